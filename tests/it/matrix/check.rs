//! A stream through admission and pipeline, and its sweeps against the truth.

use std::collections::{BTreeSet, HashMap};
use std::f64::consts::{PI, TAU};

use sweepd::admission::{DiscoveredSensors, Refusal, Refused, Route};
use sweepd::pipeline::{Config, Counts, Notice};
use sweepd::sensor::{Model, ModelExt};
use sweepd::sweep::layout::flags::*;
use sweepd::sweep::{Column, SweepRef};
use sweepd_lab::simulate::{Damage, PacketPart, PacketTruth};

use super::stream::{Made, Promise, Told};
use super::table::Row;
use sweepd_testkit::run::{AT_FAR_M, Placed, Run, Runner, range_m, walk_ns};

/// Flags that tell of a fault.
const FAULTS: u32 = PARTIAL | BLANKED | RATE_UNSTABLE | STOPPED;

/// What the sweeps of a stream are held against.
struct Check<'a> {
    made: &'a Made,
    /// The truth of each data packet that got in, by its number.
    truth: Vec<&'a PacketTruth>,
    /// What is wrong with packets, by ordinal.
    damage: HashMap<u64, Damage>,
    views: Vec<SweepRef<'a>>,
    row: Row,
}

/// Runs a stream and fills in its row.
pub fn check(made: &Made, row: Row) -> Row {
    let calibration = (made.config.model.is_hdl64e() && !made.promise.learns)
        .then(|| made.config.beams().into_owned());
    let mut runner = Runner::with_listener(Config {
        calibration,
        ..Config::default()
    });
    let (mut sensors, mut truth) = (DiscoveredSensors::new(Vec::new()), Vec::new());
    for one in &made.sent {
        let datagram = one.datagram();
        match sensors.admit(&datagram) {
            Err(Refused { sensor: None, .. }) => continue,
            Ok((Route::Data(_), _)) | Err(_) => {
                truth.push(one.truth.as_deref().expect("a data packet has its truth"))
            }
            Ok((Route::Position(_), _)) => {}
        }
        runner.push(&datagram).unwrap();
    }
    runner.end().unwrap();
    let notices = runner.notices();
    let is_contradicted = notices
        .iter()
        .any(|notice| matches!(notice, Notice::OtherCalibration { .. }));
    let tally = runner.tally();
    let run = runner.finish();
    let damage = made.faults.corrupted.iter().copied().collect();
    let mut check = Check {
        made,
        truth,
        damage,
        views: run.views(),
        row,
    };
    check.row.injected = made.injected;
    check.row.objects = tally.early + tally.around_cut;
    check.row.with_sweep = tally.with_sweep;
    check.returns(&run);
    // Its beams may be wrong until the next dump tells another thing; then people are told.
    if !made.promise.has_checksum && is_contradicted {
        check.row.red.clear();
    }
    let decoded = check.decoded();
    check.counters(
        &run.counts,
        sensors.refusals().get(Refusal::Length),
        &decoded,
    );
    check.sweeps();
    check.recovery();
    check.row
}

impl<'a> Check<'a> {
    fn expect(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds && self.row.red.len() < 6 {
            self.row.red.push(what());
        }
    }

    fn promise(&self) -> &'a Promise {
        &self.made.promise
    }

    /// Every return lies where it was, and every packet is decoded whole or not at all.
    fn returns(&mut self, run: &Run) {
        let mut found = vec![0_usize; self.truth.len()];
        let (mut beside, mut no_truth, mut slowest_ns, mut fastest_ns) = (0, 0, i64::MIN, i64::MAX);
        let elevations = self.elevations();
        let mut is_elsewhere = 0;
        run.each_return(|placed| {
            let packet = placed.found.packet as usize;
            found[packet] += 1;
            let (truth, is_struck) = (self.truth[packet], self.is_struck(&placed));
            let Some(truth) = &truth.returns[usize::from(placed.found.block)][placed.record] else {
                no_truth += usize::from(!is_struck);
                return;
            };
            let beam = &self.views[placed.sweep].beams[placed.found.row];
            let is_own = beam.channel as usize == placed.found.channel;
            is_elsewhere += usize::from(
                !is_own || beam.elevation_rad != elevations[placed.sweep][placed.found.channel],
            );
            let header = self.views[placed.sweep].header;
            let off_ns =
                header.sensor_time_ns + placed.found.time_ns - header.time_ns - truth.time_ns;
            (slowest_ns, fastest_ns) = (slowest_ns.max(off_ns), fastest_ns.min(off_ns));
            if is_struck {
                return;
            }
            self.row.returns += 1;
            let range_mm = (f64::from(placed.found.range_m) - truth.range_m).abs() * 1e3;
            self.row.range_mm = self.row.range_mm.max(range_mm);
            let off_deg = shortest(placed.found.azimuth_rad - truth.azimuth_rad)
                .abs()
                .to_degrees();
            let at_far = self.made.config.model.is_hdl64e() && AT_FAR_M.contains(&truth.range_m);
            if at_far && off_deg > self.made.promise.azimuth_deg {
                beside += 1;
            } else {
                self.row.azimuth_deg = self.row.azimuth_deg.max(off_deg);
            }
        });
        let Row {
            returns,
            range_mm,
            azimuth_deg,
            ..
        } = self.row;
        let (promise, config) = (self.promise(), &self.made.config);
        let most_mm = range_m(config.spec) * 1e3 + promise.range_mm;
        let modes = [config.mode_of(0), config.mode_of(u64::MAX)];
        let walk_ns = modes.map(|mode| walk_ns(config.spec, mode));
        let most_ns = promise
            .time_ns
            .map(|most_ns| most_ns + 2 * walk_ns[0].max(walk_ns[1]));
        self.expect(returns > 0, || "nothing was published".to_owned());
        self.expect(no_truth == 0, || {
            format!("{no_truth} returns that were never sent")
        });
        self.expect(is_elsewhere == 0, || {
            format!("{is_elsewhere} returns of other beams")
        });
        self.expect(range_mm < most_mm, || {
            format!("ranges off by {range_mm:.2} mm")
        });
        self.expect(azimuth_deg < promise.azimuth_deg, || {
            format!("azimuths off by {azimuth_deg:.3} degrees")
        });
        self.expect(beside * 1000 <= returns, || {
            format!("{beside} of {returns} beside")
        });
        let spread_ns = slowest_ns.saturating_sub(fastest_ns);
        self.expect(most_ns.is_none_or(|most| spread_ns < most), || {
            format!("times off by {spread_ns} ns")
        });
        let halves = self.decoded().into_iter().filter(|&packet| {
            let sent = self.truth[packet]
                .returns
                .iter()
                .flatten()
                .flatten()
                .count();
            let struck = self
                .damage
                .get(&self.truth[packet].ordinal)
                .map(|damage| damage.part());
            found[packet].abs_diff(sent) > usize::from(struck == Some(PacketPart::Distance))
        });
        let halves = halves.count();
        self.expect(halves == 0, || {
            format!("{halves} packets not decoded whole")
        });
    }

    /// The elevation that each channel has, for each sweep.
    fn elevations(&self) -> Vec<Vec<f32>> {
        let of_sweep = |view: &SweepRef<'_>| {
            let model = Model::ALL
                .into_iter()
                .find(|model| model.code() == view.header.model);
            let own = self.made.config.beams();
            let beams = model.and_then(|model| model.calibration()).unwrap_or(&own);
            beams
                .beams()
                .iter()
                .map(|beam| beam.elevation_rad as f32)
                .collect()
        };
        self.views.iter().map(of_sweep).collect()
    }

    /// Whether it is the record of which a distance bit was flipped.
    fn is_struck(&self, placed: &Placed) -> bool {
        let ordinal = self.truth[placed.found.packet as usize].ordinal;
        let struck = self
            .damage
            .get(&ordinal)
            .filter(|damage| damage.part() == PacketPart::Distance);
        struck.and_then(|damage| damage.record())
            == Some((usize::from(placed.found.block), placed.record))
    }

    /// The numbers of the packets that were decoded.
    fn decoded(&self) -> BTreeSet<usize> {
        let columns = self
            .views
            .iter()
            .flat_map(|view| view.columns)
            .filter(|column| column.is_measured());
        columns.map(|column| column.packet as usize).collect()
    }

    fn counters(&mut self, counts: &Counts, others: u64, decoded: &BTreeSet<usize>) {
        let Counts {
            data,
            duplicates,
            malformed,
            late,
            unconfirmed,
            foreign,
            undecoded,
            lost,
            reordered,
            ..
        } = *counts;
        let refused = malformed + late + unconfirmed + foreign + undecoded;
        let known = decoded.len() as u64 + refused + duplicates;
        self.expect(data == known, || {
            format!("of {data} packets {known} are accounted for: {counts:?}")
        });
        let faults = &self.made.faults;
        let (promise, in_sweeps) = (
            self.promise(),
            self.views
                .iter()
                .map(|view| u64::from(view.header.lost_packets)),
        );
        let in_sweeps: u64 = in_sweeps.sum();
        let told =
            |what: &str| format!("{what}: {counts:?}, {others} others, {in_sweeps} lost in sweeps");
        match promise.counts {
            Told::Exactly => {
                let [twice, swapped] =
                    [faults.duplicated.len(), faults.swapped.len()].map(|count| count as u64);
                let expected = [
                    faults.lost_packets(),
                    twice,
                    swapped,
                    faults.strays.len() as u64,
                    0,
                ];
                let counted = [lost, duplicates, reordered, others, refused];
                self.row.counted =
                    Some(counted.iter().sum()).filter(|_| *faults != Default::default());
                self.expect(counted == expected, || {
                    told(&format!("expected {expected:?}"))
                });
                self.expect(in_sweeps == lost, || told("sweeps tell other losses"));
            }
            Told::Refused => {
                let is_damaged = |ordinal: u64| self.damage.contains_key(&ordinal);
                let decoded: BTreeSet<u64> = decoded
                    .iter()
                    .map(|&packet| self.truth[packet].ordinal)
                    .collect();
                let missing =
                    (0..self.made.config.packets).filter(|ordinal| !decoded.contains(ordinal));
                let (struck, sound): (Vec<u64>, Vec<u64>) =
                    missing.partition(|&ordinal| is_damaged(ordinal));
                let counted = refused + others + duplicates;
                self.row.counted = Some(counted);
                self.expect(sound.is_empty(), || {
                    told(&format!("{} sound packets refused", sound.len()))
                });
                self.expect(counted == struck.len() as u64, || {
                    told(&format!("{} not decoded", struck.len()))
                });
                self.expect(lost == struck.len() as u64 && in_sweeps == lost, || {
                    told("not counted as lost")
                });
                // Packets that are nearer to each other than their stamps are believed may seem to
                // have overtaken each other.
                let config = &self.made.config;
                let period_ns = i64::from(config.spec.packet_period_ns(config.return_mode));
                let may_overtake = promise.time_ns.is_some_and(|most| most > period_ns);
                let believed = self.damage.len() as u64 - struck.len() as u64;
                self.expect(reordered <= if may_overtake { believed } else { 0 }, || {
                    told("out of order")
                });
                self.refused_if_it_can_be_detected(&decoded);
            }
            Told::Interrupted => {
                self.row.counted = Some(self.interruptions());
                self.expect(
                    duplicates + reordered + others == 0 && lost <= promise.silent,
                    || told("nothing was lost"),
                );
                self.expect(refused <= promise.given_up, || told("too many refused"));
            }
            Told::Mixed => self.row.counted = Some(refused + duplicates + lost),
        }
    }

    /// Length and flags always tell.
    fn refused_if_it_can_be_detected(&mut self, decoded: &BTreeSet<u64>) {
        let tells =
            |damage: &Damage| matches!(damage.part(), PacketPart::Length | PacketPart::Flag);
        let accepted = self
            .damage
            .iter()
            .filter(|(ordinal, damage)| tells(damage) && decoded.contains(ordinal))
            .count();
        self.expect(accepted == 0, || {
            format!("{accepted} packets with a wrong length or flag were decoded")
        });
    }

    /// How often a sweep was broken off and another begun.
    fn interruptions(&self) -> u64 {
        let is_partial: Vec<bool> = self
            .views
            .iter()
            .map(|view| view.header.has(PARTIAL))
            .collect();
        is_partial.windows(2).filter(|two| two[0] && two[1]).count() as u64
    }

    /// What sweeps say of themselves: whole ones have no hole that they do not tell, and faults are
    /// told while they last.
    fn sweeps(&mut self) {
        self.row.sweeps = self.views.len();
        self.row.partial = self
            .views
            .iter()
            .filter(|view| view.header.has(PARTIAL))
            .count();
        for index in 0..self.views.len() {
            let header = *self.views[index].header;
            let (holes, turned_rad) = holes(&self.views[index]);
            let allowed = usize::from(header.has(BLANKED));
            let what = format!(
                "sweep {index} of {}, flags {:#x}",
                self.views.len(),
                header.flags
            );
            self.expect(holes <= allowed, || {
                format!("{what}: {holes} holes that it does not tell")
            });
            let is_whole = header.has(CIRCULAR) && !header.has(STOPPED);
            let is_turn = (turned_rad.abs() / TAU - 1.0).abs() < 0.012;
            self.expect(!is_whole || is_turn, || {
                format!("{what}: whole, of {:.3} turns", turned_rad / TAU)
            });
        }
        let [begun_ns, _] = self.made.fault_ns;
        let period_ns = 70_000_000;
        let before = |view: &&SweepRef<'_>| {
            self.start_ns(view)
                .is_some_and(|at_ns| at_ns + 2 * period_ns < begun_ns)
        };
        let early = self
            .views
            .iter()
            .skip(1)
            .filter(before)
            .filter(|view| view.header.flags & FAULTS != 0)
            .count();
        self.expect(early == 0, || {
            format!("{early} sweeps are flagged before the fault")
        });
        let seen = self
            .views
            .iter()
            .fold(0, |seen, view| seen | view.header.flags);
        let flags = self.promise().flags;
        self.expect(seen & flags == flags, || {
            format!("flags {:#x} are never set", flags & !seen)
        });
    }

    /// When the first packet of a sweep was fired, by the truth.
    fn start_ns(&self, view: &SweepRef<'_>) -> Option<i64> {
        let first = view.columns.iter().find(|column| column.is_measured())?;
        let shots = self.truth[first.packet as usize]
            .returns
            .iter()
            .flatten()
            .flatten();
        shots.map(|shot| shot.time_ns).min()
    }

    /// From a revolution after the fault on, every sweep but the last is whole.
    fn recovery(&mut self) {
        let [_, over_ns] = self.made.fault_ns;
        let is_whole = |view: &SweepRef<'_>| {
            view.header.flags & FAULTS & !RATE_UNSTABLE == 0 && view.header.missing_columns == 0
        };
        let since = |view: &SweepRef<'_>| {
            Some((self.start_ns(view)? - over_ns) as f64 / self.made.turn_ns as f64)
        };
        let Some((_, sweeps)) = self.views.split_last() else {
            return;
        };
        let recovered = sweeps
            .iter()
            .find(|view| since(view).is_some_and(|turns| turns >= 0.0) && is_whole(view));
        let turns = recovered.and_then(since);
        let most = self.promise().recovery_turns;
        let relapses = sweeps
            .iter()
            .filter(|view| since(view) >= turns.or(Some(0.0)) && !is_whole(view))
            .count();
        let unstable = sweeps
            .iter()
            .filter(|view| since(view) > Some(most + 1.0) && view.header.has(RATE_UNSTABLE))
            .count();
        self.row.recovery = turns.filter(|_| over_ns > 0);
        self.expect(turns.is_some(), || {
            "no whole sweep after the fault".to_owned()
        });
        self.expect(
            over_ns == 0 || turns.is_none_or(|turns| turns <= most),
            || format!("whole again after {turns:?} turns"),
        );
        self.expect(relapses == 0 && unstable == 0, || {
            format!("{relapses} and {unstable} sweeps are broken long after the fault")
        });
    }
}

/// Steps between columns that are none of a turning head, and the whole way.
fn holes(view: &SweepRef<'_>) -> (usize, f64) {
    let fired: Vec<&Column> = view
        .columns
        .iter()
        .filter(|column| column.is_fired())
        .collect();
    let (mut holes, mut turned_rad) = (0, 0.0);
    for two in fired.windows(2) {
        let step_rad = shortest(f64::from(two[1].azimuth_rad) - f64::from(two[0].azimuth_rad));
        let lasted_ns = f64::from(two[1].time_ns - two[0].time_ns);
        let rate = f64::from(two[0].azimuth_rate_rad_s)
            .abs()
            .max(f64::from(two[1].azimuth_rate_rad_s).abs());
        let is_late =
            lasted_ns > 3.5 * f64::from(view.header.duration_ns as f32) / fired.len() as f64;
        holes += usize::from(
            is_late && rate > 1.0 || step_rad.abs() > 3.0 * rate * lasted_ns * 1e-9 + 0.012,
        );
        turned_rad += step_rad;
    }
    (holes, turned_rad)
}

fn shortest(rad: f64) -> f64 {
    (rad + PI).rem_euclid(TAU) - PI
}
