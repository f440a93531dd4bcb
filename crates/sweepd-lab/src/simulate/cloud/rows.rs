//! Assigns rings to beams; rings and rows are both in order from the top.

use super::error::FromCloudError;
use sweepd_core::sensor::Beam;

/// Greatest distance of a ring from its beam, degrees: units differ by half as much, models by
/// more.
const MAX_APART_DEG: f64 = 6.0;
/// Least difference of the elevations of two beams, degrees: the resolution of the status stream.
const STEP_DEG: f64 = 0.01;

/// Where a ring lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct RingPlace {
    /// Elevation of its points as seen from the sensor's origin, the median, radians.
    pub elevation_rad: f64,
    /// Distance of its points from the axis, the median, metres.
    pub away_m: f64,
}

impl RingPlace {
    /// How far a beam's elevation is from that of a beam which would have made this ring, radians.
    fn apart_rad(&self, beam: &Beam) -> f64 {
        let rise = self.elevation_rad.tan() - beam.vertical_offset_m / self.away_m;
        (rise.atan() - beam.elevation_rad).abs()
    }
}

/// The row of each ring. Rings and rows keep their order; if there are fewer rings than rows, the
/// empty rows are those that give the best fit of elevations.
///
/// # Errors
/// [`FromCloudError::Rings`]: more rings than beams; [`FromCloudError::Apart`]: a ring that is too
/// far from its beam.
pub(super) fn of_rings(rings: &[RingPlace], rows: &[Beam]) -> Result<Vec<usize>, FromCloudError> {
    let Some(spare) = rows.len().checked_sub(rings.len()) else {
        return Err(FromCloudError::Rings {
            found: rings.len(),
            beams: rows.len(),
        });
    };
    // A ring has at most `spare` empty rows above it. best[k] of a ring: the least sum of all up to
    // it with exactly k.
    let mut best = vec![0.0; spare + 1];
    let mut empty_before = Vec::with_capacity(rings.len());
    for (index, ring) in rings.iter().enumerate() {
        let mut from: Vec<usize> = (0..=spare).collect();
        for empty in 1..=spare {
            if best[from[empty - 1]] <= best[empty] {
                from[empty] = from[empty - 1];
            }
        }
        best = (0..=spare)
            .map(|empty| best[from[empty]] + ring.apart_rad(&rows[index + empty]))
            .collect();
        empty_before.push(from);
    }
    let mut empty = (0..=spare)
        .min_by(|&a, &b| best[a].total_cmp(&best[b]))
        .unwrap_or(0);
    let mut found = vec![0; rings.len()];
    for index in (0..rings.len()).rev() {
        found[index] = index + empty;
        empty = empty_before[index][empty];
    }
    check(rings, rows, &found)?;
    Ok(found)
}

fn check(rings: &[RingPlace], rows: &[Beam], found: &[usize]) -> Result<(), FromCloudError> {
    // What is no number is nowhere.
    let is_near =
        |ring: &RingPlace, row: usize| ring.apart_rad(&rows[row]).to_degrees() < MAX_APART_DEG;
    match rings
        .iter()
        .zip(found)
        .find(|&(ring, &row)| !is_near(ring, row))
    {
        None => Ok(()),
        Some((ring, &row)) => Err(FromCloudError::Apart {
            ring_deg: ring.elevation_rad.to_degrees(),
            beam_deg: rows[row].elevation_rad.to_degrees(),
        }),
    }
}

/// Completes the beams, row by row from the top, so that a calibration can hold them: beams without
/// a fit follow their neighbours, and each is at least [`STEP_DEG`] below the one above it.
///
/// `fits` holds the fit of each row.
pub(super) fn complete(rows: &[Beam], fits: &[Option<Beam>]) -> Vec<Beam> {
    let shifts_rad: Vec<Option<f64>> = (rows.iter().zip(fits))
        .map(|(beam, fit)| Some(fit.as_ref()?.elevation_rad - beam.elevation_rad))
        .collect();
    let mut beams: Vec<Beam> = Vec::with_capacity(rows.len());
    for (row, beam) in rows.iter().enumerate() {
        let above = (0..row)
            .rev()
            .find_map(|other| Some((row - other, shifts_rad[other]?)));
        let below = (row + 1..rows.len()).find_map(|other| Some((other - row, shifts_rad[other]?)));
        let shift_rad = match (above, below) {
            (Some((up, a)), Some((down, b))) => {
                (a * down as f64 + b * up as f64) / (up + down) as f64
            }
            (Some((_, only)), None) | (None, Some((_, only))) => only,
            (None, None) => 0.0,
        };
        let mut beam = fits[row].unwrap_or(Beam {
            elevation_rad: beam.elevation_rad + shift_rad,
            ..*beam
        });
        if let Some(above) = beams.last() {
            beam.elevation_rad = beam
                .elevation_rad
                .min(above.elevation_rad - STEP_DEG.to_radians());
        }
        beams.push(beam);
    }
    beams
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<Beam> {
        let elevation_rad = |row: usize| (2.0 - 0.42 * row as f64).to_radians();
        (0..64)
            .map(|row| Beam {
                vertical_offset_m: 0.2,
                ..Beam::ideal(row, elevation_rad(row))
            })
            .collect()
    }

    /// The rings of these rows for a unit that points this much higher than its calibration.
    fn rings(rows_with_ring: impl IntoIterator<Item = usize>, higher_deg: f64) -> Vec<RingPlace> {
        let ring = |row: usize| {
            let rise = (rows()[row].elevation_rad + higher_deg.to_radians()).tan() + 0.2 / 15.0;
            RingPlace {
                elevation_rad: rise.atan(),
                away_m: 15.0,
            }
        };
        rows_with_ring.into_iter().map(ring).collect()
    }

    #[test]
    fn a_ring_has_the_row_of_its_beam() {
        assert_eq!(
            of_rings(&rings(0..64, 1.3), &rows()).unwrap(),
            (0..64).collect::<Vec<_>>()
        );
        let without_top: Vec<usize> = (5..64).collect();
        assert_eq!(of_rings(&rings(5..64, 0.1), &rows()).unwrap(), without_top);
        let holes: Vec<usize> = (0..64)
            .filter(|row| ![0, 1, 30, 63].contains(row))
            .collect();
        assert_eq!(
            of_rings(&rings(holes.clone(), -0.15), &rows()).unwrap(),
            holes
        );
        assert_eq!(of_rings(&[], &rows()).unwrap(), Vec::<usize>::new());
    }

    #[test]
    fn what_is_no_scan_of_this_sensor_is_refused() {
        let too_many = vec![
            RingPlace {
                elevation_rad: 0.0,
                away_m: 10.0
            };
            65
        ];
        let error = of_rings(&too_many, &rows()).unwrap_err().to_string();
        assert_eq!(error, "65 rings, the HDL-64E has 64 beams");
        let error = of_rings(
            &[RingPlace {
                elevation_rad: 0.2,
                away_m: 10.0,
            }],
            &rows(),
        )
        .unwrap_err()
        .to_string();
        assert!(
            error.contains("11.46 degrees") && error.contains("2.00"),
            "{error}"
        );
        assert!(
            of_rings(
                &[RingPlace {
                    elevation_rad: f64::NAN,
                    away_m: 10.0
                }],
                &rows()
            )
            .is_err()
        );
    }

    #[test]
    fn beams_without_a_fit_follow_their_neighbours_and_none_overtakes_another() {
        let rows = [0.3, 0.2, 0.1, 0.0, -0.1].map(|elevation_rad| Beam::ideal(0, elevation_rad));
        let at = |elevation_rad| Some(Beam::ideal(0, elevation_rad));
        let elevations = |fits: &[Option<Beam>]| -> Vec<i64> {
            complete(&rows, fits)
                .iter()
                .map(|beam| (beam.elevation_rad * 1e6).round() as i64)
                .collect()
        };
        assert_eq!(
            elevations(&[None; 5]),
            [300_000, 200_000, 100_000, 0, -100_000]
        );
        assert_eq!(
            elevations(&[None, at(0.21), None, at(0.03), None]),
            [310_000, 210_000, 120_000, 30_000, -70_000]
        );
        assert_eq!(
            elevations(&[None, at(0.2), at(0.25), None, None]),
            [300_000, 200_000, 199_825, 150_000, 50_000]
        );
    }
}
