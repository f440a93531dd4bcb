//! Traffic that is not of a Velodyne: senders, destinations and amounts, and the LiDAR that it may
//! be of.

use std::collections::HashMap;
use std::net::SocketAddr;

use super::report::{FlowReport, per_s};
use crate::strangers::Form;
use crate::text::{count_of, rate};
use sweepd_core::wire::Datagram;

/// Most flows that are counted separately: a hostile capture may have millions.
const MAX_FLOWS: usize = 1024;
/// Most that are shown, the largest first.
const SHOWN: usize = 8;

/// The traffic that belongs to no sensor.
#[derive(Default)]
pub struct Flows {
    flows: HashMap<(SocketAddr, u16), Flow>,
    /// Datagrams of flows beyond [`MAX_FLOWS`].
    beyond: u64,
}

/// From one sender to one port.
struct Flow {
    datagrams: u64,
    form: Form,
    first_ns: i64,
    last_ns: i64,
}

impl Flows {
    /// Counts a datagram.
    pub fn add(&mut self, datagram: &Datagram<'_>) {
        let key = (datagram.source, datagram.destination_port);
        if self.flows.len() >= MAX_FLOWS && !self.flows.contains_key(&key) {
            self.beyond += 1;
            return;
        }
        let arrival_ns = datagram.arrival_ns;
        let flow = self.flows.entry(key).or_insert_with(|| Flow {
            datagrams: 0,
            form: Form::of(datagram.payload),
            first_ns: arrival_ns,
            last_ns: arrival_ns,
        });
        flow.datagrams += 1;
        flow.last_ns = arrival_ns;
        flow.form.meet(datagram.payload);
    }

    /// The largest first.
    fn sorted(&self) -> Vec<(&(SocketAddr, u16), &Flow)> {
        let mut flows: Vec<(&(SocketAddr, u16), &Flow)> = self.flows.iter().collect();
        // The address last, for a stable order.
        flows.sort_by_key(|&(key, flow)| (std::cmp::Reverse(flow.datagrams), *key));
        flows
    }

    /// All of them for programs, but for those beyond [`MAX_FLOWS`].
    pub fn reports(&self) -> Vec<FlowReport> {
        let flows = self.sorted().into_iter();
        let reports = flows.map(|(&(source, port), flow)| FlowReport {
            source,
            port,
            datagrams: flow.datagrams,
            datagrams_per_s: per_s(flow.datagrams, flow.first_ns, flow.last_ns),
            form: flow.form.to_string(),
            lidar: flow.form.lidar(source.port(), port),
        });
        reports.collect()
    }

    /// A line for each of the largest flows, and one for the rest.
    pub fn lines(&self) -> Vec<String> {
        let flows = self.sorted();
        let shown = flows.len().min(SHOWN);
        let mut lines: Vec<String> = flows[..shown]
            .iter()
            .map(|((source, port), flow)| flow.line(*source, *port))
            .collect();
        let rest = flows[shown..].iter().map(|(_, flow)| flow.datagrams);
        let rest = rest.sum::<u64>() + self.beyond;
        if rest > 0 {
            lines.push(format!("and {} of others", count_of(rest, "datagram")));
        }
        lines
    }
}

impl Flow {
    fn line(&self, source: SocketAddr, port: u16) -> String {
        let form = &self.form;
        let count = count_of(self.datagrams, "datagram");
        let rate = rate(self.datagrams, self.first_ns, self.last_ns);
        let mut line = format!("{source} to port {port}: {count} of {form}{rate}");
        if let Some(maker) = form.lidar(source.port(), port) {
            line += &format!("; looks like {maker}");
        }
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flows(sent: &[(&str, u16, &[u8])]) -> Vec<String> {
        let mut flows = Flows::default();
        for (number, &(source, destination_port, payload)) in sent.iter().enumerate() {
            let (arrival_ns, source) = (number as i64 * 500_000_000, source.parse().unwrap());
            flows.add(&Datagram {
                arrival_ns,
                source,
                destination_port,
                payload,
            });
        }
        flows.lines()
    }

    #[test]
    fn well_known_lidars_are_recognised_by_ports_lengths_and_marks() {
        let robosense = [&[0x55, 0xAA, 0x05, 0x0A][..], &[0; 1244]].concat();
        for (source, port, payload, like) in [
            (
                "10.0.0.1:50000",
                7502,
                &[1; 8448][..],
                "an Ouster (its port for measurements)",
            ),
            (
                "10.0.0.1:50001",
                7503,
                &[1; 48],
                "an Ouster (its port for inertial data)",
            ),
            ("10.0.0.2:56300", 56301, &[0; 1380], "a Livox Mid-360"),
            ("10.0.0.3:10000", 2368, &[0xEE, 0xFF, 6, 1, 0, 0], "a Hesai"),
            ("10.0.0.4:6699", 6699, &robosense, "a RoboSense"),
        ] {
            let lines = flows(&[(source, port, payload); 3]);
            let told = format!(
                "{source} to port {port}: 3 datagrams of {} bytes (2.0 a second); looks like {like}",
                payload.len()
            );
            assert!(lines.len() == 1 && lines[0].starts_with(&told), "{lines:?}");
        }
        for (port, payload) in [(7502, &[1; 100][..]), (5353, &[0x55, 0xAA]), (123, &[])] {
            let lines = flows(&[("10.0.0.9:999", port, payload)]);
            assert!(
                lines.len() == 1 && !lines[0].contains("looks like"),
                "{lines:?}"
            );
        }
    }

    /// It has the marks of a Velodyne's blocks, in blocks of another length.
    #[test]
    fn a_pandar40p_is_recognised_by_its_length() {
        let payload = [&[0xFF, 0xEE, 0x10, 0x27][..], &[30; 1258]].concat();
        let lines = flows(&[("10.0.0.3:10000", 2368, &payload[..]); 3]);
        assert!(
            lines[0].contains("looks like a Hesai Pandar40P"),
            "{lines:?}"
        );
    }

    #[test]
    fn what_differs_within_a_flow_is_no_mark_and_many_flows_are_summed_up() {
        let lines = flows(&[("10.0.0.1:9", 9, &[0xEE, 0xFF]), ("10.0.0.1:9", 9, &[0xEE])]);
        assert_eq!(
            lines,
            ["10.0.0.1:9 to port 9: 2 datagrams of 1 to 2 bytes (2.0 a second)"]
        );
        let sources: Vec<String> = (1..=1500).map(|port| format!("10.0.0.1:{port}")).collect();
        let sent: Vec<(&str, u16, &[u8])> = sources
            .iter()
            .map(|source| (&source[..], 9, &b"x"[..]))
            .collect();
        let lines = flows(&sent);
        assert_eq!(
            (lines.len(), &lines[8][..]),
            (9, "and 1,492 datagrams of others")
        );
    }
}
