//! The rule of the ground, and its numbers.
//!
//! The `climb` follows each column from the ground straight below the sensor outwards. It holds a
//! return against the *foothold*, the ground return before it:
//!
//! * One that lies no higher, or nearly so, is ground.
//! * One that lies a little higher waits for what the column shows behind it. It is *in doubt* where
//!   the way to it is gentle, else it is *low*.
//! * One that lies higher is an object.
//!
//! What waits is ground where the way goes on level behind it: a kerb, a ramp. It is an object where
//! the column comes down again first: a box. Where the column shows neither, what is in doubt is
//! ground, and what is low is an object.
//!
//! Returns that rise steeply over the one below them are a *face*. A face that the robot climbs is
//! low, and a higher one is an object, with what goes on level on top of it. Where the foot of a face
//! lies lower than the foothold, below a ramp or a step, the face starts from there. Between sparse rows
//! a step has no face: then it is told by how high and how steeply a return rises.
//!
//! So the climb needs the sensor's height, and holds for sparse sensors, whose first ground return
//! is metres out. Columns do not look at each other while they climb; in the `vote` they do.
//!
//! All is in whole steps of 16 bits. A step of a height is what the steepest way rises in a step of
//! a distance: so a distance in steps is the highest rise on it.

/// Steepest way from one ground return to the next, metres a metre.
const MAX_SLOPE: f32 = 0.2;

/// Steps of a distance from the plumb line in a metre.
pub(super) const AWAY_STEPS: f32 = 128.0;
/// Steps of a height in a metre.
pub(super) const HEIGHT_STEPS: f32 = AWAY_STEPS / MAX_SLOPE;
/// Steps of a height in a step of a distance.
pub(super) const STEEP: i16 = (1.0 / MAX_SLOPE) as i16;

/// A distance in steps.
const fn away(metres: f32) -> i16 {
    (metres * AWAY_STEPS + 0.5) as i16
}

/// A height in steps.
pub(super) const fn height(metres: f32) -> i16 {
    (metres * HEIGHT_STEPS + 0.5) as i16
}

/// Highest rise over the foothold, and deepest fall that is allowed at any distance.
pub(super) const MAX_RISE: i16 = height(0.3);
/// Half of that rise is the highest where the foothold is a return that is as far before as this:
/// what rises there may stand on ground that is not seen.
pub(super) const NEAR: i16 = away(3.0);
/// Rise that is none: the noise of ranges, and how far apart level returns may be.
pub(super) const MIN_RISE: i16 = height(0.07);
/// Nor is a rise one that is halved so often from what the steepest way rises: 2.5 %.
pub(super) const FLAT_SHIFT: u32 = 3;
/// A face rises higher than this over its foot, and more than it lies behind it and this: the
/// noise of ranges.
pub(super) const MAX_STEP: i16 = height(0.05);
/// A kerb may lean this far towards the sensor.
pub(super) const MAX_LEAN: i16 = away(0.05);
/// Of a face, what is no higher than this over the foothold is ground.
pub(super) const MAX_FOOT: i16 = height(0.02);
/// Rise above which a return of no face can be a step.
pub(super) const LEAST_STEP: i16 = height(0.1);
/// A ramp rises as the steepest way less that, halved so often: 15 %.
pub(super) const RAMP_SHIFT: u32 = 2;
/// How far the way has to go on level behind what waits. Lower boxes that are deeper than this are
/// taken for kerbs.
pub(super) const PLATEAU: i16 = away(1.0);
/// How far what lies level on an object belongs to it.
pub(super) const MAX_TOP: i16 = away(1.5);

/// Neighbours in a row whose ranges differ by less than this many metres vote on each other. Of the
/// three on either side, three that are ground make a return ground, and one at most of four or
/// more unmakes it.
pub(super) const AGREE_M: f32 = 0.5;
