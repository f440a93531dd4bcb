//! A ring buffer between a socket and the disk, with one thread at each end, so that the receiving
//! thread never waits, not even for a lock.
//!
//! It holds 64-bit words. A datagram is three words of [`Heading`] and its payload, the last word
//! padded with zeroes. Only whole datagrams are visible to the consumer; one that does not fit is
//! refused.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use zerocopy::FromZeros;

use crate::input::write::Addressed;

const HEADING_WORDS: u64 = 3;
const WORD_LEN: usize = size_of::<u64>();

/// What both ends share.
#[derive(Debug)]
struct Shared {
    /// A power of two; untouched until needed, so that they take no memory before.
    words: Box<[AtomicU64]>,
    /// Words that were ever put in, and taken out.
    put: Apart,
    taken: Apart,
    closed: AtomicBool,
}

/// A counter in its own cache line, so that writing it does not slow the reader of the other one.
#[derive(Debug, Default)]
#[repr(align(64))]
struct Apart(AtomicU64);

/// The end at which datagrams are put in.
#[derive(Debug)]
pub struct Producer(Arc<Shared>);

/// The end at which they are taken out.
#[derive(Debug)]
pub struct Consumer {
    shared: Arc<Shared>,
    /// The payload taken last.
    payload: Vec<u8>,
}

/// A ring for at least this many bytes, headings included.
pub fn ring(bytes: usize) -> (Producer, Consumer) {
    let len = bytes.div_ceil(WORD_LEN).max(64).next_power_of_two();
    // Without memory this aborts, as `Vec` does.
    let words = <[AtomicU64]>::new_box_zeroed_with_elems(len).unwrap_or_else(|_| {
        std::iter::repeat_with(|| AtomicU64::new(0))
            .take(len)
            .collect()
    });
    let shared = Arc::new(Shared {
        words,
        put: Apart::default(),
        taken: Apart::default(),
        closed: false.into(),
    });
    (
        Producer(Arc::clone(&shared)),
        Consumer {
            shared,
            payload: Vec::new(),
        },
    )
}

/// All of a datagram but its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Heading {
    arrival_ns: i64,
    source: SocketAddrV4,
    destination: SocketAddrV4,
    len: u32,
}

impl Heading {
    fn words(self) -> [u64; HEADING_WORDS as usize] {
        let source = self.source;
        let destination = self.destination;
        let ips = u64::from(source.ip().to_bits()) << 32 | u64::from(destination.ip().to_bits());
        let rest = u64::from(source.port()) << 48
            | u64::from(destination.port()) << 32
            | u64::from(self.len);
        [self.arrival_ns as u64, ips, rest]
    }

    /// The heading that begins at a position.
    fn load(shared: &Shared, begin: u64) -> Self {
        let ips = shared.load(begin + 1);
        let rest = shared.load(begin + 2);
        Self {
            arrival_ns: shared.load(begin) as i64,
            source: SocketAddrV4::new(Ipv4Addr::from_bits((ips >> 32) as u32), (rest >> 48) as u16),
            destination: SocketAddrV4::new(Ipv4Addr::from_bits(ips as u32), (rest >> 32) as u16),
            len: rest as u32,
        }
    }
}

impl Shared {
    fn load(&self, position: u64) -> u64 {
        self.word(position).load(Ordering::Relaxed)
    }

    fn word(&self, position: u64) -> &AtomicU64 {
        &self.words[position as usize & (self.words.len() - 1)]
    }
}

impl Producer {
    /// Puts a datagram in, and says whether there was room. Neither waits nor allocates.
    pub fn put(&mut self, datagram: &Addressed<'_>) -> bool {
        let shared = &*self.0;
        let Ok(len) = u32::try_from(datagram.payload.len()) else {
            return false;
        };
        let begin = shared.put.0.load(Ordering::Relaxed);
        let end = begin + HEADING_WORDS + u64::from(len).div_ceil(WORD_LEN as u64);
        // Acquire: the consumer has read what it took before this overwrites it.
        if end - shared.taken.0.load(Ordering::Acquire) > shared.words.len() as u64 {
            return false;
        }
        let &Addressed {
            arrival_ns,
            source,
            destination,
            payload,
        } = datagram;
        let heading = Heading {
            arrival_ns,
            source,
            destination,
            len,
        }
        .words();
        let (whole, rest) = payload.as_chunks::<WORD_LEN>();
        let mut last = [0; WORD_LEN];
        last[..rest.len()].copy_from_slice(rest);
        let last = (!rest.is_empty()).then_some(last);
        let payload = whole.iter().copied().chain(last).map(u64::from_le_bytes);
        for (position, word) in (begin..end).zip(heading.into_iter().chain(payload)) {
            shared.word(position).store(word, Ordering::Relaxed);
        }
        // Release: a thread that sees this position also sees the words.
        shared.put.0.store(end, Ordering::Release);
        true
    }
}

impl Drop for Producer {
    fn drop(&mut self) {
        self.0.closed.store(true, Ordering::Release);
    }
}

impl Consumer {
    /// Words that were ever put in: a place to take up to.
    pub fn end(&self) -> u64 {
        self.shared.put.0.load(Ordering::Acquire)
    }

    /// Whether nothing is before a place that [`Consumer::end`] gave.
    pub fn is_at(&self, end: u64) -> bool {
        self.taken() >= end
    }

    /// Whether the producer is gone; check before the last call of [`Consumer::end`].
    pub fn is_closed(&self) -> bool {
        self.shared.closed.load(Ordering::Acquire)
    }

    /// Arrival of the next datagram before a place that [`Consumer::end`] gave.
    pub fn next_ns(&self, end: u64) -> Option<i64> {
        (!self.is_at(end)).then(|| self.shared.load(self.taken()) as i64)
    }

    /// Takes the next datagram before a place that [`Consumer::end`] gave.
    pub fn take(&mut self, end: u64) -> Option<Addressed<'_>> {
        if self.is_at(end) {
            return None;
        }
        let begin = self.taken();
        let heading = Heading::load(&self.shared, begin);
        let len = heading.len as usize;
        let behind = begin + HEADING_WORDS + len.div_ceil(WORD_LEN) as u64;
        self.payload.clear();
        for position in begin + HEADING_WORDS..behind {
            self.payload
                .extend_from_slice(&self.shared.load(position).to_le_bytes());
        }
        // Release: the words have been read before they are overwritten.
        self.shared.taken.0.store(behind, Ordering::Release);
        let Heading {
            arrival_ns,
            source,
            destination,
            ..
        } = heading;
        Some(Addressed {
            arrival_ns,
            source,
            destination,
            payload: &self.payload[..len],
        })
    }

    fn taken(&self) -> u64 {
        self.shared.taken.0.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ENDS: (&str, &str) = ("192.168.1.201:2368", "255.255.255.255:2369");

    fn addressed(arrival_ns: i64, payload: &[u8]) -> Addressed<'_> {
        Addressed {
            arrival_ns,
            source: ENDS.0.parse().unwrap(),
            destination: ENDS.1.parse().unwrap(),
            payload,
        }
    }

    proptest! {
        #[test]
        fn what_was_put_in_comes_out_and_what_was_refused_does_not(
            steps in prop::collection::vec((0..1300_usize, any::<i64>(), 0..3_u8), 1..200),
        ) {
            let (mut producer, mut consumer) = ring(8192);
            let mut waiting = std::collections::VecDeque::new();
            for (len, arrival_ns, takes) in steps {
                let payload = vec![len as u8; len];
                let words = |len: usize| 3 + len.div_ceil(8);
                let used: usize = waiting.iter().map(|(_, payload): &(i64, Vec<u8>)| words(payload.len())).sum();
                let has_room = used + words(len) <= 1024;
                prop_assert_eq!(producer.put(&addressed(arrival_ns, &payload)), has_room);
                if has_room {
                    waiting.push_back((arrival_ns, payload));
                }
                for _ in 0..takes {
                    let (end, expected) = (consumer.end(), waiting.pop_front());
                    prop_assert_eq!(consumer.next_ns(end), expected.as_ref().map(|(arrival_ns, _)| *arrival_ns));
                    let expected = expected.as_ref().map(|(arrival_ns, payload)| addressed(*arrival_ns, payload));
                    prop_assert_eq!(consumer.take(end), expected);
                }
            }
        }
    }

    #[test]
    fn two_threads_pass_on_a_million_words_in_order() {
        let (mut producer, mut consumer) = ring(4096);
        let producer = std::thread::spawn(move || {
            for number in 0..50_000_i64 {
                let payload = [number as u8; 257];
                let payload = &payload[..number as usize % 257];
                while !producer.put(&addressed(number, payload)) {
                    std::thread::yield_now();
                }
            }
        });
        let mut number = 0;
        loop {
            let (closed, end) = (consumer.is_closed(), consumer.end());
            while let Some(datagram) = consumer.take(end) {
                assert_eq!(
                    (datagram.arrival_ns, datagram.payload.len()),
                    (number, number as usize % 257)
                );
                assert!(datagram.payload.iter().all(|&byte| byte == number as u8));
                number += 1;
            }
            if closed {
                break;
            }
            std::thread::yield_now();
        }
        producer.join().unwrap();
        assert_eq!(number, 50_000);
    }
}
