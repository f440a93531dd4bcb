//! What goes over the socket, as bytes and back. All numbers are little-endian.
//!
//! ```text
//! client   hello     "sweeptap"  version u16  length u16  name of the sensor
//! daemon   answer    "sweeptap"  version u16  status u16  length u16  text
//! daemon   datagram  1 u16  length u16  ports of source and destination u16  addresses of both 4 bytes
//!                    arrival i64, nanoseconds since 1970  payload
//! daemon   end       2 u16  length u16 = 8  zeroes  lost u64
//! ```
//!
//! After the hello a client sends nothing; that it shuts its side down asks for the end. After the
//! answer come datagrams and one end, which says how many found no room on the way. A connection
//! that breaks off without it was not ended but lost.

use std::io::{self, Read};
use std::net::{Ipv4Addr, SocketAddrV4};

use zerocopy::byteorder::little_endian::{I64, U16, U64};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use crate::capture::write::Addressed;

const MAGIC: [u8; 8] = *b"sweeptap";
/// Version of all that is here.
pub(super) const VERSION: u16 = 1;
/// Longest name of a sensor, bytes.
pub(super) const MAX_NAME_LEN: usize = 255;
/// Longest text of an answer, bytes.
pub(super) const MAX_TEXT_LEN: usize = 4096;
/// Longest payload of a UDP datagram, bytes.
const MAX_PAYLOAD_LEN: usize = 65_507;
/// Latest arrival that a capture can tell, nanoseconds since 1970.
const MAX_ARRIVAL_NS: i64 = u32::MAX as i64 * 1_000_000_000 + 999_999_999;
/// Bytes that are read at once; more than any datagram has.
const READ_LEN: usize = 256 << 10;

/// What does not follow the format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct WireError(String);

/// Refuses what it is `unless`.
fn check(holds: bool, what: impl FnOnce() -> String) -> Result<(), WireError> {
    if holds {
        Ok(())
    } else {
        Err(WireError(what()))
    }
}

#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
struct HelloHead {
    magic: [u8; 8],
    version: U16,
    len: U16,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
struct AnswerHead {
    magic: [u8; 8],
    version: U16,
    status: U16,
    len: U16,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
struct FrameHead {
    kind: U16,
    len: U16,
    source_port: U16,
    destination_port: U16,
    source: [u8; 4],
    destination: [u8; 4],
    arrival_ns: I64,
}

const DATAGRAM: u16 = 1;
const END: u16 = 2;
/// Bytes that the end has.
pub(super) const END_LEN: usize = size_of::<FrameHead>() + size_of::<U64>();

/// Whether bytes may go on to begin with the magic: what cannot is refused at once.
fn begins(bytes: &[u8]) -> bool {
    bytes
        .iter()
        .zip(MAGIC)
        .all(|(&byte, expected)| byte == expected)
}

/// The hello of a client.
pub(super) fn hello(sensor: &str) -> Vec<u8> {
    let len = U16::new(sensor.len().min(MAX_NAME_LEN) as u16);
    let head = HelloHead {
        magic: MAGIC,
        version: VERSION.into(),
        len,
    };
    [
        head.as_bytes(),
        &sensor.as_bytes()[..usize::from(len.get())],
    ]
    .concat()
}

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Hello {
    /// Not all of it has come yet.
    Incomplete,
    /// It speaks another version.
    OtherVersion,
    /// It wants this sensor.
    Sensor(String),
}

impl Hello {
    /// Reads the bytes that have come so far.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        check(begins(bytes), || "no hello".to_owned())?;
        let Ok((head, rest)) = HelloHead::ref_from_prefix(bytes) else {
            return Ok(Self::Incomplete);
        };
        if head.version.get() != VERSION {
            return Ok(Self::OtherVersion);
        }
        let len = usize::from(head.len.get());
        check((1..=MAX_NAME_LEN).contains(&len), || {
            format!("a name of {len} bytes")
        })?;
        check(rest.len() <= len, || "more than a hello".to_owned())?;
        if rest.len() < len {
            return Ok(Self::Incomplete);
        }
        let name = std::str::from_utf8(rest)
            .map_err(|_| WireError("a name that is no text".to_owned()))?;
        Ok(Self::Sensor(name.to_owned()))
    }
}

/// Whether a client gets what it asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(super) enum Status {
    /// Datagrams follow.
    Granted = 0,
    /// There is no such sensor; the text says which there are.
    UnknownSensor = 1,
    /// There are as many clients as there may be.
    Busy = 2,
    /// The daemon speaks another version.
    OtherVersion = 3,
    /// The daemon is of another user, whose name the text is.
    OtherUser = 4,
}

/// The answer of the daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Answer {
    pub(super) version: u16,
    pub(super) status: Status,
    pub(super) text: String,
}

impl Answer {
    pub(super) fn new(status: Status, text: &str) -> Self {
        let end = text.floor_char_boundary(MAX_TEXT_LEN);
        Self {
            version: VERSION,
            status,
            text: text[..end].to_owned(),
        }
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let (version, status) = (self.version.into(), (self.status as u16).into());
        let head = AnswerHead {
            magic: MAGIC,
            version,
            status,
            len: (self.text.len() as u16).into(),
        };
        [head.as_bytes(), self.text.as_bytes()].concat()
    }

    /// Reads an answer, and of what follows nothing.
    pub(super) fn read(from: &mut impl Read) -> io::Result<Result<Self, WireError>> {
        let mut head = [0; size_of::<AnswerHead>()];
        from.read_exact(&mut head)?;
        let head: AnswerHead = zerocopy::transmute!(head);
        let (version, len) = (head.version.get(), usize::from(head.len.get()));
        if !begins(&head.magic) || len > MAX_TEXT_LEN {
            return Ok(Err(WireError("no answer of a daemon".to_owned())));
        }
        let mut text = vec![0; len];
        from.read_exact(&mut text)?;
        let statuses = [
            Status::Granted,
            Status::UnknownSensor,
            Status::Busy,
            Status::OtherVersion,
            Status::OtherUser,
        ];
        let status = match statuses
            .into_iter()
            .find(|&status| status as u16 == head.status.get())
        {
            Some(status) => status,
            None if version != VERSION => Status::OtherVersion,
            None => {
                return Ok(Err(WireError(format!(
                    "an answer with status {}",
                    head.status
                ))));
            }
        };
        Ok(Ok(Self {
            version,
            status,
            text: String::from_utf8_lossy(&text).into_owned(),
        }))
    }
}

/// What the daemon sends after its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frame<'a> {
    Datagram(Addressed<'a>),
    /// Nothing follows.
    End {
        /// Datagrams that found no room.
        lost: u64,
    },
}

impl<'a> Frame<'a> {
    /// Its bytes, in two parts: all but the payload, and the payload. `None` for what no capture
    /// can tell.
    pub(super) fn parts(
        datagram: &Addressed<'a>,
    ) -> Option<([u8; size_of::<FrameHead>()], &'a [u8])> {
        let &Addressed {
            arrival_ns,
            source,
            destination,
            payload,
        } = datagram;
        let fits = payload.len() <= MAX_PAYLOAD_LEN && (0..=MAX_ARRIVAL_NS).contains(&arrival_ns);
        let head = FrameHead {
            kind: DATAGRAM.into(),
            len: (payload.len() as u16).into(),
            source_port: source.port().into(),
            destination_port: destination.port().into(),
            source: source.ip().octets(),
            destination: destination.ip().octets(),
            arrival_ns: arrival_ns.into(),
        };
        fits.then(|| (zerocopy::transmute!(head), payload))
    }

    /// The bytes of the end.
    pub(super) fn end(lost: u64) -> [u8; END_LEN] {
        let mut bytes = [0; END_LEN];
        bytes[..2].copy_from_slice(&END.to_le_bytes());
        bytes[2..4].copy_from_slice(&(size_of::<U64>() as u16).to_le_bytes());
        bytes[size_of::<FrameHead>()..].copy_from_slice(&lost.to_le_bytes());
        bytes
    }
}

impl FrameHead {
    fn check(&self) -> Result<(), WireError> {
        let (kind, len, arrival_ns) = (
            self.kind.get(),
            usize::from(self.len.get()),
            self.arrival_ns.get(),
        );
        let (is_datagram, is_end) = (kind == DATAGRAM, kind == END);
        check(is_datagram || is_end, || {
            format!("something of kind {kind}")
        })?;
        check(!is_end || len == size_of::<U64>(), || {
            format!("an end of {len} bytes")
        })?;
        check(!is_datagram || len <= MAX_PAYLOAD_LEN, || {
            format!("a datagram of {len} bytes")
        })?;
        check((0..=MAX_ARRIVAL_NS).contains(&arrival_ns), || {
            format!("an arrival at {arrival_ns} ns")
        })
    }

    fn frame<'a>(&self, payload: &'a [u8]) -> Frame<'a> {
        match payload.first_chunk() {
            Some(lost) if self.kind.get() == END => Frame::End {
                lost: u64::from_le_bytes(*lost),
            },
            _ => Frame::Datagram(Addressed {
                arrival_ns: self.arrival_ns.get(),
                source: SocketAddrV4::new(Ipv4Addr::from(self.source), self.source_port.get()),
                destination: SocketAddrV4::new(
                    Ipv4Addr::from(self.destination),
                    self.destination_port.get(),
                ),
                payload,
            }),
        }
    }
}

/// Puts frames together from what is read, in memory taken once.
#[derive(Debug)]
pub(super) struct Frames {
    bytes: Box<[u8]>,
    /// What has come and was not given out.
    begin: usize,
    end: usize,
}

impl Frames {
    pub(super) fn new() -> Self {
        Self {
            bytes: vec![0; READ_LEN].into(),
            begin: 0,
            end: 0,
        }
    }

    /// Reads what there is, once; 0 at the end. All frames that are whole have to be taken before.
    pub(super) fn read(&mut self, from: &mut impl Read) -> io::Result<usize> {
        self.bytes.copy_within(self.begin..self.end, 0);
        (self.begin, self.end) = (0, self.end - self.begin);
        let count = from.read(&mut self.bytes[self.end..])?;
        self.end += count;
        Ok(count)
    }

    /// The next frame, if it is whole.
    pub(super) fn next(&mut self) -> Result<Option<Frame<'_>>, WireError> {
        let Ok((head, rest)) = FrameHead::ref_from_prefix(&self.bytes[self.begin..self.end]) else {
            return Ok(None);
        };
        head.check()?;
        let Some(payload) = rest.get(..usize::from(head.len.get())) else {
            return Ok(None);
        };
        self.begin += size_of::<FrameHead>() + payload.len();
        Ok(Some(head.frame(payload)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// All frames of what comes in pieces of these lengths, as bytes again.
    fn decoded(mut bytes: &[u8], pieces: &[usize]) -> Result<Vec<u8>, WireError> {
        let (mut frames, mut again) = (Frames::new(), Vec::new());
        for &piece in pieces.iter().cycle() {
            let taken = frames.read(&mut bytes.take(piece as u64)).unwrap();
            bytes = &bytes[taken..];
            while let Some(frame) = frames.next()? {
                match frame {
                    Frame::Datagram(datagram) => {
                        let (head, payload) =
                            Frame::parts(&datagram).expect("what was decoded can be said");
                        again.extend([&head, payload].concat());
                    }
                    Frame::End { lost } => again.extend(Frame::end(lost)),
                }
            }
            if taken == 0 {
                break;
            }
        }
        Ok(again)
    }

    fn datagrams() -> impl Strategy<Value = Vec<u8>> {
        let one = (
            0..=MAX_ARRIVAL_NS,
            any::<[u8; 12]>(),
            prop_oneof![0..2000_usize, Just(MAX_PAYLOAD_LEN)],
        )
            .prop_map(|(arrival_ns, ends, len)| {
                let end = |at: usize| {
                    let ip: [u8; 4] = ends[at..at + 4].try_into().unwrap();
                    SocketAddrV4::new(ip.into(), u16::from_le_bytes([ends[at + 4], ends[at + 5]]))
                };
                let payload = vec![ends[0]; len];
                let datagram = Addressed {
                    arrival_ns,
                    source: end(0),
                    destination: end(6),
                    payload: &payload,
                };
                let (head, payload) = Frame::parts(&datagram).unwrap();
                [&head, payload].concat()
            });
        prop::collection::vec(one, 0..20).prop_map(|all| all.concat())
    }

    proptest! {
        #[test]
        fn frames_survive_any_pieces(all in datagrams(), pieces in prop::collection::vec(1..3000_usize, 1..20), lost: u64) {
            let all = [&all[..], &Frame::end(lost)].concat();
            prop_assert_eq!(decoded(&all, &pieces), Ok(all));
        }

        #[test]
        fn arbitrary_bytes_are_frames_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
            // Of what decodes, the bytes are the same but for the zeroes of an end.
            let decoded = decoded(&bytes, &[7, 100]);
            prop_assert!(decoded.is_err() || decoded.unwrap().len() <= bytes.len());
        }

        #[test]
        fn arbitrary_hellos_and_answers_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..300), magic: bool) {
            if magic && bytes.len() >= 10 {
                bytes[..8].copy_from_slice(&MAGIC);
                bytes[8..10].copy_from_slice(&VERSION.to_le_bytes());
            }
            if let Ok(Hello::Sensor(name)) = Hello::parse(&bytes) {
                prop_assert_eq!(hello(&name), &bytes[..]);
            }
            let _ = Answer::read(&mut &bytes[..]);
        }
    }

    #[test]
    fn a_hello_is_read_as_it_comes() {
        let whole = hello("roof");
        for len in 0..whole.len() {
            assert_eq!(Hello::parse(&whole[..len]), Ok(Hello::Incomplete));
        }
        assert_eq!(Hello::parse(&whole), Ok(Hello::Sensor("roof".to_owned())));
        assert!(Hello::parse(&[&whole[..], b"x"].concat()).is_err());
        assert!(Hello::parse(b"GET / HTTP/1.1").is_err() && Hello::parse(b"sweepd").is_err());
        assert!(Hello::parse(&hello("")).is_err());
        let mut newer = whole.clone();
        newer[8] = 2;
        assert_eq!(Hello::parse(&newer), Ok(Hello::OtherVersion));
    }

    #[test]
    fn an_answer_is_read_as_it_was_meant() {
        let answer = Answer::new(Status::UnknownSensor, "front, rear");
        assert_eq!(Answer::read(&mut &answer.bytes()[..]).unwrap(), Ok(answer));
        let long = Answer::new(Status::OtherUser, &"é".repeat(MAX_TEXT_LEN));
        assert_eq!(Answer::read(&mut &long.bytes()[..]).unwrap(), Ok(long));
        // A status of a later version is told by that version.
        let mut later = Answer::new(Status::Granted, "").bytes();
        (later[8], later[10]) = (2, 99);
        let answer = Answer::read(&mut &later[..]).unwrap().unwrap();
        assert_eq!((answer.version, answer.status), (2, Status::OtherVersion));
        later[8] = 1;
        assert!(Answer::read(&mut &later[..]).unwrap().is_err());
    }
}
