//! Who else is in the domain, and what they read (sections 8.5 and 9.6): state without sockets.
//!
//! Participants say that they are there (SPDP), again and again; one that stays silent for its
//! lease is forgotten. Each tells of its readers in numbered samples (SEDP), and sends again what
//! we say that we miss. All that others can make us keep is bounded.

use super::parameters;
use super::wire::{self, EntityId, Fields, Guid, NumberSet, Prefix};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

/// Participants that are known at a time.
pub const MAX_PARTICIPANTS: usize = 256;

/// Readers that are known at a time, of all participants.
pub const MAX_READERS: usize = 4096;

/// Places a participant or reader can be reached at.
const MAX_LOCATORS: usize = 16;

/// How long a participant is known that has acknowledged nothing.
const UNCONFIRMED_LEASE: Duration = Duration::from_secs(5);

/// Samples ahead of the first that is missing.
const WINDOW: u64 = 256;

/// A lease may be infinite; a participant that is gone is forgotten all the same.
const LONGEST_LEASE: Duration = Duration::from_secs(300);

/// How often, at most, and in which interval a participant is told of us that does not know us.
/// The end of it keeps two that have nothing to tell each other from answering for ever.
const TELLS: u32 = 8;
const TELL_INTERVAL: Duration = Duration::from_millis(50);

/// Seconds of an infinite time.
const INFINITE_SECONDS: u32 = 0x7fff_ffff;

/// The lease of who names none.
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// Where a participant or reader gets its datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The socket.
    pub address: SocketAddrV4,
    /// Whether that is of this host.
    pub near: bool,
}

/// The addresses of this host, beside those of the loopback.
pub type OwnAddresses = [Ipv4Addr];

/// Whether an address is of this host.
pub fn is_own(address: &Ipv4Addr, own: &OwnAddresses) -> bool {
    address.is_loopback() || own.contains(address)
}

impl Place {
    /// The host of it; this one has one name.
    pub fn host(self) -> Ipv4Addr {
        match self.near {
            true => Ipv4Addr::LOCALHOST,
            false => *self.address.ip(),
        }
    }

    /// Chooses among the places that someone names, whose datagrams come from `source`.
    ///
    /// On this host the loopback goes before any other address. Of another host, its address in
    /// the network that its datagrams come through is the one that surely works.
    fn choose(locators: &[SocketAddrV4], source: Ipv4Addr, own: &OwnAddresses) -> Option<Self> {
        let find = |wanted: &dyn Fn(&Ipv4Addr) -> bool| {
            let found = locators.iter().find(|locator| wanted(locator.ip()));
            found.copied()
        };
        if is_own(&source, own) {
            let near = find(&Ipv4Addr::is_loopback)
                .or_else(|| find(&|address| is_own(address, own)))
                .map(|address| Self {
                    address,
                    near: true,
                });
            if near.is_some() {
                return near;
            }
        }
        find(&|address| *address == source)
            .or_else(|| find(&|address| !is_own(address, own)))
            .map(|address| Self {
                address,
                near: false,
            })
    }
}

/// What a participant says of itself.
#[derive(Clone, Debug)]
pub struct ParticipantData {
    /// Where it hears of others.
    pub meta: Place,
    /// The places that it names for that.
    named: Vec<SocketAddrV4>,
    /// Where its readers hear, unless they name a place of their own.
    user: Vec<SocketAddrV4>,
    source: Ipv4Addr,
    lease: Duration,
}

impl ParticipantData {
    /// Reads it; none where it cannot be reached.
    pub fn read(payload: &[u8], source: Ipv4Addr, own: &OwnAddresses) -> Option<Self> {
        let (mut meta, mut user, mut lease) = (vec![], vec![], DEFAULT_LEASE);
        for (parameter, value) in parameters::read(payload)? {
            match parameter {
                parameters::METATRAFFIC_LOCATOR => push_locator(&mut meta, value),
                parameters::DEFAULT_LOCATOR => push_locator(&mut user, value),
                parameters::PARTICIPANT_LEASE => {
                    lease = Duration::from_secs(u64::from(value.u32(0)?)).min(LONGEST_LEASE);
                }
                _ => {}
            }
        }
        Some(Self {
            meta: Place::choose(&meta, source, own)?,
            named: meta,
            user,
            source,
            lease,
        })
    }

    /// Whether what comes from an address comes from where it hears of others.
    fn is_at(&self, source: Ipv4Addr, own: &OwnAddresses) -> bool {
        match self.meta.near {
            true => is_own(&source, own),
            false => *self.meta.address.ip() == source,
        }
    }
}

fn push_locator(locators: &mut Vec<SocketAddrV4>, value: Fields) {
    if locators.len() < MAX_LOCATORS {
        locators.extend(parameters::locator(value));
    }
}

/// What a participant says of a reader of its.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReaderData {
    /// Which reader.
    pub guid: Guid,
    /// Its topic in DDS, as `rt/points`.
    pub topic: String,
    /// Its type in DDS, as `sensor_msgs::msg::dds_::PointCloud2_`.
    pub type_name: String,
    /// Whether it asks for all samples.
    pub reliable: bool,
    /// Whether it asks for samples from before it was there.
    pub transient_local: bool,
    /// Whether it names its type's hash, as ROS 2 does since Iron.
    pub names_hash: bool,
    /// Something that it asks for, and no writer of ours promises.
    pub promise: Option<&'static str>,
    /// Where it gets its datagrams.
    pub place: Place,
    /// The places that it names for that; none for those of its participant.
    named: Vec<SocketAddrV4>,
}

impl ReaderData {
    /// The reader that a participant has for our publications.
    pub fn of_publications(prefix: Prefix, place: Place) -> Self {
        Self {
            guid: Guid::new(prefix, wire::PUBLICATIONS_READER),
            topic: String::new(),
            type_name: String::new(),
            reliable: true,
            transient_local: true,
            names_hash: false,
            promise: None,
            place,
            named: vec![],
        }
    }

    fn read(payload: &[u8], participant: &ParticipantData, own: &OwnAddresses) -> Option<Self> {
        let (mut guid, mut topic, mut type_name) = (None, None, None);
        let (mut reliable, mut transient_local, mut names_hash) = (false, false, false);
        let mut promise = None;
        let mut locators = vec![];
        for (parameter, value) in parameters::read(payload)? {
            match parameter {
                parameters::DEADLINE if value.u32(0)? < INFINITE_SECONDS => {
                    promise = Some("a deadline");
                }
                parameters::LIVELINESS
                    if value.u32(0)? != 0 || value.u32(4)? < INFINITE_SECONDS =>
                {
                    promise = Some("signs of life (liveliness)");
                }
                parameters::ENDPOINT_GUID => guid = Guid::read(value.bytes),
                parameters::TOPIC_NAME => topic = parameters::name(value),
                parameters::TYPE_NAME => type_name = parameters::name(value),
                parameters::RELIABILITY => reliable = value.u32(0)? == 2,
                parameters::DURABILITY => transient_local = value.u32(0)? >= 1,
                parameters::USER_DATA => {
                    names_hash = parameters::user_data_has(value, b"typehash=");
                }
                parameters::UNICAST_LOCATOR => push_locator(&mut locators, value),
                _ => {}
            }
        }
        Some(Self {
            guid: guid?,
            topic: topic?,
            type_name: type_name?,
            reliable,
            transient_local,
            names_hash,
            promise,
            place: Self::place(&locators, participant, own)?,
            named: locators,
        })
    }

    /// Where a reader is that names these places.
    fn place(
        named: &[SocketAddrV4],
        participant: &ParticipantData,
        own: &OwnAddresses,
    ) -> Option<Place> {
        let named = match named.is_empty() {
            true => &participant.user,
            false => named,
        };
        Place::choose(named, participant.source, own)
    }
}

/// Which samples of a writer are there.
#[derive(Debug)]
struct Received {
    /// The first that is missing.
    next: u64,
    /// Those behind it, at most [`WINDOW`] ahead.
    ahead: BTreeSet<u64>,
}

impl Received {
    fn new() -> Self {
        Self {
            next: 1,
            ahead: BTreeSet::new(),
        }
    }

    /// Whether the sample is new, and near enough to be kept in mind.
    fn insert(&mut self, number: u64) -> bool {
        let wanted = number >= self.next && number - self.next < WINDOW;
        let new = wanted && self.ahead.insert(number);
        self.advance();
        new
    }

    /// No sample before `number` will come any more.
    fn skip_to(&mut self, number: u64) {
        if number > self.next {
            self.next = number;
            self.ahead = self.ahead.split_off(&number);
        }
        self.advance();
    }

    fn advance(&mut self) {
        while self.ahead.remove(&self.next) {
            self.next += 1;
        }
    }

    fn missing(&self, last: u64) -> NumberSet {
        let mut missing = NumberSet::new(self.next);
        for number in self.next..=last.min(self.next + WINDOW - 1) {
            if !self.ahead.contains(&number) {
                missing.insert(number);
            }
        }
        missing
    }
}

/// What it means that a participant says that it is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// It was not known, or is at another place now.
    New,
    /// It is known, but does not seem to know us.
    Unaware,
    /// Nothing.
    Known,
}

struct Participant {
    data: ParticipantData,
    /// When it was heard first.
    since: Instant,
    heard: Instant,
    /// It has acknowledged something, from the place that it names.
    is_confirmed: bool,
    /// When it is to be told of us again, and how often. One that has only just begun hears
    /// nothing yet when it first says that it is there.
    tell_again: Instant,
    tells_left: u32,
    subscriptions: Received,
    /// The newest sample of its subscriptions that it told of.
    newest_subscription: u64,
    readers: BTreeMap<EntityId, ReaderData>,
}

/// All that is known of others.
#[derive(Default)]
pub struct Discovery {
    participants: HashMap<Prefix, Participant>,
    readers: usize,
    /// Somebody found no room since this was looked at.
    pub is_full: bool,
}

impl Discovery {
    /// A participant says that it is there.
    pub fn participant(
        &mut self,
        prefix: Prefix,
        data: ParticipantData,
        own: &OwnAddresses,
        now: Instant,
    ) -> News {
        if let Some(known) = self.participants.get_mut(&prefix) {
            let mut data = data;
            // A host may speak from several addresses: the one that works stays.
            if known.is_confirmed && data.named.contains(&known.data.meta.address) {
                (data.meta, data.source) = (known.data.meta, known.data.source);
            }
            let moved = known.data.meta != data.meta;
            known.data = data;
            known.heard = now;
            if moved {
                (known.since, known.is_confirmed) = (now, false);
                // It has told of its readers, and will not do so again.
                known.readers.retain(|_, reader| {
                    let place = ReaderData::place(&reader.named, &known.data, own);
                    reader.place = place.unwrap_or(reader.place);
                    place.is_some()
                });
                self.readers = self.count_readers();
                return News::New;
            }
            if known.tells_left == 0 || now < known.tell_again {
                return News::Known;
            }
            known.tell_again = now + TELL_INTERVAL;
            known.tells_left -= 1;
            return News::Unaware;
        }
        if self.participants.len() == MAX_PARTICIPANTS {
            return News::Known;
        }
        let participant = Participant {
            data,
            since: now,
            heard: now,
            is_confirmed: false,
            tell_again: now + TELL_INTERVAL,
            tells_left: TELLS,
            subscriptions: Received::new(),
            newest_subscription: 0,
            readers: BTreeMap::new(),
        };
        self.participants.insert(prefix, participant);
        News::New
    }

    fn count_readers(&self) -> usize {
        let readers = self.participants.values().map(|one| one.readers.len());
        readers.sum()
    }

    /// Whom a participant that is new displaces where there is no room: of those that have
    /// acknowledged nothing, the one that is known for longest.
    pub fn displaced_by(&mut self, newcomer: Prefix) -> Option<Prefix> {
        let has_room = self.participants.len() < MAX_PARTICIPANTS;
        if has_room || self.participants.contains_key(&newcomer) {
            return None;
        }
        self.is_full = true;
        let unconfirmed = self
            .participants
            .iter()
            .filter(|(_, one)| !one.is_confirmed);
        let oldest = unconfirmed.min_by_key(|(_, one)| one.since);
        oldest.map(|(prefix, _)| *prefix)
    }

    /// What a participant says of itself, if datagrams come from another place that it names than the
    /// one that was chosen.
    pub fn seen_elsewhere(
        &self,
        prefix: Prefix,
        source: Ipv4Addr,
        own: &OwnAddresses,
    ) -> Option<ParticipantData> {
        let participant = self.participants.get(&prefix)?;
        let mut data = participant.data.clone();
        (data.source, data.meta) = (source, Place::choose(&data.named, source, own)?);
        let is_elsewhere = data.is_at(source, own) && !participant.data.is_at(source, own);
        (is_elsewhere && !participant.is_confirmed).then_some(data)
    }

    /// A participant that names us acknowledges something, from this address: whether that is the place
    /// that it names.
    pub fn acknowledged(&mut self, prefix: Prefix, source: Ipv4Addr, own: &OwnAddresses) -> bool {
        let Some(participant) = self.participants.get_mut(&prefix) else {
            return false;
        };
        let is_there = participant.data.is_at(source, own);
        participant.is_confirmed |= is_there;
        is_there
    }

    /// The host from which a participant has acknowledged something.
    pub fn confirmed_host(&self, prefix: Prefix) -> Option<Ipv4Addr> {
        let participant = self.participants.get(&prefix)?;
        let host = participant.data.meta.host();
        participant.is_confirmed.then_some(host)
    }

    /// The readers of a participant.
    pub fn readers_of(&self, prefix: Prefix) -> impl Iterator<Item = &ReaderData> {
        let participant = self.participants.get(&prefix);
        participant.into_iter().flat_map(|one| one.readers.values())
    }

    /// A participant has gone, or was never there.
    pub fn forget(&mut self, prefix: Prefix) {
        if let Some(gone) = self.participants.remove(&prefix) {
            self.readers -= gone.readers.len();
        }
    }

    /// Forgets those that stay silent or acknowledge nothing, and names them; and where one of them has
    /// readers, but has acknowledged nothing.
    pub fn expire(&mut self, now: Instant) -> (Vec<Prefix>, Option<Place>) {
        let silent = |participant: &Participant| {
            let lease = participant.data.lease;
            now.saturating_duration_since(participant.heard) > lease
                || !participant.is_confirmed
                    && now.saturating_duration_since(participant.since) > UNCONFIRMED_LEASE
        };
        let gone: Vec<Prefix> = self
            .participants
            .iter()
            .filter(|(_, participant)| silent(participant))
            .map(|(prefix, _)| *prefix)
            .collect();
        let unheard = (gone
            .iter()
            .filter_map(|prefix| self.participants.get(prefix)))
        .find(|one| !one.is_confirmed && !one.readers.is_empty())
        .map(|one| one.data.meta);
        for prefix in &gone {
            self.forget(*prefix);
        }
        (gone, unheard)
    }

    /// A participant has something new to say of a reader: the reader, where it is one.
    pub fn subscription(
        &mut self,
        prefix: Prefix,
        number: u64,
        payload: &[u8],
        own: &OwnAddresses,
    ) -> Option<&ReaderData> {
        let participant = self.participants.get_mut(&prefix)?;
        if !participant.subscriptions.insert(number) {
            return None;
        }
        let reader = ReaderData::read(payload, &participant.data, own)?;
        let entity = reader.guid.entity;
        let known = participant.readers.contains_key(&entity);
        if reader.guid.prefix != prefix {
            return None;
        }
        if !known && self.readers == MAX_READERS {
            self.is_full = true;
            return None;
        }
        self.readers += usize::from(!known);
        participant.readers.insert(entity, reader);
        participant.readers.get(&entity)
    }

    /// A participant says that a reader is no more.
    pub fn subscription_ended(&mut self, prefix: Prefix, number: u64, guid: Option<Guid>) {
        let Some(participant) = self.participants.get_mut(&prefix) else {
            return;
        };
        participant.subscriptions.insert(number);
        let ended = guid.and_then(|guid| participant.readers.remove(&guid.entity));
        self.readers -= usize::from(ended.is_some());
    }

    /// A participant says which samples of its subscriptions there are.
    pub fn subscriptions(&mut self, prefix: Prefix, first: u64, last: u64) {
        if let Some(participant) = self.participants.get_mut(&prefix) {
            participant.subscriptions.skip_to(first);
            participant.newest_subscription = last;
        }
    }

    /// Which samples of a participant's subscriptions we miss, and where to say so. None as long as it has
    /// acknowledged nothing: it may be forgotten, and tells nothing again that was acknowledged.
    pub fn missing_subscriptions(&mut self, prefix: Prefix) -> Option<(NumberSet, Place)> {
        let participant = self.participants.get_mut(&prefix)?;
        if !participant.is_confirmed || participant.newest_subscription == 0 {
            return None;
        }
        // It tells us of its readers and hears us: it knows us.
        participant.tells_left = 0;
        let missing = participant
            .subscriptions
            .missing(participant.newest_subscription);
        Some((missing, participant.data.meta))
    }

    /// Where a participant hears of others.
    pub fn place(&self, prefix: Prefix) -> Option<Place> {
        self.participants.get(&prefix).map(|one| one.data.meta)
    }

    /// A participant says which samples of its subscriptions will never come.
    pub fn subscriptions_gap(&mut self, prefix: Prefix, first: u64, more: &NumberSet) {
        let Some(participant) = self.participants.get_mut(&prefix) else {
            return;
        };
        let received = &mut participant.subscriptions;
        if first <= received.next {
            received.skip_to(more.base);
        } else {
            // One that begins later is asked about again, from the first that is missing on.
            for number in first..more.base.min(received.next + WINDOW) {
                received.insert(number);
            }
        }
        for number in more.iter() {
            received.insert(number);
        }
    }

    /// All readers.
    pub fn readers(&self) -> impl Iterator<Item = &ReaderData> {
        self.participants
            .values()
            .flat_map(|participant| participant.readers.values())
    }

    /// How many participants and readers there are.
    #[cfg(test)]
    pub fn counts(&self) -> (usize, usize) {
        let readers = self.participants.values().map(|one| one.readers.len());
        assert_eq!(readers.sum::<usize>(), self.readers);
        let ahead = |one: &Participant| one.subscriptions.ahead.len() as u64;
        assert!(self.participants.values().all(|one| ahead(one) < WINDOW));
        (self.participants.len(), self.readers)
    }

    /// Where participants hear of others, of those that have acknowledged something.
    pub fn places(&self) -> impl Iterator<Item = Place> + '_ {
        let confirmed = self.participants.values().filter(|one| one.is_confirmed);
        confirmed.map(|participant| participant.data.meta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(address: [u8; 4], near: bool) -> Option<Place> {
        let address = SocketAddrV4::new(Ipv4Addr::from(address), 7411);
        Some(Place { address, near })
    }

    fn choose(locators: &[[u8; 4]], source: [u8; 4]) -> Option<Place> {
        let own = [
            Ipv4Addr::LOCALHOST,
            Ipv4Addr::new(10, 0, 0, 1),
            Ipv4Addr::new(172, 17, 0, 1),
        ];
        let locators: Vec<SocketAddrV4> = locators
            .iter()
            .map(|address| SocketAddrV4::new(Ipv4Addr::from(*address), 7411))
            .collect();
        Place::choose(&locators, Ipv4Addr::from(source), &own)
    }

    #[test]
    fn the_place_is_one_that_is_reached() {
        let loopback = [127, 0, 0, 1];
        // On this host: the loopback, or an address of ours.
        let here = [[192, 168, 9, 9], [10, 0, 0, 1], loopback];
        assert_eq!(choose(&here, [10, 0, 0, 1]), place(loopback, true));
        assert_eq!(choose(&here[..2], loopback), place([10, 0, 0, 1], true));
        // On another: not its loopback, nor an address that we have too, but that which it sends
        // from.
        let there = [loopback, [172, 17, 0, 1], [192, 168, 9, 9], [10, 0, 0, 7]];
        assert_eq!(choose(&there, [10, 0, 0, 7]), place([10, 0, 0, 7], false));
        assert_eq!(choose(&there, [8, 8, 8, 8]), place([192, 168, 9, 9], false));
        assert_eq!(choose(&there[..2], [10, 0, 0, 7]), None);
    }

    #[test]
    fn numbers_are_kept_in_order_and_bounded() {
        let mut received = Received::new();
        assert!(received.insert(1) && received.insert(3) && !received.insert(3));
        assert!(received.missing(5).iter().eq([2, 4, 5]));
        assert!(!received.insert(2 + WINDOW) && received.insert(1 + WINDOW));
        assert_eq!(received.missing(1 << 61).iter().count() as u64, WINDOW - 2);
        assert!(received.insert(2) && !received.insert(2));
        assert_eq!(received.next, 4);
        received.skip_to(1 << 61);
        assert_eq!((received.next, received.ahead.len()), (1 << 61, 0));
        assert!(received.missing(7).is_empty());
    }

    #[test]
    fn the_silent_are_forgotten() {
        let mut discovery = Discovery::default();
        let start = Instant::now();
        let meta = place([127, 0, 0, 1], true).unwrap();
        let data = |seconds| ParticipantData {
            meta,
            named: vec![meta.address],
            user: vec![],
            source: Ipv4Addr::LOCALHOST,
            lease: Duration::from_secs(seconds),
        };
        let after = |seconds| start + Duration::from_secs(seconds);
        let soon = start + Duration::from_millis(10);
        for (id, lease) in [(1, 10), (2, 20), (3, 20)] {
            let news = discovery.participant([id; 12], data(lease), &[], start);
            assert_eq!(news, News::New);
        }
        for id in [1, 2] {
            assert!(discovery.acknowledged([id; 12], Ipv4Addr::LOCALHOST, &[]));
        }
        assert_eq!(
            discovery.participant([2; 12], data(20), &[], soon),
            News::Known
        );
        assert_eq!(
            discovery.participant([2; 12], data(20), &[], after(5)),
            News::Unaware
        );
        // The third has acknowledged nothing.
        assert!(discovery.expire(after(5)).0.is_empty());
        assert_eq!(discovery.expire(after(6)).0, [[3; 12]]);
        assert!(discovery.expire(after(10)).0.is_empty());
        assert_eq!(discovery.expire(after(11)).0, [[1; 12]]);
        assert!(discovery.expire(after(25)).0.is_empty());
        assert_eq!(discovery.expire(after(26)).0, [[2; 12]]);
    }
}
