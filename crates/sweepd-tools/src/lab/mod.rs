//! Subcommands of the laboratory: simulated sensors, clouds, scores.

pub mod score;
pub mod segment;
pub mod simulate;

use std::path::Path;

use clap::Subcommand;

use sweepd::cli::CliError;
use sweepd::files;

use crate::soak;

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Segment point clouds that have no packets: KITTI, nuScenes, PCD, PLY
    Segment(Box<segment::Args>),
    /// Score labels against the ground truth of labelled scans (SemanticKITTI)
    Score(Box<score::Args>),
    /// Simulate sensors: send their packets, or write them to a capture
    Simulate(Box<simulate::Args>),
    /// Run a daemon through a day of faults, faster than life, and check that nothing grows and all
    /// is counted
    Soak(soak::Args),
}

/// Runs a subcommand.
///
/// # Errors
/// [`CliError`].
pub fn run(command: &Command) -> Result<(), CliError> {
    match command {
        Command::Segment(args) => segment::run(args),
        Command::Score(args) => score::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Soak(args) => soak::run(args),
    }
}

/// The bytes of a file of at most `limit` bytes.
fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, CliError> {
    files::read(path, limit).map_err(|source| CliError::Read {
        path: path.to_owned(),
        source,
    })
}
