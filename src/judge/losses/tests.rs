use super::*;

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
            "900 with the byte of another product, as if",
        ),
        (
            Tally {
                data,
                malformed: 900,
                ..Tally::default()
            },
            Cause::NoPackets,
            "900 packets from 10.0.0.5 to port 2368 have azimuths of no turning head",
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
        shared.contains("port 2368, which 3 sensors share, because they were not fetched in time"),
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
        span: Duration::from_secs(5),
        counted,
    }
    .share();
    assert!((share - 0.2).abs() < 1e-12, "{share}");
    // The 40 damaged packets are also missing by the sensor's clock, so that no cable is blamed.
    let recent = Recent {
        span: Duration::from_secs(5),
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
            span: Duration::from_secs(5),
            counted
        }
        .share()
            - 1.0)
            .abs()
            < 1e-12
    );
}
