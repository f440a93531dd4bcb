//! Lets the clocks of sensors go on where a capture begins again, so that a loop is no jump of them.

use std::borrow::Cow;
use std::time::Duration;

use sweepd_core::wire::{DataPacket, HOUR_US, position};

/// The clocks of the sensors of a capture that is played again and again.
#[derive(Debug, Default)]
pub struct Onward {
    /// How far they are ahead of the capture in this round, microseconds.
    ahead_us: u64,
    /// By number of the sensor.
    clocks: Vec<Clock>,
}

/// The clock of a sensor in this round.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    newest_us: Option<u32>,
    /// From the first stamp to the newest one, microseconds.
    ran_us: i64,
    packets: u64,
}

impl Clock {
    fn note(&mut self, stamp_us: u32) {
        let before_us = self.newest_us.replace(stamp_us).unwrap_or(stamp_us);
        let hour_us = i64::from(HOUR_US);
        let step_us = (i64::from(stamp_us) - i64::from(before_us)).rem_euclid(hour_us);
        // A packet that was overtaken steps back, and the next one forward again.
        self.ran_us += match step_us < hour_us / 2 {
            true => step_us,
            false => step_us - hour_us,
        };
        self.packets += 1;
    }

    /// From the first stamp to the one that would come next.
    fn round_us(&self) -> u64 {
        let ran_us = self.ran_us.max(0) as u64;
        ran_us + ran_us / self.packets.saturating_sub(1).max(1)
    }
}

impl Onward {
    /// A data packet as it is sent in this round.
    pub fn data<'p>(&mut self, sensor: usize, payload: &'p [u8]) -> Cow<'p, [u8]> {
        let Ok(packet) = DataPacket::parse(payload) else {
            return payload.into();
        };
        if self.clocks.len() <= sensor {
            self.clocks.resize(sensor + 1, Clock::default());
        }
        let stamp_us = packet.stamp_us();
        self.clocks[sensor].note(stamp_us);
        if self.ahead_us == 0 {
            return payload.into();
        }
        let mut packet = *packet;
        packet.set_stamp_us(((u64::from(stamp_us) + self.ahead_us) % u64::from(HOUR_US)) as u32);
        packet.emit().to_vec().into()
    }

    /// A position packet as it is sent in this round.
    pub fn position<'p>(&self, payload: &'p [u8]) -> Cow<'p, [u8]> {
        match position::later(payload, self.ahead_us) {
            Some(later) if self.ahead_us > 0 => later.to_vec().into(),
            _ => payload.into(),
        }
    }

    /// The capture begins again. Gives how long it lasted: by the clock of the sensor that sent most,
    /// with the time from its last packet to the next.
    pub fn begin_again(&mut self) -> Duration {
        let busiest = self.clocks.iter().max_by_key(|clock| clock.packets);
        let round_us = busiest.map_or(0, Clock::round_us);
        self.clocks.clear();
        self.ahead_us += round_us;
        Duration::from_micros(round_us)
    }
}
