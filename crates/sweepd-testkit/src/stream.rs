//! Packet streams made block by block, and the sweeps that a pipeline makes of them: no scene, only
//! time and azimuth.

use std::collections::BTreeSet;

use sweepd_core::buffers::{Buffers, HeapBuffer, HeapBuffers, Memory};
use sweepd_core::pipeline::{Arrival, Config, Counts, Event, Pipeline};
use sweepd_core::sensor::model::Stamp;
use sweepd_core::sensor::{Beam, Calibration, Model, ModelExt};
use sweepd_core::sweep::SweepRef;
use sweepd_core::wire::Datagram;
use sweepd_core::wire::data::{BLOCKS, Banks, DataPacket, RECORDS, Record, ReturnMode};

/// Arrival of a packet whose last shot is at sensor time 0.
pub const START_NS: i64 = 1_777_888_800_000_000_000;
const TURN: f64 = 36_000.0;

/// A turning head, given by its azimuth over time.
pub struct Spin {
    /// What it is.
    pub model: Model,
    /// Which returns it sends.
    pub mode: ReturnMode,
    /// Turns since the start, by seconds since the start; negative turns the other way.
    pub turns_at: Box<dyn Fn(f64) -> f64>,
    /// Hundredths of a degree.
    pub start_cdeg: f64,
    /// Azimuths are off by up to this, hundredths of a degree.
    pub jitter_cdeg: f64,
    /// What the sensor measures: from, to, hundredths of a degree.
    pub fov: Option<(f64, f64)>,
    /// What it is set to later, and when, seconds since the start.
    pub fov_later: Vec<(f64, Option<(f64, f64)>)>,
    /// Sensor clock at the start, nanoseconds.
    pub clock_ns: i64,
    /// Of its noise.
    pub seed: u64,
}

/// A packet on its way.
#[derive(Clone)]
pub struct Sent {
    /// Its bytes.
    pub packet: DataPacket,
    /// When it arrives, nanoseconds since 1970.
    pub arrival_ns: i64,
    /// Sensor time and true azimuth of the firings, nanoseconds since the start and hundredths of a
    /// degree.
    pub firings: Vec<(i64, f64)>,
    /// Its place in the stream as it was sent.
    pub ordinal: usize,
}

impl Spin {
    /// A head that turns evenly and sees all around, with the noise of an encoder.
    pub fn new(model: Model, mode: ReturnMode, rpm: f64) -> Self {
        Self {
            model,
            mode,
            turns_at: Box::new(move |seconds| rpm / 60.0 * seconds),
            start_cdeg: 12_345.0,
            jitter_cdeg: 2.0,
            fov: None,
            fov_later: Vec::new(),
            clock_ns: 1_234_567_891,
            seed: 7,
        }
    }

    fn azimuth_cdeg(&self, time_ns: i64) -> f64 {
        (self.start_cdeg + TURN * (self.turns_at)(time_ns as f64 * 1e-9)).rem_euclid(TURN)
    }

    fn is_seen(&self, cdeg: f64, time_ns: i64) -> bool {
        let set = self
            .fov_later
            .iter()
            .rfind(|(from_s, _)| time_ns as f64 * 1e-9 >= *from_s);
        set.map_or(self.fov, |&(_, fov)| fov)
            .is_none_or(|(from, to)| (cdeg - from).rem_euclid(TURN) <= (to - from).rem_euclid(TURN))
    }

    /// The packets that the sensor sends in this many seconds.
    pub fn packets(&self, seconds: f64) -> Vec<Sent> {
        let spec = self.model.spec();
        let places = spec.places(self.mode);
        let block_ns = i64::from(spec.azimuth_period_ns(self.mode));
        let mut rng = fastrand::Rng::with_seed(self.seed);
        let mut sent: Vec<Sent> = Vec::new();
        let mut packet = DataPacket::new(0, self.mode.byte(), spec.product.unwrap_or_default());
        spec.mark_banks(&mut packet, self.mode);
        let mut firings = Vec::new();
        let mut blocks = 0;
        for time_ns in (0..(seconds * 1e9) as i64).step_by(block_ns as usize) {
            let cdeg = self.azimuth_cdeg(time_ns);
            if !self.is_seen(cdeg, time_ns) {
                continue;
            }
            let stamp_us = |time_ns| ((self.clock_ns + time_ns) / 1000 % 3_600_000_000) as u32;
            if blocks == 0 {
                packet.set_stamp_us(stamp_us(time_ns));
            }
            let told = (cdeg + self.jitter_cdeg * (2.0 * rng.f64() - 1.0))
                .rem_euclid(TURN)
                .round() as u16;
            for block in &mut packet.blocks[blocks..blocks + places.blocks] {
                block.set_azimuth_cdeg(told);
                block.records = std::array::from_fn(|_| record(&mut rng));
            }
            for firing in 0..spec.firings_per_azimuth() {
                let time_ns = time_ns + firing as i64 * i64::from(spec.firing_period_ns(self.mode));
                firings.push((time_ns, self.azimuth_cdeg(time_ns)));
            }
            blocks += places.blocks;
            if blocks == places.blocks * places.azimuths {
                if spec.stamp == Stamp::Output {
                    packet.set_stamp_us(stamp_us(time_ns + block_ns));
                }
                let arrival_ns = START_NS + time_ns + block_ns + 90_000 + rng.i64(0..20_000);
                let firings = std::mem::take(&mut firings);
                sent.push(Sent {
                    packet,
                    arrival_ns,
                    firings,
                    ordinal: sent.len(),
                });
                blocks = 0;
            }
        }
        sent
    }
}

/// Takes the returns of a channel out of a data packet of a sensor with this number of channels.
pub fn blank(payload: &mut [u8], channels: usize, channel: usize) {
    for block in payload[..1200].chunks_exact_mut(100) {
        // The flags of the banks are 0xEEFF, 0xDDFF, 0xCCFF and 0xBBFF.
        let bank = usize::from(0xEE_u8.saturating_sub(block[1]) / 0x11) * 32;
        for (index, record) in block[4..].chunks_exact_mut(3).enumerate() {
            // A block may hold a channel twice.
            if (bank + index) % channels == channel {
                record[..2].fill(0);
            }
        }
    }
}

/// One in four shots sees nothing.
fn record(rng: &mut fastrand::Rng) -> Record {
    let distance = if rng.u8(..) < 64 {
        0
    } else {
        rng.u16(250..50_000)
    };
    Record {
        distance: distance.into(),
        reflectivity: rng.u8(..),
    }
}

/// Pushes a datagram of the sensor; one that is no packet is malformed.
pub fn push(pipeline: &mut Pipeline, datagram: &Datagram<'_>) {
    match datagram.parse() {
        Ok(packet) => pipeline.push(&packet),
        Err(_) => pipeline.push(Arrival::Malformed),
    }
}

/// The next sweep; passes over what else happened.
///
/// # Panics
/// At a fault: tests that expect one poll the pipeline themselves.
pub fn next_sweep<B: Buffers>(
    pipeline: &mut Pipeline,
    memory: &mut Memory<B>,
) -> Option<B::Buffer> {
    while let Some(event) = pipeline.poll(memory) {
        match event {
            Event::Sweep(sweep) => return Some(sweep),
            Event::Fault(fault) => panic!("{fault}"),
            Event::Objects(_) | Event::Notice(_) => {}
        }
    }
    None
}

/// What became of a stream.
pub struct Run {
    /// The sweeps, in the order in which they came out.
    pub sweeps: Vec<HeapBuffer>,
    /// What the pipeline counted.
    pub counts: Counts,
    /// How many packets had been pushed when each sweep came out.
    pub out_after: Vec<usize>,
}

/// An HDL-64E whose beams point aside and need no other correction, so that its ranges are those of
/// the packets.
pub fn unit() -> Calibration {
    let beam = |channel: usize| Beam {
        rotation_rad: [-8.3_f64, 5.1, -1.7, 9.6][channel % 4].to_radians(),
        ..Beam::ideal(channel, (2.0 - 0.42 * (channel ^ 3) as f64).to_radians())
    };
    Calibration::new((0..64).map(beam).collect(), 0.002).unwrap()
}

/// Nothing is segmented: the pixels are noise.
pub fn config() -> Config {
    let mut config = Config::default();
    (config.segment.min_range_m, config.segment.max_range_m) = (0.0, 0.01);
    config.segment.mount.height_m = Some(1.0);
    config
}

/// The same, with sweeps that begin at this azimuth, degrees.
pub fn cut_at(deg: f64) -> Config {
    Config {
        cut_azimuth_rad: deg.to_radians(),
        ..config()
    }
}

/// A datagram of the sensor.
pub fn datagram(payload: &[u8], arrival_ns: i64) -> Datagram<'_> {
    Datagram {
        arrival_ns,
        source: ([192, 168, 1, 201], 2368).into(),
        destination_port: 2368,
        payload,
    }
}

impl Run {
    /// Pushes packets as they arrived; an HDL-64E has the calibration of [`unit()`].
    pub fn of(config: Config, arrived: &[Sent]) -> Self {
        let payloads: Vec<_> = arrived
            .iter()
            .map(|sent| (sent.packet.emit().to_vec(), sent.arrival_ns))
            .collect();
        Self::of_payloads(config, &payloads)
    }

    /// The same for bytes and when they arrived, nanoseconds.
    pub fn of_payloads(config: Config, arrived: &[(Vec<u8>, i64)]) -> Self {
        let two_heads = |payload: &[u8]| {
            DataPacket::parse(payload).is_ok_and(|p| p.banks() == Banks::Alternating)
        };
        let calibration = arrived
            .iter()
            .take(5)
            .find(|(payload, _)| two_heads(payload))
            .map(|_| unit());
        let config = Config {
            calibration: calibration.or(config.calibration.clone()),
            ..config
        };
        let mut pipeline = Pipeline::new("test", config).unwrap();
        let mut memory = Memory::new(HeapBuffers::default());
        let (mut sweeps, mut out_after) = (Vec::new(), Vec::new());
        for (index, (payload, arrival_ns)) in arrived.iter().enumerate() {
            push(&mut pipeline, &datagram(payload, *arrival_ns));
            if index % 3 == 0 {
                pipeline.idle(None);
            }
            while let Some(event) = pipeline.poll(&mut memory) {
                sweeps.extend(event.sweep());
            }
            out_after.resize(sweeps.len(), index + 1);
        }
        pipeline.end();
        while let Some(event) = pipeline.poll(&mut memory) {
            sweeps.extend(event.sweep());
        }
        out_after.resize(sweeps.len(), arrived.len());
        Self {
            sweeps,
            counts: pipeline.status().counts,
            out_after,
        }
    }

    /// Views of the sweeps.
    pub fn views(&self) -> Vec<SweepRef<'_>> {
        self.sweeps
            .iter()
            .map(|sweep| SweepRef::open(sweep.as_ref()).unwrap())
            .collect()
    }

    /// The flags of each sweep.
    pub fn flags(&self) -> Vec<u32> {
        self.views()
            .iter()
            .map(|sweep| sweep.header.flags)
            .collect()
    }

    /// The numbers of the packets that were decoded.
    pub fn decoded(&self) -> BTreeSet<usize> {
        let views = self.views();
        let columns = views
            .iter()
            .flat_map(|sweep| sweep.columns)
            .filter(|column| column.is_measured());
        columns.map(|column| column.packet as usize).collect()
    }

    /// Checks that every return of every decoded packet is in one pixel, every other packet is
    /// counted, and each sweep is valid.
    #[track_caller]
    pub fn check(&self, arrived: &[DataPacket]) -> &Self {
        let decoded = self.decoded();
        assert!(
            self.found(arrived.len()) == self.expected(&decoded, arrived),
            "returns are lost, doubled or elsewhere"
        );
        let counts = self.counts;
        let Counts {
            duplicates,
            malformed,
            late,
            unconfirmed,
            foreign,
            undecoded,
            ..
        } = counts;
        let refused = duplicates + malformed + late + unconfirmed + foreign + undecoded;
        assert_eq!(counts.data, decoded.len() as u64 + refused, "{counts:?}");
        for sweep in self.views() {
            check_sweep(&sweep);
            check_pixels(&sweep);
        }
        self
    }

    /// The returns of the sweeps.
    #[track_caller]
    fn found(&self, packets: usize) -> Wire {
        let mut found = Wire::new(packets);
        for sweep in self.views() {
            let unit_m = model_of(&sweep).spec().distance_unit_m;
            for one in sweep.returns() {
                let distance = (f64::from(one.range_m) / unit_m).round() as u16;
                found.add(
                    one.packet as usize,
                    usize::from(one.block),
                    one.channel,
                    (distance, one.reflectivity),
                );
            }
        }
        found
    }

    /// The returns of the packets that were decoded.
    #[track_caller]
    fn expected(&self, decoded: &BTreeSet<usize>, arrived: &[DataPacket]) -> Wire {
        let mut used = vec![(0, 0); arrived.len()];
        for sweep in self.views() {
            let places = model_of(&sweep).spec().places(sweep.header.return_mode());
            let blocks = places.blocks * places.azimuths;
            for column in sweep.columns.iter().filter(|column| column.is_measured()) {
                used[column.packet as usize] = (sweep.rows(), blocks);
            }
        }
        let mut expected = Wire::new(arrived.len());
        for &number in decoded {
            let (rows, blocks) = used[number];
            for (block, stored) in arrived[number].blocks[..blocks].iter().enumerate() {
                for (index, record) in stored.records.iter().enumerate() {
                    let measured = (record.distance.get(), record.reflectivity);
                    if measured.0 != 0 {
                        expected.add(number, block, index % rows, measured);
                    }
                }
            }
        }
        expected
    }

    /// [`Run::check`] for packets of a [`Spin`].
    #[track_caller]
    pub fn check_sent(&self, arrived: &[Sent]) -> &Self {
        self.check(&arrived.iter().map(|sent| sent.packet).collect::<Vec<_>>())
    }

    /// Packets that sweeps count as lost.
    pub fn lost_in_sweeps(&self) -> u64 {
        self.views()
            .iter()
            .map(|sweep| u64::from(sweep.header.lost_packets))
            .sum()
    }

    /// The content of the sweeps without counters and arrival, with packets numbered in the order
    /// in which they were sent.
    pub fn content(&self, arrived: &[Sent]) -> Vec<Content> {
        let name = |number: u64| arrived.get(number as usize).map(|sent| sent.ordinal);
        let content = |sweep: SweepRef<'_>| Content {
            header: (
                sweep.header.flags,
                sweep.header.sensor_time_ns,
                sweep.header.duration_ns,
                sweep.header.rpm,
            ),
            columns: sweep
                .columns
                .iter()
                .map(|c| {
                    (
                        name(c.packet),
                        c.azimuth_rad,
                        c.azimuth_rate_rad_s,
                        c.time_ns,
                        c.block,
                        c.status,
                    )
                })
                .collect(),
            pixels: [sweep.range, sweep.range2].concat(),
            bytes: [sweep.reflectivity, sweep.reflectivity2, sweep.kind].concat(),
            labels: [sweep.label, sweep.label2].concat(),
        };
        self.views().into_iter().map(content).collect()
    }
}

fn model_of(sweep: &SweepRef<'_>) -> Model {
    Model::from_code(sweep.header.model).expect("the model of a sweep")
}

/// See [`Run::content`].
#[derive(Debug, PartialEq)]
pub struct Content {
    header: (u32, i64, u64, f32),
    columns: Vec<(Option<usize>, f32, f32, u32, u8, u8)>,
    pixels: Vec<f32>,
    bytes: Vec<u8>,
    labels: Vec<u32>,
}

/// Returns by packet, block and channel within the block; a block of a 16-beam sensor has two of
/// each.
#[derive(PartialEq)]
struct Wire(Vec<[u32; 2]>);

impl Wire {
    fn new(packets: usize) -> Self {
        Self(vec![[0; 2]; packets * BLOCKS * RECORDS])
    }

    #[track_caller]
    fn add(
        &mut self,
        packet: usize,
        block: usize,
        channel: usize,
        (distance, reflectivity): (u16, u8),
    ) {
        let pair = &mut self.0[(packet * BLOCKS + block) * RECORDS + channel % RECORDS];
        assert_eq!(pair[0], 0, "three returns where there is room for two");
        pair[0] = 1 << 24 | u32::from(distance) << 8 | u32::from(reflectivity);
        pair.sort_unstable();
    }
}

impl Content {
    /// The same without the columns' turning rates, and with azimuths to a hundredth of a degree.
    pub fn without_rates(mut self) -> Self {
        for (_, azimuth_rad, rate_rad_s, ..) in &mut self.columns {
            *rate_rad_s = 0.0;
            *azimuth_rad = (azimuth_rad.to_degrees() * 50.0).round();
        }
        self
    }
}

/// Checks the header against the content.
#[track_caller]
fn check_sweep(sweep: &SweepRef<'_>) {
    use sweepd_core::sweep::layout::flags::{CIRCULAR, PARTIAL, RATE_UNSTABLE};
    let header = sweep.header;
    assert!(header.columns > 0 && header.columns <= header.columns_capacity);
    assert_eq!(sweep.returns().count(), header.returns as usize);
    assert!(
        sweep
            .columns
            .windows(2)
            .all(|two| two[0].time_ns <= two[1].time_ns),
        "columns out of order"
    );
    assert!(
        sweep
            .columns
            .iter()
            .all(|c| (0.0..std::f32::consts::TAU).contains(&c.azimuth_rad))
    );
    let mut fired = sweep.columns.iter().filter(|column| column.is_fired());
    assert_eq!(
        u64::from(fired.next_back().unwrap().time_ns),
        header.duration_ns
    );
    let unfired = sweep.columns.iter().filter(|column| !column.is_fired());
    assert_eq!(unfired.count(), header.unfired_columns as usize);
    let missing = sweep
        .columns
        .iter()
        .filter(|column| column.is_missing())
        .count();
    assert_eq!(missing, header.missing_columns as usize);
    let packets: BTreeSet<u64> = sweep
        .columns
        .iter()
        .filter(|column| column.is_measured())
        .map(|column| column.packet)
        .collect();
    assert_eq!(packets.len(), header.packets as usize);
    assert!(header.flags & PARTIAL == 0 || header.flags & CIRCULAR == 0);
    if header.flags & (CIRCULAR | RATE_UNSTABLE) == CIRCULAR {
        let turns = f64::from(header.rpm) / 60e9 * header.duration_ns as f64;
        assert!(
            (0.99..1.01).contains(&turns),
            "a sweep of {turns} turns is circular"
        );
    }
    assert!(header.rpm >= 0.0 && header.rpm.is_finite());
}

/// Checks that each return is in the column of its firing.
#[track_caller]
fn check_pixels(sweep: &SweepRef<'_>) {
    use sweepd_core::sweep::layout::flags::{CIRCULAR, PARTIAL, RATE_UNSTABLE};
    let header = sweep.header;
    let rows = sweep.rows();
    let moved = sweep.beams.iter().any(|beam| beam.shift != 0);
    // One in eleven: all rows and columns in a few sweeps.
    for (index, &range) in sweep
        .range
        .iter()
        .enumerate()
        .step_by(if moved { 11 } else { 1 })
    {
        let (row, column) = (index % rows, index / rows);
        let fired_in = column as i64 + i64::from(sweep.beams[row].shift);
        let beyond =
            header.flags & CIRCULAR == 0 && !(0..sweep.columns.len() as i64).contains(&fired_in);
        let firing = sweep.firing(row, column);
        assert!(
            range == 0.0 || firing.is_measured() && !beyond,
            "a return without a firing"
        );
        // Within half a column of its column's azimuth, and one more where the turn was folded.
        if range > 0.0 && header.flags & (PARTIAL | RATE_UNSTABLE) == 0 && moved {
            let pitch = f64::from(header.rpm) / 60.0 * std::f64::consts::TAU * 57.6e-6;
            let off = sweep.azimuth_rad(row, column) - f64::from(sweep.columns[column].azimuth_rad);
            let off = (off + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                - std::f64::consts::PI;
            assert!(
                off.abs() < 2.5 * pitch,
                "row {row}, column {column} is {off} off"
            );
        }
    }
    assert!(
        sweep
            .returns()
            .all(|one| (0.0..std::f64::consts::TAU).contains(&one.azimuth_rad))
    );
    assert!(RECORDS.is_multiple_of(rows) || rows == 64);
}
