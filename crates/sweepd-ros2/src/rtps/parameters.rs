//! Parameter lists (section 9.4.2.11): what participants and endpoints say of themselves.

use super::wire::{Fields, Guid};
use std::net::{Ipv4Addr, SocketAddrV4};

pub const PARTICIPANT_LEASE: u16 = 0x02;
pub const TOPIC_NAME: u16 = 0x05;
pub const TYPE_NAME: u16 = 0x07;
pub const PROTOCOL_VERSION: u16 = 0x15;
pub const VENDOR_ID: u16 = 0x16;
pub const RELIABILITY: u16 = 0x1a;
pub const LIVELINESS: u16 = 0x1b;
pub const DURABILITY: u16 = 0x1d;
pub const OWNERSHIP: u16 = 0x1f;
pub const DEADLINE: u16 = 0x23;
pub const USER_DATA: u16 = 0x2c;
pub const UNICAST_LOCATOR: u16 = 0x2f;
pub const DEFAULT_LOCATOR: u16 = 0x31;
pub const LIFESPAN: u16 = 0x2b;
pub const METATRAFFIC_LOCATOR: u16 = 0x32;
pub const HISTORY: u16 = 0x40;
pub const PARTICIPANT_GUID: u16 = 0x50;
pub const BUILTIN_ENDPOINTS: u16 = 0x58;
pub const ENDPOINT_GUID: u16 = 0x5a;
pub const ENTITY_NAME: u16 = 0x62;
const SENTINEL: u16 = 1;

/// Set where one must understand the parameter. The bit above it marks those of vendors: 0x8007 is
/// not 0x07.
const MUST_UNDERSTAND: u16 = 0x4000;

/// A kind of locator: UDP over IPv4.
const UDP_V4: u32 = 1;

/// Longest name that is read from others: those of ROS have at most 255 bytes.
const LONGEST_NAME_BYTES: usize = 300;

/// A list that grows.
pub struct ParameterList(Vec<u8>);

impl ParameterList {
    /// Nothing but the encapsulation: parameter list, little-endian.
    pub fn new() -> Self {
        Self(vec![0, 3, 0, 0])
    }

    /// Adds bytes as they are.
    pub fn put(&mut self, parameter: u16, value: &[u8]) {
        let length = value.len().next_multiple_of(4);
        self.0.extend(parameter.to_le_bytes());
        self.0.extend((length as u16).to_le_bytes());
        self.0.extend(value);
        self.0.resize(self.0.len() + length - value.len(), 0);
    }

    /// Adds numbers of 32 bits.
    pub fn numbers(&mut self, parameter: u16, values: &[u32]) {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.put(parameter, &bytes);
    }

    /// Adds a text, which ends in a zero.
    pub fn string(&mut self, parameter: u16, text: &str) {
        let mut bytes = (text.len() as u32 + 1).to_le_bytes().to_vec();
        bytes.extend(text.as_bytes());
        bytes.push(0);
        self.put(parameter, &bytes);
    }

    /// Adds bytes with their count before them.
    pub fn octets(&mut self, parameter: u16, octets: &[u8]) {
        let mut bytes = (octets.len() as u32).to_le_bytes().to_vec();
        bytes.extend(octets);
        self.put(parameter, &bytes);
    }

    /// Adds a place to send to.
    pub fn locator(&mut self, parameter: u16, place: SocketAddrV4) {
        let mut bytes = UDP_V4.to_le_bytes().to_vec();
        bytes.extend(u32::from(place.port()).to_le_bytes());
        bytes.extend([0; 12]);
        bytes.extend(place.ip().octets());
        self.put(parameter, &bytes);
    }

    /// The list with its end.
    pub fn end(mut self) -> Vec<u8> {
        self.put(SENTINEL, &[]);
        self.0
    }
}

/// Whether these bytes of a sample are in an order that a list can have.
fn little_endian(payload: &[u8]) -> Option<bool> {
    match payload.get(..2)? {
        [0, 2] => Some(false),
        [0, 3] => Some(true),
        _ => None,
    }
}

/// The parameters of a list; none where it is no list. Those behind the first that makes no sense
/// are left out.
pub fn read(payload: &[u8]) -> Option<impl Iterator<Item = (u16, Fields<'_>)>> {
    let little_endian = little_endian(payload)?;
    let list = Fields::new(payload, little_endian);
    let mut at = 4;
    Some(std::iter::from_fn(move || {
        let parameter = list.u16(at)? & !MUST_UNDERSTAND;
        let length = usize::from(list.u16(at + 2)?);
        let bytes = payload.get(at + 4..at + 4 + length)?;
        at += 4 + length;
        let value = Fields::new(bytes, little_endian);
        (parameter != SENTINEL).then_some((parameter, value))
    }))
}

/// A place to send to, where it is one of UDP over IPv4 that can be sent to.
pub fn locator(value: Fields) -> Option<SocketAddrV4> {
    let port = u16::try_from(value.u32(4)?).ok()?;
    let address = Ipv4Addr::from(value.array(20)?);
    let usable = value.u32(0)? == UDP_V4
        && port != 0
        && !address.is_unspecified()
        && !address.is_multicast()
        && !address.is_broadcast();
    usable.then_some(SocketAddrV4::new(address, port))
}

/// A name; none where it is longer than those of ROS are.
pub fn name(value: Fields) -> Option<String> {
    let length = usize::try_from(value.u32(0)?).ok()?.checked_sub(1)?;
    if length > LONGEST_NAME_BYTES {
        return None;
    }
    let bytes = value.from(4)?.get(..length)?;
    Some(std::str::from_utf8(bytes).ok()?.to_owned())
}

/// Whether user data, as `typehash=...;`, has a key.
pub fn user_data_has(value: Fields, key: &[u8]) -> bool {
    value.bytes.windows(key.len()).any(|part| part == key)
}

/// The GUID that a list names.
pub fn guid(payload: &[u8], parameter: u16) -> Option<Guid> {
    let (_, value) = read(payload)?.find(|(found, _)| *found == parameter)?;
    Guid::read(value.bytes)
}
