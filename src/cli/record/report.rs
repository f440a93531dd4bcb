//! What a recording came to.

use std::io::{self, Write};
use std::time::Duration;

use crate::admission::Refusal;
use crate::daemon::record::protocol::Received;
use crate::files::sequence::Written;
use crate::text::{count_of, grouped};

/// Counts of one port, or of the daemon.
pub struct InputReport {
    /// `port 2368`, or `sensor roof of the daemon`.
    pub name: String,
    /// What came.
    pub received: Received,
    /// Whether it ended before the recording was stopped.
    pub ended_early: bool,
}

/// All that it came to.
pub struct Report {
    /// Of each port, or of the daemon.
    pub inputs: Vec<InputReport>,
    /// What is in the files.
    pub written: Written,
    /// How long it was listened.
    pub took: Duration,
}

impl Report {
    fn sum(&self, of: impl Fn(&Received) -> u64) -> u64 {
        self.inputs.iter().map(|input| of(&input.received)).sum()
    }

    /// Datagrams that came, of any kind.
    fn received(&self) -> u64 {
        self.sum(|input| input.datagrams)
    }

    /// Datagrams that the kernel dropped before.
    fn dropped(&self) -> u64 {
        self.sum(|input| input.dropped)
    }

    /// Datagrams that were not wanted.
    fn refused(&self) -> u64 {
        self.sum(Received::refused)
    }

    /// Datagrams that were selected but are not in the files.
    fn unwritten(&self) -> u64 {
        let wanted = self.received().saturating_sub(self.refused());
        wanted.saturating_sub(self.written.records)
    }

    /// Prints it for people.
    ///
    /// # Errors
    /// What the reader says.
    pub fn print(&self, to: &mut impl Write) -> io::Result<()> {
        let seconds = self.took.as_secs_f64();
        writeln!(to, "{}", self.written.names())?;
        writeln!(
            to,
            "  recorded     {}, {} bytes, {seconds:.1} s",
            count_of(self.written.records, "datagram"),
            grouped(self.written.bytes)
        )?;
        for sender in self.inputs.iter().flat_map(|input| &input.received.senders) {
            let data = count_of(sender.packets, "data packet");
            writeln!(
                to,
                "  sensor       {}: {data} on port {}",
                sender.source, sender.destination_port
            )?;
        }
        let others = self.sum(Received::others);
        if others > 0 {
            writeln!(
                to,
                "  others       {} of further senders, not listed",
                count_of(others, "data packet")
            )?;
        }
        let positions = self.sum(|input| input.positions);
        writeln!(to, "  position     {}", count_of(positions, "packet"))?;
        self.print_missing(to)?;
        to.flush()
    }

    /// Prints what is not in the files, and why.
    fn print_missing(&self, to: &mut impl Write) -> io::Result<()> {
        writeln!(
            to,
            "  dropped      {} by the kernel, {} because the disk was too slow or failed",
            grouped(self.dropped()),
            grouped(self.unwritten())
        )?;
        writeln!(
            to,
            "  refused      {} wrong length, {} wrong marker, {} wrong azimuth, {} other source",
            self.refused_for(Refusal::Length),
            self.refused_for(Refusal::Marker),
            self.refused_for(Refusal::Azimuth),
            self.refused_for(Refusal::Source),
        )
    }

    fn refused_for(&self, reason: Refusal) -> String {
        grouped(self.sum(|input| input.refusals.get(reason)))
    }

    /// Warnings, each with its cure.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.dropped() > 0 {
            let dropped = count_of(self.dropped(), "datagram");
            warnings.push(format!(
                "{dropped} dropped by the kernel: the machine was too busy, or the receive buffer too small \
                 (net.core.rmem_max)"
            ));
        }
        if self.unwritten() > 0 {
            let unwritten = count_of(self.unwritten(), "datagram");
            warnings.push(format!(
                "{unwritten} could not be written: record to a faster disk, or without compression"
            ));
        }
        let names: Vec<&str> = self.inputs.iter().map(|input| &input.name[..]).collect();
        let names = names.join(", ");
        if self.received() == 0 {
            warnings.push(format!(
                "nothing came from {names}: is the sensor on, does it send to this host, does a firewall stop it? \
                 `tcpdump -ni any udp` shows what comes"
            ));
        } else if self.received() == self.refused() {
            warnings.push(format!(
                "none of what came from {names} was of a sensor that was asked for"
            ));
        }
        if self.inputs.iter().any(|input| input.ended_early) {
            warnings.push("the daemon has ended, and the recording with it".to_owned());
        }
        warnings
    }
}
