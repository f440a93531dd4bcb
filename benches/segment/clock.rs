//! Time, taken stage by stage, and the middle of many.

use std::hint::black_box;
use std::time::Instant;

use sweepd::segment::Segmenter;
use sweepd::sweep::SweepMut;

/// Milliseconds of one sweep, or of the middle of many.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stages {
    /// Points, their ground, and the height of the sensor.
    pub ground: f64,
    /// Edges, runs and joins.
    pub join: f64,
    /// Components, labels and segments table.
    pub label: f64,
    /// Of the last strip, what is not in `label`.
    pub last: f64,
    /// How long the thread wanted to run meanwhile, and had no core.
    pub waited: f64,
}

impl Stages {
    pub fn total(&self) -> f64 {
        self.ground + self.join + self.label
    }

    /// From the last column of a sweep to its labels, when all strips before are done.
    pub fn tail(&self) -> f64 {
        self.last + self.label
    }
}

/// One whole segmentation. Kept as functions of their own for tools that count by function.
#[inline(never)]
pub fn segment_sweep(segmenter: &mut Segmenter, sweep: &mut SweepMut<'_>) {
    begin(segmenter, sweep);
    while find_ground(segmenter, sweep) {
        join(segmenter);
    }
    label(segmenter, sweep);
}

#[inline(never)]
fn begin(segmenter: &mut Segmenter, sweep: &mut SweepMut<'_>) {
    segmenter.begin(black_box(sweep));
}

#[inline(never)]
fn find_ground(segmenter: &mut Segmenter, sweep: &SweepMut<'_>) -> bool {
    segmenter.find_ground(black_box(sweep))
}

#[inline(never)]
fn join(segmenter: &mut Segmenter) {
    segmenter.join();
}

#[inline(never)]
fn label(segmenter: &mut Segmenter, sweep: &mut SweepMut<'_>) {
    segmenter.label(black_box(sweep));
}

/// The same with the time of its stages.
pub fn staged(segmenter: &mut Segmenter, sweep: &mut SweepMut<'_>) -> Stages {
    let mut stages = Stages::default();
    let waited = waited_ms();
    let mut lap = Lap::begin();
    begin(segmenter, sweep);
    stages.ground += lap.ms();
    while find_ground(segmenter, sweep) {
        let ground = lap.ms();
        join(segmenter);
        let join = lap.ms();
        stages.ground += ground;
        stages.join += join;
        stages.last = ground + join;
    }
    lap.ms();
    label(segmenter, sweep);
    stages.label = lap.ms();
    stages.waited = waited_ms() - waited;
    stages
}

/// How long this thread has waited for a core so far; 0 where the system does not say.
fn waited_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    stat.split(' ')
        .nth(1)
        .and_then(|ns| ns.parse().ok())
        .map_or(0.0, |ns: f64| ns * 1e-6)
}

/// Milliseconds of a call.
pub fn timed<T>(call: impl FnOnce() -> T) -> f64 {
    let mut lap = Lap::begin();
    black_box(call());
    lap.ms()
}

struct Lap(Instant);

impl Lap {
    fn begin() -> Self {
        Self(Instant::now())
    }

    /// Since the last call.
    fn ms(&mut self) -> f64 {
        let now = Instant::now();
        let passed = now - std::mem::replace(&mut self.0, now);
        passed.as_secs_f64() * 1e3
    }
}

/// The middle one.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The least.
pub fn least(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(f64::INFINITY, f64::min)
}

/// Many of one segmenter.
#[derive(Default)]
pub struct Series(Vec<Stages>);

/// Waiting so long, in ms, does not show.
const CALM_MS: f64 = 0.01;
/// So many calm ones speak for all.
const ENOUGH: usize = 5;

impl Series {
    pub fn push(&mut self, stages: Stages) {
        self.0.push(stages);
    }

    fn calm(&self) -> impl Iterator<Item = &Stages> {
        self.0.iter().filter(|stages| stages.waited < CALM_MS)
    }

    /// Those in which nobody else had the core, and all there are.
    pub fn counts(&self) -> [usize; 2] {
        [self.calm().count(), self.0.len()]
    }

    /// The middle one of those in which nobody else had the core; of all, where these are few.
    pub fn of(&self, part: impl Fn(&Stages) -> f64) -> f64 {
        match self.counts()[0] < ENOUGH {
            true => median(self.0.iter().map(part)),
            false => median(self.calm().map(part)),
        }
    }

    pub fn least(&self) -> f64 {
        least(self.0.iter().map(Stages::total))
    }
}
