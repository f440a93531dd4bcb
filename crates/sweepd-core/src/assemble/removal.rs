//! Returns that no sweep is to have: those of the robot itself, and those out of the range limits.
//!
//! They are taken out as soon as a firing is in the image. So segments, objects and all consumers
//! agree, as if the sensor had not measured them.

use std::f32::consts::TAU;
use std::fmt;
use std::ops::{Range, RangeInclusive};
use std::str::FromStr;

use super::open_sweep::unshifted;
use crate::segment::{self, Mask};
use crate::sweep::image::{pixel_azimuth_rad, pixel_point_m};
use crate::sweep::layout::{BeamRow, Column, ReturnKind, SECOND_BLOCKS, is_return};
use crate::sweep::{Pose, SweepMut};

/// Greatest coordinate of a box, metres.
const MAX_BOX_M: f64 = 100.0;
/// More than the point of a return is nearer to the sensor's origin than its range: beams begin
/// beside the origin, and the two-point correction moves points by a few centimetres.
const BEAM_OFFSET_M: f64 = 0.5;
/// What turns the kind of a return into that of the other of its pair.
const OTHER_KIND: u8 = ReturnKind::Strongest as u8 | ReturnKind::Last as u8 | SECOND_BLOCKS;

/// Sectors of a turn, for what is known of each.
pub const SECTORS: usize = 12;

/// The sector of an azimuth, radians from 0 to a whole turn.
pub fn sector(azimuth_rad: f32) -> usize {
    ((azimuth_rad / TAU * SECTORS as f32) as usize).min(SECTORS - 1)
}

/// Which returns are removed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Removal {
    /// Those that the segmenter's mask hides.
    pub masked: bool,
    /// Those out of the segmenter's range limits.
    pub out_of_range: bool,
    /// Those in one of these.
    pub boxes: Vec<BodyBox>,
}

/// A box in the frame of the robot, such as its own body, a fork or a trailer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyBox {
    /// Least and greatest x (right), y (forward) and z (up), metres.
    ends_m: [[f64; 3]; 2],
}

/// Numbers that are no [`BodyBox`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected x, y, z of a corner and of the opposite one, metres within {MAX_BOX_M} of the origin, each of them different"
)]
pub struct BodyBoxError;

impl BodyBox {
    /// The box with two opposite corners: x, y, z of one, then of the other, metres.
    ///
    /// # Errors
    /// [`BodyBoxError`]: it is flat, or reaches further than any robot.
    pub fn new([x0, y0, z0, x1, y1, z1]: [f64; 6]) -> Result<Self, BodyBoxError> {
        let mut ends_m = [[0.0; 3]; 2];
        for (axis, (one, other)) in [(x0, x1), (y0, y1), (z0, z1)].into_iter().enumerate() {
            let is_near = one.abs().max(other.abs()) <= MAX_BOX_M;
            if !is_near || one.is_nan() || other.is_nan() || one == other {
                return Err(BodyBoxError);
            }
            ends_m[0][axis] = one.min(other);
            ends_m[1][axis] = one.max(other);
        }
        Ok(Self { ends_m })
    }

    /// Whether a point is in it.
    fn holds(&self, point_m: [f64; 3]) -> bool {
        let [least, most] = self.ends_m;
        (0..3).all(|axis| (least[axis]..=most[axis]).contains(&point_m[axis]))
    }

    /// Distance of its furthest corner from a point, metres.
    fn reach_m(&self, from_m: [f64; 3]) -> f64 {
        let mut square = 0.0;
        for (axis, at_m) in from_m.into_iter().enumerate() {
            let [least, most] = self.ends_m.map(|end| (end[axis] - at_m).abs());
            square += least.max(most).powi(2);
        }
        square.sqrt()
    }
}

/// Six numbers with commas between them.
impl FromStr for BodyBox {
    type Err = BodyBoxError;

    fn from_str(text: &str) -> Result<Self, BodyBoxError> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|one| one.trim().parse()).collect();
        let corners = numbers.ok().and_then(|numbers| numbers.try_into().ok());
        Self::new(corners.ok_or(BodyBoxError)?)
    }
}

impl fmt::Display for BodyBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [[x0, y0, z0], [x1, y1, z1]] = self.ends_m;
        write!(f, "{x0},{y0},{z0},{x1},{y1},{z1}")
    }
}

/// Removes returns from the firings of a sensor, and counts them.
#[derive(Clone, Debug)]
pub struct Remover {
    mask: Option<Mask>,
    limits_m: RangeInclusive<f32>,
    boxes: Vec<BodyBox>,
    /// The sensor in the frame of the robot.
    mount: Pose,
    /// No return of a longer range is in a box, metres.
    reach_m: f32,
    /// Returns that were removed so far.
    pub removed: u64,
    /// Rows, a bit each, of which returns were removed since [`Remover::begin`].
    pub rows: u128,
    /// The same of the sectors.
    pub sectors: u32,
    /// How many were removed since.
    pub taken: u32,
}

impl Remover {
    /// For a sensor that sits there: its position, metres, and its yaw, radians. `None` where
    /// nothing is to be removed.
    pub fn new(
        removal: &Removal,
        config: &segment::Config,
        position_m: [f32; 3],
        yaw_rad: f32,
    ) -> Option<Self> {
        if *removal == Removal::default() {
            return None;
        }
        let angles_rad = [yaw_rad, config.mount.pitch_rad, config.mount.roll_rad];
        let mount = Pose::mounted(position_m, angles_rad);
        let reaches_m = removal
            .boxes
            .iter()
            .map(|one| one.reach_m(mount.position_m));
        let reach_m = reaches_m.fold(f64::NEG_INFINITY, f64::max) + BEAM_OFFSET_M;
        Some(Self {
            mask: config.mask.clone().filter(|_| removal.masked),
            limits_m: match removal.out_of_range {
                true => config.min_range_m..=config.max_range_m,
                false => 0.0..=f32::INFINITY,
            },
            boxes: removal.boxes.clone(),
            mount,
            reach_m: reach_m as f32,
            removed: 0,
            rows: 0,
            sectors: 0,
            taken: 0,
        })
    }

    /// Another sweep begins.
    pub fn begin(&mut self) {
        (self.rows, self.sectors, self.taken) = (0, 0, 0);
    }

    /// Takes returns out of these firings of a sweep, by column; gives how many.
    pub fn remove(&mut self, sweep: &mut SweepMut<'_>, firings: Range<usize>) -> u32 {
        let mut removed = 0;
        for at in firings {
            let firing = sweep.columns[at];
            if !firing.is_measured() {
                continue;
            }
            let before = removed;
            for row in 0..sweep.beams.len() {
                let taken = self.remove_from(sweep, &firing, at, row);
                self.rows |= u128::from(taken > 0) << row;
                removed += taken;
            }
            if removed > before {
                self.sectors |= 1 << sector(firing.azimuth_rad);
            }
        }
        self.removed += u64::from(removed);
        self.taken += removed;
        removed
    }

    /// The same of one beam.
    fn remove_from(&self, sweep: &mut SweepMut<'_>, firing: &Column, at: usize, row: usize) -> u32 {
        let beam = &sweep.beams[row];
        let pixel = unshifted(at, beam.shift) * sweep.beams.len() + row;
        let takes_segmented = self.takes(firing, beam, row, sweep.range[pixel]);
        if sweep.range2.is_empty() {
            if takes_segmented {
                (sweep.range[pixel], sweep.reflectivity[pixel]) = (0.0, 0);
            }
            return takes_segmented.into();
        }
        let takes_other = self.takes(firing, beam, row, sweep.range2[pixel]);
        // Where one of two returns is left, that is the one to segment.
        if takes_segmented {
            sweep.range[pixel] = sweep.range2[pixel];
            sweep.reflectivity[pixel] = sweep.reflectivity2[pixel];
            sweep.kind[pixel] ^= OTHER_KIND;
            if takes_other {
                (sweep.range[pixel], sweep.reflectivity[pixel]) = (0.0, 0);
            }
        }
        if takes_segmented || takes_other {
            (sweep.range2[pixel], sweep.reflectivity2[pixel]) = (0.0, 0);
        }
        u32::from(takes_segmented) + u32::from(takes_other)
    }

    /// Whether there is a return that must go.
    fn takes(&self, firing: &Column, beam: &BeamRow, row: usize, range_m: f32) -> bool {
        if !is_return(range_m) {
            return false;
        }
        if !self.limits_m.contains(&range_m) {
            return true;
        }
        if let Some(mask) = &self.mask
            && mask.hides(row, pixel_azimuth_rad(firing, beam))
        {
            return true;
        }
        if range_m > self.reach_m {
            return false;
        }
        let point_m = self.mount.apply(pixel_point_m(firing, beam, range_m));
        self.boxes.iter().any(|one| one.holds(point_m))
    }
}
