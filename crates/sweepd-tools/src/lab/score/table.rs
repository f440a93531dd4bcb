//! Scores as people read them.

use std::fmt::Write as _;

use sweepd::text::count_of;
use sweepd_lab::score::{Group, Row, ScanScore, Summary};

/// All figures, one a line.
pub(super) fn figures(summary: &Summary) -> String {
    let mut text = heading(summary);
    text += "mean and std over the scans; sequences: mean of the means of the sequences; pooled: all instances together\n";
    for rows in summary.rows.chunk_by(|one, next| one.group == next.group) {
        let _ = writeln!(
            text,
            "\n{:<28}{:>9}{:>9}{:>11}{:>9}",
            title(rows[0].group),
            "mean",
            "std",
            "sequences",
            "pooled"
        );
        rows.iter().for_each(|row| line(&mut text, row));
    }
    text
}

/// `18 scans of 6 sequences`
pub(super) fn heading(summary: &Summary) -> String {
    format!(
        "{} of {}\n",
        count_of(summary.scans as u64, "scan"),
        count_of(summary.sequences as u64, "sequence")
    )
}

fn title(group: Group) -> String {
    match group {
        Group::Ground => "ground".to_owned(),
        Group::GroundNoVegetation => "ground, no vegetation".to_owned(),
        Group::GroundPaved => "ground, paved".to_owned(),
        Group::Objects => "objects".to_owned(),
        Group::Instances(points) => format!(
            "instances, {} or more",
            count_of(u64::from(points), "point")
        ),
    }
}

fn line(text: &mut String, row: &Row) {
    // How many there are is counted, what they are like is measured.
    let is_count = matches!(
        row.name,
        "count" | "false_positives" | "objects" | "segments"
    );
    let decimals = if is_count { 1 } else { 4 };
    let pooled = match row.group {
        Group::Instances(_) => number(row.pooled, if is_count { 0 } else { 4 }),
        _ => String::new(),
    };
    let columns = format!(
        "  {:<26}{:>9}{:>9}{:>11}{pooled:>9}",
        row.name.replace('_', " "),
        number(row.mean, decimals),
        number(row.std, decimals),
        number(row.sequence_mean, decimals)
    );
    let _ = writeln!(text, "{}", columns.trim_end());
}

/// A number, or a dash where there is none.
pub(super) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A line for each scan, with the most important figures; empty without scans.
pub(super) fn scans(scans: &[(&str, &ScanScore)]) -> String {
    let Some((_, first)) = scans.first() else {
        return String::new();
    };
    let width = scans
        .iter()
        .map(|(name, _)| name.chars().count())
        .max()
        .unwrap_or(0)
        .max("scan".len());
    let mut text = format!(
        "\n{:<width$}{:>9}{:>8}{:>8}{:>8}",
        "scan", "ground f1", "use", "ose", "cover"
    );
    for counts in &first.instances {
        for (word, width) in [("count", 10), ("found", 10), ("pq", 8)] {
            let _ = write!(text, "{:>width$}", format!("{word} {}", counts.min_points));
        }
    }
    text.push('\n');
    for (name, score) in scans {
        let entropy = &score.entropy;
        let _ = write!(
            text,
            "{name:<width$}{:>9}{:>8.1}{:>8.1}{:>8}",
            number(score.ground.f1, 3),
            entropy.use_,
            entropy.ose,
            number(entropy.cover, 3)
        );
        for counts in &score.instances {
            let found = (counts.count > 0).then(|| counts.found_50 as f64 / counts.count as f64);
            let _ = write!(
                text,
                "{:>10}{:>10}{:>8}",
                counts.count,
                number(found, 3),
                number(counts.panoptic_quality(), 3)
            );
        }
        text.push('\n');
    }
    text
}
