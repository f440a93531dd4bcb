//! How a sensor comes to be decoded: which model it is, where its beams point, and then packet
//! after packet.
//!
//! ```text
//! Detecting -> Decoding               most models: the table in `calib/`, or a given file
//! Detecting -> Calibrating -> Decoding    an HDL-64E without a file: its packets tell, unless it is known from before
//! any -> Refusing                     nothing that can be decoded
//! Decoding, Calibrating -> Detecting  another sensor took its place
//! ```

use super::{Closing, Config, Fault, Notice, Pipeline};
use crate::assemble::builder::{Builder, BuilderConfig};
use crate::assemble::clock::{Clocks, SensorClock, vouched_utc_ns};
use crate::assemble::decode::Decoder;
use crate::assemble::motion::{TURN, rate_between};
use crate::assemble::order::{OrderedPacket, PacketOrder, Rejection};
use crate::sensor::compare::Difference;
use crate::sensor::detect::{self, DetectError, Detection, Detector, MAX_PACKETS};
use crate::sensor::unit::{Unit, UnitUpdate};
use crate::sensor::{Calibration, Model};
use crate::wire::data::{Banks, ReturnMode};
use crate::wire::hdl64::Series;
use crate::wire::nmea::Rmc;
use crate::wire::{DataPacket, Position};

/// Packets in a row with another product byte after which the sensor counts as exchanged.
const EXCHANGED_PACKETS: u32 = 8;
/// Packets that must speak of an unsupported sensor before it is believed.
const DOUBTS: u32 = 3;

pub(super) enum State {
    /// Which model is it? The packets so far wait for the answer.
    Detecting(Box<Detecting>),
    /// Where do its beams point? Its packets tell, a byte each.
    Calibrating(Box<Calibrating>),
    /// It is this one.
    Decoding(Box<Decoding>),
    /// None that can be decoded.
    Refusing,
}

pub(super) struct Detecting {
    pub(super) detector: Detector,
    pub(super) waiting: Vec<WaitingPacket>,
    /// Packets that spoke of no supported sensor, and what the last one said.
    pub(super) doubts: u32,
    pub(super) doubt: Option<DetectError>,
    /// What is known of the HDL-64E that this is expected to be.
    pub(super) unit: Option<Unit>,
    pub(super) clocks: Clocks,
}

pub(super) struct Calibrating {
    pub(super) detection: Detection,
    pub(super) unit: Unit,
    pub(super) foreign: u32,
    /// The packets at the last two cycles of the status: from there on, how far the head turned
    /// tells its speed.
    pub(super) marks: [Option<DataPacket>; 2],
    pub(super) clocks: Clocks,
}

pub(super) struct Decoding {
    pub(super) detection: Detection,
    /// What the sensor says of itself, and the calibration in use to hold it against.
    pub(super) unit: Option<(Unit, Calibration)>,
    /// Product byte of its packets, and how many others came in a row.
    pub(super) product: u8,
    pub(super) foreign: u32,
    /// Return mode of the packet before.
    pub(super) last_mode: ReturnMode,
    /// Stamp of the packet before, since two returns became one and until the packets' period with
    /// one is known.
    pub(super) unmeasured_us: Option<u32>,
    /// A packet that was overtaken by more than was held back.
    pub(super) late: Option<OrderedPacket>,
    pub(super) order: PacketOrder,
    pub(super) builder: Builder,
}

pub(super) struct WaitingPacket {
    pub(super) bytes: DataPacket,
    pub(super) number: u64,
    pub(super) arrival_ns: i64,
}

/// All that decoding a sensor begins with.
struct KnownSensor {
    detection: Detection,
    calibration: Calibration,
    /// What an HDL-64E has said of itself.
    unit: Option<Unit>,
    clocks: Clocks,
    /// How fast the head turns, hundredths of a degree a nanosecond, if the packets so far tell.
    rate_cdeg_ns: Option<f64>,
    /// Product byte of its packets.
    product: u8,
}

impl Pipeline {
    pub(super) fn detecting(model: Option<Model>, clocks: Clocks) -> State {
        State::Detecting(Box::new(Detecting {
            detector: Detector::new(model),
            waiting: Vec::with_capacity(MAX_PACKETS),
            doubts: 0,
            doubt: None,
            unit: None,
            clocks,
        }))
    }

    /// Ends the detection: decoding begins with the packets that waited, or the wait for the
    /// calibration does.
    pub(super) fn detected(&mut self, result: Result<Detection, DetectError>) -> Result<(), Fault> {
        let State::Detecting(detecting) = &mut self.state else {
            return Ok(());
        };
        let mut waiting = std::mem::take(&mut detecting.waiting);
        let unit = detecting.unit.take();
        let clocks = detecting.clocks;
        self.counts.undecoded += u64::from(detecting.doubts);
        let next = result
            .map_err(Fault::from)
            .and_then(|detection| self.after_detection(detection, unit, clocks, &waiting));
        if let Ok(State::Decoding(_)) = next {
            self.counts.reordered += sort_by_stamp(&mut waiting);
        } else {
            self.counts.undecoded += waiting.len() as u64;
            waiting.clear();
        }
        self.enter(next)?;
        for packet in &waiting {
            self.order(&packet.bytes, packet.number, packet.arrival_ns);
        }
        Ok(())
    }

    /// Enters the next state; a fault leads to the one that refuses all packets.
    fn enter(&mut self, next: Result<State, Fault>) -> Result<(), Fault> {
        self.state = State::Refusing;
        self.state = next?;
        Ok(())
    }

    /// The state of a sensor whose model is known: decoding, if its calibration is known too.
    fn after_detection(
        &mut self,
        mut detection: Detection,
        unit: Option<Unit>,
        clocks: Clocks,
        waiting: &[WaitingPacket],
    ) -> Result<State, Fault> {
        let model = detection.model;
        let mut unit = model.is_hdl64e().then(|| unit.unwrap_or_default());
        let calibration = if let Some(given) = &self.config.calibration {
            Some(given.clone().for_model(model).map_err(Fault::Calibration)?)
        } else if let Some(nominal) = model.calibration() {
            Some(nominal.clone())
        } else {
            unit.as_ref()
                .and_then(|unit| sent_calibration(&self.config, unit, &mut detection))
        };
        let Some(calibration) = calibration else {
            let mut unit = unit.take().unwrap_or_default();
            for packet in waiting {
                let _ = unit.hear(&packet.bytes);
            }
            self.notices.push(Notice::AwaitsCalibration);
            return Ok(State::Calibrating(Box::new(Calibrating {
                detection,
                unit,
                foreign: 0,
                marks: [None; 2],
                clocks,
            })));
        };
        let ends = waiting.first().zip(waiting.last());
        let rate_cdeg_ns = ends.and_then(|(first, last)| {
            rate_between(
                &first.bytes,
                &last.bytes,
                detection.return_mode,
                detection.spec,
            )
        });
        self.decoding(KnownSensor {
            detection,
            calibration,
            unit,
            clocks,
            rate_cdeg_ns,
            product: waiting.last().map_or(0, |packet| packet.bytes.product),
        })
    }

    /// Takes the byte of the calibration that a packet brings; with the last one, decoding begins.
    pub(super) fn calibrate(&mut self, packet: &DataPacket, arrival_ns: i64) -> Result<(), Fault> {
        let State::Calibrating(calibrating) = &mut self.state else {
            return Ok(());
        };
        self.counts.undecoded += 1;
        if !calibrating.detection.has_layout(packet) {
            calibrating.foreign += 1;
            self.closing = if calibrating.foreign >= EXCHANGED_PACKETS {
                Closing::Exchanged
            } else {
                Closing::No
            };
            return Ok(());
        }
        calibrating.foreign = 0;
        if let Some(UnitUpdate { utc_ns, .. }) = calibrating.unit.hear(packet) {
            calibrating
                .clocks
                .note_utc(utc_ns, packet.stamp_us(), arrival_ns);
            calibrating.marks = [calibrating.marks[1], Some(*packet)];
        }
        let mut detection = calibrating.detection;
        let Some(calibration) = sent_calibration(&self.config, &calibrating.unit, &mut detection)
        else {
            return Ok(());
        };
        self.notices.push(Notice::Calibrated {
            calibrated: calibrating.unit.calibrated(),
            packets: self.counts.data,
        });
        let rate_cdeg_ns = calibrating.marks[0]
            .and_then(|mark| rate_between(&mark, packet, detection.return_mode, detection.spec));
        let known = KnownSensor {
            detection,
            calibration,
            unit: Some(std::mem::take(&mut calibrating.unit)),
            clocks: calibrating.clocks,
            rate_cdeg_ns,
            product: 0,
        };
        let next = self.decoding(known);
        self.enter(next)
    }

    /// The state that decodes the packets of this sensor.
    fn decoding(&self, known: KnownSensor) -> Result<State, Fault> {
        let KnownSensor {
            detection,
            calibration,
            unit,
            clocks,
            rate_cdeg_ns,
            product,
        } = known;
        let rows = calibration.rows().len();
        if let Some(mask) = &self.config.segment.mask
            && mask.rows() != rows
        {
            return Err(Fault::Mask {
                found: mask.rows(),
                model: detection.model,
                rows,
            });
        }
        let limits_m = self.config.segment.min_range_m..=self.config.segment.max_range_m;
        let mut decoder = Decoder::new(
            detection.model,
            detection.spec,
            &calibration,
            self.config.return_choice,
            limits_m,
        )
        .with_level(self.level);
        decoder.is_normalised = unit.as_ref().is_some_and(Unit::is_normalised);
        let mut order = PacketOrder::new(decoder.spec);
        order.expect_rate(rate_cdeg_ns);
        let mut builder = Builder::new(decoder, self.builder_config());
        builder.clocks = clocks;
        builder.sequence = self.sweeps;
        builder.expect_rate(rate_cdeg_ns);
        Ok(State::Decoding(Box::new(Decoding {
            detection,
            unit: unit.map(|unit| (unit, calibration)),
            product,
            foreign: 0,
            last_mode: detection.return_mode,
            unmeasured_us: None,
            late: None,
            order,
            builder,
        })))
    }

    fn builder_config(&self) -> BuilderConfig {
        BuilderConfig {
            cut_cdeg: (self.config.cut_azimuth_rad.to_degrees() * 100.0).rem_euclid(TURN),
            return_choice: self.config.return_choice,
            min_points: self.config.segment.min_points as usize,
            sensor: self.sensor.clone(),
        }
    }

    /// Puts a packet in order, or counts why it has no place.
    pub(super) fn order(&mut self, packet: &DataPacket, number: u64, arrival_ns: i64) {
        let State::Decoding(decoding) = &mut self.state else {
            return;
        };
        let same_layout = decoding.detection.has_layout(packet);
        if matches!(packet.banks(), Banks::UpperHeavy | Banks::Other) {
            self.counts.malformed += 1;
            return;
        }
        let has_product = decoding.detection.spec.product.is_some() && self.config.model.is_none();
        if !same_layout || has_product && packet.product != decoding.product {
            self.counts.foreign += 1;
            decoding.foreign += 1;
            if decoding.foreign >= EXCHANGED_PACKETS {
                decoding.order.flush();
                self.closing = Closing::Exchanged;
            }
            return;
        }
        decoding.foreign = 0;
        if let Some(differences) = decoding.hear(packet, arrival_ns, self.config.model.is_none()) {
            self.notices.push(Notice::OtherCalibration { differences });
        }
        let mode = decoding.detection.mode_of(packet, decoding.last_mode);
        decoding.measure(packet, mode);
        decoding.last_mode = mode;
        match decoding.order.push(packet, mode, number, arrival_ns) {
            Ok(()) => {}
            Err(Rejection::Duplicate) => self.counts.duplicates += 1,
            Err(Rejection::Implausible(_)) => self.counts.malformed += 1,
            Err(Rejection::Behind { motion, time_ns }) => {
                let packet = OrderedPacket {
                    bytes: *packet,
                    motion,
                    mode,
                    number,
                    arrival_ns,
                    time_ns,
                };
                // It is placed by the next poll, before any other.
                self.counts.late += u64::from(decoding.late.replace(packet).is_some());
            }
        }
    }

    pub(super) fn position(&mut self, position: &Position<'_>, rmc: Option<&Rmc>, arrival_ns: i64) {
        self.counts.position += 1;
        let clocks = match &mut self.state {
            State::Detecting(detecting) => &mut detecting.clocks,
            State::Calibrating(calibrating) => &mut calibrating.clocks,
            State::Decoding(decoding) => &mut decoding.builder.clocks,
            State::Refusing => return,
        };
        let utc_ns = vouched_utc_ns(position, rmc, self.config.gps_without_pps);
        clocks.note_utc(utc_ns, position.stamp_us, arrival_ns);
    }
}

impl Decoding {
    /// An HDL-64E S3 that reported two returns so far may have either timing when it reports one:
    /// two packets in a row tell.
    fn measure(&mut self, packet: &DataPacket, mode: ReturnMode) {
        let is_change = self.last_mode == ReturnMode::Dual && mode != ReturnMode::Dual;
        let before_us = self.unmeasured_us.take();
        let specs = self.detection.model.specs();
        if mode == ReturnMode::Dual || specs.len() < 2 || !(is_change || before_us.is_some()) {
            return;
        }
        let stamp_us = packet.stamp_us();
        let measured = specs.iter().find(|spec| {
            before_us.is_some_and(|before_us| {
                detect::is_next(before_us, stamp_us, spec.packet_period_ns(mode))
            })
        });
        match measured {
            Some(&spec) if spec != self.detection.spec => {
                self.detection.spec = spec;
                self.order.take_spec(spec);
                self.builder.decoder_mut().take_spec(spec);
            }
            Some(_) => {}
            None => self.unmeasured_us = Some(stamp_us),
        }
    }

    /// Listens to what an HDL-64E says of itself. Gives in what its calibration differs from the
    /// one in use, once it is known and if it does.
    fn hear(
        &mut self,
        packet: &DataPacket,
        arrival_ns: i64,
        may_rename: bool,
    ) -> Option<Vec<Difference>> {
        let (unit, calibration) = self.unit.as_mut()?;
        let said = unit.hear(packet);
        // The packet that tells it is the first one decoded so.
        self.builder.decoder_mut().is_normalised = unit.is_normalised();
        let UnitUpdate { series, utc_ns } = said?;
        self.builder
            .clocks
            .note_utc(utc_ns, packet.stamp_us(), arrival_ns);
        if series == Some(Series::S3) && may_rename {
            // Until then it may have been either: with one return their timing is the same.
            self.detection.model = Model::Hdl64eS3;
            self.builder.decoder_mut().model = Model::Hdl64eS3;
        }
        unit.differences(calibration)
            .filter(|differences| !differences.is_empty())
    }
}

impl Detecting {
    /// Looks at a packet and keeps it. One that speaks of no supported sensor may be corrupt: only
    /// the third is believed.
    pub(super) fn observe(
        &mut self,
        packet: WaitingPacket,
    ) -> Option<Result<Detection, DetectError>> {
        let result = self.detector.observe(&packet.bytes);
        if let Some(Err(
            error @ (DetectError::Unsupported { .. } | DetectError::UnknownProduct { .. }),
        )) = result
            && self.waiting.len() + 1 < MAX_PACKETS
        {
            self.doubts += 1;
            self.doubt = Some(error);
            return result.filter(|_| self.doubts >= DOUBTS);
        }
        self.waiting.push(packet);
        result
    }

    /// What the packets so far tell, for a stream that ended; `None` when there were none.
    pub(super) fn conclude(&self) -> Option<Result<Detection, DetectError>> {
        match self.doubt {
            Some(doubt) if self.waiting.is_empty() => Some(Err(doubt)),
            _ if self.waiting.is_empty() => None,
            _ => Some(self.detector.conclude()),
        }
    }
}

/// The calibration that a unit has sent, if it is complete and that of the model; completes the
/// detection by what only the unit knows.
fn sent_calibration(
    config: &Config,
    unit: &Unit,
    detection: &mut Detection,
) -> Option<Calibration> {
    // One that no unit can have was damaged on the way, where no checksum tells: the next dump
    // brings it again.
    let calibration = unit
        .calibration()?
        .and_then(|own| own.for_model(detection.model))
        .ok()?;
    // With one return, only the unit itself knows which.
    if detection.return_mode == ReturnMode::Strongest
        && unit.return_mode() == Some(ReturnMode::Last)
    {
        detection.return_mode = ReturnMode::Last;
    }
    if config.model.is_none() && unit.series() == Some(Series::S3) {
        detection.model = Model::Hdl64eS3;
    }
    Some(calibration)
}

/// Sorts by the sensor's clock, over the hour if need be; returns how many packets had been
/// overtaken.
fn sort_by_stamp(waiting: &mut [WaitingPacket]) -> u64 {
    let Some(first) = waiting.first().map(|packet| packet.bytes.stamp_us()) else {
        return 0;
    };
    let mut clock = SensorClock::default();
    clock.set(first, 0);
    let time_ns = |packet: &WaitingPacket| clock.read_ns(packet.bytes.stamp_us());
    let mut newest_ns = i64::MIN;
    let mut overtaken = 0;
    for packet in waiting.iter() {
        overtaken += u64::from(time_ns(packet) < newest_ns);
        newest_ns = newest_ns.max(time_ns(packet));
    }
    waiting.sort_by_key(time_ns);
    overtaken
}
