//! The images that segmentation is measured on: simulated, rendered, real, and such as nobody would
//! want.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use sweepd_testkit::stream::next_sweep;

use fastrand::Rng;
use sweepd::admission::{DiscoveredSensors, Route};
use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{Buffers, HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Pipeline};
use sweepd::sensor::{Beam, Model};
use sweepd::sweep::layout::{flags, is_return};
use sweepd::sweep::{Column, Shape, SweepMut, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::cloud::{self, CloudProjector};
use sweepd_lab::simulate::shape::Ray;
use sweepd_lab::simulate::view::View;
use sweepd_lab::simulate::{Emitter, EmitterConfig, Setting, fixtures};

/// Height of the sensor over the ground in the images that are made here, metres.
pub const HEIGHT_M: f32 = 1.9;
/// Farthest return in them, metres.
const FARTHEST_M: f64 = 120.0;

/// A whole sweep with a name for the tables.
pub struct Image {
    pub name: String,
    pub pixels: usize,
    buffer: HeapBuffer,
}

impl Image {
    fn new(what: &str, mut buffer: HeapBuffer) -> Self {
        let sweep = SweepMut::open(buffer.as_mut()).unwrap();
        let name = format!("{}x{} {what}", sweep.header.rows, sweep.header.columns);
        Self {
            name,
            pixels: sweep.image_pixels().len(),
            buffer,
        }
    }

    pub fn sweep(&mut self) -> SweepMut<'_> {
        SweepMut::open(self.buffer.as_mut()).unwrap()
    }

    /// The bytes of the sweep.
    pub fn bytes(&self) -> &[u8] {
        self.buffer.as_ref()
    }

    /// Segments that it was last found to have.
    pub fn segments(&mut self) -> u32 {
        self.sweep().header.segments
    }
}

/// The sensors' shapes, simulated and, where the data is at hand, real.
pub fn sensors() -> Vec<Image> {
    let mut images = vec![
        Image::new("street", simulated(Model::Vlp16)),
        Image::new("street", simulated(Model::Hdl32e)),
        street(64, 870),
        Image::new("street", simulated(Model::Hdl64eS2)),
        street(128, 1876),
    ];
    let Some(data) = data() else { return images };
    for (what, file) in [
        ("Einride", "vlp16_einride-a"),
        ("Monterey", "hdl32e_veloview-monterey-a"),
    ] {
        images.push(Image::new(
            what,
            captured(&data.join("pcap").join(file).with_extension("pcap")),
        ));
    }
    images.extend([870, cloud::COLUMNS].into_iter().filter_map(scan));
    images
}

/// The image of a real HDL-64E at full width, or where it is not at hand, of a simulated one.
pub fn full() -> Image {
    scan(cloud::COLUMNS).unwrap_or_else(|| Image::new("street", simulated(Model::Hdl64eS2)))
}

/// A real scan in an image of this many columns, where the data is at hand.
pub fn scan(columns: usize) -> Option<Image> {
    Some(Image::new(
        "KITTI",
        projected(&kitti(&data()?, SCAN), columns),
    ))
}

/// Another real scan in an image of full width, where the data is at hand.
pub fn scan_of(name: &str) -> Option<Image> {
    let points = kitti(&data()?, name);
    Some(Image::new(
        &format!("KITTI {}", name.replace('/', "-")),
        projected(&points, cloud::COLUMNS),
    ))
}

/// The folder with real data, if it is there.
pub fn data() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    Some(std::env::var_os("SWEEPD_DATA").map_or_else(beside, PathBuf::from))
        .filter(|dir| dir.join("pcap").is_dir())
}

/// The scan that most tables have.
pub const SCAN: &str = "00/000000";

/// The points of a scan.
pub fn kitti(data: &Path, name: &str) -> Vec<[f32; 4]> {
    let path = data.join("labelled/semantickitti").join(name);
    cloud::points(&std::fs::read(path.with_extension("bin")).unwrap()).unwrap()
}

fn projected(points: &[[f32; 4]], columns: usize) -> HeapBuffer {
    let mut projector = CloudProjector::new(columns).unwrap();
    projector.project(points).unwrap();
    projector.into_buffer().unwrap()
}

/// The second whole sweep of a capture.
fn captured(path: &Path) -> HeapBuffer {
    let mut capture = Capture::open(path).unwrap();
    let mut sensors = DiscoveredSensors::new(Vec::new());
    let mut pipeline = Pipeline::new("bench", Config::default()).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    let mut whole = 0;
    while let Some(datagram) = capture.next_datagram().unwrap() {
        if let Ok((Route::Data(_), packet)) = sensors.admit(&datagram) {
            pipeline.push(&packet);
        }
        while let Some(buffer) = next_sweep(&mut pipeline, &mut memory) {
            whole += u32::from(is_whole(&buffer));
            if whole == 2 {
                return buffer;
            }
        }
    }
    panic!("{}: no two whole sweeps", path.display())
}

fn is_whole(buffer: &HeapBuffer) -> bool {
    !SweepRef::open(buffer.as_ref())
        .unwrap()
        .header
        .has(flags::PARTIAL)
}

/// The first whole sweep of a sensor in the street.
fn simulated(model: Model) -> HeapBuffer {
    let scene = fixtures::scene();
    let sensor = EmitterConfig::new(model, ReturnMode::Strongest).turns(2.5);
    let config = Config {
        calibration: Some(sensor.beams().into_owned()),
        ..Config::default()
    };
    let mut pipeline = Pipeline::new("bench", config).unwrap();
    let mut memory = Memory::new(HeapBuffers::default());
    for one in Emitter::new(sensor, &scene) {
        pipeline.push(&one.datagram().parse().unwrap());
        while let Some(buffer) = next_sweep(&mut pipeline, &mut memory) {
            if is_whole(&buffer) {
                return buffer;
            }
        }
    }
    panic!("two and a half turns hold a whole one")
}

/// The street as beams see it that no supported model has: even from +3 to -25 degrees, of 128 from
/// +15.
pub fn street(rows: usize, columns: usize) -> Image {
    let scene = Setting::Street.build(1);
    let origin = Setting::Street.pose(0).origin;
    let view = View::new(&scene, origin, 0.0, 0.0, 0.0);
    let mut rng = Rng::with_seed(1);
    made("street, rays", rows, columns, |row, column| {
        let ray = Ray::new(
            origin,
            azimuth_rad(column, columns),
            elevation_rad(row, rows),
        );
        let hit = view.cast(&ray, 0.0, FARTHEST_M, &mut rng)?;
        Some((hit.distance_m + 0.02 * (rng.f64() - rng.f64())) as f32)
    })
}

/// Flat ground, and on it a grid of boards at distances of their own: many segments, or few.
pub fn boards(rows: usize, columns: usize, across: usize, down: usize) -> Image {
    let mut rng = Rng::with_seed(1);
    let boards: Vec<f32> = (0..across * down)
        .map(|_| 5.0 + 2.0 * rng.u32(0..20) as f32)
        .collect();
    made("boards", rows, columns, |row, column| {
        let ground_m = -HEIGHT_M / elevation_rad(row, rows).sin() as f32;
        let board_m = boards[column * across / columns * down + row * down / rows];
        let nearest_m = if ground_m > 0.0 {
            ground_m.min(board_m)
        } else {
            board_m
        };
        Some(nearest_m)
    })
}

/// The worst of cases for runs, joins and components; the height is told, so that all columns are
/// climbed.
pub fn worst(rows: usize, columns: usize) -> Vec<Image> {
    let mut rng = Rng::with_seed(1);
    let mut random = move || rng.f32();
    let mut again = Rng::with_seed(2);
    let mut coin = move || again.bool();
    let mut images = Vec::new();
    let mut add = |what, range_m: &mut dyn FnMut(usize, usize) -> f32| {
        images.push(made(what, rows, columns, |row, column| {
            Some(range_m(row, column)).filter(|range| is_return(*range))
        }));
    };
    add("all at one range", &mut |_, _| 10.0);
    add("checkerboard, holes", &mut |row, column| {
        if (row + column).is_multiple_of(2) {
            10.0
        } else {
            0.0
        }
    });
    add("checkerboard, 10 and 10.5 m", &mut |row, column| {
        10.0 + 0.5 * ((row + column) % 2) as f32
    });
    add("columns, 10 m and holes", &mut |_, column| {
        if column.is_multiple_of(2) { 10.0 } else { 0.0 }
    });
    add("columns, 10 and 10.5 m", &mut |_, column| {
        10.0 + 0.5 * (column % 2) as f32
    });
    add("columns, 10 and 10.7 m", &mut |_, column| {
        10.0 + 0.7 * (column % 2) as f32
    });
    add("rows, 10 m and holes", &mut |row, _| {
        if row.is_multiple_of(2) { 10.0 } else { 0.0 }
    });
    add("rows, 10 and 10.5 m", &mut |row, _| {
        10.0 + 0.5 * (row % 2) as f32
    });
    add("rows, 10 and 10.7 m", &mut |row, _| {
        10.0 + 0.7 * (row % 2) as f32
    });
    add("comb, 10 m, shaft up", &mut |row, column| {
        if row == 0 || column.is_multiple_of(2) {
            10.0
        } else {
            10.8
        }
    });
    add("random, 10 m or hole", &mut |_, _| {
        if coin() { 10.0 } else { 0.0 }
    });
    add("random, 10 to 10.5 m", &mut |_, _| 10.0 + 0.5 * random());
    add("random, 10 to 12 m", &mut |_, _| 10.0 + 2.0 * random());
    add("random, 1 to 5 m", &mut |_, _| 1.0 + 4.0 * random());
    add("random, 1 to 80 m", &mut |_, _| 1.0 + 79.0 * random());
    images
}

fn azimuth_rad(column: usize, columns: usize) -> f64 {
    (column as f64 + 0.5) / columns as f64 * TAU
}

fn elevation_rad(row: usize, rows: usize) -> f64 {
    let top_deg = if rows > 64 { 15.0 } else { 3.0 };
    (top_deg + (-25.0 - top_deg) * (row as f64 + 0.5) / rows as f64).to_radians()
}

/// A whole turn of such ranges, of even beams and columns.
fn made(
    what: &str,
    rows: usize,
    columns: usize,
    mut range_m: impl FnMut(usize, usize) -> Option<f32>,
) -> Image {
    let shape = Shape {
        rows,
        columns_capacity: columns,
        dual: false,
        segments_capacity: rows * columns,
    };
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
    sweep.header.columns = columns as u32;
    sweep.header.flags = flags::CIRCULAR;
    for (index, column) in sweep.columns.iter_mut().enumerate() {
        let time_ns = 1e8 * index as f64 / columns as f64;
        *column = Column::measured(
            0,
            0,
            azimuth_rad(index, columns) as f32,
            (10.0 * TAU) as f32,
            time_ns as u32,
        );
    }
    for (row, beam) in sweep.beams.iter_mut().enumerate() {
        *beam = Beam::ideal(row, elevation_rad(row, rows)).row(0);
    }
    for (index, range) in sweep.range.iter_mut().enumerate() {
        *range = range_m(index % rows, index / rows).unwrap_or(0.0);
    }
    sweep.header.returns = sweep
        .range
        .iter()
        .filter(|range| is_return(**range))
        .count() as u32;
    Image::new(what, buffer)
}
