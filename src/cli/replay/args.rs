//! Options of `sweepd replay`.

use std::path::PathBuf;

use crate::cli::CliError;
use crate::cli::jobs::JobOptions;
use crate::cli::options::{SegmentOptions, SensorOptions};
use crate::cli::output::OutputOptions;
use crate::cli::play::PlayOptions;
use crate::cli::publish::PublishOptions;
use crate::cli::sections::Sections;
use crate::cli::stream::is_stdout;
use crate::cure::{Dialect, explain};
use sweepd_client::host::monotonic_ns;
use sweepd_core::pipeline::Fault;

/// Options of `sweepd replay`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  sweepd replay pcap_fixtures/street_vlp16.pcap.gz --png out
  sweepd replay drive.pcapng --sensor 192.168.1.201 --json > sweeps.jsonl
  sweepd replay drive.pcap --config sweepd.toml --sensor roof
  sweepd replay drive.pcap --start 10 --end 20 --csv returns --partial
  sweepd replay drive.pcap --start 60 --end 65 --pcap fault.pcap.gz
  sweepd replay drive.pcap --to 127.0.0.1:2368 --loop
  sweepd replay drive.pcap --publish roof --loop")]
pub struct Args {
    /// pcap or pcapng, plain or compressed with gzip, zstd, bzip2 or lz4; a ROS bag with VelodyneScan
    /// messages (.mcap, .db3, .bag, or the folder of a ROS 2 bag); or bare packets; - is standard input
    #[arg(value_name = "CAPTURE")]
    pub capture: PathBuf,
    #[command(flatten)]
    pub(super) jobs: JobOptions,
    #[command(flatten)]
    pub(super) sensor: SensorOptions,
    #[command(flatten)]
    segment: SegmentOptions,
    #[command(flatten)]
    pub(super) output: OutputOptions,
    /// Print objects as they become complete while the head turns: one JSON line each on standard
    /// output, with the arrival time of the packet that completed it, and one line for each sweep
    /// with the labels of its objects; uses one thread
    #[arg(long, conflicts_with = "json", help_heading = "Output")]
    pub(super) objects: bool,
    /// The packets that are replayed, as a capture of their own that gives the same sweeps:
    /// NAME.pcap or NAME.pcap.gz; - is standard output. With --sensor, --start and --end a piece of
    /// the capture, for a report of a fault
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "times",
        help_heading = "Output"
    )]
    pub(super) pcap: Option<PathBuf>,
    #[command(flatten)]
    pub(super) play: PlayOptions,
    #[command(flatten)]
    pub(super) publish: PublishOptions,
}

impl Args {
    /// How each sensor is decoded and segmented.
    pub(super) fn sections(&self) -> Result<Sections, CliError> {
        Sections::read(&self.sensor, &self.segment)
    }

    /// Whether standard output is for programs.
    pub(super) fn is_piped(&self) -> bool {
        self.objects || self.output.is_piped() || self.is_pcap_piped()
    }

    /// Where it writes beside standard output, as it is shown: folders, files, consumers, an address.
    pub(super) fn places(&self) -> Vec<String> {
        let mut places = self.output.places();
        let pcap = self.pcap.iter().filter(|path| !is_stdout(path));
        places.extend(pcap.map(|path| path.display().to_string()));
        let names = self.publish.publish.iter();
        places.extend(names.map(|name| format!("consumers of {name}")));
        places.extend(self.play.to.map(|to| to.to_string()));
        places
    }

    /// Whether the packets go to standard output.
    fn is_pcap_piped(&self) -> bool {
        self.pcap.as_deref().is_some_and(is_stdout)
    }

    /// Refuses options that contradict each other.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub(super) fn check(&self) -> Result<(), CliError> {
        if self.is_pcap_piped() && (self.objects || self.output.is_piped()) {
            return Err(CliError::Usage(
                "--pcap - and another output both write to standard output; give --pcap a file"
                    .to_owned(),
            ));
        }
        self.play.check(&self.capture)?;
        self.publish.check()
    }

    /// The clock that times the stages, nanoseconds; it stands still where times are left out.
    pub(super) fn clock(&self) -> fn() -> i64 {
        if self.output.no_timing {
            || 0
        } else {
            monotonic_ns
        }
    }

    /// A fault in the words of the options that brought it.
    pub(super) fn explain(&self, fault: &Fault) -> String {
        let text = explain(fault, Dialect::CommandLine);
        match (fault, &self.sensor.calibration, &self.segment.mask) {
            (Fault::Calibration(why), Some(file), _) => format!(
                "the calibration {} does not fit: {why}; give the file of this unit, or leave --calibration away",
                file.display()
            ),
            (Fault::Mask { .. }, _, Some(file)) => format!("{}: {text}", file.display()),
            _ => text,
        }
    }
}
