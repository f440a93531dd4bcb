//! Which samples of a writer are there: what a reader says of them (section 8.4.12).

use super::wire::{Ack, NumberSet};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Samples ahead of the first that is missing.
pub const WINDOW: u64 = 256;

/// First pause after which a writer is asked again; doubled while nothing comes of it.
const ASK_INTERVAL: Duration = Duration::from_secs(1);

/// Times that the pause is doubled.
const MOST_DOUBLINGS: u32 = 5;

/// The numbers of the samples that are there, or will never come.
#[derive(Debug)]
pub struct Received {
    /// The first that is missing.
    pub next: u64,
    /// Those behind it, at most [`WINDOW`] ahead.
    ahead: BTreeSet<u64>,
    /// The newest that the writer told of.
    newest: u64,
    /// Set once the writer has said what it has. Who begins anew cannot know what the writer takes for acknowledged
    /// (section 8.4.12).
    is_told: bool,
    /// Moment at which the writer is asked again, and how often it was since a sample came.
    ask: (Instant, u32),
    /// Set when a sample came that was missing, until it counts for the next question.
    has_come: bool,
}

impl Received {
    /// No sample, of a writer that is asked now what it has.
    pub fn new(now: Instant) -> Self {
        Self {
            next: 1,
            ahead: BTreeSet::new(),
            newest: 0,
            is_told: false,
            ask: (now + ASK_INTERVAL, 0),
            has_come: false,
        }
    }

    /// Whether a sample is missing, and near enough to be kept in mind.
    pub fn wants(&self, number: u64) -> bool {
        number >= self.next && number - self.next < WINDOW && !self.ahead.contains(&number)
    }

    /// Takes a sample; says whether it was wanted.
    pub fn insert(&mut self, number: u64) -> bool {
        let wanted = self.wants(number);
        if wanted {
            self.ahead.insert(number);
            self.has_come = true;
            self.advance();
        }
        wanted
    }

    /// No sample before `number` will come any more.
    pub fn skip_to(&mut self, number: u64) {
        if number > self.next {
            self.next = number;
            self.ahead = self.ahead.split_off(&number);
        }
        self.advance();
    }

    /// The writer has the samples from `first` to `last`.
    pub fn heartbeat(&mut self, first: u64, last: u64) {
        self.skip_to(first);
        self.newest = last;
        self.is_told = true;
    }

    /// Counts a further question to the writer, if one is due: it has not said what it has, or not sent all of it. It
    /// may take that for acknowledged, and never send it by itself.
    pub fn asks_again(&mut self, now: Instant) -> Option<u32> {
        let (at, times) = self.ask;
        let has_all = self.is_told && self.next > self.newest;
        let has_come = std::mem::take(&mut self.has_come);
        if has_all || has_come {
            self.ask = (now + ASK_INTERVAL, 0);
            return None;
        }
        if now < at {
            return None;
        }
        let times = times + 1;
        let interval = ASK_INTERVAL * 2u32.pow(times.min(MOST_DOUBLINGS));
        self.ask = (now + interval, times);
        Some(times)
    }

    /// Those from `first` to before the base of `more` will never come, and those of `more`.
    pub fn gap(&mut self, first: u64, more: &NumberSet) {
        if first <= self.next {
            self.skip_to(more.base);
        } else {
            // One that begins later is asked about again, from the first that is missing on.
            for number in first..more.base.min(self.next + WINDOW) {
                self.insert(number);
            }
        }
        for number in more.iter() {
            self.insert(number);
        }
    }

    fn advance(&mut self) {
        while self.ahead.remove(&self.next) {
            self.next += 1;
        }
    }

    /// Acknowledgement for the writer: those that are missing, of those that it told of.
    pub fn ack(&self) -> Ack {
        let mut missing = NumberSet::new(self.next);
        for number in self.next..=self.newest.min(self.next + WINDOW - 1) {
            if !self.ahead.contains(&number) {
                missing.insert(number);
            }
        }
        Ack {
            is_final: self.is_told && missing.is_empty(),
            missing,
        }
    }

    /// How many are kept in mind.
    #[cfg(any(test, fuzzing))]
    pub fn ahead(&self) -> usize {
        self.ahead.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_kept_in_order_and_bounded() {
        let mut received = Received::new(Instant::now());
        assert!(received.insert(1) && received.insert(3) && !received.insert(3));
        received.heartbeat(1, 5);
        let missing = |received: &Received| received.ack().missing;
        assert!(missing(&received).iter().eq([2, 4, 5]));
        assert!(!received.insert(2 + WINDOW) && received.insert(1 + WINDOW));
        received.heartbeat(1, 1 << 61);
        assert_eq!(missing(&received).iter().count() as u64, WINDOW - 2);
        assert!(received.insert(2) && !received.insert(2));
        assert_eq!(received.next, 4);
        received.heartbeat(1 << 61, 7);
        assert_eq!((received.next, received.ahead.len()), (1 << 61, 0));
        assert!(missing(&received).is_empty());
    }

    #[test]
    fn a_writer_is_asked_until_it_says_what_it_has() {
        let start = Instant::now();
        let mut received = Received::new(start);
        let asks_at = |received: &mut Received, seconds| {
            let times = received.asks_again(start + Duration::from_secs(seconds))?;
            Some((seconds, times))
        };
        let asked: Vec<(u64, u32)> = (0..100)
            .filter_map(|seconds| asks_at(&mut received, seconds))
            .collect();
        let doubled = [(1, 1), (3, 2), (7, 3), (15, 4), (31, 5)];
        assert_eq!(asked, [&doubled[..], &[(63, 6), (95, 7)]].concat());
        // A sample alone says nothing of those before it.
        assert!(received.insert(2));
        let nothing = NumberSet::new(1);
        let ack = |missing, is_final| Ack { missing, is_final };
        assert_eq!(received.ack(), ack(nothing, false));
        received.heartbeat(2, 2);
        assert_eq!(received.ack(), ack(NumberSet::new(3), true));
        assert_eq!(asks_at(&mut received, 130), None);
        // What it has does not come.
        received.heartbeat(2, 3);
        let asked = [130, 131, 132, 133].map(|seconds| asks_at(&mut received, seconds));
        assert_eq!(asked, [None, Some((131, 1)), None, Some((133, 2))]);
        assert!(received.insert(3));
        let asked = [200, 201].map(|seconds| asks_at(&mut received, seconds));
        assert_eq!(asked, [None, None]);
        // Where some come, the count begins anew.
        received.heartbeat(2, 6);
        for (number, seconds) in [(4, 204), (5, 206)] {
            assert_eq!(asks_at(&mut received, seconds - 2), Some((seconds - 2, 1)));
            assert!(received.insert(number));
            assert_eq!(asks_at(&mut received, seconds - 1), None);
        }
    }
}
