//! Whether a way is free: the nearest obstacle in a box that stands on the floor.
//!
//! An obstacle is a few returns of segments, or a group of returns without label that are neighbours
//! in the image and in range. A thin thing has too few returns for a segment; a snowflake, a drop or
//! a grain of dust has no neighbour.

use std::f64::consts::FRAC_PI_2;

use super::image::{SweepRef, turned_to};
use super::layout::{Header, LABEL_FIRST_SEGMENT, LABEL_NONE, flags, is_return};
use super::objects::ObjectsHeader;
use super::pose::Pose;

/// Greatest [`LeastReturns::unlabelled`]: more are taken as this, which bounds the search.
pub const MOST_UNLABELLED: u32 = 16;

/// Difference in range below which neighbours are of one thing, metres.
const APART_M: f32 = 0.3;

/// A box: x right, y ahead, z up, metres. Points on its faces are in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    least_m: [f64; 3],
    most_m: [f64; 3],
}

/// A [`Zone`] that would be no box, and so hold nothing: a way that is never blocked.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the zone from {least_m:?} to {most_m:?} is no box: no least may be greater than its most, or a NaN"
)]
pub struct NoBox {
    /// Least x, y and z, as given.
    pub least_m: [f64; 3],
    /// Greatest x, y and z, as given.
    pub most_m: [f64; 3],
}

impl Zone {
    /// A box from its least to its greatest x, y and z.
    ///
    /// # Errors
    /// [`NoBox`] if a least is greater than its most, or one is a NaN.
    pub fn new(least_m: [f64; 3], most_m: [f64; 3]) -> Result<Self, NoBox> {
        let zone = Self { least_m, most_m };
        match zone.meets([least_m, most_m]) {
            true => Ok(zone),
            false => Err(NoBox { least_m, most_m }),
        }
    }

    /// True if the point is in the box.
    pub fn holds(&self, point_m: [f64; 3]) -> bool {
        self.meets([point_m; 2])
    }

    /// True if another box, least and greatest x, y and z, reaches into this one.
    pub fn meets(&self, [least_m, most_m]: [[f64; 3]; 2]) -> bool {
        (0..3).all(|at| least_m[at] <= self.most_m[at] && self.least_m[at] <= most_m[at])
    }

    /// Moves a box whose z counts from the floor into the frame in which the floor is at this z. If
    /// the floor is not known, the box gets no top and no bottom: nobody can tell what stands on it.
    pub fn on_floor(mut self, floor_m: Option<f64>) -> Self {
        let [bottom_m, top_m] =
            floor_m.map_or([f64::NEG_INFINITY, f64::INFINITY], |floor_m| [floor_m; 2]);
        self.least_m[2] += bottom_m;
        self.most_m[2] += top_m;
        self
    }

    /// Returns the greatest distance of a point of the box from another point, metres: along the floor
    /// if the box has no end in height.
    fn far_m(&self, from_m: [f64; 3]) -> f64 {
        let most_m = |at: usize| {
            let ends_m =
                [self.least_m[at], self.most_m[at]].map(|end_m| (end_m - from_m[at]).abs());
            ends_m[0].max(ends_m[1])
        };
        let up_m = Some(most_m(2)).filter(|up_m| up_m.is_finite());
        most_m(0).hypot(most_m(1)).hypot(up_m.unwrap_or(0.0))
    }
}

/// Fewest returns of an obstacle; 0 is taken as 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct LeastReturns {
    /// Returns with the label of a segment, of all segments together.
    pub labelled: u32,
    /// Returns without label that are connected neighbours, at most [`MOST_UNLABELLED`]. Two returns of
    /// one pixel count once.
    pub unlabelled: u32,
}

impl Default for LeastReturns {
    fn default() -> Self {
        Self {
            labelled: 3,
            unlabelled: 4,
        }
    }
}

/// The nearest obstacle in a box.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Obstacle {
    /// Distance of the nearest return from the frame's origin, along the floor, metres.
    pub distance_m: f64,
    /// Returns in the box with the same label; if that is 0, those in groups that are large enough.
    pub returns: u32,
    /// Label of the nearest return: 0, or of a segment.
    pub label: u32,
}

impl Header {
    /// Returns z of the floor in the frame of the robot, metres: as far below the sensor as its height
    /// says, and never above the origin. `None` if neither the height nor a `z_m` over 0 is known.
    pub fn floor_m(&self) -> Option<f64> {
        floor_m(self.position_m[2], self.height_m)
    }
}

impl ObjectsHeader {
    /// Returns z of the floor in the frame of the robot, metres, as [`Header::floor_m`] does.
    pub fn floor_m(&self) -> Option<f64> {
        floor_m(self.position_m[2], self.height_m)
    }
}

fn floor_m(up_m: f32, height_m: f32) -> Option<f64> {
    let is_known = up_m > 0.0 || height_m > 0.0;
    is_known.then(|| (f64::from(up_m) - f64::from(height_m)).min(0.0))
}

impl SweepRef<'_> {
    /// Returns the nearest obstacle in a box in the robot's frame whose z counts from the
    /// [floor](Header::floor_m). If the floor is not known, everything over and under the box counts.
    ///
    /// `None` does not mean that the way is free: a low or thin thing may have no return, and a sensor
    /// that does not see is known by its [flags](flags::NOT_SEEING) alone. Returns that a mask,
    /// `min_range_m` or `max_range_m` keeps out of segments have no label, and so can be an obstacle:
    /// remove those of the robot itself, as docs/usage.md#mask says.
    ///
    /// The other return of a pixel counts as one without label only if the segmented one has no label
    /// either: it has one only if it lies within 0.3 m of that, so that floor behind an edge, or a drop
    /// before a wall, has none.
    pub fn obstacle(&self, zone: &Zone, least: LeastReturns) -> Option<Obstacle> {
        let zone = zone.on_floor(self.header.floor_m());
        self.obstacle_in(&Pose::of_mount(self.header), &zone, least)
    }

    /// Returns the nearest obstacle in a box in any frame in which z is up. The pose is that of the
    /// sensor in it.
    pub fn obstacle_in(&self, pose: &Pose, zone: &Zone, least: LeastReturns) -> Option<Obstacle> {
        let inside = Inside::new(*self, *pose, *zone);
        let labelled = tally(inside.returns(|label| label >= LABEL_FIRST_SEGMENT));
        let labelled = labelled.filter(|found| found.returns >= least.labelled);
        let unlabelled = tally(inside.groups(least.unlabelled));
        let nearest = [labelled, unlabelled].into_iter().flatten();
        let mut nearest = nearest.min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))?;
        if nearest.label != LABEL_NONE {
            nearest.returns = inside.returns(|label| label == nearest.label).count() as u32;
        }
        Some(nearest)
    }
}

/// Returns the nearest of some returns, and how many there are.
fn tally(mut returns: impl Iterator<Item = Held>) -> Option<Obstacle> {
    let mut nearest = returns.next()?;
    let mut count = 1;
    for one in returns {
        count += 1;
        if one.distance_m < nearest.distance_m {
            nearest = one;
        }
    }
    Some(Obstacle {
        distance_m: nearest.distance_m,
        returns: count,
        label: nearest.label,
    })
}

/// A return in the box.
#[derive(Clone, Copy)]
struct Held {
    place: Place,
    label: u32,
    distance_m: f64,
}

/// Place of a return in the image.
#[derive(Clone, Copy, Default, PartialEq)]
struct Place {
    row: usize,
    column: usize,
    /// Plane: 0, or 1 for the planes "2".
    plane: usize,
}

impl Place {
    fn is_pixel_of(&self, other: &Self) -> bool {
        (self.row, self.column) == (other.row, other.column)
    }
}

/// Neighbours without label.
#[derive(Clone, Copy, Default)]
struct Group {
    places: [Place; 2 * MOST_UNLABELLED as usize],
    len: usize,
    /// Pixels that the places are of.
    pixels: usize,
}

impl Group {
    fn found(&self) -> &[Place] {
        &self.places[..self.len]
    }

    fn add(&mut self, place: Place) {
        let is_new = !self.found().iter().any(|one| one.is_pixel_of(&place));
        self.pixels += usize::from(is_new);
        self.places[self.len] = place;
        self.len += 1;
    }
}

/// The returns of a sweep that are in a box.
struct Inside<'a> {
    sweep: SweepRef<'a>,
    planes: [(&'a [f32], &'a [u32]); 2],
    pose: Pose,
    zone: Zone,
    /// [`Zone::far_m`] from the sensor.
    far_m: f64,
    /// How much the sensor leans, radians, if the box has no end in height.
    lean_rad: Option<f64>,
}

impl<'a> Inside<'a> {
    fn new(sweep: SweepRef<'a>, pose: Pose, zone: Zone) -> Self {
        let is_endless = zone.least_m[2].is_infinite() || zone.most_m[2].is_infinite();
        Self {
            sweep,
            planes: [(sweep.range, sweep.label), (sweep.range2, sweep.label2)],
            pose,
            zone,
            far_m: zone.far_m(pose.position_m),
            lean_rad: is_endless.then(|| pose.rotation[2][2].clamp(-1.0, 1.0).acos()),
        }
    }

    /// Returns the returns in the box with a label that is wanted. Those without label are bare.
    fn returns(&self, is_wanted: impl Fn(u32) -> bool) -> impl Iterator<Item = Held> {
        let planes = self.planes.into_iter().enumerate();
        let all = planes.flat_map(|(plane, (_, labels))| {
            labels
                .iter()
                .enumerate()
                .map(move |(at, label)| (plane, at, *label))
        });
        let rows = self.sweep.rows();
        let is_wanted = move |plane, at, label| {
            is_wanted(label) && (label != LABEL_NONE || self.is_bare(plane, at))
        };
        all.filter(move |&(plane, at, label)| is_wanted(plane, at, label))
            .filter_map(move |(plane, at, label)| {
                let (row, column) = (at % rows, at / rows);
                let place = Place { row, column, plane };
                let distance_m = self.distance_m(place)?;
                Some(Held {
                    place,
                    label,
                    distance_m,
                })
            })
    }

    /// True if neither this return of a pixel nor the segmented one has a label.
    fn is_bare(&self, plane: usize, at: usize) -> bool {
        let mut labels = self.planes[..=plane].iter().map(|(_, labels)| labels);
        labels.all(|labels| labels.get(at) == Some(&LABEL_NONE))
    }

    /// Returns the returns in the box that have no label and are in groups of at least so many.
    fn groups(&self, least: u32) -> impl Iterator<Item = Held> {
        let least = least.min(MOST_UNLABELLED) as usize;
        let mut grouped: Option<Place> = None;
        let mut small = Group::default();
        let unlabelled = self.returns(|label| label == LABEL_NONE);
        unlabelled.filter(move |one| {
            // What is in the group of the last one need not be searched again, be it large or small: so
            // large things are cheap, and so are many small ones.
            let is_next = grouped.is_some_and(|of| self.around(of).any(|near| near == one.place));
            if is_next {
                grouped = Some(one.place);
            } else if !small.found().contains(&one.place) {
                let group = self.group(one.place, least);
                match group.pixels >= least {
                    true => grouped = Some(one.place),
                    false => small = group,
                }
            }
            grouped == Some(one.place)
        })
    }

    /// Returns the group of a return in the box without label. The search ends as soon as so many are
    /// found.
    fn group(&self, first: Place, least: usize) -> Group {
        let mut group = Group::default();
        group.add(first);
        let mut looked = 0;
        while looked < group.len && group.pixels < least {
            for place in self.around(group.places[looked]) {
                let is_new = group.pixels < least && !group.found().contains(&place);
                if is_new && self.distance_m(place).is_some() {
                    group.add(place);
                }
            }
            looked += 1;
        }
        group
    }

    /// Returns the neighbours of a return without label and with nearly the same range, in the box or
    /// not.
    fn around(&self, of: Place) -> impl Iterator<Item = Place> {
        let (rows, columns) = (self.sweep.rows(), self.sweep.columns.len());
        let circular = self.sweep.header.has(flags::CIRCULAR);
        let range_m = self.range_m(of);
        let near =
            (-1..=1).filter_map(move |by| turned_to(of.column as i64 + by, columns, circular));
        let near = near.flat_map(move |column| {
            let rows = of.row.saturating_sub(1)..(of.row + 2).min(rows);
            rows.flat_map(move |row| [0, 1].map(|plane| Place { row, column, plane }))
        });
        near.filter(move |place| {
            let (ranges, _) = self.planes[place.plane];
            let at = place.column * rows + place.row;
            self.is_bare(place.plane, at)
                && is_return(ranges[at])
                && (ranges[at] - range_m).abs() < APART_M
                && !place.is_pixel_of(&of)
        })
    }

    fn range_m(&self, Place { row, column, plane }: Place) -> f32 {
        self.planes[plane].0[column * self.sweep.rows() + row]
    }

    /// Returns the distance of a return along the floor, metres; `None` if it is not in the box.
    fn distance_m(&self, place: Place) -> Option<f64> {
        let range_m = self.range_m(place);
        let beam = &self.sweep.beams[place.row];
        let origin_m = beam.horizontal_offset_m.abs() + beam.vertical_offset_m.abs();
        // A beam goes at least so far along the floor for each metre; two-point corrections bend it by
        // less than a degree.
        let along = self.lean_rad.map_or(1.0, |lean_rad| {
            let up_rad = f64::from(beam.elevation_rad).abs() + lean_rad + 0.02;
            up_rad.min(FRAC_PI_2).cos()
        });
        // Most returns are farther away than the box: this is seen before their points are computed.
        if !is_return(range_m) || (f64::from(range_m) * along - f64::from(origin_m)) > self.far_m {
            return None;
        }
        let point_m = self.sweep.point_m(place.row, place.column, range_m);
        let point_m = self.pose.apply(point_m);
        let is_held = self.zone.holds(point_m);
        is_held.then(|| point_m[0].hypot(point_m[1]))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::collection::vec;
    use proptest::prelude::*;
    use zerocopy::IntoBytes;

    use super::*;
    use crate::{BeamRow, Column, Return, Shape, SweepMut};

    /// Wider and higher than anything in these tests, from half a metre ahead on.
    const AHEAD: Zone = Zone {
        least_m: [-100.0, 0.5, -100.0],
        most_m: [100.0, 100.0, 100.0],
    };

    /// A sweep of so many level rows and columns, a degree apart, the first straight ahead.
    struct Made {
        bytes: Vec<[u64; 8]>,
        rows: usize,
    }

    impl Made {
        fn new(rows: usize, columns: usize, dual: bool) -> Self {
            let shape = Shape {
                rows,
                columns_capacity: columns,
                dual,
                segments_capacity: 0,
            };
            let mut bytes = vec![[0; 8]; shape.total_bytes().div_ceil(64)];
            let sweep = SweepMut::create(bytes.as_mut_bytes(), &shape).unwrap();
            sweep.header.columns = columns as u32;
            for (at, column) in sweep.columns.iter_mut().enumerate() {
                *column = Column::measured(0, 0, (at as f32).to_radians(), 0.0, 0);
            }
            for (at, beam) in sweep.beams.iter_mut().enumerate() {
                *beam = BeamRow::ideal(at as u32, 0.0, 0);
            }
            Self { bytes, rows }
        }

        fn change(&mut self) -> SweepMut<'_> {
            SweepMut::open(self.bytes.as_mut_bytes()).unwrap()
        }

        fn put(&mut self, row: usize, column: usize, range_m: f32, label: u32) {
            let at = column * self.rows + row;
            let sweep = self.change();
            (sweep.range[at], sweep.label[at]) = (range_m, label);
        }

        fn put_other(&mut self, row: usize, column: usize, range_m: f32, label: u32) {
            let at = column * self.rows + row;
            let sweep = self.change();
            (sweep.range2[at], sweep.label2[at]) = (range_m, label);
        }

        fn sweep(&self) -> SweepRef<'_> {
            SweepRef::open(self.bytes.as_bytes()).unwrap()
        }

        fn obstacle(&self) -> Option<Obstacle> {
            let sweep = self.sweep();
            sweep.obstacle_in(&Pose::IDENTITY, &AHEAD, LeastReturns::default())
        }

        #[track_caller]
        fn assert(&self, distance_m: f64, returns: u32, label: u32) {
            let found = self.obstacle().expect("an obstacle");
            assert!((found.distance_m - distance_m).abs() < 1e-6, "{found:?}");
            assert_eq!((found.returns, found.label), (returns, label));
        }
    }

    #[test]
    fn three_returns_of_segments_are_an_obstacle_and_two_are_none() {
        let mut made = Made::new(2, 20, true);
        made.put(0, 0, 3.0, 2);
        made.put(1, 9, 5.0, 3);
        // Ground is nothing.
        (10..18).for_each(|column| made.put(0, column, 2.0, 1));
        assert_eq!(made.obstacle(), None);
        made.put_other(1, 9, 6.0, 3);
        made.assert(3.0, 1, 2);
        made.put(0, 9, 2.5, 3);
        made.assert(2.5, 3, 3);
    }

    #[test]
    fn four_neighbours_without_label_are_an_obstacle_and_three_are_none() {
        let mut made = Made::new(4, 20, false);
        for (row, column, range_m) in [(0, 3, 3.0), (1, 4, 3.29), (2, 3, 3.5)] {
            made.put(row, column, range_m, 0);
        }
        // A column too far, and too far in range.
        made.put(1, 6, 3.0, 0);
        made.put(1, 3, 3.95, 0);
        assert_eq!(made.obstacle(), None);
        made.put(3, 2, 3.6, 0);
        made.assert(3.0, 4, 0);
        // What has a label connects nothing.
        made.put(1, 4, 3.29, 1);
        assert_eq!(made.obstacle(), None);
    }

    #[test]
    fn what_holds_nothing_is_no_zone() {
        let (least_m, most_m) = ([-1.0, 0.5, 0.0], [1.0, 0.5, f64::INFINITY]);
        assert!(Zone::new(least_m, most_m).is_ok());
        for (axis, value) in [(0, 1.1), (1, 0.6), (2, f64::NAN)] {
            let mut wrong_m = least_m;
            wrong_m[axis] = value;
            let error = Zone::new(wrong_m, most_m).unwrap_err();
            assert!(error.to_string().contains("is no box"), "{error}");
        }
    }

    #[test]
    fn the_first_column_is_beside_the_last_of_a_whole_turn() {
        let mut made = Made::new(2, 20, false);
        for column in [0, 19] {
            made.put(0, column, 3.0, 0);
            made.put(1, column, 3.0, 0);
        }
        assert_eq!(made.obstacle(), None);
        made.change().header.flags = flags::CIRCULAR;
        made.assert(3.0, 4, 0);
    }

    #[test]
    fn two_returns_of_a_pixel_count_once_and_connect_no_others() {
        let mut made = Made::new(1, 20, true);
        for column in 0..3 {
            made.put(0, column, 3.0, 0);
            made.put_other(0, column, 3.0, 0);
        }
        assert_eq!(made.obstacle(), None);
        made.put_other(0, 3, 3.2, 0);
        made.assert(3.0, 7, 0);
        // Two things, one behind the other.
        let mut made = Made::new(1, 20, true);
        for column in 0..2 {
            made.put(0, column, 3.0, 0);
            made.put_other(0, column, 3.4, 0);
        }
        assert_eq!(made.obstacle(), None);
    }

    #[test]
    fn the_other_return_of_a_pixel_with_a_label_is_no_return_without_one() {
        // Floor behind the edge of a thing, or drops before the floor: 0.3 m and more apart.
        for label in [1, 2] {
            let mut made = Made::new(2, 20, true);
            for column in 3..6 {
                for row in 0..2 {
                    made.put(row, column, 200.0, label);
                    made.put_other(row, column, 3.0, 0);
                }
            }
            assert_eq!(made.obstacle(), None);
            // Three with a segmented return that has no label, and what has one connects nothing.
            for (row, column) in [(0, 3), (1, 3), (0, 5)] {
                made.put(row, column, 200.0, 0);
            }
            assert_eq!(made.obstacle(), None);
            made.put(0, 4, 0.0, 0);
            made.assert(3.0, 4, 0);
        }
    }

    /// Of a box 0.2 m high over the floor, by a sensor that looks to the left of its robot.
    #[test]
    fn the_zone_stands_on_the_floor_of_the_robot() {
        let mut made = Made::new(1, 40, false);
        // z is 0: as high as the sensor, up to 0.1 m to the side.
        (0..3).for_each(|column| made.put(0, column, 3.0, 5));
        let zone = |least_z_m: f64| Zone {
            least_m: [-3.5, -1.0, least_z_m],
            most_m: [-2.5, 1.0, least_z_m + 0.2],
        };
        let mut asked = |z_m: f32, height_m: f32, least_z_m: f64| {
            let header = made.change().header;
            (header.position_m, header.yaw_rad) = ([0.0, 0.0, z_m], std::f32::consts::FRAC_PI_2);
            header.height_m = height_m;
            let sweep = made.sweep();
            let found = sweep.obstacle(&zone(least_z_m), LeastReturns::default());
            (sweep.header.floor_m(), found.map(|found| found.returns))
        };
        // The sensor is 0.5 m over the floor; so it is where the origin is in the sensor.
        assert_eq!(asked(0.5, 0.5, 0.4), (Some(0.0), Some(3)));
        assert_eq!(asked(0.5, 0.5, 0.6), (Some(0.0), None));
        assert_eq!(asked(0.0, 0.5, 0.4), (Some(-0.5), Some(3)));
        assert_eq!(asked(0.5, 0.0, 0.4), (Some(0.0), Some(3)));
        // The floor is not over the origin.
        assert_eq!(asked(0.75, 0.5, 0.65), (Some(0.0), Some(3)));
        for nowhere_m in [-9.0, 9.0] {
            assert_eq!(asked(0.0, 0.0, nowhere_m), (None, Some(3)));
        }
        assert_eq!(asked(f32::NAN, f32::NAN, 0.4), (None, None));
    }

    /// What is said above, returns and groups in sets.
    fn naive(sweep: &SweepRef<'_>, zone: &Zone, least: LeastReturns) -> Option<Obstacle> {
        let floor_m = sweep.header.floor_m();
        let mount = Pose::of_mount(sweep.header);
        let is_in = |one: &Return| {
            let [x, y, z] = mount.apply(one.point_m);
            let is_between =
                |at: usize, value: f64| value >= zone.least_m[at] && value <= zone.most_m[at];
            let is_high = floor_m.is_none_or(|floor_m| is_between(2, z - floor_m));
            is_between(0, x) && is_between(1, y) && is_high
        };
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let pixels = (0..columns).flat_map(|column| (0..rows).map(move |row| (row, column)));
        let all = pixels.flat_map(|(row, column)| sweep.pixel(row, column));
        let all: Vec<Return> = all.flatten().filter(is_in).collect();
        let distance_m = |one: &Return| {
            let [x, y, _] = mount.apply(one.point_m);
            x.hypot(y)
        };
        let beside = |one: usize, other: usize| {
            let apart = one.abs_diff(other);
            let is_circular = sweep.header.has(flags::CIRCULAR);
            apart <= 1 || is_circular && apart + 1 == columns
        };
        let meet = |one: &Return, other: &Return| {
            one.row.abs_diff(other.row) <= 1
                && beside(one.column, other.column)
                && (one.row, one.column) != (other.row, other.column)
                && (one.range_m - other.range_m).abs() < 0.3
        };
        // One whose pixel has a label is none without label.
        let of_pixel = |one: &Return| sweep.label[one.column * rows + one.row];
        let bare = (0..all.len()).filter(|&at| all[at].label == 0 && of_pixel(&all[at]) == 0);
        let bare: Vec<usize> = bare.collect();
        let group_of = |first: usize| {
            let mut group = BTreeSet::from([first]);
            loop {
                let more = bare.iter().filter(|&&at| {
                    group.iter().any(|&of| meet(&all[of], &all[at])) && !group.contains(&at)
                });
                let more: Vec<usize> = more.copied().collect();
                if more.is_empty() {
                    let pixels = group.iter().map(|&at| (all[at].row, all[at].column));
                    return pixels.collect::<BTreeSet<_>>().len();
                }
                group.extend(more);
            }
        };
        let wanted = least.unlabelled.min(MOST_UNLABELLED) as usize;
        let labelled: Vec<usize> = (0..all.len()).filter(|&at| all[at].label >= 2).collect();
        let grouped = bare.iter().copied().filter(|&at| group_of(at) >= wanted);
        let grouped: Vec<usize> = grouped.collect();
        let is_obstacle = labelled.len() >= least.labelled as usize;
        let counted: Vec<usize> = if is_obstacle {
            [grouped, labelled].concat()
        } else {
            grouped
        };
        let nearest = counted.iter().map(|&at| &all[at]);
        let nearest = nearest.min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
        let same = counted.iter().filter(|&&at| all[at].label == nearest.label);
        Some(Obstacle {
            distance_m: distance_m(nearest),
            returns: same.count() as u32,
            label: nearest.label,
        })
    }

    /// A pixel's range and label; ranges that are the same to the millimetre are rare.
    fn pixel() -> impl Strategy<Value = (f32, u32)> {
        let near =
            (0_u32..4, 0_u32..1000).prop_map(|(to, more)| to as f32 * 0.25 + more as f32 * 1e-4);
        let range_m = prop_oneof![3 => near, 1 => Just(0.0)];
        (range_m, prop_oneof![4 => Just(0_u32), 1 => 1_u32..5])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        #[test]
        fn the_nearest_obstacle_is_that_of_the_naive_twin(
            rows in 1_usize..5,
            columns in 1_usize..9,
            dual in any::<bool>(),
            circular in any::<bool>(),
            pixels in vec((pixel(), pixel()), 32),
            (z_m, height_m) in prop_oneof![Just((0.0, 0.5)), Just((0.5, 0.5)), Just((0.0, 0.0))],
            (width_m, from_m, deep_m) in (0.01_f64..1.0, -0.5_f64..1.0, 0.1_f64..1.5),
            (labelled, unlabelled) in (0_u32..6, 0_u32..20),
            (rise_rad, pitch_rad, roll_rad) in (-0.4_f32..0.4, -0.4_f32..0.4, -0.4_f32..0.4),
        ) {
            let mut made = Made::new(rows, columns, dual);
            for (at, (one, other)) in pixels.into_iter().take(rows * columns).enumerate() {
                let (row, column) = (at % rows, at / rows);
                made.put(row, column, one.0, one.1);
                if dual {
                    made.put_other(row, column, other.0, other.1);
                }
            }
            let sweep = made.change();
            (sweep.header.position_m[2], sweep.header.height_m) = (z_m, height_m);
            (sweep.header.pitch_rad, sweep.header.roll_rad) = (pitch_rad, roll_rad);
            for (row, beam) in sweep.beams.iter_mut().enumerate() {
                *beam = BeamRow::ideal(row as u32, row as f32 * rise_rad, 0);
            }
            sweep.header.flags = if circular { flags::CIRCULAR } else { 0 };
            let zone = Zone {
                least_m: [-width_m, from_m, 0.4],
                most_m: [width_m, from_m + deep_m, 0.6],
            };
            let least = LeastReturns { labelled, unlabelled };
            let sweep = made.sweep();
            let (found, twin) = (sweep.obstacle(&zone, least), naive(&sweep, &zone, least));
            // Of two that are equally far, either is the nearest.
            let distance_m = |one: Option<Obstacle>| one.map(|one| one.distance_m);
            prop_assert_eq!(distance_m(found), distance_m(twin));
            if found != twin {
                let (found, twin) = (found.unwrap(), twin.unwrap());
                prop_assert!(found.label != twin.label, "{:?} {:?}", found, twin);
            }
        }

        /// Whatever planes, tables and header hold: an answer, with numbers in it, without a panic.
        #[test]
        fn a_hostile_sweep_does_no_harm(
            rows in 0_usize..5,
            columns in 0_usize..9,
            dual in any::<bool>(),
            bits in any::<u32>(),
            ranges in vec(prop_oneof![any::<f32>(), 0.0_f32..2.0], 32),
            labels in vec(prop_oneof![Just(0), any::<u32>()], 32),
            words in vec(any::<u32>(), 8),
            mount in vec(prop_oneof![any::<f32>(), -2.0_f32..2.0], 7),
            ends in vec(prop_oneof![any::<f64>(), -2.0_f64..2.0], 6),
            least in (any::<u32>(), any::<u32>()),
        ) {
            let mut made = Made::new(rows, columns, dual);
            let sweep = made.change();
            sweep.header.flags = bits;
            for (at, range_m) in sweep.range.iter_mut().chain(sweep.range2).enumerate() {
                *range_m = ranges[at % 32];
            }
            for (at, label) in sweep.label.iter_mut().chain(sweep.label2).enumerate() {
                *label = labels[at % 32];
            }
            for part in [sweep.columns.as_mut_bytes(), sweep.beams.as_mut_bytes()] {
                let odd = part.len() / 3;
                for (to, from) in part[..odd].iter_mut().zip(words.as_bytes().iter().cycle()) {
                    *to = *from;
                }
            }
            sweep.header.position_m = [mount[0], mount[1], mount[2]];
            (sweep.header.yaw_rad, sweep.header.pitch_rad) = (mount[3], mount[4]);
            (sweep.header.roll_rad, sweep.header.height_m) = (mount[5], mount[6]);
            let zone = Zone::new([ends[0], ends[1], ends[2]], [ends[3], ends[4], ends[5]]);
            let zone = zone.unwrap_or(AHEAD);
            let (labelled, unlabelled) = least;
            let found = made.sweep().obstacle(&zone, LeastReturns { labelled, unlabelled });
            prop_assert!(found.is_none_or(|found| found.distance_m >= 0.0 && found.returns > 0));
        }
    }
}
