//! Work that is done to join what belongs together, counted in tests alone: clocks are no proof
//! that it is linear in pixels.

/// So many steps more. A step is sixteen pairs of points or of runs compared, an entry of a list
/// written, or a look at the parent of a piece. What is done once for each pixel or run in any case
/// does not count.
#[cfg(not(test))]
#[inline(always)]
pub(super) fn count(_steps: usize) {}

#[cfg(test)]
pub(super) use tests::count;

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::f64::consts::TAU;

    use fastrand::Rng;

    use crate::segment::{Config, Mount, Segmenter};
    use crate::sensor::Beam;
    use crate::sweep::layout::{LABEL_NONE, flags};
    use crate::sweep::{BeamRow, Buffers, Column, HeapBuffers, Shape, SweepMut};
    use sweepd_lab::simulate::Setting;
    use sweepd_lab::simulate::shape::Ray;
    use sweepd_lab::simulate::view::View;

    const ROWS: usize = 64;
    const HEIGHT_M: f32 = 1.9;
    const WIDTHS: [usize; 4] = [512, 1024, 2048, 4096];

    /// Most steps a pixel that any of these images may take: a quarter more than the worst of them
    /// took when this was written.
    const MOST: f64 = 10.7;
    /// The same of a street.
    const MOST_OF_A_STREET: f64 = 1.2;

    thread_local! {
        static STEPS: Cell<usize> = const { Cell::new(0) };
    }

    pub fn count(steps: usize) {
        STEPS.with(|sum| sum.set(sum.get() + steps));
    }

    fn azimuth_rad(column: usize, turn: usize) -> f64 {
        (column as f64 + 0.5) / turn as f64 * TAU
    }

    fn elevation_rad(row: usize) -> f64 {
        (3.0 - 28.0 * (row as f64 + 0.5) / ROWS as f64).to_radians()
    }

    /// Steps a pixel that this many columns of a turn of this many take, with such ranges, 0 for no
    /// return.
    fn steps([columns, turn]: [usize; 2], mut range_m: impl FnMut(usize, usize) -> f32) -> f64 {
        let pixels = ROWS * columns;
        let shape = Shape {
            rows: ROWS,
            columns_capacity: columns,
            dual: false,
            segments_capacity: pixels,
        };
        let mut buffer = HeapBuffers::default().take(shape.total_bytes());
        let mut sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
        (sweep.header.columns, sweep.header.flags) = (
            columns as u32,
            if columns == turn { flags::CIRCULAR } else { 0 },
        );
        for (index, column) in sweep.columns.iter_mut().enumerate() {
            *column = Column::measured(
                0,
                0,
                azimuth_rad(index, turn) as f32,
                (10.0 * TAU) as f32,
                0,
            );
        }
        for (row, beam) in sweep.beams.iter_mut().enumerate() {
            *beam = BeamRow::new(&Beam::ideal(row, elevation_rad(row)), 0);
        }
        for (index, range) in sweep.range.iter_mut().enumerate() {
            *range = range_m(index % ROWS, index / ROWS);
        }
        let mount = Mount {
            height_m: Some(HEIGHT_M),
            ..Mount::default()
        };
        let mut segmenter = Segmenter::new(Config {
            mount,
            ..Config::default()
        })
        .unwrap();
        STEPS.set(0);
        segmenter.segment(&mut sweep);
        assert!(sweep.label.iter().any(|&label| label != LABEL_NONE));
        STEPS.get() as f64 / pixels as f64
    }

    /// Fails if a wider image takes more steps a pixel than a narrower one.
    #[track_caller]
    fn check_growth(what: &str, taken: [f64; WIDTHS.len()]) {
        println!("{what}, {WIDTHS:?} columns: {taken:.2?} steps a pixel");
        // At the ends there is less to look at, or it is looked at twice: some hundredths of a
        // narrow image.
        let grows = taken.windows(2).any(|two| two[1] > 1.05 * two[0] + 0.05);
        assert!(
            !grows,
            "{what}: {taken:.2?} steps a pixel of {WIDTHS:?} columns"
        );
    }

    #[test]
    fn the_work_on_a_street_is_linear_in_its_pixels() {
        let (scene, pose) = (Setting::Street.build(1), Setting::Street.pose(0));
        let view = View::new(&scene, pose.origin, 0.0, 0.0, 0.0);
        let taken = WIDTHS.map(|columns| {
            let mut rng = Rng::with_seed(1);
            steps([columns; 2], |row, column| {
                let ray = Ray::new(
                    pose.origin,
                    azimuth_rad(column, columns),
                    elevation_rad(row),
                );
                view.cast(&ray, 0.0, 120.0, &mut rng)
                    .map_or(0.0, |hit| hit.distance_m as f32)
            })
        });
        check_growth("street", taken);
        assert!(taken[0] < MOST_OF_A_STREET, "{taken:.2?} steps a pixel");
    }

    /// Ranges by row, column and chance.
    type Pattern = fn(usize, usize, &mut Rng) -> f32;

    /// Images that are made of runs as short as can be, or of as many components.
    const WORST: [(&str, Pattern); 9] = [
        ("checkerboard, 10 m and holes", |row, column, _| {
            if (row + column).is_multiple_of(2) {
                10.0
            } else {
                0.0
            }
        }),
        ("checkerboard, 10 and 10.5 m", |row, column, _| {
            10.0 + 0.5 * ((row + column) % 2) as f32
        }),
        ("columns, 10 m and holes", |_, column, _| {
            if column.is_multiple_of(2) { 10.0 } else { 0.0 }
        }),
        ("columns, 10 and 10.7 m", |_, column, _| {
            10.0 + 0.7 * (column % 2) as f32
        }),
        ("rows, 10 and 10.7 m", |row, _, _| {
            10.0 + 0.7 * (row % 2) as f32
        }),
        ("comb, shaft up", |row, column, _| {
            if row == 0 || column.is_multiple_of(2) {
                10.0
            } else {
                10.8
            }
        }),
        (
            "random, 10 m or hole",
            |_, _, rng| if rng.bool() { 10.0 } else { 0.0 },
        ),
        ("random, 10 to 12 m", |_, _, rng| 10.0 + 2.0 * rng.f32()),
        ("random, 1 to 80 m", |_, _, rng| 1.0 + 79.0 * rng.f32()),
    ];

    /// Of one resolution more and more of a turn, so that all is the same but the width; and two
    /// whole turns.
    #[test]
    fn the_work_on_the_worst_images_is_linear_in_their_pixels() {
        let mut most = (0.0, "");
        for (what, pattern) in WORST {
            let of = |size: [usize; 2]| {
                let mut rng = Rng::with_seed(1);
                steps(size, |row, column| pattern(row, column, &mut rng))
            };
            let parts = WIDTHS.map(|columns| of([columns, WIDTHS[3]]));
            let turns = [WIDTHS[0], WIDTHS[1]].map(|columns| of([columns; 2]));
            check_growth(what, parts);
            for taken in parts.into_iter().chain(turns) {
                most = if taken > most.0 { (taken, what) } else { most };
            }
        }
        assert!(most.0 < MOST, "{}: {:.2} steps a pixel", most.1, most.0);
    }
}
