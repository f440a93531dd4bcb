//! The turns of a sensor, decoded to find dark beams and the floor.

use serde_json::Value;

use crate::text::row;
use crate::{beams, floor};
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::floor::{FloorFinder, Sight};
use sweepd_core::pipeline::{Config, DarkBeam, Labels, Options, Pipeline};
use sweepd_core::segment::{self, ConfigError, Mount};
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::eye::eye_faults;
use sweepd_core::wire::Packet;

/// Decodes the sweeps of a sensor.
pub struct Turns {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    floor: FloorFinder,
    /// All flags of its sweeps.
    flags: u32,
    /// The mount that was said, if one was.
    said: Option<Mount>,
}

impl Turns {
    /// None so far, of a sensor that is said to be mounted like this.
    ///
    /// # Errors
    /// Never: the configuration is possible.
    pub fn new(said: Option<Mount>) -> Result<Self, ConfigError> {
        let options = Options {
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        Ok(Self {
            pipeline: Pipeline::with_options("", Config::default(), options)?,
            memory: Memory::default(),
            floor: FloorFinder::new(&segment::Config {
                mount: said.unwrap_or_default(),
                ..Default::default()
            }),
            flags: 0,
            said,
        })
    }

    /// Adds a packet.
    pub fn add(&mut self, packet: &Packet<'_>) {
        self.pipeline.push(packet);
        // What cannot be decoded is told with the model.
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            if let Some(bytes) = event.sweep()
                && let Ok(sweep) = SweepRef::open(bytes.as_ref())
            {
                self.floor.look(&sweep);
                self.flags |= sweep.header.flags;
            }
        }
    }

    /// The beams that are dark at the end.
    pub fn dark_beams(&self) -> Vec<DarkBeam> {
        self.pipeline.status().dark_beams.iter().collect()
    }

    /// Names of what the sensor did not see by.
    pub fn eye(&self) -> Vec<&'static str> {
        eye_faults(self.flags).map(|fault| fault.name).collect()
    }

    /// The floor, for programs.
    pub fn floor(&self) -> Value {
        self.seen().json()
    }

    fn seen(&self) -> floor::Seen {
        floor::Seen {
            sight: self.floor.sight(),
            set: self.said,
            is_estimated: self.said.is_none_or(|said| said.height_m.is_none()),
        }
    }

    /// Adds rows for the beams that are dark at the end, for what the sensor did not see, and for the
    /// floor.
    pub fn describe(&self, text: &mut String) {
        if let Some(sentence) = beams::sentence(&self.dark_beams()) {
            row(text, "dark beams", sentence);
        }
        for fault in eye_faults(self.flags) {
            let words = format_args!("{}: {}: {}", fault.name, fault.what, fault.cure);
            row(text, "eye", words);
        }
        self.describe_floor(text);
    }

    /// The mount that the floor gives, to be copied into a configuration.
    fn describe_floor(&self, text: &mut String) {
        let seen = match self.floor.sight() {
            Sight::Unknown => return,
            Sight::NoFloor => {
                let why = self.seen().finding().map(|finding| finding.what);
                return row(text, "floor", why.unwrap_or_default());
            }
            Sight::Floor(seen) => seen,
        };
        row(text, "floor", format_args!("{}:", floor::MOUNTED));
        for line in floor::lines(&seen).lines() {
            row(text, "", line);
        }
        let difference = self.said.and_then(|said| floor::difference(&seen, &said));
        if let Some(difference) = difference {
            row(
                text,
                "warning",
                format_args!("{difference}: {}", floor::CURE),
            );
        }
    }
}
