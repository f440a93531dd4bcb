//! Between the sockets and the disk: a bounded queue, so that receiving never waits for writing.

use std::net::{SocketAddr, SocketAddrV4};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::wire::Datagram;
use crate::wire::position::POSITION_PACKET_LEN;

/// The disk is worth waking for, bytes.
const WORTH_WRITING: usize = 64 << 10;
/// The longest that datagrams wait for others.
const PATIENCE: Duration = Duration::from_millis(100);

/// Datagrams one after the other, in memory taken once.
pub struct Load {
    kept: Vec<Kept>,
    bytes: Vec<u8>,
    capacity: usize,
}

struct Kept {
    arrival_ns: i64,
    source: SocketAddrV4,
    destination_port: u16,
    len: usize,
}

impl Load {
    /// Room for so many bytes of packets, none of which is shorter than a position packet.
    pub fn new(capacity: usize) -> Self {
        let kept = Vec::with_capacity(capacity / POSITION_PACKET_LEN + 1);
        Self { kept, bytes: Vec::with_capacity(capacity), capacity }
    }

    /// Datagrams in it.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// The datagrams, in the order in which they were put in.
    pub fn datagrams(&self) -> impl Iterator<Item = (SocketAddrV4, Datagram<'_>)> {
        let mut rest = &self.bytes[..];
        self.kept.iter().map(move |kept| {
            let (payload, behind) = rest.split_at(kept.len);
            rest = behind;
            let (arrival_ns, destination_port) = (kept.arrival_ns, kept.destination_port);
            let source = SocketAddr::V4(kept.source);
            (kept.source, Datagram { arrival_ns, source, destination_port, payload })
        })
    }

    /// Forgets the datagrams and keeps the memory.
    pub fn clear(&mut self) {
        self.kept.clear();
        self.bytes.clear();
    }

    /// Whether there was room.
    fn put(&mut self, datagram: &Datagram<'_>) -> bool {
        let len = datagram.payload.len();
        let SocketAddr::V4(source) = datagram.source else { return false };
        if self.bytes.len() + len > self.capacity || self.kept.len() == self.kept.capacity() {
            return false;
        }
        let (arrival_ns, destination_port) = (datagram.arrival_ns, datagram.destination_port);
        self.kept.push(Kept { arrival_ns, source, destination_port, len });
        self.bytes.extend_from_slice(datagram.payload);
        true
    }
}

/// What waits for the disk. There are two loads: one is filled while the other is written, and then they change
/// places.
pub struct Queue {
    state: Mutex<State>,
    worth_writing: Condvar,
}

struct State {
    filling: Load,
    closed: bool,
}

impl Queue {
    /// An empty queue for so many bytes; as many again are being written.
    pub fn new(capacity: usize) -> Self {
        Self { state: Mutex::new(State { filling: Load::new(capacity), closed: false }), worth_writing: Condvar::new() }
    }

    /// Puts datagrams in without waiting for the disk, and says how many found no room.
    pub fn put<'a>(&self, datagrams: impl Iterator<Item = Datagram<'a>>) -> u64 {
        let mut state = self.state();
        let overflowed = datagrams.filter(|datagram| !state.filling.put(datagram)).count();
        if state.filling.bytes.len() >= WORTH_WRITING {
            self.worth_writing.notify_one();
        }
        overflowed as u64
    }

    /// Nothing more will be put in.
    pub fn close(&self) {
        self.state().closed = true;
        self.worth_writing.notify_one();
    }

    /// Waits until there is something to write, but not for long, and changes it for `written`, which is cleared. `false`
    /// when all has been taken and the queue is closed.
    pub fn take(&self, written: &mut Load) -> bool {
        written.clear();
        let waits = |state: &mut State| !state.closed && state.filling.bytes.len() < WORTH_WRITING;
        let state = self.worth_writing.wait_timeout_while(self.state(), PATIENCE, waits);
        let (mut state, _) = state.unwrap_or_else(PoisonError::into_inner);
        std::mem::swap(&mut state.filling, written);
        written.len() > 0 || !state.closed
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn datagram(arrival_ns: i64, payload: &[u8]) -> Datagram<'_> {
        Datagram { arrival_ns, source: "192.168.1.201:2368".parse().unwrap(), destination_port: 2368, payload }
    }

    #[test]
    fn what_is_put_in_comes_out_in_order_and_what_has_no_room_is_counted() {
        let payload = [7; 1206];
        let queue = Queue::new(10 * 1206);
        let mut load = Load::new(10 * 1206);
        let (mut next, mut taken) = (0, Vec::new());
        for (put, overflowed) in [(4, 0), (10, 0), (13, 3), (0, 0), (1, 0)] {
            let datagrams = (next..next + put).map(|number| datagram(number, &payload));
            assert_eq!(queue.put(datagrams), overflowed);
            next += put;
            assert!(queue.take(&mut load));
            assert!(load.datagrams().all(|(_, datagram)| datagram.payload == payload));
            taken.extend(load.datagrams().map(|(_, datagram)| datagram.arrival_ns));
        }
        let expected: Vec<_> = (0..28).filter(|number| !(24..27).contains(number)).collect();
        assert_eq!(taken, expected);
        queue.close();
        assert!(!queue.take(&mut load));
    }

    #[test]
    fn what_was_put_in_before_the_end_is_written() {
        let (queue, mut load) = (Queue::new(5000), Load::new(5000));
        queue.put([datagram(1, &[0; 512])].into_iter());
        queue.close();
        assert!(queue.take(&mut load));
        assert_eq!(load.len(), 1);
        assert!(!queue.take(&mut load));
    }

    #[test]
    fn neither_load_grows() {
        let (queue, mut load) = (Queue::new(5000), Load::new(5000));
        for _ in 0..5 {
            queue.put(std::iter::repeat_n(datagram(1, &[0; 512]), 100));
            queue.take(&mut load);
            assert_eq!((load.bytes.capacity(), load.len()), (5000, 9));
        }
    }
}
