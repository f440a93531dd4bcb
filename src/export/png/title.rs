//! The head of a page: identity and properties of the sweep.

use embedded_graphics::prelude::*;

use super::canvas::{ALERT, Canvas, NOTE};
use crate::text::{grouped, utc_text};
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{LABEL_GROUND, TimeSource, flags, is_return};

/// Height of the head, pixels.
pub const HEIGHT: i32 = 68;

/// Information for a picture that is not in the sweep itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Title<'a> {
    /// Name of the sensor's model.
    pub model: &'a str,
    /// Number of the sweep in the output.
    pub sweep_number: u64,
}

/// Draws the head: names large, numbers small, warnings between them at the right.
pub fn draw(page: &mut Canvas, at: Point, sweep: SweepRef<'_>, title: &Title<'_>) {
    let sensor = sweep.header.sensor();
    let number = format!("sweep {}", title.sweep_number);
    let mut names = vec![title.model, sensor, &number];
    names.retain(|name| !name.is_empty());
    let end = page.heading(at, &names.join("  ·  "));
    let warnings = warnings(sweep).join(", ");
    page.text(Point::new(end + 30, at.y), &warnings, ALERT);
    page.text(at + Point::new(0, 28), &facts(sweep).join("   "), NOTE);
}

fn facts(sweep: SweepRef<'_>) -> Vec<String> {
    let header = sweep.header;
    let clock = match header.time_source() {
        TimeSource::Gps => "GPS clock",
        TimeSource::Host => "host clock",
    };
    let segmented = returns(sweep.range);
    let ground = sweep
        .label
        .iter()
        .filter(|&&label| label == LABEL_GROUND)
        .count();
    let second = if sweep.range2.is_empty() {
        String::new()
    } else {
        format!(
            " + {} second returns",
            grouped(returns(sweep.range2) as u64)
        )
    };
    vec![
        format!("{} ({clock})", utc_text(header.time_ns)),
        format!("{:.0} rpm", header.rpm),
        format!("{} rows × {} columns", sweep.rows(), sweep.columns.len()),
        format!(
            "{} returns{second} ({})",
            grouped(segmented as u64),
            header.return_mode()
        ),
        format!(
            "{:.0} % ground",
            100.0 * ground as f64 / segmented.max(1) as f64
        ),
        format!("{} segments", grouped(sweep.segments.len() as u64)),
    ]
}

fn returns(ranges: &[f32]) -> usize {
    ranges.iter().filter(|&&range| is_return(range)).count()
}

/// Warnings, where the sweep is not a whole turn at a steady speed.
fn warnings(sweep: SweepRef<'_>) -> Vec<String> {
    let words = [
        (flags::PARTIAL, "partial sweep"),
        (flags::REVERSED, "turning counter-clockwise"),
        (flags::BLANKED, "a sector is left out"),
        (flags::RATE_UNSTABLE, "speed unsteady"),
        (flags::STOPPED, "head stands still"),
    ];
    let mut warnings: Vec<String> = words
        .into_iter()
        .filter(|&(flag, _)| sweep.header.has(flag))
        .map(|(_, words)| words.to_owned())
        .collect();
    let columns = sweep.columns;
    let lost = columns.iter().filter(|column| column.is_missing()).count();
    if lost > 0 {
        let lost = grouped(lost as u64);
        let columns = grouped(columns.len() as u64);
        warnings.push(format!("{lost} of {columns} columns lost"));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;

    #[test]
    fn facts_by_hand() {
        let mut scene = Scene::new(&[0.1, -0.1], 3, false);
        scene.fill(|sweep| {
            sweep.header.time_ns = 1_714_566_896_789_999_999;
            sweep.header.rpm = 599.7;
            sweep.range[..4].fill(1.0);
            sweep.label[0] = LABEL_GROUND;
        });
        scene.lose(2..3);
        scene.fill(|sweep| sweep.header.flags = flags::PARTIAL);
        let facts = facts(scene.sweep()).join("|");
        let expected = "2024-05-01 12:34:56.789 UTC (host clock)|600 rpm|2 rows × 3 columns|\
                        4 returns (strongest)|25 % ground|0 segments";
        assert_eq!(facts, expected);
        assert_eq!(
            warnings(scene.sweep()),
            ["partial sweep", "1 of 3 columns lost"]
        );
    }
}
