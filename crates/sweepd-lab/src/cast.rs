//! Which obstacles a sensor sees: a ray caster of a few solids on a floor, with the truth of every
//! return.
//!
//! It shares nothing with [`simulate`](crate::simulate), so that it can judge what was made and
//! tried there. A [`Scene`] stands in the frame of the robot: x right, y ahead, z up, the floor below
//! the sensor at z = 0. A [`Sensor`] looks at it, the product's segmenter labels the image, and a
//! [`View`] holds the labels against the truth. Beams have no width and the robot stands still;
//! what is measured is off by normal noise alone.

mod draw;
#[cfg(test)]
mod floor;
mod scene;
mod sensor;
#[cfg(test)]
mod sides;
mod spin;
mod things;
mod view;

pub use draw::{Drawn, Kind};
pub use scene::{Ground, Ray, Scene, Solid, What};
pub use sensor::{Sector, Sensor};
pub use spin::Spin;
pub use things::{Thing, island, kerb, ramp, small_box, step_down};
pub use view::{Found, View};
