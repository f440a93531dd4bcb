//! Peers that begin anew: one side has forgotten the other, or something was lost.

use super::*;

/// Fast DDS says every 70 ms that it has nothing, until it hears what there is.
#[test]
fn a_reader_that_keeps_saying_that_it_has_nothing_is_told_what_there_is() {
    let (participant, writer) = deaf(213);
    let prefix = [7; 12];
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    take(&participant, reader_data(prefix, 1, 1).bytes());
    let reader = Guid::new(prefix, [0, 0, 1, 4]);
    let mut state = lock(&participant.shared.state);
    let (_, writer) = state.writers.get_mut(&writer.guid.entity).unwrap();
    let start = Instant::now();
    let mut told_ms = vec![];
    for ms in (0..2000).step_by(10) {
        let (now, mut out) = (start + Duration::from_millis(ms), Outbox::default());
        if ms % 70 == 0 {
            writer.acknack(reader, &asking_for(NumberSet::new(0)), now, &mut out);
        }
        assert!(out.messages.is_empty() && out.repairs.is_empty());
        writer.tick(now, &mut out);
        told_ms.extend(out.messages.iter().map(|_| ms));
    }
    assert!(told_ms.first().is_some_and(|ms| *ms <= 200), "{told_ms:?}");
    // Readers that answer each heartbeat so do not make it a storm.
    assert!((5..=20).contains(&told_ms.len()), "{told_ms:?}");
}

/// Fast DDS 2.14 hands out memory that is no more where a gap has a sample of which it has a part
/// (`StatefulReader::processGapMsg`): a heartbeat makes it forget such parts first.
#[test]
fn a_heartbeat_goes_before_each_gap() {
    let (participant, writer) = deaf(227);
    let (prefix, mut gaps) = ([7; 12], 0);
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    // What this one asks of durability is what is the default: nothing.
    let mut volatile = ParameterList::new();
    let guid = Guid::new(prefix, [0, 0, 2, 4]);
    volatile.put(parameters::ENDPOINT_GUID, &guid.bytes());
    volatile.string(parameters::TOPIC_NAME, TOPIC);
    volatile.string(parameters::TYPE_NAME, TYPE);
    volatile.numbers(parameters::RELIABILITY, &[2, 0, 0]);
    let volatile = data(prefix, Side::Readers.builtin().1, 1, &volatile.end());
    let new = take(&participant, volatile.bytes());
    take(&participant, reader_data(prefix, 2, 1).bytes());
    let mut missing = NumberSet::new(1);
    missing.insert(2);
    let mut asking = Message::new(prefix);
    asking.acknack([0, 0, 1, 4], writer.guid.entity, &asking_for(missing), 1);
    let asked = take(&participant, asking.bytes());
    for (_, message) in new.messages.iter().chain(&asked.messages) {
        let mut first_there = 0;
        for one in wire::read(message.bytes(), prefix).unwrap() {
            match one {
                Submessage::Heartbeat { first, .. } => first_there = first,
                Submessage::Gap { first, more, .. } => {
                    assert!(first < first_there && more.base <= first_there);
                    gaps += 1;
                }
                _ => {}
            }
        }
    }
    assert_eq!(gaps, 2);
}

/// A participant was silent for its lease, and has not forgotten us: of what we have acknowledged it says
/// nothing by itself.
#[test]
fn one_that_was_forgotten_is_asked_for_all_of_its_endpoints_again() {
    let (participant, writer) = deaf(221);
    let prefix = [7; 12];
    let mut has_readers = Message::new(prefix);
    let one = has(1, 1);
    has_readers.heartbeat(wire::SUBSCRIPTIONS_READER, wire::SUBSCRIPTIONS_WRITER, one);
    let mut all = asking_for(NumberSet::new(2));
    all.is_final = true;
    let mut missing = NumberSet::new(1);
    missing.insert(1);
    let subscriptions = |out: &Outbox| acks(out, prefix).remove(&wire::SUBSCRIPTIONS_WRITER);
    for _ in 0..2 {
        let out = take(&participant, participant_data(prefix).bytes());
        let nothing = asking_for(NumberSet::new(1));
        let of_both = Side::BOTH.map(|side| (side.builtin().1, nothing.clone()));
        assert_eq!(acks(&out, prefix), BTreeMap::from(of_both));
        take(&participant, acknowledgement(prefix, &participant).bytes());
        // The answer is lost.
        let later = Instant::now() + Duration::from_millis(1100);
        assert_eq!(
            subscriptions(&participant.shared.tick(later)),
            Some(nothing)
        );
        let out = take(&participant, has_readers.bytes());
        assert_eq!(subscriptions(&out), Some(asking_for(missing.clone())));
        take(&participant, reader_data(prefix, 1, 1).bytes());
        let out = take(&participant, has_readers.bytes());
        assert_eq!(subscriptions(&out), Some(all.clone()));
        assert_eq!(written_to(&participant, &writer).len(), 1);
        assert_eq!(
            subscriptions(&participant.shared.tick(later + Duration::from_secs(9))),
            None
        );
        participant.shared.tick(later + Duration::from_secs(21));
        assert!(written_to(&participant, &writer).is_empty());
    }
}

/// Fast DDS sends what it takes for acknowledged again to a base of 0 alone, and may know us without endpoints
/// until our lease ends, which each datagram renews.
#[test]
fn one_of_fast_dds_that_does_not_answer_is_asked_as_by_its_own_and_made_to_forget_us() {
    for (vendor, base, leases) in [
        ([1, 0x0f], 0, vec![(2, [0, 1 << 31])]),
        ([1, 0x10], 1, vec![]),
    ] {
        let (participant, _writer) = deaf(223);
        let prefix = [7; 12];
        let here = participant_of(vendor, prefix, &[Ipv4Addr::LOCALHOST]);
        let start = Instant::now();
        let first = acks(&take(&participant, here.bytes()), prefix);
        take(&participant, acknowledgement(prefix, &participant).bytes());
        let nothing = |base| asking_for(NumberSet::new(base));
        let of_both =
            |base| BTreeMap::from(Side::BOTH.map(|side| (side.builtin().1, nothing(base))));
        assert_eq!(first, of_both(1));
        let after = |ms| participant.shared.tick(start + Duration::from_millis(ms));
        assert_eq!(acks(&after(1500), prefix), of_both(base));
        let out = after(3600);
        assert_eq!(acks(&out, prefix), of_both(base));
        let mut told: Vec<(u64, [u32; 2])> = announced(&out, prefix);
        told.dedup_by_key(|(_, lease)| *lease);
        assert_eq!(told, leases);
        let out = after(7700);
        assert_eq!(
            (announced(&out, prefix), acks(&out, prefix)),
            (vec![], of_both(base))
        );
    }
}

/// Numbers and leases of our announcements.
fn announced(out: &Outbox, to: Prefix) -> Vec<(u64, [u32; 2])> {
    let messages = out.messages.iter();
    let said = messages.filter_map(|(_, message)| wire::read(message.bytes(), to));
    let announced = said.flatten().filter_map(|one| match one {
        Submessage::Data(data) if data.writer == wire::PARTICIPANTS_WRITER => {
            let mut list = parameters::read(data.payload).unwrap();
            let (_, lease) = list.find(|(id, _)| *id == parameters::PARTICIPANT_LEASE)?;
            Some((data.number, [lease.u32(0)?, lease.u32(4)?]))
        }
        _ => None,
    });
    announced.collect()
}

#[test]
fn one_that_falls_silent_is_asked_whether_it_is_there_before_its_lease_ends() {
    let (participant, _writer) = deaf(228);
    let prefix = [7; 12];
    let start = Instant::now();
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    let mut told = Message::new(prefix);
    for side in Side::BOTH {
        let (reader, writer) = side.builtin();
        let none = has(1, 0);
        told.heartbeat(reader, writer, none);
    }
    // It has told of all, and has all: nothing else is said to it.
    told.destination(participant.guid().prefix);
    for side in Side::BOTH {
        let (reader, writer) = side.builtin();
        let all = Ack {
            missing: NumberSet::new(2),
            is_final: true,
        };
        told.acknack(reader, writer, &all, 2);
    }
    take(&participant, told.bytes());
    // Its lease is 20 s.
    let mut asked = vec![];
    for seconds in 1..20 {
        let out = participant
            .shared
            .tick(start + Duration::from_secs(seconds));
        let is_asked = out.messages.iter().any(|(_, message)| {
            let mut said = wire::read(message.bytes(), prefix).unwrap();
            let is_heartbeat = |one| matches!(one, Submessage::Heartbeat { .. });
            said.any(is_heartbeat)
        });
        asked.extend(is_asked.then_some(seconds));
    }
    assert_eq!(asked, [11, 14, 17]);
}

/// A participant has forgotten us, and we have not forgotten it.
#[test]
fn one_that_forgot_what_it_acknowledged_is_told_of_it_again() {
    let (participant, _writer) = deaf(222);
    let prefix = [7; 12];
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    let reader = Guid::new(prefix, wire::PUBLICATIONS_READER);
    let mut state = lock(&participant.shared.state);
    let (_, telling) = state.writers.get_mut(&wire::PUBLICATIONS_WRITER).unwrap();
    let start = Instant::now() + Duration::from_secs(1);
    let mut after = |ack: Option<Ack>, ms| {
        let (now, mut out) = (start + Duration::from_millis(ms), Outbox::default());
        if let Some(ack) = ack {
            telling.acknack(reader, &ack, now, &mut out);
        }
        telling.tick(now, &mut out);
        let repaired = out.repairs.iter().map(|one| one.sample.number);
        (out.messages.len(), repaired.collect::<Vec<u64>>())
    };
    let mut all = asking_for(NumberSet::new(2));
    all.is_final = true;
    assert_eq!(after(Some(all), 0), (0, vec![]));
    assert_eq!(after(None, 5000), (0, vec![]));
    // It begins anew: a heartbeat, again until it has said what it misses, and the publication.
    assert_eq!(
        after(Some(asking_for(NumberSet::new(1))), 6000),
        (1, vec![])
    );
    assert_eq!(after(None, 6500), (1, vec![]));
    let mut missing = NumberSet::new(1);
    missing.insert(1);
    assert_eq!(after(Some(asking_for(missing)), 7000), (0, vec![1]));
    // One that has all and asks is answered, too.
    let all = asking_for(NumberSet::new(2));
    assert_eq!(after(Some(all), 8000), (0, vec![]));
    assert_eq!(after(None, 8100), (1, vec![]));
    assert_eq!(after(None, 9000), (0, vec![]));
}
