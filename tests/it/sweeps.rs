//! Sweeps of real captures against facts that were taken from their bytes by other means
//! (shared/data/README.md).

use sweepd::pipeline::{Config, Fault};
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::layout::{TimeSource, flags};
use sweepd::sweep::{Column, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, SimulatedDatagram, fixtures};
use sweepd_testkit::{
    due,
    raw::{self, RawPacket},
    run::{Run, Runner},
};

/// Every capture of a supported model, and the speed of its head, turns a minute.
const CAPTURES: [(&str, Model, f64); 8] = [
    ("hdl32e_mrpt-sample", Model::Hdl32e, 542.3),
    ("hdl32e_veloview-monterey-a", Model::Hdl32e, 706.5),
    ("vlp16_einride-a", Model::Vlp16, 600.0),
    // One packet: its twelve azimuths, a hundredth of a degree each, tell the speed to one in four
    // hundred.
    ("vlp16_gadomski-single", Model::Vlp16, 600.0),
    ("vlp16_mrpt-gps", Model::Vlp16, 599.1),
    ("vlp16_rlu-velodyne-example", Model::Vlp16, 600.3),
    ("vlp16_timm-dual-a", Model::Vlp16, 299.9),
    // Its product byte is the HDL-32E's; only the time between its packets tells the truth.
    ("vlp16_veloview-90deg-a", Model::Vlp16, 1198.3),
];

/// Non-zero returns between azimuth wraps. A block of the second holds azimuth 36000, which is 0
/// and begins a sweep.
const HDL32E_RETURNS: [(&str, &[u32]); 2] = [
    ("hdl32e_mrpt-sample", &[23_216, 57_734, 57_882, 7_873]),
    (
        "hdl32e_veloview-monterey-a",
        &[
            27_649, 49_426, 49_485, 49_543, 49_523, 49_598, 49_684, 49_673, 49_737, 26_731,
        ],
    ),
];

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn hdl32e_sweeps_have_the_returns_between_the_wraps() {
    let data = sweepd_testkit::data_dir();
    for (name, expected) in HDL32E_RETURNS {
        let run = Run::of_capture(&data.join(format!("pcap/{name}.pcap")));
        let views = run.views();
        let returns: Vec<u32> = views.iter().map(|sweep| sweep.header.returns).collect();
        assert_eq!(returns, expected, "{name}");
        for (index, sweep) in views.iter().enumerate() {
            let outer = index == 0 || index + 1 == views.len();
            assert_eq!(
                sweep.header.has(flags::PARTIAL),
                outer,
                "{name}, sweep {index}"
            );
            assert_eq!(
                sweep.header.has(flags::CIRCULAR),
                !outer,
                "{name}, sweep {index}"
            );
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn every_return_of_a_capture_is_in_one_sweep_as_it_stands_on_the_wire() {
    let data = sweepd_testkit::data_dir();
    for (name, model, _) in CAPTURES {
        let capture = data.join(format!("pcap/{name}.pcap"));
        let packets = raw::packets(&capture);
        let run = Run::of_capture(&capture);
        assert_eq!(run.detection.model, model, "{name}");
        let on_the_wire: u32 = packets.iter().map(RawPacket::returns).sum();
        let counted: u32 = run.views().iter().map(|sweep| sweep.header.returns).sum();
        let returns = run.returns();
        assert_eq!(
            (counted, returns.len()),
            (on_the_wire, on_the_wire as usize),
            "{name}"
        );
        let mut seen = vec![[[false; raw::RECORDS]; raw::BLOCKS]; packets.len()];
        for placed in returns {
            let (packet, block) = (
                placed.found.packet as usize,
                usize::from(placed.found.block),
            );
            let (distance, reflectivity) = packets[packet].record(block, placed.record);
            assert_eq!(
                (placed.found.range_m, placed.found.reflectivity),
                (f32::from(distance) * 0.002, reflectivity)
            );
            let seen = &mut seen[packet][block][placed.record];
            assert!(
                !std::mem::replace(seen, true),
                "{name}: a return is there twice"
            );
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_speed_is_that_of_azimuth_over_sensor_time() {
    let data = sweepd_testkit::data_dir();
    for (name, _, rpm) in CAPTURES {
        let run = Run::of_capture(&data.join(format!("pcap/{name}.pcap")));
        let (mut turns, mut time) = (0.0, 0.0);
        for sweep in run.views() {
            let duration = sweep.header.duration_ns as f64;
            turns += f64::from(sweep.header.rpm) * duration;
            time += duration;
        }
        assert!(
            (turns / time / rpm - 1.0).abs() < 0.001,
            "{name}: {} rpm",
            turns / time
        );
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn lost_packets_leave_their_columns_and_the_rest_stays_in_place() {
    let data = sweepd_testkit::data_dir();
    let run = Run::of_capture(&data.join("pcap/vlp16_timm-dual-a.pcap"));
    let views = run.views();
    assert_eq!(run.counts.lost, 21);
    assert_eq!(
        views
            .iter()
            .map(|sweep| sweep.header.lost_packets)
            .sum::<u32>(),
        21
    );
    // A packet of dual returns holds twelve firings.
    assert_eq!(
        views
            .iter()
            .map(|sweep| sweep.header.missing_columns)
            .sum::<u32>(),
        21 * 12
    );
    let columns: Vec<&Column> = views.iter().flat_map(|sweep| sweep.columns).collect();
    assert_eq!(
        columns.iter().filter(|column| column.is_missing()).count(),
        21 * 12
    );
    let gaps = columns
        .windows(2)
        .filter(|two| !two[0].is_missing() && two[1].is_missing())
        .count();
    assert_eq!(gaps, 7);
    // 299.9 rpm times 55.296 us.
    let pitch_deg = 299.9 * 6.0 * 55.296e-6;
    for two in columns.windows(2) {
        let step_deg = f64::from(two[1].azimuth_rad - two[0].azimuth_rad)
            .to_degrees()
            .rem_euclid(360.0);
        assert!((step_deg - pitch_deg).abs() < 0.1, "{step_deg}: {two:?}");
    }
    for sweep in &views {
        for (column, _) in sweep
            .columns
            .iter()
            .enumerate()
            .filter(|(_, column)| column.is_missing())
        {
            assert!((0..sweep.rows()).all(|row| sweep.pixel(row, column) == [None; 2]));
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn dual_returns_keep_both_where_they_are_equal() {
    let data = sweepd_testkit::data_dir();
    let run = Run::of_capture(&data.join("pcap/vlp16_timm-dual-a.pcap"));
    let equal = |sweep: &SweepRef<'_>| {
        let pixels = 0..sweep.range.len();
        let same = |i: usize| {
            (sweep.range[i], sweep.reflectivity[i]) == (sweep.range2[i], sweep.reflectivity2[i])
        };
        pixels.filter(|&i| sweep.range[i] > 0.0 && same(i)).count()
    };
    assert_eq!(run.views().iter().map(equal).sum::<usize>(), 150_065);
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn time_is_utc_where_gps_is_locked() {
    let data = sweepd_testkit::data_dir();
    let run = Run::of_capture(&data.join("pcap/vlp16_mrpt-gps.pcap"));
    // 2016-01-21 08:18:02.340595 UTC: stamp of the first packet, hour of the sentence.
    assert_eq!(run.views()[0].header.time_ns, 1_453_364_282_340_595_000);
    assert!(
        run.views()
            .iter()
            .all(|sweep| sweep.header.time_source() == TimeSource::Gps)
    );
}

/// A real HDL-32E whose receiver has a fix, and which has no byte for the pulse.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn time_is_utc_without_a_reported_pulse_where_that_is_allowed() {
    let data = sweepd_testkit::data_dir();
    let capture = data.join("pcap/hdl32e_veloview-monterey-a.pcap");
    let run = |gps_without_pps| {
        Run::of_capture_with(
            Config {
                gps_without_pps,
                ..Config::default()
            },
            &capture,
        )
    };
    let (host, gps) = (run(false), run(true));
    assert!(
        host.views()
            .iter()
            .all(|sweep| sweep.header.time_source() == TimeSource::Host)
    );
    let (host, gps) = (host.views(), gps.views());
    assert_eq!(host.len(), gps.len());
    // The sentence says 2012-12-11 22:06:32, the stamp of the first packet 6 min 33.203883 s.
    let utc_ns = 1_355_263_593_203_883_000;
    assert!(
        (gps[0].header.time_ns - utc_ns).abs() < 600_000,
        "{}",
        gps[0].header.time_ns
    );
    for (host, gps) in host.iter().zip(&gps) {
        assert_eq!(gps.header.time_source(), TimeSource::Gps);
        // The clock of this capture's host is 0.9 s ahead of the sensor's.
        let ahead_ns = host.header.time_ns - gps.header.time_ns;
        assert!((900_000_000..940_000_000).contains(&ahead_ns), "{ahead_ns}");
        assert_eq!(
            host.range.iter().map(|m| m.to_bits()).collect::<Vec<_>>(),
            gps.range.iter().map(|m| m.to_bits()).collect::<Vec<_>>()
        );
    }
}

/// The firings of the block that says 36000 are the first of a sweep.
fn whole_turn_begins_a_sweep(packets: &[RawPacket], run: &Run, firings: usize) {
    let blocks =
        (0..packets.len()).flat_map(|packet| (0..raw::BLOCKS).map(move |block| (packet, block)));
    let whole_turns: Vec<(usize, usize)> = blocks
        .filter(|&(packet, block)| packets[packet].azimuth_cdeg(block) == 36_000)
        .collect();
    assert!(!whole_turns.is_empty());
    for (packet, block) in whole_turns {
        let is_it =
            |column: &&Column| (column.packet, usize::from(column.block)) == (packet as u64, block);
        let (mut found, mut at_start) = (0, 0);
        for sweep in run.views() {
            found += sweep.columns.iter().filter(is_it).count();
            at_start += sweep.columns.iter().take_while(is_it).count();
        }
        assert_eq!(
            (found, at_start),
            (firings, firings),
            "packet {packet}, block {block}"
        );
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn azimuth_36000_begins_a_sweep() {
    let scene = fixtures::scene();
    let fixture = fixtures::all()
        .into_iter()
        .find(|fixture| fixture.file == "street_vlp16.pcap.gz")
        .unwrap();
    let sent: Vec<SimulatedDatagram> = fixture.datagrams(&scene).collect();
    let data = sent.iter().filter(|one| one.truth.is_some());
    let packets: Vec<RawPacket> = data.map(|one| RawPacket::new(&one.payload)).collect();
    let run = Run::of_datagrams(sent.iter().map(SimulatedDatagram::datagram));
    whole_turn_begins_a_sweep(&packets, &run, 2);

    // A real one: packet 857, block 4.
    let data = sweepd_testkit::data_dir();
    let capture = data.join("pcap/hdl32e_veloview-monterey-a.pcap");
    whole_turn_begins_a_sweep(&raw::packets(&capture), &Run::of_capture(&capture), 1);
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn models_that_are_not_supported_are_a_fault_and_no_sweep() {
    let scene = fixtures::scene();
    // A VLP-32A or VLP-32B, and a VLS-128 with three returns.
    for (product, name) in [(0x23, "VLP-32A"), (0xA1, "three returns")] {
        let config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(1.2);
        let mut runner = Runner::new(Config::default());
        let mut faults = Vec::new();
        for mut one in Emitter::new(config, &scene).filter(|one| one.truth.is_some()) {
            one.payload[1205] = product;
            if product == 0xA1 {
                one.payload[1204] = 0x3A;
                for block in 0..12 {
                    one.payload[100 * block + 1] = [0xEE, 0xDD, 0xCC, 0xBB][block / 3];
                }
            }
            faults.extend(runner.push(&one.datagram()).err());
        }
        assert_eq!(faults.len(), 1, "{name}");
        assert!(
            matches!(faults[0], Fault::Model(_)) && faults[0].to_string().contains(name),
            "{faults:?}"
        );
        assert!(runner.end().is_ok() && runner.sweeps.is_empty());
    }
}

#[test]
fn corrupt_packets_at_the_start_do_not_refuse_a_sensor() {
    let scene = fixtures::scene();
    let config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(1.2);
    let mut sent: Vec<_> = Emitter::new(config, &scene)
        .filter(|one| one.truth.is_some())
        .collect();
    // Another sensor's product byte, and the lower head of an HDL-64E.
    sent[0].payload[1205] = 0xA1;
    sent[1].payload[100] = 0xFF;
    sent[1].payload[101] = 0xDD;
    let mut runner = Runner::new(Config::default());
    for one in &sent {
        runner.push(&one.datagram()).unwrap();
    }
    runner.end().unwrap();
    assert!(runner.sweeps.len() >= 2);
    // Three in a row are no accident.
    for one in &mut sent {
        one.payload[1205] = 0xA1;
    }
    let mut runner = Runner::new(Config::default());
    let faults = sent
        .iter()
        .filter_map(|one| runner.push(&one.datagram()).err())
        .count();
    assert_eq!((faults, runner.sweeps.len()), (1, 0));
}

/// The height of one sensor is that of many sweeps: the one that takes its place, and may sit
/// elsewhere, has none of them.
#[test]
fn a_sensor_that_is_exchanged_is_seen_at_its_own_height() {
    let scene = fixtures::scene();
    let stream = |model, height_m, start_ns| {
        let mut config = EmitterConfig::new(model, ReturnMode::Strongest).turns(4.0);
        config.pose.origin.z = height_m;
        config.start_utc_ns += start_ns;
        Emitter::new(config, &scene)
            .filter(|one| one.truth.is_some())
            .collect::<Vec<_>>()
    };
    let sent = [
        stream(Model::Vlp16, 1.9, 0),
        stream(Model::Hdl32e, 1.2, 400_000_000),
    ]
    .concat();
    let run = Run::of_datagrams(sent.iter().map(SimulatedDatagram::datagram));
    let mut seen = [0; 2];
    for sweep in run.views() {
        let (own, height_m) = if sweep.rows() == 16 {
            (0, 1.9)
        } else {
            (1, 1.2)
        };
        // A piece of a turn may be too short to show it.
        if sweep.header.has(flags::CIRCULAR) {
            seen[own] += 1;
            assert!(sweep.header.has(flags::HEIGHT_ESTIMATED));
            let found_m = sweep.header.height_m;
            assert!(
                (found_m - height_m).abs() < 0.1,
                "{} rows at {height_m} m: {found_m} m",
                sweep.rows()
            );
        }
    }
    assert!(seen[0] >= 3 && seen[1] >= 2, "{seen:?}");
}

/// Whoever fetches packets sleeps until then: a sweep that is expected too late comes too late.
#[test]
fn the_packet_that_completes_a_sweep_is_expected_when_it_comes_or_one_before() {
    let scene = fixtures::scene();
    for (model, mode, rpm) in [
        (Model::Vlp16, ReturnMode::Strongest, 600.0),
        (Model::Vlp16, ReturnMode::Dual, 1200.0),
        (Model::Hdl32e, ReturnMode::Strongest, 600.0),
        (Model::Hdl64eS3, ReturnMode::Dual, 300.0),
        (Model::Vlp32c, ReturnMode::Strongest, 600.0),
        (Model::Vls128, ReturnMode::Dual, 1200.0),
    ] {
        let emitted = EmitterConfig {
            rpm,
            ..EmitterConfig::new(model, mode)
        }
        .turns(4.0);
        let period_ns = i64::from(model.spec().packet_period_ns(mode));
        let config = Config {
            calibration: Some(emitted.beams().into_owned()),
            ..Config::default()
        };
        let data = Emitter::new(emitted, &scene).filter(|one| one.truth.is_some());
        let late_ns = due::late_ns(config, data.map(|one| (one.payload, one.arrival_ns))).concat();
        // However long the newest one took through the network: some tenths of a millisecond at
        // times.
        // A cut that is no more than 0.15 ms past the end of a packet may be in it.
        let early_ns = 150_000_u64.div_ceil(period_ns as u64) as i64 * period_ns;
        let expected_ns = -20_000..early_ns + 30_000;
        assert!(
            late_ns.iter().all(|ns| expected_ns.contains(ns)),
            "{model} {mode}: {late_ns:?} ns late"
        );
        // One before where the cut is no more than 0.15 ms past its end: of three cuts, that is one
        // of a VLP-16's.
        let on_time = late_ns.iter().filter(|&&ns| ns < 200_000).count();
        assert!(
            2 * on_time > late_ns.len(),
            "{model} {mode}: {on_time} of {}",
            late_ns.len()
        );
        assert!(late_ns.len() > 200, "{model} {mode}: {}", late_ns.len());
    }
}
