//! How fast a sensor turns, by its sweeps.

use std::fmt;

use sweepd_core::sweep::layout::{Header, flags};

/// Speed over whole sweeps; over partial ones as long as there is no whole one.
#[derive(Clone, Debug, Default)]
pub struct Speed {
    /// Whether a whole sweep came.
    is_whole: bool,
    sweeps: u64,
    sum_rpm: f64,
    /// Least and greatest.
    bounds_rpm: Option<[f32; 2]>,
    is_reversed: bool,
}

impl Speed {
    /// Adds a sweep.
    pub fn add(&mut self, header: &Header) {
        let is_whole = !header.has(flags::PARTIAL);
        if is_whole && !self.is_whole {
            *self = Self {
                is_whole,
                ..Self::default()
            };
        }
        if is_whole != self.is_whole {
            return;
        }
        self.sweeps += 1;
        self.sum_rpm += f64::from(header.rpm);
        let [least, most] = self.bounds_rpm.unwrap_or([header.rpm; 2]);
        self.bounds_rpm = Some([least.min(header.rpm), most.max(header.rpm)]);
        self.is_reversed |= header.has(flags::REVERSED);
    }

    /// Whether there are sweeps, and none of them is whole.
    pub fn lacks_a_turn(&self) -> bool {
        self.sweeps > 0 && !self.is_whole
    }

    /// The mean, turns a minute; `None` without a sweep.
    pub fn mean_rpm(&self) -> Option<f64> {
        (self.sweeps > 0).then(|| self.sum_rpm / self.sweeps as f64)
    }

    /// The least and the greatest, turns a minute; `None` without a sweep.
    pub fn bounds_rpm(&self) -> Option<[f32; 2]> {
        self.bounds_rpm
    }

    /// Whether the head turns counter-clockwise.
    pub fn is_reversed(&self) -> bool {
        self.is_reversed
    }
}

/// `599.9 rpm (599.7 to 600.1)`; nothing without a sweep.
impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let (Some(rpm), Some([least, most])) = (self.mean_rpm(), self.bounds_rpm) {
            write!(f, "{rpm:.1} rpm ({least:.1} to {most:.1})")?;
        }
        match self.is_reversed {
            true => f.write_str(", counter-clockwise"),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zerocopy::FromZeros;

    /// By hand: a part of a turn counts until a whole one comes, and not after.
    #[test]
    fn whole_turns_count_where_there_are_some() {
        let mut speed = Speed::default();
        let mut add = |rpm, flags| {
            let mut header = Header::new_zeroed();
            (header.rpm, header.flags) = (rpm, flags);
            speed.add(&header);
            (speed.mean_rpm(), speed.lacks_a_turn(), speed.to_string())
        };
        let partly = (Some(580.0), true, "580.0 rpm (580.0 to 580.0)".to_owned());
        assert_eq!(add(580.0, flags::PARTIAL), partly);
        add(600.0, 0);
        add(10.0, flags::PARTIAL);
        let wholly = (
            Some(601.0),
            false,
            "601.0 rpm (600.0 to 602.0), counter-clockwise".to_owned(),
        );
        assert_eq!(add(602.0, flags::REVERSED), wholly);
        assert_eq!(Speed::default().mean_rpm(), None);
    }
}
