//! The pipeline as a whole: datagrams of a head that turns, and of whatever else is on the network.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::pipeline::{Arrival, Config, Event, Pipeline};
use sweepd::sensor::model::Stamp;
use sweepd::sensor::{Calibration, Model, ModelExt, stream};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{COLUMNS_CAPACITY, LABEL_FIRST_SEGMENT, ReturnChoice};
use sweepd::wire::data::{BLOCKS, DATA_PACKET_LEN, ReturnMode};
use sweepd::wire::hdl64::{Clock, Dump, Gps, Live, Series, pair};
use sweepd::wire::position::POSITION_PACKET_LEN;
use sweepd::wire::{DataPacket, Datagram};
use sweepd_lab::simulate::unit::unit;

use super::Numbers;

/// Packets of one run at most: a turn of an HDL-64E, some of the others.
const MOST_PACKETS: usize = 600;
const TURN: i64 = 36_000_000;
const MODES: [ReturnMode; 3] = [ReturnMode::Strongest, ReturnMode::Last, ReturnMode::Dual];

/// A sensor: time, azimuth and what it says of itself.
struct Head {
    model: Model,
    mode: ReturnMode,
    clock_ns: i64,
    arrival_ns: i64,
    /// Thousandths of hundredths of a degree.
    azimuth: i64,
    /// The same in a millisecond: 600 rpm is 3600 degrees a second.
    rate: i64,
    sent: u64,
}

impl Head {
    fn packet(&mut self) -> DataPacket {
        let spec = self.model.spec();
        let places = spec.places(self.mode);
        let block_ns = i64::from(spec.azimuth_period_ns(self.mode));
        let mut packet = DataPacket::new(0, self.mode.byte(), spec.product.unwrap_or_default());
        if self.model.is_hdl64e() {
            (packet.return_mode, packet.product) = status(self.sent as usize);
        }
        spec.mark_banks(&mut packet, self.mode);
        let begun_ns = self.clock_ns;
        for (index, block) in packet.blocks.iter_mut().enumerate() {
            if index > 0 && index % places.blocks == 0 && index < places.blocks * places.azimuths {
                self.turn(block_ns);
            }
            block.set_azimuth_cdeg((self.azimuth.rem_euclid(TURN) / 1000) as u16);
            for (channel, record) in block.records.iter_mut().enumerate() {
                // Walls with holes, and ground below.
                let noise = (self.sent as usize * 31 + index * 7 + channel * 131) as u16;
                record.distance.set(if noise.is_multiple_of(5) {
                    0
                } else {
                    1000 + channel as u16 * 300 + noise % 64
                });
                record.reflectivity = noise as u8;
            }
        }
        self.turn(block_ns);
        let stamp_ns = if spec.stamp == Stamp::Output {
            self.clock_ns
        } else {
            begun_ns
        };
        packet.set_stamp_us((stamp_ns / 1000).rem_euclid(3_600_000_000) as u32);
        self.sent += 1;
        packet
    }

    fn turn(&mut self, passed_ns: i64) {
        self.clock_ns = self.clock_ns.wrapping_add(passed_ns) & ((1 << 52) - 1);
        self.arrival_ns = self.arrival_ns.wrapping_add(passed_ns);
        self.azimuth = (self.azimuth + self.rate * passed_ns / 1_000_000).rem_euclid(TURN);
    }
}

/// The status that packet tells of the unit.
fn status(index: usize) -> (u8, u8) {
    static DUMP: OnceLock<Dump> = OnceLock::new();
    let dump = DUMP.get_or_init(|| {
        Dump::new(
            Series::S3,
            &stream::records(own()).expect("a unit of the simulator can tell itself"),
        )
    });
    let clock = Clock {
        hour: 1,
        minute: 2,
        second: 3,
        day: 4,
        month: 5,
        year: 26,
    };
    pair(
        dump,
        Series::S3,
        &Live {
            clock,
            gps: Gps::Both,
            temperature_c: 41,
            firmware: 0x47,
        },
        index,
    )
}

fn own() -> &'static Calibration {
    static UNIT: OnceLock<Calibration> = OnceLock::new();
    UNIT.get_or_init(|| unit(7))
}

/// The pipeline and what it was given.
struct Rig {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    data: u64,
    positions: u64,
    sequence: Option<u64>,
}

impl Rig {
    fn push(&mut self, arrival_ns: i64, payload: &[u8]) {
        let source = ([192, 168, 1, 201], 2368).into();
        *(if payload.len() == POSITION_PACKET_LEN {
            &mut self.positions
        } else {
            &mut self.data
        }) += 1;
        let datagram = Datagram {
            arrival_ns,
            source,
            destination_port: 2368,
            payload,
        };
        match datagram.parse() {
            Ok(packet) => self.pipeline.push(&packet),
            Err(_) => self.pipeline.push(Arrival::Malformed),
        }
        self.pipeline.idle(None);
        self.poll();
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            let bytes = match event {
                Event::Sweep(bytes) => bytes,
                Event::Fault(fault) => {
                    assert!(!fault.to_string().is_empty());
                    continue;
                }
                Event::Objects(_) | Event::Notice(_) => continue,
            };
            let sweep = SweepRef::open(bytes.as_ref()).expect("what is published is a sweep");
            let sequence = sweep.header.sequence;
            assert!(
                self.sequence.is_none_or(|last| sequence > last),
                "{sequence} after {:?}",
                self.sequence
            );
            self.sequence = Some(sequence);
            check(&sweep);
        }
        let _ = (self.pipeline.next_due_ns(None), self.pipeline.status());
    }
}

/// What is true of every sweep, whatever the packets say.
fn check(sweep: &SweepRef<'_>) {
    let header = sweep.header;
    assert!(sweep.columns.len() <= COLUMNS_CAPACITY && !sweep.columns.is_empty());
    let most = LABEL_FIRST_SEGMENT + header.segments;
    assert!(
        sweep
            .label
            .iter()
            .chain(sweep.label2)
            .all(|&label| label < most)
    );
    assert!(
        sweep
            .segments
            .iter()
            .all(|segment| segment.points > 0 && segment.nearest_m > 0.0)
    );
    let mut returns = 0;
    for one in sweep.returns() {
        returns += 1;
        assert!(
            one.range_m.is_finite() && one.range_m < 200.0 && (0.0..TAU).contains(&one.azimuth_rad),
            "{one:?}"
        );
        assert!(one.point_m.iter().all(|axis| axis.is_finite()), "{one:?}");
    }
    assert_eq!(returns, header.returns);
    let unfit = sweep
        .columns
        .iter()
        .find(|column| !(0.0..=TAU as f32).contains(&column.azimuth_rad));
    assert!(unfit.is_none(), "{unfit:?}");
    assert!(header.rpm >= 0.0 && header.rpm.is_finite());
}

/// How the pipeline is set, the sensor, then what happens, each a byte and what it needs.
pub fn pipeline(input: &[u8]) {
    let mut numbers = Numbers(input);
    let (setting, kind, cut, rate) = (numbers.u8(), numbers.u8(), numbers.u16(), numbers.u16());
    let model = Model::ALL[usize::from(kind) % Model::ALL.len()];
    let mut config = Config {
        model: (setting & 1 != 0).then_some(model),
        calibration: (setting & 2 == 0 && model.is_hdl64e()).then(|| own().clone()),
        cut_azimuth_rad: f64::from(cut) / 65_536.0 * TAU,
        return_choice: [
            ReturnChoice::Nearest,
            ReturnChoice::Strongest,
            ReturnChoice::Last,
        ][usize::from(setting >> 2) % 3],
        ..Config::default()
    };
    if setting & 0x80 != 0 {
        config.segment.method = sweepd::segment::Method::Paper;
    }
    let mut head = Head {
        model,
        mode: MODES[usize::from(kind) / Model::ALL.len() % 3],
        clock_ns: 3_599_900_000_000,
        arrival_ns: 1_700_000_000_000_000_000,
        azimuth: 12_345_000,
        rate: i64::from(rate as i16) * 10,
        sent: 0,
    };
    let pipeline = Pipeline::new("fuzz", config).expect("a configuration like others");
    let mut rig = Rig {
        pipeline,
        memory: Memory::default(),
        data: 0,
        positions: 0,
        sequence: None,
    };
    while !numbers.is_empty() && rig.data + rig.positions < MOST_PACKETS as u64 {
        happen(&mut numbers, &mut head, &mut rig);
    }
    rig.pipeline.end();
    rig.poll();
    let counts = rig.pipeline.status().counts;
    assert_eq!((counts.data, counts.position), (rig.data, rig.positions));
}

fn happen(numbers: &mut Numbers<'_>, head: &mut Head, rig: &mut Rig) {
    match numbers.u8() % 20 {
        // Packets as they should be.
        0..=3 => {
            for _ in 0..=numbers.u8() {
                let packet = head.packet();
                rig.push(head.arrival_ns, packet.emit());
            }
        }
        // Lost ones.
        4 => drop((0..=numbers.u8() >> 1).map(|_| head.packet()).last()),
        // The same twice.
        5 => {
            let packet = head.packet();
            (0..2).for_each(|_| rig.push(head.arrival_ns, packet.emit()));
        }
        // In another order.
        6 => {
            let mut packets: Vec<DataPacket> =
                (0..2 + numbers.u8() % 8).map(|_| head.packet()).collect();
            packets.reverse();
            packets
                .iter()
                .for_each(|packet| rig.push(head.arrival_ns, packet.emit()));
        }
        // Flipped bytes.
        7 => {
            let mut bytes = head.packet().emit().to_vec();
            for _ in 0..=numbers.u8() % 4 {
                bytes[usize::from(numbers.u16()) % DATA_PACKET_LEN] ^= numbers.u8();
            }
            rig.push(head.arrival_ns, &bytes);
        }
        // Clocks that jump: that of the sensor, that of the host.
        8 => {
            head.clock_ns = (head.clock_ns
                + ((i64::from(numbers.u16() as i16)) << (numbers.u8() % 34)))
                & ((1 << 52) - 1)
        }
        9 => {
            head.arrival_ns = head
                .arrival_ns
                .wrapping_add(i64::from(numbers.u16() as i16) << (numbers.u8() % 48))
        }
        10 => head.arrival_ns = numbers.i64(),
        // Nothing for a while.
        11 => {
            let now_ns = head
                .arrival_ns
                .wrapping_add(i64::from(numbers.u16() as i16) << (numbers.u8() % 48));
            rig.pipeline.idle(Some(now_ns));
            rig.poll();
        }
        // Any bytes.
        12 => {
            let len = [0, 1, 511, 1205, 1206, 1207, 9000][usize::from(numbers.u8()) % 7];
            let mut bytes = vec![numbers.u8(); len];
            let given = numbers.bytes(64.min(len));
            bytes[..given.len()].copy_from_slice(given);
            rig.push(head.arrival_ns, &bytes);
        }
        13 => {
            let mut bytes = [0; POSITION_PACKET_LEN];
            let given = numbers.bytes(100);
            bytes[0xC6..][..given.len()].copy_from_slice(given);
            rig.push(head.arrival_ns, &bytes);
        }
        // Another speed, sense, place, return mode, model.
        14 => head.rate = i64::from(numbers.u16() as i16) * 10,
        15 => head.azimuth = i64::from(numbers.u16()) * 1000 % TURN,
        16 => head.mode = MODES[usize::from(numbers.u8()) % 3],
        17 => head.model = Model::ALL[usize::from(numbers.u8()) % Model::ALL.len()],
        // All azimuths written over.
        18 => {
            let mut packet = head.packet();
            for block in 0..BLOCKS {
                packet.blocks[block].set_azimuth_cdeg(numbers.u16());
            }
            rig.push(head.arrival_ns, packet.emit());
        }
        _ if numbers.u8().is_multiple_of(4) => {
            rig.pipeline.end();
            rig.poll();
        }
        _ => rig.pipeline.push(Arrival::PassedOver),
    }
}
