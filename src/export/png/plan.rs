//! The points of a sweep seen from above, with the sensor in the middle.

use std::f64::consts::{PI, TAU};

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;

use super::canvas::{Canvas, TICK, text_width};
use super::palette::{self, DIM, GRID, GROUND_FAINT, MISSING, MISSING_STRIPE, NO_RETURN, TEXT, percentile, round_up};
use super::strip::draw_caption;
use sweepd_core::sweep::layout::{LABEL_GROUND, LABEL_NONE};
use sweepd_core::sweep::{Column, SweepRef};

/// Half of the height in metres when there is no point that could tell.
const DEFAULT_EXTENT_M: f64 = 20.0;

/// How many of the returns that are not ground are within the plan: a few far ones would make all others small.
const PERCENT_SHOWN: usize = 95;

/// Directions of equal width, for the lost sectors.
const BINS: usize = 3600;

/// A point on the floor plan.
struct Spot {
    x_m: f64,
    y_m: f64,
    label: u32,
}

/// Where metres are on the page.
struct View {
    area: Rectangle,
    center: Point,
    pixels_per_m: f64,
    /// Distance of two rings.
    ring_m: f64,
}

/// Draws the plan of a sweep, both returns of a dual one.
pub fn draw(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>) {
    let spots: Vec<Spot> = sweep
        .returns()
        .filter(|found| found.point_m.iter().all(|length| length.is_finite()))
        .map(|found| Spot { x_m: found.point_m[0], y_m: found.point_m[1], label: found.label })
        .collect();
    let view = View::of(&spots, *area);
    let remark = format!("x right, y forward (up the page), a ring each {} m", view.ring_m);
    draw_caption(page, area, "seen from above", &remark);
    page.rect(*area, NO_RETURN);
    view.draw_lost_sectors(page, sweep.columns);
    view.draw_grid(page);
    view.draw_spots(page, &spots);
    view.draw_sensor(page);
    view.draw_numbers(page);
}

impl View {
    /// A view that holds nearly all of what stands on the ground.
    fn of(spots: &[Spot], area: Rectangle) -> Self {
        let aspect = f64::from(area.size.width) / f64::from(area.size.height);
        let extent = |spot: &Spot| spot.y_m.abs().max(spot.x_m.abs() / aspect);
        let mut extents: Vec<f64> = spots.iter().filter(|spot| spot.label != LABEL_GROUND).map(extent).collect();
        if extents.is_empty() {
            extents = spots.iter().map(extent).collect();
        }
        if extents.is_empty() {
            extents.push(DEFAULT_EXTENT_M);
        }
        // Rounded up to tenths of a round number, so that sweeps of one place share a scale.
        let most_m = percentile(&mut extents, PERCENT_SHOWN).clamp(1.0, 1e4) * 1.03;
        let tenth_m = round_up(most_m) / 10.0;
        let extent_m = (most_m / tenth_m).ceil() * tenth_m;
        Self {
            area,
            center: area.center(),
            pixels_per_m: f64::from(area.size.height) / 2.0 / extent_m,
            ring_m: round_up(extent_m / 4.5),
        }
    }

    /// The pixel of a place; far outside of the area for what is far away.
    fn pixel(&self, x_m: f64, y_m: f64) -> Point {
        let far = f64::from(i16::MAX);
        let place = |metres: f64| (metres * self.pixels_per_m).clamp(-far, far).round() as i32;
        self.center + Point::new(place(x_m), -place(y_m))
    }

    /// Stripes in the directions in which packets were lost, where an empty plan does not mean free space.
    fn draw_lost_sectors(&self, page: &mut Canvas, columns: &[Column]) {
        let Some(lost) = lost_bins(columns) else { return };
        for pixel in self.area.points() {
            let Point { x, y } = pixel - self.center;
            if lost[bin(f64::from(x).atan2(f64::from(-y)))] && palette::missing(pixel.x, pixel.y) == MISSING {
                page.set(pixel, MISSING_STRIPE);
            }
        }
    }

    fn draw_grid(&self, page: &mut Canvas) {
        let (width, height) = (self.area.size.width as i32, self.area.size.height as i32);
        let Point { x: left, y: top } = self.area.top_left;
        page.line(Point::new(left, self.center.y), Point::new(left + width, self.center.y), GRID, &self.area);
        page.line(Point::new(self.center.x, top), Point::new(self.center.x, top + height), GRID, &self.area);
        for radius_m in self.rings_m() {
            page.circle(self.center, (radius_m * self.pixels_per_m).round() as u32, GRID, &self.area);
        }
    }

    /// The rings of which something is in the area.
    fn rings_m(&self) -> impl Iterator<Item = f64> + use<> {
        let ring_m = self.ring_m;
        let reach = f64::from(self.area.size.width).hypot(f64::from(self.area.size.height)) / 2.0;
        let count = (reach / self.pixels_per_m / ring_m) as u32;
        (1..=count).map(move |ring| f64::from(ring) * ring_m)
    }

    /// Ground lowest, segments on top.
    fn draw_spots(&self, page: &mut Canvas, spots: &[Spot]) {
        let layer = |label: u32| match label {
            LABEL_GROUND => 0,
            LABEL_NONE => 1,
            _ => 2,
        };
        for this in 0..3 {
            for spot in spots.iter().filter(|spot| layer(spot.label) == this) {
                let color = if spot.label == LABEL_GROUND { GROUND_FAINT } else { palette::label(spot.label) };
                let dot = Rectangle::new(self.pixel(spot.x_m, spot.y_m), Size::new_equal(2));
                page.rect(dot.intersection(&self.area), color);
            }
        }
    }

    /// An arrow head, forward.
    fn draw_sensor(&self, page: &mut Canvas) {
        let corners = [Point::new(0, -8), Point::new(-6, 7), Point::new(6, 7)].map(|corner| self.center + corner);
        page.triangle(corners, TEXT, &self.area);
    }

    /// Metres at the rings, to the right of the sensor; degrees at the edges.
    fn draw_numbers(&self, page: &mut Canvas) {
        let (width, height) = (self.area.size.width as i32, self.area.size.height as i32);
        for radius_m in self.rings_m() {
            let x = (radius_m * self.pixels_per_m).round() as i32;
            let text = format!("{radius_m} m");
            if x + text_width(&text, TICK) as i32 / 2 + 40 < width / 2 {
                page.label(self.center + Point::new(x, 0), &text, DIM, NO_RETURN);
            }
        }
        let edges = [
            (0, -height / 2 + 10, "0° forward"),
            (width / 2 - 18, 0, "90°"),
            (0, height / 2 - 10, "180°"),
            (-width / 2 + 18, 0, "270°"),
        ];
        for (x, y, text) in edges {
            page.label(self.center + Point::new(x, y), text, TEXT, NO_RETURN);
        }
    }
}

/// The direction of an azimuth.
fn bin(azimuth_rad: f64) -> usize {
    (azimuth_rad.rem_euclid(TAU) / TAU * BINS as f64) as usize % BINS
}

/// The directions from each lost column to the one after it; nothing where no column is lost.
fn lost_bins(columns: &[Column]) -> Option<[bool; BINS]> {
    let mut lost = None;
    for (index, column) in columns.iter().enumerate().filter(|(_, column)| column.is_missing()) {
        let from_rad = f64::from(column.azimuth_rad);
        let to_rad = columns.get(index + 1).map_or(from_rad, |next| f64::from(next.azimuth_rad));
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
        let lost = lost_bins(&[missing(359.75), Column::measured(0, 0, 0.35_f32.to_radians(), 60.0, 0)]).unwrap();
        let directions: Vec<usize> = (0..BINS).filter(|&direction| lost[direction]).collect();
        assert_eq!(directions, [0, 1, 2, 3, 3597, 3598, 3599]);
    }
}
