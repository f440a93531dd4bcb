//! Programs in real time, what the machine runs out of, other languages, and ROS 2: minutes.

mod consumers;
mod crashes;
mod daemon;
mod doctor;
mod live;
mod mcap;
mod resource;
mod ros2;
mod systemd;

use sweepd_testkit::counting::Counting;

#[global_allocator]
static COUNTING: Counting = Counting;
