//! Checks that a calibration is of a model; gives a model's nominal calibration.

use std::sync::OnceLock;

use super::{Beam, Calibration, Model, ModelExt, ros_yaml};

/// Greatest deviation of a beam from its nominal elevation: much more than units differ, much less
/// than models do.
const MAX_ELEVATION_ERROR_DEG: f64 = 0.5;
/// Greatest rotation of a beam on a model whose beams all point the same way.
const MAX_ROTATION_DEG: f64 = 0.1;
/// Greatest rotation of a beam on a model whose beams point to the side; those of real units stay
/// under
/// 10. More would shift rows by more columns than a sweep has room for.
const MAX_ASIDE_DEG: f64 = 12.0;

/// The nominal beams of a model: see [`ModelExt::calibration`].
pub(super) fn nominal(model: Model) -> Option<&'static Calibration> {
    static TABLES: [OnceLock<Calibration>; Model::ALL.len()] =
        [const { OnceLock::new() }; Model::ALL.len()];
    let nominal = model.spec().nominal.as_ref()?;
    Some(TABLES[model as usize].get_or_init(|| {
        ros_yaml::parse(nominal.text, nominal.file)
            .expect("the tables in calib/ are part of the program and tested")
    }))
}

impl Calibration {
    /// Fits a calibration to a model: a db.xml always has 64 entries, of which a smaller model uses
    /// the first.
    ///
    /// # Errors
    /// A sentence, if beams, elevations, rotations or distance unit cannot be of this model; it
    /// names the supported model that they fit, if there is one.
    pub fn for_model(self, model: Model) -> Result<Self, String> {
        if let Err(message) = self.fit(model) {
            let other = Model::ALL
                .into_iter()
                .find(|&other| self.fit(other).is_ok());
            return Err(match other {
                Some(other) => format!("{message}; this is the calibration of the {other}"),
                None => message,
            });
        }
        let spec = model.spec();
        let beams = self.beams()[..spec.channels].to_vec();
        Self::new(beams, spec.distance_unit_m)
    }

    /// Whether the unit of distance is one that files of this model have by mistake, so that
    /// [`Calibration::for_model`] sets it right. That of `VLS128.yaml` of ros-drivers is 7 mm; its
    /// readers take 4 mm, as the sensor does.
    pub fn has_mistaken_unit(&self, model: Model) -> bool {
        let mistaken_m = model.spec().mistaken_unit_m;
        mistaken_m.is_some_and(|unit_m| (self.distance_unit_m() - unit_m).abs() < 1e-6)
    }

    /// The model whose beams these are, whatever their unit of distance. The beams of most models are
    /// known, and any other 64 are those of an HDL-64E.
    pub(super) fn of_beams(beams: &[Beam]) -> Option<Model> {
        let has_beams = |model: &Model| {
            let calibration = Self::new(beams.to_vec(), model.spec().distance_unit_m);
            calibration.is_ok_and(|calibration| calibration.fit(*model).is_ok())
        };
        let (known, others): (Vec<_>, Vec<_>) = Model::ALL
            .into_iter()
            .partition(|model| model.spec().nominal.is_some());
        known.into_iter().chain(others).find(has_beams)
    }

    /// Checks that these can be the beams of a model; the error gives the contradiction.
    fn fit(&self, model: Model) -> Result<(), String> {
        let spec = model.spec();
        let channels = spec.channels;
        let count = self.beams().len();
        // Spare entries are zero or repeat the used ones (VeloView's VLP-16 does); beams of a
        // larger sensor do neither.
        let has_count = count >= channels
            && self.beams()[channels..].iter().all(|spare| {
                let repeated = &self.beams()[spare.channel % channels];
                spare.elevation_rad == 0.0 || spare.elevation_rad == repeated.elevation_rad
            });
        if !has_count {
            return Err(format!("{count} beams, the {model} has {channels}"));
        }
        let used = &self.beams()[..channels];
        let most_deg = if spec.shifted {
            MAX_ASIDE_DEG
        } else {
            MAX_ROTATION_DEG
        };
        for beam in used {
            let rotation_deg = beam.rotation_rad.to_degrees();
            if rotation_deg.abs() > most_deg {
                let channel = beam.channel;
                return Err(format!(
                    "beam {channel} is turned by {rotation_deg:.2} degrees, no beam of the {model} is"
                ));
            }
        }
        // Each unit of an HDL-64E has its own elevations.
        let nominal = model
            .calibration()
            .map_or(&[][..], |nominal| nominal.beams());
        for (beam, expected) in used.iter().zip(nominal) {
            let found = beam.elevation_rad.to_degrees();
            let nominal = expected.elevation_rad.to_degrees();
            if (found - nominal).abs() > MAX_ELEVATION_ERROR_DEG {
                return Err(format!(
                    "beam {} is at {found:.2} degrees, that of the {model} at {nominal:.2}",
                    beam.channel
                ));
            }
        }
        let has_unit = (self.distance_unit_m() - spec.distance_unit_m).abs() < 1e-6;
        if !has_unit && !self.has_mistaken_unit(model) {
            return Err(format!(
                "a unit of distance is {:.1} mm, that of the {model} {:.1} mm",
                self.distance_unit_m() * 1e3,
                spec.distance_unit_m * 1e3
            ));
        }
        Ok(())
    }
}
