//! A node and subscribers that lose, ask, come late, or do not read. Each test has a domain of its
//! own, on this host alone.

mod peer;

use peer::{BEST_EFFORT, LATE, LONG, Peer, RELIABLE};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use sweepd_messages::message_type::POINT_CLOUD;
use sweepd_ros2::{DiscoveryRange, Durability, Environment, Node, Publisher};

const BUFFER: usize = 1 << 20;
const TOPIC: &str = "rt/points";

fn node(domain: u16) -> Node {
    let environment = Environment {
        domain,
        range: DiscoveryRange::Localhost,
        static_peers: vec![],
    };
    Node::new(&environment, "/", "sweepd").unwrap()
}

fn points(node: &Node, durability: Durability) -> Publisher {
    node.publisher("points", &POINT_CLOUD, durability).unwrap()
}

/// A message of that many bytes, no two alike.
fn message(bytes: usize, seed: u64) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    let mut state = seed | 1;
    while message.len() < bytes {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(99);
        message.extend((state >> 32).to_le_bytes());
    }
    message.truncate(bytes);
    message
}

/// A subscriber that the publisher knows.
fn matched(publisher: &Publisher, peer: &mut Peer, readers: usize) {
    let topic = format!("rt{}", publisher.topic());
    peer.until("both know each other", |peer| {
        publisher.readers() == readers && peer.writer(&topic).is_some()
    });
}

#[test]
fn messages_arrive_whole_with_padding() {
    let node = node(200);
    let points = points(&node, Durability::Volatile);
    let mut peer = Peer::new(200, 1, BUFFER);
    peer.subscribe(TOPIC, BEST_EFFORT);
    matched(&points, &mut peer, 1);
    let messages = [message(9, 1), message(200_001, 2), message(126_000, 3)];
    for message in &messages {
        points.publish(message.clone());
    }
    peer.until("three messages", |peer| peer.samples(TOPIC) == [1, 2, 3]);
    for (message, sample) in messages
        .iter()
        .zip(peer.of(TOPIC).unwrap().samples.values())
    {
        let padding = (4 - message.len() % 4) % 4;
        assert_eq!(sample.len(), message.len() + padding);
        assert_eq!(usize::from(sample[3]), padding);
        assert_eq!(sample[4..message.len()], message[4..]);
    }
    assert_eq!(points.statistics().messages, 3);
    assert_eq!(points.statistics().subscribers[0].lost_messages, 0);
}

#[test]
fn what_is_lost_is_sent_again() {
    let node = node(201);
    let points = points(&node, Durability::Volatile);
    let mut peer = Peer::new(201, 1, BUFFER);
    peer.subscribe(TOPIC, RELIABLE);
    matched(&points, &mut peer, 1);
    // Two fragments, a sample of a single datagram, and the heartbeat with the last fragment.
    peer.loses.extend([(1, 2), (1, 3), (2, 1), (3, 4)]);
    let messages = [message(200_000, 1), message(100, 2), message(200_000, 3)];
    for message in &messages {
        points.publish(message.clone());
    }
    peer.until("three messages", |peer| peer.samples(TOPIC).len() == 3);
    let received = peer.of(TOPIC).unwrap();
    assert!(received.samples.values().eq(&messages));
    assert!(peer.loses.is_empty());
    // Four datagrams, one, and four; and of them four again. What is asked for twice in a short
    // time comes once, but the machine may be slow.
    assert!(
        (9 + 4..9 + 9).contains(&received.datagrams),
        "{}",
        received.datagrams
    );
    // They are counted once they have gone out.
    peer.until("three repairs", |_| points.statistics().repairs >= 3);
}

#[test]
fn what_left_the_history_is_a_gap() {
    let node = node(202);
    let points = points(&node, Durability::Volatile);
    let mut peer = Peer::new(202, 1, BUFFER);
    peer.asks = false;
    peer.subscribe(TOPIC, RELIABLE);
    matched(&points, &mut peer, 1);
    peer.loses.extend((1..=8).map(|sample| (sample, 1)));
    for seed in 1..=8 {
        points.publish(message(100, seed));
    }
    let newest = |peer: &Peer| {
        peer.of(TOPIC)
            .is_some_and(|of| of.heartbeat == Some((4, 8)))
    };
    peer.until("a heartbeat of the last five", newest);
    let writer = peer.writer(TOPIC).unwrap();
    peer.ask(writer, 1, 8);
    peer.until("the last five", |peer| {
        peer.samples(TOPIC) == [4, 5, 6, 7, 8]
    });
    peer.until("a gap before", |peer| {
        (1..=3).all(|sample| peer.of(TOPIC).is_some_and(|of| of.gaps.contains(&sample)))
    });
}

#[test]
fn a_late_reader_gets_the_newest_where_it_is_kept() {
    let node = node(203);
    let points = points(&node, Durability::TransientLocal);
    points.publish(message(100, 1));
    points.publish(message(100_000, 2));
    let mut late = Peer::new(203, 1, BUFFER);
    late.subscribe(TOPIC, LATE);
    late.until("the newest", |late| late.samples(TOPIC) == [2]);
    assert_eq!(late.of(TOPIC).unwrap().samples[&2], message(100_000, 2));
    // One that does not ask for it gets what is new.
    let mut volatile = Peer::new(203, 2, BUFFER);
    volatile.subscribe(TOPIC, RELIABLE);
    matched(&points, &mut volatile, 2);
    points.publish(message(100, 3));
    volatile.until("what is new", |peer| !peer.samples(TOPIC).is_empty());
    assert_eq!(volatile.samples(TOPIC), [3]);
}

#[test]
fn readers_of_one_socket_get_one_copy() {
    let node = node(204);
    let points = points(&node, Durability::Volatile);
    let mut peer = Peer::new(204, 1, BUFFER);
    peer.subscribe(TOPIC, RELIABLE);
    peer.subscribe(TOPIC, BEST_EFFORT);
    matched(&points, &mut peer, 2);
    for seed in 0..5 {
        points.publish(message(100, seed));
    }
    peer.until("five messages", |peer| peer.samples(TOPIC).len() == 5);
    peer.take_for(Duration::from_millis(300));
    assert_eq!(peer.of(TOPIC).unwrap().datagrams, 5);
}

/// Reads until told to end, in a thread.
struct Reading {
    thread: JoinHandle<Peer>,
    end: Arc<AtomicBool>,
    samples: Arc<AtomicUsize>,
}

impl Reading {
    fn start(mut peer: Peer) -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let samples = Arc::new(AtomicUsize::new(0));
        let (told, tells) = (Arc::clone(&end), Arc::clone(&samples));
        let thread = thread::spawn(move || {
            while !told.load(Ordering::Relaxed) {
                peer.take();
                tells.store(peer.samples(TOPIC).len(), Ordering::Relaxed);
            }
            peer
        });
        Self {
            thread,
            end,
            samples,
        }
    }

    fn wait_for(&self, samples: usize) {
        let start = Instant::now();
        while self.samples.load(Ordering::Relaxed) < samples {
            assert!(start.elapsed() < LONG, "sample {samples}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn end(self) -> Peer {
        self.end.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

#[test]
fn a_reader_that_does_not_read_loses_its_own() {
    let node = node(205);
    let points = points(&node, Durability::Volatile);
    let mut live = Peer::new(205, 1, BUFFER);
    live.subscribe(TOPIC, RELIABLE);
    let mut stopped = Peer::new(205, 2, 100_000);
    stopped.subscribe(TOPIC, BEST_EFFORT);
    matched(&points, &mut live, 1);
    matched(&points, &mut stopped, 2);
    let place = stopped.address();
    let of = |address| {
        let subscribers = points.statistics().subscribers;
        let found = subscribers.into_iter().find(|one| one.address == address);
        found.map(|one| (one.lost_messages, one.dropped_datagrams))
    };
    let reading = Reading::start(live);
    let mut took = vec![];
    for seed in 0..20 {
        let start = Instant::now();
        points.publish(message(1_000_000, seed));
        took.push(start.elapsed());
        reading.wait_for(1 + seed as usize);
    }
    // One waits for the patience of 40 ms, and none after it does.
    let patience = Duration::from_millis(40);
    assert!(
        took[0] > patience && took[1..].iter().min() < Some(&patience),
        "{took:?}"
    );
    // The first is given up behind the writer.
    let start = Instant::now();
    while of(place) != Some((20, Some(0))) {
        assert!(start.elapsed() < LONG, "{:?}", of(place));
        thread::sleep(Duration::from_millis(10));
    }
    reading.end();

    // Once it reads again, it gets more than its socket holds.
    let reading = Reading::start(stopped);
    let start = Instant::now();
    loop {
        assert!(start.elapsed() < LONG, "it reads again");
        let (lost, _) = of(place).unwrap();
        points.publish(message(1_000_000, 30));
        if of(place).unwrap().0 == lost && reading.samples.load(Ordering::Relaxed) > 0 {
            break;
        }
        thread::sleep(Duration::from_millis(10));
    }
    let mut stopped = reading.end();
    stopped.until("one", |peer| !peer.samples(TOPIC).is_empty());
}

#[test]
fn slow_readers_get_whole_messages() {
    for (domain, asks) in [(214, BEST_EFFORT), (215, RELIABLE)] {
        let node = node(domain);
        let points = points(&node, Durability::Volatile);
        let mut live = Peer::new(domain, 1, BUFFER);
        live.subscribe(TOPIC, RELIABLE);
        matched(&points, &mut live, 1);
        let mut slow = Peer::new(domain, 2, 100_000);
        slow.subscribe(TOPIC, asks);
        matched(&points, &mut slow, 2);
        // 80 ms and more for 16 datagrams, which come every 50 ms.
        slow.works = Duration::from_millis(5);
        let (live, slow) = (Reading::start(live), Reading::start(slow));
        let start = Instant::now();
        for seed in 0.. {
            // A machine that is late may take more until some are whole.
            if seed >= 40 && slow.samples.load(Ordering::Relaxed) >= 5 {
                break;
            }
            assert!(start.elapsed() < LONG, "five whole messages");
            let begun = Instant::now();
            points.publish(message(1_000_000, seed));
            live.wait_for(1 + seed as usize);
            thread::sleep(Duration::from_millis(50).saturating_sub(begun.elapsed()));
        }
        let slow = slow.end();
        for (number, sample) in &slow.of(TOPIC).unwrap().samples {
            assert_eq!(*sample, message(1_000_000, number - 1));
        }
        println!("{:?}", slow.samples(TOPIC));
        live.end();
    }
}

#[test]
fn publishers_come_and_go() {
    let node = node(206);
    let mut peer = Peer::new(206, 1, BUFFER);
    let asks = peer::Asks {
        names_hash: false,
        ..LATE
    };
    peer.subscribe("ros_discovery_info", LATE);
    let mut humble = Peer::new(206, 2, BUFFER);
    humble.subscribe("ros_discovery_info", asks);
    let first = points(&node, Durability::Volatile);
    let second = node
        .publisher("~/more", &POINT_CLOUD, Durability::Volatile)
        .unwrap();
    assert_eq!(second.topic(), "/sweepd/more");
    peer.until("two publishers", |peer| {
        peer.writer(TOPIC).is_some() && peer.writer("rt/sweepd/more").is_some()
    });
    // Encapsulation, participant, 1 node, "/", "sweepd", no readers, then the writers.
    let graph = |peer: &Peer| {
        peer.of("ros_discovery_info")?
            .samples
            .values()
            .last()
            .cloned()
    };
    let names = 4 + 4 + 4 + 4 + 8 + 4 + 4;
    let of_two = |gid: usize| 4 + gid + names + 2 * gid;
    peer.until("both in the graph", |peer| {
        graph(peer).is_some_and(|g| g.len() == of_two(16))
    });
    humble.until("the older graph", |peer| {
        graph(peer).is_some_and(|g| g.len() == of_two(24))
    });
    drop(first);
    peer.until("its end", |peer| peer.ended_topics == [TOPIC]);
    peer.until("its end in the graph", |peer| {
        graph(peer).is_some_and(|g| g.len() == of_two(16) - 16)
    });
    assert!(!peer.other_has_gone);
    drop(node);
    peer.until("the end of the node", |peer| peer.other_has_gone);
    assert_eq!(second.readers(), 0);
}

#[test]
fn who_asks_for_more_gets_nothing() {
    let node = node(207);
    let points = points(&node, Durability::Volatile);
    let mut peer = Peer::new(207, 1, BUFFER);
    peer.subscribe(TOPIC, LATE);
    peer.subscribe("rt/elsewhere", RELIABLE);
    peer.subscribe(TOPIC, RELIABLE);
    matched(&points, &mut peer, 1);
    // The others were told of before the one that matches.
    points.publish(message(100, 1));
    peer.until("a message for one", |peer| peer.samples(TOPIC) == [1]);
}
