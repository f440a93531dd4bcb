//! Sweeps are segmented while the head still turns: the result must be that of the whole sweep, on
//! every machine.

use std::path::{Path, PathBuf};

use sweepd::assemble::levels;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::pipeline::Config;
use sweepd::segment::{self, Mount, Segmenter};
use sweepd::sweep::layout::flags;
use sweepd::sweep::{SweepMut, SweepRef};
use sweepd_lab::twin;
use sweepd_testkit::{data_dir_if_any, run::Runner};

fn captures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pcap_fixtures");
    let of_name = |name: &str| folder.join(format!("street_{name}"));
    let mut captures: Vec<PathBuf> = [
        "vlp16.pcap.gz",
        "hdl32e_dual.pcap.gz",
        "hdl64e_s3.pcap.gz",
        "vlp16_losses.pcap",
    ]
    .map(of_name)
    .to_vec();
    if let Some(data) = data_dir_if_any() {
        captures.extend(
            ["hdl32e_veloview-monterey-a.pcap", "vlp16_einride-a.pcap"]
                .map(|name| data.join("pcap").join(name)),
        );
    }
    captures
}

/// What a segmenter writes into a sweep, without the rest.
fn written(sweep: &SweepRef<'_>) -> (Vec<u32>, Vec<u32>, Vec<u8>, [u32; 2]) {
    let segments = sweep
        .segments
        .iter()
        .flat_map(|segment| zerocopy::IntoBytes::as_bytes(segment).to_vec())
        .collect();
    (
        sweep.label.to_vec(),
        sweep.label2.to_vec(),
        segments,
        [sweep.header.ground, sweep.header.segments],
    )
}

#[test]
fn a_sweep_taken_early_is_labelled_as_a_whole_one_is() {
    let (mut circular, mut others) = (0, 0);
    let captures = captures();
    for capture in &captures {
        let mut runner = Runner::new(Config::default());
        runner.play(capture).unwrap();
        for buffer in &runner.sweeps {
            let early = SweepRef::open(buffer.as_ref()).unwrap();
            if early.header.has(flags::CIRCULAR) {
                circular += 1
            } else {
                others += 1
            }
            let height_m = Some(early.header.height_m).filter(|height_m| *height_m > 0.0);
            let Some(height_m) = height_m else { continue };
            let mount = Mount {
                height_m: Some(height_m),
                ..Mount::default()
            };
            let config = segment::Config {
                mount,
                ..segment::Config::default()
            };
            for level in levels() {
                let mut copy = HeapBuffers::default().take(buffer.as_ref().len());
                copy.as_mut().copy_from_slice(buffer.as_ref());
                let mut sweep = SweepMut::open(copy.as_mut()).unwrap();
                sweep.label.fill(0xDEAD);
                sweep.label2.fill(0xDEAD);
                Segmenter::with_level(config.clone(), level)
                    .unwrap()
                    .segment(&mut sweep);
                let same = written(&sweep.as_ref()) == written(&early);
                assert!(
                    same,
                    "{}, sweep {}, {level:?}",
                    capture.display(),
                    early.header.sequence
                );
            }
        }
        let last = SweepRef::open(runner.sweeps.last().unwrap().as_ref()).unwrap();
        let mount = Mount {
            height_m: Some(last.header.height_m),
            ..Mount::default()
        };
        let config = segment::Config {
            mount,
            ..segment::Config::default()
        };
        let naive = twin::segment(
            &last,
            &config,
            Some(last.header.height_m).filter(|height_m| *height_m > 0.0),
        );
        assert!(
            naive == last.label,
            "{}: the naive twin says otherwise",
            capture.display()
        );
    }
    // The four fixtures have this many; a real capture has one whole turn at least.
    assert!(
        circular >= 10 + captures.len() - 4 && others >= 7,
        "{circular} {others}"
    );
}
