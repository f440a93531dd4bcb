//! One sensor on the thread of its port: pushes its packets through its pipeline, publishes its
//! sweeps, and reports events.

use std::iter;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use super::counters::{Gps, SensorCounters, Stage};
use super::nap::Due;
use super::sharing::{ObjectsOutput, Outgoing};
use crate::floor;
use crate::sensor_settings::FieldOfView;
use sweepd_client::host::{monotonic_ns, realtime_ns};
use sweepd_core::assemble::{GpsDoubt, GpsTime, vouched_utc_ns};
use sweepd_core::buffers::{Buffers, Memory};
use sweepd_core::floor::Sight;
use sweepd_core::pipeline::{self, Arrival, Counts, Fault, Notice, Options, Pipeline};
use sweepd_core::segment::ConfigError;
use sweepd_core::sensor::detect;
use sweepd_core::sensor::unit::Unit;
use sweepd_core::sweep::layout::{Completion, TimeSource, flags};
use sweepd_core::sweep::objects::{self, Sending, flags as objects_flags};
use sweepd_core::sweep::{Header, SweepMut};
use sweepd_core::wire::nmea::Rmc;
use sweepd_core::wire::position::Pps;
use sweepd_core::wire::{Content, Packet, Position, hdl64};

/// A sensor that could not be decoded is detected again after this time: it may have been
/// exchanged, or its first packets may have been lost.
const SECOND_LOOK_NS: i64 = 10_000_000_000;
/// Looks from which on the floor is told.
const FLOOR_LOOKS: u64 = 5;

/// A rare event of a sensor, for the log.
#[derive(Debug)]
pub enum Event {
    /// Its packets cannot be decoded.
    Fault(Fault),
    /// Another notice of the pipeline.
    Notice(Notice),
    /// It is decoded with a new configuration from now on, or the reason why not.
    Reconfigured(Result<(), ConfigError>),
    /// Sweeps can no longer be published, with the reason.
    NotShared(String),
    /// They can again.
    SharedAgain,
    /// What it sees of the floor, each time that it has looked.
    Floor(floor::Seen),
    /// The clock of its sweeps, and what is doubtful about the time of its GPS receiver, when either
    /// changes.
    Time(TimeSource, Option<GpsDoubt>),
}

/// A sensor at work.
pub struct Sensor<B: Buffers> {
    index: usize,
    name: String,
    address: String,
    config: pipeline::Config,
    memory: Memory<B>,
    pipeline: Pipeline,
    counters: Arc<SensorCounters>,
    events: Sender<(usize, Event)>,
    /// What pipelines before this one counted.
    counted: Counts,
    /// When this pipeline began: together with the number of a sweep it is a permanent name.
    run_ns: i64,
    /// Datagrams that the kernel had dropped on the port when the sweep before was complete.
    dropped_before: u64,
    second_look_ns: Option<i64>,
    is_shared: bool,
    /// A complete sweep that waits for its shared memory, and when it was completed
    /// (CLOCK_MONOTONIC).
    held: Option<(B::Buffer, i64)>,
    objects: Option<Box<dyn ObjectsOutput>>,
    objects_every_ns: i64,
    finds_objects: bool,
    /// Sweeps that were looked at for the floor, and whether it was in doubt, as last reported.
    told_floor: (u64, bool),
    /// What was reported of its time.
    told_time: (TimeSource, Option<GpsDoubt>),
}

/// Names of a sensor, and the receivers of its events and counts.
pub struct Identity {
    /// Its place among all sensors.
    pub index: usize,
    /// Its name and that of its service.
    pub name: String,
    /// Where its packets come from, as text.
    pub address: String,
    /// What is counted.
    pub counters: Arc<SensorCounters>,
    /// The receiver of events.
    pub events: Sender<(usize, Event)>,
}

impl<B: Buffers<Buffer: Outgoing>> Sensor<B> {
    /// A sensor that has sent nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`]: the configuration of the segmentation is invalid.
    pub fn new(
        identity: Identity,
        config: pipeline::Config,
        buffers: B,
    ) -> Result<Self, ConfigError> {
        let Identity {
            index,
            name,
            address,
            counters,
            events,
        } = identity;
        let pipeline = pipeline(&address, &config, None)?;
        Ok(Self {
            index,
            name,
            address,
            config,
            memory: Memory::new(buffers),
            pipeline,
            counters,
            events,
            counted: Counts::default(),
            run_ns: realtime_ns(),
            dropped_before: 0,
            second_look_ns: None,
            is_shared: true,
            held: None,
            objects: None,
            objects_every_ns: 0,
            finds_objects: false,
            told_floor: (0, false),
            told_time: (TimeSource::Host, None),
        })
    }

    /// Sends its objects there, where somebody wants them; one that is complete may wait so long for more, nanoseconds.
    #[must_use]
    pub fn with_objects(mut self, every_ns: i64, objects: Option<Box<dyn ObjectsOutput>>) -> Self {
        self.objects_every_ns = every_ns;
        self.objects = objects;
        self
    }

    /// Takes a data packet; `dropped` counts the datagrams that the kernel had dropped on the port
    /// so far.
    pub fn data(&mut self, packet: &Packet<'_>, dropped: u64) {
        self.pipeline.push(packet);
        self.send_events(dropped);
    }

    /// Counts a datagram from its address to its data port that is not a packet.
    pub fn refuse(&self) {
        self.counters.refused.add(1);
    }

    /// When the packets are expected that are waited for: the one that completes the open sweep, and
    /// where somebody wants its objects, one that completes some of these, so that none waits longer
    /// for more than is configured. `None` if that cannot be predicted.
    pub fn due(&self) -> Option<Due> {
        let sweep_ns = self.pipeline.next_due_ns(None)?;
        let mut objects_ns = None;
        if self.finds_objects {
            let due_ns = self.pipeline.next_due_ns(Some(self.objects_every_ns))?;
            objects_ns = Some(due_ns).filter(|due_ns| *due_ns < sweep_ns);
        }
        Some(Due {
            sweep_ns,
            objects_ns,
        })
    }

    /// Takes a position packet.
    pub fn position(&mut self, packet: &Packet<'_>) {
        self.pipeline.push(packet);
        if let Content::Position(position, sentence) = &packet.content {
            let without_pps = self.config.gps_without_pps;
            let fix = sentence.map(|read| read.map(|rmc| rmc.valid));
            let rmc = sentence.and_then(Result::ok);
            // Where the pulse is not asked for, the sentence vouches for it.
            let pps = match without_pps && fix == Some(Ok(true)) {
                true => Pps::Locked,
                false => position.pps,
            };
            self.counters.set_pulse(pps, fix);
            let gps = gps_of(position, rmc.as_ref(), without_pps);
            self.counters.set_gps(self.believed(gps));
            if let Some(temperature_c) = temperature_of(position) {
                self.counters.set_temperature_c(temperature_c);
            }
        }
    }

    /// What a receiver is that gives this much: only one whose time is believed is locked.
    fn believed(&self, gps: Gps) -> Gps {
        let time = self.pipeline.status().gps;
        match gps {
            Gps::Locked if time.is_some_and(|time| !time.is_locked()) => Gps::Incomplete,
            gps => gps,
        }
    }

    /// Counts position packets that were superseded by a newer one before they were read.
    pub fn pass_over_positions(&mut self, count: u64) {
        self.pipeline.push(Arrival::OldPositions(count));
    }

    /// What is done after a batch: segments what is there of the open sweep, and ends one that has
    /// stalled by the clock that stamps its packets, if there were any; updates the counters,
    /// publishes a held sweep, and may detect the sensor again.
    pub fn idle(&mut self, now_ns: Option<i64>, dropped: u64) {
        if !self.finds_objects && self.has_listeners() {
            self.finds_objects = true;
            self.pipeline.find_objects(true);
        }
        self.pipeline.idle(now_ns);
        self.send_events(dropped);
        if self
            .second_look_ns
            .is_some_and(|at_ns| monotonic_ns() >= at_ns)
        {
            // It was valid before.
            let _ = self.begin_anew(self.config.clone());
        }
        self.publish_held();
        self.count_packets();
    }

    fn has_listeners(&self) -> bool {
        self.objects
            .as_ref()
            .is_some_and(|output| output.has_listeners())
    }

    /// Updates what is counted of packets, and what the sensor says of itself.
    fn count_packets(&self) {
        let status = self.pipeline.status();
        let mut counts = self.counted;
        counts += status.counts;
        self.counters.set(&counts);
        let breaks = status.clock_breaks;
        self.counters.restarts.set(breaks.restarts);
        self.counters.clock_jumps.set(breaks.jumps);
        if let Some(product) = status.product {
            let given = self.config.model;
            let is_other = given.is_some_and(|given| detect::has_other_beams(given, product));
            self.counters.set_product(product, is_other);
        }
        if let Some(unit) = status.unit {
            unit.temperature_c()
                .into_iter()
                .for_each(|celsius| self.counters.set_temperature_c(celsius.into()));
            unit.gps()
                .into_iter()
                .for_each(|gps| self.counters.set_gps(self.believed(gps_of_unit(gps))));
        }
    }

    /// Decodes with another configuration from now on; drops the open sweep.
    pub fn reconfigure(&mut self, config: pipeline::Config) {
        let done = self.begin_anew(config);
        self.report(Event::Reconfigured(done));
    }

    fn begin_anew(&mut self, config: pipeline::Config) -> Result<(), ConfigError> {
        let fresh = pipeline(&self.address, &config, self.pipeline.known_unit())?;
        let before = std::mem::replace(&mut self.pipeline, fresh);
        self.counted += before.status().counts;
        // They are counted anew.
        self.counters.set_dark_beams(iter::empty());
        self.counters.forget_eye();
        self.told_floor = (0, false);
        self.config = config;
        self.finds_objects = false;
        self.run_ns = realtime_ns();
        self.second_look_ns = None;
        Ok(())
    }

    /// Sends what became known.
    fn send_events(&mut self, dropped: u64) {
        let mut has_swept = false;
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                pipeline::Event::Sweep(sweep) => {
                    self.send(sweep, dropped);
                    has_swept = true;
                }
                pipeline::Event::Objects(objects) => {
                    let is_last = objects.flags & objects_flags::LAST != 0;
                    if let Some(output) = &mut self.objects {
                        let sending = sending(&self.name, self.run_ns, &self.config);
                        objects::write(&objects, &sending, |message| output.send(message));
                    }
                    // Not within a sweep: a consumer that comes back during it would get the same
                    // objects again.
                    if is_last && !self.has_listeners() {
                        self.finds_objects = false;
                        self.pipeline.find_objects(false);
                    }
                }
                pipeline::Event::Notice(notice) => self.report(Event::Notice(notice)),
                pipeline::Event::Fault(fault) => {
                    self.second_look_ns = Some(monotonic_ns() + SECOND_LOOK_NS);
                    self.report(Event::Fault(fault));
                }
            }
        }
        // It was looked for after that, so that consumers did not wait.
        if has_swept {
            self.tell_floor();
        }
    }

    /// Completes the header of a sweep, publishes it, and counts it.
    fn send(&mut self, mut sweep: B::Buffer, dropped: u64) {
        let completed_ns = realtime_ns();
        let completed_monotonic_ns = monotonic_ns();
        let Ok(whole) = SweepMut::open(sweep.as_mut()) else {
            return self.counters.unshared.add(1);
        };
        let header = whole.header;
        let dropped_datagrams = u32::try_from(dropped - self.dropped_before).unwrap_or(u32::MAX);
        let name = &self.name[..];
        let run_ns = self.run_ns;
        header.complete(&Completion {
            name,
            run_ns,
            completed_ns,
            completed_monotonic_ns,
            dropped_datagrams,
        });
        self.dropped_before = dropped;
        self.count(header);
        let (time_source, is_partial) = (header.time_source(), header.has(flags::PARTIAL));
        // The first one may have begun before any position packet.
        if !is_partial {
            self.tell_time(time_source);
        }
        self.counters
            .set_dark_beams(self.pipeline.status().dark_beams.iter());
        self.publish_held();
        self.publish(sweep, completed_monotonic_ns);
    }

    /// Reports what is seen of the floor, if it was looked at again, or a doubt begins or is over.
    fn tell_floor(&mut self) {
        let status = self.pipeline.status();
        let (sight, looks) = (status.floor, status.floor_looks);
        let now = (looks, sight.doubt().is_some());
        let before = std::mem::replace(&mut self.told_floor, now);
        // Another sensor has taken its place, if there were fewer.
        let is_other = looks < before.0;
        if is_other || now != before && looks >= FLOOR_LOOKS {
            let sight = if is_other { Sight::Unknown } else { sight };
            let seen = floor::Seen::new(sight, &self.config.segment);
            self.report(Event::Floor(seen));
        }
    }

    /// Reports the clock of a sweep and the doubt about GPS time, if that is news.
    fn tell_time(&mut self, time_source: TimeSource) {
        let doubt = self.pipeline.status().gps.and_then(GpsTime::doubt);
        let (told_source, told_doubt) = self.told_time;
        let is_same_doubt = match (told_doubt, doubt) {
            (Some(told), Some(doubt)) => told.is_kind_of(&doubt),
            (told, doubt) => told.is_none() && doubt.is_none(),
        };
        if told_source != time_source || !is_same_doubt {
            self.told_time = (time_source, doubt);
            self.report(Event::Time(time_source, doubt));
        }
        if time_source == TimeSource::Host && self.counters.gps() == Some(Gps::Locked) {
            // Its packets may have ended.
            self.counters.set_gps(Gps::Incomplete);
        }
    }

    /// Publishes a sweep, or holds it until its shared memory is ready.
    fn publish(&mut self, sweep: B::Buffer, completed_monotonic_ns: i64) {
        match sweep.publish() {
            Ok(None) => {
                self.counters
                    .stage(Stage::Send)
                    .note((monotonic_ns() - completed_monotonic_ns) as u64);
                self.note_sharing(Ok(()));
            }
            Ok(Some(sweep)) => {
                // At most one is held, the newest.
                if self.held.replace((sweep, completed_monotonic_ns)).is_some() {
                    self.counters.unshared.add(1);
                }
            }
            Err(error) => self.note_sharing(Err(error.to_string())),
        }
    }

    fn publish_held(&mut self) {
        if let Some((sweep, completed_monotonic_ns)) = self.held.take() {
            self.publish(sweep, completed_monotonic_ns);
        }
    }

    fn count(&self, header: &Header) {
        let counters = &self.counters;
        counters.sweeps.add(1);
        let is_partial = header.has(flags::PARTIAL);
        counters.partial_sweeps.add(is_partial.into());
        counters
            .steady_sweeps
            .add((!is_partial && !header.has(flags::RATE_UNSTABLE | flags::STOPPED)).into());
        counters.set_sensor(header);
        let limits_deg = self.pipeline.status().field_of_view_deg;
        if let Some(fov) = FieldOfView::measured(header.flags, limits_deg) {
            counters.set_fov(fov);
        }
        counters.stage(Stage::Decode).note(header.decode_ns.into());
        counters.stage(Stage::Ground).note(header.ground_ns.into());
        counters.stage(Stage::Label).note(header.label_ns.into());
        // If the clock was set back in between, the time is not valid.
        if let Ok(ns) = u64::try_from(header.completed_ns - header.arrival_ns) {
            counters.stage(Stage::Complete).note(ns);
        }
    }

    /// Reports once that sweeps are not published, and once that they are again.
    fn note_sharing(&mut self, sent: Result<(), String>) {
        let was_shared = std::mem::replace(&mut self.is_shared, sent.is_ok());
        match sent {
            Ok(()) if !was_shared => self.report(Event::SharedAgain),
            Ok(()) => {}
            Err(why) => {
                self.counters.unshared.add(1);
                if was_shared {
                    self.report(Event::NotShared(why));
                }
            }
        }
    }

    fn report(&self, event: Event) {
        // The receiver is gone once the daemon ends.
        let _ = self.events.send((self.index, event));
    }
}

/// A pipeline that times its stages, for the HDL-64E of which this is known.
fn pipeline(
    address: &str,
    config: &pipeline::Config,
    unit: Option<Unit>,
) -> Result<Pipeline, ConfigError> {
    let options = Options {
        clock: monotonic_ns,
        unit,
        ..Options::default()
    };
    Pipeline::with_options(address, config.clone(), options)
}

/// A message of objects that is sent now.
fn sending<'a>(name: &'a str, run_ns: i64, config: &pipeline::Config) -> Sending<'a> {
    let mount = &config.segment.mount;
    Sending {
        name,
        run_ns,
        sent_ns: realtime_ns(),
        sent_monotonic_ns: monotonic_ns(),
        position_m: config.position_m,
        angles_rad: [config.yaw_rad, mount.pitch_rad, mount.roll_rad],
    }
}

fn gps_of(position: &Position<'_>, rmc: Option<&Rmc>, without_pps: bool) -> Gps {
    let is_valid = rmc.is_some_and(|rmc| rmc.valid);
    match position.pps {
        _ if vouched_utc_ns(position, rmc, without_pps).is_some() => Gps::Locked,
        Pps::Absent if !is_valid => Gps::Absent,
        _ => Gps::Incomplete,
    }
}

fn gps_of_unit(gps: hdl64::Gps) -> Gps {
    match gps {
        hdl64::Gps::None => Gps::Absent,
        hdl64::Gps::Pulse | hdl64::Gps::Sentence => Gps::Incomplete,
        hdl64::Gps::Both => Gps::Locked,
    }
}

/// Degrees Celsius of the warmest part that a sensor reports.
fn temperature_of(position: &Position<'_>) -> Option<i32> {
    let boards = position
        .board
        .map(|board| i32::from(board.top_c.max(board.bottom_c)));
    let chips = position
        .inertial
        .map(|chips| chips.map(|chip| chip.temperature_c().round() as i32));
    boards.or(chips.and_then(|chips| chips.into_iter().max()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sweepd_core::wire::position::{Board, Inertial};

    const VALID: &str = "$GPRMC,101723,A,5006.636,N,00840.926,E,000.0,000.0,040526,000.0,W";

    fn position<'a>(pps: Pps, nmea: Option<&'a str>) -> Position<'a> {
        Position {
            stamp_us: 0,
            pps,
            nmea,
            inertial: None,
            board: None,
            thermal: None,
        }
    }

    fn gps(position: &Position<'_>, without_pps: bool) -> Gps {
        let rmc = position.nmea.and_then(|text| Rmc::parse(text).ok());
        gps_of(position, rmc.as_ref(), without_pps)
    }

    #[test]
    fn gps_is_locked_only_with_pulse_and_valid_time() {
        let checksum = VALID[1..].bytes().fold(0, |sum, byte| sum ^ byte);
        let valid = format!("{VALID}*{checksum:02X}");
        let cases = [
            (Pps::Locked, Some(&valid[..]), Gps::Locked),
            (Pps::Locked, None, Gps::Incomplete),
            (Pps::Synchronizing, Some(&valid[..]), Gps::Incomplete),
            (Pps::Absent, Some(&valid[..]), Gps::Incomplete),
            (Pps::Absent, Some(VALID), Gps::Absent),
            (Pps::Error, None, Gps::Incomplete),
        ];
        for (pps, nmea, expected) in cases {
            assert_eq!(
                gps(&position(pps, nmea), false),
                expected,
                "{pps}, {nmea:?}"
            );
        }
    }

    #[test]
    fn gps_is_locked_without_a_pulse_where_that_is_allowed() {
        let checksum = VALID[1..].bytes().fold(0, |sum, byte| sum ^ byte);
        let valid = format!("{VALID}*{checksum:02X}");
        // The time of the sentence is 17 minutes and 23 seconds.
        for (stamp_us, expected) in [(1_043_900_000, Gps::Locked), (5_000_000, Gps::Incomplete)] {
            let position = Position {
                stamp_us,
                ..position(Pps::Absent, Some(&valid))
            };
            assert_eq!(gps(&position, true), expected);
            assert_eq!(gps(&position, false), Gps::Incomplete);
        }
    }

    #[test]
    fn the_temperature_is_that_of_the_warmest_part() {
        let mut sent = position(Pps::Absent, None);
        assert_eq!(temperature_of(&sent), None);
        let chip = |temperature| Inertial {
            gyro: 0,
            temperature,
            accel_x: 0,
            accel_y: 0,
        };
        sent.inertial = Some([chip(0), chip(100), chip(-10)]);
        assert_eq!(temperature_of(&sent), Some(40));
        let board = Board {
            top_c: -3,
            bottom_c: -5,
            adc_calibration_c: 0,
            adc_change_c: 0,
            adc_age_s: 0,
            adc_reason: 0,
            adc_status: 0,
        };
        sent.board = Some(board);
        assert_eq!(temperature_of(&sent), Some(-3));
    }
}
