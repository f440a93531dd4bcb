//! The command line as a user meets it: the real binary, over shipped captures and over bad ones
//! made here.

#[cfg(feature = "slow-tests")]
mod bags;
mod calib;
mod config;
mod configured;
mod errors;
mod existing;
mod gps_time;
mod inputs;
mod inspect;
mod jobs;
mod limits;
mod made;
mod mask;
mod objects;
mod obstacle;
mod options;
mod outputs;
mod pages;
mod piece;
mod publish;
mod record;
mod segments;
mod sensor;
mod shell;
mod to_udp;
mod version;
mod watch;

use sweepd_testkit::command::*;
