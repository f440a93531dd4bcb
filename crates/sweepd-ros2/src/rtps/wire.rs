//! Messages of RTPS 2.3 (OMG formal/19-04-03, sections 8.3 and 9.4): ours written, anyone's read.
//!
//! A message is a header and submessages, each with a length of its own. Ours are little-endian;
//! those of others say which they are. Reading never fails as a whole: what makes no sense ends it.

use sweepd_client::host::realtime_ns;

/// The 12 bytes that all entities of one participant share.
pub type Prefix = [u8; 12];

/// An entity of a participant: a number of 3 bytes, and what it is.
pub type EntityId = [u8; 4];

/// No reader in particular: all readers of the participant that gets the message.
pub const ANY_READER: EntityId = [0; 4];
pub const PARTICIPANT: EntityId = [0, 0, 1, 0xc1];
pub const PARTICIPANTS_WRITER: EntityId = [0, 1, 0, 0xc2];
pub const PARTICIPANTS_READER: EntityId = [0, 1, 0, 0xc7];
pub const PUBLICATIONS_WRITER: EntityId = [0, 0, 3, 0xc2];
pub const PUBLICATIONS_READER: EntityId = [0, 0, 3, 0xc7];
pub const SUBSCRIPTIONS_WRITER: EntityId = [0, 0, 4, 0xc2];
pub const SUBSCRIPTIONS_READER: EntityId = [0, 0, 4, 0xc7];

const ACKNACK: u8 = 0x06;
const HEARTBEAT: u8 = 0x07;
const GAP: u8 = 0x08;
const INFO_TIMESTAMP: u8 = 0x09;
const INFO_DESTINATION: u8 = 0x0e;
const NACK_FRAGMENT: u8 = 0x12;
const DATA: u8 = 0x15;
const DATA_FRAGMENT: u8 = 0x16;

const LITTLE_ENDIAN: u8 = 1;
const FINAL: u8 = 2;
const INLINE_QOS: u8 = 2;
const HAS_DATA: u8 = 4;
const HAS_KEY: u8 = 8;

/// Parameters that stand inline, before the payload.
const KEY_HASH: u16 = 0x70;
/// Which request a sample answers; Fast DDS before 3 knows the number in the room of vendors.
const ANSWERS: [u16; 2] = [0x83, 0x800f];
/// Bytes of them, with the end of the list.
const ANSWERS_BYTES: usize = 2 * (4 + 24) + 4;
const STATUS_INFO: u16 = 0x71;
const SENTINEL: u16 = 1;

/// An entity, among all of the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Guid {
    /// Its participant.
    pub prefix: Prefix,
    /// Which of its entities.
    pub entity: EntityId,
}

impl Guid {
    /// That entity of that participant.
    pub fn new(prefix: Prefix, entity: EntityId) -> Self {
        Self { prefix, entity }
    }

    /// The 16 bytes of it.
    pub fn bytes(self) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[..12].copy_from_slice(&self.prefix);
        bytes[12..].copy_from_slice(&self.entity);
        bytes
    }

    /// The entity of these bytes, where they are 16 or more.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let prefix = bytes.get(..12)?.try_into().ok()?;
        Some(Self::new(prefix, bytes.get(12..16)?.try_into().ok()?))
    }
}

/// A moment as RTPS has it: seconds since 1970, and 2^-32 of them.
pub type Timestamp = [u8; 8];

/// The moment that is now.
pub fn now() -> Timestamp {
    let ns = realtime_ns() as u64;
    let fraction = ((ns % 1_000_000_000) << 32) / 1_000_000_000;
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&((ns / 1_000_000_000) as u32).to_le_bytes());
    bytes[4..].copy_from_slice(&(fraction as u32).to_le_bytes());
    bytes
}

/// Numbers from `base` on, at most 256 apart: of samples, or of fragments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NumberSet {
    /// All before it are there, when readers speak of what they miss.
    pub base: u64,
    bits: u32,
    map: [u32; 8],
}

impl NumberSet {
    /// No number.
    pub fn new(base: u64) -> Self {
        Self {
            base,
            bits: 0,
            map: [0; 8],
        }
    }

    /// Adds a number; one that is out of reach is left out.
    pub fn insert(&mut self, number: u64) {
        let Some(bit) = number.checked_sub(self.base).filter(|bit| *bit < 256) else {
            return;
        };
        self.bits = self.bits.max(bit as u32 + 1);
        self.map[bit as usize / 32] |= 1 << (31 - bit % 32);
    }

    /// Whether a number is in it.
    pub fn contains(&self, number: u64) -> bool {
        let bit = number.wrapping_sub(self.base);
        bit < u64::from(self.bits) && self.map[bit as usize / 32] >> (31 - bit % 32) & 1 == 1
    }

    /// The numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u64> + '_ {
        (self.base..self.base + u64::from(self.bits)).filter(|number| self.contains(*number))
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.map == [0; 8]
    }

    fn write(&self, to: &mut Vec<u8>) {
        put_number(to, self.base);
        to.extend(self.bits.to_le_bytes());
        for word in &self.map[..self.bits.div_ceil(32) as usize] {
            to.extend(word.to_le_bytes());
        }
    }

    /// The count of bits stands at `at`; also says where the words end.
    fn read(fields: Fields, base: u64, at: usize) -> Option<(Self, usize)> {
        let mut set = Self::new(base);
        set.bits = fields.u32(at)?;
        if set.bits > 256 {
            return None;
        }
        let words = set.bits.div_ceil(32) as usize;
        for (index, word) in set.map[..words].iter_mut().enumerate() {
            *word = fields.u32(at + 4 + 4 * index)?;
        }
        Some((set, at + 4 + 4 * words))
    }
}

/// Numbers within bytes of someone's choice of byte order.
#[derive(Clone, Copy)]
pub struct Fields<'a> {
    /// The bytes.
    pub bytes: &'a [u8],
    /// Their order.
    pub little_endian: bool,
}

impl<'a> Fields<'a> {
    /// Numbers in these bytes, in that order.
    pub fn new(bytes: &'a [u8], little_endian: bool) -> Self {
        Self {
            bytes,
            little_endian,
        }
    }

    /// Four bytes as they are.
    pub fn array(self, at: usize) -> Option<[u8; 4]> {
        self.bytes.get(at..at.checked_add(4)?)?.try_into().ok()
    }

    /// A number of 16 bits.
    pub fn u16(self, at: usize) -> Option<u16> {
        let bytes = self.bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(match self.little_endian {
            true => u16::from_le_bytes(bytes),
            false => u16::from_be_bytes(bytes),
        })
    }

    /// A number of 32 bits.
    pub fn u32(self, at: usize) -> Option<u32> {
        let bytes = self.array(at)?;
        Some(match self.little_endian {
            true => u32::from_le_bytes(bytes),
            false => u32::from_be_bytes(bytes),
        })
    }

    /// The number of a sample. Those of RTPS are signed: half of the range is never used.
    fn number(self, at: usize) -> Option<u64> {
        let high = u64::from(self.u32(at)?);
        let number = high << 32 | u64::from(self.u32(at + 4)?);
        (number < 1 << 62).then_some(number)
    }

    /// The bytes from `at` on.
    pub fn from(self, at: usize) -> Option<&'a [u8]> {
        self.bytes.get(at..)
    }
}

fn put_number(to: &mut Vec<u8>, number: u64) {
    to.extend(((number >> 32) as u32).to_le_bytes());
    to.extend((number as u32).to_le_bytes());
}

/// What a writer still has, told to readers: they ask for what they miss of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The oldest sample.
    pub first: u64,
    /// The newest; one less than `first` where there is none.
    pub last: u64,
    /// Higher in each heartbeat of a writer.
    pub count: u32,
}

/// Acknowledgement of a writer's samples by a reader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ack {
    /// Numbers that it misses; it has all before the base.
    pub missing: NumberSet,
    /// Final: it asks for no answer. If not, the writer must send a heartbeat (section 8.3.7.1).
    pub is_final: bool,
}

/// Between whom a sample goes, and which it is.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// [`ANY_READER`], or one.
    pub reader: EntityId,
    /// Whose sample it is.
    pub writer: EntityId,
    /// Its number.
    pub number: u64,
}

impl Route {
    fn write(self, to: &mut Vec<u8>) {
        to.extend(self.reader);
        to.extend(self.writer);
        put_number(to, self.number);
    }
}

/// A sample, among all of the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleId {
    /// Whose it is.
    pub writer: Guid,
    /// Its number.
    pub number: u64,
}

/// A message that grows by submessages.
pub struct Message(Vec<u8>);

impl Message {
    /// A header alone.
    pub fn new(source: Prefix) -> Self {
        let mut bytes = Vec::with_capacity(256);
        bytes.extend(b"RTPS");
        // Version 2.3, and the vendor that all peers take for unknown.
        bytes.extend([2, 3, 0, 0]);
        bytes.extend(source);
        Self(bytes)
    }

    /// No header: submessages that go behind others.
    pub fn empty() -> Self {
        Self(vec![])
    }

    /// A message to one participant.
    pub fn to(source: Prefix, destination: Prefix) -> Self {
        let mut message = Self::new(source);
        message.destination(destination);
        message
    }

    /// All of it so far.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    fn begin(&mut self, kind: u8, flags: u8, body: usize) {
        self.0.extend([kind, flags | LITTLE_ENDIAN]);
        // At most a fragment, which is shorter than a datagram.
        self.0.extend((body as u16).to_le_bytes());
    }

    /// What follows is for one participant only.
    pub fn destination(&mut self, prefix: Prefix) {
        self.begin(INFO_DESTINATION, 0, 12);
        self.0.extend(prefix);
    }

    /// What follows is of that moment.
    pub fn timestamp(&mut self, moment: Timestamp) {
        self.begin(INFO_TIMESTAMP, 0, 8);
        self.0.extend(moment);
    }

    /// What comes before a sample of `bytes`, a multiple of 4, which the caller puts behind it.
    pub fn data(&mut self, route: Route, answers: Option<SampleId>, bytes: usize) {
        let (flag, inline) = inline_bytes(answers);
        self.begin(DATA, HAS_DATA | flag, 20 + inline + bytes);
        self.0.extend([0, 0, 16, 0]);
        route.write(&mut self.0);
        self.answers(answers);
    }

    /// Parameters that stand inline.
    fn inline(&mut self, parameters: &[(u16, &[u8])]) {
        for (parameter, value) in parameters.iter().chain(&[(SENTINEL, &[][..])]) {
            self.0.extend(parameter.to_le_bytes());
            self.0.extend((value.len() as u16).to_le_bytes());
            self.0.extend(*value);
        }
    }

    fn answers(&mut self, answers: Option<SampleId>) {
        if let Some(request) = answers {
            let mut value = request.writer.bytes().to_vec();
            put_number(&mut value, request.number);
            self.inline(&ANSWERS.map(|parameter| (parameter, value.as_slice())));
        }
    }

    /// What comes before the key of a thing that is no more.
    pub fn disposal(&mut self, route: Route, key: Guid, bytes: usize) {
        self.begin(DATA, INLINE_QOS | HAS_KEY, 20 + 32 + bytes);
        self.0.extend([0, 0, 16, 0]);
        route.write(&mut self.0);
        self.inline(&[
            (KEY_HASH, key.bytes().as_slice()),
            // Disposed, and unregistered.
            (STATUS_INFO, &[0, 0, 0, 3]),
        ]);
    }

    /// What comes before `bytes` of a sample in fragments: the one of that number, from 1.
    pub fn fragment(
        &mut self,
        route: Route,
        answers: Option<SampleId>,
        (fragment, of): (u32, Fragments),
        bytes: usize,
    ) {
        let (flag, inline) = inline_bytes(answers);
        self.begin(DATA_FRAGMENT, flag, 32 + inline + bytes);
        self.0.extend([0, 0, 28, 0]);
        route.write(&mut self.0);
        self.0.extend(fragment.to_le_bytes());
        self.0.extend(1u16.to_le_bytes());
        self.0.extend((of.fragment_bytes as u16).to_le_bytes());
        self.0.extend((of.sample_bytes as u32).to_le_bytes());
        self.answers(answers);
    }

    /// Bytes of a sample behind what came before it.
    pub fn payload(&mut self, bytes: &[u8]) {
        self.0.extend(bytes);
    }

    /// Asks the readers to say what they miss.
    pub fn heartbeat(&mut self, reader: EntityId, writer: EntityId, heartbeat: Heartbeat) {
        self.begin(HEARTBEAT, 0, 28);
        self.0.extend(reader);
        self.0.extend(writer);
        put_number(&mut self.0, heartbeat.first);
        put_number(&mut self.0, heartbeat.last);
        self.0.extend(heartbeat.count.to_le_bytes());
    }

    /// Adds what our reader has of a writer.
    pub fn acknack(&mut self, reader: EntityId, writer: EntityId, ack: &Ack, count: u32) {
        let words = ack.missing.bits.div_ceil(32) as usize;
        let flags = if ack.is_final { FINAL } else { 0 };
        self.begin(ACKNACK, flags, 24 + 4 * words);
        self.0.extend(reader);
        self.0.extend(writer);
        ack.missing.write(&mut self.0);
        self.0.extend(count.to_le_bytes());
    }

    /// The samples from `first` to the one before `end` will never come.
    pub fn gap(&mut self, reader: EntityId, writer: EntityId, first: u64, end: u64) {
        self.begin(GAP, 0, 28);
        self.0.extend(reader);
        self.0.extend(writer);
        put_number(&mut self.0, first);
        NumberSet::new(end).write(&mut self.0);
    }
}

/// The flag, and the bytes, of what stands inline in an answer.
fn inline_bytes(answers: Option<SampleId>) -> (u8, usize) {
    answers.map_or((0, 0), |_| (INLINE_QOS, ANSWERS_BYTES))
}

/// How a sample is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fragments {
    /// Bytes of each but the last.
    pub fragment_bytes: usize,
    /// Bytes of all.
    pub sample_bytes: usize,
}

impl Fragments {
    /// How many there are: one at least.
    pub fn count(self) -> u32 {
        self.sample_bytes.div_ceil(self.fragment_bytes).max(1) as u32
    }

    /// The bytes of one, counted from 1; none behind the last.
    pub fn part(self, sample: &[u8], number: u32) -> &[u8] {
        let index = (number as usize).saturating_sub(1);
        let part = sample.chunks(self.fragment_bytes).nth(index);
        part.unwrap_or_default()
    }
}

/// Fragments of a sample that follow one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// The first of them, counted from 1.
    pub first: u32,
    /// How many.
    pub count: u32,
    /// Of which sample.
    pub of: Fragments,
}

impl Part {
    /// All of a sample that is not cut.
    pub fn all(bytes: usize) -> Self {
        Self {
            first: 1,
            count: 1,
            of: Fragments {
                fragment_bytes: bytes,
                sample_bytes: bytes,
            },
        }
    }

    /// Their bytes, without padding; none where they do not fit the sample or the payload.
    pub fn bytes(self, payload: &[u8]) -> Option<&[u8]> {
        let at = (self.first.checked_sub(1)? as usize).checked_mul(self.of.fragment_bytes)?;
        let left = self.of.sample_bytes.checked_sub(at)?;
        let bytes = (self.count as usize).checked_mul(self.of.fragment_bytes)?;
        payload.get(..bytes.min(left))
    }
}

/// A sample, or a part of one: something new, or the end of something.
#[derive(Debug, PartialEq)]
pub struct Data<'a> {
    /// [`ANY_READER`], or one.
    pub reader: EntityId,
    /// Whose sample it is.
    pub writer: EntityId,
    /// Its number.
    pub number: u64,
    /// What it is about, where that stands inline.
    pub key: Option<Guid>,
    /// That is no more.
    pub disposed: bool,
    /// What of the sample the payload is; none for all.
    pub part: Option<Part>,
    /// Its bytes, which may have padding behind them.
    pub payload: &'a [u8],
}

/// A submessage that we have use for.
#[derive(Debug, PartialEq)]
pub enum Submessage<'a> {
    /// A sample.
    Data(Data<'a>),
    /// What a writer has.
    Heartbeat {
        reader: EntityId,
        writer: EntityId,
        first: u64,
        last: u64,
    },
    /// What a writer will never send: from `first` to before the base of `more`, and `more`.
    Gap {
        reader: EntityId,
        writer: EntityId,
        first: u64,
        more: NumberSet,
    },
    /// Acknowledgement of a reader.
    AckNack {
        reader: EntityId,
        writer: EntityId,
        ack: Ack,
    },
    /// Which fragments of a sample a reader misses.
    NackFragment {
        reader: EntityId,
        writer: EntityId,
        number: u64,
        missing: NumberSet,
    },
}

impl Submessage<'_> {
    /// Whether its sender says what it has of a writer of ours.
    pub fn acknowledges(&self) -> bool {
        matches!(self, Self::AckNack { .. } | Self::NackFragment { .. })
    }
}

/// The submessages of a datagram that are for a participant.
pub struct Submessages<'a> {
    /// Who sent it.
    pub source: Prefix,
    /// It names us as who is to get the next submessage: its sender has heard from us.
    pub names_us: bool,
    own: Prefix,
    for_us: bool,
    rest: &'a [u8],
}

/// Opens a datagram; none where it is no RTPS, or our own.
pub fn read(datagram: &[u8], own: Prefix) -> Option<Submessages<'_>> {
    let source = datagram.get(8..20)?.try_into().ok()?;
    if !datagram.starts_with(b"RTPS\x02") || source == own {
        return None;
    }
    Some(Submessages {
        source,
        names_us: false,
        own,
        for_us: true,
        rest: &datagram[20..],
    })
}

impl<'a> Iterator for Submessages<'a> {
    type Item = Submessage<'a>;

    fn next(&mut self) -> Option<Submessage<'a>> {
        while let [kind, flags, _, _, ..] = *self.rest {
            let little_endian = flags & LITTLE_ENDIAN != 0;
            let header = Fields::new(self.rest, little_endian);
            let length = usize::from(header.u16(2)?);
            // Zero says: to the end of the datagram. Padding and a time that is none may be empty.
            let to_the_end = length == 0 && !matches!(kind, 0x01 | INFO_TIMESTAMP);
            let length = if to_the_end {
                self.rest.len() - 4
            } else {
                length
            };
            let body = self.rest.get(4..4 + length)?;
            self.rest = &self.rest[4 + length..];
            if kind == INFO_DESTINATION {
                let prefix = body.get(..12)?;
                self.names_us = prefix == self.own;
                self.for_us = self.names_us || prefix == [0; 12];
            } else if self.for_us {
                let fields = Fields::new(body, little_endian);
                if let Some(submessage) = read_submessage(kind, flags, fields) {
                    return Some(submessage);
                }
            }
        }
        None
    }
}

fn read_submessage(kind: u8, flags: u8, fields: Fields) -> Option<Submessage> {
    let [first_entity, second_entity] = [fields.array(0)?, fields.array(4)?];
    match kind {
        DATA | DATA_FRAGMENT => read_data(kind, flags, fields),
        HEARTBEAT => {
            let (first, last) = (fields.number(8)?, fields.number(16)?);
            // An empty history says that its last is one before its first.
            (first >= 1 && last + 1 >= first).then_some(Submessage::Heartbeat {
                reader: first_entity,
                writer: second_entity,
                first,
                last,
            })
        }
        GAP => {
            let more = NumberSet::read(fields, fields.number(16)?, 24)?.0;
            Some(Submessage::Gap {
                reader: first_entity,
                writer: second_entity,
                first: fields.number(8)?,
                more,
            })
        }
        ACKNACK => Some(Submessage::AckNack {
            reader: first_entity,
            writer: second_entity,
            ack: Ack {
                missing: NumberSet::read(fields, fields.number(8)?, 16)?.0,
                is_final: flags & FINAL != 0,
            },
        }),
        NACK_FRAGMENT => {
            let base = u64::from(fields.u32(16)?);
            Some(Submessage::NackFragment {
                reader: first_entity,
                writer: second_entity,
                number: fields.number(8)?,
                missing: NumberSet::read(fields, base, 20)?.0,
            })
        }
        _ => None,
    }
}

fn read_data(kind: u8, flags: u8, fields: Fields) -> Option<Submessage> {
    let part = match kind {
        DATA_FRAGMENT => Some(Part {
            first: fields.u32(20)?,
            count: fields.u16(24)?.into(),
            of: Fragments {
                fragment_bytes: fields.u16(26)?.into(),
                sample_bytes: fields.u32(28)? as usize,
            },
        }),
        _ => None,
    };
    let mut at = 4 + usize::from(fields.u16(2)?);
    let mut key = None;
    let mut disposed = false;
    if flags & INLINE_QOS != 0 {
        loop {
            let (parameter, length) = (fields.u16(at)?, usize::from(fields.u16(at + 2)?));
            let value = fields.bytes.get(at + 4..at + 4 + length);
            at += 4;
            match parameter {
                SENTINEL => break,
                KEY_HASH => key = Guid::read(value?),
                STATUS_INFO => disposed = value?.get(3)? & 3 != 0,
                _ => {}
            }
            at += length;
        }
    }
    let has_payload = part.is_some() || flags & (HAS_DATA | HAS_KEY) != 0;
    Some(Submessage::Data(Data {
        reader: fields.array(4)?,
        writer: fields.array(8)?,
        number: fields.number(12)?,
        key,
        disposed,
        part,
        payload: if has_payload { fields.from(at)? } else { &[] },
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: Prefix = [1; 12];
    const THEIRS: Prefix = [2; 12];
    const READER: EntityId = [0, 0, 1, 4];
    const WRITER: EntityId = [0, 0, 2, 3];

    /// The bytes behind the header, from hexadecimal digits as the specification draws them.
    fn behind_header(message: &Message, expected: &str) {
        let digits: Vec<String> = message.bytes()[20..]
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(digits.join(" "), expected);
    }

    fn route() -> Route {
        Route {
            reader: READER,
            writer: WRITER,
            number: 0x1_0000_0002,
        }
    }

    #[test]
    fn messages_have_the_bytes_of_the_specification() {
        let header = Message::new(OURS);
        assert_eq!(
            header.bytes(),
            b"RTPS\x02\x03\0\0\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01"
        );

        let mut data = Message::to(OURS, THEIRS);
        data.timestamp([5, 0, 0, 0, 0, 0, 0, 0x80]);
        data.data(route(), None, 8);
        behind_header(
            &data,
            "0e 01 0c 00 02 02 02 02 02 02 02 02 02 02 02 02 \
             09 01 08 00 05 00 00 00 00 00 00 80 \
             15 05 1c 00 00 00 10 00 00 00 01 04 00 00 02 03 01 00 00 00 02 00 00 00",
        );

        let mut fragment = Message::new(OURS);
        let of = Fragments {
            fragment_bytes: 63_000,
            sample_bytes: 126_004,
        };
        assert_eq!(of.count(), 3);
        fragment.fragment(route(), None, (3, of), 4);
        behind_header(
            &fragment,
            "16 01 24 00 00 00 1c 00 00 00 01 04 00 00 02 03 01 00 00 00 02 00 00 00 \
             03 00 00 00 01 00 18 f6 34 ec 01 00",
        );

        let request = SampleId {
            writer: Guid::new(THEIRS, WRITER),
            number: 5,
        };
        let mut answer = Message::new(OURS);
        answer.data(route(), Some(request), 4);
        let identity = "02 02 02 02 02 02 02 02 02 02 02 02 00 00 02 03 00 00 00 00 05 00 00 00";
        behind_header(
            &answer,
            &format!(
                "15 07 54 00 00 00 10 00 00 00 01 04 00 00 02 03 01 00 00 00 02 00 00 00 \
                 83 00 18 00 {identity} 0f 80 18 00 {identity} 01 00 00 00"
            ),
        );

        let mut heartbeat = Message::new(OURS);
        let has = Heartbeat {
            first: 4,
            last: 8,
            count: 9,
        };
        heartbeat.heartbeat(READER, WRITER, has);
        behind_header(
            &heartbeat,
            "07 01 1c 00 00 00 01 04 00 00 02 03 00 00 00 00 04 00 00 00 \
             00 00 00 00 08 00 00 00 09 00 00 00",
        );

        let mut gap = Message::new(OURS);
        gap.gap(READER, WRITER, 1, 4);
        behind_header(
            &gap,
            "08 01 1c 00 00 00 01 04 00 00 02 03 00 00 00 00 01 00 00 00 \
             00 00 00 00 04 00 00 00 00 00 00 00",
        );

        // Section 9.4.2.6: 1234:/12:00110 is what misses 1236 and 1237.
        let mut missing = NumberSet::new(1234);
        missing.insert(1236);
        missing.insert(1237);
        let mut acknack = Message::new(OURS);
        let is_final = false;
        acknack.acknack(READER, WRITER, &Ack { missing, is_final }, 1);
        behind_header(
            &acknack,
            "06 01 1c 00 00 00 01 04 00 00 02 03 00 00 00 00 d2 04 00 00 \
             04 00 00 00 00 00 00 30 01 00 00 00",
        );

        let mut end = Message::new(OURS);
        let key = Guid::new(OURS, WRITER);
        end.disposal(route(), key, 0);
        behind_header(
            &end,
            "15 0b 34 00 00 00 10 00 00 00 01 04 00 00 02 03 01 00 00 00 02 00 00 00 \
             70 00 10 00 01 01 01 01 01 01 01 01 01 01 01 01 00 00 02 03 \
             71 00 04 00 00 00 00 03 01 00 00 00",
        );
    }

    #[test]
    fn either_byte_order_is_read() {
        let mut datagram = Message::new(THEIRS).bytes().to_vec();
        // For another participant, then for us, big-endian, to the end of the datagram.
        datagram.extend([0x0e, 1, 12, 0, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3]);
        datagram.extend([0x07, 0, 0, 28]);
        datagram.extend([0; 28]);
        datagram.extend([0x0e, 0, 0, 12, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]);
        datagram.extend([0x07, 0, 0, 0]);
        datagram.extend([READER, WRITER, [0, 0, 0, 1], [0, 0, 0, 2]].concat());
        datagram.extend([0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, 7]);
        let read: Vec<Submessage> = read(&datagram, OURS).unwrap().collect();
        let expected = Submessage::Heartbeat {
            reader: READER,
            writer: WRITER,
            first: 0x1_0000_0002,
            last: 0x1_0000_0003,
        };
        assert_eq!(read, [expected]);
    }

    #[test]
    fn what_we_write_is_what_others_read() {
        let mut missing = NumberSet::new(10);
        for number in [10, 41, 42, 265, 266, 9] {
            missing.insert(number);
        }
        assert!(missing.iter().eq([10, 41, 42, 265]));
        for is_final in [false, true] {
            let mut message = Message::new(THEIRS);
            let missing = missing.clone();
            let ack = Ack { missing, is_final };
            message.acknack(READER, WRITER, &ack, 1);
            let read: Vec<Submessage> = read(message.bytes(), OURS).unwrap().collect();
            let expected = Submessage::AckNack {
                reader: READER,
                writer: WRITER,
                ack,
            };
            assert_eq!(read, [expected]);
            assert!(super::read(message.bytes(), THEIRS).is_none());
        }
    }
}
