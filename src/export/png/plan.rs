//! The points of a sweep seen from above, cropped to their extent.

use std::f64::consts::{PI, TAU};

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, Rectangle, Triangle};

use super::canvas::{BODY, Canvas, NOTE};
use super::numbers::{Texts, entry, number_size, numbered};
use super::palette::{
    self, GRID, GROUND_FAINT, MISSING, MISSING_STRIPE, NO_RETURN, RIM, TEXT, round_up,
};
use super::strip::draw_caption;
use sweepd_core::sweep::layout::{LABEL_GROUND, LABEL_NONE};
use sweepd_core::sweep::{Column, Frame, Pose, Segment, SweepRef};

/// Percentage of the returns that may be outside at each side, since a few far ones would make all
/// others small.
const PERCENT_OUTSIDE: usize = 2;
/// Reach of a plan without returns, and lower bound of any reach, metres from the sensor.
const DEFAULT_REACH_M: f64 = 20.0;
const LEAST_REACH_M: f64 = 1.0;
/// Upper bound of any reach, metres: no sensor measures farther.
const MOST_REACH_M: f64 = 1e4;
/// Between the returns and the edge, pixels.
const EDGE: u32 = 12;
/// Least distance of two rings, pixels.
const RING: f64 = 110.0;

/// Greatest size of a segment of which the number is beside its box, pixels.
const BESIDE: f64 = 36.0;

/// Directions of equal width, for the lost sectors.
const BINS: usize = 3600;

/// A point on the floor plan.
struct Spot {
    x_m: f64,
    y_m: f64,
    label: u32,
}

impl Spot {
    /// Drawing order: a greater number covers a lesser one.
    fn layer(&self) -> u8 {
        match self.label {
            LABEL_GROUND => 0,
            LABEL_NONE => 1,
            _ => 2,
        }
    }
}

/// Maps metres to the page: y to the right, x down, so that azimuths are clockwise.
struct FloorPlan {
    area: Rectangle,
    /// Where the frame has its origin.
    origin: Point,
    pixels_per_m: f64,
    /// Distance of two rings.
    ring_m: f64,
}

/// Draws the plan of a sweep, both returns of a dual one; the size of the label image decides which
/// segments are numbered. By the mount, forward is to the right too: only the names of the axes are
/// those of the frame.
pub fn draw(
    page: &mut Canvas,
    area: &Rectangle,
    sweep: SweepRef<'_>,
    frame: Frame,
    label_image: Size,
) {
    let mount = Pose::of_mount(sweep.header);
    let drawn = match frame {
        Frame::Sensor => Frame::Sensor,
        Frame::Robot | Frame::Ros => Frame::Robot,
    };
    let pose = drawn.pose(mount);
    let sensor = pose.unwrap_or(Pose::IDENTITY);
    let spots: Vec<Spot> = sweep
        .points(drawn)
        .filter(|found| found.point_m.iter().all(|length| length.is_finite()))
        .map(|found| Spot {
            x_m: found.point_m[0],
            y_m: found.point_m[1],
            label: found.label,
        })
        .collect();
    let plan = FloorPlan::of(&spots, *area);
    draw_caption(
        page,
        area,
        "seen from above",
        &remark(frame, &mount, plan.ring_m),
    );
    page.rect(*area, NO_RETURN);
    let [x_m, y_m, _] = sensor.position_m;
    let at = plan.pixel(x_m, y_m);
    plan.draw_lost_sectors(page, sweep.columns, at, &sensor);
    plan.draw_grid(page);
    plan.draw_spots(page, &spots);
    let forward = [1, 0].map(|axis: usize| sensor.rotation[axis][1]);
    draw_sensor(page, at, forward, area);
    let mut texts = Texts::new(*area);
    texts.keep_clear(Rectangle::with_center(at, Size::new_equal(24)));
    plan.draw_axes(page, &mut texts);
    let anchors = anchors(&spots, sweep.segments, pose.as_ref());
    for segment in numbered(sweep, label_image) {
        if let Some([x_m, y_m]) = entry(segment.label).and_then(|entry| *anchors.get(entry)?) {
            let box_m = segment.box_in(pose.as_ref());
            let at = plan.pixel(x_m, y_m);
            plan.draw_number(page, &mut texts, segment.label, box_m, at);
        }
    }
}

/// What the axes and the rings are, and whether the mount is applied.
fn remark(frame: Frame, mount: &Pose, ring_m: f64) -> String {
    let (axes, around) = match frame {
        Frame::Sensor => ("forward (y) to the right, x down", "the sensor"),
        Frame::Robot => ("forward (y) to the right, x down", "the robot's origin"),
        Frame::Ros => ("forward (x) to the right, y up", "the robot's origin"),
    };
    let rest = match (frame, mount.is_given()) {
        (Frame::Sensor, true) => "; the mount is not applied",
        (Frame::Robot | Frame::Ros, false) => "; the mount is not known",
        _ => "",
    };
    format!("{axes}, a ring every {ring_m} m around {around}{rest}")
}

/// An arrow head, forward: to the right and down.
pub fn draw_sensor(page: &mut Canvas, at: Point, forward: [f64; 2], clip: &Rectangle) {
    let length = forward[0].hypot(forward[1]);
    // One that looks straight up or down has no forward.
    let [right, down] = match length > 0.1 {
        true => forward.map(|each| each / length),
        false => [1.0, 0.0],
    };
    for (size, color) in [(10.0, RIM), (8.0, TEXT)] {
        let corners = [(size + 2.0, 0.0), (-size, -size), (-size, size)];
        let [tip, left, other] = corners.map(|(ahead, aside)| {
            let x: f64 = ahead * right - aside * down;
            let y: f64 = ahead * down + aside * right;
            at + Point::new(x.round() as i32, y.round() as i32)
        });
        page.fill(&Triangle::new(tip, left, other), color, clip);
    }
}

/// The least and the greatest of these lengths, all but a few percent at each end, and the
/// sensor's; rounded outwards, so that sweeps of one place share a plan.
fn reach(lengths_m: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut lengths_m: Vec<f64> = lengths_m.collect();
    let Some(last) = lengths_m.len().checked_sub(1) else {
        return [-DEFAULT_REACH_M, DEFAULT_REACH_M];
    };
    let outside = last * PERCENT_OUTSIDE / 100;
    let (_, &mut least, _) = lengths_m.select_nth_unstable_by(outside, f64::total_cmp);
    let (_, &mut most, _) = lengths_m.select_nth_unstable_by(last - outside, f64::total_cmp);
    let least = least.clamp(-MOST_REACH_M, -LEAST_REACH_M);
    let most = most.clamp(LEAST_REACH_M, MOST_REACH_M);
    let step = round_up(most - least) / 20.0;
    [(least / step).floor() * step, (most / step).ceil() * step]
}

impl FloorPlan {
    /// A plan that holds nearly all returns.
    fn of(spots: &[Spot], area: Rectangle) -> Self {
        let [up_m, down_m] = reach(spots.iter().map(|spot| spot.x_m));
        let [left_m, right_m] = reach(spots.iter().map(|spot| spot.y_m));
        let width = f64::from(area.size.width - 2 * EDGE);
        let height = f64::from(area.size.height - 2 * EDGE);
        let pixels_per_m = (width / (right_m - left_m)).min(height / (down_m - up_m));
        let middle = Point::new(
            ((left_m + right_m) / 2.0 * pixels_per_m).round() as i32,
            ((up_m + down_m) / 2.0 * pixels_per_m).round() as i32,
        );
        Self {
            area,
            origin: area.center() - middle,
            pixels_per_m,
            ring_m: round_up(RING / pixels_per_m),
        }
    }

    /// The pixel of a place, possibly far outside of the area.
    fn pixel(&self, x_m: f64, y_m: f64) -> Point {
        self.origin + Point::new(self.pixels(y_m), self.pixels(x_m))
    }

    fn pixels(&self, length_m: f64) -> i32 {
        let far = f64::from(i16::MAX);
        (length_m * self.pixels_per_m).clamp(-far, far).round() as i32
    }

    /// Stripes in the directions in which packets were lost, where an empty plan does not mean free
    /// space.
    fn draw_lost_sectors(&self, page: &mut Canvas, columns: &[Column], sensor: Point, pose: &Pose) {
        let Some(lost) = lost_bins(columns) else {
            return;
        };
        for pixel in self.area.points() {
            let from_sensor = pixel - sensor;
            let [right, forward] = level_in_sensor(pose, from_sensor);
            if palette::missing(pixel.x, pixel.y) == MISSING && lost[bin(right.atan2(forward))] {
                page.set(pixel, MISSING_STRIPE);
            }
        }
    }

    /// The ends of the axes: forward, right, back, left.
    fn axis_ends(&self) -> [Point; 4] {
        let first = self.area.top_left;
        let last = first + self.area.size - Point::new(1, 1);
        let Point { x, y } = self.origin;
        [
            Point::new(last.x, y),
            Point::new(x, last.y),
            Point::new(first.x, y),
            Point::new(x, first.y),
        ]
    }

    fn draw_grid(&self, page: &mut Canvas) {
        for end in self.axis_ends() {
            page.outline(&Line::new(self.origin, end), GRID, &self.area);
        }
        for radius_m in self.rings_m() {
            let radius = (radius_m * self.pixels_per_m).round() as u32;
            let ring = Circle::with_center(self.origin, 2 * radius + 1);
            page.outline(&ring, GRID, &self.area);
        }
    }

    /// The rings that intersect the area.
    fn rings_m(&self) -> impl Iterator<Item = f64> + use<> {
        let ring_m = self.ring_m;
        let [forward, right, back, left] = self.axis_ends().map(|end| end - self.origin);
        let reach = f64::from(forward.x.max(-back.x)).hypot(f64::from(right.y.max(-left.y)));
        let count = (reach / self.pixels_per_m / ring_m) as u32;
        (1..=count).map(move |ring| f64::from(ring) * ring_m)
    }

    /// Ground lowest, segments on top.
    fn draw_spots(&self, page: &mut Canvas, spots: &[Spot]) {
        for layer in 0..3 {
            for spot in spots.iter().filter(|spot| spot.layer() == layer) {
                let color = match spot.label {
                    LABEL_GROUND => GROUND_FAINT,
                    label => palette::label(label),
                };
                let dot = Rectangle::new(self.pixel(spot.x_m, spot.y_m), Size::new_equal(2));
                page.rect(dot.intersection(&self.area), color);
            }
        }
    }

    /// Degrees at the ends of the axes, metres at the rings along the longer horizontal axis.
    fn draw_axes(&self, page: &mut Canvas, texts: &mut Texts) {
        let ends = self.axis_ends();
        for (end, text) in ends.into_iter().zip(["0° forward", "90°", "180°", "270°"]) {
            texts.draw(page, end, text, BODY);
        }
        let right = (ends[0].x - self.origin.x) >= (self.origin.x - ends[2].x);
        for radius_m in self.rings_m() {
            let at = self.pixel(0.0, if right { radius_m } else { -radius_m });
            texts.draw(page, at, &format!("{radius_m} m"), NOTE);
        }
    }

    /// The number of a segment with this box and a return at `at`: at that point if the segment is larger than
    /// its number, else beside it.
    fn draw_number(
        &self,
        page: &mut Canvas,
        texts: &mut Texts,
        label: u32,
        [least_m, most_m]: [[f64; 3]; 2],
        at: Point,
    ) {
        let size = number_size(label);
        let width = size.width as i32;
        let height = size.height as i32;
        // The page has the sensor's y to the right.
        let [y, x, _] =
            std::array::from_fn(|axis| (most_m[axis] - least_m[axis]) * self.pixels_per_m);
        // For a large segment stay near the return: there may be no returns at the edge of its box.
        let half_x = x.min(BESIDE) as i32 / 2;
        let half_y = y.min(BESIDE) as i32 / 2;
        let mut centers = vec![
            at + Point::new(0, -half_y - height / 2 - 3),
            at + Point::new(half_x + width / 2 + 5, 0),
            at + Point::new(0, half_y + height / 2 + 5),
            at + Point::new(-half_x - width / 2 - 3, 0),
        ];
        if x > f64::from(2 * width) && y > f64::from(height) || y > f64::from(2 * height) {
            centers.insert(0, at);
        }
        texts.draw_number(page, label, &centers);
    }
}

/// The return of each segment nearest to its mean, x and y: there may be no return at the mean
/// itself.
fn anchors(spots: &[Spot], segments: &[Segment], pose: Option<&Pose>) -> Vec<Option<[f64; 2]>> {
    let centroids_m: Vec<_> = segments
        .iter()
        .map(|segment| segment.centroid_in(pose))
        .collect();
    let mut nearest = vec![(f64::INFINITY, None); segments.len()];
    for spot in spots {
        let Some(entry) = entry(spot.label).filter(|&entry| entry < segments.len()) else {
            continue;
        };
        let best = &mut nearest[entry];
        let [x_m, y_m, _] = centroids_m[entry];
        let squared = (spot.x_m - x_m).powi(2) + (spot.y_m - y_m).powi(2);
        if squared < best.0 {
            *best = (squared, Some([spot.x_m, spot.y_m]));
        }
    }
    nearest.into_iter().map(|(_, place)| place).collect()
}

/// A direction on the page as the sensor sees it: to its right and forward.
fn level_in_sensor(pose: &Pose, Point { x, y }: Point) -> [f64; 2] {
    let [across, along] = [f64::from(y), f64::from(x)];
    [0, 1].map(|axis| pose.rotation[0][axis] * across + pose.rotation[1][axis] * along)
}

/// The direction of an azimuth.
fn bin(azimuth_rad: f64) -> usize {
    (azimuth_rad.rem_euclid(TAU) / TAU * BINS as f64) as usize % BINS
}

/// The directions from each lost column to the one after it; `None` if no column is lost.
fn lost_bins(columns: &[Column]) -> Option<[bool; BINS]> {
    let mut lost = None;
    for (index, column) in columns
        .iter()
        .enumerate()
        .filter(|(_, column)| column.is_missing())
    {
        let from_rad = f64::from(column.azimuth_rad);
        let to_rad = columns
            .get(index + 1)
            .map_or(from_rad, |next| f64::from(next.azimuth_rad));
        let turn_rad = (to_rad - from_rad + PI).rem_euclid(TAU) - PI;
        let steps = (turn_rad.abs() / TAU * BINS as f64).ceil();
        let lost = lost.get_or_insert([false; BINS]);
        for step in 0..=steps as usize {
            lost[bin(from_rad + turn_rad * step as f64 / steps.max(1.0))] = true;
        }
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_directions_reach_to_the_next_column_the_short_way() {
        assert!(lost_bins(&[Column::measured(0, 0, 1.0, 60.0, 0)]).is_none());
        let missing = |degrees: f32| Column::missing(degrees.to_radians(), 60.0, 0);
        let lost = lost_bins(&[
            missing(359.75),
            Column::measured(0, 0, 0.35_f32.to_radians(), 60.0, 0),
        ])
        .unwrap();
        let directions: Vec<usize> = (0..BINS).filter(|&direction| lost[direction]).collect();
        assert_eq!(directions, [0, 1, 2, 3, 3597, 3598, 3599]);
    }
}
