//! One function for each way into the program. It takes any bytes, and fails where a promise is
//! broken.
//!
//! Both forms of the run call the same functions: `cargo test --test fuzz` with mutated seeds on
//! stable Rust, and libFuzzer, which is led by the code that an input reaches (see
//! `tests/fuzz/README.md`).
#![allow(dead_code)]

pub mod captures;
pub mod clouds;
pub mod packets;
pub mod peers;
pub mod pipeline;
pub mod recordings;
pub mod sweep;
pub mod texts;

/// A function under test.
pub type Run = fn(&[u8]);

/// All targets by name.
pub const ALL: [(&str, Run); 21] = [
    ("data_packet", packets::data_packet),
    ("position_packet", packets::position_packet),
    ("status_stream", packets::status_stream),
    ("capture", captures::capture),
    ("bag", captures::capture),
    ("frames", captures::frames),
    ("frame", captures::frame),
    ("mender", recordings::mender),
    ("db_xml", texts::db_xml),
    ("ros_yaml", texts::ros_yaml),
    ("config", texts::config),
    ("web_page", texts::web_page),
    ("mask", texts::mask),
    ("rows", texts::rows),
    ("cloud", clouds::cloud),
    ("labels", clouds::labels),
    ("pipeline", pipeline::pipeline),
    ("sweep", sweep::sweep),
    ("cdr", peers::cdr),
    ("control", peers::control),
    ("health", peers::health),
];

/// The target of this name.
pub fn named(name: &str) -> Run {
    ALL.into_iter()
        .find(|(other, _)| *other == name)
        .map(|(_, run)| run)
        .expect("the name of a target")
}

/// Reads numbers off the front of an input; zeros behind its end.
pub struct Numbers<'a>(pub &'a [u8]);

impl<'a> Numbers<'a> {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn first<const N: usize>(&mut self) -> [u8; N] {
        let mut first = [0; N];
        let (front, rest) = self.0.split_at(N.min(self.0.len()));
        first[..front.len()].copy_from_slice(front);
        self.0 = rest;
        first
    }

    pub fn u8(&mut self) -> u8 {
        self.first::<1>()[0]
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.first())
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.first())
    }

    pub fn i64(&mut self) -> i64 {
        i64::from_le_bytes(self.first())
    }

    /// So many bytes, or as many as there are.
    pub fn bytes(&mut self, len: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        front
    }
}
