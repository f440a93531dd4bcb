//! What is told of a GPS receiver whose time cannot be right.

use sweepd::wire::nmea::Rmc;
use sweepd::wire::position::{POSITION_PACKET_LEN, Position};

use crate::{Folder, inspect, made, replay};

const DAY_NS: i64 = 86_400_000_000_000;

/// The text of a receiver's sentence, from the one that is right.
type Sentence = fn(Rmc) -> String;

fn weeks_early(mut rmc: Rmc) -> String {
    rmc.utc_ns -= 7_168 * DAY_NS;
    rmc.emit()
}

/// As if switched on at midnight.
fn of_2000(mut rmc: Rmc) -> String {
    rmc.utc_ns = 10_957 * DAY_NS + rmc.utc_ns % DAY_NS;
    rmc.emit()
}

fn three_days_early(mut rmc: Rmc) -> String {
    rmc.utc_ns -= 3 * DAY_NS;
    rmc.emit()
}

fn without_date(_: Rmc) -> String {
    "$GPGGA,101722.00,5006.6,N,00840.9,E,1,08,1.0,110.0,M,47.0,M,,*6B".to_owned()
}

/// A VLP-16 of 2026-05-04 with a receiver that says this.
fn capture(folder: &Folder, name: &str, sentence: Sentence) -> std::path::PathBuf {
    let mut sent = made::vlp16();
    for one in &mut sent {
        if one.payload.len() != POSITION_PACKET_LEN {
            continue;
        }
        let position = Position::parse(&one.payload).unwrap();
        let text = sentence(Rmc::parse(position.nmea.unwrap()).unwrap());
        let nmea = Some(text.trim_end());
        one.payload = Position { nmea, ..position }.emit().to_vec();
    }
    folder.write(name, made::pcap(&sent))
}

#[test]
fn a_receiver_whose_time_cannot_be_right_is_told_and_weeks_are_added() {
    let folder = Folder::new("gps-time");
    for (name, sentence, year, source, words) in [
        (
            "weeks.pcap",
            weeks_early as Sentence,
            "2026-05-04",
            "gps",
            "1024 weeks too early",
        ),
        (
            "unset.pcap",
            of_2000,
            "2026-05-04",
            "host",
            "counts from 2000-01-01",
        ),
        (
            "days.pcap",
            three_days_early,
            "2026-05-01",
            "gps",
            "and packets arrive at 2026-05-04",
        ),
    ] {
        let path = capture(&folder, name, sentence);
        let text = inspect(&path).done();
        assert!(text.contains("GPS time") && text.contains(words), "{text}");
        let ran = replay(&path, &["--json", "--no-timing"]);
        let warnings: Vec<&str> = ran.said().collect();
        assert!(
            ran.code == 0 && warnings.len() == 1 && warnings[0].contains(words),
            "{}",
            ran.stderr
        );
        let sweep: serde_json::Value =
            serde_json::from_str(ran.stdout.lines().next().unwrap()).unwrap();
        let time_ns = sweep["time_ns"].as_i64().unwrap();
        assert!(sweepd::text::utc_text(time_ns).starts_with(year), "{sweep}");
        assert_eq!(sweep["time_source"], source);
    }
}

#[test]
fn a_sentence_without_a_date_is_told_with_the_cure() {
    let folder = Folder::new("gps-gga");
    let text = inspect(&capture(&folder, "gga.pcap", without_date)).done();
    assert!(text.contains("set the receiver to send $GPRMC"), "{text}");
}
