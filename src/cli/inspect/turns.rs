//! The turns of a sensor, decoded to find its speed, dark beams, and how it is mounted.

use super::mounted::{Basis, Mounted};
use crate::beams;
use crate::cli::CliError;
use crate::cli::speed::Speed;
use crate::text::row;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::floor::sides::Sides;
use sweepd_core::pipeline::{Config, DarkBeam, Event, Fault, Labels, Options, Pipeline};
use sweepd_core::segment::Mount;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::eye::eye_faults;
use sweepd_core::wire::Packet;
use sweepd_core::wire::position::{Gravity, Position};

/// Decodes the sweeps of a sensor.
pub struct Turns {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    speed: Speed,
    /// All flags of its sweeps.
    flags: u32,
    /// The mount that is set.
    mount: Mount,
    /// Both sides, where the mount does not say which is up.
    sides: Option<Sides>,
    gravity: Gravity,
    fault: Option<Fault>,
}

impl Turns {
    /// None so far. `is_side_said`: the mount says which side is up.
    ///
    /// # Errors
    /// [`CliError::Failed`]: the configuration is impossible.
    pub fn new(config: &Config, is_side_said: bool) -> Result<Self, CliError> {
        let options = Options {
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        Ok(Self {
            pipeline: Pipeline::with_options("", config.clone(), options)
                .map_err(|error| CliError::Failed(error.to_string()))?,
            memory: Memory::default(),
            speed: Speed::default(),
            flags: 0,
            mount: config.segment.mount,
            sides: (!is_side_said).then(|| Sides::new(&config.segment)),
            gravity: Gravity::default(),
            fault: None,
        })
    }

    /// Adds a data packet.
    pub fn add(&mut self, packet: &Packet<'_>) {
        self.pipeline.push(packet);
        self.poll();
    }

    /// Adds what a position packet says.
    pub fn hear(&mut self, position: &Position<'_>) {
        if let Some(chips) = &position.inertial {
            self.gravity.add(chips);
        }
    }

    /// The time has come so far.
    pub fn idle(&mut self, now_ns: i64) {
        if self.pipeline.idle(Some(now_ns)) {
            self.poll();
        }
    }

    /// Nothing more comes.
    pub fn end(&mut self) {
        self.pipeline.end();
        self.poll();
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                Event::Sweep(bytes) => {
                    if let Ok(sweep) = SweepRef::open(bytes.as_ref()) {
                        self.speed.add(sweep.header);
                        self.flags |= sweep.header.flags;
                        if let Some(sides) = &mut self.sides {
                            sides.look(&sweep);
                        }
                    }
                }
                Event::Fault(fault) => self.fault = Some(fault),
                _ => {}
            }
        }
    }

    /// Speed of the head.
    pub fn speed(&self) -> &Speed {
        &self.speed
    }

    /// Fault for which it cannot be decoded.
    pub fn fault(&self) -> Option<&Fault> {
        self.fault.as_ref()
    }

    /// The beams that are dark at the end.
    pub fn dark_beams(&self) -> Vec<DarkBeam> {
        self.pipeline.status().dark_beams.iter().collect()
    }

    /// Names of what the sensor did not see by.
    pub fn eye(&self) -> Vec<&'static str> {
        eye_faults(self.flags).map(|fault| fault.name).collect()
    }

    /// How it is mounted; `None` where it was not decoded.
    pub fn mounted(&self) -> Option<Mounted<'_>> {
        let status = self.pipeline.status();
        let is_hdl32e = (status.detection).is_some_and(|one| one.model == Model::Hdl32e);
        let felt = self.gravity.side().filter(|_| is_hdl32e);
        self.speed.mean_rpm()?;
        Some(Mounted {
            set: self.mount,
            seen: status.floor,
            felt,
            basis: match (&self.sides, felt) {
                _ if self.speed.lacks_a_turn() => Basis::NoTurn,
                (None, _) => Basis::Mount,
                (Some(sides), Some(side)) => Basis::Accelerometers(side, sides),
                (Some(sides), None) => Basis::Sides(sides),
            },
        })
    }

    /// Adds rows for the beams that are dark at the end, for what the sensor did not see, and for how
    /// it is mounted.
    pub fn describe(&self, text: &mut String) {
        if let Some(sentence) = beams::sentence(&self.dark_beams()) {
            row(text, "dark beams", sentence);
        }
        for fault in eye_faults(self.flags) {
            let words = format_args!("{}: {}: {}", fault.name, fault.what, fault.cure);
            row(text, "eye", words);
        }
        if let Some(mounted) = self.mounted() {
            mounted.describe(text);
        }
    }
}
