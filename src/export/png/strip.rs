//! The images of a sweep as it is stored, azimuth along x: ranges, reflectivities, labels.

use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;
use embedded_graphics::text::Alignment;

use super::canvas::{Canvas, NOTE, text_width};
use super::numbers::{Texts, entry, numbered};
use super::palette::{self, DIM, NO_RETURN, RangeScale, ReflectivityScale};
use super::raster::{Cell, Raster};
use sweepd_core::sweep::layout::is_return;
use sweepd_core::sweep::{Segment, SweepRef};

/// Height of a caption with the gap below it, pixels.
pub const CAPTION_HEIGHT: i32 = 44;
/// Height of the azimuth axis below an image, pixels.
pub const AXIS_HEIGHT: i32 = 30;
/// Least distance of two numbers along the azimuth axis, pixels.
const TICK_SPACING: usize = 70;
/// Length of the colour bar, pixels.
const BAR_WIDTH: i32 = 520;

/// The name of a panel and a remark, above its area.
pub fn draw_caption(page: &mut Canvas, area: &Rectangle, name: &str, remark: &str) {
    let at = area.top_left - Point::new(0, 24);
    let end = page.heading(at, name);
    page.text(Point::new(end + 14, at.y), remark, NOTE);
}

/// The ranges, with the scale of their colours.
pub fn draw_ranges(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let returns = sweep
        .range
        .iter()
        .filter(|&&range| is_return(range) && range.is_finite());
    let scale = RangeScale::of(&mut returns.map(|&range| f64::from(range)).collect::<Vec<_>>());
    let remark = "a row per laser by elevation, a column per firing in the order measured";
    draw_caption(page, area, "range", remark);
    let ticks = scale
        .ticks_m()
        .map(|tick| (scale.position(tick), format!("{tick} m")));
    draw_scale(page, area, RangeScale::color_at, ticks);
    draw_cells(page, area, raster, |index| {
        scale.color(f64::from(sweep.range[index]))
    });
    draw_elevations(page, area, sweep);
}

/// The reflectivities, with the scale of their colours.
pub fn draw_reflectivities(
    page: &mut Canvas,
    area: &Rectangle,
    sweep: SweepRef<'_>,
    raster: &Raster,
) {
    let remark = "grey: diffuse, up to 100; coloured: retro-reflectors such as signs, over 100";
    draw_caption(page, area, "reflectivity", remark);
    let ticks =
        ReflectivityScale::TICKS.map(|tick| (ReflectivityScale::position(tick), tick.to_string()));
    draw_scale(page, area, ReflectivityScale::color_at, ticks);
    draw_cells(page, area, raster, |index| {
        ReflectivityScale::color(sweep.reflectivity[index])
    });
    draw_elevations(page, area, sweep);
}

/// The labels, with numbers at the larger segments.
pub fn draw_labels(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let remark = "the same image after segmentation; azimuth 0 = sensor +y, clockwise";
    draw_caption(page, area, "labels", remark);
    draw_cells(page, area, raster, |index| {
        palette::label(sweep.label[index])
    });
    draw_elevations(page, area, sweep);
    let row_height = row_height(area, raster.rows);
    let anchors = anchors(sweep, raster);
    let mut texts = Texts::new(*area);
    for segment in numbered(sweep, area.size) {
        let Some(run) = entry(segment.label).and_then(|entry| *anchors.get(entry)?) else {
            continue;
        };
        let y = run.row as i32 * row_height + row_height / 2;
        let center = area.top_left + Point::new(run.middle as i32, y);
        texts.draw_number(page, segment.label, &[center]);
    }
}

/// Cells of one segment side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Run {
    cells: usize,
    middle: usize,
    row: usize,
    /// Twice the rows from the middle of the segment.
    off_middle: usize,
}

/// The longest run of each segment of the table; of equal runs the one nearest the middle of the
/// segment's height. A number there is on its segment, even if that is hollow or across the seam.
fn anchors(sweep: SweepRef<'_>, raster: &Raster) -> Vec<Option<Run>> {
    let mut longest: Vec<Option<Run>> = vec![None; sweep.segments.len()];
    for row in 0..raster.rows {
        let segments: Vec<Option<usize>> = (0..raster.width)
            .map(|x| match raster.cell(x, row) {
                Cell::Pixel(index) => entry(sweep.label[index]),
                Cell::Missing | Cell::Empty => None,
            })
            .collect();
        let mut first = 0;
        for cells in segments.chunk_by(|a, b| a == b) {
            let end = first + cells.len();
            let middle = (first + end) / 2;
            first = end;
            let Some(segment) = cells[0].filter(|&segment| segment < longest.len()) else {
                continue;
            };
            let Segment {
                row_first,
                row_last,
                ..
            } = sweep.segments[segment];
            let run = Run {
                cells: cells.len(),
                middle,
                row,
                off_middle: (usize::from(row_first) + usize::from(row_last)).abs_diff(2 * row),
            };
            let is_better = longest[segment]
                .is_none_or(|other| (run.cells, other.off_middle) > (other.cells, run.off_middle));
            if is_better {
                longest[segment] = Some(run);
            }
        }
    }
    longest
}

fn row_height(area: &Rectangle, rows: usize) -> i32 {
    area.size.height as i32 / rows.max(1) as i32
}

fn draw_cells(
    page: &mut Canvas,
    area: &Rectangle,
    raster: &Raster,
    color: impl Fn(usize) -> Rgb888,
) {
    let row_height = row_height(area, raster.rows);
    for row in 0..raster.rows {
        for x in 0..raster.width {
            let top = area.top_left + Point::new(x as i32, row as i32 * row_height);
            let place = Rectangle::new(top, Size::new(1, row_height as u32));
            match raster.cell(x, row) {
                Cell::Pixel(index) => page.rect(place, color(index)),
                Cell::Empty => page.rect(place, NO_RETURN),
                Cell::Missing => page.stripes(place),
            }
        }
    }
}

/// The colour bar at the right end of the caption, numbers below it: each has a place from 0 to 1.
fn draw_scale(
    page: &mut Canvas,
    area: &Rectangle,
    color_at: impl Fn(f64) -> Rgb888,
    ticks: impl IntoIterator<Item = (f64, String)>,
) {
    let right = area.top_left.x + area.size.width as i32 - 24;
    let left = right - BAR_WIDTH;
    let top = area.top_left.y - 38;
    for x in 0..BAR_WIDTH {
        let color = color_at(f64::from(x) / f64::from(BAR_WIDTH - 1));
        draw_tick(page, Point::new(left + x, top), 13, color);
    }
    let mut free = i32::MIN;
    for (position, text) in ticks {
        let x = left + (position * f64::from(BAR_WIDTH - 1)) as i32;
        let half = text_width(&text, NOTE) as i32 / 2;
        if x - half > free {
            draw_tick(page, Point::new(x, top + 13), 4, DIM);
            page.aligned_text(Point::new(x, top + 17), &text, NOTE, Alignment::Center);
            free = x + half + 8;
        }
    }
}

/// A vertical line of a pixel, this long.
fn draw_tick(page: &mut Canvas, top: Point, length: u32, color: Rgb888) {
    page.rect(Rectangle::new(top, Size::new(1, length)), color);
}

/// Elevations of the top row, the bottom row and the one nearest the horizon, left of the image.
fn draw_elevations(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>) {
    let rows = sweep.rows();
    let row_height = row_height(area, rows);
    let Some(horizon) = (0..rows).min_by(|&a, &b| {
        let a = sweep.beams[a].elevation_rad.abs();
        a.total_cmp(&sweep.beams[b].elevation_rad.abs())
    }) else {
        return;
    };
    let mut taken: Vec<i32> = Vec::new();
    for row in [0, rows - 1, horizon] {
        let y = area.top_left.y + row as i32 * row_height + row_height / 2;
        if taken.iter().all(|other| (other - y).abs() >= 20) {
            let left = area.top_left.x;
            let text = format!("{:+.1}°", sweep.beams[row].elevation_rad.to_degrees());
            page.aligned_text(Point::new(left - 8, y - 10), &text, NOTE, Alignment::Right);
            page.rect(
                Rectangle::new(Point::new(left - 5, y), Size::new(4, 1)),
                DIM,
            );
            taken.push(y);
        }
    }
}

/// Degrees below the lowest image.
pub fn draw_azimuths(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let lower_left = area.top_left + area.size.y_axis();
    page.aligned_text(
        lower_left + Point::new(-24, 7),
        "azimuth",
        NOTE,
        Alignment::Right,
    );
    let mut free = 0;
    for (column, degrees) in azimuth_ticks(sweep) {
        let x = raster.x_of(column, sweep.columns.len());
        if x >= free && x < raster.width {
            let at = lower_left + Point::new(x as i32, 0);
            draw_tick(page, at, 6, DIM);
            let text = format!("{degrees}°");
            page.aligned_text(at + Point::new(1, 7), &text, NOTE, Alignment::Center);
            free = x + TICK_SPACING;
        }
    }
}

/// Columns at which the azimuth passes a round number of degrees, and that number.
fn azimuth_ticks(sweep: SweepRef<'_>) -> Vec<(usize, i64)> {
    let azimuths = unwrapped_degrees(sweep);
    let (Some(first), Some(last)) = (azimuths.first(), azimuths.last()) else {
        return Vec::new();
    };
    let span = (last - first).abs();
    let step = [1.0, 2.0, 5.0, 10.0, 15.0]
        .into_iter()
        .find(|step| span / step <= 15.0)
        .unwrap_or(30.0);
    // The column before the first, as far before it as the second is behind it.
    let pitch = azimuths.get(1).map_or(step, |second| second - first);
    let mut before = first - pitch;
    let mut ticks = Vec::new();
    for (column, &azimuth) in azimuths.iter().enumerate() {
        let (tick, passed) = if azimuth > before {
            let tick = (azimuth / step).floor() * step;
            (tick, tick > before)
        } else {
            let tick = (azimuth / step).ceil() * step;
            (tick, tick < before)
        };
        if passed {
            ticks.push((column, (tick.round() as i64).rem_euclid(360)));
        }
        before = azimuth;
    }
    ticks
}

/// Azimuths of the columns in degrees, without the step at the whole turn.
fn unwrapped_degrees(sweep: SweepRef<'_>) -> Vec<f64> {
    let azimuths: Vec<f64> = sweep
        .columns
        .iter()
        .map(|column| f64::from(column.azimuth_rad).to_degrees())
        .collect();
    let mut turned = azimuths.clone();
    for column in 1..azimuths.len() {
        let step = azimuths[column] - azimuths[column - 1];
        turned[column] = turned[column - 1] + ((step + 180.0).rem_euclid(360.0) - 180.0);
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;
    use sweepd_core::sweep::Column;

    fn ticks(azimuths_deg: &[f32]) -> Vec<(usize, i64)> {
        let mut scene = Scene::new(&[0.0], azimuths_deg.len(), false);
        scene.fill(|sweep| {
            for (column, degrees) in sweep.columns.iter_mut().zip(azimuths_deg) {
                *column = Column::measured(0, 0, degrees.to_radians(), 0.0, 0);
            }
        });
        azimuth_ticks(scene.sweep())
    }

    #[test]
    fn ticks_stand_where_round_azimuths_are_passed() {
        let whole: Vec<f32> = (0..720)
            .map(|half| (half as f32 * 0.5 + 270.1).rem_euclid(360.0))
            .collect();
        let whole = ticks(&whole);
        assert_eq!(whole.len(), 12);
        assert_eq!((whole[0], whole[3]), ((0, 270), (180, 0)));
        // Reversed and partial: 10 degrees across the whole turn.
        assert_eq!(
            ticks(&[5.5, 3.5, 1.5, 359.5, 357.5, 355.5])[..2],
            [(0, 6), (1, 4)]
        );
        assert_eq!(ticks(&[]), []);
    }
}
