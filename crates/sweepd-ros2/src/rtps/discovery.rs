//! Who else is in the domain, and what they read and write (sections 8.5 and 9.6): state without
//! sockets.
//!
//! Participants say that they are there (SPDP), again and again; one that stays silent for its
//! lease is forgotten. Each tells of its readers and writers in numbered samples (SEDP), and sends again
//! what we say that we miss. All that others can make us keep is bounded.

use super::parameters;
use super::received::Received;
use super::wire::{self, Ack, EntityId, Fields, Guid, NumberSet, Prefix};
use std::collections::{BTreeMap, HashMap};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

/// Participants that are known at a time.
pub const MAX_PARTICIPANTS: usize = 256;

/// Readers that are known at a time, of all participants, and as many writers.
pub const MAX_ENDPOINTS: usize = 4096;

/// Places a participant or endpoint can be reached at.
const MAX_LOCATORS: usize = 16;

/// How long a participant is known that has acknowledged nothing.
const UNCONFIRMED_LEASE: Duration = Duration::from_secs(10);

/// A lease may be infinite; a participant that is gone is forgotten all the same.
const LONGEST_LEASE: Duration = Duration::from_secs(300);

/// How often, at most, and in which interval a participant is told of us that does not know us yet.
const TELLS: u32 = 8;
const TELL_INTERVAL: Duration = Duration::from_millis(50);

/// Interval in which one that knows us is: it may have forgotten us, and hear no group.
const RETELL_INTERVAL: Duration = Duration::from_secs(5);

/// Vendors of Fast DDS and of Cyclone DDS.
const FAST_DDS: [u8; 2] = [1, 0x0f];
const CYCLONE: [u8; 2] = [1, 0x10];

/// Seconds of an infinite time.
const INFINITE_SECONDS: u32 = 0x7fff_ffff;

/// The lease of who names none.
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// Which endpoints of participants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Their readers, or ours.
    Readers,
    /// Their writers, or ours.
    Writers,
}

impl Side {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::Readers, Self::Writers];

    /// The builtin reader and writer by which participants tell each other of them.
    pub fn builtin(self) -> (EntityId, EntityId) {
        match self {
            Self::Readers => (wire::SUBSCRIPTIONS_READER, wire::SUBSCRIPTIONS_WRITER),
            Self::Writers => (wire::PUBLICATIONS_READER, wire::PUBLICATIONS_WRITER),
        }
    }

    /// Those that a builtin writer tells of.
    pub fn told_by(writer: EntityId) -> Option<Self> {
        Self::BOTH
            .into_iter()
            .find(|side| side.builtin().1 == writer)
    }
}

/// Where a participant or endpoint gets its datagrams.
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

/// A participant that names no address of UDP over IPv4 by which this host reaches it.
pub struct Unreachable;

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
    /// Vendor of its DDS.
    vendor: [u8; 2],
}

impl ParticipantData {
    /// Reads it; none where it makes no sense.
    pub fn read(
        payload: &[u8],
        source: Ipv4Addr,
        own: &OwnAddresses,
    ) -> Option<Result<Self, Unreachable>> {
        let (mut meta, mut user, mut lease) = (vec![], vec![], DEFAULT_LEASE);
        let (mut vendor, mut has_user) = ([0; 2], false);
        for (parameter, value) in parameters::read(payload)? {
            match parameter {
                parameters::METATRAFFIC_LOCATOR => push_locator(&mut meta, value),
                parameters::DEFAULT_LOCATOR => {
                    has_user = true;
                    push_locator(&mut user, value);
                }
                parameters::PARTICIPANT_LEASE => {
                    lease = Duration::from_secs(u64::from(value.u32(0)?)).min(LONGEST_LEASE);
                }
                parameters::VENDOR_ID => vendor = *value.bytes.first_chunk()?,
                _ => {}
            }
        }
        let Some(place) = Place::choose(&meta, source, own) else {
            return Some(Err(Unreachable));
        };
        if has_user && Place::choose(&user, source, own).is_none() {
            return Some(Err(Unreachable));
        }
        Some(Ok(Self {
            meta: place,
            named: meta,
            user,
            source,
            lease,
            vendor,
        }))
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

/// What a participant says of a reader of its, or of a writer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Which one.
    pub guid: Guid,
    /// Its topic in DDS, as `rt/points`.
    pub topic: String,
    /// Its type in DDS, as `sensor_msgs::msg::dds_::PointCloud2_`.
    pub type_name: String,
    /// Whether it asks for all samples, or sends what was lost again.
    pub reliable: bool,
    /// Whether it asks for samples from before it was there, or keeps them for readers.
    pub transient_local: bool,
    /// Whether it names its type's hash, as ROS 2 does since Iron.
    pub names_hash: bool,
    /// True if its requests and replies begin with the header of rmw_cyclonedds: it is of Cyclone DDS, or
    /// names a client in its user data.
    pub has_request_header: bool,
    /// What readers ask for and no writer promises, of ours and it.
    pub promise: Option<&'static str>,
    /// Where it gets its datagrams.
    pub place: Place,
}

impl Endpoint {
    /// The reader by which a participant hears of our endpoints of a side.
    pub fn builtin_reader(prefix: Prefix, side: Side, place: Place) -> Self {
        Self {
            guid: Guid::new(prefix, side.builtin().0),
            topic: String::new(),
            type_name: String::new(),
            reliable: true,
            transient_local: true,
            names_hash: false,
            has_request_header: false,
            promise: None,
            place,
        }
    }

    fn read(
        payload: &[u8],
        side: Side,
        participant: &ParticipantData,
        own: &OwnAddresses,
    ) -> Option<Self> {
        let (mut guid, mut topic, mut type_name) = (None, None, None);
        let asks = side == Side::Readers;
        // Writers are reliable unless they say otherwise; readers ask for it.
        let (mut reliable, mut transient_local, mut names_hash) = (!asks, false, false);
        let mut has_request_header = participant.vendor == CYCLONE;
        let mut promise = None;
        let mut locators = vec![];
        for (parameter, value) in parameters::read(payload)? {
            match parameter {
                parameters::OWNERSHIP if value.u32(0)? != 0 => {
                    promise = Some("one writer at a time (ownership exclusive)");
                }
                // What a writer promises, no reader of ours asks for.
                parameters::DEADLINE if asks && value.u32(0)? < INFINITE_SECONDS => {
                    promise = Some("a deadline");
                }
                parameters::LIVELINESS
                    if asks && (value.u32(0)? != 0 || value.u32(4)? < INFINITE_SECONDS) =>
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
                    has_request_header |= parameters::user_data_has(value, b"clientid=");
                }
                parameters::UNICAST_LOCATOR => push_locator(&mut locators, value),
                _ => {}
            }
        }
        // One that names no places is where its participant is.
        let named = match locators.is_empty() {
            true => &participant.user,
            false => &locators,
        };
        Some(Self {
            guid: guid?,
            topic: topic?,
            type_name: type_name?,
            reliable,
            transient_local,
            names_hash,
            has_request_header,
            promise,
            place: Place::choose(named, participant.source, own)?,
        })
    }
}

/// What a participant told of its readers, or of its writers.
struct Told {
    /// Samples in which it told.
    samples: Received,
    endpoints: BTreeMap<EntityId, Endpoint>,
}

impl Told {
    fn nothing(now: Instant) -> Self {
        Self {
            samples: Received::new(now),
            endpoints: BTreeMap::new(),
        }
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
    /// Moment at which it was asked last whether it is still there.
    probed: Instant,
    /// It has acknowledged something, from the place that it names.
    is_confirmed: bool,
    /// When it is to be told of us again, and how often at once. One that has only just begun hears
    /// nothing yet when it first says that it is there.
    tell_again: Instant,
    tells_at_once: u32,
    /// For each [`Side`].
    told: [Told; 2],
}

impl Participant {
    fn endpoints(&self, side: Side) -> &BTreeMap<EntityId, Endpoint> {
        &self.told[side as usize].endpoints
    }

    /// Says whether it is told of us again, as it says again that it is there.
    fn hears_again(&mut self, now: Instant) -> News {
        if now < self.tell_again {
            return News::Known;
        }
        let is_settled = self.tells_at_once == 0;
        self.tells_at_once = self.tells_at_once.saturating_sub(1);
        self.tell_again = now
            + if is_settled {
                RETELL_INTERVAL
            } else {
                TELL_INTERVAL
            };
        News::Unaware
    }
}

/// All that is known of others.
#[derive(Default)]
pub struct Discovery {
    participants: HashMap<Prefix, Participant>,
    /// Endpoints of each [`Side`].
    counts: [usize; 2],
    /// Somebody found no room since this was looked at.
    pub is_full: bool,
}

impl Discovery {
    /// A participant says that it is there.
    pub fn participant(&mut self, prefix: Prefix, mut data: ParticipantData, now: Instant) -> News {
        let mut since = now;
        if let Some(known) = self.participants.get_mut(&prefix) {
            // A host may speak from several addresses: the one that works stays.
            if known.is_confirmed && data.named.contains(&known.data.meta.address) {
                (data.meta, data.source) = (known.data.meta, known.data.source);
            }
            if known.data.meta == data.meta {
                known.data = data;
                return known.hears_again(now);
            }
            // It has moved: all begins anew. One that names its places in turn goes on to be unheard.
            since = if known.is_confirmed { now } else { known.since };
            self.forget(prefix);
        }
        if self.participants.len() == MAX_PARTICIPANTS {
            return News::Known;
        }
        let participant = Participant {
            data,
            since,
            heard: now,
            probed: now,
            is_confirmed: false,
            tell_again: now + TELL_INTERVAL,
            tells_at_once: TELLS,
            told: Side::BOTH.map(|_| Told::nothing(now)),
        };
        self.participants.insert(prefix, participant);
        News::New
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

    /// Something comes from an address: whether that is where its participant is, whose lease begins anew
    /// then. One that had to pause tells of itself again after its lease alone.
    pub fn hears(
        &mut self,
        prefix: Prefix,
        source: Ipv4Addr,
        own: &OwnAddresses,
        now: Instant,
    ) -> bool {
        let Some(participant) = self.participants.get_mut(&prefix) else {
            return false;
        };
        let is_there = participant.data.is_at(source, own);
        if is_there {
            participant.heard = now;
        }
        is_there
    }

    /// The host from which a participant has acknowledged something.
    pub fn confirmed_host(&self, prefix: Prefix) -> Option<Ipv4Addr> {
        let participant = self.participants.get(&prefix)?;
        let host = participant.data.meta.host();
        participant.is_confirmed.then_some(host)
    }

    /// The endpoints of a participant.
    pub fn endpoints_of(&self, prefix: Prefix, side: Side) -> impl Iterator<Item = &Endpoint> {
        let participant = self.participants.get(&prefix).into_iter();
        participant.flat_map(move |one| one.endpoints(side).values())
    }

    /// A participant has gone, or was never there.
    pub fn forget(&mut self, prefix: Prefix) {
        if let Some(gone) = self.participants.remove(&prefix) {
            for side in Side::BOTH {
                self.counts[side as usize] -= gone.endpoints(side).len();
            }
        }
    }

    /// Forgets those that stay silent or acknowledge nothing, and names them; and the place of each that goes
    /// on to say that it is there, but has acknowledged nothing.
    pub fn expire(&mut self, now: Instant) -> Vec<(Prefix, Option<Place>)> {
        let expired = |(prefix, one): (&Prefix, &Participant)| {
            let is_unheard =
                !one.is_confirmed && now.saturating_duration_since(one.since) > UNCONFIRMED_LEASE;
            let is_silent = now.saturating_duration_since(one.heard) > one.data.lease;
            let goes_on = one.heard - one.since > UNCONFIRMED_LEASE / 2;
            let place = (is_unheard && goes_on).then_some(one.data.meta);
            (is_unheard || is_silent).then_some((*prefix, place))
        };
        let gone: Vec<(Prefix, Option<Place>)> =
            self.participants.iter().filter_map(expired).collect();
        for (prefix, _) in &gone {
            self.forget(*prefix);
        }
        gone
    }

    /// True if an endpoint is known; of another entity, its participant.
    pub fn knows(&self, guid: Guid) -> bool {
        let is_endpoint = ![wire::PARTICIPANT, wire::ANY_READER].contains(&guid.entity);
        self.participants.get(&guid.prefix).is_some_and(|one| {
            let mut told = one.told.iter();
            !is_endpoint || told.any(|told| told.endpoints.contains_key(&guid.entity))
        })
    }

    fn told(&mut self, prefix: Prefix, side: Side) -> Option<&mut Told> {
        let participant = self.participants.get_mut(&prefix)?;
        Some(&mut participant.told[side as usize])
    }

    /// A participant has something new to say of an endpoint: the endpoint, where it is one.
    pub fn endpoint(
        &mut self,
        (prefix, side): (Prefix, Side),
        number: u64,
        payload: &[u8],
        own: &OwnAddresses,
    ) -> Option<&Endpoint> {
        let participant = self.participants.get_mut(&prefix)?;
        let (told, count) = (
            &mut participant.told[side as usize],
            &mut self.counts[side as usize],
        );
        if !told.samples.wants(number) {
            return None;
        }
        let endpoint = Endpoint::read(payload, side, &participant.data, own);
        let endpoint = endpoint.filter(|endpoint| endpoint.guid.prefix == prefix);
        let known = (endpoint.as_ref())
            .is_none_or(|endpoint| told.endpoints.contains_key(&endpoint.guid.entity));
        if !known && *count == MAX_ENDPOINTS {
            // It is missing still, and asked for again.
            self.is_full = true;
            return None;
        }
        told.samples.insert(number);
        let endpoint = endpoint?;
        let entity = endpoint.guid.entity;
        *count += usize::from(!known);
        told.endpoints.insert(entity, endpoint);
        told.endpoints.get(&entity)
    }

    /// A participant says that an endpoint is no more.
    pub fn endpoint_ended(&mut self, prefix: Prefix, side: Side, number: u64, guid: Option<Guid>) {
        let Some(told) = self.told(prefix, side) else {
            return;
        };
        told.samples.insert(number);
        let ended = guid.and_then(|guid| told.endpoints.remove(&guid.entity));
        self.counts[side as usize] -= usize::from(ended.is_some());
    }

    /// A participant says which samples there are of its endpoints.
    pub fn heartbeat(&mut self, prefix: Prefix, side: Side, first: u64, last: u64) {
        if let Some(participant) = self.participants.get_mut(&prefix) {
            participant.told[side as usize]
                .samples
                .heartbeat(first, last);
            if participant.is_confirmed {
                // It tells us of its endpoints and hears us: it knows us.
                participant.tells_at_once = 0;
            }
        }
    }

    /// A participant says which samples of its endpoints will never come.
    pub fn gap(&mut self, prefix: Prefix, side: Side, first: u64, more: &NumberSet) {
        if let Some(told) = self.told(prefix, side) {
            told.samples.gap(first, more);
        }
    }

    /// Acknowledgement of the samples in which a participant tells of its endpoints, and its place.
    pub fn ack(&self, prefix: Prefix, side: Side) -> Option<(Ack, Place)> {
        let participant = self.participants.get(&prefix)?;
        let samples = &participant.told[side as usize].samples;
        Some((samples.ack(), participant.data.meta))
    }

    /// Acknowledgement for one that was asked before, and of which nothing came. Fast DDS sends what it takes for
    /// acknowledged again if the base is 0, with which its own readers begin; others take that for malformed
    /// (section 9.4.2.6).
    pub fn second_ack(&self, prefix: Prefix, side: Side) -> Option<(Ack, Place)> {
        let (ack, place) = self.ack(prefix, side)?;
        let anew = Ack {
            missing: NumberSet::new(0),
            is_final: false,
        };
        let said = match self.fast_dds(prefix) {
            Some(_) => anew,
            None => ack,
        };
        Some((said, place))
    }

    /// Participants that have been silent for more than half of their lease, now and then: one announcement may be
    /// lost, and some say nothing else.
    pub fn silent(&mut self, now: Instant) -> Vec<Prefix> {
        let mut silent = vec![];
        for (prefix, one) in &mut self.participants {
            let lease = one.data.lease;
            if now.saturating_duration_since(one.heard) > lease / 2
                && now.saturating_duration_since(one.probed) > lease / 8
                && one.is_confirmed
            {
                one.probed = now;
                silent.push(*prefix);
            }
        }
        silent
    }

    /// Participants that are to be asked again of which endpoints they have told, and how often they were; of those
    /// that have acknowledged something.
    pub fn ask_again(&mut self, now: Instant) -> Vec<(Prefix, Side, u32)> {
        let mut due = vec![];
        for (prefix, one) in &mut self.participants {
            for side in Side::BOTH.into_iter().filter(|_| one.is_confirmed) {
                let times = one.told[side as usize].samples.asks_again(now);
                due.extend(times.map(|times| (*prefix, side, times)));
            }
        }
        due
    }

    /// Place of a participant that is one of Fast DDS.
    pub fn fast_dds(&self, prefix: Prefix) -> Option<Place> {
        let one = self.participants.get(&prefix)?;
        (one.data.vendor == FAST_DDS).then_some(one.data.meta)
    }

    /// Where a participant hears of others.
    pub fn place(&self, prefix: Prefix) -> Option<Place> {
        self.participants.get(&prefix).map(|one| one.data.meta)
    }

    /// All endpoints of a side.
    pub fn endpoints(&self, side: Side) -> impl Iterator<Item = &Endpoint> {
        let participants = self.participants.values();
        participants.flat_map(move |one| one.endpoints(side).values())
    }

    /// How many participants, readers and writers there are.
    #[cfg(any(test, fuzzing))]
    pub fn counts(&self) -> (usize, usize, usize) {
        let counts = Side::BOTH.map(|side| self.endpoints(side).count());
        assert_eq!(counts, self.counts);
        let told = self.participants.values().flat_map(|one| &one.told);
        for told in told {
            assert!((told.samples.ahead() as u64) < super::received::WINDOW);
        }
        (self.participants.len(), counts[0], counts[1])
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
            vendor: [0; 2],
        };
        let after = |seconds| start + Duration::from_secs(seconds);
        let soon = start + Duration::from_millis(10);
        for (id, lease) in [(1, 10), (2, 20), (3, 20)] {
            let news = discovery.participant([id; 12], data(lease), start);
            assert_eq!(news, News::New);
        }
        for id in [1, 2] {
            assert!(discovery.acknowledged([id; 12], Ipv4Addr::LOCALHOST, &[]));
        }
        assert_eq!(discovery.participant([2; 12], data(20), soon), News::Known);
        assert_eq!(
            discovery.participant([2; 12], data(20), after(5)),
            News::Unaware
        );
        assert!(discovery.hears([2; 12], Ipv4Addr::LOCALHOST, &[], after(5)));
        assert!(discovery.hears([3; 12], Ipv4Addr::LOCALHOST, &[], after(6)));
        assert!(discovery.hears([1; 12], Ipv4Addr::LOCALHOST, &[], after(9)));
        assert!(!discovery.hears([1; 12], Ipv4Addr::new(8, 8, 8, 8), &[], after(10)));
        assert!(discovery.expire(after(10)).is_empty());
        // The third goes on to say that it is there, and has acknowledged nothing.
        assert_eq!(discovery.expire(after(11)), [([3; 12], Some(meta))]);
        assert!(discovery.expire(after(19)).is_empty());
        assert_eq!(discovery.expire(after(20)), [([1; 12], None)]);
        assert_eq!(discovery.expire(after(26)), [([2; 12], None)]);
    }
}
