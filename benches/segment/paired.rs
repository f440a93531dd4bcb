//! This commit and an older one on the same images, in alternate turns.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use super::clock::{least, median};
use super::images::{self, Image};

const TURNS: usize = 60;

/// A program that answers as `serve` does.
struct Other {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Other {
    fn start(program: &Path) -> Self {
        let mut child = Command::new(program)
            .arg("serve")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}", program.display()));
        let input = child.stdin.take().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self {
            child,
            input,
            output,
        }
    }

    /// Milliseconds of a whole segmentation, and from the last column to the table.
    fn turn(&mut self, line: &str) -> [f64; 2] {
        writeln!(self.input, "{line}").unwrap();
        let mut answer = String::new();
        self.output.read_line(&mut answer).unwrap();
        let mut numbers = answer
            .split_whitespace()
            .map(|number| number.parse::<f64>().unwrap() * 1e-6);
        std::array::from_fn(|_| numbers.next().expect("two numbers"))
    }

    fn stop(mut self) {
        drop(self.input);
        self.child.wait().unwrap();
    }
}

/// Prints how long this commit takes as against the program that `SWEEPD_BENCH_OTHER` names.
pub fn paired() {
    let Some(other) = std::env::var_os("SWEEPD_BENCH_OTHER") else {
        return;
    };
    println!(
        "\n== Beside {}: least ms of both; ratio of these, and median ratio of single turns",
        other.display()
    );
    let columns = format!("{:>9}{:>9}{:>7}{:>7}", "other", "this", "ratio", "median");
    println!("{:<36}{columns}{columns}, from the last column on", "image");
    let folder = tempfile::tempdir().unwrap();
    let mut other = Other::start(Path::new(&other));
    let mut this = Other::start(&std::env::current_exe().unwrap());
    let real = images::sensors()
        .into_iter()
        .chain(images::scan_of("10/000000"));
    let worst = images::worst(64, 2083).into_iter();
    let all = real
        .map(|image| (image, 0.0))
        .chain(worst.map(|image| (image, images::HEIGHT_M)));
    for (image, height_m) in all {
        let path = folder.path().join(&image.name);
        std::fs::write(&path, image.bytes()).unwrap();
        let line = format!("{height_m} {}", path.display());
        println!("{}", compare(&image, &line, &mut other, &mut this));
    }
    other.stop();
    this.stop();
}

fn compare(image: &Image, line: &str, other: &mut Other, this: &mut Other) -> String {
    let mut others = Vec::new();
    let mut these = Vec::new();
    for turn in 0..=TURNS {
        let times = [other.turn(line), this.turn(line)];
        // The first one takes memory.
        if turn > 0 {
            others.push(times[0]);
            these.push(times[1]);
        }
    }
    let mut line = format!("{:<36}", image.name);
    for part in 0..2 {
        let other_ms = least(others.iter().map(|one| one[part]));
        let this_ms = least(these.iter().map(|one| one[part]));
        let single = these.iter().zip(&others);
        let middle = median(single.map(|(this, other)| this[part] / other[part]));
        let ratio = this_ms / other_ms;
        line += &format!("{other_ms:>9.3}{this_ms:>9.3}{ratio:>7.2}{middle:>7.2}");
    }
    line
}
