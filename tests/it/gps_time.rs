//! Which time of a GPS receiver sweeps have.

use sweepd::sensor::Model;
use sweepd::sweep::layout::TimeSource;
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::EmitterConfig;
use sweepd_lab::simulate::emitter::Emitter;
use sweepd_lab::simulate::fixtures;
use sweepd_lab::simulate::gps::{Clock, ReceiverFault, Reception};
use sweepd_testkit::run::Run;

const SECOND_NS: i64 = 1_000_000_000;
const DAY_NS: i64 = 86_400 * SECOND_NS;

/// A sensor whose receiver has this fault for these seconds, and sends for eight.
fn sensor(model: Model, fault: ReceiverFault, from_s: i64, to_s: i64) -> EmitterConfig {
    let mut config = EmitterConfig::new(model, ReturnMode::Strongest).turns(80.0);
    config.clock = Clock::Gps {
        position_deg: (50.1, 8.7),
        reception: Reception::ALWAYS,
    };
    let span = Reception {
        from_ns: from_s * SECOND_NS,
        to_ns: to_s * SECOND_NS,
    };
    config.receiver_fault = Some((fault, span));
    config
}

/// For each whole sweep, how many seconds its time is from where it should be, and its clock.
fn times(config: &EmitterConfig) -> Vec<(i64, TimeSource)> {
    let scene = fixtures::scene();
    let sent: Vec<_> = Emitter::new(config.clone(), &scene).untold().collect();
    let run = Run::of_datagrams(sent.iter().map(|one| one.datagram()));
    let mut times = Vec::new();
    for (place, sweep) in run.views()[1..].iter().enumerate() {
        let header = sweep.header;
        // The first turn is partial, and begins at the cut.
        let utc_ns = config.start_utc_ns + place as i64 * SECOND_NS / 10;
        let off_s = (header.time_ns - utc_ns) as f64 * 1e-9;
        times.push((off_s.round() as i64, header.time_source()));
    }
    times
}

#[test]
fn a_fault_of_the_receiver_does_not_move_the_time() {
    for (fault, from_s, to_s) in [
        (ReceiverFault::Ahead(3_600 * SECOND_NS), 2, 7),
        (ReceiverFault::Week, 2, 60),
        (ReceiverFault::Week, 0, 60),
        (ReceiverFault::Garbled, 0, 60),
    ] {
        let times = times(&sensor(Model::Vlp16, fault, from_s, to_s));
        assert!(
            times.len() > 75 && times.iter().all(|&time| time == (0, TimeSource::Gps)),
            "{fault:?}: {times:?}"
        );
    }
}

#[test]
fn a_receiver_that_says_nothing_new_or_counts_from_2000_is_no_lock() {
    let frozen = times(&sensor(Model::Vlp16, ReceiverFault::Frozen, 1, 60));
    // The sentence for the first second is complete 0.25 s after it, and repeated for 3 s.
    assert!(
        frozen[..30]
            .iter()
            .all(|&time| time == (0, TimeSource::Gps))
    );
    assert!(
        frozen[36..]
            .iter()
            .all(|&time| time == (0, TimeSource::Host))
    );
    // An HDL-64E has no sentences: it says the time itself.
    for model in [Model::Vlp16, Model::Hdl64eS3] {
        let unset = times(&sensor(model, ReceiverFault::Unset, 0, 60).turns(30.0));
        let is_host = |&(_, source): &(i64, TimeSource)| source == TimeSource::Host;
        assert!(
            !unset.is_empty() && unset.iter().all(is_host),
            "{model}: {unset:?}"
        );
    }
}

#[test]
fn a_host_whose_clock_is_wrong_does_not_make_gps_time_wrong() {
    for ahead_days in [-20_000, -2 * 7_168, -7_168, -3, 3, 5_000] {
        let mut config = sensor(Model::Vlp16, ReceiverFault::Garbled, 60, 61).turns(5.0);
        config.host_ahead_ns = ahead_days * DAY_NS;
        let times = times(&config);
        assert!(
            times.iter().all(|&time| time == (0, TimeSource::Gps)),
            "{ahead_days}: {times:?}"
        );
    }
}
