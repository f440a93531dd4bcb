//! Asks a running daemon for its health.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;

use crate::web_interface::{get_json, runtime};

const PATIENCE: Duration = Duration::from_secs(2);

/// The daemon's `/health`, whether all is well there or not.
///
/// # Errors
/// In a few words, why there is no answer.
pub fn ask(at: SocketAddr) -> Result<Value, String> {
    runtime()
        .map_err(|error| error.to_string())?
        .block_on(get_json(at, "/health", PATIENCE))
}
