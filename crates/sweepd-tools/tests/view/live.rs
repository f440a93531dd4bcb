//! A sensor that is published, not yet, no more, and again.

use std::time::Duration;

use serde_json::{Value, json};
use sweepd::buffers::Buffers;
use sweepd::cli::publish::publish;
use sweepd::host::realtime_ns;
use sweepd::pipeline::Config;
use sweepd::publish::{Domain, Loans, ServiceSettings, Topic};
use sweepd::sweep::{SweepMut, SweepRef};
use sweepd_testkit::TempDomain;

use crate::captures::{fixture, sweeps};
use crate::page::{Page, View};

/// A daemon, as far as consumers see it.
pub struct Publisher {
    name: String,
    loans: Loans,
    run_ns: i64,
    sequence: u64,
}

impl Publisher {
    pub fn new(domain: &Domain, name: &str) -> Self {
        let settings = ServiceSettings {
            name: name.to_owned(),
            topic: Topic::Sweeps,
            max_consumers: 4,
            model: String::new(),
            address: "192.168.1.201:2368".to_owned(),
        };
        Self {
            name: name.to_owned(),
            loans: Loans::create(domain, &settings).unwrap(),
            run_ns: realtime_ns(),
            sequence: 0,
        }
    }

    pub fn publish(&mut self, sweep: &impl AsRef<[u8]>) {
        let bytes = sweep.as_ref();
        let mut slot = self.loans.take(bytes.len());
        slot.as_mut()[..bytes.len()].copy_from_slice(bytes);
        let copy = SweepMut::open(slot.as_mut()).unwrap();
        copy.header.sequence = self.sequence;
        copy.header.pitch_rad = 2_f64.to_radians() as f32;
        self.sequence += 1;
        publish(slot, &self.name, self.run_ns).unwrap();
    }
}

/// Publishes until the page says this, which it does only for a moment after a sweep.
fn publish_until(
    words: &str,
    page: &mut Page,
    daemon: &mut Publisher,
    sweep: &impl AsRef<[u8]>,
) -> Value {
    for _ in 0..100 {
        if let Some(state) = page.words_within(words, Duration::from_secs(1)) {
            return state;
        }
        daemon.publish(sweep);
        page.sweep();
        page.drawn();
    }
    panic!("it does not say {words}");
}

pub fn view(own: &TempDomain, args: &[&str]) -> View {
    View::start_with(args, |command| {
        command.env("SWEEPD_ROOT", own.root());
    })
}

/// How many sweeps the page missed before its next one, and the number of that.
fn next_numbers(page: &mut Page) -> (u64, u64) {
    let shown = page.sweep();
    let sequence = shown.about["sequence"].as_u64().unwrap();
    page.drawn();
    (shown.missed(), sequence)
}

#[test]
fn a_sensor_that_comes_late_stalls_goes_and_comes_again() {
    let own = TempDomain::new("sweepd-view-").unwrap();
    let some = sweeps(&fixture("street_vlp16.pcap.gz"), &Config::default());
    let view = view(&own, &["roof"]);
    let mut page = view.page();
    let source = page.next("source");
    assert_eq!(
        (&source["kind"], &source["name"], &source["sweeps"]),
        (&"sensor".into(), &"roof".into(), &json!(null))
    );
    let state = page.words("roof is not published in");
    assert_eq!(state["ok"], false);

    let mut daemon = Publisher::new(&own.domain(), "roof");
    page.words("no sweep of roof for ");
    daemon.publish(&some[1]);
    let shown = page.sweep();
    assert_eq!((&shown.about["index"], shown.missed()), (&json!(null), 0));
    let expected = SweepRef::open(some[1].as_ref()).unwrap();
    assert!(shown.sweep().label == expected.label && shown.sweep().segments == expected.segments);
    assert_eq!(shown.sweep().header.name(), "roof");
    // What it is segmented with is taken from its sweeps.
    let source = view.page().next("source");
    assert_eq!(source["sensors"], json!(["roof"]));
    let pitch = source["settings"]
        .as_array()
        .unwrap()
        .iter()
        .find(|row| row["key"] == "pitch_deg");
    assert_eq!(pitch.unwrap()["now"], 2.0);
    page.words("the sensor stalls: no sweep for ");
    page.drawn();
    // Sweeps that were never published are missed.
    daemon.sequence += 3;
    daemon.publish(&some[0]);
    assert_eq!(next_numbers(&mut page), (3, 4));
    publish_until("live", &mut page, &mut daemon, &some[0]);

    drop(daemon);
    let state = page.words("the daemon is gone");
    assert_eq!(state["ok"], false);
    let mut daemon = Publisher::new(&own.domain(), "roof");
    std::thread::sleep(Duration::from_millis(600));
    daemon.publish(&some[2]);
    assert_eq!(next_numbers(&mut page), (3, 0));
    let words = "the daemon was started again";
    let state = publish_until(words, &mut page, &mut daemon, &some[2]);
    assert_eq!(
        (&state["ok"], &state["facts"]["restarts"]),
        (&true.into(), &"1".into())
    );
}

#[test]
fn of_several_sensors_the_page_chooses_one() {
    let own = TempDomain::new("sweepd-view-").unwrap();
    let some = sweeps(&fixture("street_vlp16.pcap.gz"), &Config::default());
    let mut daemons = ["front", "roof"].map(|name| Publisher::new(&own.domain(), name));
    let view = view(&own, &[]);
    let mut page = view.page();
    let source = page.until(|message| message["sensors"] == json!(["front", "roof"]));
    assert_eq!(source["kind"], "choice");
    page.words("choose one");
    page.ask(json!({ "do": "choose", "sensor": "roof" }));
    let source = page.until(|message| message["kind"] == "sensor");
    assert_eq!(source["name"], "roof");
    page.words("sweep of roof");
    for daemon in &mut daemons {
        daemon.publish(&some[0]);
    }
    assert_eq!(page.sweep().sweep().header.name(), "roof");
}

/// What a page is told that holds for a setting.
#[cfg(feature = "slow-tests")]
fn now<'a>(source: &'a Value, key: &str) -> &'a Value {
    let rows = source["settings"].as_array().unwrap();
    &rows.iter().find(|row| row["key"] == key).unwrap()["now"]
}

#[test]
#[cfg(feature = "slow-tests")]
fn the_page_begins_with_what_the_daemon_runs_with() {
    use crate::browser::Robot;
    let robot = Robot::start(
        "vlp16",
        "min_points = 33, max_range_m = 40, method = 'paper'",
    );
    let view = robot.view_with(&["--min-points", "20"]);
    let mut page = view.page();
    let source = page.until(|message| message["told"] == true);
    assert_eq!(
        (now(&source, "min_points"), now(&source, "max_range_m")),
        (&json!(20.0), &json!(40.0))
    );
    assert_eq!(
        (&source["method"], &source["masked"]),
        (&"paper".into(), &false.into())
    );
    // The lines that change the daemon's file, and no others.
    page.ask(json!({ "do": "tune", "method": "paper", "settings": { "theta_deg": 12, "max_range_m": null } }));
    page.ask(json!({ "do": "configuration" }));
    let lines = page.next("configuration");
    assert_eq!(
        lines["text"],
        "[sensor.segment]\ntheta_deg = 12\nmin_points = 20\n# without max_range_m\n"
    );
}
