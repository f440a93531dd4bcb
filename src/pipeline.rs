//! The whole algorithm on one page: datagrams of one sensor in, labelled sweeps out.
//!
//! Pure: bytes and time come in as arguments. Live, replay and tests push the same datagrams through here, so the same
//! bytes give the same sweeps.
//!
//! ```text
//! push(datagram)   what arrived                 poll()   the next sweep that is whole, segmented
//! tick(now)        nothing arrived for a while  end()    nothing will arrive any more
//! ```

use crate::segment::{self, ConfigError, Segmenter};
use crate::sensor::compare::Difference;
use crate::sensor::detect::{DetectError, Detection, Detector, MAX_PACKETS};
use crate::sensor::unit::{Said, Unit};
use crate::sensor::{Calibration, Model};
use crate::sweep::builder::{Builder, Settings};
use crate::sweep::clock::{Clocks, SensorClock};
use crate::sweep::decode::Decoder;
use crate::sweep::layout::ReturnChoice;
use crate::sweep::motion::{TURN, rate_between};
use crate::sweep::order::{Order, OrderCounts, Packet, Refusal};
use crate::sweep::{Buffers, SweepMut};
use crate::wire::data::{Banks, ReturnMode};
use crate::wire::hdl64::{CalibrationTime, Series};
use crate::wire::position::POSITION_PACKET_LEN;
use crate::wire::{DataPacket, Datagram, Position};

/// After so much silence the open sweep is closed as it is.
const STALL_NS: i64 = 500_000_000;
/// Packets in a row with another product byte after which the sensor counts as exchanged.
const EXCHANGED_PACKETS: u32 = 8;

/// Packets that must speak of an unsupported sensor before it is believed.
const DOUBTS: u32 = 3;

/// How a sensor's packets are to be read and its sweeps cut and segmented.
#[derive(Clone, Debug)]
pub struct Config {
    /// The model; `None` detects it.
    pub model: Option<Model>,
    /// The unit's calibration; `None` takes the model's table, or the one that an HDL-64E sends with its packets.
    pub calibration: Option<Calibration>,
    /// Azimuth at which sweeps are cut, radians.
    pub cut_azimuth_rad: f64,
    /// Which of two returns is segmented.
    pub return_choice: ReturnChoice,
    /// How sweeps are segmented.
    pub segment: segment::Config,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: None,
            calibration: None,
            cut_azimuth_rad: 0.0,
            return_choice: ReturnChoice::Nearest,
            segment: segment::Config::default(),
        }
    }
}

/// Reads a clock, for the times spent on each stage; the core itself has none.
pub trait Stopwatch {
    /// Nanoseconds since any fixed moment.
    fn now_ns(&self) -> u64;
}

/// A stopwatch that stands still: all times are 0.
#[derive(Clone, Copy, Debug, Default)]
pub struct Untimed;

impl Stopwatch for Untimed {
    fn now_ns(&self) -> u64 {
        0
    }
}

/// What became of a sensor's datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Data packets that arrived, by length.
    pub data: u64,
    /// Position packets that arrived, by length.
    pub position: u64,
    /// Data packets with a wrong marker, an impossible azimuth, or azimuths of no turning head.
    pub malformed: u64,
    /// Byte-identical copies.
    pub duplicates: u64,
    /// Packets that were overtaken and put back in order.
    pub reordered: u64,
    /// Packets missing by the sensor's clock.
    pub lost: u64,
    /// Packets that came too late for their sweep.
    pub late: u64,
    /// Packets whose clock or return mode no neighbour confirmed.
    pub unconfirmed: u64,
    /// Packets with another sensor's product byte.
    pub foreign: u64,
    /// Packets that came before the model was known and after it proved to be unsupported, and those of an HDL-64E before
    /// its calibration was.
    pub undecoded: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.data += other.data;
        self.position += other.position;
        self.malformed += other.malformed;
        self.duplicates += other.duplicates;
        self.reordered += other.reordered;
        self.lost += other.lost;
        self.late += other.late;
        self.unconfirmed += other.unconfirmed;
        self.foreign += other.foreign;
        self.undecoded += other.undecoded;
    }
}

/// Why a sensor's packets cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The model is unknown, unsupported or contradicted.
    #[error(transparent)]
    Model(#[from] DetectError),
    /// The calibration that was given is of another model.
    #[error("the calibration does not fit: {0}")]
    Calibration(String),
    /// The calibration that an HDL-64E sends is impossible.
    #[error("the calibration in its packets cannot be used: {0}; give the file of this unit with --calibration")]
    OwnCalibration(String),
    /// The packets of an HDL-64E ended before they had told its calibration.
    #[error(
        "no calibration: {known} of the {of} bytes of the one in its packets had come when they ended, and a whole one takes \
         4160 packets; give the file of this unit with --calibration"
    )]
    Uncalibrated {
        /// Bytes that had come.
        known: usize,
        /// Bytes that there are.
        of: usize,
    },
    /// The mask has not as many rows as the sensor.
    #[error("the mask is {found} pixels high, a {model} has {rows} rows; make it one row a beam")]
    Mask {
        /// Rows of the mask.
        found: usize,
        /// The sensor.
        model: Model,
        /// Its rows.
        rows: usize,
    },
}

/// What happened that people want to know of, apart from the sweeps.
#[derive(Clone, Debug, PartialEq)]
pub enum Notice {
    /// An HDL-64E is known and no calibration was given: nothing is decoded until the one in its packets is complete.
    AwaitsCalibration {
        /// The model.
        model: Model,
    },
    /// It is complete, and decoding begins.
    Calibrated {
        /// When the unit was calibrated, by its own account.
        calibrated: Option<CalibrationTime>,
        /// Data packets that came before.
        packets: u64,
    },
    /// The calibration in use is not the one that the unit sends.
    OtherCalibration {
        /// In what they differ, by beam: the one in use, the unit's own.
        differences: Vec<Difference>,
    },
}

/// One sensor's way from datagrams to labelled sweeps.
pub struct Pipeline<B: Buffers, W: Stopwatch> {
    config: Config,
    sensor: String,
    watch: W,
    state: State<B>,
    segmenter: Segmenter,
    counts: Counts,
    /// Ordinal of the next data packet.
    next_number: u64,
    closing: Closing,
    notices: Vec<Notice>,
}

enum State<B: Buffers> {
    /// Which model is it? The packets so far wait for the answer.
    Detecting(Box<Detecting<B>>),
    /// Where do its beams point? Its packets tell, a byte each.
    Calibrating(Box<Calibrating<B>>),
    /// It is this one.
    Decoding(Box<Decoding<B>>),
    /// None that can be decoded.
    Refusing,
}

struct Detecting<B: Buffers> {
    detector: Detector,
    waiting: Vec<Waiting>,
    /// Packets that spoke of no supported sensor, and what the last one said.
    doubts: u32,
    doubt: Option<DetectError>,
    buffers: B,
    clocks: Clocks,
}

struct Calibrating<B: Buffers> {
    detection: Detection,
    unit: Unit,
    foreign: u32,
    /// The packets at the last two cycles of the status: from there on, how far the head turned tells its speed.
    marks: [Option<DataPacket>; 2],
    buffers: B,
    clocks: Clocks,
}

struct Decoding<B: Buffers> {
    detection: Detection,
    /// What the sensor says of itself, and the calibration in use to hold it against.
    unit: Option<(Unit, Calibration)>,
    /// Product byte of its packets, and how many others came in a row.
    product: u8,
    foreign: u32,
    /// Return mode of the packet before.
    last_mode: ReturnMode,
    order: Order,
    builder: Builder<B>,
}

struct Waiting {
    bytes: DataPacket,
    number: u64,
    arrival_ns: i64,
}

/// Whether the open sweep is to be closed when all packets are placed, and why.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Closing {
    No,
    Silence,
    Exchanged,
}

impl<B: Buffers, W: Stopwatch> Pipeline<B, W> {
    /// A pipeline for the sensor of this name, which has seen nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`]: no sweep can be segmented like that.
    pub fn new(sensor: &str, config: Config, buffers: B, watch: W) -> Result<Self, ConfigError> {
        let segmenter = Segmenter::new(config.segment.clone())?;
        let state = Self::detecting(config.model, buffers, Clocks::default());
        let counts = Counts::default();
        let sensor = sensor.to_owned();
        Ok(Self {
            config,
            sensor,
            watch,
            state,
            segmenter,
            counts,
            next_number: 0,
            closing: Closing::No,
            notices: Vec::new(),
        })
    }

    /// Takes a datagram of this sensor. Call [`Pipeline::poll`] until it is empty before the next one.
    ///
    /// # Errors
    /// [`Fault`], once, when the packets turn out to be of no model that can be decoded; all that follow are counted.
    pub fn push(&mut self, datagram: &Datagram<'_>) -> Result<(), Fault> {
        if datagram.payload.len() == POSITION_PACKET_LEN {
            self.position(datagram);
            return Ok(());
        }
        let number = self.next_number;
        self.next_number += 1;
        self.counts.data += 1;
        let Ok(packet) = DataPacket::parse(datagram.payload) else {
            self.counts.malformed += 1;
            return Ok(());
        };
        match &mut self.state {
            State::Detecting(detecting) => {
                match detecting.observe(Waiting { bytes: *packet, number, arrival_ns: datagram.arrival_ns }) {
                    Some(result) => self.detected(result),
                    None => Ok(()),
                }
            }
            State::Calibrating(_) => self.calibrate(packet, datagram.arrival_ns),
            State::Decoding(_) => {
                self.order(packet, number, datagram.arrival_ns);
                Ok(())
            }
            State::Refusing => {
                self.counts.undecoded += 1;
                Ok(())
            }
        }
    }

    /// Passes a data packet over, undecoded: the ordinals of those that follow count it all the same.
    pub fn pass_over(&mut self) {
        self.next_number += 1;
    }

    /// The next sweep that is whole, labelled; see [`SweepRef::open`](crate::sweep::SweepRef::open).
    pub fn poll(&mut self) -> Option<B::Buffer> {
        let begun_ns = self.watch.now_ns();
        let State::Decoding(decoding) = &mut self.state else { return self.close() };
        let Decoding { order, builder, .. } = &mut **decoding;
        let whole = loop {
            // Firing by firing into columns, up to a cut.
            if let Some(slot) = builder.at_hand()
                && let Some(sweep) = builder.advance(order.packet(slot), order.clock())
            {
                break Some(sweep);
            }
            // The next packet by the sensor's clock, with what is missing before it.
            let Some((slot, before)) = order.pop() else { break None };
            builder.begin(slot, order.packet(slot), before);
        };
        builder.spent(self.watch.now_ns() - begun_ns);
        let whole = whole.or_else(|| self.close())?;
        Some(self.segment(whole))
    }

    /// Tells the time while nothing arrives: a sweep that stalled is to be closed as it is. Whether there is one: then it
    /// comes out at the next [`Pipeline::poll`].
    pub fn tick(&mut self, now_ns: i64) -> bool {
        if let State::Decoding(decoding) = &mut self.state
            && decoding.builder.newest_arrival_ns().is_some_and(|newest| now_ns.saturating_sub(newest) > STALL_NS)
        {
            decoding.order.flush();
            self.closing = Closing::Silence;
            return true;
        }
        false
    }

    /// Nothing more will come: the packets held back and the open sweep come out at the next [`Pipeline::poll`].
    ///
    /// # Errors
    /// [`Fault`], when there were too few packets to tell the model before and it proves to be none that can be decoded.
    pub fn end(&mut self) -> Result<(), Fault> {
        if let State::Detecting(detecting) = &self.state
            && let Some(result) = detecting.conclude()
        {
            self.detected(result)?;
        }
        match &mut self.state {
            State::Decoding(decoding) => {
                decoding.order.flush();
                self.closing = Closing::Silence;
            }
            State::Calibrating(calibrating) => {
                let (known, of) = calibrating.unit.known();
                self.state = State::Refusing;
                return Err(Fault::Uncalibrated { known, of });
            }
            State::Detecting(_) | State::Refusing => {}
        }
        Ok(())
    }

    /// What happened since this was asked last.
    pub fn take_notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    /// The model and how it was told, once it is known.
    pub fn detection(&self) -> Option<Detection> {
        match &self.state {
            State::Decoding(decoding) => Some(decoding.detection),
            State::Calibrating(calibrating) => Some(calibrating.detection),
            State::Detecting(_) | State::Refusing => None,
        }
    }

    /// What became of the datagrams so far.
    pub fn counts(&self) -> Counts {
        let mut counts = self.counts;
        if let State::Decoding(decoding) = &self.state {
            let OrderCounts { reordered, unconfirmed } = decoding.order.counts();
            counts.reordered += reordered;
            counts.unconfirmed += unconfirmed;
            counts.lost += decoding.builder.lost();
        }
        counts
    }

    /// The paper's two steps, on a whole sweep and in place: take the ground away, join what is left.
    fn segment(&mut self, mut whole: B::Buffer) -> B::Buffer {
        let Ok(mut sweep) = SweepMut::open(whole.as_mut()) else { return whole };
        let begun_ns = self.watch.now_ns();
        self.segmenter.prepare(&sweep);
        self.segmenter.find_ground(&mut sweep);
        let without_ground_ns = self.watch.now_ns();
        self.segmenter.connect(&mut sweep);
        self.segmenter.describe(&mut sweep);
        let labelled_ns = self.watch.now_ns();
        sweep.header.ground_ns = (without_ground_ns - begun_ns) as u32;
        sweep.header.label_ns = (labelled_ns - without_ground_ns) as u32;
        whole
    }

    fn detecting(model: Option<Model>, buffers: B, clocks: Clocks) -> State<B> {
        let (detector, waiting) = (Detector::new(model), Vec::with_capacity(MAX_PACKETS));
        State::Detecting(Box::new(Detecting { detector, waiting, doubts: 0, doubt: None, buffers, clocks }))
    }

    /// The model is told: decoding begins with the packets that waited, or the wait for the calibration does.
    fn detected(&mut self, result: Result<Detection, DetectError>) -> Result<(), Fault> {
        let State::Detecting(detecting) = std::mem::replace(&mut self.state, State::Refusing) else { return Ok(()) };
        let Detecting { waiting, doubts, buffers, clocks, .. } = *detecting;
        self.counts.undecoded += u64::from(doubts) + waiting.len() as u64;
        let detection = result?;
        let calibration = match &self.config.calibration {
            Some(given) => given.clone().for_model(detection.model).map_err(Fault::Calibration)?,
            None => match detection.model.calibration() {
                Some(nominal) => nominal.clone(),
                None => {
                    let mut unit = Unit::default();
                    for packet in &waiting {
                        let _ = unit.hear(&packet.bytes);
                    }
                    self.notices.push(Notice::AwaitsCalibration { model: detection.model });
                    let calibrating = Calibrating { detection, unit, foreign: 0, marks: [None; 2], buffers, clocks };
                    self.state = State::Calibrating(Box::new(calibrating));
                    return Ok(());
                }
            },
        };
        let unit = detection.model.is_hdl64e().then(Unit::default);
        let ends = waiting.first().zip(waiting.last()).map(|(first, last)| (&first.bytes, &last.bytes));
        let rate = ends.and_then(|(first, last)| rate_between(first, last, detection.return_mode, detection.spec));
        self.decode(detection, (calibration, unit), (buffers, clocks, rate), waiting)
    }

    /// Takes the byte of the calibration that a packet brings; with the last one, decoding begins.
    fn calibrate(&mut self, packet: &DataPacket, arrival_ns: i64) -> Result<(), Fault> {
        let State::Calibrating(calibrating) = &mut self.state else { return Ok(()) };
        self.counts.undecoded += 1;
        if !calibrating.detection.has_layout(packet) {
            calibrating.foreign += 1;
            self.closing = if calibrating.foreign >= EXCHANGED_PACKETS { Closing::Exchanged } else { Closing::No };
            return Ok(());
        }
        calibrating.foreign = 0;
        if let Some(Said { utc_ns, .. }) = calibrating.unit.hear(packet) {
            calibrating.clocks.said(utc_ns, packet.stamp_us(), arrival_ns);
            calibrating.marks = [calibrating.marks[1], Some(*packet)];
        }
        let Some(calibration) = calibrating.unit.calibration() else { return Ok(()) };
        let State::Calibrating(calibrating) = std::mem::replace(&mut self.state, State::Refusing) else {
            return Ok(());
        };
        let Calibrating { mut detection, unit, marks, buffers, clocks, .. } = *calibrating;
        let calibration = calibration.and_then(|own| own.for_model(detection.model)).map_err(Fault::OwnCalibration)?;
        // With one return, only the unit itself knows which.
        if let (ReturnMode::Strongest, Some(ReturnMode::Last)) = (detection.return_mode, unit.return_mode()) {
            detection.return_mode = ReturnMode::Last;
        }
        self.notices.push(Notice::Calibrated { calibrated: unit.calibrated(), packets: self.counts.data });
        let rate = marks[0].and_then(|mark| rate_between(&mark, packet, detection.return_mode, detection.spec));
        self.decode(detection, (calibration, Some(unit)), (buffers, clocks, rate), Vec::new())
    }

    /// Builds what decodes this model and gives it the packets that waited.
    fn decode(
        &mut self,
        detection: Detection,
        (calibration, unit): (Calibration, Option<Unit>),
        (buffers, clocks, rate_cdeg_ns): (B, Clocks, Option<f64>),
        mut waiting: Vec<Waiting>,
    ) -> Result<(), Fault> {
        if let Some(mask) = self.config.segment.mask.as_ref().filter(|mask| mask.rows() != calibration.rows().len()) {
            let (found, rows) = (mask.rows(), calibration.rows().len());
            return Err(Fault::Mask { found, model: detection.model, rows });
        }
        self.counts.undecoded -= waiting.len() as u64;
        let limits_m = self.config.segment.min_range_m..=self.config.segment.max_range_m;
        let model = (detection.model, detection.spec);
        let decoder = Decoder::new(model, &calibration, self.config.return_choice, limits_m);
        let mut order = Order::new(decoder.spec);
        order.expect_rate(rate_cdeg_ns);
        let mut builder = Builder::new(buffers, decoder, self.settings());
        builder.clocks = clocks;
        builder.expect_rate(rate_cdeg_ns);
        let product = waiting.last().map_or(0, |packet| packet.bytes.product);
        let unit = unit.map(|unit| (unit, calibration));
        let last_mode = detection.return_mode;
        let decoding = Decoding { detection, unit, product, foreign: 0, last_mode, order, builder };
        self.state = State::Decoding(Box::new(decoding));
        self.counts.reordered += sort_by_stamp(&mut waiting);
        for packet in &waiting {
            self.order(&packet.bytes, packet.number, packet.arrival_ns);
        }
        Ok(())
    }

    fn settings(&self) -> Settings {
        Settings {
            cut_cdeg: (self.config.cut_azimuth_rad.to_degrees() * 100.0).rem_euclid(TURN),
            return_choice: self.config.return_choice,
            min_points: self.config.segment.min_points as usize,
            sensor: self.sensor.clone(),
        }
    }

    /// Puts a packet in order, or counts why it has no place.
    fn order(&mut self, packet: &DataPacket, number: u64, arrival_ns: i64) {
        let State::Decoding(decoding) = &mut self.state else { return };
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
        decoding.last_mode = mode;
        match decoding.order.push(packet, mode, number, arrival_ns) {
            Ok(()) => {}
            Err(Refusal::Duplicate) => self.counts.duplicates += 1,
            Err(Refusal::Implausible(_)) => self.counts.malformed += 1,
            Err(Refusal::Behind { motion, time_ns }) => {
                let packet = Packet { bytes: *packet, motion, mode, number, arrival_ns, time_ns };
                if decoding.builder.late(&packet) {
                    self.counts.reordered += 1;
                } else {
                    self.counts.late += 1;
                }
            }
        }
    }

    fn position(&mut self, datagram: &Datagram<'_>) {
        self.counts.position += 1;
        let Ok(position) = Position::parse(datagram.payload) else { return };
        match &mut self.state {
            State::Detecting(detecting) => detecting.clocks.position(&position, datagram.arrival_ns),
            State::Calibrating(calibrating) => calibrating.clocks.position(&position, datagram.arrival_ns),
            State::Decoding(decoding) => decoding.builder.clocks.position(&position, datagram.arrival_ns),
            State::Refusing => {}
        }
    }

    /// All packets are placed: closes the open sweep if that is due, and begins anew with another sensor.
    fn close(&mut self) -> Option<B::Buffer> {
        if self.closing == Closing::No {
            return None;
        }
        if let State::Decoding(decoding) = &mut self.state
            && let Some(sweep) = decoding.builder.interrupt(decoding.order.clock())
        {
            return Some(sweep);
        }
        if std::mem::replace(&mut self.closing, Closing::No) == Closing::Exchanged {
            self.counts = self.counts();
            let (buffers, clocks) = match std::mem::replace(&mut self.state, State::Refusing) {
                State::Decoding(decoding) => decoding.builder.into_parts(),
                State::Calibrating(calibrating) => (calibrating.buffers, calibrating.clocks),
                other => {
                    self.state = other;
                    return None;
                }
            };
            self.state = Self::detecting(self.config.model, buffers, clocks);
        }
        None
    }
}

impl<B: Buffers> Decoding<B> {
    /// Listens to what an HDL-64E says of itself. Gives in what its calibration differs from the one in use, once it is
    /// known and if it does.
    fn hear(&mut self, packet: &DataPacket, arrival_ns: i64, may_rename: bool) -> Option<Vec<Difference>> {
        let (unit, calibration) = self.unit.as_mut()?;
        let Said { series, is_normalised, utc_ns } = unit.hear(packet)?;
        self.builder.clocks.said(utc_ns, packet.stamp_us(), arrival_ns);
        self.builder.decoder_mut().is_normalised = is_normalised;
        if series == Some(Series::S3) && may_rename {
            // Until then it may have been either: with one return their timing is the same.
            self.detection.model = Model::Hdl64eS3;
            self.builder.decoder_mut().model = Model::Hdl64eS3;
        }
        unit.differences(calibration).filter(|differences| !differences.is_empty())
    }
}

impl<B: Buffers> Detecting<B> {
    /// Looks at a packet and keeps it. One that speaks of no supported sensor may be corrupt: only the third is believed.
    fn observe(&mut self, packet: Waiting) -> Option<Result<Detection, DetectError>> {
        let result = self.detector.observe(&packet.bytes);
        if let Some(Err(error @ (DetectError::Unsupported { .. } | DetectError::UnknownProduct { .. }))) = result
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
    fn conclude(&self) -> Option<Result<Detection, DetectError>> {
        match self.doubt {
            Some(doubt) if self.waiting.is_empty() => Some(Err(doubt)),
            _ if self.waiting.is_empty() => None,
            _ => Some(self.detector.conclude()),
        }
    }
}

/// Sorts by the sensor's clock, over the hour if need be; returns how many packets had been overtaken.
fn sort_by_stamp(waiting: &mut [Waiting]) -> u64 {
    let Some(first) = waiting.first().map(|packet| packet.bytes.stamp_us()) else { return 0 };
    let mut clock = SensorClock::default();
    clock.set(first, 0);
    let time_ns = |packet: &Waiting| clock.read_ns(packet.bytes.stamp_us());
    let mut newest_ns = i64::MIN;
    let mut overtaken = 0;
    for packet in waiting.iter() {
        overtaken += u64::from(time_ns(packet) < newest_ns);
        newest_ns = newest_ns.max(time_ns(packet));
    }
    waiting.sort_by_key(time_ns);
    overtaken
}
