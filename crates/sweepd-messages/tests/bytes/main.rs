//! The bytes of messages: by hand, and read back against the sweep. What ROS 2 makes of them is in
//! the root package's `tests/ros`.

mod clouds;
mod others;
mod reader;
mod scene;
