//! Warnings of others that get nothing, and of those that publish the same.

use super::*;

#[test]
fn only_of_those_that_acknowledge_something_is_it_told_that_they_do_not_match() {
    let (participant, _writer) = deaf(219);
    let [_, _] = with_readers(&participant);
    let prefix = [7; 12];
    let mut list = ParameterList::new();
    list.put(
        parameters::ENDPOINT_GUID,
        &Guid::new(prefix, WRITER).bytes(),
    );
    list.string(parameters::TOPIC_NAME, ODOM);
    list.string(parameters::TYPE_NAME, TYPE);
    list.numbers(parameters::OWNERSHIP, &[1]);
    let exclusive = data(prefix, wire::PUBLICATIONS_WRITER, 1, &list.end());
    let told = || lock(&participant.shared.state).ways.findings.len();
    take(&participant, participant_data(prefix).bytes());
    take(&participant, exclusive.bytes());
    assert_eq!(told(), 0);
    take(&participant, acknowledgement(prefix, &participant).bytes());
    assert_eq!(told(), 1);
}

/// Sentences on what is wrong at a time.
fn findings(participant: &Participant, now: Instant) -> Vec<String> {
    let state = lock(&participant.shared.state);
    let known = |of| state.discovery.knows(of);
    state.ways.findings.lasting(now, known)
}

#[test]
fn who_acknowledges_nothing_is_told_of_with_the_addresses_that_it_was_told() {
    let (participant, writer) = deaf_within(224, DiscoveryRange::Subnet);
    let there = Ipv4Addr::new(198, 51, 100, 7);
    let receive = |message: &Message| participant.shared.receive(message.bytes(), there);
    let [mute, begins] = [[7; 12], [8; 12]];
    let start = Instant::now();
    let after = |seconds| start + Duration::from_secs(seconds);
    for prefix in [mute, begins] {
        receive(&participant_at(prefix, &[there]));
    }
    let heard = (lock(&participant.shared.state).discovery).hears(mute, there, &[], after(6));
    assert!(heard);
    participant.shared.tick(after(9));
    assert!(findings(&participant, after(9)).is_empty());
    participant.shared.tick(after(11));
    // One that was there once may have gone.
    let [told] = &findings(&participant, after(11))[..] else {
        panic!("{:?}", findings(&participant, after(11)));
    };
    let own = participant.shared.transport.sockets.own().port();
    assert!(
        told.contains("198.51.100.7:9 has acknowledged nothing for 10 s"),
        "{told}"
    );
    assert!(told.contains(&format!("127.0.0.1:{own}")), "{told}");
    assert!(findings(&participant, after(50)).is_empty());

    // It acknowledges something; a reader of its does not.
    receive(&participant_at(mute, &[there]));
    receive(&acknowledgement(mute, &participant));
    receive(&reader_data(mute, 1, 1));
    assert!(findings(&participant, Instant::now()).is_empty());
    assert_eq!(writer.counters.readers.load(Ordering::Relaxed), 1);
    participant.shared.tick(after(12));
    let told = findings(&participant, after(12));
    assert!(
        told.len() == 1 && told[0].starts_with("/points: a subscriber at 198.51"),
        "{told:?}"
    );
    let mut acks = Message::to(mute, participant.guid().prefix);
    acks.acknack(
        [0, 0, 1, 4],
        writer.guid.entity,
        &asking_for(NumberSet::new(1)),
        1,
    );
    receive(&acks);
    participant.shared.tick(after(13));
    assert!(findings(&participant, after(13)).is_empty());
}

#[test]
fn who_names_no_address_of_ipv4_is_told_of_once() {
    let (participant, _writer) = deaf(225);
    let prefix = [0xab; 12];
    let nowhere = participant_at(prefix, &[]);
    for _ in 0..3 {
        take(&participant, nowhere.bytes());
    }
    let now = Instant::now();
    let [told] = &findings(&participant, now)[..] else {
        panic!("{:?}", findings(&participant, now));
    };
    assert!(
        told.contains("127.0.0.1 whose GIDs begin with ab.ab.ab"),
        "{told}"
    );
    take(&participant, participant_data(prefix).bytes());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    assert!(findings(&participant, now).is_empty());
}

#[test]
fn an_endpoint_that_is_told_of_in_fragments_is_told_of() {
    let (participant, _writer) = deaf(227);
    let prefix = [7; 12];
    take(&participant, participant_data(prefix).bytes());
    let of = Fragments {
        fragment_bytes: 100,
        sample_bytes: 180,
    };
    let route = Route {
        reader: wire::SUBSCRIPTIONS_READER,
        writer: wire::SUBSCRIPTIONS_WRITER,
        number: 1,
    };
    let mut first = Message::new(prefix);
    first.fragment(route, None, (1, of), 100);
    first.payload(&[0; 100]);
    take(&participant, first.bytes());
    let told = findings(&participant, Instant::now());
    let it = "at 127.0.0.1:9 tells of a subscriber or publisher in more than one fragment";
    assert!(told.len() == 1 && told[0].contains(it), "{told:?}");
}

#[test]
fn another_publisher_of_the_same_topic_is_told_of_for_as_long_as_it_is_there() {
    let (participant, _writer) = deaf(226);
    let prefix = [7; 12];
    let second: EntityId = [0, 0, 10, 3];
    let later = Instant::now() + Duration::from_secs(100);
    take(&participant, participant_data(prefix).bytes());
    for (number, entity) in [(1, WRITER), (2, second)] {
        let guid = Guid::new(prefix, entity);
        let told = endpoint_data(guid, Side::Writers, number, TOPIC);
        take(&participant, told.bytes());
    }
    assert!(findings(&participant, later).is_empty());
    take(&participant, acknowledgement(prefix, &participant).bytes());
    for (number, entity) in [(3, WRITER), (4, second)] {
        let told = findings(&participant, later);
        let it = "publishes /points too";
        assert!(told.len() == 1 && told[0].contains(it), "{told:?}");
        let ended = ended(prefix, Side::Writers, entity, number);
        take(&participant, ended.bytes());
    }
    assert!(findings(&participant, later).is_empty());
}
