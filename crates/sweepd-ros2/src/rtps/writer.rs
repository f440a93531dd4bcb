//! A writer: its history, the readers that it matches, and what those have (section 8.4).
//!
//! State without sockets. Small messages and deliveries that follow from what happens are put into
//! an [`Outbox`]; no reader is waited for. A reader that asks for what the history no longer has
//! gets a gap.

use super::discovery::{Endpoint, Place};
use super::flow::{Delivery, Kind, Link, Progress, Pulse, Step};
use super::sample::{Body, Sample};
use super::wire::{Ack, Guid, Message, NumberSet, Prefix};
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

/// First time after which a reader is asked what it has; doubled while it does not answer.
const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(100);

/// Longest such time.
const LONGEST_INTERVAL: Duration = Duration::from_secs(3);

/// Shortest time between two repairs of a sample for a reader.
const REPAIR_INTERVAL: Duration = Duration::from_millis(20);

/// Time in which a reader must acknowledge something.
const HEARD_WITHIN: Duration = Duration::from_secs(10);

/// Messages, and repairs, that follow from one datagram or one tick.
pub const OUTBOX: usize = 1024;

/// Old buffers that are kept for new samples.
const SPARE_BUFFERS: usize = 2;

/// What others see of a writer without its lock.
#[derive(Debug, Default)]
pub struct Counters {
    /// Readers that it matches.
    pub readers: AtomicUsize,
    /// Samples that were sent to someone.
    pub written: AtomicU64,
    /// Times that a reader asked for a sample or its fragments, and got them.
    pub repaired: AtomicU64,
}

/// A reader, and what became of the samples for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReaderCount {
    /// Which reader.
    pub guid: Guid,
    /// Where it gets its samples.
    pub place: Place,
    /// Samples that it lost, because its socket was full for too long.
    pub skipped: u64,
}

/// What is to be sent: small messages at once, samples when there is room. There is an end to
/// what one datagram can ask for; readers ask again.
#[derive(Default)]
pub struct Outbox {
    /// Messages, and where they go.
    pub messages: Vec<(SocketAddrV4, Message)>,
    /// Samples that are sent again.
    pub repairs: Vec<Delivery>,
}

impl Outbox {
    /// Adds a message.
    pub fn message(&mut self, to: SocketAddrV4, message: Message) {
        if self.messages.len() < OUTBOX {
            self.messages.push((to, message));
        }
    }

    fn repair(&mut self, repair: Delivery) {
        if self.repairs.len() < OUTBOX {
            self.repairs.push(repair);
        }
    }
}

struct Reader {
    link: Arc<Link>,
    reliable: bool,
    names_hash: bool,
    /// Its participant has acknowledged something from its host. Nothing goes to anyone else: the
    /// address may be another's.
    is_confirmed: bool,
    /// Moment at which it was there first.
    since: Instant,
    /// It gets no sample before this.
    from: u64,
    /// It has all up to this.
    acknowledged: u64,
    /// Set when it has acknowledged something, or asked for something.
    has_answered: bool,
    /// Set while it asks what there is, and has got no answer.
    asks: bool,
    /// When it was asked last, or last said something new.
    asked: Instant,
    /// It is asked again that much later.
    interval: Duration,
    skipped: u64,
    /// It has still to get the history, once it has acknowledged something.
    is_owed: bool,
    /// A sample whose rest is sent to it behind the writer. It gets no other meanwhile.
    under_way: Weak<()>,
    /// When samples were last sent again, of late.
    repaired: BTreeMap<u64, Instant>,
}

impl Reader {
    /// Whether a sample is to be sent again: not if that was done a moment ago. What the reader
    /// asks for twice is on its way.
    fn wants(&mut self, number: u64, now: Instant) -> bool {
        let last = self.repaired.get(&number);
        let wants = last.is_none_or(|last| now.duration_since(*last) > REPAIR_INTERVAL);
        if wants {
            self.repaired.insert(number, now);
        }
        wants
    }

    fn is_busy(&self) -> bool {
        self.under_way.strong_count() > 0
    }

    fn ask_after(&mut self, interval: Duration, now: Instant) {
        self.interval = interval;
        self.asked = now;
    }
}

/// The writer.
pub struct Writer {
    /// Which of ours.
    pub guid: Guid,
    /// Held from the number of a sample to its end: samples follow one another.
    pub turn: Arc<Mutex<()>>,
    /// For all to see.
    pub counters: Arc<Counters>,
    transient_local: bool,
    depth: usize,
    lifespan: Option<Duration>,
    history: VecDeque<Arc<Sample>>,
    /// Number of the newest sample that is sent, or was not sent for want of readers.
    complete: u64,
    readers: BTreeMap<Guid, Reader>,
    heartbeats: Arc<AtomicU32>,
    spare: Vec<Vec<u8>>,
}

impl Writer {
    /// A writer without samples and readers.
    pub fn new(
        guid: Guid,
        transient_local: bool,
        depth: usize,
        lifespan: Option<Duration>,
    ) -> Self {
        Self {
            guid,
            turn: Arc::default(),
            counters: Arc::default(),
            transient_local,
            depth,
            lifespan,
            history: VecDeque::new(),
            complete: 0,
            readers: BTreeMap::new(),
            heartbeats: Arc::default(),
            spare: vec![],
        }
    }

    /// Number of the oldest sample in the history.
    fn first(&self) -> u64 {
        let oldest = self.history.front();
        oldest.map_or(self.complete + 1, |sample| sample.number)
    }

    fn pulse(&self, first: u64, last: u64) -> Pulse {
        Pulse {
            first,
            last,
            count: Arc::clone(&self.heartbeats),
        }
    }

    fn reader_count_changed(&self) {
        let readers = self.readers.values().filter(|one| one.is_confirmed);
        let readers = readers.count();
        self.counters.readers.store(readers, Ordering::Relaxed);
    }

    /// A reader is there, or is at another place now. A late one gets the history, where both
    /// sides want that.
    pub fn add_reader(
        &mut self,
        data: &Endpoint,
        link: Arc<Link>,
        is_confirmed: bool,
        now: Instant,
        out: &mut Outbox,
    ) {
        if let Some(known) = self.readers.get_mut(&data.guid) {
            (known.link, known.is_confirmed) = (link, is_confirmed);
            self.reader_count_changed();
            return;
        }
        let late = self.transient_local && data.transient_local;
        let newest = self.history.back().map_or(0, |sample| sample.number);
        let from = if late {
            1
        } else {
            newest.max(self.complete) + 1
        };
        let place = link.place;
        let reader = Reader {
            link,
            reliable: data.reliable,
            names_hash: data.names_hash,
            is_confirmed,
            since: now,
            from,
            acknowledged: from - 1,
            has_answered: false,
            asks: false,
            asked: now,
            interval: HEARTBEAT_INTERVAL,
            skipped: 0,
            is_owed: late,
            under_way: Weak::new(),
            repaired: BTreeMap::new(),
        };
        self.readers.insert(data.guid, reader);
        self.reader_count_changed();
        if late && is_confirmed {
            self.send_history(data.guid, now, out);
        } else if data.reliable {
            let mut message = Message::to(self.guid.prefix, data.guid.prefix);
            let pulse = match late {
                true => self.pulse(self.first(), self.complete),
                false => self.pulse(from, from - 1),
            };
            message.heartbeat(data.guid.entity, self.guid.entity, pulse.beat());
            if from > 1 {
                message.gap(data.guid.entity, self.guid.entity, 1, from);
            }
            out.message(place.address, message);
        }
    }

    /// A participant has acknowledged something, from a host: its readers there get samples.
    pub fn confirm(&mut self, prefix: Prefix, host: Ipv4Addr, now: Instant, out: &mut Outbox) {
        let mut owed = vec![];
        for (guid, reader) in &mut self.readers {
            if guid.prefix == prefix && reader.link.place.host() == host && !reader.is_confirmed {
                reader.is_confirmed = true;
                owed.extend(reader.is_owed.then_some(*guid));
            }
        }
        for reader in owed {
            self.send_history(reader, now, out);
        }
        self.reader_count_changed();
    }

    /// Gives a reader what was written before it was there.
    fn send_history(&mut self, to: Guid, now: Instant, out: &mut Outbox) {
        if let Some(reader) = self.readers.get_mut(&to) {
            reader.is_owed = false;
        }
        let samples: Vec<u64> = self.history.iter().map(|sample| sample.number).collect();
        for number in samples {
            self.repair(to, number, None, now, out);
        }
    }

    /// Readers that are no more: one, or those of a participant.
    pub fn remove_readers(&mut self, gone: impl Fn(Guid) -> bool) {
        self.readers.retain(|guid, _| !gone(*guid));
        self.reader_count_changed();
        if self.readers.is_empty() && !self.transient_local {
            self.history.clear();
        }
    }

    /// An old buffer to write a new sample into, empty.
    pub fn buffer(&mut self) -> Vec<u8> {
        self.spare.pop().unwrap_or_default()
    }

    /// Gives a sample its number, and says to whom it goes. None where no reader gets it, now or
    /// later. The turn must be held until [`Writer::finish`].
    pub fn begin(&mut self, body: Body) -> Option<Vec<Delivery>> {
        if self.readers.is_empty() && !self.transient_local {
            return None;
        }
        let sample = Arc::new(Sample::new(self.complete + 1, body));
        // Best-effort readers ask for nothing again.
        let reliable = self.readers.values().any(|reader| reader.reliable);
        let keep = reliable || self.transient_local;
        if keep {
            self.history.push_back(Arc::clone(&sample));
        }
        let depth = if keep { self.depth } else { 0 };
        while self.history.len() > depth
            && let Some(old) = self.history.pop_front()
        {
            self.recycle(old);
        }
        for (guid, reader) in &mut self.readers {
            reader.skipped += u64::from(reader.is_busy() && sample.is_for(*guid));
        }
        let mut deliveries: Vec<Delivery> = vec![];
        let mut by_way: HashMap<*const Link, usize> = HashMap::new();
        for (guid, reader) in &self.readers {
            if !reader.is_confirmed || reader.is_busy() || !sample.is_for(*guid) {
                continue;
            }
            let by_reader = matches!(sample.body, Body::ByReader { .. });
            let pulse = || self.pulse(self.first(), sample.number);
            let way = Arc::as_ptr(&reader.link);
            if let Some(&same_place) = by_way.get(&way).filter(|_| !by_reader) {
                // It goes there already, for any reader.
                let delivery = &mut deliveries[same_place];
                if reader.reliable && delivery.pulse.is_none() {
                    delivery.pulse = Some(pulse());
                }
                continue;
            }
            by_way.insert(way, deliveries.len());
            let to = by_reader.then_some(*guid);
            let mut delivery = self.delivery(to, reader, &sample);
            delivery.pulse = reader.reliable.then(pulse);
            deliveries.push(delivery);
        }
        Some(deliveries)
    }

    /// The sample is sent; `ended` says how each delivery did. Returns those to go on with behind
    /// the writer.
    pub fn finish(&mut self, ended: Vec<(Delivery, Step)>, now: Instant) -> Vec<Delivery> {
        self.complete += 1;
        for reader in self.readers.values_mut() {
            reader.ask_after(HEARTBEAT_INTERVAL, now);
        }
        if !ended.is_empty() {
            self.counters.written.fetch_add(1, Ordering::Relaxed);
        }
        let (mut slow, mut sent, mut lost) = (vec![], None, vec![]);
        let mut under_way = HashMap::new();
        for (mut delivery, step) in ended {
            match step {
                Step::Slow => {
                    delivery.kind = Kind::Rest;
                    let one = Arc::downgrade(&delivery.under_way);
                    under_way.insert(Arc::as_ptr(&delivery.link), one);
                    slow.push(delivery);
                    continue;
                }
                Step::Lost => lost.push(delivery.link),
                Step::Sent | Step::Waits | Step::Done | Step::Gone => {}
            }
            sent = Some(delivery.sample);
        }
        for reader in self.readers.values_mut() {
            if let Some(one) = under_way.get(&Arc::as_ptr(&reader.link)) {
                reader.under_way = Weak::clone(one);
            }
        }
        self.lost(&lost);
        if let Some(sample) = sent {
            self.recycle(sample);
        }
        slow
    }

    /// Readers at the ends of these ways have lost a sample. There may be thousands of both.
    pub fn lost(&mut self, ways: &[Arc<Link>]) {
        let ways: HashSet<*const Link> = ways.iter().map(Arc::as_ptr).collect();
        let readers = self.readers.values_mut();
        for reader in readers.filter(|one| ways.contains(&Arc::as_ptr(&one.link))) {
            reader.skipped += 1;
        }
    }

    /// Keeps the buffer of a sample that is no longer needed.
    fn recycle(&mut self, sample: Arc<Sample>) {
        if let Ok(sample) = Arc::try_unwrap(sample)
            && let Body::Same(mut buffer) = sample.body
            && self.spare.len() < SPARE_BUFFERS
        {
            buffer.clear();
            self.spare.push(buffer);
        }
    }

    /// Takes back the samples of a thing that is no more.
    pub fn withdraw(&mut self, of: impl Fn(&Sample) -> bool) {
        self.history.retain(|sample| !of(sample));
    }

    /// Keeps the newest samples that say that something has ended, up to that many.
    pub fn keep_ends(&mut self, ends: usize) {
        let all = self
            .history
            .iter()
            .filter(|sample| sample.ended().is_some());
        let mut surplus = all.count().saturating_sub(ends);
        self.history.retain(|sample| {
            let drop = surplus > 0 && sample.ended().is_some();
            surplus -= usize::from(drop);
            !drop
        });
    }

    /// A sample for a reader alone, or for all that are where it is.
    fn delivery(&self, to: Option<Guid>, reader: &Reader, sample: &Arc<Sample>) -> Delivery {
        Delivery {
            link: Arc::clone(&reader.link),
            writer: self.guid,
            reader: to,
            sample: Arc::clone(sample),
            names_hash: reader.names_hash,
            only: None,
            pulse: None,
            progress: Progress::default(),
            kind: Kind::New,
            under_way: Arc::default(),
        }
    }

    /// Sends a sample again, or some of its fragments; says no if it is no longer there, or is for another.
    fn repair(
        &mut self,
        to: Guid,
        number: u64,
        only: Option<NumberSet>,
        now: Instant,
        out: &mut Outbox,
    ) -> bool {
        let index = (self.history).partition_point(|sample| sample.number < number);
        let is_it = |sample: &&Arc<Sample>| {
            sample.number == number && number <= self.complete && sample.is_for(to)
        };
        let Some(sample) = self.history.get(index).filter(is_it).cloned() else {
            return false;
        };
        let first = self.first();
        let Some(reader) = self.readers.get_mut(&to) else {
            return true;
        };
        if reader.is_confirmed && reader.wants(number, now) {
            let pulse = reader
                .reliable
                .then_some([first.max(reader.from), self.complete]);
            let mut repair = self.delivery(Some(to), &self.readers[&to], &sample);
            repair.only = only;
            repair.kind = Kind::Repair;
            repair.pulse = pulse.map(|[first, last]| self.pulse(first, last));
            out.repair(repair);
        }
        true
    }

    /// A reader says what it misses: it gets that again, or hears that it never will. That may be below what
    /// it had acknowledged: one that had forgotten us begins anew.
    pub fn acknack(&mut self, from: Guid, ack: &Ack, now: Instant, out: &mut Outbox) {
        let missing = &ack.missing;
        let (first, last) = (self.first(), self.complete);
        let Some(reader) = self.readers.get_mut(&from) else {
            return;
        };
        reader.has_answered = true;
        reader.asks = !ack.is_final;
        let has = missing.base.saturating_sub(1).min(last);
        if has > reader.acknowledged || !missing.is_empty() {
            reader.ask_after(HEARTBEAT_INTERVAL, now);
        } else {
            // It says that it is there, until it hears what there is. Each time that postponed the
            // answer, it would never hear.
            reader.interval = HEARTBEAT_INTERVAL;
        }
        if has > reader.acknowledged || reader.asks {
            reader.acknowledged = has;
        }
        if reader.is_busy() {
            return;
        }
        let first = first.max(reader.from);
        let to = reader.link.place.address;
        let mut gaps = Message::to(self.guid.prefix, from.prefix);
        // Fast DDS forgets what it has of a sample at a heartbeat; after a gap alone it would hand out
        // memory that is no more.
        let what_is_there = self.pulse(first, last.max(first - 1)).beat();
        gaps.heartbeat(from.entity, self.guid.entity, what_is_there);
        let empty = gaps.bytes().len();
        let mut told_of = 0;
        for number in missing.iter().filter(|number| (1..=last).contains(number)) {
            let end = if number < first { first } else { number + 1 };
            let gone = number < first || !self.repair(from, number, None, now, out);
            if gone && number >= told_of {
                gaps.gap(from.entity, self.guid.entity, number, end);
                told_of = end;
            }
        }
        if gaps.bytes().len() > empty {
            out.message(to, gaps);
        }
    }

    /// A reader says which fragments of a sample it misses.
    pub fn nack_fragment(
        &mut self,
        from: Guid,
        number: u64,
        missing: NumberSet,
        now: Instant,
        out: &mut Outbox,
    ) {
        let known = self.readers.get(&from);
        if known.is_some_and(|reader| number >= reader.from && !reader.is_busy()) {
            self.repair(from, number, Some(missing), now, out);
        }
    }

    /// Asks readers that have not said that they have all.
    pub fn tick(&mut self, now: Instant, out: &mut Outbox) {
        if let Some(lifespan) = self.lifespan {
            self.history
                .retain(|sample| now.saturating_duration_since(sample.written) <= lifespan);
        }
        if self.readers.is_empty() {
            return;
        }
        let pulse = self.pulse(self.first(), self.complete);
        for (guid, reader) in &mut self.readers {
            // Of a long history, a reader may have asked for much.
            reader
                .repaired
                .retain(|_, at| now.duration_since(*at) < REPAIR_INTERVAL);
            let is_new = !reader.has_answered && now < reader.since + HEARD_WITHIN;
            let lacks = reader.acknowledged < self.complete;
            let waiting = reader.reliable && (reader.asks || is_new || lacks);
            let can_answer = reader.is_confirmed && !reader.is_busy();
            if !waiting || !can_answer || now < reader.asked + reader.interval {
                continue;
            }
            reader.asks = false;
            reader.ask_after((reader.interval * 2).min(LONGEST_INTERVAL), now);
            let mut message = Message::to(self.guid.prefix, guid.prefix);
            message.heartbeat(guid.entity, self.guid.entity, pulse.beat());
            out.message(reader.link.place.address, message);
        }
    }

    /// Readers that should have acknowledged something by now, and their places. One of best effort says nothing,
    /// but its participant does.
    pub fn unheard(&self, now: Instant) -> impl Iterator<Item = (Guid, Place)> {
        let readers = self.readers.iter().filter(move |(_, reader)| {
            let is_heard = match reader.reliable {
                true => reader.has_answered,
                false => reader.is_confirmed,
            };
            !is_heard && now.saturating_duration_since(reader.since) > HEARD_WITHIN
        });
        readers.map(|(guid, reader)| (*guid, reader.link.place))
    }

    /// A heartbeat for a reader that has acknowledged nothing yet: what it says then shows where it is.
    pub fn heartbeat(&self, to: Guid) -> Message {
        let mut message = Message::to(self.guid.prefix, to.prefix);
        let pulse = self.pulse(self.first(), self.complete);
        message.heartbeat(to.entity, self.guid.entity, pulse.beat());
        message
    }

    /// Whether somebody of a participant gets samples.
    pub fn is_read_by(&self, prefix: Prefix) -> bool {
        let mut readers = self.readers.iter();
        readers.any(|(guid, reader)| guid.prefix == prefix && reader.is_confirmed)
    }

    /// The readers, and what they lost.
    pub fn reader_counts(&self) -> Vec<ReaderCount> {
        let count = |(guid, reader): (&Guid, &Reader)| ReaderCount {
            guid: *guid,
            place: reader.link.place,
            skipped: reader.skipped,
        };
        let confirmed = self.readers.iter().filter(|(_, one)| one.is_confirmed);
        confirmed.map(count).collect()
    }
}
