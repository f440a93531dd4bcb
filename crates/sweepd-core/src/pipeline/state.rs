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
use super::report::{Fault, Notice, Report};
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
    /// A sensor of which no more is known than what is given.
    pub fn detecting(model: Option<Model>, unit: Option<Unit>, handover: Handover) -> Self {
        State::Detecting(Box::new(Detecting::new(model, unit, handover)))
    }

    /// Takes a data packet.
    ///
    /// # Errors
    /// [`Fault`]: packets are refused from here on.
    pub fn push(
        &mut self,
        packet: &NumberedPacket<'_>,
        setup: &Setup,
        report: &mut Report,
    ) -> Result<(), Fault> {
        match self {
            State::Detecting(detecting) => {
                if let Some(result) = detecting.push(packet) {
                    return self.detected(result, setup, report);
                }
            }
            State::Calibrating(calibrating) => {
                if let Some(known) = calibrating.push(packet, &setup.config, report) {
                    // Where the sensor is refused, `?` leaves at this state.
                    *self = State::Refusing;
                    *self = State::Decoding(Box::new(Decoding::new(known, setup)?));
                }
            }
            State::Decoding(decoding) => decoding.push(packet, setup, report),
            State::Refusing => report.counts.undecoded += 1,
        }
        Ok(())
    }

    /// Nothing more will come.
    ///
    /// # Errors
    /// [`Fault`]: what came was not enough, or is of no sensor that can be decoded.
    pub fn end(&mut self, setup: &Setup, report: &mut Report) -> Result<(), Fault> {
        if let State::Detecting(detecting) = self
            && let Some(result) = detecting.conclude()
        {
            self.detected(result, setup, report)?;
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
        report: &mut Report,
    ) -> Result<(), Fault> {
        let State::Detecting(mut detecting) = std::mem::replace(self, State::Refusing) else {
            return Ok(());
        };
        // All of them, unless decoding begins with those that wait.
        report.counts.undecoded += detecting.packets();
        let detection = result?;
        if let Some(given) = &setup.config.calibration
            && given.has_mistaken_unit(detection.model)
        {
            report.notices.push_back(Notice::MistakenUnit {
                found_m: given.distance_unit_m(),
                used_m: detection.spec.distance_unit_m,
            });
        }
        match detecting.identify(detection, &setup.config)? {
            Identity::AwaitsCalibration(calibrating) => {
                report.notices.push_back(Notice::AwaitsCalibration);
                *self = State::Calibrating(calibrating);
            }
            Identity::Known(known) => {
                let mut decoding = Decoding::new(*known, setup)?;
                report.counts.reordered += detecting.sort();
                for packet in detecting.waiting() {
                    report.counts.undecoded -= 1;
                    decoding.push(&packet, setup, report);
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
    pub fn clocks(&self) -> Option<&Clocks> {
        match self {
            State::Detecting(detecting) => Some(&detecting.handover.clocks),
            State::Calibrating(calibrating) => Some(&calibrating.handover.clocks),
            State::Decoding(decoding) => Some(&decoding.builder.clocks),
            State::Refusing => None,
        }
    }

    /// The same, to be noted in.
    pub fn clocks_mut(&mut self) -> Option<&mut Clocks> {
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

    /// What is known of the HDL-64E that this is, or is expected to be.
    pub fn known_unit(&self) -> Option<&Unit> {
        match self {
            State::Detecting(detecting) => detecting.unit.as_ref(),
            _ => self.unit(),
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
