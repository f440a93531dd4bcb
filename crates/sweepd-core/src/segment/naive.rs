//! The specification twin of the default method: the same labels, each written down as directly as
//! it can be said.
//!
//! Queues and `Vec`s of pixels; no words, no runs, no vectors. Nothing in the program calls it: the
//! tests and benches hold the fast path against it, on real and on random images.

use std::collections::{HashMap, VecDeque};

use super::area::Areas;
use super::components::Small;
use super::config::Config;
use super::ground::{
    AGREE_M, AWAY_STEPS, FLAT_SHIFT, HEIGHT_STEPS, MAX_FOOT, MAX_KERB, MAX_LEAN, MAX_RISE,
    MAX_STEP, MAX_TOP, MIN_RISE, NEAR, PLATEAU, STEEP,
};
use super::joining;
use super::near::{Gap, Limits, WindowRow};
use super::order::{MOST_COLUMNS, Order};
use super::points::{self, Placed};
use super::ranges::to_step;
use crate::sweep::SweepRef;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, flags};

/// Labels of a sweep, by pixel, at this height of the sensor.
pub fn segment(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    let pixels = points::placed(sweep, config);
    let circular = sweep.header.has(flags::CIRCULAR);
    let columns = sweep.columns.len();
    let order = Order::new(sweep, Some(columns));
    let pitch_rad = joining::pitch_rad(sweep.columns, order);
    let mut limits = Limits::default();
    limits.set(sweep.beams, pitch_rad, &config.joining);
    let mut areas = Areas::default();
    areas.set(sweep.beams, pitch_rad);
    let is_jump = |column: usize| {
        let before = match column.checked_sub(1) {
            None if circular => columns - 1,
            None => return false,
            Some(before) => before,
        };
        joining::is_jump(&sweep.columns[before], &sweep.columns[column], pitch_rad)
    };
    let image = Image {
        rows: sweep.rows(),
        columns,
        circular,
        pixels: &pixels,
        jumps: (0..columns).map(is_jump).collect(),
    };
    let climbed = match height_m {
        Some(height_m) => climb(&image, height_m),
        None => vec![false; pixels.len()],
    };
    let ground = vote(&image, &climbed);
    let on: Vec<bool> = pixels
        .iter()
        .zip(&ground)
        .map(|(pixel, ground)| pixel.is_some() && !ground)
        .collect();
    let near = Nearness {
        image: &image,
        on: &on,
        limits,
        areas,
    };
    let component = near.components();
    let component = near.small_to_large(component, Small::new(&config.joining));
    number(&component, &ground, &pixels, config.min_points.max(1))
}

/// The image: what may be labelled, and which pixels are how far apart.
struct Image<'a> {
    rows: usize,
    columns: usize,
    circular: bool,
    pixels: &'a [Option<Placed>],
    /// Columns that are no neighbours of those before.
    jumps: Vec<bool>,
}

impl Image<'_> {
    /// The pixel this many rows below and columns behind another.
    fn beside(&self, pixel: usize, down: i64, on: i64) -> Option<usize> {
        let row = (pixel % self.rows) as i64 + down;
        let column = (pixel / self.rows) as i64 + on;
        let column = if self.circular {
            column.rem_euclid(self.columns as i64)
        } else {
            column
        };
        let is_there =
            (0..self.rows as i64).contains(&row) && (0..self.columns as i64).contains(&column);
        is_there.then(|| column as usize * self.rows + row as usize)
    }
}

/// Of three neighbours on either side in the row whose range is alike, three that are ground make a
/// pixel ground; one at most of four or more unmakes it.
fn vote(image: &Image<'_>, climbed: &[bool]) -> Vec<bool> {
    let agree = to_step(AGREE_M).unsigned_abs();
    let ballot = |pixel: usize, here: &Placed| {
        let voters = [-3, -2, -1, 1, 2, 3]
            .into_iter()
            .filter_map(|on| image.beside(pixel, 0, on));
        let like = voters.filter(|&other| {
            let apart = |there: Placed| to_step(here.range_m).abs_diff(to_step(there.range_m));
            image.pixels[other].is_some_and(|there| apart(there) < agree)
        });
        let votes: Vec<bool> = like.map(|other| climbed[other]).collect();
        let ayes = votes.iter().filter(|aye| **aye).count();
        match climbed[pixel] {
            true => ayes >= 2 || votes.len() < 4,
            false => ayes >= 3,
        }
    };
    image
        .pixels
        .iter()
        .enumerate()
        .map(|(pixel, here)| here.is_some_and(|here| ballot(pixel, &here)))
        .collect()
}

/// What of an image is no ground, and which of its pixels are near each other.
struct Nearness<'a> {
    image: &'a Image<'a>,
    on: &'a [bool],
    limits: Limits,
    areas: Areas,
}

impl Nearness<'_> {
    /// The pixel this many rows below and columns behind another, if both are no ground and there
    /// is no jump between their columns.
    fn beside(&self, pixel: usize, down: i64, on: i64) -> Option<usize> {
        let other = self.image.beside(pixel, down, on)?;
        let between = if on > 0 { 1..=on } else { on + 1..=0 };
        let is_parted = between
            .filter_map(|on| self.image.beside(pixel, 0, on))
            .any(|pixel| self.image.jumps[pixel / self.image.rows]);
        (self.on[pixel] && self.on[other] && !is_parted).then_some(other)
    }

    /// The pixel there, if it is as near as this.
    fn near(&self, pixel: usize, row: WindowRow, on: i64, gap: Gap) -> Option<usize> {
        let other = self.beside(pixel, row.down as i64, on)?;
        let [here, there] = [pixel, other].map(|pixel| {
            self.limits
                .flat_of(pixel % self.image.rows, self.steps(pixel))
        });
        let columns = on.unsigned_abs() as usize;
        let is_near = self.limits.is_near(gap, [here, there], columns, row);
        is_near.then_some(other)
    }

    /// The same in its own row and so many places up.
    fn near_above(&self, pixel: usize, place: usize, on: i64) -> Option<usize> {
        let row = self.limits.up(pixel % self.image.rows, place);
        self.near(pixel, row, on, self.limits.gap)
    }

    /// The range of a pixel in steps.
    fn steps(&self, pixel: usize) -> i16 {
        to_step(self.range_m(pixel))
    }

    /// The range of a pixel; 0 where there is no return.
    fn range_m(&self, pixel: usize) -> f32 {
        self.image.pixels[pixel].map_or(0.0, |placed| placed.range_m)
    }

    /// Whether a pixel continues the run to the left of it.
    fn goes_on(&self, pixel: usize) -> bool {
        self.near_above(pixel, 0, -1).is_some()
    }

    /// Whether the pixel above (-1) or below (1) is joined to one, and has a run that goes on to
    /// the left of it (0) or to the right (1).
    fn goes_on_beside(&self, pixel: usize, down: i64, right: i64) -> bool {
        let beside = self.image.beside(pixel, down, 0).filter(|&beside| {
            let lower = pixel.max(beside);
            self.near_above(lower, 1, 0).is_some()
        });
        let next = beside.and_then(|beside| self.image.beside(beside, 0, right));
        next.is_some_and(|next| self.goes_on(next))
    }

    /// The window of a pixel where a run begins (to the left) or ends (to the right): its rows, and
    /// columns behind.
    fn window(&self, pixel: usize) -> Vec<(WindowRow, i64)> {
        let mut window = Vec::new();
        let most = MOST_COLUMNS as i64;
        let sides = [(0, -most..=0), (1, 0..=most)];
        for (right, columns) in sides {
            let next = self.image.beside(pixel, 0, right);
            let goes_on = next.is_some_and(|next| self.goes_on(next));
            let beside = [-1, 1].map(|down| self.goes_on_beside(pixel, down, right));
            if !goes_on && beside == [false; 2] {
                for row in self.limits.window(pixel % self.image.rows) {
                    window.extend(columns.clone().map(|on| (*row, on)));
                }
            }
        }
        window
    }

    /// What a pixel is joined to: its direct neighbours to the left and above, and what its window
    /// holds.
    fn joined(&self, pixel: usize) -> impl Iterator<Item = usize> {
        let left = self.near_above(pixel, 0, -1);
        let above =
            (1..=self.limits.above.len()).map(move |place| self.near_above(pixel, place, 0));
        let window = self.window(pixel).into_iter();
        let held = window.map(move |(row, on)| self.near(pixel, row, on, self.limits.gap));
        std::iter::once(left).chain(above).chain(held).flatten()
    }

    /// Breadth-first search over what is joined; the first pixel of each pixel's component.
    fn components(&self) -> Vec<Option<usize>> {
        let mut joined = vec![Vec::new(); self.on.len()];
        for pixel in (0..self.on.len()).filter(|&pixel| self.on[pixel]) {
            for other in self.joined(pixel) {
                joined[pixel].push(other);
                joined[other].push(pixel);
            }
        }
        let mut component = vec![None; self.on.len()];
        for start in (0..self.on.len()).filter(|&pixel| self.on[pixel]) {
            if component[start].is_some() {
                continue;
            }
            component[start] = Some(start);
            let mut queue = VecDeque::from([start]);
            while let Some(here) = queue.pop_front() {
                for &there in &joined[here] {
                    if component[there].is_none() {
                        component[there] = Some(start);
                        queue.push_back(there);
                    }
                }
            }
        }
        component
    }

    /// What each component shows to the sensor, by its first pixel.
    fn areas_of(&self, component: &[Option<usize>]) -> HashMap<usize, u64> {
        let mut areas: HashMap<usize, u64> = HashMap::new();
        for (pixel, first) in component.iter().enumerate() {
            if let Some(first) = first {
                let area = self.areas.of(pixel % self.image.rows, &[self.steps(pixel)]);
                let sum = areas.entry(*first).or_default();
                *sum = sum.saturating_add(area);
            }
        }
        areas
    }

    /// Gives each small component to the large one that is nearest to where its runs begin and end,
    /// if one is near enough.
    fn small_to_large(&self, component: Vec<Option<usize>>, small: Small) -> Vec<Option<usize>> {
        let points = points_of(&component);
        let areas = self.areas_of(&component);
        let is_small = |first: usize| small.is(points[&first], areas[&first]);
        let mut nearest: HashMap<usize, (f32, usize)> = HashMap::new();
        for (pixel, small) in component.iter().enumerate() {
            let Some(small) = small.filter(|&first| is_small(first)) else {
                continue;
            };
            for (row, on) in self.window(pixel) {
                let Some(other) = self.near(pixel, row, on, self.limits.reach) else {
                    continue;
                };
                let Some(large) = component[other].filter(|&first| !is_small(first)) else {
                    continue;
                };
                let columns = on.unsigned_abs() as usize;
                let rows = [pixel, other].map(|pixel| pixel % self.image.rows);
                let ranges_m = [pixel, other].map(|pixel| self.range_m(pixel));
                let apart2 = self.limits.apart2(rows, ranges_m, columns);
                let best = nearest.entry(small).or_insert((f32::INFINITY, usize::MAX));
                if (apart2, large) < *best {
                    *best = (apart2, large);
                }
            }
        }
        let found = |first: usize| nearest.get(&first).map_or(first, |best| best.1);
        component
            .into_iter()
            .map(|first| first.map(found))
            .collect()
    }
}

/// How many points each component has, by its first pixel.
fn points_of(component: &[Option<usize>]) -> HashMap<usize, u32> {
    let mut points = HashMap::new();
    for first in component.iter().flatten() {
        *points.entry(*first).or_default() += 1;
    }
    points
}

/// Numbers the components that are large enough by their first pixels in memory.
fn number(
    component: &[Option<usize>],
    ground: &[bool],
    pixels: &[Option<Placed>],
    min_points: u32,
) -> Vec<u32> {
    let points = points_of(component);
    let mut number: HashMap<usize, u32> = HashMap::new();
    let label = |pixel: usize| match component[pixel] {
        _ if pixels[pixel].is_none() => LABEL_NONE,
        _ if ground[pixel] => LABEL_GROUND,
        Some(first) if points[&first] >= min_points => {
            let next = LABEL_FIRST_SEGMENT + number.len() as u32;
            *number.entry(first).or_insert(next)
        }
        _ => LABEL_NONE,
    };
    (0..component.len()).map(label).collect()
}

/// Ground by the climb of each column: see [`ground`](super::ground). All is in whole steps.
fn climb(image: &Image<'_>, height_m: f32) -> Vec<bool> {
    let mut ground = vec![false; image.pixels.len()];
    for column in 0..image.columns {
        let spots = spots(image, column, height_m);
        let mut climber = Climber::default();
        for (spot, is_face) in spots.iter().zip(faces(&spots)) {
            climber.step(*spot, is_face);
        }
        climber.settle(Verdict::Unknown);
        for pixel in climber.ground {
            ground[pixel] = true;
        }
    }
    ground
}

/// A return of a column.
#[derive(Clone, Copy, Default)]
struct Spot {
    pixel: usize,
    /// Distance from the plumb line in steps.
    away: i16,
    /// Height over the ground at the sensor in steps.
    height: i16,
}

/// The returns of a column, from the lowest row up.
fn spots(image: &Image<'_>, column: usize, height_m: f32) -> Vec<Spot> {
    let pixels = (0..image.rows).rev().map(|row| column * image.rows + row);
    let spot = |pixel: usize| {
        let placed = image.pixels[pixel]?;
        let height = (placed.height_m + height_m) * HEIGHT_STEPS;
        Some(Spot {
            pixel,
            away: (placed.away_m * AWAY_STEPS) as i16,
            height: height.round_ties_even() as i16,
        })
    };
    pixels.filter_map(spot).collect()
}

/// Which returns of a column belong to faces: their foot, and what is steep over it, up to the last
/// return that is high over it.
fn faces(spots: &[Spot]) -> Vec<bool> {
    let mut is_face = vec![false; spots.len()];
    let mut foot = Spot::default();
    let mut first = 0;
    for (index, spot) in spots.iter().enumerate() {
        let rise = spot.height.saturating_sub(foot.height);
        let apart = (spot.away - foot.away).abs();
        let is_steep = rise.saturating_add(MAX_STEP) > apart.saturating_mul(STEEP);
        if !is_steep {
            foot = *spot;
            first = index;
        } else if rise > MAX_STEP {
            is_face[first..=index].fill(true);
        }
    }
    is_face
}

/// Where the climb of a column has come to.
#[derive(Default)]
struct Climber {
    foothold: Spot,
    /// The last return that waits, or that lies on an object.
    edge: Spot,
    /// The distance of the first such return.
    start_away: i16,
    edge_is: Edge,
    /// What waits.
    waiting: Vec<Waiting>,
    /// Pixels that are ground.
    ground: Vec<usize>,
}

/// What the return before is.
#[derive(Clone, Copy, Default, PartialEq)]
enum Edge {
    #[default]
    Nothing,
    Waiting,
    OnObject,
}

struct Waiting {
    pixel: usize,
    in_doubt: bool,
}

/// What a column shows behind what waits.
enum Verdict {
    Ground,
    Object,
    /// Neither: what is in doubt is ground, what is low is not.
    Unknown,
}

impl Climber {
    /// Takes the next return.
    fn step(&mut self, here: Spot, is_face: bool) {
        let rise = here.height.saturating_sub(self.foothold.height);
        let ahead = here.away - self.foothold.away;
        if self.goes_on_level(here, is_face, rise) {
            return;
        }
        let falls_little = rise.saturating_add(ahead.abs().max(MAX_RISE)) > 0;
        let stands_apart = ahead >= NEAR && self.foothold.away > 0;
        let max_rise = if stands_apart { MAX_RISE / 2 } else { MAX_RISE };
        let walkable = falls_little && !is_face && rise < ahead.min(max_rise).max(MIN_RISE);
        let flat = walkable && rise <= (ahead >> FLAT_SHIFT).max(MIN_RISE);
        let foot = falls_little && is_face && rise <= MAX_FOOT;
        let max_low = if is_face { MAX_KERB } else { MAX_RISE };
        let low = (1..=max_low).contains(&rise) && ahead > -MAX_LEAN;
        if flat || foot {
            self.settle(Verdict::Unknown);
            self.ground.push(here.pixel);
            // Noise lifts no foothold.
            if flat && rise <= ahead.max(0) {
                self.foothold = here;
            }
        } else if walkable || low {
            if self.edge_is != Edge::Waiting {
                self.start_away = here.away;
            }
            self.wait(here, walkable);
        } else {
            self.settle(Verdict::Unknown);
            self.start_away = here.away;
            self.edge = here;
            if is_face && rise > 0 {
                self.edge_is = Edge::OnObject;
            }
        }
    }

    /// Takes a return that is level with what waits, or with the object. Or it says no: then the
    /// return may have come down from there.
    fn goes_on_level(&mut self, here: Spot, is_face: bool, rise: i16) -> bool {
        let run = here.away - self.start_away;
        if self.edge_is == Edge::Nothing || self.edge_is == Edge::OnObject && run >= MAX_TOP {
            return false;
        }
        let apart = i32::from(here.height).abs_diff(self.edge.height.into());
        let apart = apart.min(i16::MAX as u32) as i16;
        if i32::from(rise).abs() < apart.into() {
            let is_short = self.edge.away - self.start_away < PLATEAU;
            self.settle(if is_short {
                Verdict::Object
            } else {
                Verdict::Unknown
            });
            return false;
        }
        if is_face || apart >= (here.away - self.edge.away).max(MIN_RISE) {
            return false;
        }
        if self.edge_is == Edge::OnObject {
            self.edge = here;
        } else if run < PLATEAU {
            self.wait(here, false);
        } else {
            self.settle(Verdict::Ground);
            self.ground.push(here.pixel);
            self.foothold = here;
        }
        true
    }

    /// This return waits for what comes behind it.
    fn wait(&mut self, here: Spot, in_doubt: bool) {
        let pixel = here.pixel;
        self.waiting.push(Waiting { pixel, in_doubt });
        self.edge = here;
        self.edge_is = Edge::Waiting;
    }

    /// Nothing waits any longer.
    fn settle(&mut self, verdict: Verdict) {
        for Waiting { pixel, in_doubt } in self.waiting.drain(..) {
            let is_ground = match verdict {
                Verdict::Ground => true,
                Verdict::Object => false,
                Verdict::Unknown => in_doubt,
            };
            if is_ground {
                self.ground.push(pixel);
            }
        }
        self.edge_is = Edge::Nothing;
    }
}
