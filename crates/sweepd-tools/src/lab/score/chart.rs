//! A picture of figures over a parameter: panels side by side, each with lines over an axis of its
//! own, and all over the same shares from 0 to 1.
//!
//! Lines are not distinguished by colour alone: each has its own shape of mark.

use std::io::{self, Write};

use embedded_graphics::mono_font::iso_8859_1 as fonts;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, Rectangle, Triangle};
use embedded_graphics::text::Alignment;

use sweepd::export::png::canvas::{BODY, Canvas, TextStyle};
use sweepd::export::png::palette::{BACKGROUND, DIM, GRID, NO_RETURN, TEXT, round_up};

/// Pixels of a chart.
pub const CHART_SIZE: (u32, u32) = (1200, 620);

// A chart is shown at its full size, unlike a picture of a sweep.
/// Names of axes and lines.
const CAPTION: TextStyle = TextStyle::new(&fonts::FONT_9X15_BOLD, TEXT);
/// Sentences.
const NOTE: TextStyle = TextStyle::new(&fonts::FONT_7X13, DIM);
/// Numbers at axes.
const TICK: TextStyle = TextStyle::new(&fonts::FONT_6X12, TEXT);

/// From the top to the panels, pixels.
const TOP: i32 = 108;
/// Height of a panel, pixels.
const HEIGHT: u32 = 380;
/// Left of each panel, for what its axis says, pixels.
const LEFT: i32 = 72;
/// Right of each panel, pixels.
const RIGHT: i32 = 24;
/// From one line of the legend to the next, pixels.
const LINE: i32 = 20;
/// Half of a mark, pixels.
const MARK: i32 = 5;
/// Grid lines over the height.
const SHARES: u32 = 5;
/// Steps of an axis, at least about.
const STEPS: f64 = 5.0;

/// What is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// What it is about.
    pub title: String,
    /// What the shares are of.
    pub note: String,
    /// Side by side.
    pub panels: Vec<Panel>,
}

/// Lines over one parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// The parameter and its unit.
    pub parameter: String,
    /// One or several.
    pub lines: Vec<Series>,
}

/// A line.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// What the legend calls it.
    pub name: String,
    /// Value of the parameter, 0 or more, and the share, 0 to 1; in the order in which they are
    /// joined.
    pub points: Vec<[f64; 2]>,
}

/// Draws a chart and writes it as PNG, of [`CHART_SIZE`]. A panel without points has an axis from 0
/// to 1.
///
/// # Errors
/// Those of `out`.
pub fn write_chart(chart: &Chart, out: impl Write) -> io::Result<()> {
    draw(chart).write_png(out)
}

fn draw(chart: &Chart) -> Canvas {
    let mut page = Canvas::new(Size::new(CHART_SIZE.0, CHART_SIZE.1), BACKGROUND);
    page.text(Point::new(LEFT, 16), &chart.title, BODY);
    page.text(Point::new(LEFT, 44), &chart.note, NOTE);
    let mut marks = 0;
    for (number, panel) in chart.panels.iter().enumerate() {
        let scale = Scale::of(panel, area(number, chart.panels.len()));
        scale.draw(&mut page, &panel.parameter);
        for (below, line) in (0..).zip(&panel.lines) {
            scale.draw_line(&mut page, line, marks);
            scale.draw_legend(&mut page, line, marks, below);
            marks += 1;
        }
    }
    page
}

/// Where a panel is among this many.
fn area(number: usize, count: usize) -> Rectangle {
    let width = CHART_SIZE.0 as i32 / count.max(1) as i32;
    let left = number as i32 * width + LEFT;
    Rectangle::new(
        Point::new(left, TOP),
        Size::new((width - LEFT - RIGHT).max(1) as u32, HEIGHT),
    )
}

/// Where values are on the page.
struct Scale {
    area: Rectangle,
    step: f64,
    steps: u32,
}

impl Scale {
    /// From 0 to the first round step behind the greatest value.
    fn of(panel: &Panel, area: Rectangle) -> Self {
        let values = panel
            .lines
            .iter()
            .flat_map(|line| &line.points)
            .map(|[value, _]| *value);
        let most = values.fold(0.0, f64::max);
        let most = if most > 0.0 && most.is_finite() {
            most
        } else {
            1.0
        };
        let step = round_up(most / STEPS);
        Self {
            area,
            step,
            steps: (most / step * 0.999_999).ceil() as u32,
        }
    }

    fn pixel(&self, point: [f64; 2]) -> Point {
        let [value, share] = point;
        let Size { width, height } = self.area.size;
        let x = part(value / (self.step * f64::from(self.steps)), width);
        self.area.top_left + Point::new(x, height as i32 - 1 - part(share, height))
    }

    /// The ground of the panel, its grid, and what its axes say.
    fn draw(&self, page: &mut Canvas, parameter: &str) {
        page.rect(self.area, NO_RETURN);
        let most = self.step * f64::from(self.steps);
        for number in 0..=SHARES {
            let share = f64::from(number) / f64::from(SHARES);
            let left = self.pixel([0.0, share]);
            let right = self.pixel([most, share]);
            page.outline(&Line::new(left, right), GRID, &self.area);
            let text = format!("{share:.1}");
            page.aligned_text(left - Point::new(8, 6), &text, TICK, Alignment::Right);
        }
        let decimals = (-self.step.log10().floor()).max(0.0) as usize;
        for number in 0..=self.steps {
            let value = f64::from(number) * self.step;
            let foot = self.pixel([value, 0.0]);
            let head = self.pixel([value, 1.0]);
            page.outline(&Line::new(foot, head), GRID, &self.area);
            let text = format!("{value:.decimals$}");
            page.aligned_text(foot + Point::new(0, 6), &text, TICK, Alignment::Center);
        }
        let below = Point::new(self.area.center().x, self.bottom() + 24);
        page.aligned_text(below, parameter, CAPTION, Alignment::Center);
        page.text(self.area.top_left - Point::new(0, 22), "precision", CAPTION);
    }

    fn bottom(&self) -> i32 {
        self.area.top_left.y + self.area.size.height as i32
    }

    fn draw_line(&self, page: &mut Canvas, line: &Series, mark: usize) {
        let pixels: Vec<Point> = line.points.iter().map(|&point| self.pixel(point)).collect();
        for ends in pixels.windows(2) {
            for thick in 0..2 {
                let down = Point::new(0, thick);
                let part = Line::new(ends[0] + down, ends[1] + down);
                page.outline(&part, color(mark), &self.area);
            }
        }
        pixels.into_iter().for_each(|at| draw_mark(page, at, mark));
    }

    /// The name of a line, and where it is best.
    fn draw_legend(&self, page: &mut Canvas, line: &Series, mark: usize, below: i32) {
        let at = Point::new(self.area.top_left.x + 10, self.bottom() + 54 + below * LINE);
        draw_mark(page, at + Point::new(0, 7), mark);
        let end = page.text(at + Point::new(16, 0), &line.name, CAPTION);
        // Of equals the first.
        let best = line
            .points
            .iter()
            .rev()
            .max_by(|a, b| a[1].total_cmp(&b[1]));
        if let Some([value, share]) = best {
            let text = format!("best {share:.3} at {value}");
            page.text(Point::new(end + 14, at.y + 1), &text, NOTE);
        }
    }
}

/// ColorBrewer's Set2: its hues can be distinguished without red or green, and its lightness suits
/// a dark page.
fn color(mark: usize) -> Rgb888 {
    let color = colorous::SET2[mark % colorous::SET2.len()];
    Rgb888::new(color.r, color.g, color.b)
}

/// A disc, a square, a triangle, a diamond.
fn draw_mark(page: &mut Canvas, at: Point, mark: usize) {
    let everywhere = page.bounding_box();
    let color = color(mark);
    let [up, right] = [Point::new(0, MARK + 1), Point::new(MARK + 1, 0)];
    match mark % 4 {
        0 => (0..=MARK as u32).for_each(|radius| {
            // Circles of one pixel leave holes between them; a second set beside the first fills
            // these.
            for center in [at, at + Point::new(1, 0)] {
                let circle = Circle::with_center(center, 2 * radius + 1);
                page.outline(&circle, color, &everywhere);
            }
        }),
        1 => page.rect(
            Rectangle::with_center(at, Size::new_equal(2 * MARK as u32)),
            color,
        ),
        2 => {
            let triangle = Triangle::new(at - up, at + up - right, at + up + right);
            page.fill(&triangle, color, &everywhere);
        }
        _ => {
            for tip in [at - up, at + up] {
                let half = Triangle::new(tip, at - right, at + right);
                page.fill(&half, color, &everywhere);
            }
        }
    }
}

/// The pixel at a share of this many.
fn part(share: f64, pixels: u32) -> i32 {
    (share.clamp(0.0, 1.0) * f64::from(pixels - 1)).round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(lines: &[&[[f64; 2]]]) -> Panel {
        let line = |points: &&[[f64; 2]]| Series {
            name: "a".into(),
            points: points.to_vec(),
        };
        Panel {
            parameter: "theta, degrees".into(),
            lines: lines.iter().map(line).collect(),
        }
    }

    fn chart(panels: Vec<Panel>) -> Chart {
        Chart {
            title: "found".into(),
            note: "all of them".into(),
            panels,
        }
    }

    fn at(page: &Canvas, Point { x, y }: Point) -> Rgb888 {
        let at = (y as u32 * CHART_SIZE.0 + x as u32) as usize * 3;
        Rgb888::new(page.bytes()[at], page.bytes()[at + 1], page.bytes()[at + 2])
    }

    #[test]
    fn axes_end_at_a_round_step_behind_the_last_value() {
        for (most, step, steps) in [
            (45.0, 10.0, 5),
            (1.5, 0.5, 3),
            (1.0, 0.2, 5),
            (50.0, 10.0, 5),
            (7.0, 2.0, 4),
        ] {
            let scale = Scale::of(&panel(&[&[[most, 0.5]]]), area(0, 2));
            assert!(
                (scale.step - step).abs() < 1e-9 && scale.steps == steps,
                "{most}: {} {}",
                scale.step,
                scale.steps
            );
        }
        let empty = Scale::of(&panel(&[]), area(0, 1));
        assert_eq!((empty.step, empty.steps), (0.2, 5));
    }

    /// Two lines that cross: each point has its colour, in its place.
    #[test]
    fn points_are_where_their_values_are() {
        let rising = [[0.0, 0.1], [10.0, 0.4], [50.0, 0.9]];
        let falling = [[5.0, 0.8], [40.0, 0.2]];
        let page = draw(&chart(vec![panel(&[&rising]), panel(&[&falling])]));
        for (number, points) in [&rising[..], &falling[..]].into_iter().enumerate() {
            let Rectangle { top_left, size } = area(number, 2);
            for [value, share] in points {
                let most = if number == 0 { 50.0 } else { 40.0 };
                let x = top_left.x + (value / most * f64::from(size.width - 1)).round() as i32;
                let y = top_left.y + ((1.0 - share) * f64::from(size.height - 1)).round() as i32;
                assert_eq!(
                    at(&page, Point::new(x, y)),
                    color(number),
                    "{value} {share}"
                );
            }
            assert_eq!(at(&page, top_left + Point::new(3, 3)), NO_RETURN);
        }
    }

    #[test]
    fn four_lines_have_four_colours_and_panels_stay_on_the_page() {
        let colors: Vec<Rgb888> = (0..4).map(color).collect();
        assert!((1..4).all(|index| !colors[..index].contains(&colors[index])));
        let page = Rectangle::new(Point::zero(), Size::new(CHART_SIZE.0, CHART_SIZE.1));
        for (number, count) in [(0, 1), (0, 2), (1, 2), (2, 3)] {
            assert_eq!(area(number, count).intersection(&page), area(number, count));
        }
    }

    #[test]
    fn anything_gives_a_picture() {
        let strange = [
            [f64::NAN, f64::NAN],
            [f64::INFINITY, -3.0],
            [-1.0, 7.0],
            [0.0, 0.0],
        ];
        for panels in [vec![], vec![panel(&[])], vec![panel(&[&[], &strange])]] {
            let mut file = Vec::new();
            write_chart(&chart(panels), &mut file).unwrap();
            assert!(file.starts_with(b"\x89PNG"));
        }
    }
}
