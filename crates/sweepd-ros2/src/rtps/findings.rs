//! Findings: what is wrong with others on the domain. Each is a line of the log once, and is kept for as long as it
//! lasts.

use super::wire::Guid;
use crate::log;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Most findings that are kept. When there are that many, those that are over make room, [`ROOM_EVERY`].
pub const MAX_FINDINGS: usize = 16;
const ROOM_EVERY: Duration = Duration::from_secs(60);

/// A finding about nobody in particular.
pub const NOBODY: Guid = Guid {
    prefix: [0; 12],
    entity: [0; 4],
};

/// Time that a finding lasts when what it is about is no longer known: participants announce themselves more
/// often.
const LASTS: Duration = Duration::from_secs(30);

struct Finding {
    text: String,
    found: Instant,
    has_ended: bool,
}

/// The findings, by the participant or endpoint that they are about. They stay when that is forgotten: one that
/// comes back is not told of again.
#[derive(Default)]
pub struct Findings {
    all: BTreeMap<Guid, Finding>,
    /// Moment at which room was made last.
    cleared: Option<Instant>,
}

impl Findings {
    /// Notes that something is wrong with a participant or an endpoint.
    pub fn find(&mut self, of: Guid, now: Instant, text: impl FnOnce() -> String) {
        if let Some(known) = self.all.get_mut(&of) {
            if std::mem::take(&mut known.has_ended) {
                known.text = text();
            }
            known.found = now;
            return;
        }
        let is_due = self.cleared.is_none_or(|at| now - at > ROOM_EVERY);
        if self.all.len() == MAX_FINDINGS && is_due {
            self.all
                .retain(|_, one| !one.has_ended && now < one.found + LASTS);
            self.cleared = Some(now);
        }
        if self.all.len() < MAX_FINDINGS {
            let finding = Finding {
                text: text(),
                found: now,
                has_ended: false,
            };
            log::warn(format_args!("{}", finding.text));
            self.all.insert(of, finding);
        }
    }

    /// Notes that something is well again.
    pub fn end(&mut self, of: Guid) {
        if let Some(finding) = self.all.get_mut(&of) {
            finding.has_ended = true;
        }
    }

    /// Says what is wrong at a time.
    pub fn lasting(&self, now: Instant, is_known: impl Fn(Guid) -> bool) -> Vec<String> {
        let lasts = |(of, one): &(&Guid, &Finding)| {
            !one.has_ended && (is_known(**of) || now < one.found + LASTS)
        };
        let lasting = self.all.iter().filter(lasts);
        lasting.map(|(_, one)| one.text.clone()).collect()
    }

    /// Counts those that are kept.
    #[cfg(any(test, fuzzing))]
    pub fn len(&self) -> usize {
        self.all.len()
    }
}
