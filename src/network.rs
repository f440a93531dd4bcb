//! This host's network, as far as it tells why no packets come: its interfaces, and what the kernel
//! drops before any program gets it. Everything is read without privileges.

use std::fs;
use std::io;
use std::net::Ipv4Addr;
use std::path::Path;

use getifaddrs::{Address, InterfaceFilter};

use crate::strangers::Cause;

/// Packets a second that may be a sensor's: the slowest sends 754.
const LEAST_RATE: f64 = 100.0;

/// An interface of this host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Its name.
    pub name: String,
    /// Whether it is switched on.
    pub up: bool,
    /// Whether something is at the other end of the cable; `None` if unknown.
    pub carrier: Option<bool>,
    /// Whether it is a device, rather than one that software made.
    pub is_device: bool,
    /// Addresses and how many of their bits are those of the net.
    pub addresses: Vec<(Ipv4Addr, u8)>,
}

impl Interface {
    /// Whether an address is in one of its nets.
    pub fn reaches(&self, address: Ipv4Addr) -> bool {
        self.addresses.iter().any(|&(own, bits)| {
            let mask = u32::MAX
                .checked_shl(32 - u32::from(bits.min(32)))
                .unwrap_or(0);
            (u32::from(own) ^ u32::from(address)) & mask == 0
        })
    }

    /// What keeps packets from coming in here.
    fn trouble(&self) -> Option<Cause> {
        let name = &self.name;
        if !self.up {
            return Some(Cause {
                what: format!("interface {name} is down"),
                cure: format!("`ip link set {name} up`"),
            });
        }
        (self.carrier == Some(false)).then(|| Cause {
            what: format!("interface {name} has no carrier"),
            cure: "nothing is at the other end of its cable: check the cable, and the power there"
                .to_owned(),
        })
    }
}

/// The interfaces but loopback: those that are up, and those that are down and have a plug.
pub fn interfaces() -> Vec<Interface> {
    let addresses = addresses().unwrap_or_default();
    let entries = fs::read_dir("/sys/class/net")
        .into_iter()
        .flatten()
        .flatten();
    let names = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name != "lo");
    let mut interfaces: Vec<Interface> = names
        .map(|name| {
            let file =
                |what: &str| fs::read_to_string(format!("/sys/class/net/{name}/{what}")).ok();
            let flags = file("flags")
                .and_then(|text| u32::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok());
            let own = addresses.iter().filter(|(interface, _)| *interface == name);
            Interface {
                up: flags.is_some_and(|flags| flags & 1 != 0),
                // Reading it fails while the interface is down.
                carrier: file("carrier").map(|text| text.trim() == "1"),
                is_device: Path::new(&format!("/sys/class/net/{name}/device")).exists(),
                addresses: own.map(|(_, address)| *address).collect(),
                name,
            }
        })
        .filter(|one: &Interface| one.up || one.is_device)
        .collect();
    interfaces.sort_by(|a, b| a.name.cmp(&b.name));
    interfaces
}

/// The IPv4 addresses of this host with their interfaces, and how many bits are those of the net.
fn addresses() -> io::Result<Vec<(String, (Ipv4Addr, u8))>> {
    let mut found = Vec::new();
    for interface in InterfaceFilter::new().v4().get()? {
        if let Address::V4(own) = interface.address
            && let Some(mask) = own.netmask
        {
            let bits = u32::from(mask).count_ones() as u8;
            found.push((interface.name, (own.address, bits)));
        }
    }
    Ok(found)
}

/// What is wrong between this host and a sensor that does not answer: of the interface that it is
/// listened on alone, else of those in its net, else of all.
pub fn wiring(
    interfaces: &[Interface],
    sensor: Option<Ipv4Addr>,
    alone: Option<&str>,
) -> Vec<Cause> {
    // The interfaces, except loopback, say nothing of a sensor on this host.
    if sensor.is_some_and(|sensor| sensor.is_loopback()) {
        return Vec::new();
    }
    let is_on_the_way = |one: &Interface| match (alone, sensor) {
        (Some(alone), _) => one.name == alone,
        (None, Some(sensor)) => one.reaches(sensor),
        (None, None) => true,
    };
    let is_known = interfaces.iter().any(is_on_the_way);
    let mut causes = Vec::new();
    if let Some(sensor) = sensor
        && !interfaces.iter().any(|one| one.reaches(sensor))
    {
        causes.push(Cause {
            what: format!("this host has no address in the net of {sensor}"),
            cure: format!(
                "give the interface at the sensor one, {}",
                an_address(sensor)
            ),
        });
    }
    // Where none is known to be on the way, a cable may be in any.
    let on_the_way = (interfaces.iter()).filter(|one| match is_known {
        true => is_on_the_way(one),
        false => one.is_device,
    });
    causes.extend(on_the_way.filter_map(Interface::trouble));
    causes
}

/// The command that gives this host an address in the net of a sensor.
fn an_address(sensor: Ipv4Addr) -> String {
    let [a, b, c, d] = sensor.octets();
    let other = if d == 100 { 101 } else { 100 };
    format!("such as `ip address add {a}.{b}.{c}.{other}/24 dev INTERFACE`")
}

/// IP packets that this host took in and gave to no program, since it booted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Drops {
    /// By the reverse path filter: there is no route to the sender.
    pub reverse_path: u64,
    /// For no reason that the kernel counts, as by its firewall.
    pub uncounted: u64,
}

impl Drops {
    /// What the kernel has counted so far; `None` where it does not tell.
    pub fn read() -> Option<Self> {
        let snmp = fs::read_to_string("/proc/net/snmp").ok()?;
        let netstat = fs::read_to_string("/proc/net/netstat").ok()?;
        Self::parse(&snmp, &netstat)
    }

    /// From the text of these two files: pairs of lines, names and then numbers.
    fn parse(snmp: &str, netstat: &str) -> Option<Self> {
        let ip = |name| counter(snmp, "Ip:", name);
        let more = |group, name| counter(netstat, group, name).unwrap_or(0);
        let reverse_path = more("TcpExt:", "IPReversePathFilter");
        let mut told = ip("InDelivers")? + reverse_path;
        for name in [
            "InHdrErrors",
            "InAddrErrors",
            "ForwDatagrams",
            "InUnknownProtos",
            "InDiscards",
        ] {
            told += ip(name)?;
        }
        // Fragments that became a part of another packet.
        told += ip("ReasmReqds")?.saturating_sub(ip("ReasmOKs")?);
        told += more("IpExt:", "InNoRoutes") + more("IpExt:", "InTruncatedPkts");
        Some(Self {
            reverse_path,
            uncounted: ip("InReceives")?.saturating_sub(told),
        })
    }

    /// Those since an earlier time.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            reverse_path: self.reverse_path.saturating_sub(earlier.reverse_path),
            uncounted: self.uncounted.saturating_sub(earlier.uncounted),
        }
    }

    /// Whether so many within some seconds that a sensor's packets may be among them, and by what.
    pub fn cause(&self, seconds: f64, sensor: Option<Ipv4Addr>) -> Option<Cause> {
        let is_much = |count: u64| count as f64 / seconds >= LEAST_RATE;
        if is_much(self.reverse_path) {
            let example =
                sensor.map_or(String::new(), |sensor| format!(", {}", an_address(sensor)));
            return Some(Cause {
                what: "this host's reverse path filter drops packets, because it has no route to their sender".to_owned(),
                cure: format!(
                    "give the interface at the sensor an address in the sensor's net{example}; or switch the filter off: \
                     `sysctl -w net.ipv4.conf.all.rp_filter=0 net.ipv4.conf.INTERFACE.rp_filter=0`"
                ),
            });
        }
        is_much(self.uncounted).then(|| Cause {
            what: "this host takes packets in and gives them to no program, as a firewall does".to_owned(),
            cure: "let UDP to the sensor's ports in: as root, `nft list ruleset` or `iptables -L -n` shows the rules"
                .to_owned(),
        })
    }
}

/// A number of a group, by its name.
fn counter(text: &str, group: &str, name: &str) -> Option<u64> {
    let mut lines = text.lines().filter(|line| line.starts_with(group));
    let names = lines.next()?.split_whitespace();
    let numbers = lines.next()?.split_whitespace();
    let mut pairs = names.zip(numbers);
    pairs.find(|(own, _)| *own == name)?.1.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SNMP: &str = "Ip: Forwarding DefaultTTL InReceives InHdrErrors InAddrErrors ForwDatagrams InUnknownProtos \
                        InDiscards InDelivers OutRequests ReasmReqds ReasmOKs\nIp: 2 64 10000 1 2 3 4 5 5000 9 300 100\n";
    const NETSTAT: &str = "TcpExt: SyncookiesSent IPReversePathFilter\nTcpExt: 0 4000\n\
                           IpExt: InNoRoutes InTruncatedPkts\nIpExt: 7 8\n";

    #[test]
    fn what_the_kernel_drops_is_counted_by_whom() {
        let drops = Drops::parse(SNMP, NETSTAT).unwrap();
        let uncounted = 10_000 - 5_000 - 4_000 - 15 - 200 - 15;
        let expected = Drops {
            reverse_path: 4_000,
            uncounted,
        };
        assert_eq!(drops, expected);
        let sensor = Some(Ipv4Addr::new(192, 168, 1, 201));
        let cause = drops.cause(5.0, sensor).unwrap().to_string();
        for part in ["reverse path filter", "192.168.1.100/24", "rp_filter=0"] {
            assert!(cause.contains(part), "{cause}");
        }
        let rest = drops.since(&Drops {
            uncounted: 0,
            ..drops
        });
        let cause = rest.cause(5.0, sensor).unwrap().to_string();
        assert!(
            cause.contains("firewall") && cause.contains("nft list ruleset"),
            "{cause}"
        );
        assert_eq!(rest.cause(60.0, sensor), None);
        assert_eq!(Drops::parse("", NETSTAT), None);
    }

    #[test]
    fn loopback_is_an_address_of_every_host() {
        let found = addresses().unwrap();
        assert!(found.contains(&("lo".to_owned(), (Ipv4Addr::LOCALHOST, 8))));
    }

    #[test]
    fn only_interfaces_on_the_way_are_to_blame() {
        let sensor = Ipv4Addr::new(192, 168, 1, 201);
        let interface = |name: &str, host: [u8; 4], carrier| Interface {
            name: name.to_owned(),
            up: true,
            carrier: Some(carrier),
            is_device: name.starts_with("eth"),
            addresses: vec![(host.into(), 24)],
        };
        let good = interface("eth0", [192, 168, 1, 100], true);
        let bad = interface("eth1", [10, 0, 0, 1], false);
        let both = [good, bad];
        assert_eq!(wiring(&both, Some(sensor), None), []);
        assert!(
            wiring(&both, Some(sensor), Some("eth1"))[0]
                .what
                .contains("eth1 has no carrier")
        );
        let docker = interface("docker0", [172, 17, 0, 1], false);
        let elsewhere = wiring(&[docker, both[1].clone()], Some(sensor), None);
        let whats = elsewhere.iter().map(|cause| &cause.what[..]);
        let expected = [
            "this host has no address in the net of 192.168.1.201",
            "interface eth1 has no carrier",
        ];
        assert!(whats.eq(expected), "{elsewhere:?}");
    }
}
