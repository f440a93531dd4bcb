//! What the environment says of the domain, in the variables that ROS 2 has for it.

use std::env;
use std::net::Ipv4Addr;

/// The highest domain that there are ports for.
const LAST_DOMAIN: u16 = 232;

/// How far participants look for each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiscoveryRange {
    /// Nowhere: it finds no one, and is not found.
    Off,
    /// On this host, and on the static peers.
    Localhost,
    /// In the networks of this host, as far as multicast goes.
    Subnet,
}

/// A host that is looked at whether multicast reaches it or not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StaticPeer {
    /// An address, which is used at once.
    Address(Ipv4Addr),
    /// A host name, which the node looks up: every 5 s until it is known, then once a minute.
    Name(String),
}

/// Which domain a node enters, and who may find it there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    /// From 0 to 232.
    pub domain: u16,
    /// How far to look.
    pub range: DiscoveryRange,
    /// Hosts that are looked at in any case.
    pub static_peers: Vec<StaticPeer>,
}

/// A variable of the environment that makes no sense.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{variable} is `{value}`: {cure}")]
#[non_exhaustive]
pub struct EnvironmentError {
    variable: &'static str,
    value: String,
    cure: String,
}

impl Environment {
    /// Reads `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_STATIC_PEERS` and
    /// `ROS_LOCALHOST_ONLY`. What is unset or empty has ROS' default: domain 0, `SUBNET`.
    ///
    /// # Errors
    /// A variable that ROS would not take.
    pub fn from_env() -> Result<Self, EnvironmentError> {
        Self::from_variables(|name| env::var_os(name).map(|value| value.to_string_lossy().into()))
    }

    fn from_variables(
        get: impl Fn(&'static str) -> Option<String>,
    ) -> Result<Self, EnvironmentError> {
        let domain = read(&get, "ROS_DOMAIN_ID", read_domain)?;
        let mut range = read(&get, "ROS_AUTOMATIC_DISCOVERY_RANGE", read_range)?;
        let mut static_peers = read(&get, "ROS_STATIC_PEERS", read_peers)?;
        // The older variable goes before the others where it is set, as in ROS.
        if read(&get, "ROS_LOCALHOST_ONLY", read_switch)? {
            range = DiscoveryRange::Localhost;
            static_peers.clear();
        }
        if range == DiscoveryRange::Off {
            static_peers.clear();
        }
        Ok(Self {
            domain,
            range,
            static_peers,
        })
    }
}

/// Reads one variable; `parse` gives the cure where its value makes no sense.
fn read<T>(
    get: impl Fn(&'static str) -> Option<String>,
    variable: &'static str,
    parse: fn(&str) -> Result<T, String>,
) -> Result<T, EnvironmentError> {
    let value = get(variable).unwrap_or_default();
    parse(&value).map_err(|cure| EnvironmentError {
        variable,
        value,
        cure,
    })
}

fn read_domain(value: &str) -> Result<u16, String> {
    match value.parse() {
        _ if value.is_empty() => Ok(0),
        Ok(domain) if domain <= LAST_DOMAIN => Ok(domain),
        _ => Err(format!(
            "give a number from 0 to {LAST_DOMAIN}, or unset it"
        )),
    }
}

fn read_range(value: &str) -> Result<DiscoveryRange, String> {
    match value {
        "OFF" => Ok(DiscoveryRange::Off),
        "LOCALHOST" => Ok(DiscoveryRange::Localhost),
        // The system's default is that of DDS, which is multicast.
        "" | "SUBNET" | "SYSTEM_DEFAULT" => Ok(DiscoveryRange::Subnet),
        _ => Err("give OFF, LOCALHOST, SUBNET or SYSTEM_DEFAULT, or unset it".to_owned()),
    }
}

fn read_peers(value: &str) -> Result<Vec<StaticPeer>, String> {
    let peers = value.split(';').filter(|peer| !peer.is_empty());
    peers
        .map(|peer| match peer.parse() {
            Ok(address) => Ok(StaticPeer::Address(address)),
            Err(_) if is_host_name(peer) => Ok(StaticPeer::Name(peer.to_owned())),
            Err(_) => Err(format!(
                "`{peer}` is neither an IPv4 address nor a host name; separate peers by `;`"
            )),
        })
        .collect()
}

/// True for a name of RFC 1123, 2.1, also with `_`, as containers have it. One whose last label is a number
/// is none: it is an address gone wrong. The system's resolver would take 10.0.0 for 10.0.0.0.
fn is_host_name(name: &str) -> bool {
    let name = name.strip_suffix('.').unwrap_or(name);
    let is_label = |label: &str| {
        let is_inner = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
        (1..=63).contains(&label.len())
            && label.bytes().all(is_inner)
            && !label.starts_with('-')
            && !label.ends_with('-')
    };
    let last = name.rsplit('.').next().unwrap_or(name);
    name.len() <= 253
        && name.split('.').all(is_label)
        && !last.bytes().all(|byte| byte.is_ascii_digit())
}

fn read_switch(value: &str) -> Result<bool, String> {
    match value {
        "" | "0" => Ok(false),
        "1" => Ok(true),
        _ => Err("give 1 or 0, or unset it".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<Environment, String> {
        let get = |name: &'static str| {
            let found = variables.iter().find(|(other, _)| *other == name);
            found.map(|(_, value)| value.to_string())
        };
        Environment::from_variables(get).map_err(|error| error.to_string())
    }

    fn environment(domain: u16, range: DiscoveryRange, peers: &[[u8; 4]]) -> Environment {
        Environment {
            domain,
            range,
            static_peers: (peers.iter().copied())
                .map(|peer| StaticPeer::Address(peer.into()))
                .collect(),
        }
    }

    const DOMAIN: &str = "ROS_DOMAIN_ID";
    const RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
    const PEERS: &str = "ROS_STATIC_PEERS";
    const LOCALHOST: &str = "ROS_LOCALHOST_ONLY";

    #[test]
    fn variables_mean_what_they_mean_to_ros() {
        use DiscoveryRange::{Localhost, Off, Subnet};
        assert_eq!(read(&[]), Ok(environment(0, Subnet, &[])));
        let all = [
            (DOMAIN, "232"),
            (RANGE, "LOCALHOST"),
            (PEERS, "10.0.0.7;127.0.0.1;"),
        ];
        let peers = [[10, 0, 0, 7], [127, 0, 0, 1]];
        assert_eq!(read(&all), Ok(environment(232, Localhost, &peers)));
        let older = [(LOCALHOST, "1"), (RANGE, "SUBNET"), (PEERS, "10.0.0.7")];
        assert_eq!(read(&older), Ok(environment(0, Localhost, &[])));
        assert_eq!(
            read(&[(LOCALHOST, "0"), (DOMAIN, "")]),
            Ok(environment(0, Subnet, &[]))
        );
        assert_eq!(
            read(&[(RANGE, "SYSTEM_DEFAULT")]),
            Ok(environment(0, Subnet, &[]))
        );
        assert_eq!(
            read(&[(RANGE, "OFF"), (PEERS, "10.0.0.7")]),
            Ok(environment(0, Off, &[]))
        );
    }

    #[test]
    fn errors_name_the_variable_and_the_cure() {
        let cases = [
            (
                DOMAIN,
                "233",
                "ROS_DOMAIN_ID is `233`: give a number from 0 to 232, or unset it",
            ),
            (
                DOMAIN,
                "-1",
                "ROS_DOMAIN_ID is `-1`: give a number from 0 to 232, or unset it",
            ),
            (
                RANGE,
                "localhost",
                "ROS_AUTOMATIC_DISCOVERY_RANGE is `localhost`: give OFF, LOCALHOST, SUBNET or \
                 SYSTEM_DEFAULT, or unset it",
            ),
            (
                LOCALHOST,
                "yes",
                "ROS_LOCALHOST_ONLY is `yes`: give 1 or 0, or unset it",
            ),
            (
                PEERS,
                "10.0.0.7;::1",
                "ROS_STATIC_PEERS is `10.0.0.7;::1`: `::1` is neither an IPv4 address nor a host \
                 name; separate peers by `;`",
            ),
        ];
        for (variable, value, error) in cases {
            assert_eq!(read(&[(variable, value)]), Err(error.to_owned()));
        }
    }

    #[test]
    fn a_peer_is_refused_only_if_it_can_be_neither_an_address_nor_a_name() {
        let long_label = "a".repeat(63);
        let long_name = [&long_label[..]; 4].join(".");
        let names = [
            "laptop.local",
            "laptop",
            "Base-Station.lan.",
            "ros_master_1",
            "3com.example",
            "10.0.0.7.example",
            "xn--lftfjord-n1a.example",
            &long_label,
            // Three labels of 63 bytes and one of 61, with the points between them.
            &long_name[..253],
        ];
        for name in names {
            let peers = read(&[(PEERS, name)]).unwrap().static_peers;
            assert_eq!(peers, [StaticPeer::Name(name.to_owned())]);
        }
        let (longer_label, longer_name) = (format!("{long_label}a"), &long_name[..254]);
        let neither = [
            "127.0.0.1,127.0.0.2",
            "127.0.0.1:7400",
            "::1",
            "10.0.0",
            "10.0.0.",
            "300.1.1.1",
            "1.2.3.4.5",
            "010.0.0.1",
            "7",
            " laptop.local",
            "laptop .local",
            "laptop\n",
            ".",
            ".local",
            "laptop..local",
            "-laptop",
            "laptop-.local",
            "münchen.local",
            "udp/laptop",
            "$PEER",
            &longer_label,
            longer_name,
        ];
        for peer in neither {
            let error = format!(
                "ROS_STATIC_PEERS is `a;{peer}`: `{peer}` is neither an IPv4 address nor a host \
                 name; separate peers by `;`"
            );
            assert_eq!(read(&[(PEERS, &format!("a;{peer}"))]), Err(error));
        }
    }
}
