//! A reader: the writers that it matches, and what is there of their samples (section 8.4).
//!
//! State without sockets. Samples of a writer go into the [`Inbox`] in their order, those of a reliable
//! one without holes; the newest stay there. Fragments are taken in their order, too: what comes after a
//! lost one is asked for again, or lost. Memory is taken for bytes that came, never for a length that was
//! announced, and all of it is bounded.

use super::discovery::{Endpoint, Place};
use super::flow::lock;
use super::received::{Received, WINDOW};
use super::terms::Terms;
use super::wire::{Ack, Data, Fragments, Guid, NumberSet, Part, SampleId};
use crate::log;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, Thread};
use std::time::Instant;

/// Writers that a reader takes samples of.
pub const MAX_WRITERS: usize = 128;

/// Samples of the largest size that there is room for: in the inbox, and once more for what waits before
/// it.
pub const ROOM: usize = 4;

/// The smallest sample: its encapsulation.
const SMALLEST_BYTES: usize = 4;

/// A sample that came.
#[derive(Debug, PartialEq, Eq)]
pub struct Sample {
    /// Which it is.
    pub id: SampleId,
    /// Its bytes, encapsulation included.
    pub payload: Vec<u8>,
    /// Form of its writer's requests: [`Endpoint::has_request_header`].
    pub has_request_header: bool,
}

/// Samples that wait to be taken: the newest.
pub struct Inbox {
    queue: Mutex<Queue>,
    depth: usize,
    bytes: usize,
    /// Writers that the reader matches.
    pub writers: AtomicUsize,
}

impl Inbox {
    fn new(depth: usize, bytes: usize) -> Self {
        Self {
            queue: Mutex::default(),
            depth,
            bytes,
            writers: AtomicUsize::new(0),
        }
    }

    fn put(&self, sample: Sample) {
        let mut queue = lock(&self.queue);
        queue.bytes += sample.payload.len();
        queue.samples.push_back(sample);
        while queue.samples.len() > self.depth || queue.bytes > self.bytes {
            let oldest = queue.samples.pop_front();
            queue.bytes -= oldest.map_or(0, |oldest| oldest.payload.len());
        }
        if let Some(taker) = queue.taker.take() {
            taker.unpark();
        }
    }

    /// Takes the oldest. Where there is none, the thread is unparked when one comes.
    pub fn take(&self) -> Option<Sample> {
        let mut queue = lock(&self.queue);
        let oldest = queue.samples.pop_front();
        match &oldest {
            Some(oldest) => queue.bytes -= oldest.payload.len(),
            None => queue.taker = Some(thread::current()),
        }
        oldest
    }
}

/// What waits in an [`Inbox`].
#[derive(Default)]
struct Queue {
    samples: VecDeque<Sample>,
    /// Those of the samples.
    bytes: usize,
    /// Who found nothing.
    taker: Option<Thread>,
}

/// A sample that has not come whole, or waits for one before it.
struct Waiting {
    bytes: Vec<u8>,
    of: Fragments,
    /// The fragment that comes next.
    next: u32,
}

impl Waiting {
    fn new(of: Fragments) -> Self {
        Self {
            bytes: vec![],
            of,
            next: 1,
        }
    }

    fn is_whole(&self) -> bool {
        self.bytes.len() == self.of.sample_bytes
    }

    /// Takes fragments, if they are those that come next.
    fn add(&mut self, part: Part, bytes: &[u8]) {
        if self.of != part.of && part.first == 1 && !self.is_whole() {
            *self = Self::new(part.of);
        }
        if self.of == part.of && self.next == part.first && !self.is_whole() {
            self.bytes.extend(bytes);
            self.next += part.count;
        }
    }
}

/// A writer that the reader matches.
struct Source {
    /// Where it hears what we miss.
    place: Place,
    has_request_header: bool,
    received: Received,
    waiting: BTreeMap<u64, Waiting>,
    /// Of all that waits.
    bytes: usize,
}

impl Source {
    /// Takes a part of a sample that is missing. Says whether the sample is whole now.
    fn add(&mut self, number: u64, part: Part, bytes: &[u8]) -> bool {
        if part.first > 1 && !self.waiting.contains_key(&number) {
            return false;
        }
        let waiting = self.waiting.entry(number);
        let waiting = waiting.or_insert_with(|| Waiting::new(part.of));
        self.bytes -= waiting.bytes.len();
        waiting.add(part, bytes);
        self.bytes += waiting.bytes.len();
        waiting.is_whole()
    }

    /// Puts the samples that wait for none before them into the inbox, and drops those that are given up.
    fn settle(&mut self, writer: Guid, inbox: &Inbox) {
        while let Some(oldest) = self.waiting.first_entry()
            && *oldest.key() < self.received.next
        {
            let (number, waiting) = oldest.remove_entry();
            self.bytes -= waiting.bytes.len();
            if waiting.is_whole() {
                inbox.put(Sample {
                    id: SampleId { writer, number },
                    payload: waiting.bytes,
                    has_request_header: self.has_request_header,
                });
            }
        }
    }

    /// Waits no longer for what keeps the oldest sample waiting.
    fn give_up(&mut self, writer: Guid, inbox: &Inbox) {
        if let Some((number, waiting)) = self.waiting.first_key_value() {
            let is_lost = u64::from(!waiting.is_whole());
            self.received.skip_to(number + is_lost);
            self.settle(writer, inbox);
        }
    }
}

/// The reader.
pub struct Reader {
    /// Which of ours.
    pub guid: Guid,
    /// What it asks for.
    pub terms: Terms,
    /// Where its samples wait.
    pub inbox: Arc<Inbox>,
    largest_bytes: usize,
    sources: BTreeMap<Guid, Source>,
    /// It was told that a sample is too large.
    told_large: bool,
    /// It was told that there are too many writers.
    told_full: bool,
    /// There was no room for a writer, since [`Reader::has_room_again`] was asked.
    has_refused: bool,
}

impl Reader {
    /// A reader without writers. Samples of more than `largest_bytes` are refused.
    pub fn new(guid: Guid, terms: Terms, largest_bytes: usize) -> Self {
        Self {
            guid,
            inbox: Arc::new(Inbox::new(terms.depth, ROOM * largest_bytes)),
            terms,
            largest_bytes,
            sources: BTreeMap::new(),
            told_large: false,
            told_full: false,
            has_refused: false,
        }
    }

    /// A writer is there, or is at another place now. Says what it is asked, and where, unless there is no room
    /// for it.
    pub fn add_writer(&mut self, writer: &Endpoint, now: Instant) -> Option<(Ack, Place)> {
        let (place, has_request_header) = (writer.place, writer.has_request_header);
        if let Some(known) = self.sources.get_mut(&writer.guid) {
            (known.place, known.has_request_header) = (place, has_request_header);
            return self.asked(writer.guid);
        }
        if self.sources.len() == MAX_WRITERS {
            self.has_refused = true;
            if !std::mem::replace(&mut self.told_full, true) {
                log::warn(format_args!(
                    "{}: {MAX_WRITERS} publishers are known, the most that there is room for: others are not \
                     heard until some leave",
                    self.terms.ros_topic()
                ));
            }
            return None;
        }
        let source = Source {
            place,
            has_request_header,
            received: Received::new(now),
            waiting: BTreeMap::new(),
            bytes: 0,
        };
        self.sources.insert(writer.guid, source);
        self.writer_count_changed();
        self.asked(writer.guid)
    }

    /// Acknowledgement for a writer, and its place. A reader that is not reliable sends none.
    fn asked(&self, writer: Guid) -> Option<(Ack, Place)> {
        let source = self.sources.get(&writer).filter(|_| self.terms.reliable)?;
        Some((source.received.ack(), source.place))
    }

    /// The writers that are to be asked again what they have.
    pub fn asks_again(&mut self, now: Instant) -> Vec<(Guid, Ack, Place)> {
        let sources = self.sources.iter_mut().filter(|_| self.terms.reliable);
        let ask = |(guid, source): (&Guid, &mut Source)| {
            source.received.asks_again(now)?;
            Some((*guid, source.received.ack(), source.place))
        };
        sources.filter_map(ask).collect()
    }

    /// Writers that are no more: one, or those of a participant.
    pub fn remove_writers(&mut self, gone: impl Fn(Guid) -> bool) {
        self.sources.retain(|guid, _| !gone(*guid));
        self.writer_count_changed();
    }

    /// Whether there is room, once, for writers that found none.
    pub fn has_room_again(&mut self) -> bool {
        self.sources.len() < MAX_WRITERS && std::mem::take(&mut self.has_refused)
    }

    fn writer_count_changed(&self) {
        let writers = &self.inbox.writers;
        writers.store(self.sources.len(), Ordering::Relaxed);
    }

    /// A writer sends a sample, or a part of one.
    pub fn data(&mut self, from: Guid, data: &Data) {
        let Some(source) = self.sources.get_mut(&from) else {
            return;
        };
        let number = data.number;
        if !self.terms.reliable {
            // What has not come by now was lost.
            source.received.skip_to((number + 1).saturating_sub(WINDOW));
        }
        if !source.received.wants(number) {
            return;
        }
        let part = data.part.unwrap_or(Part::all(data.payload.len()));
        let size = part.of.sample_bytes;
        if data.disposed || size < SMALLEST_BYTES || size > self.largest_bytes {
            // As if it had come: it would be asked for for ever.
            source.received.insert(number);
            source.settle(from, &self.inbox);
            self.tell_large(size);
            return;
        }
        let Some(bytes) = part.bytes(data.payload).filter(|bytes| !bytes.is_empty()) else {
            return;
        };
        if source.add(number, part, bytes) {
            if !self.terms.reliable {
                source.received.skip_to(number);
            }
            source.received.insert(number);
            source.settle(from, &self.inbox);
        }
        self.bound(from);
    }

    /// Gives up what there is no room for. Behind a missing sample of a writer, as many wait as would push
    /// it out of the inbox; of all writers, the one with the most bytes loses.
    fn bound(&mut self, from: Guid) {
        if let Some(source) = self.sources.get_mut(&from)
            && source.waiting.len() > self.terms.depth
        {
            source.give_up(from, &self.inbox);
        }
        while self.waiting_bytes() > ROOM * self.largest_bytes
            && let Some((guid, source)) = self.sources.iter_mut().max_by_key(|(_, one)| one.bytes)
        {
            source.give_up(*guid, &self.inbox);
        }
    }

    fn waiting_bytes(&self) -> usize {
        self.sources.values().map(|source| source.bytes).sum()
    }

    fn tell_large(&mut self, bytes: usize) {
        if bytes > self.largest_bytes && !std::mem::replace(&mut self.told_large, true) {
            log::warn(format_args!(
                "{}: a message of {bytes} bytes is refused, and others like it: at most {} are taken",
                self.terms.ros_topic(),
                self.largest_bytes
            ));
        }
    }

    /// A writer says what it has: what is missing of it, and where to say so.
    pub fn heartbeat(&mut self, from: Guid, first: u64, last: u64) -> Option<(Ack, Place)> {
        if let Some(source) = self.sources.get_mut(&from).filter(|_| self.terms.reliable) {
            source.received.heartbeat(first, last);
            source.settle(from, &self.inbox);
        }
        self.asked(from)
    }

    /// A writer says what it will never send.
    pub fn gap(&mut self, from: Guid, first: u64, more: &NumberSet) {
        if let Some(source) = self.sources.get_mut(&from) {
            source.received.gap(first, more);
            source.settle(from, &self.inbox);
        }
    }
}

#[cfg(any(test, fuzzing))]
impl Reader {
    /// Fails where there is more than there is room for. Capacities grow by doubling.
    pub fn check_bounds(&self) {
        assert!(self.sources.len() <= MAX_WRITERS);
        let room = ROOM * self.largest_bytes;
        assert!(self.waiting_bytes() <= room);
        for source in self.sources.values() {
            let waiting = source.waiting.values();
            let (bytes, capacity) = waiting.fold((0, 0), |(bytes, capacity), one| {
                (bytes + one.bytes.len(), capacity + one.bytes.capacity())
            });
            assert_eq!(bytes, source.bytes);
            assert!(capacity <= 2 * bytes + 8 * source.waiting.len());
            assert!(source.waiting.len() <= self.terms.depth);
            assert!((source.received.ahead() as u64) < WINDOW);
        }
        let queue = lock(&self.inbox.queue);
        let bytes = queue.samples.iter().map(|sample| sample.payload.len());
        assert_eq!(bytes.sum::<usize>(), queue.bytes);
        assert!(queue.samples.len() <= self.terms.depth && queue.bytes <= room);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rtps::discovery::Side;
    use crate::rtps::wire::ANY_READER;
    use std::net::{Ipv4Addr, SocketAddrV4};

    const LARGEST: usize = 1000;

    fn writer(id: u8) -> Guid {
        Guid::new([id; 12], [0, 0, 1, 3])
    }

    /// A reader that keeps so many samples, of these writers.
    fn reader(reliable: bool, depth: usize, writers: &[Guid]) -> Reader {
        let terms = Terms {
            topic: "rt/odom".to_owned(),
            type_name: "nav_msgs::msg::dds_::Odometry_".to_owned(),
            type_hash: "RIHS01_0",
            reliable,
            transient_local: false,
            depth,
            lifespan: None,
            is_sole: false,
        };
        let mut reader = Reader::new(Guid::new([9; 12], [0, 0, 1, 4]), terms, LARGEST);
        for guid in writers {
            let place = Place {
                address: SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9),
                near: true,
            };
            let mut writer = Endpoint::builtin_reader([0; 12], Side::Writers, place);
            writer.guid = *guid;
            assert_eq!(
                reader.add_writer(&writer, Instant::now()).is_some(),
                reliable
            );
        }
        reader
    }

    fn sample(number: u64, bytes: usize) -> Vec<u8> {
        (0..bytes).map(|at| (number as usize + at) as u8).collect()
    }

    fn send(reader: &mut Reader, from: Guid, number: u64, part: Option<Part>, payload: &[u8]) {
        let data = Data {
            reader: ANY_READER,
            writer: from.entity,
            number,
            key: None,
            disposed: false,
            part,
            payload,
        };
        reader.data(from, &data);
        reader.check_bounds();
    }

    fn send_whole(reader: &mut Reader, from: Guid, number: u64) {
        send(reader, from, number, None, &sample(number, 100));
    }

    /// Sends fragments of 100 bytes: of so many from the one of that number on.
    fn send_part(
        reader: &mut Reader,
        from: Guid,
        number: u64,
        bytes: usize,
        [first, count]: [u32; 2],
    ) {
        let of = Fragments {
            fragment_bytes: 100,
            sample_bytes: bytes,
        };
        let whole = sample(number, bytes);
        let at = 100 * (first as usize - 1);
        let mut payload = whole[at..bytes.min(at + 100 * count as usize)].to_vec();
        // Padding.
        payload.resize(payload.len().next_multiple_of(4), 99);
        send(
            reader,
            from,
            number,
            Some(Part { first, count, of }),
            &payload,
        );
    }

    fn taken(reader: &Reader) -> Vec<u64> {
        let mut numbers = vec![];
        while let Some(one) = reader.inbox.take() {
            assert_eq!(one.payload, sample(one.id.number, one.payload.len()));
            numbers.push(one.id.number);
        }
        numbers
    }

    fn missing(reader: &mut Reader, from: Guid, first: u64, last: u64) -> Vec<u64> {
        let (ack, _) = reader.heartbeat(from, first, last).unwrap();
        ack.missing.iter().collect()
    }

    #[test]
    fn a_reliable_reader_gets_all_in_order() {
        let from = writer(1);
        let mut reader = reader(true, 10, &[from]);
        // It is late: the writer has samples from 41 on.
        send_whole(&mut reader, from, 42);
        assert_eq!(taken(&reader), []);
        assert_eq!(missing(&mut reader, from, 41, 45), [41, 43, 44, 45]);
        send_part(&mut reader, from, 43, 350, [1, 2]);
        send_part(&mut reader, from, 43, 350, [4, 1]);
        send_whole(&mut reader, from, 45);
        assert_eq!(taken(&reader), []);
        send_whole(&mut reader, from, 41);
        send_whole(&mut reader, from, 41);
        assert_eq!(taken(&reader), [41, 42]);
        assert_eq!(missing(&mut reader, from, 41, 45), [43, 44]);
        reader.gap(from, 44, &NumberSet::new(45));
        // Of what is sent again, the fragments that it has.
        send_part(&mut reader, from, 43, 350, [1, 1]);
        send_part(&mut reader, from, 43, 350, [3, 2]);
        assert_eq!(taken(&reader), [43, 45]);
        assert_eq!(missing(&mut reader, from, 41, 45), []);
        // What left the writer's history is not waited for.
        send_whole(&mut reader, from, 48);
        assert_eq!(missing(&mut reader, from, 47, 48), [47]);
        reader.gap(from, 47, &NumberSet::new(48));
        assert_eq!(taken(&reader), [48]);
    }

    #[test]
    fn a_best_effort_reader_gets_what_comes() {
        let from = writer(1);
        let mut reader = reader(false, 10, &[from]);
        send_part(&mut reader, from, 5, 350, [1, 4]);
        send_part(&mut reader, from, 6, 350, [1, 2]);
        send_whole(&mut reader, from, 7);
        send_part(&mut reader, from, 6, 350, [3, 2]);
        send_whole(&mut reader, from, 7);
        send_whole(&mut reader, from, 1 << 40);
        assert_eq!(taken(&reader), [5, 7, 1 << 40]);
        assert!(reader.heartbeat(from, 1, 1 << 41).is_none());
        assert!(reader.sources[&from].waiting.is_empty());
        // A stranger.
        send_whole(&mut reader, writer(2), 1);
        assert_eq!(taken(&reader), []);
    }

    #[test]
    fn the_newest_wait_and_what_there_is_no_room_for_is_given_up() {
        let from = writer(1);
        let mut reader = reader(true, 3, &[from]);
        (1..=5).for_each(|number| send_whole(&mut reader, from, number));
        assert_eq!(taken(&reader), [3, 4, 5]);
        // The fourth behind a missing one would push it out.
        (7..=9).for_each(|number| send_whole(&mut reader, from, number));
        assert_eq!(taken(&reader), []);
        send_whole(&mut reader, from, 10);
        assert_eq!(taken(&reader), [8, 9, 10]);
        // One that is too large is as one that will never come.
        send(&mut reader, from, 11, None, &sample(11, LARGEST + 1));
        send(&mut reader, from, 12, None, &[]);
        send_whole(&mut reader, from, 13);
        assert_eq!(taken(&reader), [13]);
        assert_eq!(missing(&mut reader, from, 1, 13), []);
    }

    #[test]
    fn of_many_writers_those_lose_that_take_most() {
        let writers: Vec<Guid> = (1..=120).map(writer).collect();
        let mut reader = reader(true, 10, &writers);
        send_part(&mut reader, writers[0], 1, 900, [1, 3]);
        // Each sends all but the last fragment, again and again.
        for round in 0..20 {
            for from in &writers[1..] {
                send_part(&mut reader, *from, 1 + round, 1000, [1, 9]);
            }
        }
        send_part(&mut reader, writers[0], 1, 900, [4, 6]);
        assert_eq!(taken(&reader), [1]);
        reader.remove_writers(|guid| guid != writers[0]);
        assert_eq!((reader.sources.len(), reader.waiting_bytes()), (1, 0));
    }

    #[test]
    fn fragments_that_make_no_sense_change_nothing() {
        let from = writer(1);
        let mut reader = reader(true, 3, &[from]);
        for (first, count, fragment_bytes, sample_bytes) in [
            (0, 1, 100, 900),
            (1, 0, 100, 900),
            (1, 1, 0, 900),
            (1, 3, 100, 900),
            (u32::MAX, 65_535, 65_535, 900),
            (10, 1, 100, 900),
            (2, 1, 100, 900),
        ] {
            let of = Fragments {
                fragment_bytes,
                sample_bytes,
            };
            let part = Part { first, count, of };
            send(&mut reader, from, 1, Some(part), &[0; 200]);
            assert!(reader.sources[&from].waiting.is_empty(), "{part:?}");
        }
        // Another size from the first fragment on: the sample begins anew.
        send_part(&mut reader, from, 1, 900, [1, 2]);
        send_part(&mut reader, from, 1, 800, [3, 2]);
        send_part(&mut reader, from, 1, 800, [1, 8]);
        assert_eq!(taken(&reader), [1]);
    }
}
