//! The two images of a sweep as it is stored: ranges above, labels below, azimuth along x.

use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;
use embedded_graphics::text::Alignment;

use super::canvas::{BODY, CAPTION, Canvas, TICK, text_width};
use super::palette::{self, DIM, GRID, NO_RETURN, RangeScale, TEXT};
use super::raster::{Cell, Raster};
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::is_return;

/// Height of a caption with the gap below it, pixels.
pub const CAPTION_HEIGHT: i32 = 32;
/// Height of the azimuth axis below an image, pixels.
pub const AXIS_HEIGHT: i32 = 20;
/// Least distance of two numbers along the azimuth axis, pixels.
const TICK_SPACING: usize = 60;
/// Length of the colour bar, pixels.
const BAR_WIDTH: i32 = 480;

/// The name of a panel and a remark, above its area.
pub fn draw_caption(page: &mut Canvas, area: &Rectangle, name: &str, remark: &str) {
    let at = area.top_left - Point::new(0, 20);
    let end = page.text(at, name, CAPTION, TEXT, Alignment::Left);
    page.text(Point::new(end + 14, at.y + 2), remark, BODY, DIM, Alignment::Left);
}

/// The ranges, with the scale of their colours.
pub fn draw_ranges(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let returns = sweep.range.iter().filter(|&&range| is_return(range) && range.is_finite());
    let scale = RangeScale::of(&mut returns.map(|&range| f64::from(range)).collect::<Vec<_>>());
    draw_caption(page, area, "range", "a row per laser by elevation, a column per firing in the order measured");
    draw_scale(page, area, scale);
    draw_cells(page, area, raster, |index| scale.color(f64::from(sweep.range[index])));
    draw_elevations(page, area, sweep);
}

/// The labels.
pub fn draw_labels(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let remark = "the same image after segmentation; azimuth 0 = sensor +y, clockwise";
    draw_caption(page, area, "labels", remark);
    draw_cells(page, area, raster, |index| palette::label(sweep.label[index]));
    draw_elevations(page, area, sweep);
}

fn draw_cells(page: &mut Canvas, area: &Rectangle, raster: &Raster, color: impl Fn(usize) -> Rgb888) {
    let row_height = area.size.height as usize / raster.rows.max(1);
    for row in 0..raster.rows {
        for x in 0..raster.width {
            let cell = raster.cell(x, row);
            let fill = if let Cell::Pixel(index) = cell { color(index) } else { NO_RETURN };
            for y in row * row_height..(row + 1) * row_height {
                let at = area.top_left + Point::new(x as i32, y as i32);
                page.set(at, if cell == Cell::Missing { palette::missing(at.x, at.y) } else { fill });
            }
        }
    }
}

/// The colour bar at the right end of the caption, metres below it.
fn draw_scale(page: &mut Canvas, area: &Rectangle, scale: RangeScale) {
    let right = area.top_left.x + area.size.width as i32 - 24;
    let (left, top) = (right - BAR_WIDTH, area.top_left.y - 30);
    for x in 0..BAR_WIDTH {
        let color = RangeScale::color_at(f64::from(x) / f64::from(BAR_WIDTH - 1));
        page.rect(Rectangle::new(Point::new(left + x, top), Size::new(1, 12)), color);
    }
    let mut free = i32::MIN;
    for tick in scale.ticks_m() {
        let x = left + (scale.position(tick) * f64::from(BAR_WIDTH - 1)) as i32;
        let text = format!("{tick} m");
        let half = text_width(&text, TICK) as i32 / 2;
        if x - half > free {
            page.rect(Rectangle::new(Point::new(x, top + 12), Size::new(1, 3)), DIM);
            page.text(Point::new(x, top + 16), &text, TICK, DIM, Alignment::Center);
            free = x + half + 6;
        }
    }
}

/// Elevations of the top row, the bottom row and the one nearest the horizon, left of the image.
fn draw_elevations(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>) {
    let rows = sweep.rows();
    let row_height = area.size.height as i32 / rows.max(1) as i32;
    let level =
        |&a: &usize, &b: &usize| sweep.beams[a].elevation_rad.abs().total_cmp(&sweep.beams[b].elevation_rad.abs());
    let horizon = (0..rows).min_by(level);
    let mut taken: Vec<i32> = Vec::new();
    for row in [Some(0), rows.checked_sub(1), horizon].into_iter().flatten().filter(|&row| row < rows) {
        let y = area.top_left.y + row as i32 * row_height + row_height / 2;
        if taken.iter().all(|other| (other - y).abs() >= 12) {
            let text = format!("{:+.1}°", sweep.beams[row].elevation_rad.to_degrees());
            page.text(Point::new(area.top_left.x - 8, y - 6), &text, TICK, DIM, Alignment::Right);
            page.rect(Rectangle::new(Point::new(area.top_left.x - 5, y), Size::new(4, 1)), DIM);
            taken.push(y);
        }
    }
}

/// Degrees below an image.
pub fn draw_azimuths(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, raster: &Raster) {
    let below = area.top_left.y + area.size.height as i32;
    page.text(Point::new(area.top_left.x - 16, below + 6), "azimuth", TICK, DIM, Alignment::Right);
    let mut free = 0;
    for (column, degrees) in azimuth_ticks(sweep) {
        let x = raster.x_of(column, sweep.columns.len());
        if x >= free && x < raster.width {
            let at = Point::new(area.top_left.x + x as i32, below);
            page.rect(Rectangle::new(at, Size::new(1, 5)), DIM);
            page.text(at + Point::new(1, 6), &format!("{degrees}°"), TICK, DIM, Alignment::Center);
            free = x + TICK_SPACING;
        }
    }
    page.line(Point::new(area.top_left.x, below), bottom_right(area), GRID, &page.bounding_box());
}

fn bottom_right(area: &Rectangle) -> Point {
    area.top_left + Point::new(area.size.width as i32, area.size.height as i32)
}

/// Columns at which the azimuth passes a round number of degrees, and that number.
fn azimuth_ticks(sweep: SweepRef<'_>) -> Vec<(usize, i64)> {
    let azimuths = unwrapped_degrees(sweep);
    let (Some(first), Some(last)) = (azimuths.first(), azimuths.last()) else { return Vec::new() };
    let span = (last - first).abs();
    let step = [1.0, 2.0, 5.0, 10.0, 15.0].into_iter().find(|step| span / step <= 15.0).unwrap_or(30.0);
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
    let mut turned = 0.0;
    let mut before = None;
    let azimuths = sweep.columns.iter().map(|column| f64::from(column.azimuth_rad).to_degrees());
    azimuths
        .map(|azimuth| {
            let step = (azimuth - before.unwrap_or(0.0) + 180.0).rem_euclid(360.0) - 180.0;
            turned = if before.is_some() { turned + step } else { azimuth };
            before = Some(azimuth);
            turned
        })
        .collect()
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
        let whole: Vec<f32> = (0..720).map(|half| (half as f32 * 0.5 + 270.1).rem_euclid(360.0)).collect();
        let whole = ticks(&whole);
        assert_eq!(whole.len(), 12);
        assert_eq!((whole[0], whole[3]), ((0, 270), (180, 0)));
        // Reversed and partial: 10 degrees across the whole turn.
        assert_eq!(ticks(&[5.5, 3.5, 1.5, 359.5, 357.5, 355.5])[..2], [(0, 6), (1, 4)]);
        assert_eq!(ticks(&[]), []);
    }
}
