use super::*;
use crate::sensor::{Model, ModelExt};

const PERIOD_US: f64 = 1327.104;

/// The n-th packet of a VLP-16 at 600 rpm.
fn packet(n: u32) -> DataPacket {
    let mut packet = DataPacket::new(1_000_000 + (f64::from(n) * PERIOD_US) as u32, 0x37, 0x22);
    for (block, stored) in (0..).zip(&mut packet.blocks) {
        stored.set_azimuth_cdeg(((f64::from(n * 12 + block) * 39.813_12) % 36_000.0) as u16);
    }
    packet
}

struct Line(PacketOrder);

impl Line {
    /// After ten packets in order.
    fn new() -> Self {
        let mut line = Self(PacketOrder::new(Model::Vlp16.spec()));
        (0..10).for_each(|n| assert_eq!(line.push(&packet(n), n).unwrap().len(), 1));
        line
    }

    /// The packets that come out when this one arrives as number `n`.
    fn push(&mut self, packet: &DataPacket, n: u32) -> Result<Vec<(u64, PacketGap)>, Rejection> {
        let arrival_ns = (f64::from(n) * PERIOD_US * 1e3) as i64;
        self.0
            .push(packet, ReturnMode::Strongest, u64::from(n), arrival_ns)?;
        Ok(self.out())
    }

    fn out(&mut self) -> Vec<(u64, PacketGap)> {
        let mut out = Vec::new();
        while let Some((index, before)) = self.0.pop() {
            out.push((self.0.packet(index).number, before));
        }
        out
    }
}

#[test]
fn behind_a_gap_four_packets_are_held() {
    let mut line = Line::new();
    (11..15).for_each(|n| assert_eq!(line.push(&packet(n), n), Ok(vec![])));
    let out = line.push(&packet(15), 15).unwrap();
    assert!(matches!(
        out[0],
        (
            11,
            PacketGap::Lost {
                is_exact: true,
                packets: 1,
                silence: None,
                ..
            }
        )
    ));
    assert_eq!(out[1..], [12, 13, 14, 15].map(|n| (n, PacketGap::None)));
    assert!(matches!(
        line.push(&packet(10), 16),
        Err(Rejection::Behind { .. })
    ));
    assert_eq!(line.push(&packet(10), 17), Err(Rejection::Duplicate));
}

/// Minutes ahead, every stamp is near a whole number of periods. It must not hold packets back, nor
/// count as loss.
#[test]
fn a_stamp_far_ahead_is_forgotten_with_the_next_packet() {
    let mut line = Line::new();
    let mut corrupt = packet(10);
    corrupt.set_stamp_us(corrupt.stamp_us() + 100 * 1_327_104);
    assert_eq!(line.push(&corrupt, 10), Ok(vec![]));
    (11..15).for_each(|n| assert_eq!(line.push(&packet(n), n), Ok(vec![])));
    let out = line.push(&packet(15), 15).unwrap();
    assert!(matches!(out[0], (11, PacketGap::Lost { packets: 1, .. })));
    line.0.flush();
    assert_eq!(
        (line.out(), line.0.counts()),
        (
            vec![],
            OrderCounts {
                unconfirmed: 1,
                ..OrderCounts::default()
            }
        )
    );
}

/// One azimuth at the end of a packet cannot distinguish a sector that is left out from a corrupt
/// byte; the next stamp can.
#[test]
fn a_jump_at_the_edge_of_a_packet_waits_for_the_next_stamp() {
    for block in [0, 11] {
        let mut line = Line::new();
        let mut corrupt = packet(10);
        corrupt.blocks[block].set_azimuth_cdeg(20_000);
        assert_eq!(line.push(&corrupt, 10), Ok(vec![]));
        assert_eq!(line.push(&packet(11), 11), Ok(vec![]));
        line.0.flush();
        assert!(matches!(
            line.out()[..],
            [(11, PacketGap::Lost { packets: 1, .. })]
        ));

        let mut line = Line::new();
        let mut leaping = packet(10);
        let beyond = packet(10 + 37);
        let from = block.max(1);
        for (stored, later) in leaping.blocks.iter_mut().zip(&beyond.blocks).skip(from) {
            stored.set_azimuth_cdeg(later.azimuth_cdeg());
        }
        assert_eq!(line.push(&leaping, 10), Ok(vec![]));
        let out = line.push(&packet(48), 48).unwrap();
        assert_eq!(out, [(10, PacketGap::None), (48, PacketGap::None)]);
        assert!(line.0.sector().is_some());
    }
}

/// An overtaken packet confirms the stamp of the one that overtook it, but not an azimuth at the
/// far end of that.
#[test]
fn an_overtaken_packet_does_not_vouch_for_a_jump_at_the_edge() {
    for block in [0, 11] {
        let mut line = Line::new();
        let mut corrupt = packet(11);
        corrupt.blocks[block].set_azimuth_cdeg(20_000);
        let arrivals = [corrupt, packet(10), packet(12), packet(13)];
        let arrive = |(place, packet): (u32, &DataPacket)| line.push(packet, 10 + place).unwrap();
        let mut out: Vec<_> = (0..).zip(&arrivals).flat_map(arrive).collect();
        line.0.flush();
        out.extend(line.out());
        // Numbers are those of the arrival: the packet from before, and the two behind the corrupt
        // one.
        assert!(matches!(
            out[..],
            [
                (11, PacketGap::None),
                (12, PacketGap::Lost { packets: 1, .. }),
                (13, PacketGap::None)
            ]
        ));
        assert!(line.0.sector().is_none());
    }
}

#[test]
fn a_clock_that_jumps_is_believed_when_the_next_packet_agrees() {
    let mut line = Line::new();
    let mut jumped = [packet(10), packet(11)];
    jumped
        .iter_mut()
        .for_each(|one| one.set_stamp_us(one.stamp_us() + 77_777_777));
    assert_eq!(line.push(&jumped[0], 10), Ok(vec![]));
    assert_eq!(
        line.push(&jumped[1], 11),
        Ok(vec![(10, PacketGap::Start), (11, PacketGap::None)])
    );
    assert_eq!(line.0.counts(), OrderCounts::default());
}

#[test]
fn it_keeps_its_promises_when_ready_packets_are_not_taken_out() {
    let mut order = PacketOrder::new(Model::Vlp16.spec());
    for n in 0..200 {
        order
            .push(&packet(n), ReturnMode::Strongest, u64::from(n), 0)
            .unwrap();
    }
    let mut numbers =
        std::iter::from_fn(|| order.pop().map(|(index, _)| order.packet(index).number));
    assert!((0..200).all(|n| numbers.next() == Some(n)));
}
