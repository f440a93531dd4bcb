//! Cures for a sensor that cannot be decoded. The core gives the fault; the name of a setting
//! depends on where the user sets it.

use sweepd_core::pipeline::Fault;
use sweepd_core::sensor::detect::DetectError;
use sweepd_core::sensor::{Model, ModelExt};

/// Where the user sets options, which decides their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// Options of a command.
    CommandLine,
    /// Keys of the daemon's configuration.
    Configuration,
}

impl Dialect {
    fn model(self) -> &'static str {
        match self {
            Self::CommandLine => "--model",
            Self::Configuration => "`model`",
        }
    }

    fn calibration(self) -> &'static str {
        match self {
            Self::CommandLine => "--calibration",
            Self::Configuration => "`calibration`",
        }
    }
}

/// A fault and its cure, in one sentence.
pub fn explain(fault: &Fault, dialect: Dialect) -> String {
    format!("{fault}; {}", cure(fault, dialect))
}

fn cure(fault: &Fault, dialect: Dialect) -> String {
    match fault {
        Fault::Model(error) => cure_model(error, dialect),
        Fault::Calibration(_) => format!(
            "give the file of this unit, or leave {} away",
            dialect.calibration()
        ),
        Fault::OwnCalibration(_) | Fault::Uncalibrated { .. } => {
            format!("give the file of this unit with {}", dialect.calibration())
        }
        Fault::Mask { .. } => "make it one row a beam".to_owned(),
    }
}

/// Why the model cannot be detected, and the cure, in one sentence.
pub fn explain_model(error: &DetectError, dialect: Dialect) -> String {
    format!("{error}; {}", cure_model(error, dialect))
}

fn cure_model(error: &DetectError, dialect: Dialect) -> String {
    let key = dialect.model();
    match error {
        DetectError::Unsupported { .. } => format!("supported are {}", supported()),
        DetectError::UnknownProduct { .. } => {
            format!("if it is one of {}, say so with {key}", supported())
        }
        DetectError::Contradiction {
            given: true,
            timing,
            ..
        } => format!("leave {key} away, or give {}", timing.flag()),
        DetectError::Contradiction { timing, .. } => {
            format!("if it is one, give {} with {key}", timing.flag())
        }
        DetectError::Layout { banks, .. } => {
            let fitting = Model::ALL
                .into_iter()
                .map(|model| model.spec())
                .filter(|spec| banks.count() == Some(spec.banks()))
                .map(|spec| spec.model.flag());
            let flags = fitting.collect::<Vec<_>>().join(", ");
            format!("leave {key} away, or give one of {flags}")
        }
        DetectError::UnknownPeriod { .. } => format!(
            "{key} cannot help: is this another sensor, two sensors behind one address, or a capture with most packets \
             lost?"
        ),
        DetectError::Clock { .. } => {
            "let the simulator or gateway that sends them stamp each with its microsecond of the hour, as a sensor does"
                .to_owned()
        }
        DetectError::TooFewPackets { .. } => {
            format!("supported are {}: say which with {key}", supported())
        }
    }
}

/// The supported models, for a sentence.
fn supported() -> String {
    Model::ALL
        .map(|model| format!("{model} ({})", model.flag()))
        .join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cure_names_the_setting_where_it_is_made() {
        let fault = Fault::Model(DetectError::Contradiction {
            said: Model::Vlp16,
            given: true,
            timing: Model::Hdl32e,
            interval_us: 553,
        });
        assert_eq!(
            explain(&fault, Dialect::CommandLine),
            "the given model is VLP-16, but packets come 553 us apart, as those of the HDL-32E do; leave --model away, or \
             give hdl32e"
        );
        assert!(
            explain(&fault, Dialect::Configuration)
                .ends_with("; leave `model` away, or give hdl32e")
        );
    }
}
