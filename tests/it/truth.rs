//! What is decoded and labelled, against what the simulator knows about every return it put on the
//! wire.

use std::collections::HashMap;
use std::path::Path;

use sweepd::pipeline::Config;
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, TimeSource, flags};
use sweepd_lab::simulate::fixtures::{self, Fixture};
use sweepd_lab::simulate::gps::{Clock, Reception};
use sweepd_lab::simulate::shape::Vec3;
use sweepd_lab::simulate::{
    Class, EmitterConfig, Faults, PacketTruth, ReturnTruth, SimulatedDatagram,
};
use sweepd_testkit::run::{AT_FAR_M, Placed, Run, range_m, walk_ns};

const HOUR_NS: i64 = 3_600_000_000_000;

/// The truth of the data packets of a capture, in the order of the file.
struct Truth(Vec<PacketTruth>);

impl Truth {
    fn of(sent: &[SimulatedDatagram]) -> Self {
        Self(
            sent.iter()
                .filter_map(|one| one.truth.as_deref().cloned())
                .collect(),
        )
    }

    fn get(&self, placed: &Placed) -> &ReturnTruth {
        let packet = &self.0[placed.found.packet as usize];
        let record = &packet.returns[usize::from(placed.found.block)][placed.record];
        record.as_ref().expect("a return that was never sent")
    }

    /// Returns on the wire, those of packets that came twice counted once.
    fn returns(&self) -> usize {
        let mut packets: HashMap<u64, usize> = HashMap::new();
        for packet in &self.0 {
            packets.insert(
                packet.ordinal,
                packet.returns.iter().flatten().flatten().count(),
            );
        }
        packets.values().sum()
    }
}

/// The largest errors of a run.
#[derive(Debug, Default)]
struct Worst {
    range_m: f64,
    azimuth_deg: f64,
    time_ns: i64,
}

/// How far off an azimuth can be, degrees. A block's own is off by the encoder's jitter and half a
/// hundredth; the rest is what the turning rate, which is a mean over many packets, adds on the way
/// to the shot.
fn azimuth_deg(fixture: &Fixture) -> f64 {
    if fixture.config.encoder.jitter_deg == 0.0 {
        0.006
    } else {
        fixture.config.encoder.jitter_deg + 0.01
    }
}

/// With the unit's calibration from the first packet on, where it has one.
fn calibrated(fixture: &Fixture) -> Config {
    let unit = fixture
        .config
        .model
        .is_hdl64e()
        .then(|| fixture.config.beams().into_owned());
    Config {
        calibration: unit,
        ..Config::default()
    }
}

/// Every return is there once, with the azimuth, the sensor time and (within `range_m`) the range
/// that are true.
fn check(fixture: &Fixture, sent: &[SimulatedDatagram], run: &Run, range_m: f64) {
    let file = fixture.file;
    let truth = Truth::of(sent);
    let (views, returns) = (run.views(), run.returns());
    assert_eq!(returns.len(), truth.returns(), "{file}");
    assert_eq!(run.counts.lost, fixture.faults.lost_packets(), "{file}");
    assert_eq!(
        run.counts.duplicates,
        fixture.faults.duplicated.len() as u64,
        "{file}"
    );
    let start_ns = match fixture.config.clock {
        Clock::Free { hour_ns } => hour_ns,
        Clock::Gps {
            reception: Reception::ALWAYS,
            ..
        } => fixture.config.start_utc_ns.rem_euclid(HOUR_NS),
        // Switched on with the first shot; no fixture is long enough for it to follow the receiver.
        Clock::Gps { .. } => 0,
    };
    let spec = fixture.config.spec;
    let walk_ns = walk_ns(spec, fixture.config.return_mode);
    let (mut worst, mut beside) = (Worst::default(), 0);
    for placed in &returns {
        let (found, truth) = (&placed.found, truth.get(placed));
        let off_deg = (found.azimuth_rad - truth.azimuth_rad).to_degrees();
        let header = views[placed.sweep].header;
        // The sensor's own clock: truncated to a microsecond, so late by nothing and early by less
        // than one; of a VLS-128 only the mean of the rests after its firings is known.
        let early_ns =
            start_ns + truth.time_ns - (header.sensor_time_ns + found.time_ns - header.time_ns);
        assert!(
            (-walk_ns..1_000 + walk_ns).contains(&early_ns),
            "{file}: {early_ns} ns: {found:?} {truth:?}"
        );
        let utc_ns = fixture.config.start_utc_ns + truth.time_ns;
        match header.time_source() {
            TimeSource::Gps => assert_eq!(
                found.time_ns,
                utc_ns - early_ns,
                "{file}: {found:?} {truth:?}"
            ),
            // Late by the least way of a packet to the host.
            TimeSource::Host => {
                let late_ns = found.time_ns + early_ns - utc_ns - fixture.config.host_ahead_ns;
                assert!(
                    (90_000 - walk_ns..250_000).contains(&late_ns),
                    "{file}: {late_ns} ns: {found:?}"
                );
            }
        }
        worst.range_m = worst
            .range_m
            .max((f64::from(found.range_m) - truth.range_m).abs());
        let off_deg = ((off_deg + 180.0).rem_euclid(360.0) - 180.0).abs();
        let at_far = fixture.config.model.is_hdl64e() && AT_FAR_M.contains(&truth.range_m);
        if at_far && off_deg > azimuth_deg(fixture) {
            beside += 1;
        } else {
            worst.azimuth_deg = worst.azimuth_deg.max(off_deg);
        }
        worst.time_ns = worst.time_ns.max(early_ns);
    }
    println!(
        "{file}: {} returns, off by at most {worst:?}; {beside} beside",
        returns.len()
    );
    assert!(
        beside * 1000 <= returns.len(),
        "{file}: {beside} of {}",
        returns.len()
    );
    assert!(
        worst.range_m < range_m && worst.azimuth_deg < azimuth_deg(fixture),
        "{file}: {worst:?}"
    );
}

#[test]
fn the_shipped_captures_decode_to_the_truth() {
    let scene = fixtures::scene();
    for fixture in fixtures::all() {
        let sent: Vec<SimulatedDatagram> = fixture.datagrams(&scene).collect();
        let capture = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("pcap_fixtures")
            .join(fixture.file);
        let run = Run::of_capture_with(calibrated(&fixture), &capture);
        // Noise of 10 mm: of a million returns none should be six of that off, and none is.
        check(&fixture, &sent, &run, 0.06);
    }
}

#[test]
fn without_noise_only_rounding_is_left() {
    let scene = fixtures::scene();
    for mut fixture in fixtures::all() {
        fixture.config.optics.noise_m = 0.0;
        fixture.config.encoder.jitter_deg = 0.0;
        let sent: Vec<SimulatedDatagram> = fixture.datagrams(&scene).collect();
        let run = Run::of_datagrams_with(
            calibrated(&fixture),
            sent.iter().map(SimulatedDatagram::datagram),
        );
        check(&fixture, &sent, &run, range_m(fixture.config.spec));
    }
}

#[test]
fn every_model_gives_back_the_truth_at_every_speed() {
    use sweepd::wire::data::ReturnMode::{Dual, Strongest};
    let scene = fixtures::scene();
    let timings = Model::ALL
        .into_iter()
        .flat_map(|model| model.specs().iter().map(move |&spec| (model, spec)));
    for (model, spec) in timings {
        for mode in if model == Model::Hdl64eS2 {
            &[Strongest][..]
        } else {
            &[Strongest, Dual]
        } {
            for (rpm, jitter_deg) in [
                (300.0, 0.0),
                (300.0, 0.02),
                (600.0, 0.0),
                (842.7, 0.02),
                (1200.0, 0.0),
                (1200.0, 0.02),
            ] {
                let mut config = EmitterConfig::new(model, *mode);
                (config.spec, config.rpm) = (spec, rpm);
                (config.encoder.jitter_deg, config.encoder.start_deg) = (jitter_deg, 300.0);
                config.optics.noise_m = 0.0;
                config = config.turns(0.4);
                let fixture = Fixture {
                    file: "made up",
                    config,
                    faults: Faults::default(),
                };
                let sent: Vec<SimulatedDatagram> = fixture.datagrams(&scene).collect();
                let run = Run::of_datagrams_with(
                    calibrated(&fixture),
                    sent.iter().map(SimulatedDatagram::datagram),
                );
                println!("{model} {mode} {rpm} rpm, jitter {jitter_deg}:");
                check(&fixture, &sent, &run, range_m(spec));
            }
        }
    }
}

/// The foot of a thing may pass for ground up to here, metres: between two beams that meet the
/// ground, a sparse sensor cannot tell a wall's foot from a slope.
const FOOT_M: f64 = 0.4;

/// What the labels are worth, over all whole sweeps of a capture.
#[derive(Debug, Default)]
struct Score {
    /// Ground returns that are labelled so; returns labelled ground; ground returns.
    ground: [usize; 3],
    /// Returns labelled ground that are no ground and higher than a foot.
    high: usize,
    /// Near objects that are a segment of their own, more than half, by class; and all of them.
    found: HashMap<Class, [usize; 2]>,
}

/// An object of the scene in one sweep.
struct Seen {
    class: Class,
    returns: usize,
    range_sum_m: f64,
    segments: HashMap<u32, usize>,
}

fn score(fixture: &Fixture) -> Score {
    let scene = fixtures::scene();
    let sent: Vec<SimulatedDatagram> = fixture.datagrams(&scene).collect();
    let truth = Truth::of(&sent);
    let run = Run::of_datagrams_with(
        calibrated(fixture),
        sent.iter().map(SimulatedDatagram::datagram),
    );
    let (views, returns) = (run.views(), run.returns());
    let mut score = Score::default();
    for sweep in (0..views.len()).filter(|&sweep| !views[sweep].header.has(flags::PARTIAL)) {
        let mut objects: HashMap<u32, Seen> = HashMap::new();
        for placed in returns.iter().filter(|placed| placed.sweep == sweep) {
            let (truth, label) = (truth.get(placed), placed.found.label);
            let (is, said) = (truth.class == Class::Ground, label == LABEL_GROUND);
            score.ground[0] += usize::from(is && said);
            score.ground[1] += usize::from(said);
            score.ground[2] += usize::from(is);
            let place = fixture.config.pose.origin + Vec3::from(placed.found.point_m);
            score.high += usize::from(said && !is && scene.levelled(place).z > FOOT_M);
            let new = Seen {
                class: truth.class,
                returns: 0,
                range_sum_m: 0.0,
                segments: HashMap::new(),
            };
            let seen = objects.entry(truth.object).or_insert(new);
            seen.returns += 1;
            seen.range_sum_m += truth.range_m;
            if label >= LABEL_FIRST_SEGMENT {
                *seen.segments.entry(label).or_default() += 1;
            }
        }
        for seen in objects.values().filter(|seen| seen.counts()) {
            let [found, all] = score.found.entry(seen.class).or_default();
            *found += usize::from(seen.best_iou(&views[sweep]) > 0.5);
            *all += 1;
        }
    }
    score
}

impl Seen {
    /// Whether the object is one that a robot on this street must see: near, and met by enough
    /// beams.
    fn counts(&self) -> bool {
        let kind = matches!(self.class, Class::Car | Class::Person | Class::Pole);
        kind && self.returns >= 20 && self.range_sum_m / (self.returns as f64) < 20.0
    }

    /// Intersection over union with the segment that has most of it.
    fn best_iou(&self, sweep: &SweepRef<'_>) -> f64 {
        let iou = |(&label, &shared): (&u32, &usize)| {
            let segment = sweep
                .segments
                .iter()
                .find(|segment| segment.label == label)
                .unwrap();
            shared as f64 / (self.returns + segment.points as usize - shared) as f64
        };
        self.segments.iter().map(iou).fold(0.0, f64::max)
    }
}

#[test]
fn labels_are_true() {
    // Ground precision and recall, share of the ground labels up to a foot's height, near objects
    // found: all a little worse than measured, to catch what makes them worse.
    for (file, precision, recall, low, objects) in [
        ("street_vlp16.pcap.gz", 0.97, 0.98, 0.99, 96),
        ("street_hdl32e.pcap.gz", 0.99, 0.99, 0.99, 89),
        ("street_hdl64e_s2.pcap.gz", 0.98, 0.99, 0.99, 275),
    ] {
        let fixture = fixtures::all()
            .into_iter()
            .find(|fixture| fixture.file == file)
            .unwrap();
        let score = score(&fixture);
        let [both, said, is] = score.ground.map(|count| count as f64);
        let found = [both / said, both / is, 1.0 - score.high as f64 / said];
        let [hits, all] = score
            .found
            .values()
            .fold([0, 0], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
        let told = format!(
            "{file}: precision, recall, low {found:.4?}; {hits} of {all} near objects; {score:?}"
        );
        println!("{told}");
        assert!(
            found[0] > precision && found[1] > recall && found[2] > low && hits >= objects,
            "{told}"
        );
    }
}
