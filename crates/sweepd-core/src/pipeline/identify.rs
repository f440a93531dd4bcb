//! Which sensor it is, and where its beams point: by its first packets.

use fearless_simd::Level;

use super::config::Config;
use super::report::{Fault, Notice, Report};
use crate::assemble::clock::{Clocks, SensorClock};
use crate::assemble::motion::rate_between;
use crate::sensor::detect::{DetectError, Detection, Detector, MAX_PACKETS};
use crate::sensor::unit::{Unit, UnitUpdate};
use crate::sensor::{Calibration, Model, ModelExt};
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;
use crate::wire::hdl64::Series;

/// Packets in a row of another sensor after which the sensor counts as exchanged.
const EXCHANGED_PACKETS: u32 = 8;
/// Packets that must speak of an unsupported sensor before it is believed.
const DOUBTS: u32 = 3;

/// What a pipeline is made for.
pub(super) struct Setup {
    pub config: Config,
    /// Name of the sensor.
    pub sensor: String,
    /// Instructions that decoders use.
    pub level: Level,
}

/// A data packet, and its ordinal among those of its sensor.
pub(super) struct NumberedPacket<'a> {
    pub bytes: &'a DataPacket,
    pub number: u64,
    pub arrival_ns: i64,
}

/// The same, kept until the model is known.
struct WaitingPacket {
    bytes: DataPacket,
    number: u64,
    arrival_ns: i64,
}

/// Packets in a row that another sensor sent.
#[derive(Default)]
pub(super) struct ForeignRun(u32);

impl ForeignRun {
    /// Counts a packet.
    pub fn note(&mut self, is_foreign: bool) {
        self.0 = if is_foreign {
            self.0.saturating_add(1)
        } else {
            0
        };
    }

    /// Whether the sensor counts as exchanged.
    pub fn is_exchange(&self) -> bool {
        self.0 >= EXCHANGED_PACKETS
    }
}

/// What goes on when another sensor takes the place of one.
#[derive(Clone, Copy, Default)]
pub(super) struct Handover {
    pub clocks: Clocks,
    /// Sweeps so far.
    pub sweeps: u64,
}

/// All that decoding a sensor begins with.
pub(super) struct KnownSensor {
    pub detection: Detection,
    pub calibration: Calibration,
    /// What an HDL-64E has said of itself.
    pub unit: Option<Unit>,
    pub handover: Handover,
    /// How fast the head turns, hundredths of a degree a nanosecond, if the packets so far tell.
    pub rate_cdeg_ns: Option<f64>,
    /// Product byte of its packets.
    pub product: u8,
}

/// What the model of a sensor leads to.
pub(super) enum Identity {
    Known(Box<KnownSensor>),
    AwaitsCalibration(Box<Calibrating>),
}

/// A sensor whose model is not known yet: the packets so far wait for it.
pub(super) struct Detecting {
    detector: Detector,
    waiting: Vec<WaitingPacket>,
    /// Packets that spoke of no supported sensor, and what the last one said.
    doubts: u32,
    doubt: Option<DetectError>,
    /// What is known of the HDL-64E that this is expected to be.
    pub unit: Option<Unit>,
    pub handover: Handover,
}

impl Detecting {
    pub fn new(model: Option<Model>, unit: Option<Unit>, handover: Handover) -> Self {
        Self {
            detector: Detector::new(model),
            waiting: Vec::with_capacity(MAX_PACKETS),
            doubts: 0,
            doubt: None,
            unit,
            handover,
        }
    }

    /// Looks at a packet and keeps it. One that speaks of no supported sensor may be corrupt: only
    /// the third is believed.
    pub fn push(&mut self, packet: &NumberedPacket<'_>) -> Option<Result<Detection, DetectError>> {
        let result = self.detector.observe(packet.bytes);
        if let Some(Err(
            error @ (DetectError::Unsupported { .. } | DetectError::UnknownProduct { .. }),
        )) = result
            && self.waiting.len() + 1 < MAX_PACKETS
        {
            self.doubts += 1;
            self.doubt = Some(error);
            return result.filter(|_| self.doubts >= DOUBTS);
        }
        self.waiting.push(WaitingPacket {
            bytes: *packet.bytes,
            number: packet.number,
            arrival_ns: packet.arrival_ns,
        });
        result
    }

    /// What the packets so far tell, for a stream that ended; `None` when there were none.
    pub fn conclude(&self) -> Option<Result<Detection, DetectError>> {
        match self.doubt {
            Some(doubt) if self.waiting.is_empty() => Some(Err(doubt)),
            _ if self.waiting.is_empty() => None,
            _ => Some(self.detector.conclude()),
        }
    }

    /// Packets that came so far.
    pub fn packets(&self) -> u64 {
        u64::from(self.doubts) + self.waiting.len() as u64
    }

    /// Finds the calibration of a sensor whose model is known by now.
    ///
    /// # Errors
    /// [`Fault::Calibration`].
    pub fn identify(
        &mut self,
        mut detection: Detection,
        config: &Config,
    ) -> Result<Identity, Fault> {
        let model = detection.model;
        let mut unit = model
            .is_hdl64e()
            .then(|| self.unit.take().unwrap_or_default());
        let calibration = if let Some(given) = &config.calibration {
            Some(given.clone().for_model(model).map_err(Fault::Calibration)?)
        } else if let Some(nominal) = model.calibration() {
            Some(nominal.clone())
        } else {
            unit.as_ref()
                .and_then(|unit| sent_calibration(config, unit, &mut detection))
        };
        let Some(calibration) = calibration else {
            let mut unit = unit.take().unwrap_or_default();
            for packet in &self.waiting {
                let _ = unit.hear(&packet.bytes);
            }
            return Ok(Identity::AwaitsCalibration(Box::new(Calibrating {
                detection,
                unit,
                foreign: ForeignRun::default(),
                marks: [None; 2],
                handover: self.handover,
            })));
        };
        let ends = self.waiting.first().zip(self.waiting.last());
        let rate_cdeg_ns = ends.and_then(|(first, last)| {
            rate_between(
                &first.bytes,
                &last.bytes,
                detection.return_mode,
                detection.spec,
            )
        });
        Ok(Identity::Known(Box::new(KnownSensor {
            detection,
            calibration,
            unit,
            handover: self.handover,
            rate_cdeg_ns,
            product: self.waiting.last().map_or(0, |packet| packet.bytes.product),
        })))
    }

    /// Sorts the packets that wait by the sensor's clock, over the hour if need be; returns how
    /// many had been overtaken.
    pub fn sort(&mut self) -> u64 {
        let Some(first) = self.waiting.first().map(|packet| packet.bytes.stamp_us()) else {
            return 0;
        };
        let mut clock = SensorClock::default();
        clock.set(first, 0);
        let mut newest_ns = i64::MIN;
        let mut overtaken = 0;
        for packet in &self.waiting {
            let time_ns = clock.read_ns(packet.bytes.stamp_us());
            overtaken += u64::from(time_ns < newest_ns);
            newest_ns = newest_ns.max(time_ns);
        }
        self.waiting
            .sort_by_key(|packet| clock.read_ns(packet.bytes.stamp_us()));
        overtaken
    }

    /// The packets that wait.
    pub fn waiting(&self) -> impl Iterator<Item = NumberedPacket<'_>> {
        self.waiting.iter().map(|packet| NumberedPacket {
            bytes: &packet.bytes,
            number: packet.number,
            arrival_ns: packet.arrival_ns,
        })
    }
}

/// An HDL-64E whose beams are not known yet: its packets tell, a byte each.
pub(super) struct Calibrating {
    pub detection: Detection,
    pub unit: Unit,
    foreign: ForeignRun,
    /// The packets at the last two cycles of the status: from there on, how far the head turned
    /// tells its speed.
    marks: [Option<DataPacket>; 2],
    pub handover: Handover,
}

impl Calibrating {
    /// Takes the byte of the calibration that a packet brings; with the last one, the sensor is
    /// known.
    pub fn push(
        &mut self,
        packet: &NumberedPacket<'_>,
        config: &Config,
        report: &mut Report,
    ) -> Option<KnownSensor> {
        report.counts.undecoded += 1;
        let bytes = packet.bytes;
        let is_foreign = !self.detection.has_layout(bytes.banks());
        self.foreign.note(is_foreign);
        if is_foreign {
            return None;
        }
        if let Some(UnitUpdate { heard, .. }) = self.unit.hear(bytes) {
            self.handover
                .clocks
                .note_utc(heard, bytes.stamp_us(), packet.arrival_ns);
            self.marks = [self.marks[1], Some(*bytes)];
        }
        let mut detection = self.detection;
        let calibration = sent_calibration(config, &self.unit, &mut detection)?;
        report.notices.push_back(Notice::Calibrated {
            calibrated: self.unit.calibrated(),
            packets: report.counts.data,
        });
        let rate_cdeg_ns = self.marks[0]
            .and_then(|mark| rate_between(&mark, bytes, detection.return_mode, detection.spec));
        Some(KnownSensor {
            detection,
            calibration,
            unit: Some(std::mem::take(&mut self.unit)),
            handover: self.handover,
            rate_cdeg_ns,
            product: 0,
        })
    }

    /// Whether another sensor has taken the place of this one.
    pub fn is_exchanged(&self) -> bool {
        self.foreign.is_exchange()
    }

    /// Why it cannot be decoded, if no more packets come.
    pub fn fault(&self) -> Fault {
        let own = self
            .unit
            .calibration()
            .map(|own| own.and_then(|own| own.for_model(self.detection.model)));
        match own {
            Some(Err(error)) => Fault::OwnCalibration(error),
            _ => {
                let (known, of) = self.unit.known();
                Fault::Uncalibrated { known, of }
            }
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
