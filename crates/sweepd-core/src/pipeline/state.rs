//! What a pipeline knows of its sensor.
//!
//! ```text
//! Detecting -> Decoding                   most models: the table in `calib/`, or a given file
//! Detecting -> Calibrating -> Decoding    an HDL-64E without a file: its packets tell, unless it is known from before
//! any -> Refusing                         nothing that can be decoded
//! Decoding, Calibrating -> Detecting      another sensor took its place
//! ```

use super::decoding::Decoding;
use super::identify::{Calibrating, Detecting, Handover, Identity, NumberedPacket, Setup};
use super::report::{Events, Fault, Notice};
use crate::assemble::clock::Clocks;
use crate::sensor::Model;
use crate::sensor::detect::{DetectError, Detection};
use crate::sensor::unit::Unit;

pub(super) enum State {
    /// Which model is it?
    Detecting(Box<Detecting>),
    /// Where do its beams point?
    Calibrating(Box<Calibrating>),
    /// It is this one.
    Decoding(Box<Decoding>),
    /// None that can be decoded.
    Refusing,
}

impl State {
    /// A sensor of which nothing is known, unless its model is given.
    pub fn detecting(model: Option<Model>, handover: Handover) -> Self {
        State::Detecting(Box::new(Detecting::new(model, handover)))
    }

    /// Takes a data packet.
    ///
    /// # Errors
    /// [`Fault`]: packets are refused from here on.
    pub fn push(
        &mut self,
        packet: &NumberedPacket<'_>,
        setup: &Setup,
        events: &mut Events,
    ) -> Result<(), Fault> {
        match self {
            State::Detecting(detecting) => {
                if let Some(result) = detecting.push(packet) {
                    return self.detected(result, setup, events);
                }
            }
            State::Calibrating(calibrating) => {
                if let Some(known) = calibrating.push(packet, &setup.config, events) {
                    *self = State::Refusing;
                    *self = State::Decoding(Box::new(Decoding::new(known, setup)?));
                }
            }
            State::Decoding(decoding) => decoding.push(packet, setup, events),
            State::Refusing => events.counts.undecoded += 1,
        }
        Ok(())
    }

    /// Nothing more will come.
    ///
    /// # Errors
    /// [`Fault`]: what came was not enough, or is of no sensor that can be decoded.
    pub fn end(&mut self, setup: &Setup, events: &mut Events) -> Result<(), Fault> {
        if let State::Detecting(detecting) = self
            && let Some(result) = detecting.conclude()
        {
            self.detected(result, setup, events)?;
        }
        match self {
            State::Decoding(decoding) => decoding.flush(),
            State::Calibrating(calibrating) => {
                let fault = calibrating.fault();
                *self = State::Refusing;
                return Err(fault);
            }
            State::Detecting(_) | State::Refusing => {}
        }
        Ok(())
    }

    /// Ends the detection: decoding begins with the packets that waited, or the wait for the
    /// calibration does.
    fn detected(
        &mut self,
        result: Result<Detection, DetectError>,
        setup: &Setup,
        events: &mut Events,
    ) -> Result<(), Fault> {
        let State::Detecting(mut detecting) = std::mem::replace(self, State::Refusing) else {
            return Ok(());
        };
        // All of them, unless decoding begins with those that wait.
        events.counts.undecoded += detecting.packets();
        let detection = result?;
        if let Some(given) = &setup.config.calibration
            && given.has_mistaken_unit(detection.model)
        {
            events.notices.push(Notice::MistakenUnit {
                found_m: given.distance_unit_m(),
                used_m: detection.spec.distance_unit_m,
            });
        }
        match detecting.identify(detection, &setup.config)? {
            Identity::AwaitsCalibration(calibrating) => {
                events.notices.push(Notice::AwaitsCalibration);
                *self = State::Calibrating(calibrating);
            }
            Identity::Known(known) => {
                let mut decoding = Decoding::new(*known, setup)?;
                events.counts.reordered += detecting.sort();
                for packet in detecting.waiting() {
                    events.counts.undecoded -= 1;
                    decoding.push(&packet, setup, events);
                }
                *self = State::Decoding(Box::new(decoding));
            }
        }
        Ok(())
    }

    /// The sensor, if it is decoded.
    pub fn decoding(&self) -> Option<&Decoding> {
        match self {
            State::Decoding(decoding) => Some(decoding),
            _ => None,
        }
    }

    /// The sensor, if it is decoded.
    pub fn decoding_mut(&mut self) -> Option<&mut Decoding> {
        match self {
            State::Decoding(decoding) => Some(decoding),
            _ => None,
        }
    }

    /// What brings the sensor's time to time since 1970.
    pub fn clocks(&mut self) -> Option<&mut Clocks> {
        match self {
            State::Detecting(detecting) => Some(&mut detecting.handover.clocks),
            State::Calibrating(calibrating) => Some(&mut calibrating.handover.clocks),
            State::Decoding(decoding) => Some(&mut decoding.builder.clocks),
            State::Refusing => None,
        }
    }

    /// The model, and how it was detected, once it is known.
    pub fn detection(&self) -> Option<Detection> {
        match self {
            State::Decoding(decoding) => Some(decoding.detection),
            State::Calibrating(calibrating) => Some(calibrating.detection),
            State::Detecting(_) | State::Refusing => None,
        }
    }

    /// What an HDL-64E says of itself, as far as it has been heard.
    pub fn unit(&self) -> Option<&Unit> {
        match self {
            State::Decoding(decoding) => decoding.unit(),
            State::Calibrating(calibrating) => Some(&calibrating.unit),
            State::Detecting(_) | State::Refusing => None,
        }
    }

    /// Expects the HDL-64E of which this is known, before the first packet.
    pub fn expect_unit(&mut self, known: Option<Unit>) {
        if let State::Detecting(detecting) = self {
            detecting.unit = known;
        }
    }

    /// What is known of the HDL-64E that this is, or is expected to be.
    pub fn into_unit(self) -> Option<Unit> {
        match self {
            State::Detecting(detecting) => detecting.unit,
            State::Calibrating(calibrating) => Some(calibrating.unit),
            State::Decoding(decoding) => decoding.into_unit(),
            State::Refusing => None,
        }
    }

    /// What goes on with the next sensor, if another one has taken the place of this one.
    pub fn exchanged(&self) -> Option<Handover> {
        match self {
            State::Calibrating(calibrating) if calibrating.is_exchanged() => {
                Some(calibrating.handover)
            }
            State::Decoding(decoding) if decoding.is_exchanged() => Some(decoding.handover()),
            _ => None,
        }
    }
}
