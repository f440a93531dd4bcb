//! Around the cut: the end of a turn and the beginning of the next as one image, so that objects
//! there are emitted as soon as the head has passed them.
//!
//! ```text
//! image   | the last columns of the turn before (tail) | the first of this turn, as they come |
//!                                                     cut
//! keep    of a complete turn its tail
//! follow  the columns of the next turn that are final: strips are joined, what has ended is emitted
//! ```
//!
//! The strips of the turn itself begin behind its first columns, and see these when it is complete,
//! beside its end.

use fearless_simd::Level;
use zerocopy::IntoBytes;

use super::config::Config;
use super::objects::{Cut, Objects};
use super::order::{AHEAD, BEFORE, Order, STRIP};
use super::strips::Strips;
use crate::sweep::layout::{Shape, flags};
use crate::sweep::objects::Object;
use crate::sweep::{Segment, SweepMut};

/// Times in the image begin this long before the first shot of the turn, nanoseconds: those of the
/// turn before are positive, too.
const BEFORE_NS: i64 = 1 << 30;

/// The image around a cut, and what is followed there.
#[derive(Clone, Debug)]
pub(super) struct Seam {
    strips: Strips,
    image: Vec<u64>,
    /// The turn before, by its number, and the sensor's time of its first shot, nanoseconds.
    turn: Option<(u64, i64)>,
    /// Its rows and columns, and how many of these are in the image.
    rows: usize,
    columns: usize,
    tail: usize,
    /// Columns of this turn that the image has room for, and how many of them a firing reaches
    /// back over: of the last ones not all pixels are there.
    room: usize,
    lead: usize,
    /// Columns of this turn in the image: firings, and final pixels.
    fired: usize,
    final_columns: usize,
}

impl Seam {
    pub fn new(level: Level) -> Self {
        Self {
            strips: Strips::new(level),
            image: Vec::new(),
            turn: None,
            rows: 0,
            columns: 0,
            tail: 0,
            room: 0,
            lead: 0,
            fired: 0,
            final_columns: 0,
        }
    }

    /// Keeps the end of a complete turn.
    pub fn keep(&mut self, sweep: &SweepMut<'_>, config: &Config) {
        self.turn = None;
        self.strips.objects = None;
        if !sweep.header.has(flags::CIRCULAR) || sweep.header.columns == 0 {
            return;
        }
        let of = sweep.as_ref();
        let (rows, columns) = (of.rows(), of.columns.len());
        let start = Order::new(&of, None).start;
        let shifts = of.beams.iter().map(|beam| beam.shift.max(0) as usize);
        let lead = shifts.max().unwrap_or(0).min(columns);
        let width = config.max_width_rad / std::f32::consts::TAU * columns as f32;
        let width = (width as usize).min(columns);
        let tail = (start + BEFORE + width).min(columns);
        // To where the widest object that begins before the strips of the turn do is known to have
        // ended.
        let room = start + BEFORE + width + 2 * STRIP + AHEAD + lead;
        let shape = Shape {
            rows,
            columns_capacity: tail + room,
            dual: false,
            segments_capacity: 0,
        };
        let words = shape.total_bytes().div_ceil(size_of::<u64>());
        self.image.resize(words, 0);
        let Ok(image) = SweepMut::create(self.image.as_mut_bytes(), &shape) else {
            return;
        };
        image.range.fill(0.0);
        image.columns[..tail].copy_from_slice(&of.columns[columns - tail..]);
        image.beams.copy_from_slice(of.beams);
        for (row, beam) in of.beams.iter().enumerate() {
            // What this turn fired: up to there, counted from the cut. What lies behind the cut
            // stands at the beginning of its image.
            let end = tail
                .saturating_add_signed(-beam.shift as isize)
                .min(tail + room);
            for at in 0..end {
                let column = (columns - tail + at) % columns;
                image.range[at * rows + row] = of.range[column * rows + row];
            }
        }
        self.turn = Some((of.header.sequence, of.header.sensor_time_ns));
        (self.rows, self.columns, self.tail) = (rows, columns, tail);
        (self.room, self.lead) = (room, lead);
        (self.fired, self.final_columns) = (0, 0);
    }

    /// Columns of the open sweep that must be final before more is known here; `None` when all is.
    pub fn next_columns(&self) -> Option<usize> {
        self.turn?;
        self.strips.objects.as_ref()?;
        Some(self.strips.next_columns().saturating_sub(self.tail))
    }

    /// Forgets the turn before: this one has changed behind its beginning.
    pub fn spoil(&mut self) {
        self.turn = None;
    }

    /// Takes the columns of the open sweep of which the first `ready` are final, and adds to the
    /// objects what has ended.
    pub fn follow(
        &mut self,
        sweep: &SweepMut<'_>,
        ready: usize,
        config: &Config,
        height_m: Option<f32>,
        objects: &mut Objects,
    ) {
        let Some((before, time_ns)) = self.turn else {
            return;
        };
        let trail = Order::new(&sweep.as_ref(), None)
            .start
            .saturating_sub(STRIP);
        let is_next = sweep.header.sequence == before + 1
            && sweep.header.rows as usize == self.rows
            && trail < self.tail;
        if !is_next {
            self.turn = None;
        } else if ready > trail {
            self.follow_next(sweep, ready, time_ns, config, height_m, objects);
        }
    }

    fn follow_next(
        &mut self,
        sweep: &SweepMut<'_>,
        ready: usize,
        time_ns: i64,
        config: &Config,
        height_m: Option<f32>,
        objects: &mut Objects,
    ) {
        // Taken out, so that it can be lent beside what follows it.
        let mut bytes = std::mem::take(&mut self.image);
        let Ok(mut image) = SweepMut::open(bytes.as_mut_bytes()) else {
            return;
        };
        let turn_ns = sweep.header.sensor_time_ns.saturating_sub(time_ns);
        self.copy_new(&mut image, sweep, ready, turn_ns);
        self.join(&mut image, sweep.header.sequence, config, height_m);
        self.hand_on(objects);
        let is_full = self.final_columns + self.lead >= self.room;
        let around_cut = self.strips.objects.as_ref();
        if is_full || around_cut.is_none_or(Objects::is_past_cut) {
            self.turn = None;
        }
        self.image = bytes;
    }

    /// Copies the columns that are new. `turn_ns` is how long the turn before took.
    fn copy_new(
        &mut self,
        image: &mut SweepMut<'_>,
        sweep: &SweepMut<'_>,
        ready: usize,
        turn_ns: i64,
    ) {
        let rows = image.beams.len();
        let [margin, fired] =
            [sweep.header.margin_columns, sweep.header.columns].map(|it| it as usize);
        if self.fired == 0 {
            image.beams.copy_from_slice(sweep.beams);
            for column in &mut image.columns[..self.tail] {
                let time_ns = BEFORE_NS + i64::from(column.time_ns) - turn_ns;
                column.time_ns = u32::try_from(time_ns).unwrap_or(0);
            }
            // Pixels that this turn fired before the cut.
            for (row, beam) in sweep.beams.iter().enumerate() {
                let first = usize::try_from(beam.shift).unwrap_or(0).min(margin);
                for back in 1..=first.min(self.tail) {
                    image.range[(self.tail - back) * rows + row] =
                        sweep.range[(margin - back) * rows + row];
                }
            }
        }
        for at in self.fired..fired.min(self.room) {
            let mut column = sweep.columns[margin + at];
            column.time_ns = column.time_ns.saturating_add(BEFORE_NS as u32);
            image.columns[self.tail + at] = column;
        }
        let ready = ready.min(self.room - self.lead);
        for at in self.final_columns..ready {
            let from = &sweep.range[(margin + at) * rows..][..rows];
            let onto = &mut image.range[(self.tail + at) * rows..][..rows];
            for ((row, beam), range_m) in sweep.beams.iter().enumerate().zip(from) {
                // What the turn before fired behind the cut stays.
                if at as i64 + i64::from(beam.shift) >= 0 {
                    onto[row] = *range_m;
                }
            }
        }
        self.fired = fired.min(self.room);
        self.final_columns = ready;
    }

    fn join(
        &mut self,
        image: &mut SweepMut<'_>,
        sequence: u64,
        config: &Config,
        height_m: Option<f32>,
    ) {
        image.header.columns = (self.tail + self.fired) as u32;
        image.header.flags = flags::CIRCULAR;
        image.header.sequence = sequence;
        let ready = Some(self.tail + self.final_columns);
        if self.strips.objects.is_none() {
            let trail = Order::new(&image.as_ref(), None).start - STRIP;
            let cut = Cut {
                at: self.tail - trail,
                until: self.tail + STRIP + BEFORE,
            };
            self.strips.objects = Some(Objects::around(cut));
            self.strips.begin(image, config, height_m, ready);
        } else {
            self.strips.go_on(image, ready);
        }
        while self.strips.find_ground(image, config) {
            self.strips.join();
            self.strips.emit(image, config);
        }
    }

    /// Hands on what is new, as of this turn.
    fn hand_on(&mut self, objects: &mut Objects) {
        let Some(around_cut) = &mut self.strips.objects else {
            return;
        };
        let (tail, columns) = (self.tail as i64, self.columns as i64);
        for found in around_cut.take().1 {
            let mut object: Object = *found;
            let Segment {
                column_first,
                column_last,
                ..
            } = &mut object.segment;
            for column in [column_first, column_last] {
                *column = (i64::from(*column) - tail).rem_euclid(columns) as u32;
            }
            object.first_pixel -= (self.tail * self.rows) as u32;
            for time_ns in [&mut object.first_ns, &mut object.last_ns] {
                *time_ns -= BEFORE_NS as i32;
            }
            objects.push(object);
        }
    }
}
