//! The static peers: addresses that were given, and those that host names have at the moment.
//!
//! A look-up in the system's resolver may take many seconds, and cannot be cancelled. So each name has a
//! thread of its own, for which nobody waits.

use super::flow::lock;
use crate::environment::StaticPeer;
use crate::log;
use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Addresses used of one name. A laptop has two, in its wired and its wireless network.
const MAX_ADDRESSES: usize = 8;

type Addresses = BTreeSet<Ipv4Addr>;

/// Pauses between look-ups of a name.
#[derive(Clone, Copy)]
struct Pauses {
    until_known: Duration,
    when_known: Duration,
}

const PAUSES: Pauses = Pauses {
    until_known: Duration::from_secs(5),
    when_known: Duration::from_secs(60),
};

/// The static peers of a participant.
pub struct Peers(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    left: Condvar,
}

struct State {
    /// Addresses of each peer.
    addresses: Vec<Addresses>,
    has_left: bool,
}

impl Peers {
    /// Takes addresses at once, and begins to look up names.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(peers: &[StaticPeer]) -> io::Result<Self> {
        Self::resolved_by(resolve, PAUSES, peers)
    }

    fn resolved_by(
        resolve: impl Fn(&str) -> io::Result<Addresses> + Clone + Send + 'static,
        pauses: Pauses,
        peers: &[StaticPeer],
    ) -> io::Result<Self> {
        let known = |peer: &StaticPeer| match peer {
            StaticPeer::Address(address) => Addresses::from([*address]),
            StaticPeer::Name(_) => Addresses::new(),
        };
        let state = State {
            addresses: peers.iter().map(known).collect(),
            has_left: false,
        };
        let this = Self(Arc::new(Shared {
            state: Mutex::new(state),
            left: Condvar::new(),
        }));
        for (index, peer) in peers.iter().enumerate() {
            let StaticPeer::Name(name) = peer else {
                continue;
            };
            let (shared, name, resolve) = (Arc::clone(&this.0), name.clone(), resolve.clone());
            thread::Builder::new()
                .name("rtps-peer".to_owned())
                .spawn(move || shared.look_up(index, &name, resolve, pauses))?;
        }
        Ok(this)
    }

    /// Returns the addresses that are known now.
    pub fn addresses(&self) -> Vec<Ipv4Addr> {
        let state = lock(&self.0.state);
        state.addresses.iter().flatten().copied().collect()
    }

    /// True if a peer has that address now.
    pub fn contains(&self, address: Ipv4Addr) -> bool {
        let state = lock(&self.0.state);
        state.addresses.iter().any(|of| of.contains(&address))
    }

    /// Ends the look-ups; one that is under way is without effect.
    pub fn leave(&self) {
        lock(&self.0.state).has_left = true;
        self.0.left.notify_all();
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        self.leave();
    }
}

impl Shared {
    /// Looks up the name of a peer until the participant leaves. One that was known keeps its addresses
    /// until it has others.
    fn look_up(
        &self,
        index: usize,
        name: &str,
        resolve: impl Fn(&str) -> io::Result<Addresses>,
        pauses: Pauses,
    ) {
        let mut known = Addresses::new();
        let mut is_warned = false;
        let mut pause = Duration::ZERO;
        while !self.leaves_within(pause) {
            let found = resolve(name);
            if self.leaves_within(Duration::ZERO) {
                return;
            }
            match found {
                Ok(found) if found == known => {}
                Ok(found) => {
                    lock(&self.state).addresses[index].clone_from(&found);
                    log::info(format_args!("{}", news(name, &found, &known)));
                    known = found;
                }
                Err(error) if known.is_empty() && !is_warned => {
                    is_warned = true;
                    log::warn(format_args!(
                        "static peer {name} is not known: {error}; check the name and the network; \
                         it is looked up again every {} s",
                        pauses.until_known.as_secs()
                    ));
                }
                Err(_) => {}
            }
            pause = match known.is_empty() {
                true => pauses.until_known,
                false => pauses.when_known,
            };
        }
    }

    /// Waits that long, or until the participant leaves; true if it does.
    fn leaves_within(&self, pause: Duration) -> bool {
        let state = lock(&self.state);
        let waited = (self.left).wait_timeout_while(state, pause, |state| !state.has_left);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.has_left
    }
}

/// Returns the line of the log for addresses that are new.
fn news(name: &str, found: &Addresses, before: &Addresses) -> String {
    let list = |addresses: &Addresses| {
        let words: Vec<String> = addresses.iter().map(Ipv4Addr::to_string).collect();
        words.join(", ")
    };
    let mut line = format!("static peer {name} is {}", list(found));
    if !before.is_empty() {
        line += &format!("; it was {}", list(before));
    }
    line
}

/// Asks the system for the IPv4 addresses of a name: all, as the peer may be reached at one alone.
fn resolve(name: &str) -> io::Result<Addresses> {
    let found = (name, 0).to_socket_addrs()?;
    let found: Addresses = found
        .filter_map(|address| match address.ip() {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        })
        .collect();
    match found.is_empty() {
        true => Err(io::Error::other("it has no IPv4 address")),
        // The least: the same ones in whatever order a name server gives them.
        false => Ok(found.into_iter().take(MAX_ADDRESSES).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
    use std::time::Instant;

    const NEVER: Duration = Duration::from_secs(3_600);
    const PATIENCE: Duration = Duration::from_secs(60);

    fn name(name: &str) -> StaticPeer {
        StaticPeer::Name(name.to_owned())
    }

    fn address(last: u8) -> Ipv4Addr {
        Ipv4Addr::new(10, 0, 0, last)
    }

    fn found(last: &[u8]) -> io::Result<Addresses> {
        match last {
            [] => Err(io::Error::other("nobody answers")),
            last => Ok(last.iter().copied().map(address).collect()),
        }
    }

    /// A resolver that tells of each look-up, and then waits for an answer; an empty one is an error. What it
    /// tells ends when no thread has it any more.
    fn resolver(
        answers: Receiver<&'static [u8]>,
        ask: Sender<String>,
    ) -> impl Fn(&str) -> io::Result<Addresses> + Clone + Send {
        let answers = Arc::new(Mutex::new(answers));
        move |name: &str| {
            ask.send(name.to_owned()).unwrap();
            found(lock(&answers).recv().unwrap_or_default())
        }
    }

    /// Waits until the peers have these addresses and no others.
    fn until(peers: &Peers, last: &[u8]) {
        let expected: Vec<Ipv4Addr> = last.iter().copied().map(address).collect();
        let begun = Instant::now();
        while peers.addresses() != expected {
            assert!(begun.elapsed() < PATIENCE, "{:?}", peers.addresses());
            thread::sleep(Duration::from_millis(1));
        }
        for last in 0..=u8::MAX {
            let is_expected = expected.contains(&address(last));
            assert_eq!(peers.contains(address(last)), is_expected);
        }
    }

    #[test]
    fn a_name_is_looked_up_until_it_is_known() {
        let ((answer, answers), (ask, asked)) = (channel(), channel());
        let pauses = Pauses {
            until_known: Duration::ZERO,
            when_known: NEVER,
        };
        let peers =
            Peers::resolved_by(resolver(answers, ask), pauses, &[name("roof.test")]).unwrap();
        for last in [&[][..], &[], &[7, 9]] {
            assert_eq!(asked.recv_timeout(PATIENCE).unwrap(), "roof.test");
            assert!(peers.addresses().is_empty());
            answer.send(last).unwrap();
        }
        until(&peers, &[7, 9]);
        // It waits for the next look-up by now, or begins to; the end of both is at once.
        peers.leave();
        let next = asked.recv_timeout(PATIENCE);
        assert_eq!(next, Err(RecvTimeoutError::Disconnected));
    }

    #[test]
    fn a_name_that_is_known_is_looked_up_for_changes_and_the_log_has_each_once() {
        let ((answer, answers), (ask, asked)) = (channel(), channel());
        let pauses = Pauses {
            until_known: Duration::ZERO,
            when_known: Duration::ZERO,
        };
        let peers =
            Peers::resolved_by(resolver(answers, ask), pauses, &[name("deck.test")]).unwrap();
        let answers = [
            (&[][..], &[][..]),
            (&[], &[]),
            (&[7], &[7]),
            (&[7], &[7]),
            // What does not answer for a while has not moved.
            (&[], &[7]),
            (&[9, 8], &[8, 9]),
            (&[8, 9], &[8, 9]),
        ];
        let mut lines = vec![];
        for (last, expected) in answers {
            assert_eq!(asked.recv_timeout(PATIENCE).unwrap(), "deck.test");
            answer.send(last).unwrap();
            until(&peers, expected);
            // The log keeps a hundred lines, also of other tests.
            lines.extend(log::take());
        }
        // The last answer is told of when it asks again.
        asked.recv_timeout(PATIENCE).unwrap();
        lines.extend(log::take());
        let lines: Vec<String> = lines
            .into_iter()
            .map(|line| line.text)
            .filter(|line| line.contains("deck.test"))
            .collect();
        assert_eq!(
            lines,
            [
                "static peer deck.test is not known: nobody answers; check the name and the network; \
                 it is looked up again every 0 s",
                "static peer deck.test is 10.0.0.7",
                "static peer deck.test is 10.0.0.8, 10.0.0.9; it was 10.0.0.7",
            ]
        );
    }

    #[test]
    fn a_look_up_that_hangs_delays_neither_the_others_nor_the_end() {
        let ((answer, answers), (ask, asked)) = (channel(), channel());
        let hangs = resolver(answers, ask);
        let resolve = move |name: &str| match name {
            "slow.test" => hangs(name),
            _ => found(&[2]),
        };
        let all = [
            name("slow.test"),
            StaticPeer::Address(address(1)),
            name("quick.test"),
        ];
        let peers = Peers::resolved_by(resolve, PAUSES, &all).unwrap();
        assert!(peers.contains(address(1)));
        until(&peers, &[1, 2]);
        asked.recv_timeout(PATIENCE).unwrap();
        peers.leave();
        answer.send(&[3]).unwrap();
        let next = asked.recv_timeout(PATIENCE);
        assert_eq!(next, Err(RecvTimeoutError::Disconnected));
        until(&peers, &[1, 2]);
    }

    #[test]
    fn the_system_resolves_names_to_addresses_of_ipv4() {
        let own = resolve("localhost").unwrap();
        assert!(own.contains(&Ipv4Addr::LOCALHOST));
        assert!(resolve("::1").is_err());
    }
}
