//! Senders whose datagrams reach no sensor: who they are, as far as their packets tell, and what to
//! change if one of them is the sensor that is waited for. The daemon, `doctor` and `inspect` read
//! it here.

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::ops::RangeInclusive;

use serde_json::{Value, json};

use sweepd_core::sensor::Model;
use sweepd_core::sensor::detect::Detector;
use sweepd_core::wire::{Content, DataPacket, Datagram};

/// Most strangers of a port that are told apart.
const MAX_STRANGERS: usize = 16;
/// A stranger that has sent nothing for this long makes room for another, and is no cause of
/// present silence, nanoseconds.
const GONE_NS: u64 = 5_000_000_000;
/// Bytes of a payload in which formats have their marks.
const HEAD_BYTES: usize = 4;

/// The length and the first bytes that the payloads of a sender have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Form {
    /// Bytes of the shortest and of the longest payload.
    pub bytes: RangeInclusive<usize>,
    head: [u8; HEAD_BYTES],
    head_len: usize,
}

impl Form {
    /// The form of one payload.
    pub fn of(payload: &[u8]) -> Self {
        let len = payload.len();
        let head_len = len.min(HEAD_BYTES);
        let mut head = [0; HEAD_BYTES];
        head[..head_len].copy_from_slice(&payload[..head_len]);
        Self {
            bytes: len..=len,
            head,
            head_len,
        }
    }

    /// Keeps what another payload has in common with those before.
    pub fn meet(&mut self, payload: &[u8]) {
        let len = payload.len();
        self.bytes = len.min(*self.bytes.start())..=len.max(*self.bytes.end());
        let pairs = self.head[..self.head_len].iter().zip(payload);
        self.head_len = pairs.take_while(|(a, b)| a == b).count();
    }

    /// The LiDAR that sends such datagrams by default from one port to another, according to its
    /// maker's drivers.
    pub fn lidar(&self, source_port: u16, port: u16) -> Option<&'static str> {
        let least = *self.bytes.start();
        let head = &self.head[..self.head_len];
        match (source_port, port) {
            (_, 7502) if least >= 1000 => Some("an Ouster (its port for measurements)"),
            (_, 7503) if least == 48 => Some("an Ouster (its port for inertial data)"),
            (56300, _) if least >= 1000 => Some("a Livox Mid-360 (its port for points)"),
            (57000, _) if least >= 1000 => Some("a Livox HAP (its port for points)"),
            _ if head.starts_with(&[0xEE, 0xFF]) => Some("a Hesai (by its first bytes)"),
            // Its blocks begin as those of a Velodyne do; 4 bytes more are a sequence number.
            _ if head.starts_with(&[0xFF, 0xEE]) && (least == 1262 || least == 1266) => {
                Some("a Hesai Pandar40P (by length and first bytes)")
            }
            _ if head.starts_with(&[0x55, 0xAA]) && least == 1248 => {
                Some("a RoboSense (by length and first bytes)")
            }
            _ => None,
        }
    }
}

/// Their length: "1262 bytes", "1 to 9 bytes".
impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (least, most) = (self.bytes.start(), self.bytes.end());
        if least != most {
            write!(f, "{least} to ")?;
        }
        write!(f, "{most} bytes")
    }
}

/// What a stranger sends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sends {
    /// Data packets of a Velodyne, of this model if the packets tell it.
    Data(Option<Model>),
    /// Position packets of a Velodyne alone.
    Positions,
    /// Datagrams of another LiDAR, with its name, or of anything else.
    Others(Form, Option<&'static str>),
}

impl fmt::Display for Sends {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Data(Some(model)) => write!(f, "data packets of model {model}"),
            Self::Data(None) => f.write_str("data packets of a Velodyne"),
            Self::Positions => f.write_str("position packets of a Velodyne"),
            Self::Others(form, lidar) => {
                write!(f, "datagrams of {form}")?;
                lidar.map_or(Ok(()), |lidar| write!(f, " that look like {lidar}"))
            }
        }
    }
}

/// A sender whose datagrams reach no sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stranger {
    /// Where it sends from.
    pub source: SocketAddr,
    /// What it sends.
    pub sends: Sends,
    /// How many came since it was last forgotten.
    pub datagrams: u64,
}

impl Stranger {
    /// Whether it is a LiDAR of another maker.
    pub fn is_other_lidar(&self) -> bool {
        matches!(self.sends, Sends::Others(_, Some(_)))
    }

    /// That nothing of what it sends is a Velodyne's.
    pub fn not_velodyne(&self) -> Cause {
        Cause {
            what: format!(
                "{} come from {}, and none is a packet of a Velodyne",
                self.sends, self.source
            ),
            cure: "sweepd decodes Velodynes alone: correct `address` or `port`, or look at what is connected there"
                .to_owned(),
        }
    }

    /// For programs.
    pub fn json(&self) -> Value {
        let model = match self.sends {
            Sends::Data(Some(model)) => Some(model.to_string()),
            _ => None,
        };
        json!({
            "address": self.source.ip(),
            "source_port": self.source.port(),
            "sends": self.sends.to_string(),
            "model": model,
            "datagrams": self.datagrams,
        })
    }
}

/// A stranger, and what is kept to tell what it is.
#[derive(Clone, Debug)]
struct Entry {
    source: SocketAddr,
    /// The port that it sends to.
    port: u16,
    form: Form,
    datagrams: u64,
    /// Data packets and position packets among them.
    data: u64,
    positions: u64,
    newest_ns: i64,
    /// Its datagrams, less those of senders that found no room.
    weight: u64,
    detector: Detector,
    model: Option<Model>,
}

impl Entry {
    fn new(datagram: &Datagram<'_>) -> Self {
        Self {
            source: datagram.source,
            port: datagram.destination_port,
            form: Form::of(datagram.payload),
            datagrams: 0,
            data: 0,
            positions: 0,
            newest_ns: datagram.arrival_ns,
            weight: 0,
            detector: Detector::new(None),
            model: None,
        }
    }

    fn add(&mut self, datagram: &Datagram<'_>) {
        self.datagrams += 1;
        self.weight += 1;
        self.newest_ns = datagram.arrival_ns;
        self.form.meet(datagram.payload);
        match datagram.parse().map(|packet| packet.content) {
            Ok(Content::Data(packet)) => self.add_data(packet),
            Ok(Content::Position(..)) => self.positions += 1,
            Err(_) => {}
        }
    }

    fn add_data(&mut self, packet: &DataPacket) {
        self.data += 1;
        if self.model.is_none()
            && let Some(Ok(detection)) = self.detector.observe(packet)
        {
            self.model = Some(detection.model);
        }
    }

    fn is_gone(&self, now_ns: i64) -> bool {
        now_ns.abs_diff(self.newest_ns) > GONE_NS
    }

    fn stranger(&self) -> Stranger {
        let sends = match (self.data, self.positions) {
            (0, 0) => Sends::Others(
                self.form.clone(),
                self.form.lidar(self.source.port(), self.port),
            ),
            (0, _) => Sends::Positions,
            _ => Sends::Data(self.model),
        };
        Stranger {
            source: self.source,
            sends,
            datagrams: self.datagrams,
        }
    }
}

/// The strangers of a port. Its size is fixed, whoever sends.
#[derive(Clone, Debug)]
pub struct Strangers(Vec<Entry>);

impl Default for Strangers {
    fn default() -> Self {
        Self(Vec::with_capacity(MAX_STRANGERS))
    }
}

impl Strangers {
    /// Notes a datagram that reaches no sensor. Without room for its sender, one datagram less
    /// counts for each that is there (after Misra and Gries): whoever sends more than a 17th of all
    /// stays, however many addresses a flood has.
    pub fn add(&mut self, datagram: &Datagram<'_>) {
        let source = SocketAddr::new(datagram.source.ip().to_canonical(), datagram.source.port());
        let datagram = &Datagram {
            source,
            ..*datagram
        };
        if let Some(known) = self.0.iter_mut().find(|one| one.source == source) {
            if known.is_gone(datagram.arrival_ns) {
                *known = Entry::new(datagram);
            }
            return known.add(datagram);
        }
        if self.0.len() == MAX_STRANGERS {
            self.0.retain_mut(|one| {
                one.weight = one.weight.saturating_sub(1);
                one.weight > 0 && !one.is_gone(datagram.arrival_ns)
            });
        }
        if self.0.len() < MAX_STRANGERS {
            let mut one = Entry::new(datagram);
            one.add(datagram);
            self.0.push(one);
        }
    }

    /// All of them, from the first that came.
    pub fn all(&self) -> Vec<Stranger> {
        self.0.iter().map(Entry::stranger).collect()
    }

    /// Those that send now, from the one that sends most; nanoseconds since 1970.
    pub fn present(&self, now_ns: i64) -> Vec<Stranger> {
        let present = self.0.iter().filter(|one| !one.is_gone(now_ns));
        let mut present: Vec<Stranger> = present.map(Entry::stranger).collect();
        present.sort_by_key(|one| (std::cmp::Reverse(one.datagrams), one.source));
        present
    }
}

/// A sensor from which nothing comes.
#[derive(Clone, Copy, Debug)]
pub struct Sought {
    /// Its configured address.
    pub address: IpAddr,
    /// The port that it should send its data to.
    pub port: u16,
}

/// Why nothing comes from a sensor, and the cure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cause {
    /// What is in the way.
    pub what: String,
    /// What to change.
    pub cure: String,
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.cure)
    }
}

impl Sought {
    /// What comes in its place, of the strangers by the port that they send to; `known` are the
    /// addresses of all configured sensors. The likeliest alone: its own address on another port or
    /// with other datagrams, then a Velodyne, then another LiDAR on its port.
    pub fn instead(&self, strangers: &[(u16, Stranger)], known: &[IpAddr]) -> Option<Cause> {
        let own = strangers
            .iter()
            .filter(|(_, one)| one.source.ip() == self.address);
        let data = own
            .clone()
            .find(|(_, one)| matches!(one.sends, Sends::Data(_)));
        if let Some((port, one)) = data {
            return Some(self.elsewhere(*port, one));
        }
        let own_others = own
            .clone()
            .find(|(port, one)| *port == self.port && matches!(one.sends, Sends::Others(..)));
        if let Some((_, one)) = own_others {
            return Some(one.not_velodyne());
        }
        let unknown = strangers
            .iter()
            .filter(|(port, one)| *port == self.port && !known.contains(&one.source.ip()));
        let velodynes: Vec<&Stranger> = unknown
            .clone()
            .map(|(_, one)| one)
            .filter(|one| matches!(one.sends, Sends::Data(_)))
            .collect();
        if !velodynes.is_empty() {
            return Some(other_address(&velodynes));
        }
        let lidar = unknown.map(|(_, one)| one).find(|one| one.is_other_lidar());
        lidar.map(Stranger::not_velodyne)
    }

    /// Its address is right, its port, or the port that it sends from, is not.
    fn elsewhere(&self, port: u16, one: &Stranger) -> Cause {
        let Stranger { source, sends, .. } = one;
        let cure = if port == self.port {
            format!("set `address = \"{source}\"`, or leave the port there out")
        } else {
            format!(
                "set `port = {port}`, or Data Port on its web page to {}",
                self.port
            )
        };
        Cause {
            what: format!("{sends} come from {source} to port {port}"),
            cure,
        }
    }
}

/// One Velodyne or more of addresses that are not configured.
fn other_address(velodynes: &[&Stranger]) -> Cause {
    // More than a few are no help.
    let shown = &velodynes[..velodynes.len().min(3)];
    let whats: Vec<String> = shown
        .iter()
        .map(|one| format!("{} come from {}", one.sends, one.source.ip()))
        .collect();
    let lines: Vec<String> = shown
        .iter()
        .map(|one| format!("`address = \"{}\"`", one.source.ip()))
        .collect();
    Cause {
        what: whats.join(", and "),
        cure: format!("if that is this sensor, set {}", lines.join(" or ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PORT: u16 = 2368;

    fn datagram(source: SocketAddr, arrival_ns: i64, payload: &[u8]) -> Datagram<'_> {
        Datagram {
            arrival_ns,
            source,
            destination_port: PORT,
            payload,
        }
    }

    /// A sensor sends one datagram of nine; each of the others has an address of its own.
    #[test]
    fn a_flood_of_addresses_hides_no_sensor_and_takes_no_memory() {
        let sensor: SocketAddr = "10.0.0.1:2368".parse().unwrap();
        let mut strangers = Strangers::default();
        for number in 0..90_000_u32 {
            let source = match number % 9 {
                0 => sensor,
                _ => SocketAddr::new(IpAddr::V4((0x0B00_0000 + number).into()), 9),
            };
            strangers.add(&datagram(source, i64::from(number) * 1000, &[7; 100]));
        }
        assert_eq!(strangers.0.capacity(), MAX_STRANGERS);
        let all = strangers.all();
        assert_eq!((all[0].source, all[0].datagrams), (sensor, 10_000));
    }

    #[test]
    fn who_is_silent_makes_room_and_is_no_cause() {
        let mut strangers = Strangers::default();
        for host in 0..MAX_STRANGERS as u8 {
            let source = SocketAddr::from(([10, 0, 0, host], 9));
            for _ in 0..100 {
                strangers.add(&datagram(source, 0, &[1]));
            }
        }
        let late = GONE_NS as i64 + 1;
        assert_eq!(strangers.present(late - 1).len(), MAX_STRANGERS);
        assert_eq!(strangers.present(late), []);
        let new: SocketAddr = "10.0.1.1:9".parse().unwrap();
        strangers.add(&datagram(new, late, &[1]));
        assert_eq!(strangers.all()[0].source, new);
    }

    #[test]
    fn the_line_to_change_is_that_of_who_sends() {
        let roof = Sought {
            address: "192.168.1.201".parse().unwrap(),
            port: PORT,
        };
        let rear: IpAddr = "192.168.1.202".parse().unwrap();
        let from = |source: &str, port, sends| {
            let source = source.parse().unwrap();
            let datagrams = 754;
            (
                port,
                Stranger {
                    source,
                    sends,
                    datagrams,
                },
            )
        };
        let data = || Sends::Data(Some(Model::Vlp16));
        let noise = || Sends::Others(Form::of(&[1]), None);
        for (strangers, part) in [
            (
                vec![from("192.168.1.203:2368", PORT, data())],
                Some("`address = \"192.168.1.203\"`"),
            ),
            (
                vec![from("192.168.1.201:2368", 2369, data())],
                Some("`port = 2369`"),
            ),
            (
                vec![from("192.168.1.201:4000", PORT, data())],
                Some("`address = \"192.168.1.201:4000\"`"),
            ),
            (
                vec![from("192.168.1.201:4000", PORT, noise())],
                Some("datagrams of 1 bytes"),
            ),
            // Another port's, another sensor's, and noise.
            (vec![from("192.168.1.203:2368", 2369, data())], None),
            (vec![from("192.168.1.202:2368", PORT, data())], None),
            (vec![from("192.168.1.203:2368", PORT, noise())], None),
        ] {
            let instead = roof.instead(&strangers, &[roof.address, rear]);
            let text = instead.map(|one| one.to_string());
            match part {
                Some(part) => assert!(
                    text.as_ref().is_some_and(|text| text.contains(part)),
                    "{text:?}"
                ),
                None => assert_eq!(text, None),
            }
        }
    }
}
