use super::*;
use crate::judge::losses::SensorAddress;

/// A sensor that sends 750 packets a second, observed twice a second.
struct Watched {
    losses: Losses,
    now: Duration,
    tally: Tally,
}

impl Watched {
    fn new() -> Self {
        Self {
            losses: Losses::new(Limits::default()),
            now: Duration::ZERO,
            tally: Tally::default(),
        }
    }

    /// Runs for these seconds, with this change each half second; gives the reported changes.
    fn run(&mut self, seconds: u32, happens: fn(&mut Tally)) -> Vec<Turn> {
        let mut told = Vec::new();
        for _ in 0..2 * seconds {
            self.now += Duration::from_millis(500);
            happens(&mut self.tally);
            told.extend(self.losses.observe(self.now, self.tally));
        }
        told
    }

    fn sentence(&self) -> String {
        let place = SensorAddress {
            address: "192.168.1.201".to_owned(),
            port: Some(2368),
            sensors: 1,
        };
        self.losses.recent().unwrap().sentence(&place)
    }
}

fn well(tally: &mut Tally) {
    tally.data += 375;
}

fn loses_half(tally: &mut Tally) {
    tally.data += 188;
    tally.lost += 187;
}

fn loses_a_tenth(tally: &mut Tally) {
    tally.data += 337;
    tally.lost += 38;
}

fn loses_one_in_a_hundred(tally: &mut Tally) {
    tally.data += 371;
    tally.lost += 4;
}

#[test]
fn losses_are_logged_when_they_begin_and_when_they_are_over() {
    let mut roof = Watched::new();
    assert_eq!(roof.run(20, well), []);
    assert_eq!(roof.run(20, loses_a_tenth), [Turn::Begun(Level::Warning)]);
    assert!(
        roof.sentence()
            .starts_with("10.1 % of its packets are lost or of no use (380 of 3750 in 5 s)")
    );
    let [Turn::Over(lasted)] = roof.run(20, well)[..] else {
        panic!("not told once that it is over")
    };
    assert!((20..=25).contains(&lasted.as_secs()), "{lasted:?}");
    assert_eq!((roof.losses.level(), roof.run(60, well)), (None, vec![]));
}

#[test]
fn many_losses_are_a_level_of_their_own_and_fall_back_by_half_of_each_limit() {
    let mut roof = Watched::new();
    // From the first observation: no level in between.
    assert_eq!(roof.run(10, loses_half), [Turn::Begun(Level::Fault)]);
    // A tenth is just above half of the second limit, so that the level stays.
    assert_eq!(
        (roof.run(20, loses_a_tenth), roof.losses.level()),
        (vec![], Some(Level::Fault))
    );
    // 1.07 % is below half of both.
    assert_eq!(roof.run(20, loses_one_in_a_hundred).len(), 1);
    assert_eq!(roof.losses.level(), None);
    let mut rear = Watched::new();
    rear.run(10, well);
    assert_eq!(
        rear.run(10, loses_half),
        [Turn::Begun(Level::Warning), Turn::Begun(Level::Fault)]
    );
}

#[test]
fn losses_that_vary_around_a_limit_are_reported_once() {
    let mut roof = Watched::new();
    roof.run(10, well);
    let mut told = Vec::new();
    for second in 0..120 {
        // 2.1 % and 3.7 %, some seconds each.
        let wavers: fn(&mut Tally) = match second % 12 {
            0..6 => |tally| (tally.data, tally.lost) = (tally.data + 361, tally.lost + 14),
            _ => |tally| (tally.data, tally.lost) = (tally.data + 367, tally.lost + 8),
        };
        told.extend(roof.run(1, wavers));
    }
    assert_eq!(told, [Turn::Begun(Level::Warning)]);
}

#[test]
fn drops_and_duplicates_that_vary_around_a_limit_are_there_once() {
    let mut roof = Watched::new();
    roof.run(10, well);
    let mut told = vec![(None, false)];
    for second in 0..120 {
        // 2.1 % and 3.7 % dropped, 0.7 % and 1.2 % twice, some seconds each.
        roof.run(
            1,
            match second % 12 {
                0..6 => |tally| came(tally, 375, 14, 5),
                _ => |tally| came(tally, 375, 8, 2),
            },
        );
        let level = roof.losses.dropping().map(|(level, _)| level);
        told.push((level, roof.losses.duplicates().is_some()));
        told.dedup();
    }
    let warning = Some(Level::Warning);
    let begins = [(None, false), (warning, false), (warning, true)];
    assert!(
        told.len() <= 3 && told.iter().all(|one| begins.contains(one)),
        "{told:?}"
    );
    assert_eq!(told.last(), Some(&(warning, true)));
    roof.run(10, well);
    assert!(roof.losses.dropping().is_none() && roof.losses.duplicates().is_none());
}

/// What came to the port in half a second.
fn came(tally: &mut Tally, data: u64, dropped: u64, duplicates: u64) {
    tally.data += data;
    tally.received += data;
    tally.dropped += dropped;
    tally.duplicates += duplicates;
}

#[test]
fn what_comes_first_and_what_came_before_a_reload_is_no_loss() {
    let mut roof = Watched::new();
    // A second in which the model is detected and packets are out of order.
    assert_eq!(
        roof.run(1, |tally| (tally.data, tally.lost) =
            (tally.data + 100, tally.lost + 300)),
        []
    );
    assert_eq!(roof.run(20, well), []);
    roof.losses.begin_anew();
    assert_eq!(
        roof.run(1, |tally| (tally.data, tally.lost) =
            (tally.data + 100, tally.lost + 300)),
        []
    );
    assert_eq!(roof.run(20, well), []);
    assert!(
        roof.losses
            .recent()
            .is_some_and(|recent| recent.share() == 0.0)
    );
    // Losses go on over a reload, and end with the stream.
    roof.run(10, loses_half);
    roof.losses.begin_anew();
    assert_eq!(
        (roof.losses.level(), roof.run(10, loses_half)),
        (Some(Level::Fault), vec![])
    );
    roof.losses.forget();
    assert_eq!((roof.losses.level(), roof.losses.recent()), (None, None));
    assert_eq!(roof.run(20, well), []);
}

#[test]
fn some_packets_alone_are_no_share() {
    let mut roof = Watched::new();
    assert_eq!(
        roof.run(20, |tally| (tally.data, tally.lost) =
            (tally.data + 4, tally.lost + 4)),
        []
    );
}
