//! What follows from what others say: whom we meet, who reads and writes what, and who misses what.

use super::{ANSWER_RATIO, SHORT_LEASE, Shared, State, rival};
use crate::rtps::discovery::{
    Endpoint, MAX_ENDPOINTS, MAX_PARTICIPANTS, News, OwnAddresses, ParticipantData, Place, Side,
    Unreachable, is_own,
};
use crate::rtps::findings::NOBODY;
use crate::rtps::flow::lock;
use crate::rtps::parameters;
use crate::rtps::reader::Reader;
use crate::rtps::wire::{self, ANY_READER, Ack, Data, EntityId, Guid, Message, Prefix, Submessage};
use crate::rtps::writer::Outbox;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::atomic::Ordering;
use std::time::Instant;

impl Shared {
    /// Takes a datagram, from anyone: what follows from it.
    pub(super) fn receive(&self, datagram: &[u8], source: Ipv4Addr) -> Outbox {
        let mut out = Outbox::default();
        let mut state = lock(&self.state);
        if self.hears(source, &state.addresses)
            && let Some(mut submessages) = wire::read(datagram, self.prefix)
        {
            let prefix = submessages.source;
            while let Some(submessage) = submessages.next() {
                if submessages.names_us && submessage.acknowledges() {
                    self.confirm(&mut state, prefix, source, &mut out);
                }
                self.take(&mut state, prefix, source, submessage, &mut out);
            }
            state.limit(prefix, &mut out, ANSWER_RATIO * datagram.len());
        }
        out
    }

    fn take(
        &self,
        state: &mut State,
        prefix: Prefix,
        source: Ipv4Addr,
        submessage: Submessage,
        out: &mut Outbox,
    ) {
        let now = Instant::now();
        let is_there = (state.discovery).hears(prefix, source, &state.addresses, now);
        match submessage {
            Submessage::Data(data) if data.writer == wire::PARTICIPANTS_WRITER => {
                match data.disposed {
                    true if is_there => state.forget(prefix),
                    true => {}
                    false => self.announced(state, prefix, source, data.payload, out),
                }
            }
            // Anyone can speak in its name.
            Submessage::Data(_) | Submessage::Gap { .. } if !is_there => {}
            Submessage::Data(data) => match Side::told_by(data.writer) {
                Some(side) => state.told((prefix, side), &data, out),
                None => state.data(prefix, &data),
            },
            Submessage::Heartbeat {
                reader,
                writer,
                first,
                last,
            } => match Side::told_by(writer) {
                Some(side) => {
                    if is_there {
                        state.discovery.heartbeat(prefix, side, first, last);
                    }
                    match state.discovery.confirmed_host(prefix) {
                        Some(_) => self.ask_for_endpoints(state, prefix, side, out),
                        None => state.ask_whether_it_hears(prefix, out),
                    }
                }
                None if is_there => {
                    state.heartbeat(reader, Guid::new(prefix, writer), first, last, out);
                }
                None => {}
            },
            Submessage::Gap {
                reader,
                writer,
                first,
                more,
            } => match Side::told_by(writer) {
                Some(side) => state.discovery.gap(prefix, side, first, &more),
                None => {
                    for own in readers_named(&mut state.readers, reader) {
                        own.gap(Guid::new(prefix, writer), first, &more);
                    }
                }
            },
            acknowledgement => state.acknowledged(prefix, acknowledgement, out),
        }
    }

    /// A participant says that it is there, and where.
    fn announced(
        &self,
        state: &mut State,
        prefix: Prefix,
        source: Ipv4Addr,
        payload: &[u8],
        out: &mut Outbox,
    ) {
        match ParticipantData::read(payload, source, &state.addresses) {
            Some(Ok(data)) => self.meet(state, prefix, data, out),
            Some(Err(Unreachable)) => state.find_unreachable(prefix, source),
            None => {}
        }
    }

    /// A participant that names us acknowledges something: its readers on that host may get samples, and
    /// its writers there are heard.
    fn confirm(&self, state: &mut State, prefix: Prefix, source: Ipv4Addr, out: &mut Outbox) {
        if state.discovery.confirmed_host(prefix).is_some() {
            return;
        }
        let elsewhere = state
            .discovery
            .seen_elsewhere(prefix, source, &state.addresses);
        if let Some(data) = elsewhere {
            self.meet(state, prefix, data, out);
        }
        if !state
            .discovery
            .acknowledged(prefix, source, &state.addresses)
        {
            return;
        }
        let participant = Guid::new(prefix, wire::PARTICIPANT);
        state.ways.findings.end(participant);
        if let Some(host) = state.discovery.confirmed_host(prefix) {
            for (_, writer) in state.writers.values_mut() {
                writer.confirm(prefix, host, Instant::now(), out);
            }
        }
        for side in Side::BOTH {
            state.join(prefix, side, None, out);
            self.ask_for_endpoints(state, prefix, side, out);
        }
    }

    /// Warns of a participant, or of a subscriber of a topic, from which nothing comes back.
    pub(super) fn find_unheard(
        &self,
        state: &mut State,
        (topic, who): (Option<&str>, Guid),
        place: Place,
        now: Instant,
    ) {
        state.ways.findings.find(who, now, || {
            let what = match topic {
                Some(topic) => format!("{topic}: a subscriber"),
                None => "a participant".to_owned(),
            };
            let sockets = &self.transport.sockets;
            let via = sockets.source_to(*place.address.ip());
            let named = sockets.places(&self.environment, &state.addresses, via);
            let named: Vec<String> = named.iter().map(SocketAddrV4::to_string).collect();
            format!(
                "{what} at {} has acknowledged nothing for 10 s, and gets nothing: it was told that we are at {}; a \
                 firewall, an address translation or DDS Security may be between",
                place.address,
                named.join(", ")
            )
        });
    }

    /// Says to a participant of which of its endpoints we have heard.
    fn ask_for_endpoints(&self, state: &mut State, prefix: Prefix, side: Side, out: &mut Outbox) {
        if let Some(said) = state.discovery.ack(prefix, side) {
            self.say(state, (prefix, side), said, out);
        }
    }

    fn say(
        &self,
        state: &mut State,
        (prefix, side): (Prefix, Side),
        (ack, place): (Ack, Place),
        out: &mut Outbox,
    ) {
        let (reader, writer) = side.builtin();
        let (reader, writer) = (self.guid(reader), Guid::new(prefix, writer));
        out.message(place.address, state.ways.acknack(reader, writer, &ack));
    }

    /// "I am here for half a second." One of Fast DDS that was stopped for longer than our lease may know us, but
    /// none of our endpoints: it removes those for the lease that has ended, while it meets us anew by what waits
    /// in its socket. It takes nothing of us then, nor does that end, as each datagram renews the lease. It removes
    /// us for this one, and meets us at the next announcement.
    fn short_lease(&self, addresses: &OwnAddresses, place: Place) -> Message {
        // It reads no announcement twice.
        self.announced.fetch_add(1, Ordering::Relaxed);
        let via = self.transport.sockets.source_to(*place.address.ip());
        self.announcement_for(addresses, via, SHORT_LEASE)
    }

    /// Asks those that are silent whether they are there, and writers again of which something is missing.
    pub(super) fn ask_again(&self, state: &mut State, now: Instant, out: &mut Outbox) {
        for prefix in state.discovery.silent(now) {
            state.ask_whether_it_hears(prefix, out);
        }
        for (prefix, side, times) in state.discovery.ask_again(now) {
            if let Some(place) = state.discovery.fast_dds(prefix).filter(|_| times == 2) {
                out.message(place.address, self.short_lease(&state.addresses, place));
            }
            if let Some(said) = state.discovery.second_ack(prefix, side) {
                self.say(state, (prefix, side), said, out);
            }
        }
        for reader in state.readers.values_mut() {
            for (writer, ack, place) in reader.asks_again(now) {
                let message = state.ways.acknack(reader.guid, writer, &ack);
                out.message(place.address, message);
            }
        }
    }

    /// Answers a participant that says that it is there: that we are too, which writers and readers we
    /// have, and that we have heard of none of its yet.
    fn meet(&self, state: &mut State, prefix: Prefix, data: ParticipantData, out: &mut Outbox) {
        let place = data.meta;
        if let Some(displaced) = state.discovery.displaced_by(prefix) {
            state.forget(displaced);
        }
        let now = Instant::now();
        let news = state.discovery.participant(prefix, data, now);
        if news == News::Known {
            return;
        }
        let via = self.transport.sockets.source_to(*place.address.ip());
        let announcement = self.announcement(&state.addresses, via);
        out.message(place.address, announcement);
        if news == News::Unaware && state.discovery.confirmed_host(prefix).is_some() {
            return;
        }
        for side in Side::BOTH {
            self.ask_for_endpoints(state, prefix, side, out);
        }
        if news == News::Unaware {
            state.ask_whether_it_hears(prefix, out);
            return;
        }
        // One that was here before has moved.
        state.remove_endpoints(prefix);
        for side in Side::BOTH {
            let reader = Endpoint::builtin_reader(prefix, side, place);
            let link = state.ways.link(place);
            if let Some((_, telling)) = state.writers.get_mut(&side.builtin().1) {
                telling.add_reader(&reader, link, false, now, out);
            }
        }
    }
}

/// Our readers that a submessage names.
fn readers_named(
    readers: &mut BTreeMap<EntityId, Reader>,
    named: EntityId,
) -> impl Iterator<Item = &mut Reader> {
    let readers = readers.values_mut();
    readers.filter(move |own| named == ANY_READER || named == own.guid.entity)
}

impl State {
    /// The number of an endpoint that is new, and its kind.
    pub(super) fn new_entity(&mut self, kind: u8) -> EntityId {
        self.entities += 1;
        let [_, high, middle, low] = self.entities.to_be_bytes();
        [high, middle, low, kind]
    }

    /// Sends a heartbeat to a participant that has acknowledged nothing: what it answers shows where it is.
    fn ask_whether_it_hears(&self, prefix: Prefix, out: &mut Outbox) {
        let publications = self.writers.get(&wire::PUBLICATIONS_WRITER);
        if let Some(((_, publications), place)) = publications.zip(self.discovery.place(prefix)) {
            let reader = Guid::new(prefix, wire::PUBLICATIONS_READER);
            out.message(place.address, publications.heartbeat(reader));
        }
    }

    /// Takes messages out that have more than so many bytes in all, but of those to the host from which a
    /// participant has acknowledged something.
    fn limit(&self, prefix: Prefix, out: &mut Outbox, bytes: usize) {
        let host = self.discovery.confirmed_host(prefix);
        let mut left = bytes;
        out.messages.retain(|(to, message)| {
            let near = is_own(to.ip(), &self.addresses);
            let place = Place { address: *to, near };
            if host == Some(place.host()) {
                return true;
            }
            let rest = left.checked_sub(message.bytes().len());
            left = rest.unwrap_or(left);
            rest.is_some()
        });
    }

    /// Warns of a participant that cannot be reached.
    fn find_unreachable(&mut self, prefix: Prefix, source: Ipv4Addr) {
        let who = Guid::new(prefix, wire::PARTICIPANT);
        self.ways.findings.find(who, Instant::now(), || {
            let id: Vec<String> = prefix.iter().map(|byte| format!("{byte:02x}")).collect();
            format!(
                "the participant at {source} whose GIDs begin with {} gets nothing: it names no address of UDP over \
                 IPv4 that is reached from here; FASTDDS_BUILTIN_TRANSPORTS must be unset there, DEFAULT or UDPv4",
                id.join(".")
            )
        });
    }

    /// Warns of a participant that tells of an endpoint in fragments: they are not read.
    fn find_fragments(&mut self, by: Guid) {
        let place = self.discovery.place(by.prefix);
        self.ways.findings.find(by, Instant::now(), || {
            let at = place.map_or(String::new(), |place| format!(" at {}", place.address));
            format!(
                "a participant{at} tells of a subscriber or publisher in more than one fragment, which is not read: that \
                 one gets nothing; give it a shorter topic, or its DDS larger fragments"
            )
        });
    }

    /// Brings the endpoints of a participant together with those of ours that they match: one, or all of a
    /// side.
    fn join(&mut self, prefix: Prefix, side: Side, only: Option<EntityId>, out: &mut Outbox) {
        let host = self.discovery.confirmed_host(prefix);
        for endpoint in self.discovery.endpoints_of(prefix, side) {
            if only.is_some_and(|only| only != endpoint.guid.entity) {
                continue;
            }
            if side == Side::Writers {
                for reader in self.readers.values_mut() {
                    self.ways.join_writer(reader, endpoint, host, out);
                }
            }
            for (offer, writer) in self.writers.values_mut() {
                match (side, offer) {
                    (Side::Readers, Some(offer)) => {
                        self.ways.join((offer, writer), endpoint, host, out);
                    }
                    (Side::Writers, Some(offer)) => self.ways.find_rival(offer, endpoint, host),
                    (_, None) => {}
                }
            }
        }
    }

    /// Gives readers of ours that have room again the writers that found none.
    pub(super) fn fill_readers(&mut self, out: &mut Outbox) {
        for reader in self.readers.values_mut() {
            if !reader.has_room_again() {
                continue;
            }
            for writer in self.discovery.endpoints(Side::Writers) {
                let host = self.discovery.confirmed_host(writer.guid.prefix);
                self.ways.join_writer(reader, writer, host, out);
            }
        }
    }

    /// Warns that somebody found no room.
    pub(super) fn find_full(&mut self, now: Instant) {
        if std::mem::take(&mut self.discovery.is_full) {
            self.ways.findings.find(NOBODY, now, || {
                format!(
                    "{MAX_PARTICIPANTS} participants, or {MAX_ENDPOINTS} subscribers or publishers, are known on this \
                     ROS domain, the most that there is room for: others may get nothing until some leave"
                )
            });
        }
    }

    /// Gives a writer what a reader says of its samples; anything else is for nobody here.
    fn acknowledged(&mut self, prefix: Prefix, submessage: Submessage, out: &mut Outbox) {
        let now = Instant::now();
        match submessage {
            Submessage::AckNack {
                reader,
                writer,
                ack,
            } => {
                let from = Guid::new(prefix, reader);
                if let Some((_, writer)) = self.writers.get_mut(&writer) {
                    writer.acknack(from, &ack, now, out);
                    self.ways.findings.end(from);
                }
            }
            Submessage::NackFragment {
                reader,
                writer,
                number,
                missing,
            } => {
                let from = Guid::new(prefix, reader);
                if let Some((_, writer)) = self.writers.get_mut(&writer) {
                    writer.nack_fragment(from, number, missing, now, out);
                }
            }
            Submessage::Data(_) | Submessage::Heartbeat { .. } | Submessage::Gap { .. } => {}
        }
    }

    /// A participant has gone, or was never there.
    pub(super) fn forget(&mut self, prefix: Prefix) {
        self.discovery.forget(prefix);
        self.remove_endpoints(prefix);
    }

    /// The endpoints of a participant are no more.
    pub(super) fn remove_endpoints(&mut self, prefix: Prefix) {
        self.remove(|guid| guid.prefix == prefix);
        self.ways.drop_unused();
    }

    /// Endpoints of others are no more.
    fn remove(&mut self, gone: impl Fn(Guid) -> bool) {
        for (_, writer) in self.writers.values_mut() {
            writer.remove_readers(&gone);
        }
        for reader in self.readers.values_mut() {
            reader.remove_writers(&gone);
        }
    }

    /// A participant tells of an endpoint of its.
    fn told(&mut self, (prefix, side): (Prefix, Side), data: &Data, out: &mut Outbox) {
        let Data {
            number, payload, ..
        } = *data;
        if data.part.is_some() {
            self.find_fragments(Guid::new(prefix, data.writer));
            return;
        }
        if data.disposed {
            let key = data
                .key
                .or(parameters::guid(payload, parameters::ENDPOINT_GUID));
            let key = key.filter(|key| key.prefix == prefix);
            self.discovery.endpoint_ended(prefix, side, number, key);
            self.remove(|guid| Some(guid) == key);
            if side == Side::Writers {
                self.rival_ended(prefix);
            }
        } else {
            let own = &self.addresses;
            let endpoint = self
                .discovery
                .endpoint((prefix, side), number, payload, own);
            let Some(entity) = endpoint.map(|endpoint| endpoint.guid.entity) else {
                return;
            };
            self.join(prefix, side, Some(entity), out);
        }
        // One that was here before may have moved.
        self.ways.drop_unused();
    }

    /// A writer of a participant is no more: another of its may still be of a topic of ours.
    fn rival_ended(&mut self, prefix: Prefix) {
        self.ways.findings.end(rival(prefix));
        let offers = || {
            self.writers
                .values()
                .filter_map(|(offer, _)| offer.as_ref())
        };
        let mut writers = self.discovery.endpoints_of(prefix, Side::Writers);
        let rival =
            writers.find_map(|one| Some((offers().find(|offer| offer.has_rival(one))?, one)));
        if let Some((offer, writer)) = rival {
            let host = self.discovery.confirmed_host(prefix);
            self.ways.find_rival(offer, writer, host);
        }
    }

    /// A writer of others sends a sample, or a part of one.
    fn data(&mut self, prefix: Prefix, data: &Data) {
        for reader in readers_named(&mut self.readers, data.reader) {
            reader.data(Guid::new(prefix, data.writer), data);
        }
    }

    /// A writer of others says what it has: our readers say what they miss.
    fn heartbeat(
        &mut self,
        reader: EntityId,
        writer: Guid,
        first: u64,
        last: u64,
        out: &mut Outbox,
    ) {
        for own in readers_named(&mut self.readers, reader) {
            if let Some((ack, place)) = own.heartbeat(writer, first, last) {
                let message = self.ways.acknack(own.guid, writer, &ack);
                out.message(place.address, message);
            }
        }
    }
}
