//! What a recording came to.

use std::io::{self, Write};
use std::time::Duration;

use super::files::Written;
use crate::capture::Gate;
use crate::capture::sensors::OtherCounts;
use crate::export::text::{count_of, grouped};

/// What one port came to.
pub struct PortReport {
    /// The port.
    pub port: u16,
    /// Datagrams that came.
    pub received: u64,
    /// Datagrams that the kernel dropped before.
    pub dropped: u64,
    /// What got in, and what did not.
    pub gate: Gate,
}

/// All of it.
pub struct Report {
    /// A line a port.
    pub ports: Vec<PortReport>,
    /// What is in the files.
    pub written: Written,
    /// How long it was listened.
    pub took: Duration,
}

impl Report {
    /// Datagrams that came, of any kind.
    pub fn received(&self) -> u64 {
        self.ports.iter().map(|port| port.received).sum()
    }

    /// Datagrams that the kernel dropped.
    pub fn dropped(&self) -> u64 {
        self.ports.iter().map(|port| port.dropped).sum()
    }

    /// Datagrams that were let in and are not in the files.
    pub fn unwritten(&self) -> u64 {
        (self.received() - self.refused().total()).saturating_sub(self.written.datagrams)
    }

    fn refused(&self) -> OtherCounts {
        let refused = self.ports.iter().map(|port| port.gate.refused());
        refused.fold(OtherCounts::default(), |sum, more| OtherCounts {
            length: sum.length + more.length,
            not_velodyne: sum.not_velodyne + more.not_velodyne,
            not_selected: sum.not_selected + more.not_selected,
            too_many: sum.too_many + more.too_many,
        })
    }

    /// Prints it for people; each number has its word beside it.
    ///
    /// # Errors
    /// What the reader says.
    pub fn print(&self, to: &mut impl Write) -> io::Result<()> {
        let Written { datagrams, bytes, first, last, files } = &self.written;
        let names = match files {
            1 => first.display().to_string(),
            _ => format!("{} to {} ({files} files)", first.display(), last.display()),
        };
        let seconds = self.took.as_secs_f64();
        writeln!(to, "{names}")?;
        writeln!(to, "  recorded     {}, {} bytes, {seconds:.1} s", count_of(*datagrams, "datagram"), grouped(*bytes))?;
        for (port, sensor, data) in self.sensors() {
            writeln!(to, "  sensor       {}: {} on port {port}", sensor, count_of(data, "data packet"))?;
        }
        let positions: u64 = self.ports.iter().map(|port| port.gate.positions()).sum();
        writeln!(to, "  position     {}", count_of(positions, "packet"))?;
        let (dropped, unwritten) = (grouped(self.dropped()), grouped(self.unwritten()));
        writeln!(to, "  dropped      {dropped} by the kernel, {unwritten} because the disk was too slow or failed")?;
        let refused = self.refused();
        let [length, marker, source, many] =
            [refused.length, refused.not_velodyne, refused.not_selected, refused.too_many].map(grouped);
        writeln!(
            to,
            "  refused      {length} wrong length, {marker} wrong marker, {source} other source, {many} too many sensors"
        )?;
        to.flush()
    }

    fn sensors(&self) -> impl Iterator<Item = (u16, &str, u64)> {
        let of = |port: &PortReport| port.port;
        self.ports
            .iter()
            .flat_map(move |port| port.gate.by_sensor().map(move |(sensor, data)| (of(port), &sensor.name[..], data)))
    }

    /// What people must know of, each with its cure.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.dropped() > 0 {
            let dropped = count_of(self.dropped(), "datagram");
            warnings.push(format!(
                "the kernel dropped {dropped}: the machine was too busy, or the receive buffer too small (net.core.rmem_max)"
            ));
        }
        if self.unwritten() > 0 {
            let unwritten = count_of(self.unwritten(), "datagram");
            warnings.push(format!("{unwritten} could not be written: record to a faster disk, or without compression"));
        }
        let ports: Vec<String> = self.ports.iter().map(|port| port.port.to_string()).collect();
        let ports = ports.join(", ");
        if self.received() == 0 {
            warnings.push(format!(
                "nothing came to port {ports}: is the sensor on, does it send to this host, does a firewall stop it? \
                 `tcpdump -ni any udp` shows what comes"
            ));
        } else if self.received() == self.refused().total() {
            warnings.push(format!("none of what came to port {ports} was of a sensor that was asked for"));
        }
        warnings
    }
}
