//! The fast segmentation against its naive twin, and what must be true of any labelled sweep.

use std::collections::HashMap;
use std::f32::consts::{PI, TAU};
use sweepd_testkit::objects::{check, is_wide};

use proptest::prelude::*;
use sweepd::assemble::levels;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::segment::placed;
use sweepd::segment::{Config, ConfigError, Joining, Mask, Method, Mount, Segmenter, Stance};
use sweepd::sensor::Beam;
use sweepd::sensor::TwoPoint;
use sweepd::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE, flags, is_return};
use sweepd::sweep::{Column, Segment, Shape, SweepMut, SweepRef};
use sweepd_lab::cloud::{COLUMNS, CloudProjector, CloudSegmenter, points};
use sweepd_lab::twin;
use zerocopy::IntoBytes;

/// A random scene and the sensor that sees it, drawn from a seed.
#[derive(Clone, Debug)]
struct Scene {
    rows: usize,
    columns: usize,
    circular: bool,
    dual: bool,
    /// Pitch and roll of the sensor, radians.
    tilt_rad: [f32; 2],
    masked: bool,
    /// Rows are shifted and beams bent, as those of an HDL-64E are.
    shifted: bool,
    /// All beams start at one place.
    one_origin: bool,
    kind: Kind,
    seed: u64,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// Any range in any pixel.
    Noise,
    /// A few ranges that differ by a sensor's step or a multiple of it.
    Steps,
    /// Ground, boxes and holes.
    Street,
    /// Ranges as great as packets can tell.
    Far,
}

fn scenes() -> impl Strategy<Value = Scene> {
    let street = || Just(Kind::Street);
    let kind = prop_oneof![
        Just(Kind::Noise),
        Just(Kind::Steps),
        street(),
        street(),
        Just(Kind::Far)
    ];
    let rows = prop_oneof![
        1..20_usize,
        Just(32),
        Just(64),
        Just(65),
        Just(127),
        Just(128)
    ];
    // Upright, head down and on its side.
    let tilt_rad = prop_oneof![
        Just([0.0; 2]),
        Just([0.1, -0.06]),
        Just([0.0, PI]),
        Just([-0.2, -3.0]),
        Just([0.7, 0.5]),
    ];
    let bools = any::<[bool; 5]>();
    let scene = (rows, 1..70_usize, bools, tilt_rad, kind, any::<u64>());
    scene.prop_map(|(rows, columns, bools, tilt_rad, kind, seed)| {
        let [circular, dual, masked, shifted, one_origin] = bools;
        Scene {
            rows,
            columns,
            circular,
            dual,
            tilt_rad,
            masked,
            shifted,
            one_origin,
            kind,
            seed,
        }
    })
}

impl Scene {
    fn config(&self, method: Method) -> Config {
        let mut rng = fastrand::Rng::with_seed(self.seed ^ 1);
        let mount = Mount {
            height_m: Some(1.5 + rng.f32()),
            ..self.mount()
        };
        let mask = self.masked.then(|| self.mask(&mut rng));
        let min_range_m = if self.masked { 3.0 * rng.f32() } else { 0.0 };
        let max_range_m = if self.masked {
            min_range_m + 5.0 + 40.0 * rng.f32()
        } else {
            f32::INFINITY
        };
        Config {
            method,
            min_points: rng.u32(1..6),
            theta_rad: 0.02 + 0.5 * rng.f32(),
            mount,
            min_range_m,
            max_range_m,
            mask,
            joining: Joining {
                gap_rad: [0.0, 0.035, 0.2][rng.usize(..3)],
                min_gap_m: [0.0, 0.25][rng.usize(..2)],
                max_gap_m: [0.25, 0.65, 1.0][rng.usize(..3)],
                small_points: [0, 1, 5, 22][rng.usize(..4)],
                small_area_m2: [0.0, 0.1, 10.0][rng.usize(..3)],
                small_reach_m: 0.4 * rng.f32(),
            },
            climb_m: [0.02, 0.05, 0.11, 0.2][rng.usize(..4)],
            max_width_rad: 0.3 + 4.0 * rng.f32(),
            ..Config::default()
        }
    }

    fn mount(&self) -> Mount {
        let [pitch_rad, roll_rad] = self.tilt_rad;
        Mount {
            height_m: None,
            pitch_rad,
            roll_rad,
        }
    }

    fn mask(&self, rng: &mut fastrand::Rng) -> Mask {
        let width = rng.usize(1..20);
        let mut hidden: Vec<bool> = (0..width * self.rows).map(|_| rng.u8(..) < 30).collect();
        // One that hides all is refused.
        hidden[0] = false;
        Mask::new(width, self.rows, &hidden).unwrap()
    }

    /// Calls with the sweep, whose columns begin at the given one; label planes hold the rests of
    /// an older sweep.
    fn with_sweep<T>(&self, start: usize, look: impl FnOnce(&mut SweepMut<'_>) -> T) -> T {
        let pixels = self.rows * self.columns;
        let shape = Shape {
            rows: self.rows,
            columns_capacity: self.columns + 5,
            dual: self.dual,
            segments_capacity: pixels,
        };
        let mut buffer = HeapBuffers::default().take(shape.total_bytes());
        let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
        sweep.header.columns = self.columns as u32;
        sweep.header.margin_columns = if self.shifted { 4 } else { 0 };
        sweep.header.flags = if self.circular { flags::CIRCULAR } else { 0 };
        sweep.label.fill(0xDEAD);
        sweep.label2.fill(0xDEAD);
        let mut rng = fastrand::Rng::with_seed(self.seed);
        self.draw(&mut sweep, &mut rng);
        let image = (sweep.image_columns(), sweep.image_pixels());
        sweep.columns[image.0].rotate_left(start);
        sweep.range[image.1].rotate_left(start * self.rows);
        for (range2, range) in sweep.range2.iter_mut().zip(&*sweep.range) {
            let apart = [0.0, 0.1, 0.29, 0.31, 2.0][rng.usize(..5)];
            *range2 = if rng.bool() { *range + apart } else { 0.0 };
        }
        look(&mut sweep)
    }

    fn draw(&self, sweep: &mut SweepMut<'_>, rng: &mut fastrand::Rng) {
        let (top, bottom) = (0.2 * rng.f64(), -0.1 - 0.5 * rng.f64());
        for (row, beam) in sweep.beams.iter_mut().enumerate() {
            let part = row as f64 / self.rows as f64;
            let ideal = Beam::ideal(row, top + (bottom - top) * part);
            let rotation_rad = if self.tilt_rad != [0.0; 2] {
                0.1 * (rng.f64() - 0.5)
            } else {
                0.0
            };
            let [vertical_offset_m, horizontal_offset_m] = match self.one_origin {
                true => [0.2, 0.03],
                false => [0.1 * rng.f64(), 0.06 * (rng.f64() - 0.5)],
            };
            let two_point = Some(TwoPoint {
                distance_offset_x_m: 0.1 * rng.f64(),
                distance_offset_y_m: 0.1,
            });
            let two_point = two_point.filter(|_| self.shifted);
            let beam_of = Beam {
                rotation_rad,
                vertical_offset_m,
                horizontal_offset_m,
                two_point,
                ..ideal
            };
            *beam = beam_of.row(rng.u32(..46_000));
            beam.shift = if self.shifted { rng.i32(-9..9) } else { 0 };
        }
        // Gaps of up to four pitches, of which the widest part neighbours.
        let pitch = TAU / (self.columns as f32 * 1.2);
        let mut azimuth_rad = rng.f32();
        let columns = sweep.image_columns();
        for column in &mut sweep.columns[columns] {
            *column = Column::measured(0, 0, azimuth_rad % TAU, 62.0 + rng.f32(), 0);
            azimuth_rad += pitch
                * if rng.u8(..) < 20 {
                    1.0 + 3.0 * rng.f32()
                } else {
                    0.9 + 0.2 * rng.f32()
                };
        }
        let levels: Vec<f32> = (0..4)
            .map(|_| 2.0 + 0.002 * rng.u32(..3000) as f32)
            .collect();
        let is_head_down = self.mount().stance() == Stance::HeadDown;
        for index in 0..self.rows * self.columns {
            let (row, column) = (index % self.rows, index / self.rows);
            // Never nearer than any sensor measures: within a hand's breadth of the origin a bent
            // beam need not reach its range.
            let range_m = match self.kind {
                Kind::Noise => 0.5 + 300.0 * rng.f32().powi(3),
                Kind::Steps => levels[rng.usize(..4)] + 0.002 * rng.u32(..20) as f32,
                Kind::Far => 250.0 + [0.0, 4.5, 5.5, 12.0][rng.usize(..4)] + rng.f32(),
                Kind::Street => {
                    let mut elevation = sweep.beams[row].elevation_rad;
                    if is_head_down {
                        elevation = -elevation;
                    }
                    let road = if elevation < -0.01 {
                        -1.8 / elevation.sin()
                    } else {
                        0.0
                    };
                    let wall = levels[column / 7 % 4] * if row % 11 < 8 { 1.0 } else { 0.0 };
                    let bump = 0.02 * rng.f32();
                    match [wall, road] {
                        [_, 0.0] => wall,
                        [wall, road] if wall > 0.0 && wall < road => wall,
                        _ => road + bump,
                    }
                }
            };
            let first = sweep.image_pixels().start;
            sweep.range[first + index] = if rng.u8(..) < 25 { 0.0 } else { range_m };
        }
    }
}

fn label_of(sweep: &mut SweepMut<'_>, config: &Config) {
    Segmenter::new(config.clone()).unwrap().segment(sweep);
}

/// The same in steps: at each stop, a share of the columns, what will stay as it is.
fn label_early(sweep: &mut SweepMut<'_>, segmenter: &mut Segmenter, mut stops: Vec<f64>) {
    stops.sort_by(f64::total_cmp);
    let (whole, image, range) = (
        sweep.header.columns,
        sweep.image_pixels(),
        sweep.range.to_vec(),
    );
    let rows = sweep.header.rows as usize;
    let shifts = || sweep.beams.iter().map(|beam| beam.shift);
    let [lead, trail] = [shifts().max(), shifts().map(|shift| -shift).max()]
        .map(|most| most.unwrap().max(0) as usize);
    for stop in stops {
        if stop < 0.2 {
            segmenter.spoil();
        }
        sweep.header.columns = (stop * f64::from(whole)) as u32;
        let ready = (sweep.header.columns as usize).saturating_sub(lead);
        sweep.range.fill(3.0);
        let sure = image.start + (trail * rows).min(ready * rows)..image.start + ready * rows;
        sweep.range[sure.clone()].copy_from_slice(&range[sure]);
        if segmenter.begin_early(sweep, ready) {
            while segmenter.find_ground(sweep) {
                segmenter.join();
                segmenter.emit(sweep);
            }
        }
    }
    sweep.header.columns = whole;
    sweep.range.copy_from_slice(&range);
    sweep.label.fill(0xDEAD);
    segmenter.segment(sweep);
}

/// What a segmenter writes into a sweep, but for its header.
fn written(sweep: &SweepRef<'_>) -> (Vec<u32>, Vec<u32>, Vec<u8>) {
    let segments = sweep
        .segments
        .iter()
        .flat_map(|segment| segment.as_bytes().to_vec())
        .collect();
    (sweep.label.to_vec(), sweep.label2.to_vec(), segments)
}

/// The labels with each segment named by its first pixel in an order that a rotation does not
/// change.
fn canonical(labels: &[u32], rows: usize, start: usize) -> Vec<u32> {
    let mut labels = labels.to_vec();
    labels.rotate_right(start * rows);
    let mut names = HashMap::new();
    for label in labels
        .iter_mut()
        .filter(|label| **label >= LABEL_FIRST_SEGMENT)
    {
        let next = names.len() as u32 + LABEL_FIRST_SEGMENT;
        *label = *names.entry(*label).or_insert(next);
    }
    labels
}

/// Counts, boxes and extents of the table, gone over pixel by pixel.
fn check_table(sweep: &SweepRef<'_>) {
    let columns = sweep.columns.len();
    let mut count = vec![0; sweep.segments.len()];
    let mut sum_m = vec![[0.0; 3]; sweep.segments.len()];
    let mut ground = 0;
    for row in 0..sweep.rows() {
        for column in 0..columns {
            let Some(pixel) = sweep.pixel(row, column)[0] else {
                continue;
            };
            ground += u32::from(pixel.label == LABEL_GROUND);
            let Some(place) = pixel.label.checked_sub(LABEL_FIRST_SEGMENT) else {
                continue;
            };
            let segment = &sweep.segments[place as usize];
            count[place as usize] += 1;
            for (axis, value) in pixel.point_m.into_iter().enumerate() {
                sum_m[place as usize][axis] += value;
                let (min, max) = (
                    f64::from(segment.min_m[axis]),
                    f64::from(segment.max_m[axis]),
                );
                assert!(
                    (min - 1e-3..=max + 1e-3).contains(&value),
                    "{min} {value} {max}"
                );
            }
            assert!(segment.nearest_m <= pixel.range_m);
            assert!((segment.row_first..=segment.row_last).contains(&(row as u16)));
            let from_first = (column + columns - segment.column_first as usize) % columns;
            let width =
                (segment.column_last as usize + columns - segment.column_first as usize) % columns;
            assert!(from_first <= width, "column {column} in {segment:?}");
        }
    }
    for ((segment, label), (count, sum_m)) in sweep
        .segments
        .iter()
        .zip(LABEL_FIRST_SEGMENT..)
        .zip(count.iter().zip(sum_m))
    {
        assert_eq!((segment.label, segment.points), (label, *count));
        for (axis, sum_m) in sum_m.into_iter().enumerate() {
            assert!((f64::from(segment.centroid_m[axis]) - sum_m / f64::from(*count)).abs() < 1e-3);
        }
    }
    assert_eq!(sweep.header.ground, ground);
}

/// Segments are wide where the sensor is inside their boxes, or where they have pixels in more than
/// so many degrees. Columns here are 1 / 1.2 of a turn's, but for gaps, so that a fifth more or less
/// is left open.
fn check_flags(sweep: &SweepRef<'_>, config: &Config) {
    let columns = sweep.columns.len();
    let pitch_rad = TAU / (1.2 * columns as f32);
    for segment in sweep.segments {
        let has_pixel = |column: usize| {
            let first = column % columns * sweep.rows();
            sweep.label[first..first + sweep.rows()].contains(&segment.label)
        };
        // Around a turn: all but the longest stretch of columns without its pixels.
        let (mut hole, mut widest) = (0, 0);
        for column in 0..2 * columns {
            hole = if has_pixel(column) { 0 } else { hole + 1 };
            widest = hole.max(widest);
        }
        let spanned = match sweep.header.has(flags::CIRCULAR) {
            true => columns - widest,
            false => {
                let first = (0..columns).find(|column| has_pixel(*column));
                let last = (0..columns).rfind(|column| has_pixel(*column));
                last.unwrap() + 1 - first.unwrap()
            }
        };
        let width_rad = spanned as f32 * pitch_rad;
        let ends_m = segment.min_m.iter().zip(&segment.max_m);
        let is_around = ends_m.clone().all(|(min_m, max_m)| min_m * max_m <= 0.0);
        // Of a few columns, most may stand before gaps.
        let is_near = columns < 16
            || (width_rad / config.max_width_rad - 1.0).abs() < 0.2
            || (width_rad - config.max_width_rad).abs() < 2.0 * pitch_rad;
        let expected = is_around || width_rad > config.max_width_rad;
        assert!(
            is_wide(segment) == expected || is_near && !is_around,
            "{width_rad} of {}: {segment:?}",
            config.max_width_rad
        );
    }
}

/// Whether a pixel holds a return that may be labelled.
fn is_real(sweep: &SweepRef<'_>, config: &Config, pixel: usize) -> bool {
    let row = pixel % sweep.rows();
    let column = pixel / sweep.rows();
    let is_masked = config
        .mask
        .as_ref()
        .is_some_and(|mask| mask.hides(row, sweep.azimuth_rad(row, column)));
    let range_m = sweep.range[pixel];
    is_return(range_m) && (config.min_range_m..=config.max_range_m).contains(&range_m) && !is_masked
}

/// Beta of two pixels, by the points where their beams end if all start at one place, radians.
fn beta_rad(sweep: &SweepRef<'_>, a: usize, b: usize) -> f64 {
    let far = if sweep.range[a] > sweep.range[b] {
        a
    } else {
        b
    };
    let along_m = |pixel: usize| {
        let row = pixel % sweep.rows();
        let column = pixel / sweep.rows();
        let origin_m = sweep.point_m(row, column, 0.0);
        let end_m = sweep.point_m(row, column, sweep.range[pixel]);
        [0, 1, 2].map(|axis| end_m[axis] - origin_m[axis])
    };
    let far_m = along_m(far);
    let near_m = along_m(a + b - far);
    let apart_m = [0, 1, 2].map(|axis| far_m[axis] - near_m[axis]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    (dot(far_m, apart_m) / (dot(far_m, far_m) * dot(apart_m, apart_m)).sqrt())
        .clamp(-1.0, 1.0)
        .acos()
}

/// Gaps before the columns in median gaps; none before the first of what is no whole turn.
fn gaps(sweep: &SweepRef<'_>) -> Vec<Option<f64>> {
    let columns = sweep.columns.len();
    let azimuth_rad = |column: usize| f64::from(sweep.columns[column % columns].azimuth_rad);
    let gap_rad = |column: usize| {
        let gap_rad = (azimuth_rad(column) - azimuth_rad(column + columns - 1))
            .rem_euclid(std::f64::consts::TAU);
        gap_rad.min(std::f64::consts::TAU - gap_rad)
    };
    let first = usize::from(!sweep.header.has(flags::CIRCULAR));
    let mut sorted_rad: Vec<f64> = (first..columns).map(gap_rad).collect();
    sorted_rad.sort_by(f64::total_cmp);
    let median_rad = sorted_rad
        .get(sorted_rad.len().saturating_sub(1) / 2)
        .copied()
        .unwrap_or(0.0);
    (0..columns)
        .map(|column| (column >= first).then(|| gap_rad(column) / median_rad))
        .collect()
}

/// Components of some pixels by pairs of them.
fn united(pixels: usize, pairs: &[[usize; 2]]) -> Vec<usize> {
    let mut first: Vec<usize> = (0..pixels).collect();
    loop {
        let before = first.clone();
        for &[a, b] in pairs {
            first[a] = first[a].min(first[b]);
            first[b] = first[a];
        }
        if first == before {
            return first;
        }
    }
}

/// Holds the segments against the paper: neighbours that are no ground belong together where beta
/// exceeds theta, and components of enough points are numbered by their first pixels. Pairs within
/// some percent of theta may go either way: the sweep's points know the turning rate of each
/// column, the method but its mean.
fn check_components(sweep: &SweepRef<'_>, config: &Config) {
    let rows = sweep.rows();
    let columns = sweep.columns.len();
    let pixels = sweep.label.len();
    let is_on = |pixel: usize| is_real(sweep, config, pixel) && sweep.label[pixel] != LABEL_GROUND;
    let gaps = gaps(sweep);
    let mut sure = Vec::new();
    let mut possible = Vec::new();
    for pixel in (0..pixels).filter(|&pixel| is_on(pixel)) {
        let above = (pixel % rows > 0).then(|| (pixel - 1, 0.0));
        let before = gaps[pixel / rows].map(|gap| ((pixel + (columns - 1) * rows) % pixels, gap));
        for (other, gap) in [above, before]
            .into_iter()
            .flatten()
            .filter(|(other, _)| is_on(*other))
        {
            let beta_rad = beta_rad(sweep, pixel, other);
            let theta_rad = f64::from(config.theta_rad);
            if beta_rad > 0.95 * theta_rad && gap < 3.01 {
                possible.push([pixel, other]);
            }
            if beta_rad > 1.05 * theta_rad && gap < 2.99 {
                sure.push([pixel, other]);
            }
        }
    }
    let sure = united(pixels, &sure);
    let possible = united(pixels, &possible);
    let points = |component: &[usize], pixel: usize| {
        component
            .iter()
            .filter(|first| **first == component[pixel])
            .count()
    };
    let mut first_of = Vec::new();
    for pixel in (0..pixels).filter(|&pixel| is_on(pixel)) {
        let label = sweep.label[pixel];
        assert_eq!(
            label, sweep.label[sure[pixel]],
            "pixel {pixel} and {} are joined",
            sure[pixel]
        );
        match label.checked_sub(LABEL_FIRST_SEGMENT) {
            None => assert!(
                points(&sure, pixel) < config.min_points as usize,
                "pixel {pixel} has no label"
            ),
            Some(place) => {
                if place as usize == first_of.len() {
                    first_of.push(pixel);
                }
                let first = first_of[place as usize];
                assert_eq!(
                    possible[pixel], possible[first],
                    "pixel {pixel} and {first} are not joined"
                );
                assert!(
                    points(&possible, pixel) >= config.min_points as usize,
                    "pixel {pixel} has a label"
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(400) })]

    #[test]
    fn fast_is_naive(scene in scenes()) {
        let config = scene.config(Method::Slope);
        scene.with_sweep(0, |sweep| {
            let naive = twin::segment(&sweep.as_ref(), &config, config.mount.height_m);
            let mut first = None;
            for level in levels() {
                Segmenter::with_level(config.clone(), level).unwrap().segment(sweep);
                let sweep = sweep.as_ref();
                prop_assert_eq!(sweep.label, &naive[..], "{:?}", level);
                let written = written(&sweep);
                prop_assert!(first.get_or_insert_with(|| written.clone()) == &written, "{:?}", level);
            }
            Ok(())
        })?;
    }

    #[test]
    fn a_height_that_is_estimated_is_that_of_the_naive_twin(scene in scenes()) {
        let mut config = scene.config(Method::Slope);
        config.mount.height_m = None;
        scene.with_sweep(0, |sweep| {
            let (height_m, doubt) = twin::Height::new(&config).labels_take(&sweep.as_ref());
            let naive = twin::segment(&sweep.as_ref(), &config, height_m);
            for level in levels() {
                Segmenter::with_level(config.clone(), level).unwrap().segment(sweep);
                let sweep = sweep.as_ref();
                let said = (sweep.header.height_m, sweep.header.height_doubt);
                prop_assert_eq!(said, (height_m.unwrap_or(0.0), doubt), "{:?}", level);
                prop_assert_eq!(sweep.label, &naive[..], "{:?}", level);
            }
            Ok(())
        })?;
    }

    #[test]
    fn the_paper_joins_by_beta(scene in scenes()) {
        let scene = Scene { shifted: false, one_origin: true, ..scene };
        let mut config = scene.config(Method::Paper);
        // Nothing that is not real connects.
        config.paper.repair_reach = 0;
        scene.with_sweep(0, |sweep| {
            label_of(sweep, &config);
            check_table(&sweep.as_ref());
            check_components(&sweep.as_ref(), &config);
        });
    }

    /// Whatever the beams are, with repaired holes.
    #[test]
    fn the_paper_labels_what_may_be_labelled(scene in scenes()) {
        let config = scene.config(Method::Paper);
        scene.with_sweep(0, |sweep| {
            label_of(sweep, &config);
            check_table(&sweep.as_ref());
            for (pixel, label) in sweep.as_ref().label.iter().enumerate() {
                prop_assert!(*label == LABEL_NONE || is_real(&sweep.as_ref(), &config, pixel));
            }
            Ok(())
        })?;
    }

    #[test]
    fn points_lie_where_the_sweep_says(scene in scenes()) {
        let config = scene.config(Method::Slope);
        scene.with_sweep(0, |sweep| {
            let sweep = sweep.as_ref();
            for (index, placed) in placed(&sweep, &config).iter().enumerate() {
                let Some(placed) = placed else { continue };
                let found = placed.point_m.map(f64::from);
                let expected = sweep.point_m(index % scene.rows, index / scene.rows, placed.range_m);
                let off_m = found.iter().zip(expected).map(|(found, expected)| (found - expected).abs());
                prop_assert!(off_m.fold(0.0, f64::max) < 1e-3, "{:?} {:?}", found, expected);
                // The ground takes beams for straight and for starting on the sensor's axis; they
                // start up to 3 cm aside.
                let up = config.mount.up();
                let height_m = up.height_m(expected);
                let off_m = (f64::from(placed.height_m) - height_m).abs();
                let lean = up.height_m([1.0, 0.0, 0.0]).hypot(up.height_m([0.0, 1.0, 0.0]));
                let most_m = if scene.shifted { 0.3 + 0.1 * lean } else { 0.002 + 0.03 * lean };
                prop_assert!(off_m < most_m, "{}", off_m);
                let far2 = placed.height_m.powi(2) + placed.away_m.powi(2);
                prop_assert!((far2.sqrt() - placed.range_m).abs() < 0.35);
            }
            Ok(())
        })?;
    }

    /// Strips are taken while the head turns: what may still change, the first columns and the
    /// last, is not looked at.
    #[test]
    fn early_is_whole(scene in scenes(), columns in 1..300_usize, stops in proptest::collection::vec(0.0..1.0, 0..6)) {
        let scene = Scene { circular: true, columns, ..scene };
        let config = scene.config(Method::Slope);
        scene.with_sweep(0, |sweep| {
            label_of(sweep, &config);
            let whole = written(&sweep.as_ref());
            label_early(sweep, &mut Segmenter::new(config).unwrap(), stops);
            prop_assert!(written(&sweep.as_ref()) == whole);
            Ok(())
        })?;
    }

    /// Objects are told while the head turns, those of a sweep that changes with it; a
    /// listener changes nothing.
    #[test]
    fn objects_are_the_rows_of_the_table(
        scene in scenes(),
        columns in 1..900_usize,
        width_rad in 0.05..3.0_f32,
        stops in proptest::collection::vec(0.0..1.0, 0..12),
    ) {
        let scene = Scene { circular: true, columns, rows: scene.rows.min(40), ..scene };
        let config = Config { max_width_rad: width_rad, ..scene.config(Method::Slope) };
        let is_changed = stops.iter().any(|stop| *stop < 0.2);
        scene.with_sweep(0, |sweep| {
            for (index, column) in sweep.columns.iter_mut().enumerate() {
                column.time_ns = 100_000 * index as u32;
            }
            label_of(sweep, &config);
            let whole = written(&sweep.as_ref());
            let mut segmenter = Segmenter::new(config).unwrap();
            segmenter.find_objects(true);
            label_early(sweep, &mut segmenter, stops);
            prop_assert!(written(&sweep.as_ref()) == whole);
            let (first, told, labels) = segmenter.objects().unwrap().take();
            let tally = check(&sweep.as_ref(), told, labels.unwrap(), is_changed, "a scene");
            prop_assert!(first == 0 && told.len() >= tally.early + tally.with_sweep);
            Ok(())
        })?;
    }

    #[test]
    fn tables_and_planes_agree(scene in scenes(), paper in any::<bool>()) {
        let config = scene.config(if paper { Method::Paper } else { Method::Slope });
        scene.with_sweep(0, |sweep| {
            label_of(sweep, &config);
            let sweep = sweep.as_ref();
            check_table(&sweep);
            check_flags(&sweep, &config);
            for (index, &label) in sweep.label.iter().enumerate() {
                prop_assert!(is_return(sweep.range[index]) || label == LABEL_NONE);
                prop_assert!(label < sweep.header.segments + LABEL_FIRST_SEGMENT);
            }
            for (index, &label2) in sweep.label2.iter().enumerate() {
                // Near on the beam it is the same object; nothing is labelled beyond the limits, in
                // either plane.
                let (range_m, range2_m) = (sweep.range[index], sweep.range2[index]);
                let within = |range_m: f32| range_m >= config.min_range_m && range_m <= config.max_range_m;
                let same = (range2_m - range_m).abs() <= 0.3 && is_return(range2_m) && within(range2_m);
                prop_assert_eq!(label2, if same { sweep.label[index] } else { LABEL_NONE });
                prop_assert!(within(range_m) || sweep.label[index] == LABEL_NONE);
            }
            Ok(())
        })?;
    }

    #[test]
    fn a_turn_has_no_beginning(scene in scenes(), start in 0..70_usize) {
        let scene = Scene { circular: true, dual: false, ..scene };
        // Of fewer columns, the angle between them is not that of most.
        let start = if scene.columns < 4 { 0 } else { start % scene.columns };
        for method in [Method::Slope, Method::Paper] {
            let config = scene.config(method);
            let labels = |start| scene.with_sweep(start, |sweep| {
                // Points are measured from the speed of the first column, and the angle between
                // columns from the first ones; some pair lies so near a limit that the last bit
                // decides.
                const PITCH_RAD: f32 = 1.0 / 16.0;
                for (index, column) in sweep.columns.iter_mut().enumerate() {
                    column.azimuth_rate_rad_s = 62.5;
                    column.azimuth_rad = PITCH_RAD * ((index + start) % scene.columns) as f32;
                }
                // Of two components as near as each other, a small one goes to the first: here none
                // are.
                let image = sweep.image_pixels();
                let pixels = image.len();
                for (index, range_m) in sweep.range[image].iter_mut().enumerate() {
                    *range_m *= 1.0 + 1e-6 * ((index + start * scene.rows) % pixels) as f32;
                }
                label_of(sweep, &config);
                canonical(sweep.as_ref().label, scene.rows, start)
            });
            prop_assert_eq!(labels(0), labels(start));
        }
    }
}

/// A segmenter that has seen other shapes labels like a new one.
#[test]
fn a_workspace_keeps_nothing() {
    let scene = |rows, columns, seed| Scene {
        rows,
        columns,
        circular: true,
        dual: false,
        tilt_rad: [0.0; 2],
        masked: false,
        shifted: seed % 2 == 0,
        one_origin: seed % 3 == 0,
        kind: Kind::Street,
        seed,
    };
    for method in [Method::Slope, Method::Paper] {
        let config = scene(64, 60, 1).config(method);
        let mut used = Segmenter::new(config.clone()).unwrap();
        for scene in [
            scene(64, 60, 1),
            scene(16, 30, 2),
            scene(128, 5, 3),
            scene(1, 1, 4),
            scene(16, 69, 5),
        ] {
            scene.with_sweep(0, |sweep| {
                used.segment(sweep);
                let labels = sweep.as_ref().label.to_vec();
                label_of(sweep, &config);
                assert_eq!(labels, sweep.as_ref().label);
            });
        }
    }
}

#[test]
fn an_empty_sweep_and_a_full_table_are_no_trouble() {
    let mut buffer = HeapBuffers::default().take(1 << 16);
    let shape = Shape {
        rows: 16,
        columns_capacity: 40,
        dual: true,
        segments_capacity: 1,
    };
    let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    label_of(&mut sweep, &Config::default());
    assert_eq!((sweep.header.segments, sweep.header.ground), (0, 0));

    // Two walls, and a table with room for one.
    sweep.header.columns = 40;
    for (column, place) in sweep.columns.iter_mut().enumerate() {
        *place = Column::measured(0, 0, 0.004 * column as f32, 60.0, 0);
    }
    for (row, beam) in sweep.beams.iter_mut().enumerate() {
        *beam = Beam::ideal(row, (15.0 - 2.0 * row as f64).to_radians()).row(0);
    }
    for (index, range_m) in sweep.range.iter_mut().enumerate() {
        *range_m = if index / 16 < 20 { 3.0 } else { 30.0 };
    }
    label_of(
        &mut sweep,
        &Config {
            mount: Mount {
                height_m: Some(50.0),
                ..Mount::default()
            },
            ..Config::default()
        },
    );
    let sweep = sweep.as_ref();
    assert_eq!(sweep.header.segments, 1);
    assert!((0..640).all(|index| sweep.label[index]
        == if index / 16 < 20 {
            LABEL_FIRST_SEGMENT
        } else {
            LABEL_NONE
        }));
}

#[test]
fn a_gap_that_is_no_distance_is_refused() {
    let of = |change: fn(&mut Joining)| {
        let mut config = Config::default();
        change(&mut config.joining);
        Segmenter::new(config).map(|_| ())
    };
    assert_eq!(of(|joining| joining.small_reach_m = 0.0), Ok(()));
    let changes: [fn(&mut Joining); 8] = [
        |joining| joining.small_reach_m = -0.1,
        |joining| joining.small_reach_m = f32::NAN,
        |joining| joining.small_area_m2 = f32::NAN,
        |joining| joining.gap_rad = -0.1,
        |joining| joining.gap_rad = f32::NAN,
        |joining| joining.min_gap_m = -0.1,
        |joining| joining.min_gap_m = 0.7,
        |joining| joining.max_gap_m = 1.1,
    ];
    for change in changes {
        let error = of(change).unwrap_err();
        assert!(matches!(error, ConfigError::Gap { .. }), "{error}");
    }
}

/// Segments of boards before a sensor with rows of 0.4 degrees: how far away they stand, metres,
/// and their columns and rows.
fn segments_of(boards: &[Board]) -> u32 {
    table_of(boards, &Config::default()).len() as u32
}

type Board = (f32, std::ops::Range<usize>, std::ops::Range<usize>);

/// The table of these.
fn table_of(boards: &[Board], config: &Config) -> Vec<Segment> {
    const COLUMNS: usize = 1800;
    let shape = Shape {
        rows: 32,
        columns_capacity: COLUMNS,
        dual: false,
        segments_capacity: 50,
    };
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    sweep.header.columns = COLUMNS as u32;
    sweep.header.flags = flags::CIRCULAR;
    for (row, beam) in sweep.beams.iter_mut().enumerate() {
        *beam = Beam::ideal(row, (6.4 - 0.4 * row as f64).to_radians()).row(0);
    }
    for (index, column) in sweep.columns.iter_mut().enumerate() {
        *column = Column::measured(0, 0, TAU * index as f32 / COLUMNS as f32, 62.8, 0);
    }
    for (away_m, columns, rows) in boards {
        for column in columns.clone() {
            for row in rows.clone() {
                let cos = sweep.beams[row].elevation_rad.cos();
                sweep.range[column * 32 + row] = away_m / cos;
            }
        }
    }
    label_of(&mut sweep, config);
    sweep.as_ref().segments.to_vec()
}

/// Columns of 0.2 degrees: 60 degrees are 300. Rows from 6.4 degrees up to 6 down.
#[test]
fn a_segment_is_wide_by_its_width_or_around_the_sensor() {
    let wide_with = |boards: &[Board], max_deg: f32, method: Method| {
        let config = Config {
            method,
            max_width_rad: max_deg.to_radians(),
            ..Config::default()
        };
        let table = table_of(boards, &config);
        assert_eq!(table.len(), 1, "{boards:?}, {method:?}");
        is_wide(&table[0])
    };
    for method in [Method::Slope, Method::Paper] {
        let wide = |boards: &[Board], max_deg: f32| wide_with(boards, max_deg, method);
        // 59 and 61 degrees: in one piece, and across the seam.
        assert!(!wide(&[(5.0, 200..495, 0..32)], 60.0));
        assert!(wide(&[(5.0, 200..505, 0..32)], 60.0));
        assert!(!wide(
            &[(5.0, 1700..1800, 0..32), (5.0, 0..195, 0..32)],
            60.0
        ));
        assert!(wide(
            &[(5.0, 1700..1800, 0..32), (5.0, 0..205, 0..32)],
            60.0
        ));
        // 120 degrees may not be wide, but these from 10 degrees left to 100 right have ends before
        // the sensor and behind it, left and right.
        let corner = |rows: std::ops::Range<usize>, last: usize| {
            wide(
                &[(5.0, 1750..1800, rows.clone()), (5.0, 0..last, rows)],
                120.0,
            )
        };
        assert!(corner(0..32, 500) && !corner(0..32, 400));
        // As an arch: all of it is above the sensor.
        assert!(!corner(0..10, 500));
        // All around.
        assert!(wide(&[(5.0, 0..1800, 0..32)], 300.0));
    }
}

#[test]
fn a_width_that_is_none_is_refused() {
    for max_width_rad in [0.0, -1.0, f32::NAN] {
        let config = Config {
            max_width_rad,
            ..Config::default()
        };
        let error = Segmenter::new(config).unwrap_err();
        assert!(matches!(error, ConfigError::Width { .. }), "{error}");
    }
}

/// A column is 0.2 degrees.
#[test]
fn what_stands_side_by_side_is_parted_by_the_gap_that_the_sensor_sees() {
    let side_by_side = |away_m: f32, apart_m: f32| {
        let columns = (apart_m / away_m / 0.2_f32.to_radians()).round() as usize;
        let second = 220 + columns;
        segments_of(&[
            (away_m, 200..221, 0..32),
            (away_m, second..second + 21, 0..32),
        ])
    };
    for (away_m, gap_m) in [(12.0, 0.42), (15.0, 0.52), (30.0, 0.65), (60.0, 0.65)] {
        let step_m = away_m * 0.2_f32.to_radians();
        let what = format!("{away_m} m away");
        assert_eq!(side_by_side(away_m, gap_m - step_m), 1, "{what}");
        assert_eq!(side_by_side(away_m, gap_m + 1.5 * step_m), 2, "{what}");
    }
    // One behind the other.
    let behind = |away_m: f32, apart_m: f32| {
        segments_of(&[
            (away_m, 200..221, 0..32),
            (away_m + apart_m, 221..242, 0..32),
        ])
    };
    assert_eq!([behind(4.0, 0.2), behind(4.0, 0.3)], [1, 2]);
    assert_eq!([behind(30.0, 0.6), behind(30.0, 0.7)], [1, 2]);
}

/// A row is 0.4 degrees.
#[test]
fn what_stands_above_the_other_is_one_thing() {
    let above = |away_m: f32, second: usize| {
        segments_of(&[(away_m, 200..250, 0..9), (away_m, 200..250, second..32)])
    };
    // Four rows apart, 0.28 m at 10 m, 0.98 m at 35 m, and 1.1 m at 40 m.
    assert_eq!(
        [10.0, 35.0, 40.0].map(|away_m| above(away_m, 12)),
        [1, 1, 2]
    );
    // No window has the fifth.
    assert_eq!(above(10.0, 13), 2);
}

/// What shows less than 0.1 m² is a part of what is near it, and a thing of its own elsewhere.
#[test]
fn what_shows_little_is_a_part_of_what_is_near() {
    // A board of 0.09 m² at 5 m, 12 by 12 pixels, and a larger one so far behind it.
    let behind =
        |apart_m: f32| segments_of(&[(5.0, 200..212, 4..16), (5.0 + apart_m, 212..300, 0..32)]);
    assert_eq!([behind(0.3), behind(0.55), behind(0.7)], [1, 1, 2]);
}

/// A sparse sensor, 1 m over a flat floor and 4 degrees nose up, with a box 3 m behind it across
/// the seam: columns begin behind the sensor.
#[test]
fn sixteen_tilted_beams_see_a_floor_and_a_box() {
    const COLUMNS: usize = 900;
    let mount = Mount {
        height_m: Some(1.0),
        pitch_rad: 4_f32.to_radians(),
        roll_rad: 0.0,
    };
    let shape = Shape {
        rows: 16,
        columns_capacity: COLUMNS,
        dual: false,
        segments_capacity: 50,
    };
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    sweep.header.columns = COLUMNS as u32;
    sweep.header.flags = flags::CIRCULAR;
    for (row, beam) in sweep.beams.iter_mut().enumerate() {
        *beam = Beam::ideal(row, (15.0 - 2.0 * row as f64).to_radians()).row(2304 * row as u32);
    }
    for (index, column) in sweep.columns.iter_mut().enumerate() {
        *column = Column::measured(
            0,
            0,
            TAU * ((index as f32 / COLUMNS as f32) + 0.5).fract(),
            62.8,
            0,
        );
    }
    let up = mount.up();
    for index in 0..16 * COLUMNS {
        let (row, column) = (index % 16, index / 16);
        let [x, y, z] = sweep.as_ref().point_m(row, column, 1.0);
        let to_floor = if up.height_m([x, y, z]) < -0.03 {
            -1.0 / up.height_m([x, y, z])
        } else {
            f64::INFINITY
        };
        let to_box = if y < 0.0 && (3.0 * x / y).abs() < 0.5 {
            -3.0 / y
        } else {
            f64::INFINITY
        };
        let range_m = to_floor.min(to_box);
        sweep.range[index] = if range_m.is_finite() {
            range_m as f32
        } else {
            0.0
        };
    }

    label_of(
        &mut sweep,
        &Config {
            mount,
            ..Config::default()
        },
    );
    let read = sweep.as_ref();
    for found in read.returns() {
        let height_m = up.height_m(found.point_m) + 1.0;
        let floor = height_m.abs() < 1e-3;
        // Half a metre behind the last return from the floor, the foot of the box may be a slope.
        let foot = (0.0..0.1).contains(&height_m) && !floor;
        assert!(
            found.label
                == if floor {
                    LABEL_GROUND
                } else {
                    LABEL_FIRST_SEGMENT
                }
                || foot,
            "{height_m} {found:?}"
        );
    }
    assert_eq!(read.header.segments, 1);
    assert!(
        read.segments[0].column_first > 850 && read.segments[0].column_last < 50,
        "{:?}",
        read.segments[0]
    );
    assert_eq!(
        (read.header.height_m, read.header.pitch_rad),
        (1.0, mount.pitch_rad)
    );
    assert!(!read.header.has(flags::HEIGHT_ESTIMATED));

    // Untold, the height is seen.
    label_of(
        &mut sweep,
        &Config {
            mount: Mount {
                height_m: None,
                ..mount
            },
            ..Config::default()
        },
    );
    assert!(
        (sweep.header.height_m - 1.0).abs() < 0.01 && sweep.header.has(flags::HEIGHT_ESTIMATED)
    );
    // A room without floor shows none, and so no ground.
    sweep.range.fill(4.0);
    sweep
        .range
        .chunks_exact_mut(16)
        .for_each(|column| column[8..].fill(0.0));
    label_of(&mut sweep, &Config::default());
    assert_eq!((sweep.header.height_m, sweep.header.ground), (0.0, 0));
    assert!(!sweep.header.has(flags::HEIGHT_ESTIMATED));
}

/// The roof of KITTI's car is 1.73 m high.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_height_of_a_car_is_seen() {
    let data = sweepd_testkit::data_dir();
    let mut projector = CloudProjector::new(COLUMNS).unwrap();
    let mut segmenter = Segmenter::new(Config::default()).unwrap();
    for frame in ["000000", "000004", "000009"] {
        let bytes =
            std::fs::read(data.join(format!("labelled/semantickitti/04/{frame}.bin"))).unwrap();
        let mut sweep = projector.project(&points(&bytes).unwrap()).unwrap();
        segmenter.segment(&mut sweep);
        assert!(
            (sweep.header.height_m - 1.73).abs() < 0.05,
            "{frame}: {}",
            sweep.header.height_m
        );
        assert!(sweep.header.has(flags::HEIGHT_ESTIMATED));
    }
}

/// Real scans, every step of the way: what is fast is what is naive.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn fast_is_naive_on_real_scans() {
    let data = sweepd_testkit::data_dir();
    for (scan, climb_m) in [("00/000000", 0.2), ("08/000009", 0.2), ("08/000009", 0.05)] {
        let bytes = std::fs::read(data.join(format!("labelled/semantickitti/{scan}.bin"))).unwrap();
        let mut projector = CloudProjector::new(COLUMNS).unwrap();
        let mut sweep = projector.project(&points(&bytes).unwrap()).unwrap();
        let mount = Mount {
            height_m: Some(1.73),
            ..Mount::default()
        };
        let config = Config {
            mount,
            climb_m,
            ..Config::default()
        };
        label_of(&mut sweep, &config);
        let sweep = sweep.as_ref();
        check_table(&sweep);
        assert!(
            sweep.label == twin::segment(&sweep, &config, config.mount.height_m),
            "{scan}"
        );
    }
}

/// The labelled street scans: the share of ground points that are found, and of found ones that are
/// ground.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn ground_is_what_people_call_ground() {
    const GROUND: [u16; 6] = [40, 44, 48, 49, 60, 72];
    const UNLABELLED: u16 = 0;
    let data = sweepd_testkit::data_dir();
    for (method, least) in [(Method::Slope, 0.95), (Method::Paper, 0.92)] {
        let [mut right, mut found, mut there] = [0_u32; 3];
        for sequence in ["00", "02", "04", "06", "08", "10"] {
            for frame in ["000000", "000004", "000009"] {
                let file = data.join(format!("labelled/semantickitti/{sequence}/{frame}.bin"));
                let classes = std::fs::read(file.with_extension("label")).unwrap();
                let config = Config {
                    method,
                    ..Config::default()
                };
                let mut segmenter = CloudSegmenter::new(config, COLUMNS).unwrap();
                let labels = segmenter.segment(&std::fs::read(file).unwrap()).unwrap();
                for (label, class) in labels.into_iter().zip(classes.as_chunks::<4>().0) {
                    let class = u16::from_le_bytes([class[0], class[1]]);
                    let (ours, theirs) = (label == LABEL_GROUND, GROUND.contains(&class));
                    if class != UNLABELLED {
                        right += u32::from(ours && theirs);
                        found += u32::from(ours);
                        there += u32::from(theirs);
                    }
                }
            }
        }
        let [right, found, there] = [right, found, there].map(f64::from);
        let f1 = 2.0 * right / (found + there);
        println!(
            "{method:?}: precision {:.3}, recall {:.3}, F1 {f1:.3}",
            right / found,
            right / there
        );
        assert!(f1 > least, "{method:?}: {f1}");
    }
}
