//! Of the 25 pains of users of other drivers (docs/promises.md), those that no other test shows to
//! be absent.

use std::collections::BTreeSet;
use sweepd_testkit::stream;

use sweepd::sensor::Model;
use sweepd::sweep::layout::flags::CIRCULAR;
use sweepd::wire::data::{BLOCKS, ReturnMode};
use sweepd_testkit::stream::{Run, Spin, config};

/// The block in which the azimuth wraps, of each packet that has one: 0 where it is less than the
/// last of the packet before.
fn wraps(sent: &[stream::Sent]) -> BTreeSet<usize> {
    let azimuths: Vec<u16> = sent
        .iter()
        .flat_map(|one| one.packet.blocks.iter().map(|block| block.azimuth_cdeg()))
        .collect();
    (1..azimuths.len())
        .filter(|&at| azimuths[at] < azimuths[at - 1])
        .map(|at| at % BLOCKS)
        .collect()
}

/// Pains 1, 3 and 6: a packet of the next turn in this one, a warning and a dropped block where the
/// wrap falls in block 0, a gap that flickers. Wherever in its packet the wrap falls, a turn is cut
/// there, and every return is in one pixel.
#[test]
fn the_wrap_may_fall_in_any_block_of_a_packet() {
    for model in [Model::Vlp16, Model::Hdl32e] {
        let sent = Spin {
            start_cdeg: 18_000.0,
            ..Spin::new(model, ReturnMode::Strongest, 617.0)
        }
        .packets(3.5);
        assert_eq!(
            wraps(&sent).len(),
            BLOCKS,
            "{model}: the wrap falls in every block"
        );
        let run = Run::of(config(), &sent);
        run.check_sent(&sent);
        // From half a turn on 36.0 turns: 36 crossings of 0.
        assert_eq!((run.sweeps.len(), run.counts.lost), (37, 0), "{model}");
        let whole = &run.views()[1..36];
        assert!(
            whole.iter().all(|sweep| sweep.header.flags == CIRCULAR),
            "{model}"
        );
        let columns: BTreeSet<u32> = whole.iter().map(|sweep| sweep.header.columns).collect();
        assert!(
            columns.len() <= 3 && columns.last().unwrap() - columns.first().unwrap() <= 2,
            "{model}: {columns:?}"
        );
        // A sweep begins behind the cut and ends before it, to a firing.
        for sweep in whole {
            let [first, last] = [sweep.columns[0], sweep.columns[sweep.columns.len() - 1]]
                .map(|one| one.azimuth_rad);
            let pitch = std::f32::consts::TAU / sweep.columns.len() as f32;
            assert!(
                first < 1.5 * pitch && last > std::f32::consts::TAU - 1.5 * pitch,
                "{model}: {first} to {last}"
            );
        }
    }
}
