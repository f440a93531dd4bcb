//! A sensor that is known: its packets into order, and into sweeps.

use super::identify::{ForeignRun, Handover, KnownSensor, NumberedPacket, Setup};
use super::report::{Counts, Fault, Notice, Report};
use crate::assemble::builder::{Builder, BuilderConfig};
use crate::assemble::decode::Decoder;
use crate::assemble::motion::TURN;
use crate::assemble::order::{ClockBreaks, OrderCounts, OrderedPacket, PacketOrder, Rejection};
use crate::assemble::removal::Remover;
use crate::buffers::OpenBuffer;
use crate::sensor::compare::Difference;
use crate::sensor::detect::{self, Detection};
use crate::sensor::unit::{Unit, UnitUpdate};
use crate::sensor::{Calibration, Model, ModelExt};
use crate::sweep::layout::TimeSource;
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;
use crate::wire::hdl64::Series;

/// The open sweep of a sensor that is silent for longer is closed as it is.
const STALL_NS: i64 = 500_000_000;

/// What became of the packet that came too late for its order.
pub(super) enum LatePacket {
    /// Its columns waited for it.
    Placed,
    /// Its sweep is complete already.
    Lost,
}

/// A sensor whose packets are decoded.
pub(super) struct Decoding {
    pub detection: Detection,
    /// What the sensor says of itself, and the calibration in use to compare it with.
    unit: Option<(Unit, Calibration)>,
    /// Product byte of its packets.
    pub product: u8,
    foreign: ForeignRun,
    /// Return mode of the packet before.
    last_mode: ReturnMode,
    /// Stamp of the packet before, since two returns became one and until the packets' period with
    /// one is known.
    unmeasured_us: Option<u32>,
    /// A packet that was overtaken by more than was held back.
    late: Option<OrderedPacket>,
    order: PacketOrder,
    pub builder: Builder,
    /// Whether the open sweep is closed once all packets are placed.
    closing: bool,
}

impl Decoding {
    /// Decodes the packets of this sensor from here on.
    ///
    /// # Errors
    /// [`Fault::Mask`].
    pub fn new(known: KnownSensor, setup: &Setup) -> Result<Self, Fault> {
        let KnownSensor {
            detection,
            calibration,
            unit,
            handover,
            rate_cdeg_ns,
            product,
        } = known;
        let config = &setup.config;
        let rows = calibration.rows().len();
        if let Some(mask) = &config.segment.mask
            && mask.rows() != rows
        {
            return Err(Fault::Mask {
                found: mask.rows(),
                model: detection.model,
                rows,
            });
        }
        let mut decoder = Decoder::new(
            detection.model,
            detection.spec,
            &calibration,
            config.return_choice,
            config.segment.min_range_m..=config.segment.max_range_m,
        )
        .with_level(setup.level);
        decoder.is_normalised = unit.as_ref().is_some_and(Unit::is_normalised);
        let mut order = PacketOrder::new(decoder.spec);
        order.expect_rate(rate_cdeg_ns);
        let builder_config = BuilderConfig {
            cut_cdeg: (config.cut_azimuth_rad.to_degrees() * 100.0).rem_euclid(TURN),
            return_choice: config.return_choice,
            min_points: config.segment.min_points as usize,
            sensor: setup.sensor.clone(),
        };
        let mut builder = Builder::new(decoder, builder_config);
        builder.clocks = handover.clocks;
        builder.remover = Remover::new(
            &config.removal,
            &config.segment,
            config.position_m,
            config.yaw_rad,
        )
        .map(Box::new);
        builder.sequence = handover.sweeps;
        builder.expect_rate(rate_cdeg_ns);
        Ok(Self {
            detection,
            unit: unit.map(|unit| (unit, calibration)),
            product,
            foreign: ForeignRun::default(),
            last_mode: detection.return_mode,
            unmeasured_us: None,
            late: None,
            order,
            builder,
            closing: false,
        })
    }

    /// Puts a packet in order, or counts why it has no place.
    pub fn push(&mut self, packet: &NumberedPacket<'_>, setup: &Setup, report: &mut Report) {
        let NumberedPacket {
            bytes,
            number,
            arrival_ns,
        } = *packet;
        let counts = &mut report.counts;
        let banks = bytes.banks();
        if banks.count().is_none() {
            counts.malformed += 1;
            return;
        }
        let without_confidence = bytes.without_confidence();
        let (bytes, banks) = match &without_confidence {
            Some(bytes) => (bytes, bytes.banks()),
            None => (bytes, banks),
        };
        let is_detected = setup.config.model.is_none();
        let has_product = self.detection.spec.product.is_some() && is_detected;
        let is_foreign =
            !self.detection.has_layout(banks) || has_product && bytes.product != self.product;
        self.foreign.note(is_foreign);
        if is_foreign {
            counts.foreign += 1;
            if self.foreign.is_exchange() {
                self.flush();
            }
            return;
        }
        if let Some(differences) = self.hear(bytes, arrival_ns, is_detected) {
            report
                .notices
                .push_back(Notice::OtherCalibration { differences });
        }
        let mode = self.detection.mode_of(bytes, banks, self.last_mode);
        self.measure(bytes, mode);
        self.last_mode = mode;
        match self.order.push(bytes, mode, number, arrival_ns) {
            Ok(()) => {}
            Err(Rejection::Duplicate) => counts.duplicates += 1,
            Err(Rejection::Implausible(_)) => counts.malformed += 1,
            Err(Rejection::Behind { motion, time_ns }) => {
                let packet = OrderedPacket {
                    bytes: *bytes,
                    motion,
                    mode,
                    number,
                    arrival_ns,
                    time_ns,
                };
                // It is placed by the next poll, before any other.
                counts.late += u64::from(self.late.replace(packet).is_some());
            }
        }
    }

    /// An HDL-64E S3 that reported two returns so far may have either timing when it reports one:
    /// two packets in a row tell.
    fn measure(&mut self, packet: &DataPacket, mode: ReturnMode) {
        let is_change = self.last_mode == ReturnMode::Dual && mode != ReturnMode::Dual;
        let before_us = self.unmeasured_us.take();
        let specs = self.detection.model.specs();
        let may_change = self.detection.model.is_hdl64e() && specs.len() > 1;
        if mode == ReturnMode::Dual || !may_change || !(is_change || before_us.is_some()) {
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
        is_detected: bool,
    ) -> Option<Vec<Difference>> {
        let (unit, calibration) = self.unit.as_mut()?;
        let said = unit.hear(packet);
        // The packet that tells it is the first one decoded so.
        self.builder.decoder_mut().is_normalised = unit.is_normalised();
        let UnitUpdate { series, heard } = said?;
        self.builder
            .clocks
            .note_utc(heard, packet.stamp_us(), arrival_ns);
        if series == Some(Series::S3) && is_detected {
            // Until then it may have been either: with one return their timing is the same.
            self.detection.model = Model::Hdl64eS3;
            self.builder.decoder_mut().model = Model::Hdl64eS3;
        }
        unit.differences(calibration)
            .filter(|differences| !differences.is_empty())
    }

    /// Places the packet that came too late for its order, if there is one and its columns wait
    /// for it.
    pub fn place_late(&mut self, buffer: &mut dyn OpenBuffer) -> Option<LatePacket> {
        let packet = self.late.take()?;
        Some(if self.builder.late(&packet, buffer) {
            LatePacket::Placed
        } else {
            LatePacket::Lost
        })
    }

    /// Places packets until a sweep is whole or there are no more; returns whether one is.
    pub fn advance(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        let order = &mut self.order;
        let builder = &mut self.builder;
        loop {
            // Firing by firing into columns, up to a cut.
            if let Some(index) = builder.current_packet()
                && builder.advance(order.packet(index), order.clock(), buffer)
            {
                return true;
            }
            // The next packet by the sensor's clock, with what is missing before it.
            let Some((index, before)) = order.pop() else {
                return false;
            };
            builder.begin(index, order.packet(index), before);
        }
    }

    /// Holds no packet back any more, and closes the open sweep when all are placed.
    pub fn flush(&mut self) {
        self.order.flush();
        self.closing = true;
    }

    /// Closes the open sweep, if that is due; returns whether there was one.
    pub fn close(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        self.closing = self.closing && self.builder.interrupt(self.order.clock(), buffer);
        self.closing
    }

    /// Time of the open sweep's first shot as far as it is known by now, and its clock.
    pub fn begun_ns(&self) -> Option<(i64, TimeSource)> {
        self.builder.begun_ns(self.order.clock())
    }

    /// Whether the sensor has been silent for longer than [`STALL_NS`].
    pub fn is_stalled(&self, now_ns: i64) -> bool {
        self.builder
            .newest_arrival_ns()
            .is_some_and(|newest| now_ns.saturating_sub(newest) > STALL_NS)
    }

    /// Whether another sensor has taken the place of this one.
    pub fn is_exchanged(&self) -> bool {
        self.foreign.is_exchange()
    }

    /// What goes on with the next sensor.
    pub fn handover(&self) -> Handover {
        Handover {
            clocks: self.builder.clocks,
            sweeps: self.builder.sequence,
        }
    }

    /// What an HDL-64E has said of itself.
    pub fn unit(&self) -> Option<&Unit> {
        self.unit.as_ref().map(|(unit, _)| unit)
    }

    /// How often the sensor's clock did not run on.
    pub fn clock_breaks(&self) -> ClockBreaks {
        self.order.clock_breaks()
    }

    /// Adds what order and builder have counted.
    pub fn add_to(&self, counts: &mut Counts) {
        let OrderCounts {
            reordered,
            unconfirmed,
            set_back,
        } = self.order.counts();
        counts.reordered += reordered;
        counts.set_back += set_back;
        counts.unconfirmed += unconfirmed;
        counts.lost += self.builder.lost();
        counts.removed += (self.builder.remover.as_ref()).map_or(0, |remover| remover.removed);
    }
}
