use super::*;
use crate::sensor_settings::{Returns, Rpm};
use sweepd_core::floor::Floor;
use sweepd_core::segment::{self, Mount};
use sweepd_core::sweep::height::HeightDoubt;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::nmea::NmeaError;

const RUNNING: Running = Running {
    model: Model::Vlp16,
    rpm: 599.6,
    return_mode: ReturnMode::Strongest,
    fov: Some(FieldOfView::WHOLE),
};

/// A sensor that is observed ten times a second.
struct Watched {
    watcher: Watcher,
    seen: Observation,
}

impl Watched {
    fn new(rpm: Option<u16>) -> Self {
        let want = Settings {
            rpm: rpm.map(Rpm),
            ..Settings::default()
        };
        let place = SensorAddress {
            address: "192.168.1.201".to_owned(),
            port: Some(2368),
            sensors: 1,
        };
        Self {
            watcher: Watcher::new("roof", place, want, Limits::default(), Duration::ZERO),
            seen: Observation::default(),
        }
    }

    /// Observes for this many tenths of a second, with this many packets and sweeps in each.
    fn observe(&mut self, tenths: u32, data: u64, sweeps: u64) -> Vec<String> {
        let mut texts = Vec::new();
        for _ in 0..tenths {
            self.seen.now += Duration::from_millis(100);
            self.seen.data += data;
            self.seen.steady_sweeps += sweeps;
            self.seen.running =
                (self.seen.steady_sweeps > 0).then(|| self.seen.running.unwrap_or(RUNNING));
            texts.extend(
                self.watcher
                    .observe(&self.seen)
                    .into_iter()
                    .map(|message| message.text),
            );
        }
        texts
    }

    fn turn(&mut self, running: Running) {
        self.seen.running = Some(running);
    }
}

const NONE: Sight = Sight::NoFloor {
    is_contradicted: false,
};

#[test]
fn each_change_of_a_sensors_state_is_logged_once() {
    let mut roof = Watched::new(None);
    let silence = "roof: no packets from 192.168.1.201 on port 2368: is it powered, and is this host its \
                       destination?";
    assert_eq!(roof.observe(19, 0, 0), [""; 0]);
    assert_eq!(roof.observe(100, 0, 0), [silence]);
    assert_eq!(roof.watcher.state(), State::Waiting);
    let spinning = "roof: packets arrive from 192.168.1.201, waiting for its first whole turn";
    assert_eq!(roof.observe(15, 75, 0), [spinning]);
    assert_eq!(roof.watcher.complaint(), Some(first_turn().to_string()));
    assert_eq!(roof.observe(85, 75, 0), [""; 0]);
    assert_eq!(roof.watcher.complaint(), Some(no_sweep().to_string()));
    let streaming = "roof: streaming, VLP-16 at 600 rpm, one return";
    assert_eq!(roof.observe(100, 75, 1), [streaming]);
    assert_eq!(
        (roof.watcher.state(), roof.watcher.complaint()),
        (State::Streaming, None)
    );
    // The last turn is not complete.
    assert_eq!(roof.observe(1, 37, 0), [""; 0]);
    let stalled = "roof: no packets from 192.168.1.201 on port 2368, though they came before: has it lost its power or \
                       its cable, or was its destination changed?";
    assert_eq!(roof.observe(50, 0, 0), [stalled]);
    assert_eq!(roof.watcher.state(), State::Stalled);
    assert_eq!(roof.observe(5, 75, 0), [spinning]);
    assert_eq!(roof.observe(5, 75, 1), [streaming]);
}

#[test]
fn why_no_packets_come_is_logged_when_it_is_known_and_once_a_minute_at_most() {
    let mut roof = Watched::new(None);
    assert_eq!(roof.observe(30, 0, 0).len(), 1);
    for (why, told) in [("one", 1), ("one", 0), ("another", 0)] {
        let (what, cure) = (why.to_owned(), "change it".to_owned());
        roof.watcher.explain_silence(Some(Cause { what, cure }));
        let silence = format!("roof: no packets from 192.168.1.201 on port 2368: {why}: change it");
        let expected = vec![silence.clone(); told];
        assert_eq!(roof.observe(100, 0, 0), expected);
        assert_eq!(
            silence.strip_prefix("roof: "),
            roof.watcher.complaint().as_deref()
        );
    }
    assert_eq!(roof.observe(600, 0, 0).len(), 1);
    // A new stall has the reason with it.
    roof.observe(10, 75, 1);
    assert!(roof.observe(50, 0, 0)[0].ends_with(": another: change it"));
}

#[test]
fn a_head_that_stops_is_reported_and_a_short_slowdown_is_not() {
    let mut roof = Watched::new(None);
    roof.observe(10, 75, 1);
    assert_eq!(roof.observe(15, 75, 0), [""; 0]);
    assert_eq!(roof.observe(1, 75, 1), [""; 0]);
    assert_eq!(roof.observe(40, 75, 0), [format!("roof: {}", no_sweep())]);
    assert_eq!(roof.watcher.state(), State::SpinningUp);
}

#[test]
fn a_wrong_model_is_reported_again_only_when_the_reason_changes() {
    let mut roof = Watched::new(None);
    roof.observe(1, 75, 0);
    for expected in [&["roof: this is a VLS-128"][..], &[], &[]] {
        roof.watcher.refused("this is a VLS-128".to_owned());
        assert_eq!(roof.observe(20, 75, 0), expected);
        assert_eq!(
            roof.watcher.complaint().as_deref(),
            Some("this is a VLS-128")
        );
        assert_eq!(roof.watcher.state(), State::WrongModel);
    }
    roof.watcher.refused("this is something else".to_owned());
    assert_eq!(roof.observe(20, 75, 0), ["roof: this is something else"]);
    assert_eq!(
        roof.observe(1, 75, 1),
        ["roof: streaming, VLP-16 at 600 rpm, one return"]
    );
}

#[test]
fn the_calibration_is_awaited_and_then_it_streams() {
    let mut roof = Watched::new(None);
    roof.watcher.awaits_calibration();
    assert_eq!(
        roof.observe(5, 300, 0),
        [format!("roof: {}", no_calibration())]
    );
    assert_eq!(roof.watcher.state(), State::NoCalibration);
    roof.watcher.unhindered();
    assert_eq!(roof.observe(5, 300, 0).len(), 1);
    assert_eq!(roof.watcher.state(), State::SpinningUp);
}

#[test]
fn another_mode_or_model_is_reported_and_a_drifting_speed_is_not() {
    let mut roof = Watched::new(None);
    roof.observe(1, 75, 1);
    roof.turn(Running {
        rpm: 580.0,
        ..RUNNING
    });
    assert_eq!(roof.observe(5, 75, 1), [""; 0]);
    roof.turn(Running {
        return_mode: ReturnMode::Dual,
        ..RUNNING
    });
    assert_eq!(
        roof.observe(5, 75, 1),
        ["roof: streaming, VLP-16 at 600 rpm, two returns"]
    );
    roof.turn(Running {
        model: Model::Hdl32e,
        ..RUNNING
    });
    assert_eq!(
        roof.observe(5, 75, 1),
        ["roof: streaming, HDL-32E at 600 rpm, one return"]
    );
}

#[test]
fn a_wrong_speed_is_reported_once_and_is_a_fault_of_the_sensor() {
    let mut roof = Watched::new(Some(600));
    assert_eq!(roof.observe(5, 75, 1).len(), 1);
    roof.turn(Running {
        rpm: 540.0,
        ..RUNNING
    });
    let off = "turns at 540 rpm, [sensor.want] says 600: change one of the two";
    assert_eq!(roof.observe(5, 75, 1), [format!("roof: {off}")]);
    assert_eq!(roof.watcher.complaint().as_deref(), Some(off));
    roof.turn(Running {
        rpm: 575.0,
        ..RUNNING
    });
    assert_eq!(
        roof.observe(5, 75, 1),
        [""; 0],
        "within what is told, but not back yet"
    );
    roof.turn(RUNNING);
    assert_eq!(
        roof.observe(5, 75, 1),
        ["roof: turns at 600 rpm again, as it is set to"]
    );
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn other_settings_than_wanted_are_a_warning_and_logged_once() {
    let mut roof = Watched::new(None);
    roof.watcher.expect(Settings {
        returns: Some(Returns(ReturnMode::Strongest)),
        fov: Some(FieldOfView::WHOLE),
        ..Settings::default()
    });
    assert_eq!(roof.observe(5, 75, 1).len(), 1);
    roof.turn(Running {
        fov: "270-90".parse().ok(),
        ..RUNNING
    });
    let unlike = "measures from 270-90 degrees, wanted is 0-359";
    assert_eq!(roof.observe(5, 75, 1), [format!("roof: {unlike}")]);
    roof.turn(Running {
        fov: "270-91".parse().ok(),
        ..RUNNING
    });
    let no_news: [&str; 0] = [];
    assert_eq!(roof.observe(1, 75, 1), no_news);
    roof.turn(Running {
        fov: "270-90".parse().ok(),
        ..RUNNING
    });
    assert_eq!(roof.observe(1, 75, 1), no_news);
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::Streaming, false));
    assert_eq!(
        is.complaint,
        Some(format!("{unlike}: change one of the two"))
    );
    roof.turn(RUNNING);
    assert_eq!(roof.observe(5, 75, 1), ["roof: is set as wanted again"]);
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn position_packets_alone_are_no_silence() {
    let mut roof = Watched::new(None);
    roof.seen.position = 5;
    let told = roof.observe(30, 0, 0);
    assert_eq!(told.len(), 1);
    assert!(
        told[0].contains("only position packets from 192.168.1.201"),
        "{told:?}"
    );
}

/// Seconds of a sensor that streams and loses this many packets for each 75 that come.
fn lose(roof: &mut Watched, seconds: u32, lost: u64) -> Vec<String> {
    let mut told = Vec::new();
    for _ in 0..10 * seconds {
        roof.seen.tally.data += 75;
        roof.seen.tally.lost += lost;
        told.extend(roof.observe(1, 75, 1));
    }
    told
}

fn floor(doubt: Option<HeightDoubt>) -> Floor {
    Floor {
        height_m: 0.4,
        pitch_rad: (-10_f32).to_radians(),
        roll_rad: 0.0,
        height_spread_m: 0.001,
        pitch_spread_rad: 0.0,
        roll_spread_rad: 0.0,
        sweeps: 15,
        looks: 15,
        doubt,
    }
}

#[test]
fn a_floor_is_told_with_the_mount_that_it_gives() {
    let line = "mount = { height_m = 0.400, pitch_deg = -10.0, roll_deg = 0.0 }  # spread 0.001 m";
    for (mount, is_warning) in [(floor(None).mount(), false), (Mount::default(), true)] {
        let mut roof = Watched::new(None);
        roof.observe(5, 75, 1);
        let config = segment::Config {
            mount,
            ..Default::default()
        };
        let see =
            |roof: &mut Watched, sight| roof.watcher.see_floor(floor::Seen::new(sight, &config));
        let told = see(&mut roof, Sight::Floor(floor(None))).unwrap();
        assert!(
            told.is_warning == is_warning && told.text.contains(line),
            "{told:?}"
        );
        let complaint = roof.watcher.complaint();
        assert_eq!(complaint.is_some_and(|one| one.contains(line)), is_warning);
        assert_eq!(see(&mut roof, Sight::Floor(floor(None))), None);
    }
}

/// The log has each doubt once, whatever its numbers, and that it is over; `/health` has the newest.
#[test]
fn a_doubt_about_the_height_is_logged_when_it_begins_and_when_it_is_over() {
    let mut roof = Watched::new(None);
    roof.observe(5, 75, 1);
    let mount = Mount {
        height_m: None,
        ..floor(None).mount()
    };
    let config = segment::Config {
        mount,
        ..Default::default()
    };
    let doubt = |far_dm| Sight::Floor(floor(Some(HeightDoubt::Small { far_dm })));
    let [deeper, as_deep, deeper_yet] = [0.8, 0.82, 0.85].map(|height_m| Floor {
        height_m,
        ..floor(None)
    });
    for (sight, logged) in [
        (
            NONE,
            Some(
                "no floor is seen: everything is an obstacle; no level surface is in sight: set height_m",
            ),
        ),
        (NONE, None),
        (doubt(9), Some("it ends 0.9 m from the sensor")),
        (doubt(8), None),
        (Sight::Floor(floor(None)), Some("height_m = 0.400")),
        (Sight::Floor(deeper), Some("height_m = 0.800")),
        (Sight::Floor(as_deep), None),
        // 5 % deeper and more.
        (Sight::Floor(deeper_yet), Some("height_m = 0.850")),
        (
            doubt(7),
            Some("the height is a guess: 0.40 m; it ends 0.7 m"),
        ),
        (NONE, Some("no floor is seen")),
    ] {
        let seen = floor::Seen::new(sight, &config);
        let told = roof.watcher.see_floor(seen);
        assert_eq!(told.is_some(), logged.is_some(), "{sight:?}: {told:?}");
        if let Some((told, words)) = told.zip(logged) {
            assert!(told.text.contains(words), "{told:?}");
            assert_eq!(told.is_warning, sight.doubt().is_some());
        }
        let condition = roof.watcher.condition();
        assert!(condition.state == State::Streaming && !condition.is_fault);
        assert_eq!(condition.complaint.is_some(), sight.doubt().is_some());
        assert!(condition.findings.contains(&seen.finding().unwrap()));
    }
    // What is configured is no warning, and told once.
    let mut roof = Watched::new(None);
    let config = segment::Config {
        mount: floor(None).mount(),
        ..config
    };
    let mut see = |sight| roof.watcher.see_floor(floor::Seen::new(sight, &config));
    assert!(!see(NONE).unwrap().is_warning);
    assert!(see(Sight::Floor(floor(None))).is_some());
    for sight in [doubt(7), NONE, Sight::Floor(floor(None))] {
        assert_eq!(see(sight), None);
    }
}

#[test]
fn gps_time_that_comes_goes_or_is_doubtful_is_logged_once() {
    let mut roof = Watched::new(None);
    roof.observe(5, 75, 1);
    let mut see = |source, doubt| {
        let told = roof.watcher.see_time(source, doubt);
        let texts: Vec<String> = told.into_iter().map(|message| message.text).collect();
        (texts, roof.watcher.complaint())
    };
    let (texts, complaint) = see(TimeSource::Gps, None);
    assert_eq!(
        (texts, complaint),
        (vec!["roof: times are UTC by GPS".to_owned()], None)
    );
    // 2026-03-10 10:00:59 UTC, and the same at 2006-07-25.
    let said_ns = 1_153_821_659_000_000_000;
    let weeks = GpsDoubt::Weeks {
        said_ns,
        weeks: 1024,
    };
    let (texts, complaint) = see(TimeSource::Gps, Some(weeks));
    let words = "2006-07-25 10:00:59.000 UTC, 1024 weeks too early";
    assert!(texts.len() == 1 && texts[0].contains(words), "{texts:?}");
    assert!(complaint.is_some_and(|why| why.contains(words)));
    let later = GpsDoubt::Weeks {
        said_ns: said_ns + 1_000_000_000,
        weeks: 1024,
    };
    assert_eq!(see(TimeSource::Gps, Some(later)).0, [""; 0]);
    let far = GpsDoubt::Far {
        said_ns,
        host_ns: 0,
    };
    let (texts, _) = see(TimeSource::Host, Some(far));
    assert!(
        texts.len() == 2
            && texts[0].contains("1970-01-01 00:00:00.000 UTC")
            && texts[0].contains("set it by NTP")
            && texts[1] == "roof: GPS time is lost: times are of this host's clock",
        "{texts:?}"
    );
    let (texts, complaint) = see(TimeSource::Host, None);
    assert_eq!((texts.len(), complaint), (1, None));
}

#[test]
fn losses_are_a_state_beside_streaming() {
    let mut roof = Watched::new(Some(600));
    lose(&mut roof, 10, 0);
    assert_eq!(roof.watcher.state(), State::Streaming);
    let told = lose(&mut roof, 10, 5);
    assert!(told.len() == 1 && told[0].starts_with("roof: "), "{told:?}");
    let Condition {
        state,
        complaint,
        is_fault,
        recent,
        ..
    } = roof.watcher.condition();
    assert_eq!((state, is_fault), (State::Losing, false));
    assert!(
        complaint
            .unwrap()
            .starts_with("6.2 % of its packets are lost or of no use")
    );
    assert!((recent.unwrap().share() - 5.0 / 80.0).abs() < 1e-9);
    // Another speed than configured is still a fault, and both are reported.
    roof.turn(Running {
        rpm: 500.0,
        ..RUNNING
    });
    assert_eq!(lose(&mut roof, 1, 5).len(), 1);
    let Condition {
        state,
        complaint,
        is_fault,
        ..
    } = roof.watcher.condition();
    assert_eq!((state, is_fault), (State::Losing, true));
    assert!(
        complaint
            .is_some_and(|why| why.contains("of its packets") && why.contains("turns at 500 rpm"))
    );
    roof.turn(RUNNING);
    let told = lose(&mut roof, 10, 75);
    assert!(told.len() == 2, "{told:?}");
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::LosingMany, true));
    let told = lose(&mut roof, 10, 0);
    assert!(
        told.len() == 1 && told[0].contains("its losses are over"),
        "{told:?}"
    );
    let is = roof.watcher.condition();
    assert_eq!(
        (is.state, is.complaint, is.is_fault, is.losses),
        (State::Streaming, None, false, None)
    );
}

#[test]
fn a_sensor_that_does_not_see_is_a_fault_and_one_that_is_dark_in_part_a_warning() {
    let mut roof = Watched::new(Some(600));
    roof.observe(5, 75, 1);
    let told = roof.watcher.observe_eye(flags::BLIND).unwrap();
    assert!(
        told.is_warning
            && told
                .text
                .starts_with("roof: blind: hardly a shot returns: ")
    );
    assert_eq!(roof.watcher.observe_eye(flags::BLIND), None);
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::NotSeeing, true));
    assert!(is.complaint.is_some_and(|why| why.contains("window")));
    assert!(
        roof.watcher
            .observe_eye(flags::DARK_BELOW)
            .unwrap()
            .is_warning
    );
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::Streaming, false));
    assert!(
        is.complaint
            .is_some_and(|why| why.starts_with("dark below"))
    );
    let told = roof.watcher.observe_eye(0).unwrap();
    assert_eq!(
        (told.is_warning, &told.text[..]),
        (false, "roof: it sees again")
    );
    assert_eq!(roof.watcher.condition().complaint, None);
}

#[test]
fn a_beam_that_is_dark_for_long_is_a_warning_and_logged_once() {
    let mut roof = Watched::new(Some(600));
    roof.observe(5, 75, 1);
    let dark = |channel: u32, turns| DarkBeam {
        row: channel + 1,
        channel,
        turns,
    };
    let sentence =
        "channel 82 (row 83) has not returned for 1,000 turns, though the beams next to it have";
    let told = roof.watcher.observe_beams(vec![dark(82, 1000)]).unwrap();
    assert!(told.is_warning);
    assert_eq!(told.text, format!("roof: {sentence}"));
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::Streaming, false));
    assert_eq!(is.complaint.as_deref(), Some(sentence));
    // The same beam a turn later is no news, a second one is, and one of two that is back is
    // not.
    assert_eq!(roof.watcher.observe_beams(vec![dark(82, 1001)]), None);
    let both = vec![dark(9, 1000), dark(82, 1002)];
    assert!(roof.watcher.observe_beams(both).unwrap().is_warning);
    assert_eq!(roof.watcher.observe_beams(vec![dark(9, 1001)]), None);
    // Beside another speed and losses it is told last.
    roof.turn(Running {
        rpm: 500.0,
        ..RUNNING
    });
    lose(&mut roof, 10, 5);
    let complaint = roof.watcher.complaint().unwrap();
    assert!(
            complaint.contains("; it turns at 500 rpm")
                && complaint.ends_with("; channel 9 (row 10) has not returned for 1,001 turns, though the beams next to it have"),
            "{complaint}"
        );
    roof.turn(RUNNING);
    lose(&mut roof, 10, 0);
    let told = roof.watcher.observe_beams(Vec::new()).unwrap();
    assert_eq!(
        (told.is_warning, &told.text[..]),
        (
            false,
            "roof: the beams that had not returned return again, or their counts were reset"
        )
    );
    assert_eq!(roof.watcher.observe_beams(Vec::new()), None);
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn a_given_model_against_the_factory_byte_is_a_warning_that_names_the_line_to_change() {
    let mut roof = Watched::new(None);
    roof.observe(5, 75, 1);
    // A Puck Hi-Res under `model = "vlp16"`.
    roof.seen.facts.other_product = Some(0x24);
    let told = roof.observe(5, 75, 1);
    assert!(
        told.len() == 1 && told[0].contains("factory byte"),
        "{told:?}"
    );
    let is = roof.watcher.condition();
    assert_eq!((is.state, is.is_fault), (State::Streaming, false));
    assert!(is.complaint.unwrap().contains("Puck Hi-Res"));
    assert!(is.findings[0].cure.contains("`model = \"puck-hires\"`"));
    // Silence does not say that it is over.
    let told = roof.observe(50, 0, 0);
    assert!(
        told.len() == 1 && told[0].contains("came before"),
        "{told:?}"
    );
    assert!(!roof.watcher.complaint().unwrap().contains("factory byte"));
    let told = roof.observe(20, 75, 1);
    assert!(
        told.iter().all(|one| !one.contains("factory byte")),
        "{told:?}"
    );
    assert!(roof.watcher.complaint().unwrap().contains("factory byte"));
    roof.seen.facts.other_product = None;
    assert!(roof.observe(5, 75, 1)[0].contains("this is over"));
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn what_the_kernel_drops_is_told_though_no_stamp_shows_it() {
    let mut roof = Watched::new(None);
    for (dropped, is_fault) in [(5, false), (75, true)] {
        for _ in 0..100 {
            roof.seen.tally.data += 75;
            roof.seen.tally.received += 75;
            roof.seen.tally.dropped += dropped;
            roof.observe(1, 75, 1);
        }
        let is = roof.watcher.condition();
        assert_eq!((is.state, is.is_fault), (State::Streaming, is_fault));
        assert!(is.complaint.unwrap().contains("kernel dropped"));
    }
    lose(&mut roof, 10, 0);
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn drops_are_logged_as_they_begin_rise_and_end_however_the_losses_tell_them() {
    let mut roof = Watched::new(None);
    let mut told: Vec<Vec<bool>> = Vec::new();
    // Of 75 that are sent, so many are dropped, and so many missed by the stamps.
    for (dropped, lost) in [(0, 0), (5, 0), (30, 0), (30, 30), (30, 0), (0, 0)] {
        let mut texts = Vec::new();
        for _ in 0..100 {
            roof.seen.tally.received += 75;
            roof.seen.tally.data += 75 - lost;
            roof.seen.tally.dropped += dropped;
            roof.seen.tally.lost += lost;
            texts.extend(roof.observe(1, 75, 1));
        }
        texts.retain(|text| text.contains("kernel dropped"));
        told.push(
            texts
                .iter()
                .map(|text| text.contains("this is over"))
                .collect(),
        );
        // Once, by the drops or by the losses.
        let complaint = roof.watcher.complaint().unwrap_or_default();
        let times = complaint.matches("kernel dropped").count();
        assert_eq!(times, usize::from(dropped > 0), "{complaint}");
    }
    let [one, none, over] = [vec![false], Vec::new(), vec![true]];
    // The losses are told as a warning, and as a fault.
    let losses = vec![false; 2];
    assert_eq!(told, [none.clone(), one.clone(), one, losses, none, over]);
}

#[test]
fn a_log_that_blames_the_network_also_tells_what_the_kernel_drops_later() {
    let mut roof = Watched::new(None);
    let mut texts = Vec::new();
    // A tenth is lost, before this host and then in it.
    for dropped in [0, 8] {
        for _ in 0..100 {
            roof.seen.tally.received += 72;
            roof.seen.tally.data += 72;
            roof.seen.tally.dropped += dropped;
            roof.seen.tally.lost += 8;
            texts.extend(roof.observe(1, 75, 1));
        }
    }
    let [_streaming, network, kernel] = &texts[..] else {
        panic!("{texts:?}")
    };
    assert!(network.contains("lost before this host, whose kernel dropped none"));
    assert!(kernel.contains("kernel dropped") && !kernel.contains("before this host"));
    let complaint = roof.watcher.complaint().unwrap_or_default();
    assert_eq!(
        complaint.matches("kernel dropped").count(),
        1,
        "{complaint}"
    );
}

#[test]
fn silence_does_not_tell_the_drops_before_it() {
    let mut roof = Watched::new(None);
    for _ in 0..100 {
        roof.seen.tally.received += 75;
        roof.seen.tally.data += 45;
        roof.seen.tally.dropped += 30;
        roof.seen.tally.lost += 30;
        roof.observe(1, 75, 1);
    }
    assert!(roof.watcher.complaint().unwrap().contains("kernel dropped"));
    let mut told = roof.observe(50, 0, 0);
    told.extend(roof.observe(50, 75, 1));
    assert!(
        told.iter().all(|text| !text.contains("kernel dropped")),
        "{told:?}"
    );
}

#[test]
fn a_sensor_that_changes_again_and_again_is_told_with_how_often() {
    let mut roof = Watched::new(None);
    let models = [Model::Vlp16, Model::Hdl32e, Model::Vlp16];
    for (at, model) in models.into_iter().enumerate() {
        roof.turn(Running { model, ..RUNNING });
        roof.observe(5, 75, 1);
        assert_eq!(roof.watcher.complaint().is_some(), at == 2);
    }
    let told = roof.watcher.complaint().unwrap();
    assert!(
        told.contains("another model 2 times in the last 10 minutes"),
        "{told}"
    );
    roof.seen.facts.clock_jumps = 1;
    roof.observe(5, 75, 1);
    roof.seen.facts.clock_jumps = 3;
    let told = roof.observe(5, 75, 1);
    assert!(
        told.len() == 1 && told[0].contains("its clock jumped 3 times"),
        "{told:?}"
    );
}

#[test]
fn a_sentence_that_is_not_read_is_told_when_that_lasts() {
    let mut roof = Watched::new(None);
    let locked = Some((Pps::Locked, Some(Ok(true))));
    roof.seen.facts.pulse = locked;
    roof.observe(5, 75, 1);
    let unread = Some((Pps::Locked, Some(Err(NmeaError::NotRmc))));
    // Each second one is garbled.
    for second in 0..20 {
        roof.seen.facts.pulse = if second % 2 == 0 { unread } else { locked };
        assert_eq!(roof.observe(10, 75, 1), [""; 0]);
    }
    roof.seen.facts.pulse = unread;
    let told = roof.observe(60, 75, 1);
    assert!(
        told.len() == 1 && told[0].contains("not an RMC sentence: set the receiver to send $GPRMC"),
        "{told:?}"
    );
    roof.seen.facts.pulse = locked;
    assert!(roof.watcher.complaint().is_some());
    let told = roof.observe(60, 75, 1);
    assert!(
        told.len() == 1 && told[0].contains("this is over"),
        "{told:?}"
    );
    assert_eq!(roof.watcher.complaint(), None);
}

#[test]
fn a_sensor_that_is_silent_has_no_losses() {
    let mut roof = Watched::new(None);
    lose(&mut roof, 10, 75);
    assert_eq!(roof.watcher.state(), State::LosingMany);
    assert_eq!(roof.observe(50, 0, 0).len(), 1);
    assert_eq!(
        (roof.watcher.state(), roof.watcher.condition().recent),
        (State::Stalled, None)
    );
    // The losses of the pause are counted with the first packet behind it.
    roof.seen.tally.lost += 3_750;
    assert_eq!(
        lose(&mut roof, 10, 0),
        ["roof: streaming, VLP-16 at 600 rpm, one return"]
    );
}

#[test]
fn a_clock_of_this_host_that_stays_off_is_told_once_and_when_it_is_over() {
    let mut roof = Watched::new(None);
    roof.observe(5, 75, 1);
    // A packet that waits is no clock that is off.
    for (ahead_s, tenths, told) in [
        (5.0, 20, 0),
        (0.01, 5, 0),
        (0.2, 60, 1),
        (0.07, 60, 0),
        (0.04, 5, 1),
    ] {
        roof.seen.facts.host_ahead_s = Some(ahead_s);
        let texts = roof.observe(tenths, 75, 1);
        assert_eq!(texts.len(), told, "{ahead_s}: {texts:?}");
        let is_off = roof
            .watcher
            .complaint()
            .is_some_and(|why| why.contains("ahead of the sensor's GPS time"));
        assert_eq!(is_off, [0.2, 0.07].contains(&ahead_s));
    }
    // The doubt about the receiver has both dates.
    let (said_ns, host_ns) = (1, i64::MAX);
    roof.watcher
        .see_time(TimeSource::Gps, Some(GpsDoubt::Far { said_ns, host_ns }));
    roof.seen.facts.host_ahead_s = Some(9e9);
    assert_eq!(roof.observe(60, 75, 1), [""; 0]);
}
