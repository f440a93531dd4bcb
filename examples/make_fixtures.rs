//! Makes the captures in `pcap_fixtures/` and prints the table of their README.
//!
//! ```text
//! cargo run --release --example make_fixtures -- pcap_fixtures
//! ```

use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

use flate2::{Compression, GzBuilder};
use sweepd::input::write::{Addressed, PcapWriter};
use sweepd_lab::simulate::Scene;
use sweepd_lab::simulate::fixtures::{self, Counts, Fixture};

fn main() -> Result<()> {
    let folder = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "pcap_fixtures".to_owned());
    let scene = fixtures::scene();
    for fixture in fixtures::all() {
        let counts = make(&fixture, &scene, Path::new(&folder))?;
        println!("{}", fixture.readme_row(&counts));
    }
    Ok(())
}

fn make(fixture: &Fixture, scene: &Scene, folder: &Path) -> Result<Counts> {
    let file = BufWriter::new(File::create(folder.join(fixture.file))?);
    if !fixture.file.ends_with(".gz") {
        return write(fixture, scene, file);
    }
    // No time of making in the header: the same scene gives the same file.
    let mut gzip = GzBuilder::new().mtime(0).write(file, Compression::best());
    let counts = write(fixture, scene, &mut gzip)?;
    gzip.finish()?.flush()?;
    Ok(counts)
}

fn write(fixture: &Fixture, scene: &Scene, out: impl Write) -> Result<Counts> {
    let mut capture = PcapWriter::new(out)?;
    let mut counts = Counts::default();
    for one in fixture.datagrams(scene) {
        counts.add(&one);
        capture.write(&Addressed {
            arrival_ns: one.arrival_ns,
            source: one.source,
            destination: one.destination,
            payload: &one.payload,
        })?;
    }
    capture.finish()?.flush()?;
    Ok(counts.with(&fixture.faults))
}
