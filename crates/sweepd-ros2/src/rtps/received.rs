//! Which samples of a writer are there: what a reader says of them (section 8.4.12).

use super::wire::NumberSet;
use std::collections::BTreeSet;

/// Samples ahead of the first that is missing.
pub const WINDOW: u64 = 256;

/// The numbers of the samples that are there, or will never come.
#[derive(Debug)]
pub struct Received {
    /// The first that is missing.
    pub next: u64,
    /// Those behind it, at most [`WINDOW`] ahead.
    ahead: BTreeSet<u64>,
    /// The newest that the writer told of.
    pub newest: u64,
}

impl Received {
    /// No sample.
    pub fn new() -> Self {
        Self {
            next: 1,
            ahead: BTreeSet::new(),
            newest: 0,
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

    /// Those that are missing, of those that the writer told of.
    pub fn missing(&self) -> NumberSet {
        let mut missing = NumberSet::new(self.next);
        for number in self.next..=self.newest.min(self.next + WINDOW - 1) {
            if !self.ahead.contains(&number) {
                missing.insert(number);
            }
        }
        missing
    }

    /// How many are kept in mind.
    #[cfg(test)]
    pub fn ahead(&self) -> usize {
        self.ahead.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_kept_in_order_and_bounded() {
        let mut received = Received::new();
        assert!(received.insert(1) && received.insert(3) && !received.insert(3));
        received.newest = 5;
        assert!(received.missing().iter().eq([2, 4, 5]));
        assert!(!received.insert(2 + WINDOW) && received.insert(1 + WINDOW));
        received.newest = 1 << 61;
        assert_eq!(received.missing().iter().count() as u64, WINDOW - 2);
        assert!(received.insert(2) && !received.insert(2));
        assert_eq!(received.next, 4);
        received.heartbeat(1 << 61, 7);
        assert_eq!((received.next, received.ahead.len()), (1 << 61, 0));
        assert!(received.missing().is_empty());
    }
}
