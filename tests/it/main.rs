//! Tests of what is pure, and of shared memory within one process.

mod bags;
mod calibration;
mod capture;
mod cloud;
#[path = "../common/mod.rs"]
mod common;
mod dark_beams;
mod decode;
mod detect;
mod determinism;
mod faults;
mod field_of_view;
mod fixtures;
mod from_cloud;
mod golden;
mod hdl64e;
mod leftover;
mod matrix;
mod mounts;
mod objects;
mod obstacles;
mod pains;
mod paper;
mod promises;
mod removal;
mod segment;
mod share;
mod simulated_scores;
mod small_robots;
mod strips;
mod sweeps;
mod truth;
mod velodyne_decoder;
mod velodyne_reference;
mod veloview;
mod vlp32c_vls128;
