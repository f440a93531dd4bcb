//! Files of frames: pcap and pcapng, plain or compressed, and the frames in them; ROS bags; what the
//! program that reads databases sends.

use std::io::{Cursor, ErrorKind};

use sweepd::admission::DiscoveredSensors;
use sweepd::input::db3::{Frame, MAX_MESSAGE_LEN};
use sweepd::input::{Capture, CaptureCounts, CaptureError, Decapsulator, LinkType, NoDatagram};

use super::Numbers;

/// Records that are looked at: a compressed file of a few bytes can hold a billion empty ones.
const MOST_RECORDS: u64 = 20_000;
/// The link types that are understood, and one that is not.
const LINKS: [u16; 11] = [0, 1, 12, 14, 101, 108, 113, 228, 229, 276, 147];

/// A capture is read to its end, or up to where it breaks off: every record is counted once.
pub fn capture(input: &[u8]) {
    read(Capture::new("fuzz", Box::new(Cursor::new(input.to_vec()))));
}

/// Frames of a database, one behind the other: what is read is written again, byte for byte.
pub fn frames(input: &[u8]) {
    let mut rest = input;
    loop {
        let before = rest;
        match Frame::read(&mut rest) {
            Ok(frame) => {
                let mut again = Vec::new();
                frame.write(&mut again).expect("memory");
                let read = &before[..before.len() - rest.len()];
                // The last frame has no text where there is nothing to say, but can be sent one.
                let is_same = again == read || matches!(frame, Frame::End { .. });
                assert!(is_same && again.len() as u64 <= 3 * (MAX_MESSAGE_LEN + 8));
            }
            Err(error) => {
                let kinds = [ErrorKind::UnexpectedEof, ErrorKind::InvalidData];
                return assert!(kinds.contains(&error.kind()), "{error}");
            }
        }
    }
}

fn read(opened: Result<Capture, CaptureError>) {
    let mut capture = match opened {
        Ok(capture) => capture,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let mut sensors = DiscoveredSensors::new(Vec::new());
    let mut datagrams = 0;
    loop {
        match capture.next_placed() {
            Ok(None) => break,
            Ok(Some(placed)) => {
                assert!(placed.datagram.payload.len() <= 65_535);
                let _ = sensors.admit_from(&placed.datagram, placed.topic);
                datagrams += 1;
            }
            Err(error) => panic!("memory cannot fail to be read: {error}"),
        }
        if capture.counts().records >= MOST_RECORDS {
            break;
        }
    }
    let tally = capture.counts();
    let CaptureCounts {
        records,
        not_ip,
        not_udp,
        truncated_records,
        fragments,
        unsupported_link,
        malformed,
        ..
    } = tally;
    assert_eq!(tally.datagrams, datagrams);
    let others = not_ip + not_udp + truncated_records + fragments + unsupported_link + malformed;
    assert_eq!(records, datagrams + others, "{tally:?}");
    if let Some(truncation) = capture.truncation() {
        assert!(!truncation.to_string().is_empty());
        assert!(
            capture
                .next_datagram()
                .expect("the end is no error")
                .is_none()
        );
    }
    assert!(capture.link_types().len() <= 16);
    let _ = (capture.first_ns(), capture.last_ns(), capture.record());
}

/// Frames, each with two bytes of length, one that chooses the link, one of time.
pub fn frame(input: &[u8]) {
    let mut numbers = Numbers(input);
    let mut decapsulator = Decapsulator::new();
    let mut time_ns = 0_i64;
    while !numbers.is_empty() {
        let (len, link, wait) = (usize::from(numbers.u16()), numbers.u8(), numbers.u8());
        let link = LinkType(LINKS[usize::from(link) % LINKS.len()]);
        time_ns = time_ns.saturating_add(i64::from(wait as i8) << 30);
        let frame = numbers.bytes(len);
        match decapsulator.decapsulate(link, frame, time_ns) {
            Ok(datagram) => {
                assert!(datagram.payload.len() <= 65_535 && datagram.arrival_ns == time_ns)
            }
            Err(NoDatagram::UnsupportedLink(of)) => {
                assert_eq!((of, of.to_string().is_empty()), (link, false))
            }
            Err(reason) => assert!(!reason.to_string().is_empty()),
        }
    }
}
