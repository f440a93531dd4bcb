//! Objects while the head turns: a component that no later strip can join is emitted at
//! once, with the entry that it will have in the segments table.
//!
//! ```text
//! follow   after each strip: which components go on, which have ended, which are emitted
//! end      when the table is complete: emits the other segments, and the label of each object
//! ```
//!
//! A component has **ended** when its last column lies so far back that no window of a later strip
//! reaches it. It is emitted when it is also certain which small components become part of it: those
//! near it have ended too, and so has every component that they may join instead. A component with
//! a pixel in the first columns that are processed of a turn is emitted with the sweep; `seam` emits
//! the objects around the cut earlier.

use std::cmp::Reverse;

use fearless_simd::Simd;
use zerocopy::FromZeros;

use super::components::{Components, Near, Sum};
use super::order::{BEFORE, MOST_COLUMNS, Order, STRIP};
use super::runs::Runs;
use super::wide::Wide;
use crate::sweep::image::pixel_azimuth_rad;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE, flags};
use crate::sweep::objects::{Object, why};
use crate::sweep::{Header, Segment, SweepRef};

/// Where objects around a cut are emitted, position by position: those with a pixel behind it, and one
/// before `until`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    pub at: usize,
    pub until: usize,
}

/// Stands for no component.
const NONE: u32 = u32::MAX;

/// What is emitted of one sweep after another.
#[derive(Clone, Debug, Default)]
pub struct Objects {
    /// Whether these are the objects around a cut.
    cut: Option<Cut>,
    /// Position behind the last strip that was followed.
    followed: usize,
    /// The sweep, by its number, and whether strips of it are still followed.
    sequence: Option<u64>,
    is_followed: bool,
    /// Columns before the image's first, when it was begun.
    margin: u32,
    emitted: Vec<Object>,
    /// How many of them were handed out.
    handed: usize,
    /// Of a complete sweep, the label of each emitted object.
    labels: Option<Vec<u32>>,
    open: Vec<Open>,
    /// Index in `open` of the component of each root.
    slots: Vec<u32>,
    /// Pairs of an unsettled small component and one that is near it.
    notes: Vec<Near>,
    /// Notes of the components that were taken, and how often these were thinned before.
    taken: (usize, u32),
    gifts: Vec<Gift>,
}

/// A component that may still be emitted.
#[derive(Clone, Copy, Debug)]
struct Open {
    root: u32,
    whole: Extent,
    /// What was not emitted in parts.
    part: Extent,
    sum: Sum,
    /// Whether a part was emitted.
    is_parted: bool,
    has_ended: bool,
    /// Whether it has been emitted, or became part of another, or never will be.
    is_settled: bool,
    /// Of a small one: the nearest that is not small.
    nearest: Nearest,
    /// Whether it has not ended, or not all that it may become part of, or that may become part of
    /// it.
    waits: bool,
}

/// What is nearest to a small component: of two as near, that with the lower first pixel.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
struct Nearest {
    /// Distance, squared.
    apart2: f32,
    first: u32,
    root: u32,
}

impl Nearest {
    const NONE: Self = Self {
        apart2: f32::INFINITY,
        first: NONE,
        root: NONE,
    };
}

/// A small component that became part of another one.
#[derive(Clone, Copy, Debug)]
struct Gift {
    small: u32,
    large: u32,
    whole: Extent,
}

/// Where something lies, position by position.
#[derive(Clone, Copy, Debug)]
struct Extent {
    first: usize,
    last: usize,
    first_shot: Shot,
    /// [With its row flipped](Shot::with_row_flipped).
    last_shot: Shot,
    /// Its first pixel behind the cut, if there is one.
    first_behind: u32,
}

/// A pixel's shot as one number, which is fast to compare: the position of its firing, its time in
/// the firing, its row. The first shot has the least; of two at the same time, the lower row comes
/// first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Shot(u64);

impl Shot {
    fn new(firing: usize, offset_ns: u32, row: usize) -> Self {
        Self((firing as u64) << 40 | u64::from(offset_ns) << 8 | row as u64)
    }

    fn firing(self) -> usize {
        (self.0 >> 40) as usize
    }

    fn row(self) -> usize {
        (self.0 & 0xFF) as usize
    }

    /// With the row's bits flipped, or back. The last shot has the greatest then; of two at the same
    /// time, that with the lower row, too.
    fn with_row_flipped(self) -> Self {
        Self(self.0 ^ 0xFF)
    }
}

impl Extent {
    const NONE: Self = Self {
        first: usize::MAX,
        last: 0,
        first_shot: Shot(u64::MAX),
        last_shot: Shot(0),
        first_behind: u32::MAX,
    };

    fn add(&mut self, other: &Self) {
        self.first = self.first.min(other.first);
        self.last = self.last.max(other.last);
        self.first_behind = self.first_behind.min(other.first_behind);
        self.first_shot = self.first_shot.min(other.first_shot);
        self.last_shot = self.last_shot.max(other.last_shot);
    }

    fn columns(&self) -> usize {
        (self.last + 1).saturating_sub(self.first)
    }
}

impl Objects {
    /// Emits what lies around a cut.
    pub(super) fn around(cut: Cut) -> Self {
        Self {
            cut: Some(cut),
            ..Self::default()
        }
    }

    /// The reason to emit an object of this extent, or `None` if it is not emitted here; `usual` where
    /// there is no cut.
    fn reason(&self, extent: &Extent, usual: u32) -> Option<u32> {
        match self.cut {
            None => Some(usual),
            Some(cut) if extent.last < cut.at || extent.first >= cut.until => None,
            Some(_) => Some(why::SEAM),
        }
    }

    /// Whether all that lies around the cut was followed to its end.
    pub(super) fn is_past_cut(&self) -> bool {
        let until = self.cut.map_or(0, |cut| cut.until);
        let mut open = self.open.iter();
        self.followed >= until && open.all(|open| open.whole.first >= until)
    }

    /// Begins to follow the strips of a sweep. A second call for the same sweep means that it has
    /// changed: objects emitted before stay, the others are emitted when it is complete.
    pub(super) fn begin(&mut self, header: &Header, is_early: bool) {
        let sequence = header.sequence;
        let is_again = self.sequence == Some(sequence) && self.labels.is_none();
        if !is_again {
            self.emitted.clear();
            self.handed = 0;
            self.margin = header.margin_columns;
        }
        self.labels = None;
        self.sequence = Some(sequence);
        self.is_followed = is_early && !is_again;
        self.open.clear();
        self.slots.clear();
        self.notes.clear();
        self.taken = (0, 0);
        self.gifts.clear();
    }

    /// The objects emitted since the last call, and the ordinal of the first of them; when the sweep
    /// is complete also the label of each of its objects, 0 where a late packet has changed the
    /// object, so that the table has no such segment.
    pub fn take(&mut self) -> (usize, &[Object], Option<&[u32]>) {
        let from = std::mem::replace(&mut self.handed, self.emitted.len());
        (from, &self.emitted[from..], self.labels.as_deref())
    }

    /// Takes the strip at a position, the columns of it that count, and what its runs measure.
    #[inline(always)]
    pub(super) fn follow<S: Simd>(
        &mut self,
        simd: S,
        strip: Strip<'_>,
        components: &mut Components,
        min_points: u32,
    ) {
        if !self.is_followed {
            return;
        }
        self.slots.resize(components.pieces(), NONE);
        // First, or a run would begin a second entry for a component that has another root by now.
        self.unite(simd, components);
        self.add_runs(simd, &strip, components);
        self.followed = strip.position + STRIP;
        self.emit_parts(&strip, min_points);
        self.settle(components);
        self.emit_whole(simd, &strip, components, min_points);
        self.forget_settled();
    }

    /// Finds what has ended, and emits parts of what is too wide.
    fn emit_parts(&mut self, strip: &Strip<'_>, min_points: u32) {
        // No window of a later strip reaches further back.
        let reached = self.followed - MOST_COLUMNS;
        for index in 0..self.open.len() {
            let open = &mut self.open[index];
            let is_behind = open.whole.last < reached;
            // These columns come again at the end of the turn, and may be joined to what ends
            // there.
            let is_at_seam = open.whole.first < STRIP + BEFORE;
            open.has_ended = is_behind && !is_at_seam;
            // The last part waits for no small ones: it is the whole that has them, with the sweep.
            let is_wide = strip.wide.spans(open.part.columns()) || open.is_parted && is_behind;
            if is_wide && open.sum.points >= min_points.max(1) {
                open.is_parted = true;
                let Open { part, sum, .. } = *open;
                (open.part, open.sum) = (Extent::NONE, Sum::NONE);
                if let Some(reason) = self.reason(&part, why::WIDE) {
                    self.push(object(&sum, &part, 0, reason, strip));
                }
            }
        }
    }

    /// Emits what has ended and waits for nothing.
    #[inline(always)]
    fn emit_whole<S: Simd>(
        &mut self,
        simd: S,
        strip: &Strip<'_>,
        components: &mut Components,
        min_points: u32,
    ) {
        for index in 0..self.open.len() {
            let open = &mut self.open[index];
            // A small one that nothing takes is an object by itself, if it has enough points. One
            // that was given away is emitted as part of the other.
            let is_known = if components.is_small(open.root) {
                open.is_settled && open.nearest.root == NONE
            } else {
                open.has_ended && !open.waits
            };
            if !is_known {
                continue;
            }
            open.is_settled = true;
            let open = *open;
            let (sum, whole) = self.with_gifts(simd, &open, components);
            // The first and last column of a wide object are certain only at the end of the turn:
            // the whole is emitted with the sweep.
            if !open.is_parted
                && sum.points >= min_points.max(1)
                && let Some(reason) = self.reason(&whole, why::COMPLETE)
            {
                let columns = whole.columns();
                self.push(object(&sum, &whole, columns, reason, strip));
            }
        }
    }

    /// Emits an object.
    pub(super) fn push(&mut self, mut object: Object) {
        object.ordinal = self.emitted.len() as u32;
        self.emitted.push(object);
    }

    /// Learns which components are one by now.
    #[inline(always)]
    fn unite<S: Simd>(&mut self, simd: S, components: &mut Components) {
        for index in 0..self.open.len() {
            let before = self.open[index].root;
            let root = components.root(before);
            if root == before {
                continue;
            }
            self.slots[before as usize] = NONE;
            let slot = self.slots[root as usize];
            if slot == NONE {
                self.slots[root as usize] = index as u32;
                self.open[index].root = root;
                continue;
            }
            let open = self.open[index];
            let into = &mut self.open[slot as usize];
            into.whole.add(&open.whole);
            into.part.add(&open.part);
            into.sum.add(simd, &open.sum);
            into.is_parted |= open.is_parted;
            self.open[index].root = NONE;
        }
        self.forget_settled();
    }

    /// Adds the runs of a strip to their components.
    #[inline(always)]
    fn add_runs<S: Simd>(&mut self, simd: S, strip: &Strip<'_>, components: &mut Components) {
        let runs = &strip.runs.all[strip.runs.from..];
        for (run, sum) in runs.iter().zip(&strip.runs.sums) {
            let columns = run.columns() & strip.counted;
            if columns == 0 {
                continue;
            }
            let row = usize::from(run.row);
            let beam = &strip.sweep.beams[row];
            let first = strip.position + columns.trailing_zeros() as usize;
            let last = strip.position + STRIP - 1 - columns.leading_zeros() as usize;
            let shot = |position: usize| {
                let firing = position.saturating_add_signed(beam.shift as isize);
                Shot::new(firing, beam.time_offset_ns, row)
            };
            let mut extent = Extent {
                first,
                last,
                first_shot: shot(first),
                last_shot: shot(last).with_row_flipped(),
                first_behind: u32::MAX,
            };
            if let Some(cut) = self.cut
                && last >= cut.at
                && let Some(column) = strip.order.column(first.max(cut.at))
            {
                extent.first_behind = (column * strip.sweep.rows() + row) as u32;
            }
            let root = components.root(run.piece);
            if self.slots[root as usize] == NONE {
                self.slots[root as usize] = self.open.len() as u32;
                self.open.push(Open {
                    root,
                    whole: Extent::NONE,
                    part: Extent::NONE,
                    sum: Sum::NONE,
                    is_parted: false,
                    has_ended: false,
                    is_settled: false,
                    nearest: Nearest::NONE,
                    waits: false,
                });
            }
            let open = &mut self.open[self.slots[root as usize] as usize];
            open.whole.add(&extent);
            open.part.add(&extent);
            open.sum.add(simd, sum);
        }
    }

    /// Finds which small components have ended and become part of which others, and which others
    /// wait for small ones.
    fn settle(&mut self, components: &mut Components) {
        // Anew each time: with this strip, components may have grown, or have become one.
        for open in &mut self.open {
            open.nearest = Nearest::NONE;
            open.waits = !open.has_ended;
        }
        self.take_notes(components);
        self.find_nearest(components);
        // In this order: small ones that are certain are given away first, and then the others wait
        // only for those that are left.
        self.wait_for_nearer(components);
        self.settle_small(components);
        self.wait_for_small(components);
    }

    /// Takes the notes that are new, and drops those of components that are not small any more.
    fn take_notes(&mut self, components: &mut Components) {
        let (nears, thinned) = components.nears();
        // Thinned notes stand in another order: all are taken once more. Some are there twice then,
        // which changes nothing.
        if self.taken.1 != thinned {
            self.taken = (0, thinned);
        }
        self.notes.extend_from_slice(&nears[self.taken.0..]);
        self.taken.0 = nears.len();
        let slots = &self.slots;
        self.notes.retain_mut(|note| {
            note.small = components.root(note.small);
            note.large = components.root(note.large);
            slots[note.small as usize] != NONE && components.is_small(note.small)
        });
    }

    fn find_nearest(&mut self, components: &Components) {
        for note in &self.notes {
            if components.is_small(note.large) {
                continue;
            }
            let nearest = &mut self.open[self.slots[note.small as usize] as usize].nearest;
            let found = Nearest {
                apart2: note.apart2,
                first: components.sum(note.large).first,
                root: note.large,
            };
            if found < *nearest {
                *nearest = found;
            }
        }
    }

    /// Has small ones wait while what is nearest to them may change.
    fn wait_for_nearer(&mut self, components: &Components) {
        for note in &self.notes {
            let slot = self.slots[note.small as usize] as usize;
            let nearest = self.open[slot].nearest;
            let has_ended = self.has_ended(note.large);
            let may_grow = !has_ended && components.is_small(note.large);
            // Of two that are as near, the one with the lower first pixel takes it. Until both have
            // ended, either may be joined to something with a lower one.
            let is_tied = note.apart2 == nearest.apart2
                && note.large != nearest.root
                && !(has_ended && self.has_ended(nearest.root));
            self.open[slot].waits |= (may_grow && note.apart2 <= nearest.apart2) || is_tied;
        }
    }

    /// Whether the component of a root has ended.
    fn has_ended(&self, root: u32) -> bool {
        let slot = self.slots[root as usize];
        slot == NONE || self.open[slot as usize].has_ended
    }

    /// Gives the small ones that wait for nothing to what is nearest to them.
    fn settle_small(&mut self, components: &Components) {
        for open in &mut self.open {
            if open.waits || !components.is_small(open.root) {
                continue;
            }
            open.is_settled = true;
            if open.nearest.root != NONE {
                self.gifts.push(Gift {
                    small: open.root,
                    large: open.nearest.root,
                    whole: open.whole,
                });
            }
        }
    }

    /// Has the others wait for small ones near them.
    fn wait_for_small(&mut self, components: &Components) {
        for note in &self.notes {
            let small = self.slots[note.small as usize] as usize;
            let large = self.slots[note.large as usize];
            if large != NONE && !self.open[small].is_settled && !components.is_small(note.large) {
                self.open[large as usize].waits = true;
            }
        }
    }

    /// What a component measures with the small ones that became part of it, added in the order of
    /// the table.
    #[inline(always)]
    fn with_gifts<S: Simd>(
        &mut self,
        simd: S,
        open: &Open,
        components: &mut Components,
    ) -> (Sum, Extent) {
        let (mut sum, mut whole) = (components.sum(open.root), open.whole);
        // As `Components::finish` adds them: in another order the last bits of the sums differ.
        self.gifts.sort_unstable_by_key(|gift| gift.small);
        self.gifts.retain(|gift| {
            let is_here = components.root(gift.large) == open.root;
            if is_here {
                sum.add(simd, &components.sum(gift.small));
                whole.add(&gift.whole);
            }
            !is_here
        });
        (sum, whole)
    }

    /// Drops what is settled, and what is part of another.
    fn forget_settled(&mut self) {
        let slots = &mut self.slots;
        let mut kept = 0;
        for index in 0..self.open.len() {
            let Open {
                root, is_settled, ..
            } = self.open[index];
            if root == NONE {
                continue;
            }
            if is_settled {
                slots[root as usize] = NONE;
                continue;
            }
            if kept < index {
                slots[root as usize] = kept as u32;
                self.open[kept] = self.open[index];
            }
            kept += 1;
        }
        self.open.truncate(kept);
    }

    /// Emits the segments of a complete sweep that were not emitted, and which label each object has.
    pub(super) fn end(&mut self, sweep: &SweepRef<'_>, has_height: bool) {
        if self.sequence != Some(sweep.header.sequence) || self.labels.is_some() {
            self.begin(sweep.header, false);
        }
        self.is_followed = false;
        let mut labels = self.labels.take().unwrap_or_default();
        labels.clear();
        // Without a height nothing is ground, so that a segment may be the floor: none is emitted.
        let mut is_emitted = vec![!has_height; sweep.segments.len()];
        // An image that did not become a turn is widened at its beginning, so that its pixels have
        // other numbers than when objects were emitted.
        let moved = i64::from(self.margin) - i64::from(sweep.header.margin_columns);
        for object in &self.emitted {
            let pixel = i64::from(object.first_pixel) + moved * sweep.rows() as i64;
            let label = usize::try_from(pixel)
                .ok()
                .and_then(|pixel| sweep.label.get(pixel))
                .copied()
                .unwrap_or(LABEL_NONE);
            let index = label.wrapping_sub(LABEL_FIRST_SEGMENT) as usize;
            let is_it = sweep.segments.get(index).is_some_and(|segment| {
                !object.is_segment() || is_same(&object.segment, segment, sweep, moved)
            });
            labels.push(if is_it { label } else { LABEL_NONE });
            if is_it && object.is_segment() {
                is_emitted[index] = true;
            }
        }
        self.emit_rest(sweep, &is_emitted, &mut labels);
        self.labels = Some(labels);
    }

    /// Emits what was not emitted, by the pixels of the label image.
    fn emit_rest(&mut self, sweep: &SweepRef<'_>, is_emitted: &[bool], labels: &mut Vec<u32>) {
        // One pass over the image, not one for each segment: the first pixel, the first shot and the
        // last one of each.
        let mut rest = vec![None; is_emitted.len()];
        for (pixel, &label) in sweep.label.iter().enumerate() {
            let index = label.wrapping_sub(LABEL_FIRST_SEGMENT) as usize;
            if is_emitted.get(index) != Some(&false) {
                continue;
            }
            let row = pixel % sweep.rows();
            let firing = sweep.fired_in(row, pixel / sweep.rows());
            let after_ns = sweep.beams[row].time_offset_ns;
            let time_ns = sweep.columns[firing].time_ns.saturating_add(after_ns);
            let shot = (time_ns, row, firing);
            let (_, first, last) = rest[index].get_or_insert((pixel, shot, shot));
            *first = shot.min(*first);
            if (time_ns, Reverse(row)) > (last.0, Reverse(last.1)) {
                *last = shot;
            }
        }
        for (segment, found) in sweep.segments.iter().zip(rest) {
            let Some((pixel, first, last)) = found else {
                continue;
            };
            labels.push(segment.label);
            let azimuth_rad = |(_, row, firing): (u32, usize, usize)| {
                pixel_azimuth_rad(&sweep.columns[firing], &sweep.beams[row]) as f32
            };
            self.push(Object {
                segment: *segment,
                first_pixel: pixel as u32,
                why: why::SWEEP,
                azimuth_first_rad: azimuth_rad(first),
                azimuth_last_rad: azimuth_rad(last),
                first_ns: nanoseconds(first.0),
                last_ns: nanoseconds(last.0),
                ..Object::new_zeroed()
            });
        }
    }
}

/// A strip that was joined.
#[derive(Clone, Copy)]
pub(super) struct Strip<'a> {
    pub sweep: &'a SweepRef<'a>,
    pub runs: &'a Runs,
    pub order: Order,
    pub position: usize,
    /// Its columns that count.
    pub counted: u64,
    pub wide: Wide,
}

/// An object of the open sweep, or a part of one; by `columns` it may be wide, which a part is not.
fn object(sum: &Sum, extent: &Extent, columns: usize, reason: u32, strip: &Strip<'_>) -> Object {
    let Strip { sweep, order, .. } = *strip;
    let mut segment = sum.segment(LABEL_NONE);
    let column = |position: usize| order.column(position).unwrap_or(0);
    segment.column_first = column(extent.first) as u32;
    segment.column_last = column(extent.last) as u32;
    segment.flags = strip.wide.flags(&segment, columns);
    let shot = |shot: Shot| {
        let beam = &sweep.beams[shot.row()];
        // The firing has come, with one exception: around the cut, pixels of the turn before have
        // the shifts of this turn, and may then seem to be fired later than the newest column.
        let firing = sweep.columns.get(column(shot.firing()));
        firing.or(sweep.columns.last()).map_or((0.0, 0), |firing| {
            let time_ns = firing.time_ns.saturating_add(beam.time_offset_ns);
            (pixel_azimuth_rad(firing, beam) as f32, nanoseconds(time_ns))
        })
    };
    let (azimuth_first_rad, first_ns) = shot(extent.first_shot);
    let (azimuth_last_rad, last_ns) = shot(extent.last_shot.with_row_flipped());
    let first_pixel = match reason {
        why::SEAM => extent.first_behind,
        _ => sum.first,
    };
    Object {
        segment,
        first_pixel,
        why: reason,
        azimuth_first_rad,
        azimuth_last_rad,
        first_ns,
        last_ns,
        ..Object::new_zeroed()
    }
}

/// Nanoseconds after the first shot, as objects have them.
fn nanoseconds(after: u32) -> i32 {
    i32::try_from(after).unwrap_or(i32::MAX)
}

/// Whether a segment that was emitted is the one in the table. A sweep that did not become a whole
/// turn is segmented again from its first column on: there the same points may be added in another
/// order.
fn is_same(emitted: &Segment, found: &Segment, sweep: &SweepRef<'_>, moved: i64) -> bool {
    let mut emitted = *emitted;
    emitted.label = found.label;
    if sweep.header.has(flags::CIRCULAR) {
        return emitted == *found;
    }
    let rows = [emitted.row_first, emitted.row_last] == [found.row_first, found.row_last];
    let columns =
        [emitted.column_first, emitted.column_last].map(|column| i64::from(column) + moved);
    let expected = [found.column_first, found.column_last].map(i64::from);
    emitted.points == found.points && rows && columns == expected
}
