//! Ground by slope: each column is climbed from its lowest row, and what rises too steeply is no
//! ground. Then each row is asked whether its neighbours agree.
//!
//! The `climb` starts at the sensor's foot, the point of the ground straight below it, and goes on
//! from each ground point to the next. So it needs the sensor's height, and holds for sparse
//! sensors, whose first ground point is metres out. Columns do not look at each other while they
//! climb; in the `vote` they do. This file has the limits of both.
//!
//! Both compare whole steps in 16 bits. The vote has those of ranges, of 7.8 mm. For the climb,
//! heights and what the steepest way rises are in steps of 2 mm, distances in steps of 7.8 mm; where
//! `max_slope` is more than 1 to 4, steps are as much longer as the way rises more in 256 m.

use super::joining::DENSE_DEG;
use crate::sweep::BeamRow;

/// What counts as ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeGround {
    /// Steepest way from one ground point to the next, up or down, metres a metre.
    pub max_slope: f32,
    /// Highest rise from one ground point to the next, however far apart they are, metres; `None`
    /// chooses by the rows of the image: see [`SlopeGround::max_rise_m`]. A fall has no such limit.
    pub max_rise_m: Option<f32>,
    /// Rise or fall that is allowed at any distance: the noise of near points, metres.
    pub min_rise_m: f32,
    /// What rises higher than this over its foot, at more than 45 degrees, is an object, metres.
    pub max_step_m: f32,
    /// A step that is no higher than this is a kerb when the ground goes on level behind it,
    /// metres.
    pub max_kerb_m: f32,
    /// Neighbours in a row whose ranges differ by less vote on each other, metres; 0 turns the vote
    /// off. Of the three on either side, three that are ground make a point ground, and one at most
    /// of four or more unmakes it.
    pub agree_m: f32,
}

impl Default for SlopeGround {
    fn default() -> Self {
        Self {
            max_slope: 0.2,
            max_rise_m: None,
            min_rise_m: 0.07,
            max_step_m: 0.05,
            max_kerb_m: 0.28,
            agree_m: 0.5,
        }
    }
}

impl SlopeGround {
    /// Highest rise from one ground point to the next where rows are [this far
    /// apart](rows_apart_rad), metres: what is configured, else 0.3 where rows are dense, and 0.15
    /// where they are sparse, so that the next point may lie on what stands there.
    pub fn max_rise_m(&self, rows_apart_rad: f32) -> f32 {
        let are_dense = rows_apart_rad <= DENSE_DEG.to_radians();
        self.max_rise_m
            .unwrap_or(if are_dense { 0.3 } else { 0.15 })
    }
}

/// How far apart rows are, in the mean, radians. Ground is followed through all rows, so the wide
/// steps count as well: those of a VLP-32C are 1.3 degrees apart, though most of its rows are dense.
pub fn rows_apart_rad(beams: &[BeamRow]) -> f32 {
    let steps = beams.len().saturating_sub(1).max(1) as f32;
    match beams {
        [top, .., bottom] => (top.elevation_rad - bottom.elevation_rad).abs() / steps,
        _ => 0.0,
    }
}
