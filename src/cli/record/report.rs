//! What a recording came to.

use std::io::{self, Write};
use std::time::Duration;

use super::input::InputReport;
use crate::admission::{Refusal, RefusalCounts};
use crate::capture::record::Written;
use crate::text::{count_of, grouped};

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
    /// Datagrams that came, of any kind.
    pub fn received(&self) -> u64 {
        self.inputs.iter().map(|input| input.received).sum()
    }

    /// Datagrams that got lost before they came.
    pub fn dropped(&self) -> u64 {
        self.inputs.iter().map(|input| input.dropped.0).sum()
    }

    /// Where they did.
    fn dropped_where(&self) -> &'static str {
        self.inputs.first().map_or("", |input| input.dropped.1)
    }

    /// Datagrams that were let in and are not in the files.
    pub fn unwritten(&self) -> u64 {
        (self.received() - self.refused()).saturating_sub(self.written.datagrams)
    }

    fn refusals(&self) -> RefusalCounts {
        let mut sum = RefusalCounts::default();
        self.inputs
            .iter()
            .for_each(|input| sum += input.admission.refusals());
        sum
    }

    /// Datagrams that were not let in. Those of one sensor too many are: they have no line of their
    /// own, that is all.
    fn refused(&self) -> u64 {
        let refusals = self.refusals();
        refusals.total() - refusals.get(Refusal::TooMany)
    }

    /// Prints it for people; each number has its word beside it.
    ///
    /// # Errors
    /// What the reader says.
    pub fn print(&self, to: &mut impl Write) -> io::Result<()> {
        let Written {
            datagrams,
            bytes,
            first,
            last,
            files,
        } = &self.written;
        let names = match files {
            1 => first.display().to_string(),
            _ => format!("{} to {} ({files} files)", first.display(), last.display()),
        };
        let seconds = self.took.as_secs_f64();
        writeln!(to, "{names}")?;
        writeln!(
            to,
            "  recorded     {}, {} bytes, {seconds:.1} s",
            count_of(*datagrams, "datagram"),
            grouped(*bytes)
        )?;
        for sender in self
            .inputs
            .iter()
            .flat_map(|input| input.admission.senders())
        {
            let (data, port) = (
                count_of(sender.packets, "data packet"),
                sender.destination_port,
            );
            writeln!(
                to,
                "  sensor       {}: {data} on port {port}",
                sender.source
            )?;
        }
        let refusals = self.refusals();
        let others = refusals.get(Refusal::TooMany);
        if others > 0 {
            writeln!(
                to,
                "  others       {} of so many senders that they have no line here",
                count_of(others, "data packet")
            )?;
        }
        let positions: u64 = self
            .inputs
            .iter()
            .map(|input| input.admission.positions())
            .sum();
        writeln!(to, "  position     {}", count_of(positions, "packet"))?;
        self.print_missing(to)?;
        to.flush()
    }

    /// What is not in the files, and why.
    fn print_missing(&self, to: &mut impl Write) -> io::Result<()> {
        let refusals = self.refusals();
        let (dropped, unwritten) = (grouped(self.dropped()), grouped(self.unwritten()));
        let dropped_where = self.dropped_where();
        writeln!(
            to,
            "  dropped      {dropped} {dropped_where}, {unwritten} because the disk was too slow or failed"
        )?;
        writeln!(
            to,
            "  refused      {} wrong length, {} wrong marker, {} wrong azimuth, {} other source",
            grouped(refusals.get(Refusal::Length)),
            grouped(refusals.get(Refusal::Marker)),
            grouped(refusals.get(Refusal::Azimuth)),
            grouped(refusals.get(Refusal::Source)),
        )
    }

    /// What people must know of, each with its cure.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.dropped() > 0 {
            let (dropped, dropped_where) =
                (count_of(self.dropped(), "datagram"), self.dropped_where());
            warnings.push(format!(
                "{dropped} dropped {dropped_where}: the machine was too busy, or the receive buffer too small \
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
