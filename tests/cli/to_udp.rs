//! `--to`: the capture on the network again, to a socket of the test's own.

use std::collections::BTreeMap;
use std::net::UdpSocket;
use std::time::{Duration, Instant};

use sweepd_testkit::PATIENCE;

use crate::{Folder, Ran, command, fixture, made, replay};
use sweepd_testkit::free_port;

/// For 600 datagrams, each of which the kernel counts with 2.3 kB.
const BUFFER_BYTES: usize = 4 << 20;

/// Replays to a socket, and gives what arrived by the port that it came from, and how long it took.
fn received(
    capture: &std::path::Path,
    count: usize,
    options: &[&str],
) -> (BTreeMap<u16, Vec<Vec<u8>>>, Duration) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    // Room for all of it, should the reader have to wait for a core; the system may allow less.
    socket2::SockRef::from(&socket)
        .set_recv_buffer_size(BUFFER_BYTES)
        .unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let to = socket.local_addr().unwrap().to_string();
    let reader = std::thread::spawn(move || {
        let mut ports = BTreeMap::<u16, Vec<Vec<u8>>>::new();
        let mut buffer = [0; 2000];
        for _ in 0..count {
            let Ok((len, from)) = socket.recv_from(&mut buffer) else {
                break;
            };
            ports
                .entry(from.port())
                .or_default()
                .push(buffer[..len].to_vec());
        }
        ports
    });
    let begun = Instant::now();
    let args = [&["replay", capture.to_str().unwrap(), "--to", &to], options].concat();
    Ran::of(command(&args).output().unwrap()).done();
    let took = begun.elapsed();
    (reader.join().unwrap(), took)
}

#[test]
fn every_datagram_arrives_in_order_with_the_timing_of_the_capture() {
    let sent = made::vlp16();
    let (ports, took) = received(&fixture("street_vlp16_losses.pcap"), sent.len(), &[]);
    let arrived: Vec<_> = ports.into_values().collect();
    assert_eq!(arrived.len(), 1);
    let sent: Vec<Vec<u8>> = sent.into_iter().map(|sent| sent.payload).collect();
    assert!(arrived[0] == sent);
    assert!(took >= Duration::from_millis(390), "{took:?}");
}

#[test]
fn each_sensor_sends_from_a_port_of_its_own() {
    let folder = Folder::new("ports");
    let mut one = made::vlp16();
    // A position packet comes first, as it does now and then.
    let first = one.iter().position(|sent| !sent.is_data()).unwrap();
    one.drain(..first);
    let mut other = made::with_ports(&made::vlp16(), "192.168.1.9:2368", 2368);
    other.retain(|sent| sent.is_data());
    other.iter_mut().for_each(|sent| sent.payload[5] ^= 1);
    let both = made::together(&[&one, &other]);
    let path = folder.write("two.pcap", made::pcap(&both));
    let (ports, _) = received(&path, both.len(), &[]);
    let arrived: Vec<_> = ports.into_values().collect();
    assert_eq!(arrived.len(), 2);
    for of in [one, other] {
        let payloads: Vec<Vec<u8>> = of.into_iter().map(|sent| sent.payload).collect();
        assert!(arrived.contains(&payloads));
    }
}

#[test]
fn only_what_is_played_is_sent_and_the_clock_goes_on_in_a_loop() {
    let sent = made::vlp16();
    let start_ns = sent[0].arrival_ns;
    let played = sent
        .iter()
        .filter(|sent| (100_000_000..200_000_000).contains(&(sent.arrival_ns - start_ns)));
    let played: Vec<Vec<u8>> = played.map(|sent| sent.payload.clone()).collect();
    let first_position = played.iter().position(|one| one.len() == 512).unwrap();
    let options = [
        "--start",
        "0.1",
        "--end",
        "0.2",
        "--loop=12",
        "--speed",
        "4",
    ];
    let (ports, _) = received(
        &fixture("street_vlp16_losses.pcap"),
        12 * played.len(),
        &options,
    );
    let arrived = ports.into_values().next().unwrap();
    assert_eq!(arrived.len(), 12 * played.len());
    assert!(arrived[..played.len()] == played);
    // The clock goes on from round to round, and the time of the GPS receiver with it.
    let mut newest_us = None;
    for (payload, first) in arrived.iter().zip(played.iter().cycle()) {
        let at = if payload.len() == 1206 { 1200 } else { 0xC6 };
        let [stamp_us, first_us] =
            [payload, first].map(|bytes| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
        let mut same = payload.clone();
        same[at..at + 4].copy_from_slice(&first[at..at + 4]);
        if payload.len() == 1206 {
            // Some overtake others.
            let stamp_us = i64::from(stamp_us);
            let step_us = stamp_us - newest_us.replace(stamp_us).unwrap_or(stamp_us);
            assert!(step_us.abs() < 20_000, "{step_us}");
        } else {
            let [says, said] = [payload, first].map(|bytes| second(bytes));
            assert_eq!(
                (stamp_us / 1_000_000 + 60 - says) % 60,
                (first_us / 1_000_000 + 60 - said) % 60
            );
            same[0xCE..].copy_from_slice(&first[0xCE..]);
        }
        assert!(same == *first);
    }
    assert!(
        arrived
            .iter()
            .any(|one| one.len() == 512 && second(one) != second(&played[first_position]))
    );
}

/// The second of the minute in the sentence of a position packet, whose checksum is right.
fn second(payload: &[u8]) -> u32 {
    let text = std::str::from_utf8(&payload[0xCE..]).unwrap();
    let rmc = sweepd::wire::nmea::Rmc::parse(text.lines().next().unwrap()).unwrap();
    (rmc.utc_ns / 1_000_000_000 % 60) as u32
}

#[test]
fn a_port_without_a_listener_is_no_error() {
    let free = format!("127.0.0.1:{}", free_port());
    let options = ["--to", &free, "--speed", "max", "--no-timing"];
    let alone = replay(&fixture("street_vlp16_losses.pcap"), &["--no-timing"]).done();
    assert_eq!(
        replay(&fixture("street_vlp16_losses.pcap"), &options).done(),
        alone
    );
}
