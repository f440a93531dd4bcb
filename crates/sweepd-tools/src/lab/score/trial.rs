//! A method with one value of its parameter, and its scores so far.

use std::path::Path;
use std::time::Instant;

use super::Methods;
use sweepd::cli::CliError;
use sweepd_core::segment::{Config, Method};
use sweepd_lab::cloud::CloudSegmenter;
use sweepd_lab::score::{Baseline, ScanScore};

/// A method of ours. Its state, such as the height of the sensor, is reset for each sequence.
pub(super) struct OwnMethod {
    config: Config,
    columns: usize,
    segmenter: CloudSegmenter,
}

impl OwnMethod {
    pub(super) fn new(config: Config, columns: usize) -> Result<Self, CliError> {
        Ok(Self {
            segmenter: segmenter(&config, columns)?,
            config,
            columns,
        })
    }

    pub(super) fn begin_sequence(&mut self) -> Result<(), CliError> {
        self.segmenter = segmenter(&self.config, self.columns)?;
        Ok(())
    }

    pub(super) fn segment(&mut self, cloud: &Path, bytes: &[u8]) -> Result<Vec<u32>, CliError> {
        self.segmenter
            .segment(bytes)
            .map_err(|error| CliError::Failed(format!("{}: {error}", cloud.display())))
    }
}

fn segmenter(config: &Config, columns: usize) -> Result<CloudSegmenter, CliError> {
    CloudSegmenter::new(config.clone(), columns)
        .map_err(|error| CliError::Failed(error.to_string()))
}

/// What segments a cloud.
enum Segmentation {
    Own(Box<OwnMethod>),
    /// Segments of the points that our default method does not label as ground.
    Baseline(Baseline),
}

/// A method with one value of its parameter, and its scores so far.
pub(super) struct Trial {
    pub method: &'static str,
    pub parameter: &'static str,
    pub value: f64,
    pub unit: &'static str,
    segmentation: Segmentation,
    /// By the name of the sequence.
    pub scored: Vec<(String, ScanScore)>,
    ms: Vec<f64>,
}

/// A scan, with all that the trials share.
pub(super) struct LoadedScan<'a> {
    pub cloud: &'a Path,
    pub bytes: Vec<u8>,
    pub points: Vec<[f32; 4]>,
    /// Labels of the default method.
    pub ground: Vec<u32>,
}

impl Trial {
    /// All that were asked for.
    pub(super) fn all(args: &Methods) -> Result<Vec<Self>, CliError> {
        let mut trials = Vec::new();
        for (name, method) in [("slope", Method::Slope), ("paper", Method::Paper)] {
            for &theta_deg in &args.theta {
                let config = Config {
                    method,
                    theta_rad: theta_deg.to_radians() as f32,
                    ..Config::default()
                };
                trials.push(Self {
                    method: name,
                    parameter: "theta",
                    value: theta_deg,
                    unit: "degrees",
                    segmentation: Segmentation::Own(Box::new(OwnMethod::new(
                        config,
                        args.columns,
                    )?)),
                    scored: Vec::new(),
                    ms: Vec::new(),
                });
            }
        }
        for &distance_m in &args.distance {
            let baseline = Baseline::Euclidean { distance_m };
            trials.push(Self::baseline(
                "euclidean",
                "distance",
                distance_m,
                baseline,
            ));
        }
        for &cell_m in &args.cell {
            trials.push(Self::baseline(
                "grid",
                "cell",
                cell_m,
                Baseline::Grid { cell_m },
            ));
        }
        Ok(trials)
    }

    fn baseline(
        method: &'static str,
        parameter: &'static str,
        metres: f64,
        baseline: Baseline,
    ) -> Self {
        Self {
            method,
            parameter,
            value: metres,
            unit: "m",
            segmentation: Segmentation::Baseline(baseline),
            scored: Vec::new(),
            ms: Vec::new(),
        }
    }

    pub(super) fn begin_sequence(&mut self) -> Result<(), CliError> {
        match &mut self.segmentation {
            Segmentation::Own(method) => method.begin_sequence(),
            Segmentation::Baseline(_) => Ok(()),
        }
    }

    /// Labels a scan, and takes the time.
    pub(super) fn label(&mut self, scan: &LoadedScan<'_>) -> Result<Vec<u32>, CliError> {
        let start = Instant::now();
        let labels = match &mut self.segmentation {
            Segmentation::Own(method) => method.segment(scan.cloud, &scan.bytes)?,
            Segmentation::Baseline(baseline) => {
                baseline.segment(&scan.points, &scan.ground, Config::default().min_points)
            }
        };
        self.ms.push(start.elapsed().as_secs_f64() * 1e3);
        Ok(labels)
    }

    /// The median time of the scans: the first of a sequence also allocates memory.
    pub(super) fn median_ms(&self) -> f64 {
        let mut ms = self.ms.clone();
        ms.sort_unstable_by(f64::total_cmp);
        ms.get(ms.len() / 2).copied().unwrap_or_default()
    }
}
