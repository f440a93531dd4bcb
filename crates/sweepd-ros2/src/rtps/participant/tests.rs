//! Datagrams of anyone: no panic, and no more state than there is room for.

mod anew;
mod findings;

use super::fuzz::*;
use super::*;
use crate::environment::StaticPeer;
use crate::rtps::discovery::{MAX_ENDPOINTS, MAX_PARTICIPANTS};
use crate::rtps::wire::{Fragments, NumberSet, SampleId, Submessage};
use proptest::collection::vec;
use proptest::prelude::*;

/// Acknowledgements for a participant, by its writers.
fn acks(out: &Outbox, to: Prefix) -> BTreeMap<EntityId, Ack> {
    let messages = out.messages.iter();
    let said = messages.filter_map(|(_, message)| wire::read(message.bytes(), to));
    let acks = said.flatten().filter_map(|one| match one {
        Submessage::AckNack { writer, ack, .. } => Some((writer, ack)),
        _ => None,
    });
    acks.collect()
}

#[test]
fn sensible_datagrams_are_understood() {
    let (participant, writer) = deaf(208);
    let [here, reads, others, ended] = sensible(writer.guid).try_into().unwrap();
    // Once it has acknowledged something, the publications, and the question for its own endpoints; and for a
    // reader, the writer's history.
    take(&participant, &here);
    let out = take(&participant, acknowledgement([7; 12], &participant).bytes());
    assert_eq!((out.messages.len(), out.repairs.len()), (2, 1));
    let out = take(&participant, &reads);
    assert_eq!((out.messages.len(), out.repairs.len()), (0, 5));
    assert_eq!(writer.counters.readers.load(Ordering::Relaxed), 1);
    thread::sleep(Duration::from_millis(30));
    // An answer to the heartbeat and a gap; samples 4, 7, part of 5, and 1 of the publications.
    let out = take(&participant, &others);
    assert_eq!((out.messages.len(), out.repairs.len()), (2, 4));
    take(&participant, &ended);
    assert_eq!(writer.counters.readers.load(Ordering::Relaxed), 0);
}

#[test]
fn seeds_of_the_fuzzer_cut_anywhere_do_no_harm() {
    for (run, seeds) in [
        (datagrams as fn(&[u8]), conversations()),
        (parameter_list, parameter_lists()),
    ] {
        assert!(seeds.len() > 1);
        for seed in seeds {
            (0..seed.len()).step_by(7).for_each(|end| run(&seed[..end]));
            run(&seed);
        }
    }
}

#[test]
fn any_datagram_does_no_harm() {
    let (participant, writer) = deaf(209);
    let sensible = sensible(writer.guid);
    let header = sensible[0][..20].to_vec();
    let cases = |cases| ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(cases)
    };
    proptest!(cases(300), |(bytes in vec(any::<u8>(), 0..400))| {
        take(&participant, &bytes);
        take(&participant, &[header.as_slice(), &bytes].concat());
    });
    let changes = vec((any::<prop::sample::Index>(), any::<u8>()), 0..6);
    let one = (
        0..sensible.len(),
        changes,
        any::<prop::sample::Index>(),
        any::<bool>(),
    );
    proptest!(cases(3000), |(datagrams in vec(one, 1..8))| {
        for (which, changes, end, cut) in datagrams {
            let mut datagram = sensible[which].clone();
            for (at, value) in changes {
                let at = at.index(datagram.len());
                datagram[at] = value;
            }
            if cut {
                datagram.truncate(end.index(datagram.len()));
            }
            take(&participant, &datagram);
        }
    });
}

#[test]
fn samples_are_taken_of_writers_that_acknowledge_something() {
    let (participant, _writer) = deaf(216);
    let [best_effort, reliable] = with_readers(&participant);
    let prefix = [7; 12];
    take(&participant, participant_data(prefix).bytes());
    take(&participant, writer_data(prefix).bytes());
    let sample = sample_in_fragments(prefix, 1);
    let out = take(&participant, sample.bytes());
    assert!(out.messages.is_empty() && reliable.inbox.take().is_none());
    // Its place is right now: the reliable one asks what there is, and gets it.
    let out = take(&participant, acknowledgement(prefix, &participant).bytes());
    let asked = acks(&out, prefix);
    let nothing = asking_for(NumberSet::new(1));
    assert_eq!(asked.get(&WRITER), Some(&nothing));
    let out = take(&participant, sample.bytes());
    let [(_, answer)] = &out.messages[..] else {
        panic!("{} messages", out.messages.len());
    };
    let mut answer = wire::read(answer.bytes(), prefix).unwrap();
    let all = Submessage::AckNack {
        reader: reliable.guid.entity,
        writer: WRITER,
        ack: Ack {
            missing: NumberSet::new(2),
            is_final: true,
        },
    };
    assert_eq!(answer.next(), Some(all));
    for handle in [&best_effort, &reliable] {
        let sample = handle.inbox.take().unwrap();
        assert_eq!((sample.id.number, sample.payload), (1, vec![1; 280]));
        assert_eq!(handle.inbox.writers.load(Ordering::Relaxed), 1);
    }
    // A heartbeat for one of them is none for the other.
    let mut told = Message::new(prefix);
    let two = has(1, 2);
    told.heartbeat(best_effort.guid.entity, WRITER, two);
    assert!(take(&participant, told.bytes()).messages.is_empty());
    told.heartbeat(reliable.guid.entity, WRITER, two);
    assert_eq!(take(&participant, told.bytes()).messages.len(), 1);
    // It ends; another participant cannot end it.
    for (other, writers) in [([6; 12], 1), (prefix, 0)] {
        let mut ended = Message::new(other);
        let route = Route {
            reader: wire::ANY_READER,
            writer: wire::PUBLICATIONS_WRITER,
            number: 2,
        };
        ended.disposal(route, Guid::new(prefix, WRITER), 0);
        take(&participant, ended.bytes());
        assert_eq!(reliable.inbox.writers.load(Ordering::Relaxed), writers);
    }
}

/// Pages of memory that the process has.
fn resident_pages() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    pages.split(' ').nth(1).unwrap().parse().unwrap()
}

/// Mutated datagrams of a hostile participant, and between them samples of an honest one, of which each must
/// arrive.
#[test]
fn hostile_datagrams_change_neither_memory_nor_delivery() {
    const COUNT: u64 = 500_000;
    let (participant, writer) = deaf(217);
    let readers = with_readers(&participant);
    let [hostile, honest] = [[7; 12], [8; 12]];
    for prefix in [hostile, honest] {
        take(&participant, participant_data(prefix).bytes());
        take(&participant, acknowledgement(prefix, &participant).bytes());
        take(&participant, writer_data(prefix).bytes());
    }
    let seeds = [sensible(writer.guid), sensible_to_readers(hostile)].concat();
    let mut state = 0x5eed_u64;
    let mut random = |below: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(99);
        (state >> 33) as usize % below
    };
    let mut pages = 0;
    for number in 0..COUNT {
        let mut datagram = seeds[random(seeds.len())].clone();
        for _ in 0..random(7) {
            let at = random(datagram.len());
            datagram[at] = random(256) as u8;
        }
        if random(8) == 0 {
            datagram.truncate(random(datagram.len()));
        }
        take(&participant, &datagram);
        if number == COUNT / 10 {
            pages = resident_pages();
        }
        if number % 50 == 0 {
            let sample = 1 + number / 50;
            take(&participant, sample_in_fragments(honest, sample).bytes());
            for reader in &readers {
                let taken = std::iter::from_fn(|| reader.inbox.take());
                let arrived = taken.filter(|one| one.id.writer.prefix == honest);
                let numbers: Vec<u64> = arrived.map(|one| one.id.number).collect();
                assert_eq!(numbers, [sample]);
            }
        }
    }
    let grown = resident_pages().saturating_sub(pages);
    println!("{COUNT} datagrams: {grown} pages more in the last nine tenths, of {pages}");
    assert!(grown < 4096);
}

#[test]
fn a_flood_fills_what_there_is_room_for() {
    let (participant, _writer) = deaf(210);
    let prefix = |number: u32| {
        let mut prefix = [9; 12];
        prefix[..4].copy_from_slice(&number.to_le_bytes());
        prefix
    };
    take(&participant, participant_data(prefix(0)).bytes());
    take(
        &participant,
        acknowledgement(prefix(0), &participant).bytes(),
    );
    for number in 1..1000 {
        take(&participant, participant_data(prefix(number)).bytes());
    }
    assert!(lock(&participant.shared.state).discovery.is_full);
    // One that is new displaces one that has acknowledged nothing.
    let host = lock(&participant.shared.state)
        .discovery
        .confirmed_host(prefix(0));
    assert_eq!(host, Some(Ipv4Addr::LOCALHOST));
    for number in 0..6000_u16 {
        let message = reader_data(prefix(0), 1 + u64::from(number), number);
        participant
            .shared
            .receive(message.bytes(), Ipv4Addr::LOCALHOST);
    }
    take(&participant, &[]);
    let counts = lock(&participant.shared.state).discovery.counts();
    assert_eq!(counts, (MAX_PARTICIPANTS, MAX_ENDPOINTS, 0));
    // The first that found no room is still missing, and finds it once another has ended.
    let ended = ended(prefix(0), Side::Readers, [0, 0, 7, 4], 6001);
    take(&participant, ended.bytes());
    let counts = lock(&participant.shared.state).discovery.counts();
    assert_eq!(counts.1, MAX_ENDPOINTS - 1);
    let again = MAX_ENDPOINTS as u16;
    let again = reader_data(prefix(0), 1 + u64::from(again), again);
    take(&participant, again.bytes());
    let counts = lock(&participant.shared.state).discovery.counts();
    assert_eq!(counts.1, MAX_ENDPOINTS);
    // All asked at once in one datagram.
    let mut asking = Message::new(prefix(0));
    let mut missing = NumberSet::new(1);
    (1..=256).for_each(|number| missing.insert(number));
    let missing = asking_for(missing);
    while asking.bytes().len() < 65_000 {
        asking.acknack([0, 0, 1, 4], [0, 0, 1, 3], &missing, 1);
    }
    take(&participant, asking.bytes());
}

#[test]
fn others_are_not_heard_where_they_must_not_be() {
    let (mut participant, _writer) = deaf(211);
    let stranger = Ipv4Addr::new(203, 0, 113, 9);
    let here = participant_data([7; 12]);
    let there = participant_at([8; 12], &[stranger]);
    participant.shared.receive(there.bytes(), stranger);
    assert_eq!(
        lock(&participant.shared.state).discovery.counts(),
        (0, 0, 0)
    );
    participant
        .shared
        .receive(here.bytes(), Ipv4Addr::LOCALHOST);
    assert_eq!(
        lock(&participant.shared.state).discovery.counts(),
        (1, 0, 0)
    );
    // A static peer got that address.
    let peers = Peers::new(&[StaticPeer::Address(stranger)]).unwrap();
    Arc::get_mut(&mut participant.shared).unwrap().peers = peers;
    participant.shared.receive(there.bytes(), stranger);
    assert_eq!(
        lock(&participant.shared.state).discovery.counts(),
        (2, 0, 0)
    );
}

/// Places that a sample goes to when it is written.
fn written_to(participant: &Participant, writer: &WriterHandle) -> Vec<SocketAddrV4> {
    sent_to(participant, writer, Body::Same(vec![0; 200_000]))
}

fn sent_to(participant: &Participant, writer: &WriterHandle, body: Body) -> Vec<SocketAddrV4> {
    let mut state = lock(&participant.shared.state);
    let (_, writer) = state.writers.get_mut(&writer.guid.entity).unwrap();
    let deliveries = writer.begin(body).unwrap();
    let to = deliveries.iter().map(|one| one.link.place.address);
    let to = to.collect();
    writer.finish(vec![], Instant::now());
    to
}

#[test]
fn samples_go_to_no_address_from_which_nothing_was_acknowledged() {
    let (participant, writer) = deaf(214);
    let victim = Ipv4Addr::new(198, 51, 100, 9);
    for number in 0..200 {
        let prefix = [number; 12];
        let message = participant_at(prefix, &[victim]);
        let out = take(&participant, message.bytes());
        let bytes: usize = out.messages.iter().map(|(_, one)| one.bytes().len()).sum();
        assert!(bytes <= 3 * message.bytes().len() && out.repairs.is_empty());
        let out = take(&participant, reader_data(prefix, 1, 1).bytes());
        assert!(out.repairs.is_empty());
        // From here, for a place elsewhere.
        let out = take(&participant, acknowledgement(prefix, &participant).bytes());
        assert!(out.messages.is_empty() && out.repairs.is_empty());
    }
    assert_eq!(writer.counters.readers.load(Ordering::Relaxed), 0);
    assert!(written_to(&participant, &writer).is_empty());
    let later = Instant::now() + Duration::from_secs(2);
    let out = participant.shared.tick(later);
    assert!(out.messages.is_empty() && out.repairs.is_empty());

    // An honest one beside them.
    let prefix = [250; 12];
    take(&participant, participant_data(prefix).bytes());
    take(&participant, reader_data(prefix, 1, 1).bytes());
    assert!(written_to(&participant, &writer).is_empty());
    // What it tells of its readers is not acknowledged yet: it would not tell it again.
    let mut heartbeat = Message::new(prefix);
    let told = has(1, 1);
    heartbeat.heartbeat(wire::SUBSCRIPTIONS_READER, wire::SUBSCRIPTIONS_WRITER, told);
    let out = take(&participant, heartbeat.bytes());
    let [(_, asks)] = &out.messages[..] else {
        panic!("{} messages", out.messages.len());
    };
    let mut asks = wire::read(asks.bytes(), prefix).unwrap();
    assert!(matches!(
        asks.next(),
        Some(Submessage::Heartbeat {
            writer: wire::PUBLICATIONS_WRITER,
            ..
        })
    ));
    // What names nobody could come from anyone.
    let mut unnamed = Message::new(prefix);
    unnamed.acknack(
        wire::PUBLICATIONS_READER,
        wire::PUBLICATIONS_WRITER,
        &asking_for(NumberSet::new(1)),
        1,
    );
    take(&participant, unnamed.bytes());
    assert!(written_to(&participant, &writer).is_empty());
    // Somebody else names its address.
    let other = [251; 12];
    take(&participant, participant_data(other).bytes());
    take(&participant, reader_data(other, 1, 1).bytes());
    let out = take(&participant, acknowledgement(prefix, &participant).bytes());
    let acked = acks(&out, prefix).remove(&wire::SUBSCRIPTIONS_WRITER);
    let all = acked.expect("its readers are acknowledged now");
    assert_eq!((all.missing, all.is_final), (NumberSet::new(2), true));
    assert_eq!(writer.counters.readers.load(Ordering::Relaxed), 1);
    let honest = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9);
    assert_eq!(written_to(&participant, &writer), [honest]);

    // Those that acknowledge nothing are forgotten within seconds.
    participant.shared.tick(later + Duration::from_secs(9));
    assert_eq!(
        lock(&participant.shared.state).discovery.counts(),
        (1, 1, 0)
    );
}

#[test]
fn a_host_with_two_addresses_is_reached_at_the_one_that_answers() {
    let (participant, writer) = deaf_within(215, DiscoveryRange::Subnet);
    let wired = Ipv4Addr::new(198, 51, 100, 7);
    let wireless = Ipv4Addr::new(203, 0, 113, 7);
    let prefix = [7; 12];
    let here = participant_at(prefix, &[wired, wireless]);
    let receive = |message: &Message, source| participant.shared.receive(message.bytes(), source);
    receive(&here, wireless);
    receive(&reader_data(prefix, 1, 1), wireless);
    receive(&acknowledgement(prefix, &participant), wired);
    receive(&reader_data(prefix, 1, 1), wired);
    let place = SocketAddrV4::new(wired, 9);
    assert_eq!(written_to(&participant, &writer), [place]);
    // What it says through the other one changes nothing.
    receive(&here, wireless);
    assert_eq!(written_to(&participant, &writer), [place]);
}

#[test]
fn an_answer_goes_to_who_asked_and_others_hear_that_it_never_comes() {
    let (participant, writer) = deaf_within(221, DiscoveryRange::Subnet);
    let receive = |message: &Message, source| participant.shared.receive(message.bytes(), source);
    let clients = [7, 8].map(|id| ([id; 12], Ipv4Addr::new(198, 51, 100, id)));
    for (prefix, there) in clients {
        receive(&participant_at(prefix, &[there]), there);
        receive(&acknowledgement(prefix, &participant), there);
        receive(&reader_data(prefix, 1, 1), there);
    }
    let [(asks, there), (other, elsewhere)] = clients;
    let request = SampleId {
        writer: Guid::new(asks, WRITER),
        number: 1,
    };
    let to = sent_to(&participant, &writer, Body::Answer(request, vec![0; 8]));
    assert_eq!(to, [SocketAddrV4::new(there, 9)]);
    let missing = |prefix, source| {
        let mut eighth = NumberSet::new(8);
        eighth.insert(8);
        let mut message = Message::to(prefix, writer.guid.prefix);
        message.acknack([0, 0, 1, 4], writer.guid.entity, &asking_for(eighth), 2);
        receive(&message, source)
    };
    let out = missing(asks, there);
    assert_eq!((out.messages.len(), out.repairs.len()), (0, 1));
    let out = missing(other, elsewhere);
    let [(_, never)] = &out.messages[..] else {
        panic!("{} messages", out.messages.len());
    };
    assert!(out.repairs.is_empty());
    let gap = Submessage::Gap {
        reader: [0, 0, 1, 4],
        writer: writer.guid.entity,
        first: 8,
        more: NumberSet::new(9),
    };
    assert_eq!(wire::read(never.bytes(), other).unwrap().last(), Some(gap));
}

/// Clients of Cyclone DDS are its participants, and endpoints that name a client.
#[test]
fn the_form_of_a_request_is_that_of_its_client() {
    let (participant, _writer) = deaf(222);
    let [_, reader] = with_readers(&participant);
    for (id, vendor, user_data, has_header) in [
        (1, [1, 0x0f], "typehash=RIHS01_0;", false),
        (2, [1, 0x10], "typehash=RIHS01_0;", true),
        (3, [0, 0], "typehash=RIHS01_0;clientid=01.10.ab;", true),
    ] {
        let prefix = [id; 12];
        let here = participant_of(vendor, prefix, &[Ipv4Addr::LOCALHOST]);
        let mut list = ParameterList::new();
        let guid = Guid::new(prefix, WRITER);
        list.put(parameters::ENDPOINT_GUID, &guid.bytes());
        list.string(parameters::TOPIC_NAME, ODOM);
        list.string(parameters::TYPE_NAME, TYPE);
        list.octets(parameters::USER_DATA, user_data.as_bytes());
        let writes = data(prefix, wire::PUBLICATIONS_WRITER, 1, &list.end());
        let knows_us = acknowledgement(prefix, &participant);
        for message in [here, knows_us, writes, sample_in_fragments(prefix, 1)] {
            take(&participant, message.bytes());
        }
        assert_eq!(reader.inbox.take().unwrap().has_request_header, has_header);
    }
}

#[test]
fn samples_in_the_name_of_another_are_not_taken() {
    let (participant, _writer) = deaf_within(218, DiscoveryRange::Subnet);
    let [_, reader] = with_readers(&participant);
    let there = Ipv4Addr::new(198, 51, 100, 7);
    let elsewhere = Ipv4Addr::new(203, 0, 113, 7);
    let prefix = [7; 12];
    let receive = |message: &Message, source| participant.shared.receive(message.bytes(), source);
    receive(&participant_at(prefix, &[there]), there);
    receive(&acknowledgement(prefix, &participant), there);
    receive(&writer_data(prefix), there);
    let sample = |number| sample_in_fragments(prefix, number);
    receive(&sample(1), elsewhere);
    assert!(reader.inbox.take().is_none());
    // Nor is it said in its name that they will never come, or that there is no such writer.
    let mut gap = Message::new(prefix);
    gap.gap(wire::ANY_READER, WRITER, 1, 9);
    receive(&gap, elsewhere);
    let mut heartbeat = Message::new(prefix);
    let told = has(9, 9);
    heartbeat.heartbeat(wire::ANY_READER, WRITER, told);
    let out = receive(&heartbeat, elsewhere);
    assert!(out.messages.is_empty());
    receive(&ended(prefix, Side::Writers, WRITER, 2), elsewhere);
    // Nor that it has gone.
    let route = Route {
        reader: wire::ANY_READER,
        writer: wire::PARTICIPANTS_WRITER,
        number: 2,
    };
    let mut good_bye = Message::new(prefix);
    good_bye.disposal(route, Guid::new(prefix, wire::PARTICIPANT), 0);
    receive(&good_bye, elsewhere);
    receive(&sample(1), there);
    assert_eq!(reader.inbox.take().unwrap().id.number, 1);
    // By itself it goes.
    receive(&good_bye, there);
    receive(&sample(2), there);
    assert!(reader.inbox.take().is_none());
}

#[test]
fn a_writer_that_found_no_room_is_heard_once_another_has_ended() {
    let (participant, _writer) = deaf(220);
    let [_, reader] = with_readers(&participant);
    let prefix = [7; 12];
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    for number in 1..=128 {
        let guid = Guid::new(prefix, [0, 1, number, 3]);
        let message = endpoint_data(guid, Side::Writers, u64::from(number), ODOM);
        take(&participant, message.bytes());
    }
    let late = endpoint_data(Guid::new(prefix, WRITER), Side::Writers, 129, ODOM);
    take(&participant, late.bytes());
    take(&participant, sample_in_fragments(prefix, 1).bytes());
    assert!(reader.inbox.take().is_none());
    let ended = ended(prefix, Side::Writers, [0, 1, 5, 3], 130);
    take(&participant, ended.bytes());
    participant.shared.tick(Instant::now());
    take(&participant, sample_in_fragments(prefix, 1).bytes());
    assert_eq!(reader.inbox.take().unwrap().id.writer.entity, WRITER);
}

#[test]
fn late_readers_get_no_sample_that_is_too_old() {
    let lifespan = Duration::from_secs(10);
    let guid = Guid::new([1; 12], [0, 0, 1, 3]);
    let mut writer = Writer::new(guid, true, 100, Some(lifespan));
    assert!(writer.begin(Body::Same(vec![0; 8])).is_some());
    let written = Instant::now();
    writer.finish(vec![], written);
    let place = Place {
        address: SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9),
        near: true,
    };
    for (seconds, samples) in [(0, 1), (9, 1), (11, 0)] {
        let mut out = Outbox::default();
        let now = written + Duration::from_secs(seconds);
        writer.tick(now, &mut out);
        let reader = Endpoint::builtin_reader([seconds as u8; 12], Side::Readers, place);
        writer.add_reader(&reader, Arc::new(Link::new(place)), true, now, &mut out);
        assert_eq!(out.repairs.len(), samples, "after {seconds} s");
    }
}
