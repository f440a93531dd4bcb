//! Sweeps to encode.

use sweepd_core::buffers::{Buffers, HeapBuffer, HeapBuffers};
use sweepd_core::sensor::Beam;
use sweepd_sweep::ReturnMode;
use sweepd_sweep::layout::{ReturnKind, flags};
use sweepd_sweep::{Column, Shape, SweepMut, SweepRef};

/// A sweep and its bytes.
pub struct Scene(HeapBuffer);

impl Scene {
    /// A sweep without returns.
    pub fn new(rows: usize, columns: usize, dual: bool) -> Self {
        let shape = Shape {
            rows,
            columns_capacity: columns,
            dual,
            segments_capacity: 8,
        };
        let mut buffer = HeapBuffers::default().take(shape.total_bytes());
        let header = SweepMut::create(buffer.as_mut(), &shape).unwrap().header;
        header.columns = columns as u32;
        header.time_ns = 1_700_000_000_123_456_789;
        if dual {
            header.return_mode = u32::from(ReturnMode::Dual.byte());
        }
        Self(buffer)
    }

    pub fn sweep(&self) -> SweepRef<'_> {
        SweepRef::open(self.0.as_ref()).unwrap()
    }

    pub fn fill(&mut self, change: impl FnOnce(&mut SweepMut<'_>)) {
        change(&mut SweepMut::open(self.0.as_mut()).unwrap());
    }

    /// Any beams, azimuths, ranges, labels, segments and flags, as sensors have them.
    pub fn random(seed: u64) -> Self {
        let mut random = fastrand::Rng::with_seed(seed);
        let (rows, columns, dual) = (random.usize(1..9), random.usize(1..40), random.bool());
        let mut scene = Self::new(rows, columns, dual);
        scene.fill(|sweep| scatter(sweep, &mut random));
        scene
    }
}

fn scatter(sweep: &mut SweepMut<'_>, random: &mut fastrand::Rng) {
    sweep.header.flags = [0, flags::CIRCULAR, flags::REVERSED][random.usize(0..3)];
    for (index, column) in sweep.columns.iter_mut().enumerate() {
        // Beams fire within a period; some firings overlap the next one, or are out of order.
        let time_ns = index as u32 * 55_296 + random.u32(0..3) * 40_000;
        let (azimuth_rad, rate) = (random.f32() * 6.0, 126.0 * random.f32() - 63.0);
        *column = match random.u8(0..8) {
            0 => Column::missing(azimuth_rad, rate, time_ns),
            1 => Column::unfired(azimuth_rad, rate, time_ns),
            _ => Column::measured(index as u64, 0, azimuth_rad, rate, time_ns),
        };
    }
    for (row, beam) in sweep.beams.iter_mut().enumerate() {
        *beam = Beam::ideal(row, f64::from(random.f32()) - 0.5).row(random.u32(0..55_296));
        beam.shift = random.i32(-3..4);
        beam.rotation_rad = random.f32() - 0.5;
        beam.vertical_offset_m = random.f32() * 0.2;
        beam.horizontal_offset_m = random.f32() * 0.1;
        if random.bool() {
            beam.distance_offset_m = 1.2;
            beam.distance_offset_x_m = 1.2 + random.f32() * 0.1;
            beam.distance_offset_y_m = 1.2 - random.f32() * 0.1;
        }
    }
    for ranges in [&mut *sweep.range, &mut *sweep.range2] {
        ranges.fill_with(|| f32::from(random.u8(0..3).min(1)) * (2.0 + random.f32() * 120.0));
    }
    let most = if random.bool() { 9 } else { 100_000 };
    for labels in [&mut *sweep.label, &mut *sweep.label2] {
        labels.fill_with(|| random.u32(0..3) * random.u32(0..most));
    }
    for reflectivities in [&mut *sweep.reflectivity, &mut *sweep.reflectivity2] {
        reflectivities.fill_with(|| random.u8(..));
    }
    clear_beyond_ends(sweep);
    let kinds = [ReturnKind::Strongest, ReturnKind::Last];
    sweep.kind.fill_with(|| kinds[random.usize(0..2)] as u8);
    sweep.header.segments = random.u32(0..=8);
    for (segment, label) in sweep.segments.iter_mut().zip(2..) {
        segment.label = label;
        segment.min_m = [(); 3].map(|()| random.f32() * 100.0 - 50.0);
        segment.max_m = segment.min_m.map(|least| least + random.f32() * 4.0);
    }
}

/// An image that is not circular has no return where its rows go beyond its ends.
fn clear_beyond_ends(sweep: &mut SweepMut<'_>) {
    let (rows, columns) = (sweep.beams.len(), sweep.columns.len() as i32);
    if sweep.header.has(flags::CIRCULAR) {
        return;
    }
    for index in 0..sweep.range.len() {
        let firing = (index / rows) as i32 + sweep.beams[index % rows].shift;
        if !(0..columns).contains(&firing) {
            sweep.range[index] = 0.0;
            if let Some(range_m) = sweep.range2.get_mut(index) {
                *range_m = 0.0;
            }
        }
    }
}
