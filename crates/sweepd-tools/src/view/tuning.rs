//! Segments a sweep anew with the options of a page.

use std::collections::BTreeMap;

use hyper::body::Bytes;
use serde::Deserialize;
use serde_json::{Value, json};

use super::channels::{packed, sweep_bytes};
use sweepd::daemon::record::protocol::SegmentSettings;
use sweepd_client::host::monotonic_ns;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::HeapBuffers;
use sweepd_core::pipeline::TimedSegmenter;
use sweepd_core::segment::settings::{REMOVED, Table, Unit};
use sweepd_core::segment::{Config, MAX_ROWS, Method, SETTINGS, Segmenter, Setting};
use sweepd_core::sweep::layout::LayoutError;
use sweepd_core::sweep::{SweepMut, SweepRef};

/// Methods by name, the default first.
const METHODS: [(&str, Method); 2] = [("slope", Method::Slope), ("paper", Method::Paper)];

/// What a page asks for; what it does not name stays as it is.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct TuningRequest {
    method: Option<String>,
    settings: Option<BTreeMap<String, Option<f64>>>,
}

impl TuningRequest {
    /// The configuration that it makes of another one; none where it ends the tuning.
    ///
    /// # Errors
    /// What is refused, for people.
    pub(super) fn config(&self, base: &Config) -> Result<Option<Config>, String> {
        let Some(values) = &self.settings else {
            return Ok(None);
        };
        let mut config = base.clone();
        if let Some(name) = &self.method {
            let method = METHODS.iter().find(|(known, _)| known == name);
            let (_, method) = method.ok_or("the method is slope or paper")?;
            config.method = *method;
        }
        for (key, value) in values {
            // A page that was open before an upgrade.
            if REMOVED.iter().any(|removed| removed.key == *key) {
                continue;
            }
            let setting = SETTINGS.iter().find(|setting| setting.key == *key);
            let setting = setting.ok_or("there is no such setting")?;
            match *value {
                Some(value) if setting.allows(value) => setting.set(&mut config, value),
                Some(_) => return Err(format!("{key}: expected {}", setting.expected())),
                None if setting.absent.is_empty() => {
                    return Err(format!("{key}: expected {}", setting.expected()));
                }
                None => setting.take(&mut config, &Config::default()),
            }
        }
        config.check().map_err(|error| error.to_string())?;
        Ok(Some(config))
    }
}

/// The table of settings, for a page.
pub(super) fn settings(now: &Config) -> Value {
    let default = Config::default();
    let row = |setting: &Setting| {
        json!({
            "key": setting.key,
            "unit": match setting.unit {
                Unit::Count => "",
                Unit::Degrees => "deg",
                Unit::Metres => "m",
            },
            "default": setting.get(&default),
            "now": setting.get(now),
            "least": setting.range.start(),
            "most": setting.range.end(),
            "what": setting.doc,
            "absent": setting.absent,
        })
    };
    SETTINGS.iter().map(row).collect()
}

/// The names of the methods, the default first.
pub(super) fn methods() -> Value {
    METHODS.iter().map(|(name, _)| *name).collect()
}

/// The name of a configuration's method.
pub(super) fn method(config: &Config) -> &'static str {
    let known = METHODS.iter().find(|(_, method)| *method == config.method);
    known.map_or("", |(name, _)| name)
}

/// What a daemon has told that it segments with, but for its mask.
///
/// # Errors
/// It is another release, with other settings.
pub(super) fn told(settings: SegmentSettings) -> Result<Config, String> {
    let SegmentSettings {
        method,
        settings,
        max_object_deg,
        masked: _,
    } = settings;
    let request = TuningRequest {
        method: Some(method),
        settings: Some(settings),
    };
    let mut base = Config::default();
    if let Some(degrees) = max_object_deg {
        base.max_width_rad = degrees.to_radians() as f32;
    }
    Ok(request.config(&base)?.unwrap_or(base))
}

/// The lines of a sensor in the daemon's configuration that make one of another: the keys that
/// change.
pub(super) fn lines(config: &Config, configured: &Config) -> String {
    let mut text = String::new();
    for (table, head) in [
        (Table::Mount, "[sensor.mount]"),
        (Table::Segment, "[sensor.segment]"),
    ] {
        let mut lines = String::new();
        if table == Table::Segment && config.method != configured.method {
            lines += &format!("method = \"{}\"\n", method(config));
        }
        for setting in SETTINGS.iter().filter(|setting| setting.table == table) {
            if setting.is_same(config, configured) {
                continue;
            }
            lines += &match setting.get(config) {
                Some(value) => format!("{} = {value}\n", setting.key),
                None => format!("# without {}\n", setting.key),
            };
        }
        if !lines.is_empty() {
            text += &format!("{head}\n{lines}");
        }
    }
    if text.is_empty() {
        let of = match *configured == Config::default() {
            true => "defaults",
            false => "configuration",
        };
        text = format!("# nothing differs from the {of}\n");
    }
    text
}

/// A segmenter, and what it was made for.
struct Tuned {
    config: Config,
    /// Whether it takes the height of the sensor from headers.
    has_headers: bool,
    segmenter: TimedSegmenter,
}

/// Segments copies of sweeps.
#[derive(Default)]
pub(super) struct Tuner {
    buffers: HeapBuffers,
    segmenter: Option<Tuned>,
}

impl Tuner {
    /// A copy of a sweep, segmented like this. The height is that of the configuration, else that in
    /// the sweep's header; where this tilts the sensor in another way, it is estimated.
    ///
    /// # Errors
    /// Why it cannot be, for people.
    pub(super) fn segment(&mut self, bytes: &[u8], config: &Config) -> Result<Bytes, String> {
        let mut buffer = self
            .copy(bytes, config.min_points)
            .map_err(|error| error.to_string())?;
        let mut sweep = SweepMut::open(buffer.as_mut()).map_err(|error| error.to_string())?;
        // What was spent on the sweep itself.
        sweep.header.ground_ns = 0;
        if sweep.header.rows as usize > MAX_ROWS {
            return Err(format!(
                "the sweep has {} rows, more than {MAX_ROWS}",
                sweep.header.rows
            ));
        }
        // Degrees of a page are rounded.
        let is_same = |one_rad: f32, other_rad: f32| (one_rad - other_rad).abs() < 1e-4;
        let header = &sweep.header;
        // A sweep of another method says nothing of the height.
        let has_headers = (header.height_m > 0.0 || header.height_doubt != 0)
            && is_same(config.mount.pitch_rad, header.pitch_rad)
            && is_same(config.mount.roll_rad, header.roll_rad);
        self.segmenter(config, has_headers)?.segment(&mut sweep);
        // Of the table, only what is filled is sent.
        let mut shape = sweep.header.shape();
        shape.segments_capacity = sweep.header.segments as usize;
        let (offsets, total_bytes) = shape.offsets();
        sweep.header.segments_capacity = sweep.header.segments;
        (sweep.header.offsets, sweep.header.total_bytes) = (offsets, total_bytes as u64);
        sweep_bytes(buffer).ok_or_else(|| "the sweep cannot be read".to_owned())
    }

    fn segmenter(
        &mut self,
        config: &Config,
        has_headers: bool,
    ) -> Result<&mut TimedSegmenter, String> {
        let kept = self.segmenter.take();
        // One that looks for the floor itself is for this sweep alone.
        let kept = kept.filter(|kept| kept.config == *config && kept.has_headers && has_headers);
        let tuned = match kept {
            Some(kept) => kept,
            None => {
                let mut segmenter =
                    Segmenter::new(config.clone()).map_err(|error| error.to_string())?;
                if has_headers {
                    segmenter = segmenter.with_heights_in_headers();
                }
                Tuned {
                    config: config.clone(),
                    has_headers,
                    segmenter: TimedSegmenter::new(segmenter, monotonic_ns),
                }
            }
        };
        Ok(&mut self.segmenter.insert(tuned).segmenter)
    }

    /// A copy with room for all segments that there can be of this many points.
    fn copy(&mut self, bytes: &[u8], min_points: u32) -> Result<HeapBuffer, LayoutError> {
        let sweep = SweepRef::open(bytes)?;
        let segments = sweep.range.len() / (min_points as usize).max(1) + 1;
        // Those that it has are left out: there may be more.
        let untold = SweepRef {
            segments: &[],
            ..sweep
        };
        packed(&mut self.buffers, &untold, segments)
    }
}
