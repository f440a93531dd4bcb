//! What a consumer of shared memory gets, and whether a cloud of a peer is the same.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::client::{Client, Domain};
use sweepd::sweep::layout::is_return;
use sweepd::sweep::{Return, SweepRef};

use super::hurry;
use super::peer::Said;

/// Sweeps that are kept: peers are a few behind at most.
const KEPT: usize = 100;
/// Bytes of a point.
pub const STEP: usize = 26;
/// Name, offset, datatype (7 float32, 4 uint16, 6 uint32) and count of each field.
const FIELDS: [(&str, u32, u8, u32); 7] = [
    ("x", 0, 7, 1),
    ("y", 4, 7, 1),
    ("z", 8, 7, 1),
    ("intensity", 12, 7, 1),
    ("ring", 16, 4, 1),
    ("time", 18, 7, 1),
    ("label", 22, 6, 1),
];

/// The sweeps of a sensor, as they come.
pub struct Consumer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    over: AtomicBool,
    sweeps: Mutex<VecDeque<Arc<Expected>>>,
    came: Condvar,
}

/// A sweep.
pub struct Expected {
    /// Its place among the sweeps of this run.
    pub sequence: u64,
    /// Time of its first shot.
    pub stamp_ns: i64,
    bytes: HeapBuffer,
    /// The data of the cloud that was found equal.
    equal: Mutex<Option<Vec<u8>>>,
}

/// A return in the axes of ROS.
struct Point {
    position_m: [f64; 3],
    range_m: f32,
    reflectivity: u8,
    ring: u16,
    after_stamp_ns: i64,
    label: u32,
}

impl Consumer {
    /// Follows a sensor.
    pub fn start(domain: &Domain, sensor: &str) -> Self {
        let shared = Arc::<Shared>::default();
        let mut client = Client::within(domain, sensor).unwrap();
        let mut memory = HeapBuffers::default();
        let of_thread = Arc::clone(&shared);
        let thread = thread::spawn(move || {
            // What it misses, no cloud can be held against.
            hurry("-15");
            while !of_thread.over.load(Ordering::Relaxed) {
                let Some(sweep) = client.next(Duration::from_millis(100)).unwrap().received()
                else {
                    continue;
                };
                // No more than a copy: the daemon waits for nobody.
                let mut bytes = memory.take(sweep.bytes().len());
                bytes.as_mut()[..sweep.bytes().len()].copy_from_slice(sweep.bytes());
                drop(sweep);
                let expected = Arc::new(Expected::new(bytes));
                let mut sweeps = of_thread.sweeps.lock().unwrap();
                sweeps.push_back(expected);
                if sweeps.len() > KEPT {
                    sweeps.pop_front();
                }
                of_thread.came.notify_all();
            }
        });
        Self {
            shared,
            thread: Some(thread),
        }
    }

    /// The sweep of this stamp. A peer may hear of it before this consumer.
    pub fn find(&self, stamp_ns: i64) -> Option<Arc<Expected>> {
        let begun = Instant::now();
        let mut sweeps = self.shared.sweeps.lock().unwrap();
        loop {
            let found = sweeps.iter().rev().find(|one| one.stamp_ns == stamp_ns);
            if found.is_some() || begun.elapsed() > Duration::from_secs(2) {
                return found.cloned();
            }
            let wait = Duration::from_millis(100);
            (sweeps, _) = self.shared.came.wait_timeout(sweeps, wait).unwrap();
        }
    }

    /// The number of the newest sweep.
    pub fn newest(&self) -> Option<u64> {
        let sweeps = self.shared.sweeps.lock().unwrap();
        sweeps.back().map(|sweep| sweep.sequence)
    }

    /// Stamps of the kept sweeps, relative to one: for messages.
    pub fn around(&self, stamp_ns: i64) -> String {
        let sweeps = self.shared.sweeps.lock().unwrap();
        let relative_s = |one: &Arc<Expected>| (one.stamp_ns - stamp_ns) as f64 * 1e-9;
        let kept: Vec<String> = sweeps
            .iter()
            .map(|one| format!("{}: {:.3}", one.sequence, relative_s(one)))
            .collect();
        kept.join(", ")
    }
}

impl Drop for Consumer {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            if !thread::panicking() {
                ended.unwrap();
            }
        }
    }
}

impl Expected {
    fn new(bytes: HeapBuffer) -> Self {
        let header = *SweepRef::open(bytes.as_ref()).unwrap().header;
        Self {
            sequence: header.sequence,
            stamp_ns: header.time_ns,
            bytes,
            equal: Mutex::default(),
        }
    }

    /// The sweep.
    pub fn view(&self) -> SweepRef<'_> {
        SweepRef::open(self.bytes.as_ref()).unwrap()
    }

    /// Whether a cloud is this sweep.
    ///
    /// # Errors
    /// What differs.
    pub fn check(&self, frame_id: &str, said: &Said) -> Result<(), String> {
        let sweep = self.view();
        let count = sweep.header.returns as usize;
        for (key, expected) in [
            ("frame_id", json!(frame_id)),
            ("height", json!(1)),
            ("width", json!(count)),
            ("fields", json!(FIELDS)),
            ("is_bigendian", json!(false)),
            ("point_step", json!(STEP)),
            ("row_step", json!(STEP * count)),
            ("length", json!(STEP * count)),
            ("is_dense", json!(true)),
        ] {
            if said.line[key] != expected {
                return Err(format!("{key} is {}, not {expected}", said.line[key]));
            }
        }
        // Point by point once; all other clouds of the sweep are the same bytes.
        let mut equal = self.equal.lock().unwrap();
        if let Some(equal) = &*equal {
            return match *equal == said.data {
                true => Ok(()),
                false => Err("not the bytes that another reader got".to_owned()),
            };
        }
        let (points, rest) = said.data.as_chunks::<STEP>();
        if points.len() != count || !rest.is_empty() {
            return Err(format!("{} bytes of {count} points", said.data.len()));
        }
        let mut returns: Vec<Return> = sweep.returns().collect();
        // As they were measured; of those at once, the higher row first.
        returns.sort_by_key(|one| (one.time_ns, one.row));
        for (index, (bytes, found)) in points.iter().zip(&returns).enumerate() {
            let expected = Point::of(&sweep, found);
            if !expected.is(bytes) {
                return Err(format!("point {index} is {bytes:?}, not {expected:?}"));
            }
        }
        *equal = Some(said.data.clone());
        Ok(())
    }

    /// Whether images are this sweep's: ranges as they are, NaN where there is no return; labels.
    ///
    /// # Errors
    /// What differs.
    pub fn check_image(&self, frame_id: &str, said: &Said) -> Result<(), String> {
        let sweep = self.view();
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let is_range = said.line["encoding"] == "32FC1";
        let bytes = if is_range { 4 } else { 2 };
        let encoding = if is_range { "32FC1" } else { "16UC1" };
        for (key, expected) in [
            ("frame_id", json!(frame_id)),
            ("height", json!(rows)),
            ("width", json!(columns)),
            ("encoding", json!(encoding)),
            ("is_bigendian", json!(false)),
            ("step", json!(bytes * columns)),
            ("length", json!(bytes * columns * rows)),
        ] {
            if said.line[key] != expected {
                return Err(format!("{key} is {}, not {expected}", said.line[key]));
            }
        }
        for (index, found) in said.data.chunks_exact(bytes).enumerate() {
            let pixel = index % columns * rows + index / columns;
            let is_equal = if is_range {
                let found = f32::from_le_bytes(found.try_into().unwrap());
                let expected = sweep.range[pixel];
                found == expected || found.is_nan() && !is_return(expected)
            } else {
                u32::from(u16::from_le_bytes(found.try_into().unwrap())) == sweep.label[pixel]
            };
            if !is_equal {
                return Err(format!("pixel {index} of {encoding} is {found:?}"));
            }
        }
        Ok(())
    }
}

impl std::fmt::Debug for Point {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            position_m,
            reflectivity,
            ring,
            after_stamp_ns,
            label,
            ..
        } = self;
        write!(
            f,
            "{position_m:?} m, reflectivity {reflectivity}, ring {ring}, {after_stamp_ns} ns, label {label}"
        )
    }
}

impl Point {
    fn of(sweep: &SweepRef<'_>, found: &Return) -> Self {
        let [right_m, forward_m, up_m] = found.point_m;
        Self {
            position_m: [forward_m, -right_m, up_m],
            range_m: found.range_m,
            reflectivity: found.reflectivity,
            ring: (sweep.rows() - 1 - found.row) as u16,
            after_stamp_ns: found.time_ns - sweep.header.time_ns,
            label: found.label,
        }
    }

    /// Whether the bytes are this point: the position within the rounding of float32, the rest
    /// exactly.
    fn is(&self, bytes: &[u8; STEP]) -> bool {
        let f32_at = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let tolerance_m = f64::from(self.range_m.max(1.0) * f32::EPSILON);
        let is_near = |axis: usize| {
            (f64::from(f32_at(4 * axis)) - self.position_m[axis]).abs() <= tolerance_m
        };
        let after_stamp_s = (self.after_stamp_ns as f64 * 1e-9) as f32;
        (0..3).all(is_near)
            && after_stamp_s >= 0.0
            && f32_at(12) == f32::from(self.reflectivity)
            && u16::from_le_bytes([bytes[16], bytes[17]]) == self.ring
            && f32_at(18) == after_stamp_s
            && u32::from_le_bytes(bytes[22..26].try_into().unwrap()) == self.label
    }
}

/// A cloud whose bytes are those of the wire, decoded: little-endian CDR, alignment counted from
/// behind the first 4 bytes.
pub fn decode_raw(said: &mut Said) {
    let mut reader = Cdr {
        bytes: &said.data[4..],
        at: 0,
    };
    assert_eq!(said.data[..2], [0, 1], "little-endian CDR");
    let (sec, nanosec) = (reader.u32(), reader.u32());
    let mut line = json!({
        "stamp_ns": i64::from(sec) * 1_000_000_000 + i64::from(nanosec),
        "frame_id": reader.text(),
        "height": reader.u32(),
        "width": reader.u32(),
    });
    let fields: Vec<Value> = (0..reader.u32())
        .map(|_| json!([reader.text(), reader.u32(), reader.u8(), reader.u32()]))
        .collect();
    line["fields"] = fields.into();
    line["is_bigendian"] = (reader.u8() != 0).into();
    line["point_step"] = reader.u32().into();
    line["row_step"] = reader.u32().into();
    let length = reader.u32();
    line["length"] = length.into();
    let data = reader.take(length as usize).to_vec();
    line["is_dense"] = (reader.u8() != 0).into();
    for key in ["topic", "quality"] {
        line[key] = said.line[key].take();
    }
    *said = Said { line, data };
}

struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cdr<'a> {
    fn take(&mut self, len: usize) -> &'a [u8] {
        self.at += len;
        &self.bytes[self.at - len..self.at]
    }

    fn u8(&mut self) -> u8 {
        self.take(1)[0]
    }

    fn u32(&mut self) -> u32 {
        self.at = self.at.next_multiple_of(4);
        u32::from_le_bytes(self.take(4).try_into().unwrap())
    }

    fn text(&mut self) -> &'a str {
        let len = self.u32() as usize;
        let (text, _) = self.take(len).split_at(len - 1);
        std::str::from_utf8(text).unwrap()
    }
}
