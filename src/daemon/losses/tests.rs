use super::*;

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

/// Counts of five seconds, and words of their cause and cure.
#[test]
fn the_cause_follows_from_what_was_counted() {
    let data = 3000;
    let place = |sensors| SensorAddress {
        address: "10.0.0.5".to_owned(),
        port: Some(2368),
        sensors,
    };
    let recent = |counted| Recent {
        span: Duration::from_secs(5),
        counted,
    };
    let cases = [
        (
            Tally {
                data,
                lost: 750,
                ..Tally::default()
            },
            Cause::Network,
            "lost before this host, whose kernel dropped none on port 2368: look at cable",
        ),
        (
            Tally {
                data,
                lost: 750,
                dropped: 100,
                ..Tally::default()
            },
            Cause::Network,
            "most of them: its kernel dropped only 100 datagrams on port 2368: look",
        ),
        (
            Tally {
                data,
                lost: 750,
                dropped: 800,
                ..Tally::default()
            },
            Cause::Host,
            "this host's kernel dropped 800 datagrams",
        ),
        (
            Tally {
                data,
                lost: 750,
                dropped: 9000,
                strangers: 40_000,
                ..Tally::default()
            },
            Cause::Flood,
            "where 40000 of no configured sensor came too: find their sender with `tcpdump -ni any udp port 2368`",
        ),
        // Other senders that cause no drops are not blamed.
        (
            Tally {
                data,
                lost: 750,
                strangers: 40_000,
                ..Tally::default()
            },
            Cause::Network,
            "look at cable",
        ),
        (
            Tally {
                data,
                late: 1500,
                lost: 20,
                ..Tally::default()
            },
            Cause::SecondSensor,
            "1500 behind stamps that came before, as if two heads sent from 10.0.0.5 to port 2368",
        ),
        (
            Tally {
                data,
                other_product: 900,
                malformed: 7,
                ..Tally::default()
            },
            Cause::SecondSensor,
            "900 with the byte of another product, 7 with azimuths of no turning head, as if",
        ),
        (
            Tally {
                data,
                unconfirmed: 900,
                ..Tally::default()
            },
            Cause::SecondSensor,
            "900 with a stamp that no neighbour confirms, as if",
        ),
        (
            Tally {
                data,
                refused: 900,
                ..Tally::default()
            },
            Cause::NoPackets,
            "900 datagrams from 10.0.0.5 to port 2368 are no packets of a sensor",
        ),
    ];
    for (counted, cause, words) in cases {
        let recent = recent(counted);
        assert_eq!(recent.cause(), cause, "{counted:?}");
        assert!(
            recent.sentence(&place(1)).contains(words),
            "{}",
            recent.sentence(&place(1))
        );
    }
    let shared = recent(Tally {
        data,
        lost: 9,
        dropped: 9,
        ..Tally::default()
    })
    .sentence(&place(3));
    assert!(
        shared.contains("port 2368, which 3 sensors share, because the daemon did not fetch them"),
        "{shared}"
    );
    let unknown = SensorAddress {
        port: None,
        ..place(0)
    };
    let of_consumer = recent(Tally {
        data,
        lost: 9,
        ..Tally::default()
    })
    .sentence(&unknown);
    assert!(
        of_consumer.contains("dropped none on its port"),
        "{of_consumer}"
    );
}

#[test]
fn a_share_counts_each_packet_once() {
    // Of 1000 packets, 200 are in no sweep: 150 did not come, 50 came late and were counted as lost
    // before.
    let counted = Tally {
        data: 850,
        lost: 200,
        late: 50,
        ..Tally::default()
    };
    let share = Recent {
        span: WINDOW,
        counted,
    }
    .share();
    assert!((share - 0.2).abs() < 1e-12, "{share}");
    // The 40 damaged packets are also missing by the sensor's clock, so that no cable is blamed.
    let recent = Recent {
        span: WINDOW,
        counted: Tally {
            data: 960,
            lost: 40,
            refused: 40,
            ..Tally::default()
        },
    };
    assert!(
        (recent.share() - 0.04).abs() < 1e-12 && recent.cause() == Cause::NoPackets,
        "{recent:?}"
    );
    let counted = Tally {
        refused: 500,
        ..Tally::default()
    };
    assert!(
        (Recent {
            span: WINDOW,
            counted
        }
        .share()
            - 1.0)
            .abs()
            < 1e-12
    );
}
