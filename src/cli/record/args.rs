//! The options of `sweepd record`.

use std::path::PathBuf;
use std::time::Instant;

use crate::admission::SensorFilter;
use crate::cli::options::{Listening, within};
use crate::cli::output::ForceOptions;
use crate::cli::ros2::{MessageOptions, OUTPUTS};
use crate::files::sequence::Rotation;

/// Options of `sweepd record`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Only data and position packets are recorded; all else is counted by reason. Ctrl-C ends a recording \
cleanly. A packet is on the disk about a second after it came. Where a daemon has the sensor, --from \
records what the daemon receives.

With --mcap, this program records the sweeps that the daemon shares, not its packets: points, boxes of \
the segments, and where the sensor sits, as messages of ROS 2. A sweep is on the disk about a second \
after it came. A file is called FILE.part while it is being written; if a kill leaves one, the next \
recording to that name mends it, as NAME-recovered.mcap. Nothing that is damaged is deleted.

Examples:
  sweepd record -o drive.pcap
  sweepd record -o minute.pcap.gz --seconds 60 --sensor 192.168.1.201
  sweepd record -o drive.pcap --port 2369 --rotate-mb 1000
  sweepd record -o group.pcap --multicast 239.1.2.3 --interface eth1
  sweepd record -o roof.pcap --from roof
  sweepd record --mcap roof.mcap --from roof --rotate-seconds 60")]
pub struct Args {
    /// File to write: NAME.pcap or NAME.pcap.gz; with --force it is NAME.pcap.part until it ends, and
    /// such a part of a recording that was killed becomes NAME-recovered.pcap
    #[arg(short, long, value_name = "FILE", required_unless_present = "mcap")]
    pub(super) output: Option<PathBuf>,
    /// File to write sweeps to instead of packets: NAME.mcap, for Foxglove and ros2 bag; it gets those
    /// that the daemon shares of the sensor of --from, and must run as the daemon's user
    #[arg(long, value_name = "FILE", group = OUTPUTS, requires = "from", conflicts_with_all = ["output", "sensor"])]
    pub(super) mcap: Option<PathBuf>,
    #[command(flatten)]
    pub(super) force: ForceOptions,
    /// Have the running daemon record what it receives of this sensor, by its name in the daemon's
    /// configuration; the daemon's user must be allowed to write the file
    #[arg(long, value_name = "NAME", conflicts_with_all = ["ports", "bind", "multicast", "interface"])]
    pub(super) from: Option<String>,
    /// Folder of the daemon's files [default: $SWEEPD_ROOT; else /run/sweepd/iox2 where there is a
    /// /run/sweepd, else /tmp/sweepd/iox2]
    #[arg(long, value_name = "DIR", requires = "from")]
    pub(super) root: Option<PathBuf>,
    #[command(flatten)]
    pub(super) listening: Listening,
    /// Only sensors at this address: IP or IP:PORT; may be given several times
    #[arg(long, value_name = "ADDR")]
    pub(super) sensor: Vec<SensorFilter>,
    /// Stop after this [default: at Ctrl-C or SIGTERM]
    #[arg(long, value_name = "SECONDS", value_parser = within(0.1..=1e9, "seconds"), allow_negative_numbers = true)]
    pub(super) seconds: Option<f64>,
    /// Begin another file before one gets longer than this, uncompressed: NAME-000.pcap,
    /// NAME-001.pcap, ..., numbers that exist left out
    #[arg(
        long,
        value_name = "MB",
        value_parser = within(0.01..=1e9, "MB"),
        allow_negative_numbers = true,
        conflicts_with = "force"
    )]
    pub(super) rotate_mb: Option<f64>,
    /// Begin another file before one covers more time than this; names as with --rotate-mb
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = within(0.1..=1e9, "seconds"),
        allow_negative_numbers = true,
        conflicts_with = "force"
    )]
    pub(super) rotate_seconds: Option<f64>,
    #[command(flatten)]
    pub(super) messages: MessageOptions,
}

impl Args {
    /// When the recording begins another file.
    pub fn rotation(&self) -> Rotation {
        // The casts saturate.
        Rotation {
            bytes: self.rotate_mb.map(|megabytes| (megabytes * 1e6) as u64),
            ns: self.rotate_seconds.map(|seconds| (seconds * 1e9) as u64),
        }
    }

    /// Whether the recording has lasted as long as was asked.
    pub fn is_due(&self, begun: Instant) -> bool {
        self.seconds
            .is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds)
    }
}
