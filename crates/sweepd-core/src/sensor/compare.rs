//! Compares two calibrations: which beams differ, in which values, and by how much.

use super::{Beam, Calibration};

/// Angles may differ by this much, degrees: twice the rounding of the status stream.
pub const ANGLE_TOLERANCE_DEG: f64 = 0.02;
/// Lengths may differ by this much, metres.
pub const LENGTH_TOLERANCE_M: f64 = 0.002;

/// A value in which two calibrations of a beam differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Channel of the beam.
    pub channel: usize,
    /// What differs.
    pub quantity: Quantity,
    /// The values, degrees or metres.
    pub values: [f64; 2],
}

/// What places or turns a beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Angle above the horizon, degrees.
    Elevation,
    /// Rotation correction, degrees.
    Rotation,
    /// Distance offset, metres.
    Distance,
    /// Distance offset for x at the near point, metres; the plain one where there is none.
    DistanceX,
    /// Distance offset for y at the near point, metres; the plain one where there is none.
    DistanceY,
    /// Height of the origin, metres.
    VerticalOffset,
    /// Sideways shift of the origin, metres.
    HorizontalOffset,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Elevation,
        Self::Rotation,
        Self::Distance,
        Self::DistanceX,
        Self::DistanceY,
        Self::VerticalOffset,
        Self::HorizontalOffset,
    ];

    /// The words for it in output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Elevation => "elevation",
            Self::Rotation => "rotation",
            Self::Distance => "distance offset",
            Self::DistanceX => "distance offset x",
            Self::DistanceY => "distance offset y",
            Self::VerticalOffset => "vertical offset",
            Self::HorizontalOffset => "horizontal offset",
        }
    }

    /// Whether it is an angle in degrees, not a length in metres.
    pub fn is_angle(self) -> bool {
        matches!(self, Self::Elevation | Self::Rotation)
    }

    /// Its unit: `degrees` or `m`.
    pub fn unit(self) -> &'static str {
        if self.is_angle() { "degrees" } else { "m" }
    }

    /// Its value for a beam, degrees or metres.
    pub fn of(self, beam: &Beam) -> f64 {
        match self {
            Self::Elevation => beam.elevation_rad.to_degrees(),
            Self::Rotation => beam.rotation_rad.to_degrees(),
            Self::Distance => beam.distance_offset_m,
            Self::DistanceX => beam.near_distance_offsets_m()[0],
            Self::DistanceY => beam.near_distance_offsets_m()[1],
            Self::VerticalOffset => beam.vertical_offset_m,
            Self::HorizontalOffset => beam.horizontal_offset_m,
        }
    }

    fn tolerance(self) -> f64 {
        // A little more than the tolerance, so that binary rounding does not make a difference of
        // exactly the tolerance count.
        let tolerance = if self.is_angle() {
            ANGLE_TOLERANCE_DEG
        } else {
            LENGTH_TOLERANCE_M
        };
        tolerance * (1.0 + 1e-9)
    }
}

/// Values in which beams of the same channel differ by more than the tolerances, beam by beam.
///
/// Beams that only one of the two has are skipped: compare the numbers of beams first.
pub fn differences(a: &Calibration, b: &Calibration) -> Vec<Difference> {
    let mut differences = Vec::new();
    for (a, b) in a.beams().iter().zip(b.beams()) {
        for quantity in Quantity::ALL {
            let values = [quantity.of(a), quantity.of(b)];
            if (values[0] - values[1]).abs() > quantity.tolerance() {
                differences.push(Difference {
                    channel: a.channel,
                    quantity,
                    values,
                });
            }
        }
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::calibration::TwoPoint;

    #[test]
    fn what_differs_is_named_and_the_rest_is_not() {
        let calibration = |change: fn(&mut Beam)| {
            let mut beams = vec![
                Beam::ideal(0, 0.1),
                Beam {
                    distance_offset_m: 1.25,
                    ..Beam::ideal(1, 0.2)
                },
            ];
            change(&mut beams[1]);
            Calibration::new(beams, 0.002).unwrap()
        };
        let plain = calibration(|_| ());
        let two_point = |x, y| {
            Some(TwoPoint {
                distance_offset_x_m: x,
                distance_offset_y_m: y,
            })
        };
        let same = calibration(|beam| {
            beam.elevation_rad += 0.02_f64.to_radians();
            beam.vertical_offset_m = 0.002;
            beam.two_point = Some(TwoPoint {
                distance_offset_x_m: 1.25,
                distance_offset_y_m: 1.25,
            });
        });
        assert_eq!(differences(&plain, &same), []);
        let mut other = calibration(|beam| beam.rotation_rad = -0.021_f64.to_radians())
            .beams()
            .to_vec();
        other[1].two_point = two_point(1.25, 1.253);
        let found = differences(&plain, &Calibration::new(other, 0.002).unwrap());
        let named: Vec<_> = found
            .iter()
            .map(|one| (one.channel, one.quantity))
            .collect();
        assert_eq!(named, [(1, Quantity::Rotation), (1, Quantity::DistanceY)]);
        assert_eq!(found[1].values, [1.25, 1.253]);
    }
}
