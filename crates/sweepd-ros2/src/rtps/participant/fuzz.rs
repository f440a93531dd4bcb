//! Datagrams that any host can send a participant: for the tests, and for the fuzzer (tests/fuzz).
#![cfg_attr(not(test), allow(dead_code))]

use super::*;
use crate::rtps::discovery::{MAX_ENDPOINTS, MAX_PARTICIPANTS};
use crate::rtps::findings::MAX_FINDINGS;
use crate::rtps::wire::{Fragments, Heartbeat, NumberSet};
use crate::rtps::writer::OUTBOX;

pub(super) const TOPIC: &str = "rt/points";
pub(super) const ODOM: &str = "rt/odom";
pub(super) const TYPE: &str = "sensor_msgs::msg::dds_::PointCloud2_";

/// A participant that hears nothing but what a test gives it, with samples 3 to 7 of a topic.
pub(super) fn deaf(domain: u16) -> (Participant, WriterHandle) {
    deaf_within(domain, DiscoveryRange::Localhost)
}

/// A participant that hears nothing, with a discovery range of the test's.
pub(super) fn deaf_within(domain: u16, range: DiscoveryRange) -> (Participant, WriterHandle) {
    let environment = Environment {
        domain,
        range,
        static_peers: vec![],
    };
    let participant = Participant {
        shared: Arc::new(Shared::open(&environment, "test", "/").unwrap()),
        threads: Mutex::default(),
    };
    let writer = participant.add_writer(Terms {
        topic: TOPIC.to_owned(),
        type_name: TYPE.to_owned(),
        type_hash: "RIHS01_0",
        reliable: true,
        transient_local: true,
        depth: 5,
        lifespan: None,
        is_sole: true,
    });
    for _ in 0..7 {
        participant.write(&writer, Body::Same(vec![0; 200_000]));
    }
    (participant, writer)
}

/// Readers of its: one of best effort, and a reliable one.
pub(super) fn with_readers(participant: &Participant) -> [ReaderHandle; 2] {
    [false, true].map(|reliable| {
        let asks = Terms {
            topic: ODOM.to_owned(),
            type_name: TYPE.to_owned(),
            type_hash: "RIHS01_0",
            reliable,
            transient_local: false,
            depth: 5,
            lifespan: None,
            is_sole: false,
        };
        participant.add_reader(asks, 10_000)
    })
}

/// "I am here."
pub(super) fn participant_data(prefix: Prefix) -> Message {
    participant_at(prefix, &[Ipv4Addr::LOCALHOST])
}

/// "I am at one of these addresses."
pub(super) fn participant_at(prefix: Prefix, addresses: &[Ipv4Addr]) -> Message {
    participant_of([1, 0x10], prefix, addresses)
}

/// Announcement of a participant of a vendor, at one of these addresses.
pub(super) fn participant_of(vendor: [u8; 2], prefix: Prefix, addresses: &[Ipv4Addr]) -> Message {
    let mut list = ParameterList::new();
    for parameter in [parameters::METATRAFFIC_LOCATOR, parameters::DEFAULT_LOCATOR] {
        for address in addresses {
            list.locator(parameter, SocketAddrV4::new(*address, 9));
        }
    }
    list.numbers(parameters::PARTICIPANT_LEASE, &[20, 0]);
    list.put(parameters::VENDOR_ID, &vendor);
    data(prefix, wire::PARTICIPANTS_WRITER, 1, &list.end())
}

/// "I miss these. What is there?"
pub(super) fn asking_for(missing: NumberSet) -> Ack {
    Ack {
        missing,
        is_final: false,
    }
}

/// "You have told me of no writer of yours."
pub(super) fn acknowledgement(prefix: Prefix, participant: &Participant) -> Message {
    let mut message = Message::to(prefix, participant.guid().prefix);
    message.acknack(
        wire::PUBLICATIONS_READER,
        wire::PUBLICATIONS_WRITER,
        &asking_for(NumberSet::new(1)),
        1,
    );
    message
}

/// "I have a reader."
pub(super) fn reader_data(prefix: Prefix, number: u64, reader: u16) -> Message {
    let [high, low] = reader.to_be_bytes();
    let guid = Guid::new(prefix, [0, high, low, 4]);
    endpoint_data(guid, Side::Readers, number, TOPIC)
}

/// "I have a writer."
pub(super) fn writer_data(prefix: Prefix) -> Message {
    endpoint_data(Guid::new(prefix, WRITER), Side::Writers, 1, ODOM)
}

pub(super) fn endpoint_data(guid: Guid, side: Side, number: u64, topic: &str) -> Message {
    let mut list = ParameterList::new();
    list.put(parameters::ENDPOINT_GUID, &guid.bytes());
    list.string(parameters::TOPIC_NAME, topic);
    list.string(parameters::TYPE_NAME, TYPE);
    list.numbers(parameters::RELIABILITY, &[2, 0, 0]);
    list.numbers(parameters::DURABILITY, &[1]);
    list.octets(parameters::USER_DATA, b"clientid=1;");
    data(guid.prefix, side.builtin().1, number, &list.end())
}

/// A sample of a writer of others, in three fragments; behind the last, "I have all up to this".
pub(super) fn sample_in_fragments(prefix: Prefix, number: u64) -> Message {
    let payload = [number as u8; 280];
    let mut message = Message::new(prefix);
    let of = Fragments {
        fragment_bytes: 100,
        sample_bytes: payload.len(),
    };
    let route = Route {
        reader: wire::ANY_READER,
        writer: WRITER,
        number,
    };
    for fragment in 1..=of.count() {
        let part = of.part(&payload, fragment);
        message.fragment(route, None, (fragment, of), part.len());
        message.payload(part);
    }
    let told = has(1, number);
    message.heartbeat(wire::ANY_READER, WRITER, told);
    message
}

pub(super) fn data(prefix: Prefix, writer: EntityId, number: u64, payload: &[u8]) -> Message {
    let mut message = Message::new(prefix);
    let route = Route {
        reader: wire::ANY_READER,
        writer,
        number,
    };
    message.data(route, None, payload.len());
    message.payload(payload);
    message
}

/// "An endpoint of mine is no more."
pub(super) fn ended(prefix: Prefix, side: Side, entity: EntityId, number: u64) -> Message {
    let mut message = Message::new(prefix);
    let route = Route {
        reader: wire::ANY_READER,
        writer: side.builtin().1,
        number,
    };
    message.disposal(route, Guid::new(prefix, entity), 0);
    message
}

/// A writer of others.
pub(super) const WRITER: EntityId = [0, 0, 9, 3];

/// Datagrams that make sense to the participant, of each kind that it takes.
pub(super) fn sensible(writer: Guid) -> Vec<Vec<u8>> {
    let prefix = [7; 12];
    let reader = [0, 0, 1, 4];
    let mut missing = NumberSet::new(1);
    for number in [1, 4, 7, 9, 200] {
        missing.insert(number);
    }
    let mut others = Message::new(prefix);
    others.destination(writer.prefix);
    let heartbeat = has(1, 300);
    others.heartbeat(
        wire::SUBSCRIPTIONS_READER,
        wire::SUBSCRIPTIONS_WRITER,
        heartbeat,
    );
    others.gap(
        wire::SUBSCRIPTIONS_READER,
        wire::SUBSCRIPTIONS_WRITER,
        5,
        90,
    );
    others.acknack(reader, writer.entity, &asking_for(missing.clone()), 1);
    others.acknack(
        wire::PUBLICATIONS_READER,
        wire::PUBLICATIONS_WRITER,
        &asking_for(missing),
        1,
    );
    // NACK_FRAG of sample 5: fragments 1 and 3 of 4.
    others.payload(&[0x12, 1, 32, 0]);
    others.payload(&[reader, writer.entity].concat());
    others.payload(&[
        0, 0, 0, 0, 5, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0xa0, 1, 0, 0, 0,
    ]);
    [
        participant_data(prefix),
        reader_data(prefix, 1, 1),
        others,
        ended(prefix, Side::Readers, reader, 2),
    ]
    .iter()
    .map(|message| message.bytes().to_vec())
    .collect()
}

/// Takes a datagram, and sees that there is an end to what it makes us do and keep.
pub(super) fn take(participant: &Participant, datagram: &[u8]) -> Outbox {
    let out = participant.shared.receive(datagram, Ipv4Addr::LOCALHOST);
    assert!(out.messages.len() <= OUTBOX && out.repairs.len() <= OUTBOX);
    let bytes: usize = out
        .messages
        .iter()
        .map(|(_, message)| message.bytes().len())
        .sum();
    assert!(bytes < 16 << 20, "{bytes} bytes of answers");
    let state = lock(&participant.shared.state);
    let (participants, readers, writers) = state.discovery.counts();
    assert!(participants <= MAX_PARTICIPANTS && readers.max(writers) <= MAX_ENDPOINTS);
    assert!(state.ways.links.len() <= participants + readers);
    assert!(state.ways.findings.len() <= MAX_FINDINGS);
    for reader in state.readers.values() {
        reader.check_bounds();
    }
    out
}

/// Datagrams that make sense to the participant's readers.
pub(super) fn sensible_to_readers(prefix: Prefix) -> Vec<Vec<u8>> {
    let mut small = data(prefix, WRITER, 1, &[1; 60]);
    small.gap(wire::ANY_READER, WRITER, 3, 5);
    let mut pieces = sample_in_fragments(prefix, 2);
    pieces.gap(wire::ANY_READER, WRITER, 1, 2);
    let ended = ended(prefix, Side::Writers, WRITER, 2);
    [writer_data(prefix), small, pieces, ended]
        .iter()
        .map(|message| message.bytes().to_vec())
        .collect()
}

/// A participant of others.
const THEIRS: Prefix = [7; 12];
/// Prefix that stands in an input for that of the participant.
const OURS: Prefix = [9; 12];

/// Takes datagrams to a participant, each behind its length (`u16`, little-endian).
pub fn datagrams(input: &[u8]) {
    let (participant, _writer) = deaf(229);
    with_readers(&participant);
    let mut rest = input;
    while let [low, high, bytes @ ..] = rest {
        let (datagram, others) =
            bytes.split_at(bytes.len().min(u16::from_le_bytes([*low, *high]).into()));
        let mut datagram = datagram.to_vec();
        for at in 0..datagram.len().saturating_sub(OURS.len() - 1) {
            if datagram[at..].starts_with(&OURS) {
                datagram[at..][..OURS.len()].copy_from_slice(&participant.guid().prefix);
            }
        }
        take(&participant, &datagram);
        rest = others;
    }
}

/// Takes a parameter list as that of a writer, of a reader and of a participant.
pub fn parameter_list(input: &[u8]) {
    let (participant, _writer) = deaf(230);
    with_readers(&participant);
    take(&participant, participant_data(THEIRS).bytes());
    take(&participant, acknowledgement(THEIRS, &participant).bytes());
    // A submessage is no longer.
    let list = &input[..input.len().min(60_000)];
    let told_by = [
        (Side::Writers.builtin().1, 1),
        (Side::Readers.builtin().1, 1),
        (wire::PARTICIPANTS_WRITER, 2),
    ];
    for (writer, number) in told_by {
        take(&participant, data(THEIRS, writer, number, list).bytes());
    }
}

/// Inputs of [`datagrams`] that make sense.
pub fn conversations() -> Vec<Vec<u8>> {
    let mut acknowledgement = Message::to(THEIRS, OURS);
    acknowledgement.acknack(
        wire::PUBLICATIONS_READER,
        wire::PUBLICATIONS_WRITER,
        &asking_for(NumberSet::new(1)),
        1,
    );
    // The first writer of a participant.
    let [here, rest @ ..] = &sensible(Guid::new(OURS, [0, 0, 1, 3]))[..] else {
        return vec![];
    };
    let begin = [here.clone(), acknowledgement.bytes().to_vec()];
    [rest, &sensible_to_readers(THEIRS)]
        .map(|rest| {
            let framed = begin.iter().chain(rest).flat_map(|datagram| {
                let len = (datagram.len() as u16).to_le_bytes();
                [&len[..], datagram].concat()
            });
            framed.collect()
        })
        .to_vec()
}

/// Inputs of [`parameter_list`] that make sense: the payloads of what is told in a conversation.
pub fn parameter_lists() -> Vec<Vec<u8>> {
    [
        participant_data(THEIRS),
        reader_data(THEIRS, 1, 1),
        writer_data(THEIRS),
    ]
    .iter()
    .flat_map(|message| wire::read(message.bytes(), OURS).into_iter().flatten())
    .filter_map(|submessage| match submessage {
        wire::Submessage::Data(data) => Some(data.payload.to_vec()),
        _ => None,
    })
    .collect()
}

/// "I have the samples from the first to the last."
pub(super) fn has(first: u64, last: u64) -> Heartbeat {
    Heartbeat {
        first,
        last,
        count: 1,
    }
}
