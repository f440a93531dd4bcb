//! A simulated sensor: a scene, a head that turns in it, and the datagrams that a real sensor would
//! send.
//!
//! ```text
//! setting ->  Scene  ->  View::cast  ->  optics  ->  Emitter  ->  deliver  ->  SimulatedDatagram { bytes, truth }
//! seed        solids     nearest hit     returns     packets      faults
//! ```
//!
//! * [`shape`]: convex solids and rays. [`scene`]: objects of such solids, and the ray that finds
//!   the nearest.
//! * [`props`]: what stands there. [`mod@street`], [`parking`], [`mod@field`], [`mod@room`],
//!   [`mod@corridor`], [`mod@warehouse`]: the scenes; [`setting`]: which of them, and how sensors are
//!   mounted there.
//! * [`beam`]: where a beam starts and goes, by the manual's formulas, and what the packet says of
//!   it. [`mod@unit`]: the beams of an HDL-64E that was never built.
//! * [`optics`]: from what a beam meets to the returns that the sensor reports.
//! * [`config`]: a sensor. [`head`]: how it turns. [`clock`]: what its clock follows. `schedule`:
//!   when it fires. [`emitter`]: time, turning head and packets. [`truth`]: what each return really
//!   was. [`gps`]: the position packets; an HDL-64E has its `status` instead.
//! * [`delivery`]: what a network does to datagrams. [`plan`]: faults at random rates. [`damage`]:
//!   what is wrong with one packet.
//! * [`fixtures`]: the captures in `pcap_fixtures/`.
//!
//! The simulator computes forwards, from time to direction to bytes, and shares only the tables in
//! [`sweepd_core::sensor`] with the decoder, so that an error in one does not hide in the other.
//! The same configuration gives the same bytes; a packet depends only on its time, not on the
//! packets before it.
//!
//! ```
//! use sweepd_core::sensor::Model;
//! use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, street};
//! use sweepd_core::wire::data::ReturnMode;
//!
//! let scene = street(1);
//! let config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest).turns(0.25);
//! let cars = Emitter::new(config, &scene)
//!     .filter_map(|sent| sent.truth)
//!     .flat_map(|truth| truth.returns.into_iter().flatten().flatten())
//!     .filter(|one| one.class == Class::Car)
//!     .count();
//! assert!(cars > 100);
//! ```

mod builder;
pub mod clock;
mod layout;
mod schedule;
mod status;

pub mod beam;
pub mod cloud;
pub mod config;
pub mod corridor;
pub mod damage;
pub mod delivery;
pub mod emitter;
pub mod field;
pub mod fixtures;
pub mod gps;
pub mod head;
pub mod optics;
pub mod parking;
pub mod plan;
pub mod props;
pub mod room;
pub mod scene;
pub mod setting;
pub mod shape;
pub mod street;
pub mod truth;
pub mod unit;
pub mod view;
pub mod warehouse;

pub use clock::ClockStep;
pub use config::EmitterConfig;
pub use damage::{Damage, EyeFault, EyeKind, PacketPart};
pub use delivery::{Faults, deliver};
pub use emitter::Emitter;
pub use head::{FieldOfView, Motion, Motor, Pose, SpeedChange};
pub use plan::Rates;
pub use scene::{Class, Scene};
pub use setting::Setting;
pub use street::street;
pub use truth::{PacketTruth, ReturnTruth, SimulatedDatagram};
