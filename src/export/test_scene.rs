//! Sweeps for the tests of the writers: rays cast into boxes on a plane.

use std::f64::consts::TAU;
use std::ops::Range;

use zerocopy::FromZeros;

use sweepd_core::buffers::{Buffers, HeapBuffer, HeapBuffers};
use sweepd_core::sensor::Beam;
use sweepd_core::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, ReturnKind};
use sweepd_core::sweep::{Column, Segment, Shape, SweepMut, SweepRef};
use sweepd_core::wire::data::ReturnMode;

/// A box: least and greatest x, y, z in the sensor's axes.
type Box3 = [[f64; 3]; 2];

/// Height of the sensor above the ground.
const HEIGHT_M: f64 = 1.5;

/// A sweep and its bytes.
pub struct Scene {
    buffer: HeapBuffer,
}

impl Scene {
    /// A sweep without returns: columns evenly around the circle, beams without delay, room for 256
    /// segments.
    pub fn new(elevations_rad: &[f64], columns: usize, dual: bool) -> Self {
        let rows = elevations_rad.len();
        let shape = Shape {
            rows,
            columns_capacity: columns,
            dual,
            segments_capacity: 256,
        };
        let mut scene = Self {
            buffer: HeapBuffers::default().take(shape.total_bytes()),
        };
        let sweep = SweepMut::create(scene.buffer.as_mut(), &shape).unwrap();
        sweep.header.columns = columns as u32;
        sweep.header.time_ns = 1_700_000_000_000_000_000;
        sweep.header.rpm = 600.0;
        sweep.header.set_sensor("192.168.1.201:2368");
        if dual {
            sweep.header.return_mode = u32::from(ReturnMode::Dual.byte());
        }
        for (index, column) in sweep.columns.iter_mut().enumerate() {
            let azimuth = index as f64 / columns as f64 * TAU;
            *column = Column::measured(
                index as u64 / 24,
                (index % 12) as u8,
                azimuth as f32,
                0.0,
                index as u32 * 55_296,
            );
        }
        for (row, &elevation) in elevations_rad.iter().enumerate() {
            sweep.beams[row] = Beam::ideal(rows - 1 - row, elevation).row(0);
        }
        scene
    }

    /// The sweep, to read.
    pub fn sweep(&self) -> SweepRef<'_> {
        SweepRef::open(self.buffer.as_ref()).unwrap()
    }

    /// Changes the sweep.
    pub fn fill(&mut self, change: impl FnOnce(&mut SweepMut<'_>)) {
        change(&mut SweepMut::open(self.buffer.as_mut()).unwrap());
    }

    /// Mounts the sensor 0.5 m to the right, 1 m ahead, 1.5 m up, turned to the left, nose 30 degrees
    /// up.
    pub fn mount(&mut self) {
        self.fill(|sweep| {
            sweep.header.position_m = [0.5, 1.0, 1.5];
            sweep.header.yaw_rad = 90_f32.to_radians();
            sweep.header.pitch_rad = 30_f32.to_radians();
        });
    }

    /// Loses the packets of some columns.
    pub fn lose(&mut self, columns: Range<usize>) {
        self.fill(|sweep| {
            let rows = sweep.beams.len();
            for column in columns {
                let Column {
                    azimuth_rad,
                    time_ns,
                    ..
                } = sweep.columns[column];
                sweep.columns[column] = Column::missing(azimuth_rad, 0.0, time_ns);
                sweep.range[column * rows..(column + 1) * rows].fill(0.0);
            }
        });
    }

    /// 16 rows by 400 columns: ground, a box at azimuth 90 (label 2), a wall at 180 (label 3).
    pub fn small() -> Self {
        let mut scene = Self::new(&fan(16, 15.0, -15.0), 400, false);
        scene.cast(&[
            [[6.0, -1.0, -1.5], [8.0, 1.0, 0.0]],
            [[-15.0, -10.5, -1.5], [15.0, -10.0, 1.0]],
        ]);
        scene
    }

    /// A street with houses, cars, poles, people and lost packets, for the eye.
    pub fn street(rows: usize, columns: usize, dual: bool) -> Self {
        let (up, down) = if rows == 16 {
            (15.0, -15.0)
        } else {
            (8.0, -25.0)
        };
        let mut scene = Self::new(&fan(rows, up, down), columns, dual);
        let mut random = fastrand::Rng::with_seed(7);
        let mut boxes: Vec<Box3> = vec![
            [[-30.0, 12.0, -1.5], [-12.0, 40.0, 8.0]],
            [[14.0, -60.0, -1.5], [30.0, 30.0, 7.0]],
        ];
        boxes.extend([
            [[-40.0, -30.0, -1.5], [-10.0, -8.0, 4.0]],
            [[-5.0, 55.0, -1.5], [9.0, 60.0, 6.0]],
        ]);
        for _ in 0..14 {
            let (x, y) = ([-6.0, 8.0][random.usize(0..2)], random.f64() * 80.0 - 40.0);
            boxes.push([[x, y, -1.5], [x + 1.8, y + 4.3, random.f64() * 0.7 - 0.2]]);
        }
        for _ in 0..22 {
            let (x, y) = (random.f64() * 24.0 - 11.0, random.f64() * 60.0 - 30.0);
            let thick = 0.15 + random.f64() * 0.4;
            boxes.push([
                [x, y, -1.5],
                [x + thick, y + thick, if thick < 0.3 { 4.0 } else { 0.3 }],
            ]);
        }
        boxes.retain(|[min, max]| max[0] < -1.0 || min[0] > 1.0 || max[1] < -1.5 || min[1] > 1.5);
        scene.cast(&boxes);
        scene.fill(|sweep| {
            for index in 0..sweep.range.len() {
                sweep.range[index] *= 1.0 + (random.f32() - 0.5) * 0.002;
                match random.u32(0..100) {
                    0..2 => (sweep.range[index], sweep.label[index]) = (0.0, 0),
                    2..4 => sweep.label[index] = 0,
                    _ => {}
                }
                if dual && random.u32(0..12) == 0 && sweep.label[index] > 1 {
                    sweep.range2[index] = sweep.range[index] + 2.0;
                    sweep.kind[index] = ReturnKind::Last as u8;
                }
            }
        });
        scene.lose(columns / 5..columns / 5 + 48);
        scene
    }

    /// A sweep of this shape with any azimuths, ranges (also infinite ones), labels, segments and
    /// flags.
    pub fn random(rows: usize, columns: usize, dual: bool, seed: u64) -> Self {
        let mut random = fastrand::Rng::with_seed(seed);
        let elevations: Vec<f64> = (0..rows).map(|_| random.f64() * 3.0 - 1.5).collect();
        let mut scene = Self::new(&elevations, columns, dual);
        scene.fill(|sweep| scatter(sweep, &mut random));
        scene
    }

    /// Fills ranges, labels and the table of segments.
    fn cast(&mut self, boxes: &[Box3]) {
        self.fill(|sweep| {
            let rows = sweep.beams.len();
            for index in 0..sweep.range.len() {
                let (azimuth, elevation) = (
                    sweep.columns[index / rows].azimuth_rad,
                    sweep.beams[index % rows].elevation_rad,
                );
                let (range, label) = hit(f64::from(azimuth), f64::from(elevation), boxes);
                (sweep.range[index], sweep.label[index]) = (range, label);
                sweep.reflectivity[index] = (index % 256) as u8;
            }
        });
        let mut segments: Vec<Segment> = Vec::new();
        for found in self
            .sweep()
            .returns()
            .filter(|found| found.label >= LABEL_FIRST_SEGMENT)
        {
            let at = segments
                .iter()
                .position(|segment| segment.label == found.label)
                .unwrap_or_else(|| {
                    let mut segment = Segment::new_zeroed();
                    (segment.label, segment.nearest_m) = (found.label, f32::MAX);
                    segment.row_first = u16::MAX;
                    (segment.min_m, segment.max_m) = ([f32::MAX; 3], [f32::MIN; 3]);
                    segments.push(segment);
                    segments.len() - 1
                });
            let segment = &mut segments[at];
            segment.points += 1;
            (segment.row_first, segment.row_last) = (
                segment.row_first.min(found.row as u16),
                segment.row_last.max(found.row as u16),
            );
            segment.nearest_m = segment.nearest_m.min(found.range_m);
            for (axis, length) in found
                .point_m
                .map(|length| length as f32)
                .into_iter()
                .enumerate()
            {
                segment.min_m[axis] = segment.min_m[axis].min(length);
                segment.max_m[axis] = segment.max_m[axis].max(length);
                segment.centroid_m[axis] = (segment.min_m[axis] + segment.max_m[axis]) / 2.0;
            }
        }
        // A label is its segment's place in the table; a box that no ray hits has none.
        self.fill(|sweep| {
            for label in sweep
                .label
                .iter_mut()
                .filter(|label| **label >= LABEL_FIRST_SEGMENT)
            {
                let at = segments.iter().position(|segment| segment.label == *label);
                *label = at.map_or(*label, |at| LABEL_FIRST_SEGMENT + at as u32);
            }
            segments
                .iter_mut()
                .zip(LABEL_FIRST_SEGMENT..)
                .for_each(|(segment, label)| segment.label = label);
            sweep.header.segments = segments.len() as u32;
            sweep.segments[..segments.len()].copy_from_slice(&segments);
        });
    }
}

/// Elevations from one angle to another, degrees in, radians out.
fn fan(rows: usize, from_deg: f64, to_deg: f64) -> Vec<f64> {
    (0..rows)
        .map(|row| (from_deg + (to_deg - from_deg) * row as f64 / (rows - 1) as f64).to_radians())
        .collect()
}

/// Range and label of what a ray hits first within 100 m.
fn hit(azimuth: f64, elevation: f64, boxes: &[Box3]) -> (f32, u32) {
    let ray = [
        elevation.cos() * azimuth.sin(),
        elevation.cos() * azimuth.cos(),
        elevation.sin(),
    ];
    let ground = (-HEIGHT_M / ray[2], LABEL_GROUND);
    let solids = boxes
        .iter()
        .zip(LABEL_FIRST_SEGMENT..)
        .filter_map(|(solid, label)| Some((enters(ray, solid)?, label)));
    let hits = solids
        .chain([ground])
        .filter(|&(range, _)| range > 0.0 && range < 100.0);
    let nearest = hits.min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.map_or((0.0, 0), |(range, label)| (range as f32, label))
}

fn enters(ray: [f64; 3], [min, max]: &Box3) -> Option<f64> {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let (a, b) = (min[axis] / ray[axis], max[axis] / ray[axis]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    (near < far).then_some(near)
}

/// Two beams, two columns, three returns: the tests give their files.
pub fn two_beams() -> Scene {
    let mut scene = Scene::new(&[30_f64.to_radians(), 0.0], 2, true);
    scene.fill(|sweep| {
        sweep.beams[0].time_offset_ns = 500;
        sweep.columns[0] = Column::measured(7, 4, 90_f32.to_radians(), 0.0, 0);
        sweep.columns[1] = Column::measured(7, 6, 359.999_99_f32.to_radians(), 0.0, 55_296);
        (sweep.range[0], sweep.reflectivity[0], sweep.label[0]) = (2.0, 200, 2);
        (sweep.range2[0], sweep.reflectivity2[0]) = (1.5, 100);
        (sweep.range[3], sweep.reflectivity[3], sweep.label[3]) = (10.0, 3, 1);
        sweep.kind[..4].fill(ReturnKind::Last as u8);
    });
    scene
}

fn scatter(sweep: &mut SweepMut<'_>, random: &mut fastrand::Rng) {
    let range = |random: &mut fastrand::Rng| match random.u32(0..4) {
        0 => 0.0,
        1 => Some(f32::from_bits(random.u32(..)))
            .filter(|range| !range.is_nan())
            .unwrap_or(0.0),
        _ => random.f32() * 130.0,
    };
    sweep.header.flags = random.u32(0..128);
    sweep.header.time_ns = random.i64(i64::MIN / 2..i64::MAX / 2);
    sweep.range.fill_with(|| range(random));
    sweep.range2.fill_with(|| range(random));
    sweep.label.fill_with(|| {
        if random.bool() {
            random.u32(0..9)
        } else {
            random.u32(..)
        }
    });
    sweep.label2.fill_with(|| random.u32(0..9));
    sweep.kind.fill_with(|| random.u8(..));
    for column in sweep.columns.iter_mut() {
        let azimuth_rad = random.f32() * 7.0;
        *column = match random.bool() {
            true => Column::missing(azimuth_rad, 0.0, 0),
            false => Column::measured(3, 2, azimuth_rad, 60.0, 9),
        };
    }
    sweep.header.segments = random.u32(0..=256);
    for segment in sweep.segments.iter_mut() {
        let lengths = [(); 3].map(|()| f32::from_bits(random.u32(..)));
        (segment.label, segment.nearest_m) = (random.u32(2..), f32::from_bits(random.u32(..)));
        (segment.min_m, segment.max_m, segment.centroid_m) =
            (lengths, lengths.map(|length| -length), lengths);
    }
}
