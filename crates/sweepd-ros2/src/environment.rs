//! What the environment says of the domain, in the variables that ROS 2 has for it.

use crate::log;
use std::env;
use std::net::Ipv4Addr;

/// The highest domain that there are ports for.
const LAST_DOMAIN: u16 = 232;

const NO_SERVER: &str = "this node asks no discovery server, and nodes that do so do not see it; \
     unset it for those that are to hear this node; where multicast does not reach them, set \
     ROS_STATIC_PEERS";
const NO_PROFILES: &str = "this node reads no profiles, and uses all interfaces of this host; \
     choose whom it speaks with by ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS";

/// True for a value that tells ROS to do otherwise than this node.
type Matters = fn(&str) -> bool;

/// Variables that decide who hears whom and that this node cannot obey, and what to do instead.
const NOT_OBEYED: [(&str, Matters, &str); 8] = [
    (
        "ROS_SECURITY_ENABLE",
        |value| value == "true",
        "this node has no DDS Security, and sends in clear; nodes that enforce it do not hear \
         this one; unset it for this node",
    ),
    ("ROS_DISCOVERY_SERVER", is_set, NO_SERVER),
    ("ROS2_EASY_MODE", is_set, NO_SERVER),
    (
        "RMW_IMPLEMENTATION",
        |value| {
            is_set(value)
                && !["dds", "rtps", "connext"]
                    .iter()
                    .any(|dds| value.contains(dds))
        },
        "this node speaks DDS (RTPS), and nodes of other middleware do not hear it; set \
         rmw_fastrtps_cpp or rmw_cyclonedds_cpp for those that are to hear it",
    ),
    (
        "FASTDDS_BUILTIN_TRANSPORTS",
        |value| {
            let (transports, _options) = value.split_once('?').unwrap_or((value, ""));
            !["", "DEFAULT", "UDPv4"].contains(&transports)
        },
        "this node sends by UDPv4 alone, and nodes with other transports get nothing of it; set \
         DEFAULT or UDPv4 for those that are to hear it",
    ),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", is_set, NO_PROFILES),
    ("FASTDDS_DEFAULT_PROFILES_FILE", is_set, NO_PROFILES),
    ("CYCLONEDDS_URI", is_set, NO_PROFILES),
];

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

/// A variable of the environment that makes no sense, or asks for what this node cannot do.
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
    /// `ROS_LOCALHOST_ONLY`. What is unset or empty has ROS' default: domain 0, `SUBNET`. Other variables that
    /// decide who hears whom, as `ROS_DISCOVERY_SERVER`, are told in the [`log`] as warnings.
    ///
    /// # Errors
    /// A variable that ROS would not take, or DDS Security enforced (`ROS_SECURITY_STRATEGY`), which this
    /// node does not have.
    pub fn from_env() -> Result<Self, EnvironmentError> {
        let get = |name| env::var_os(name).map(|value| value.to_string_lossy().into());
        let environment = Self::from_variables(get)?;
        for not_obeyed in not_obeyed(get) {
            log::warn(format_args!("{not_obeyed}"));
        }
        Ok(environment)
    }

    fn from_variables(
        get: impl Fn(&'static str) -> Option<String>,
    ) -> Result<Self, EnvironmentError> {
        // As in rcl, it counts only where security is enabled.
        if get("ROS_SECURITY_ENABLE").is_some_and(|value| value == "true") {
            read(&get, "ROS_SECURITY_STRATEGY", read_strategy)?;
        }
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

/// Returns the variables that this node does not obey, though it matters.
fn not_obeyed(get: impl Fn(&'static str) -> Option<String>) -> Vec<EnvironmentError> {
    let told = |(variable, matters, cure): (&'static str, Matters, &str)| {
        let value = get(variable).filter(|value| matters(value))?;
        Some(EnvironmentError {
            variable,
            value: in_a_line(&value),
            cure: cure.to_owned(),
        })
    };
    NOT_OBEYED.into_iter().filter_map(told).collect()
}

/// Returns the beginning of a value: CYCLONEDDS_URI may be a whole document.
fn in_a_line(value: &str) -> String {
    const LONGEST: usize = 60;
    let end = value.char_indices().nth(LONGEST);
    let (beginning, dots) = end.map_or((value, ""), |(end, _)| (&value[..end], "..."));
    beginning.replace(char::is_control, " ") + dots
}

fn is_set(value: &str) -> bool {
    !value.is_empty()
}

fn read_strategy(value: &str) -> Result<(), String> {
    match value {
        "Enforce" => Err(
            "this node has no DDS Security; unset ROS_SECURITY_ENABLE for it to let it send in \
             clear"
                .to_owned(),
        ),
        _ => Ok(()),
    }
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

    /// Warnings of one variable.
    fn warnings(variable: &str, value: &str) -> Vec<String> {
        let get = |name: &'static str| (name == variable).then(|| value.to_owned());
        let warnings = not_obeyed(get);
        warnings.iter().map(|warning| warning.to_string()).collect()
    }

    #[test]
    fn what_cannot_be_obeyed_is_told_where_it_matters() {
        let told = [
            ("ROS_SECURITY_ENABLE", "true", "DDS Security"),
            ("ROS_DISCOVERY_SERVER", "10.0.0.1:11811", "discovery server"),
            ("ROS_DISCOVERY_SERVER", ";", "discovery server"),
            ("ROS2_EASY_MODE", "10.0.0.1", "discovery server"),
            ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp", "rmw_fastrtps_cpp"),
            ("RMW_IMPLEMENTATION", "rmw_iceoryx_cpp", "rmw_fastrtps_cpp"),
            ("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA", "UDPv4"),
            (
                "FASTDDS_BUILTIN_TRANSPORTS",
                "LARGE_DATA?max_msg_size=1MB",
                "UDPv4",
            ),
            ("FASTDDS_BUILTIN_TRANSPORTS", "SHM", "UDPv4"),
            ("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULTv6", "UDPv4"),
            ("FASTRTPS_DEFAULT_PROFILES_FILE", "wifi.xml", RANGE),
            ("FASTDDS_DEFAULT_PROFILES_FILE", "wifi.xml", RANGE),
            ("CYCLONEDDS_URI", "file:///etc/cyclone.xml", PEERS),
        ];
        for (variable, value, cure) in told {
            let warnings = warnings(variable, value);
            let begins = format!("{variable} is `{value}`: ");
            assert!(
                matches!(&warnings[..], [one] if one.starts_with(&begins) && one.contains(cure)),
                "{warnings:?}"
            );
        }
        let harmless = [
            ("ROS_SECURITY_ENABLE", "True"),
            ("ROS_SECURITY_ENABLE", "1"),
            ("ROS_SECURITY_STRATEGY", "Enforce"),
            ("ROS_DISCOVERY_SERVER", ""),
            ("RMW_IMPLEMENTATION", ""),
            ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
            ("RMW_IMPLEMENTATION", "rmw_fastrtps_dynamic_cpp"),
            ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"),
            ("RMW_IMPLEMENTATION", "rmw_connextdds"),
            ("RMW_IMPLEMENTATION", "rmw_gurumdds_cpp"),
            ("FASTDDS_BUILTIN_TRANSPORTS", ""),
            ("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULT"),
            ("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4?sockets_size=1MB"),
            ("RMW_FASTRTPS_USE_QOS_FROM_XML", "1"),
            ("CYCLONEDDS_URI", ""),
        ];
        for (variable, value) in harmless {
            assert!(warnings(variable, value).is_empty(), "{variable}={value}");
        }
    }

    #[test]
    fn a_document_in_a_variable_is_told_in_a_line() {
        let document = format!("<CycloneDDS>\n  <Domain Id=\"any\">{}", "ä".repeat(60));
        let warnings = warnings("CYCLONEDDS_URI", &document);
        // 33 characters before those that are two bytes long.
        let value = format!("<CycloneDDS>   <Domain Id=\"any\">{}...", "ä".repeat(28));
        assert!(
            warnings[0].starts_with(&format!("CYCLONEDDS_URI is `{value}`: ")),
            "{warnings:?}"
        );
    }

    #[test]
    fn enforced_security_is_refused() {
        const ENABLE: &str = "ROS_SECURITY_ENABLE";
        const STRATEGY: &str = "ROS_SECURITY_STRATEGY";
        assert_eq!(
            read(&[(ENABLE, "true"), (STRATEGY, "Enforce")]),
            Err(
                "ROS_SECURITY_STRATEGY is `Enforce`: this node has no DDS Security; unset \
                 ROS_SECURITY_ENABLE for it to let it send in clear"
                    .to_owned()
            )
        );
        let open = Ok(environment(0, DiscoveryRange::Subnet, &[]));
        for variables in [
            [(ENABLE, "true"), (STRATEGY, "Permissive")],
            [(ENABLE, "true"), (STRATEGY, "enforce")],
            [(ENABLE, "false"), (STRATEGY, "Enforce")],
            [(ENABLE, "TRUE"), (STRATEGY, "Enforce")],
        ] {
            assert_eq!(read(&variables), open);
        }
    }
}
