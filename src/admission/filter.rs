//! Which senders to take.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;

/// Selects sensors: all at an address, those that send from one port, or also to one port; in a
/// bag, that of a topic.
///
/// ```
/// use sweepd::admission::SensorFilter;
/// let filter: SensorFilter = "192.168.1.201".parse().unwrap();
/// assert!(filter.matches("192.168.1.201:2368".parse().unwrap(), 2368));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorFilter(Selection);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Selection {
    Address {
        ip: IpAddr,
        source_port: Option<u16>,
        destination_port: Option<u16>,
    },
    Topic(String),
}

impl SensorFilter {
    /// Selects what comes from an address; where ports are given, from the one and to the other.
    pub fn new(ip: IpAddr, source_port: Option<u16>, destination_port: Option<u16>) -> Self {
        Self(Selection::Address {
            ip,
            source_port,
            destination_port,
        })
    }

    /// Selects what both select; `None` where that is nothing.
    pub fn and(&self, other: &Self) -> Option<Self> {
        match (&self.0, &other.0) {
            (
                &Selection::Address {
                    ip,
                    source_port,
                    destination_port,
                },
                &Selection::Address {
                    ip: other_ip,
                    source_port: other_source,
                    destination_port: other_destination,
                },
            ) => {
                let is_possible = ip == other_ip
                    && agree(source_port, other_source)
                    && agree(destination_port, other_destination);
                let source_port = source_port.or(other_source);
                let destination_port = destination_port.or(other_destination);
                is_possible.then(|| Self::new(ip, source_port, destination_port))
            }
            _ => (self == other).then(|| self.clone()),
        }
    }

    /// Whether a sensor with this source that sends data to this port is selected.
    pub fn matches(&self, source: SocketAddr, destination_port: u16) -> bool {
        match self.0 {
            Selection::Address {
                ip,
                source_port,
                destination_port: to,
            } => {
                ip == source.ip().to_canonical()
                    && source_port.is_none_or(|port| port == source.port())
                    && to.is_none_or(|port| port == destination_port)
            }
            Selection::Topic(_) => false,
        }
    }

    /// Whether the sensor of this topic is selected.
    pub fn matches_topic(&self, topic: &str) -> bool {
        matches!(&self.0, Selection::Topic(own) if own == topic)
    }

    /// Whether a sensor at this address may be selected. For position packets, which come from
    /// another port.
    pub fn matches_ip(&self, address: IpAddr) -> bool {
        matches!(self.0, Selection::Address { ip, .. } if ip == address.to_canonical())
    }
}

/// Whether two ports, each of which may be any, can be one.
fn agree(one: Option<u16>, other: Option<u16>) -> bool {
    one.is_none() || other.is_none() || one == other
}

impl std::fmt::Display for SensorFilter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.0 {
            Selection::Topic(topic) => f.write_str(topic),
            Selection::Address {
                ip,
                source_port,
                destination_port,
            } => {
                match source_port {
                    Some(port) => write!(f, "{}", SocketAddr::new(*ip, *port))?,
                    None => write!(f, "{ip}")?,
                }
                destination_port.map_or(Ok(()), |port| write!(f, ">{port}"))
            }
        }
    }
}

/// A text that names no sensor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` names no sensor; expected IP, IP:PORT or IP:PORT>PORT as in the output, such as 192.168.1.201 or \
     192.168.1.201:2368, with an IPv6 address in brackets before a port; or a topic of a bag, such as /velodyne_packets"
)]
pub struct SensorFilterError(String);

impl SensorFilterError {
    /// Of this text.
    pub fn new(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl FromStr for SensorFilter {
    type Err = SensorFilterError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::parse(text).ok_or_else(|| SensorFilterError::new(text))
    }
}

impl SensorFilter {
    fn parse(text: &str) -> Option<Self> {
        if text.starts_with('/') {
            return Some(Self(Selection::Topic(text.to_owned())));
        }
        if let Ok(ip) = text.parse::<IpAddr>() {
            return Some(Self(Selection::Address {
                ip: ip.to_canonical(),
                source_port: None,
                destination_port: None,
            }));
        }
        let (source, destination_port) = match text.split_once('>') {
            Some((source, port)) => (source, Some(port.parse().ok()?)),
            None => (text, None),
        };
        let source: SocketAddr = source.parse().ok()?;
        Some(Self(Selection::Address {
            ip: source.ip().to_canonical(),
            source_port: Some(source.port()),
            destination_port,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_written_as_they_are_read() {
        for text in [
            "10.0.0.1",
            "10.0.0.1:5",
            "10.0.0.1:5>6",
            "fe80::1",
            "[fe80::1]:5",
            "/left/velodyne_packets",
        ] {
            assert_eq!(text.parse::<SensorFilter>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn two_filters_select_what_both_do() {
        for (one, other, both) in [
            ("10.0.0.1", "10.0.0.1:5", Some("10.0.0.1:5")),
            ("10.0.0.1:5>6", "10.0.0.1:5", Some("10.0.0.1:5>6")),
            ("10.0.0.1:4", "10.0.0.1:5", None),
            ("10.0.0.1", "10.0.0.2", None),
            ("/left", "/left", Some("/left")),
            ("/left", "10.0.0.1", None),
        ] {
            let [one, other] = [one, other].map(|text| text.parse::<SensorFilter>().unwrap());
            let found = one.and(&other);
            assert_eq!(found, other.and(&one));
            assert_eq!(found.map(|found| found.to_string()).as_deref(), both);
        }
    }

    #[test]
    fn a_wrong_filter_says_what_was_expected() {
        for text in [
            "",
            "lidar",
            "10.0.0",
            "10.0.0.1:",
            "10.0.0.1:99999",
            "10.0.0.1>5",
            "10.0.0.1:5>x",
            "fe80::1:5>6",
        ] {
            let error = text.parse::<SensorFilter>().unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("`{text}` names no sensor; expected IP")),
                "{error}"
            );
        }
    }
}
