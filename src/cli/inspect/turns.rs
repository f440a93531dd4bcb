//! The turns of a sensor, decoded to find dark beams.

use crate::beams;
use crate::text::row;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{Config, DarkBeam, Labels, Options, Pipeline};
use sweepd_core::segment::ConfigError;
use sweepd_core::wire::Packet;

/// Decodes the sweeps of a sensor.
pub struct Turns {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
}

impl Turns {
    /// None so far.
    ///
    /// # Errors
    /// Never: the configuration is possible.
    pub fn new() -> Result<Self, ConfigError> {
        let options = Options {
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        Ok(Self {
            pipeline: Pipeline::with_options("", Config::default(), options)?,
            memory: Memory::default(),
        })
    }

    /// Adds a packet.
    pub fn add(&mut self, packet: &Packet<'_>) {
        self.pipeline.push(packet);
        // What cannot be decoded is told with the model.
        while self.pipeline.poll(&mut self.memory).is_some() {}
    }

    /// Adds a row for the beams that are dark at the end, if there are any.
    pub fn describe(&self, text: &mut String) {
        let dark: Vec<DarkBeam> = self.pipeline.status().dark_beams.iter().collect();
        if let Some(sentence) = beams::sentence(&dark) {
            row(text, "dark beams", sentence);
        }
    }
}
