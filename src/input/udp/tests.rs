use std::net::UdpSocket;

use super::*;
use crate::admission::{DiscoveredSensors, Refusal};
use sweepd_core::sensor::Model;
use sweepd_core::wire::DataPacket;
use sweepd_testkit::Stopwatch;

const WAIT: Duration = Duration::from_secs(60);
const SOON: Duration = Duration::from_millis(50);

fn source(buffer_bytes: usize) -> UdpSource {
    let loopback = UdpConfig {
        address: Ipv4Addr::LOCALHOST,
        buffer_bytes,
        ..UdpConfig::port(0)
    };
    UdpSource::bind(&loopback).unwrap()
}

fn sender() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").unwrap()
}

/// Stamps and payloads of all that waits.
fn drain(source: &mut UdpSource) -> Vec<(i64, Vec<u8>)> {
    let mut all = Vec::new();
    loop {
        let before = all.len();
        all.extend(
            source
                .receive(SOON)
                .unwrap()
                .map(|datagram| (datagram.arrival_ns, datagram.payload.to_vec())),
        );
        if all.len() == before {
            return all;
        }
    }
}

/// The kernel begins to stamp a moment after a first socket requests it; earlier datagrams are
/// stamped when they are fetched.
fn until_stamped(source: &mut UdpSource, sender: &UdpSocket) -> u64 {
    for sent in 1..=100 {
        sender.send_to(b"x", source.local_addr()).unwrap();
        let sent_ns = now_ns();
        std::thread::sleep(Duration::from_millis(5));
        if matches!(drain(source)[..], [(stamp_ns, _)] if stamp_ns <= sent_ns) {
            return sent;
        }
    }
    panic!("the kernel does not stamp");
}

#[test]
fn all_that_is_sent_arrives_in_order_with_the_stamps_of_the_kernel() {
    let (mut source, sender) = (source(ample_buffer_bytes()), sender());
    let first = until_stamped(&mut source, &sender);
    let begun_ns = now_ns();
    let mut arrived = Vec::new();
    for round in 0..10_u32 {
        for number in 0..100 {
            sender
                .send_to(&(round * 100 + number).to_le_bytes(), source.local_addr())
                .unwrap();
        }
        let ended_ns = now_ns();
        // Stamped when they came, not when they were fetched.
        std::thread::sleep(Duration::from_millis(5));
        let now = drain(&mut source);
        assert!(
            now.iter()
                .all(|(stamp_ns, _)| (begun_ns..=ended_ns).contains(stamp_ns))
        );
        arrived.extend(now);
    }
    assert!(arrived.is_sorted_by_key(|(stamp_ns, _)| *stamp_ns));
    let numbers: Vec<[u8; 4]> = arrived
        .iter()
        .map(|(_, payload)| payload[..].try_into().unwrap())
        .collect();
    assert_eq!(
        numbers,
        (0..1000_u32).map(u32::to_le_bytes).collect::<Vec<_>>()
    );
    assert_eq!((source.received(), source.dropped()), (first + 1000, 0));
}

#[test]
fn source_and_destination_of_a_datagram_are_given() {
    let (mut source, sender) = (source(100_000), sender());
    sender.send_to(b"x", source.local_addr()).unwrap();
    let port = source.local_addr().port();
    let ends: Vec<_> = source
        .receive(WAIT)
        .unwrap()
        .map(|one| (one.source, one.destination_port))
        .collect();
    assert_eq!(ends, [(sender.local_addr().unwrap(), port)]);
    // A source on all addresses reports which of them a datagram was sent to.
    let mut all = UdpSource::bind(&UdpConfig::port(0)).unwrap();
    let to = [[127, 0, 0, 1], [127, 0, 0, 77]]
        .map(|ip| SocketAddrV4::new(ip.into(), all.local_addr().port()));
    for to in &to {
        sender.send_to(b"x", to).unwrap();
    }
    let mut told = Vec::new();
    while told.len() < to.len() {
        told.extend(
            all.receive_addressed(WAIT)
                .unwrap()
                .map(|one| one.destination),
        );
    }
    assert_eq!(told, to);
}

#[test]
fn what_a_small_buffer_cannot_hold_is_counted_exactly_over_many_batches() {
    let (mut source, sender) = (source(16 * 1024), sender());
    let mut sent = 0;
    for round in 1..=4 {
        for _ in 0..300 {
            sender.send_to(&[7; 1206], source.local_addr()).unwrap();
            sent += 1;
        }
        // Also without a datagram that carries the count.
        let dropped = source.dropped();
        assert!(dropped >= round * 280, "{dropped}");
        drain(&mut source);
        assert_eq!(
            (source.received() + source.dropped(), source.dropped()),
            (sent, dropped)
        );
    }
    // And by the control messages alone.
    sender.send_to(b"one more", source.local_addr()).unwrap();
    source.drops = DropCounter::default();
    assert_eq!(source.receive(WAIT).unwrap().count(), 1);
    assert_eq!(source.received() + source.drops.total, sent + 1);
}

#[test]
fn each_datagram_says_how_many_were_dropped_before_it() {
    let (mut source, sender) = (source(100 * 1024), sender());
    let (mut sent, mut taken, mut within_a_batch) = (0_u64, 0, false);
    for _ in 0..4 {
        for _ in 0..500 {
            sender
                .send_to(&sent.to_le_bytes(), source.local_addr())
                .unwrap();
            sent += 1;
        }
        loop {
            let before = taken;
            let mut said = Vec::new();
            for (addressed, dropped) in source.receive_counted(SOON).unwrap() {
                assert_eq!(
                    u64::from_le_bytes(addressed.payload.try_into().unwrap()),
                    taken + dropped
                );
                said.push(dropped);
                taken += 1;
            }
            within_a_batch |= said.first() != said.last();
            if taken == before {
                break;
            }
            // This one fits behind those that wait, after those that were dropped.
            if taken < 70 {
                sender
                    .send_to(&sent.to_le_bytes(), source.local_addr())
                    .unwrap();
                sent += 1;
            }
        }
        assert_eq!(taken + source.dropped(), sent);
    }
    assert!(
        within_a_batch && source.dropped() > 500,
        "{} dropped",
        source.dropped()
    );
}

#[test]
fn the_drop_counter_wraps_and_never_goes_back() {
    let mut drops = DropCounter::default();
    let mut total = |dropped| {
        drops.note(Some(dropped));
        drops.total
    };
    assert_eq!([5, 5, 4, 9].map(&mut total), [5, 5, 5, 9]);
    let half = u32::MAX / 2;
    assert_eq!(
        [half, u32::MAX - 1, 3].map(&mut total),
        [half.into(), u64::from(u32::MAX) - 1, (1 << 32) + 3]
    );
}

#[test]
fn longer_datagrams_are_cut_and_never_taken_for_packets() {
    let (mut source, sender) = (source(1_000_000), sender());
    let lens = [0, 1, 512, 1206, 1207, 1280, 1281, 9000, 65_507];
    for len in lens {
        sender.send_to(&vec![1; len], source.local_addr()).unwrap();
    }
    let arrived: Vec<_> = drain(&mut source)
        .into_iter()
        .map(|(_, payload)| payload.len())
        .collect();
    assert_eq!(arrived, lens.map(|len: usize| len.min(1280)));
}

#[test]
fn others_on_the_port_are_distinguished() {
    let (mut source, sensor, foreign) = (source(ample_buffer_bytes()), sender(), sender());
    let mut sensors = DiscoveredSensors::new(vec![
        sensor.local_addr().unwrap().to_string().parse().unwrap(),
    ]);
    let packet = DataPacket::new(0, 0x37, 0x22);
    for _ in 0..50 {
        sensor.send_to(packet.emit(), source.local_addr()).unwrap();
        foreign.send_to(packet.emit(), source.local_addr()).unwrap();
        foreign.send_to(&[9; 1206], source.local_addr()).unwrap();
        foreign.send_to(&[9; 300], source.local_addr()).unwrap();
    }
    while source.received() < 200 {
        let batch = source.receive(WAIT).unwrap();
        assert!(batch.clone().count() > 0);
        batch.for_each(|datagram| {
            let _ = sensors.admit(&datagram);
        });
    }
    assert_eq!(sensors.senders().len(), 1);
    assert_eq!(sensors.senders()[0].packets, 50);
    for reason in [Refusal::Length, Refusal::Marker, Refusal::Source] {
        assert_eq!(sensors.refusals().get(reason), 50, "{reason:?}");
    }
    assert_eq!(sensors.refusals().total(), 150);
}

#[test]
fn a_silent_port_lets_the_caller_tick() {
    let mut source = source(100_000);
    let begun = std::time::Instant::now();
    assert_eq!(source.receive(SOON).unwrap().count(), 0);
    assert!(begun.elapsed() >= SOON / 2);
    // Never blocks, however often it is called.
    let begun = Stopwatch::start();
    assert!((0..1000).all(|_| source.receive(Duration::ZERO).unwrap().count() == 0));
    assert!(begun.elapsed() < Duration::from_millis(500));
}

#[test]
fn a_port_that_is_taken_is_an_error_that_names_it_even_if_the_other_would_share() {
    let other = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
    other.set_reuse_address(true).unwrap();
    other
        .bind(&SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0).into())
        .unwrap();
    let port = other.local_addr().unwrap().as_socket_ipv4().unwrap().port();
    let error = UdpSource::bind(&UdpConfig::port(port)).unwrap_err();
    assert!(matches!(error, UdpError::PortTaken { port: taken, holder: Some(_) } if taken == port));
    assert!(
        error
            .to_string()
            .contains(&format!("port {port} is held by "))
    );
}

#[test]
fn what_this_host_has_not_is_an_error_that_names_it() {
    let error = |config: UdpConfig| UdpSource::bind(&config).unwrap_err().to_string();
    let elsewhere = UdpConfig {
        address: [192, 0, 2, 1].into(),
        ..UdpConfig::port(0)
    };
    assert!(error(elsewhere).contains("has the address 192.0.2.1"));
    let interface = UdpConfig {
        interface: Some("none77".to_owned()),
        ..UdpConfig::port(0)
    };
    assert!(error(interface).contains("interface none77"));
    let group = UdpConfig {
        multicast: Some([10, 0, 0, 1].into()),
        ..UdpConfig::port(0)
    };
    assert!(error(group).contains("10.0.0.1 is no multicast group"));
}

#[test]
fn a_multicast_group_is_received_only_by_sources_that_joined_it() {
    let group = Ipv4Addr::new(239, 255, 77, 77);
    let on_loopback = UdpConfig {
        interface: Some("lo".to_owned()),
        ..UdpConfig::port(0)
    };
    let mut member = UdpSource::bind(&UdpConfig {
        multicast: Some(group),
        ..on_loopback.clone()
    })
    .unwrap();
    let sender = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
    sender.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).unwrap();
    let to = SocketAddrV4::new(group, member.local_addr().port());
    if let Err(error) = sender.send_to(b"all", &to.into()) {
        // Some sandboxes have no multicast on their loopback.
        eprintln!("SKIPPED: {error}");
        return;
    }
    let destinations: Vec<_> = member
        .receive_addressed(WAIT)
        .unwrap()
        .map(|one| one.destination)
        .collect();
    assert_eq!(destinations, [to]);
    let mut outsider = UdpSource::bind(&on_loopback).unwrap();
    let to = SocketAddrV4::new(group, outsider.local_addr().port());
    sender.send_to(b"all", &to.into()).unwrap();
    assert_eq!(outsider.receive(SOON).unwrap().count(), 0);
}

#[test]
fn the_buffer_holds_half_a_second_or_says_what_to_do() {
    assert_eq!(ample_buffer_bytes(), 9376 * buffer::CHARGED_BYTES);
    let small = ReceiveBuffer {
        wanted_bytes: ample_buffer_bytes(),
        granted_bytes: 425_984,
    };
    assert_eq!(
        (small.packets(), small.fastest_ms(), small.rmem_max()),
        (184, 9, 10_801_152)
    );
    let warning = small.warning(2368).unwrap();
    for part in [
        "port 2368",
        "425984 bytes",
        "9 ms",
        "sysctl -w net.core.rmem_max=10801152",
        "/etc/sysctl.d/",
    ] {
        assert!(warning.contains(part), "{warning}");
    }
    let ample = ReceiveBuffer {
        granted_bytes: ample_buffer_bytes(),
        ..small
    };
    assert_eq!(ample.warning(2368), None);
    // A VLP-16 with two returns sends 1508 packets a second: 184 last 122 ms, 1000 last 663 ms.
    let sensor = [Some(Model::Vlp16)];
    let warning = small.warning_for(2368, &sensor).unwrap();
    assert!(
        warning.contains("122 ms of a VLP-16 with two returns"),
        "{warning}"
    );
    let enough = ReceiveBuffer {
        granted_bytes: 1000 * buffer::CHARGED_BYTES,
        ..small
    };
    assert_eq!(enough.warning_for(2368, &sensor), None);
    assert!(enough.warning_for(2368, &[sensor[0]; 2]).is_some());
    let given = source(ample_buffer_bytes()).buffer();
    assert_eq!(given.is_too_small(), given.warning(1).is_some());
}
