//! Plays a capture or a simulation: one sweep is shown at a time.
//!
//! A pipeline only goes forward. A step back is one of the last sweeps, which are kept; further back,
//! the capture is run again from its beginning. Sweeps on the way to the one that is shown are
//! decoded and not labelled.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use hyper::body::Bytes;

use super::index::NO_TURN;
use super::reader::{Decoded, Labels, Reader, SourceConfig, Step};
use crate::view::channels::{Command, Publisher, State, packed, sweep_bytes};
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::HeapBuffers;
use sweepd_core::segment::ConfigError;
use sweepd_core::sweep::SweepRef;

/// Sweeps that are kept for steps back.
const KEPT: usize = 16;
/// Longest time without a look at the commands.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// What a sweep may be late and still does not delay the next.
const LATE: Duration = Duration::from_millis(50);
/// How long the last sweep is seen before the first comes again.
const LAST: Duration = Duration::from_millis(500);
/// A capture of at most this many sweeps begins again by itself: else it would be over before anybody looks.
const SHORT: u64 = 100;
/// Longest pause of a capture that is played as long, nanoseconds.
const PAUSE_NS: i64 = 10_000_000_000;

/// Plays.
pub(super) struct Player {
    publisher: Publisher,
    source_config: SourceConfig,
    /// Begins again at the end.
    is_endless: bool,
    labels: Labels,
    /// For what is shown.
    buffers: HeapBuffers,
    reader: Option<Reader>,
    /// Number of the sensor that is shown; the index reads it.
    sensor: Arc<AtomicUsize>,
    /// Number of its section.
    section: usize,
    /// Place of the next sweep of the reader.
    next: u64,
    /// The last sweeps of the reader, without gaps.
    kept: VecDeque<Kept>,
    /// Place and arrival of the sweep that is shown.
    shown: Option<(u64, i64)>,
    /// The sweep that is to be shown at once.
    wanted: Option<u64>,
    /// The number of one whose place is to be found first.
    linked: Option<u64>,
    is_playing: bool,
    /// The last sweep was shown, and playing on would need another.
    is_at_end: bool,
    speed: f64,
    /// When the sweep that is shown was due.
    due: Instant,
    /// The capture cannot be opened any more.
    lost: Option<String>,
}

struct Kept {
    /// Its number.
    sequence: u64,
    sweep: KeptSweep,
}

enum KeptSweep {
    Decoded(HeapBuffer),
    Labelled(Bytes),
}

/// What a search for a sweep came to.
enum Found {
    Sweep(Bytes),
    NotYet,
    /// There are only this many.
    Fewer(u64),
}

impl Player {
    pub(super) fn new(
        publisher: Publisher,
        source_config: SourceConfig,
        is_endless: bool,
    ) -> Result<Self, ConfigError> {
        Ok(Self {
            labels: Labels::new(&source_config.sections)?,
            buffers: HeapBuffers::default(),
            publisher,
            source_config,
            is_endless,
            reader: None,
            sensor: Arc::default(),
            section: 0,
            next: 0,
            kept: VecDeque::new(),
            shown: None,
            wanted: Some(0),
            linked: None,
            is_playing: true,
            is_at_end: false,
            speed: 1.0,
            due: Instant::now(),
            lost: None,
        })
    }

    fn sensor(&self) -> usize {
        self.sensor.load(Ordering::Relaxed)
    }

    /// The number of the sensor that is shown, for the index.
    pub(super) fn chosen(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.sensor)
    }

    /// Plays until the end of the program.
    pub(super) fn run(mut self) {
        while !self.publisher.is_over() {
            // Of several places to go to, the last one counts.
            while let Ok(command) = self.publisher.commands.try_recv() {
                self.obey(command);
            }
            let wait = self.advance();
            self.tell();
            let until = Instant::now() + wait;
            loop {
                let rest = until.saturating_duration_since(Instant::now());
                match self.publisher.commands.recv_timeout(rest) {
                    Ok(command) => self.obey(command),
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                if self.wanted.is_some() {
                    break;
                }
            }
        }
    }

    /// Shows what is wanted or due; returns how long there is nothing to do.
    fn advance(&mut self) -> Duration {
        if let Some(sequence) = self.linked {
            match self.place_of(sequence) {
                Some(place) => self.seek(place),
                None => return Duration::ZERO,
            }
        }
        let playing = self.is_playing && !self.is_at_end && self.publisher.is_watched();
        let next = self.shown.map_or(0, |(index, _)| index + 1);
        let index = match self.wanted {
            Some(index) => index,
            None if playing => next,
            None => {
                // Time stands still.
                self.due = Instant::now();
                return LOOK_EVERY;
            }
        };
        match self.find(index) {
            Found::NotYet => Duration::ZERO,
            Found::Fewer(sweeps) if self.wanted.is_some() => {
                // Past the end: the last one.
                self.wanted = sweeps.checked_sub(1);
                self.is_at_end = true;
                Duration::ZERO
            }
            Found::Fewer(sweeps) if self.begins_again(sweeps) => {
                let rest = (self.due + LAST).saturating_duration_since(Instant::now());
                if rest.is_zero() {
                    self.wanted = Some(0);
                }
                rest.min(LOOK_EVERY)
            }
            Found::Fewer(_) => {
                self.is_at_end = true;
                Duration::ZERO
            }
            Found::Sweep(bytes) => {
                let Ok(sweep) = SweepRef::open(&bytes) else {
                    return LOOK_EVERY;
                };
                let arrival_ns = sweep.header.arrival_ns;
                let now = Instant::now();
                if self.wanted.take().is_some() {
                    self.due = now;
                } else {
                    let due = self.due + self.interval(arrival_ns);
                    if due > now {
                        return (due - now).min(LOOK_EVERY);
                    }
                    // What was late is not made up for: it would rush by.
                    self.due = due.max(now.checked_sub(LATE).unwrap_or(now));
                }
                self.shown = Some((index, arrival_ns));
                self.publisher.show(Some(index), 0, bytes);
                Duration::ZERO
            }
        }
    }

    /// Whether a capture of this many sweeps plays again at its end; a broken one does not.
    fn begins_again(&self, sweeps: u64) -> bool {
        sweeps > 1 && (self.is_endless || sweeps <= SHORT && self.trouble().is_none())
    }

    /// What is wrong with the capture.
    fn trouble(&self) -> Option<String> {
        let trouble = self.reader.as_ref().and_then(Reader::trouble);
        self.lost.clone().or(trouble)
    }

    fn obey(&mut self, command: Command) {
        let shown = self.shown.map_or(0, |(index, _)| index);
        match command {
            Command::Play => {
                if self.is_at_end {
                    self.wanted = Some(0);
                }
                self.is_playing = true;
                self.is_at_end = false;
            }
            Command::Pause => self.is_playing = false,
            Command::Step(by) => {
                self.is_playing = false;
                self.seek(self.wanted.unwrap_or(shown).saturating_add_signed(by));
            }
            Command::Seek(index) => self.seek(index),
            Command::Find(sequence) => {
                self.seek(0);
                self.linked = Some(sequence);
            }
            Command::Speed(factor) => self.speed = factor,
            Command::Choose(name) => {
                let sensors = self.publisher.description().sensors;
                if let Some(sensor) = sensors.iter().position(|sensor| *sensor == name)
                    && sensor != self.sensor()
                {
                    self.sensor.store(sensor, Ordering::Relaxed);
                    self.publisher.change_sensor();
                    self.publisher
                        .describe(|now| (now.sweeps, now.marks) = (Some(0), Vec::new()));
                    self.restart();
                    self.shown = None;
                    self.seek(0);
                }
            }
        }
    }

    fn seek(&mut self, index: u64) {
        (self.wanted, self.linked) = (Some(index), None);
        self.is_at_end = false;
    }

    /// From the sweep that is shown to one that arrived then, at the present speed.
    fn interval(&self, arrival_ns: i64) -> Duration {
        let before_ns = self.shown.map_or(arrival_ns, |(_, arrival_ns)| arrival_ns);
        let passed_ns = arrival_ns.saturating_sub(before_ns);
        // The clock was set, or the capture was paused for long.
        if !(0..PAUSE_NS).contains(&passed_ns) {
            return Duration::ZERO;
        }
        Duration::from_secs_f64(passed_ns as f64 * 1e-9 / self.speed)
    }

    fn restart(&mut self) {
        self.reader = None;
        self.next = 0;
        self.kept.clear();
    }

    /// Looks for a sweep for a while.
    fn find(&mut self, index: u64) -> Found {
        let first = self.next - self.kept.len() as u64;
        if index < first {
            self.restart();
        }
        let begun = Instant::now();
        while index >= self.next {
            match self.read() {
                Some(Step::Sweep(decoded)) => self.keep(decoded),
                Some(Step::More) => {}
                Some(Step::End) | None => return Found::Fewer(self.next),
            }
            if begun.elapsed() > LOOK_EVERY {
                return Found::NotYet;
            }
        }
        let first = self.next - self.kept.len() as u64;
        match self.label((index - first) as usize) {
            Some(bytes) => Found::Sweep(bytes),
            // Not a sweep that can be read.
            None => Found::Fewer(index),
        }
    }

    /// The place of the sweep of this number, or of the first one behind it; of the last one, where
    /// there is none. `None` while it is looked for.
    fn place_of(&mut self, sequence: u64) -> Option<u64> {
        if self
            .kept
            .front()
            .is_some_and(|first| first.sequence > sequence)
        {
            self.restart();
        }
        let begun = Instant::now();
        loop {
            if let Some(place) = self.kept.iter().position(|kept| kept.sequence >= sequence) {
                return Some(self.next - (self.kept.len() - place) as u64);
            }
            match self.read() {
                Some(Step::Sweep(decoded)) => self.keep(decoded),
                Some(Step::More) => {}
                Some(Step::End) | None => return Some(self.next.saturating_sub(1)),
            }
            if begun.elapsed() > LOOK_EVERY {
                return None;
            }
        }
    }

    fn read(&mut self) -> Option<Step> {
        if self.reader.is_none() && self.lost.is_none() {
            match Reader::open(&self.source_config) {
                Ok(reader) => self.reader = Some(reader),
                Err(error) => self.lost = Some(error.to_string()),
            }
        }
        self.reader.as_mut().map(Reader::step)
    }

    fn keep(&mut self, decoded: Decoded) {
        if decoded.sensor != self.sensor() {
            return;
        }
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        if decoded.section != self.section {
            self.section = decoded.section;
            let (segment, configured) = self.source_config.segment(self.section);
            self.publisher
                .describe(|now| (now.segment, now.configured) = (segment, configured));
        }
        self.next = decoded.index + 1;
        self.kept.push_back(Kept {
            sequence: decoded.sequence,
            sweep: KeptSweep::Decoded(decoded.buffer),
        });
    }

    /// One of the kept sweeps, with labels.
    fn label(&mut self, place: usize) -> Option<Bytes> {
        let kept = &mut self.kept.get_mut(place)?.sweep;
        if let KeptSweep::Decoded(buffer) = kept {
            self.labels.label(self.section, buffer);
            let empty = KeptSweep::Labelled(Bytes::new());
            if let KeptSweep::Decoded(buffer) = std::mem::replace(kept, empty) {
                let sweep = SweepRef::open(buffer.as_ref()).ok()?;
                let copy = packed(&mut self.buffers, &sweep, sweep.segments.len()).ok()?;
                *kept = KeptSweep::Labelled(sweep_bytes(copy)?);
            }
        }
        match kept {
            KeptSweep::Labelled(bytes) => Some(bytes.clone()),
            KeptSweep::Decoded(_) => None,
        }
    }

    /// Says how it is.
    fn tell(&self) {
        let trouble = self.trouble();
        let words = match (&trouble, self.shown, self.wanted) {
            (Some(trouble), None, _) => trouble.clone(),
            (Some(trouble), Some(_), _) => format!("{trouble}; what came before can be looked at"),
            (None, _, Some(index)) => match self.linked {
                Some(sequence) => format!("looking for sweep {sequence}"),
                None => format!(
                    "looking for sweep {} of the capture, at {}",
                    index + 1,
                    self.next
                ),
            },
            (None, None, None) => match self.reader.as_ref().map(Reader::missing).as_deref() {
                Some([missing, ..]) => missing.clone(),
                _ => NO_TURN.to_owned(),
            },
            _ if self.is_at_end => "the end".to_owned(),
            _ if self.is_playing => "playing".to_owned(),
            _ => "paused".to_owned(),
        };
        self.publisher.tell(State {
            words,
            ok: trouble.is_none(),
            playing: self.is_playing && !self.is_at_end,
            speed: self.speed,
            facts: BTreeMap::new(),
        });
    }
}
