//! `sweepd sensor` against a web interface that the tests serve, whole and failing.

use std::time::Instant;

use serde_json::{Value, json};
use sweepd_testkit::PATIENCE;

use crate::{Ran, sweepd};
use sweepd_testkit::{
    free_port,
    web_page::{Fault, WebPage},
};

fn sensor(page: &WebPage, words: &[&str]) -> Ran {
    let address = page.address();
    let mut all = vec!["sensor", &address];
    all.extend(words);
    sweepd(&all)
}

/// What a run that fails says, with exit status 1.
#[track_caller]
fn failed(ran: &Ran) -> &str {
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    &ran.stderr
}

fn bodies(page: &WebPage) -> Vec<String> {
    page.forms().into_iter().map(|(_, body)| body).collect()
}

#[test]
fn it_is_shown() {
    let page = WebPage::default();
    let expected = "\
VLP-16, serial 11002162040404
laser          on
returns        strongest
rpm            600
fov            0-359
phase-lock     off
position-port  8308
data-port      2368
host           255.255.255.255
turns at       599 rpm
pulse (PPS)    Absent
";
    assert_eq!(sensor(&page, &["show"]).done(), expected);
    let shown: Value = serde_json::from_str(&sensor(&page, &["show", "--json"]).done()).unwrap();
    assert_eq!(
        shown,
        json!({
            "address": page.address(),
            "identity": "VLP-16, serial 11002162040404",
            "laser": "on",
            "returns": "strongest",
            "rpm": 600,
            "fov": "0-359",
            "phase_lock": "off",
            "position_port": 8308,
            "data_port": 2368,
            "host": "255.255.255.255",
            "measured_rpm": 599.0,
            "pps": "Absent",
        })
    );
    assert_eq!(page.forms(), []);
}

#[test]
fn without_yes_it_is_said_and_not_done() {
    let page = WebPage::default();
    let set = ["set", "--rpm", "1200", "--laser", "on", "--fov", "270-90"];
    let expected = "\
rpm 600 -> 1200
fov 0-359 -> 270-90
nothing was changed: --yes does it
";
    assert_eq!(sensor(&page, &set).done(), expected);
    assert_eq!(page.forms(), []);
    let same = ["set", "--rpm", "600", "--yes"];
    assert_eq!(sensor(&page, &same).done(), "it is set so already\n");
    assert_eq!(page.forms(), []);
}

#[test]
fn what_is_set_lasts_until_power_is_lost_and_what_is_saved_longer() {
    let page = WebPage::default();
    let said = sensor(&page, &["set", "--rpm", "1200", "--yes"]).done();
    assert_eq!(
        said,
        "rpm 600 -> 1200\ndone, until it loses power: --save keeps it\n"
    );
    assert_eq!(page.get("", "rpm"), "1200");
    page.restart();
    assert_eq!(page.get("", "rpm"), "600");
    let said = sensor(&page, &["set", "--rpm", "300", "--save", "--yes"]).done();
    assert_eq!(said, "rpm 600 -> 300\nsaved: it starts like this\n");
    page.restart();
    assert_eq!(page.get("", "rpm"), "300");
}

#[test]
fn a_program_reads_what_was_set() {
    let page = WebPage::default();
    let set = |rest: &[&str]| -> Value {
        let words = [&["set", "--rpm", "1200", "--json"], rest].concat();
        serde_json::from_str(&sensor(&page, &words).done()).unwrap()
    };
    let planned = set(&["--fov", "270-90"]);
    let keys = ["rpm", "fov", "laser"];
    assert_eq!(
        keys.map(|key| (&planned["found"][key], &planned["wanted"][key])),
        [
            (&json!(600), &json!(1200)),
            (&json!("0-359"), &json!("270-90")),
            (&json!("on"), &Value::Null),
        ]
    );
    let is_so = |report: &Value| (report["done"] == true, report["saved"] == true);
    assert_eq!((is_so(&planned), page.forms()), ((false, false), vec![]));
    assert_eq!(is_so(&set(&["--yes", "--save"])), (true, true));
    assert_eq!(page.get("", "rpm"), "1200");
    let again = set(&[]);
    assert_eq!(
        (is_so(&again), &again["address"]),
        ((true, false), &json!(page.address()))
    );
}

#[test]
fn everything_can_be_set_at_once_and_where_to_last() {
    let page = WebPage::default();
    let words = "set --host 192.168.1.100 --data-port 2369 --position-port 8309 --rpm 900 --returns dual --laser off \
                 --fov 270-90 --phase-lock 90.25 --yes";
    let ran = sensor(&page, &words.split_whitespace().collect::<Vec<_>>());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(
        ran.stderr,
        "warning: the phase is locked to the pulse per second, which is Absent\n"
    );
    let set = [
        ("", "laser", "Off"),
        ("", "returns", "Dual"),
        ("", "rpm", "900"),
        ("fov", "start", "270"),
        ("fov", "end", "90"),
        ("phaselock", "enabled", "On"),
        ("phaselock", "offset", "9025"),
        ("host", "tport", "8309"),
        ("host", "dport", "2369"),
        ("host", "addr", "192.168.1.100"),
    ];
    for (path, field, value) in set {
        assert_eq!(page.get(path, field), value, "{path} {field}");
    }
    assert_eq!(page.forms().len(), 8);
    assert_eq!(bodies(&page)[7], "addr=192.168.1.100");
}

#[test]
fn bad_values_are_refused_before_anything_is_sent() {
    let page = WebPage::default();
    let bad = [
        ["--rpm", "610", "a multiple of 60"],
        ["--rpm", "1260", "300 to 1200"],
        ["--returns", "both", "strongest, last or dual"],
        ["--fov", "0-360", "whole degrees 0 to 359"],
        ["--laser", "1", "on or off"],
        ["--host", "127.0.0.1", "that the sensor can send to"],
        ["--data-port", "0", "1 to 65535"],
        ["--position-port", "70000", "1 to 65535"],
        ["--phase-lock", "360", "0 to 359.99 degrees"],
    ];
    for [option, value, expected] in bad {
        let ran = sensor(&page, &["set", option, value, "--yes"]);
        assert_eq!(ran.code, 2, "{option} {value}");
        assert!(
            ran.stderr.contains(option) && ran.stderr.contains(expected),
            "{}",
            ran.stderr
        );
    }
    let nothing = sensor(&page, &["set", "--yes"]);
    nothing.says(&["nothing to set: give a setting"]);
    assert_eq!(nothing.code, 2);
    assert_eq!(page.connections(), 0);
    let ran = sweepd(&["sensor", "255.255.255.255", "show"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("the sensor's own IPv4 address"));
}

#[test]
fn a_page_that_cannot_be_read_is_said_in_bounded_time() {
    let faults = [
        (Fault::Silent, "no answer within 3.0 s"),
        (Fault::ClosesHalfway, "no settings can be read"),
        (Fault::Garbage, "the answer is no JSON"),
        (Fault::Huge, "length limit exceeded"),
    ];
    std::thread::scope(|scope| {
        for (fault, why) in faults {
            for action in [&["show"][..], &["set", "--rpm", "1200", "--yes"]] {
                scope.spawn(move || {
                    let page = WebPage::failing(fault);
                    let begun = Instant::now();
                    let ran = sensor(&page, action);
                    assert!(failed(&ran).contains(why), "{fault:?}: {}", ran.stderr);
                    assert!(ran.stderr.contains(&page.address()));
                    assert!(begun.elapsed() < PATIENCE, "{fault:?}");
                    assert_eq!(page.forms(), [], "{fault:?}");
                });
            }
        }
    });
    // Nothing listens.
    let gone = format!("127.0.0.1:{}", free_port());
    let ran = sweepd(&["sensor", &gone, "show"]);
    assert!(failed(&ran).contains("Connection refused"));
    assert!(ran.stderr.contains("An HDL-64E has no web interface"));
}

#[test]
fn one_that_stops_in_the_middle_is_told_how_far_it_came() {
    let page = WebPage::failing_from(1, Fault::Silent);
    let set = "set --returns last --rpm 1200 --fov 270-90 --host 192.168.1.100 --save --yes";
    let set: Vec<&str> = set.split_whitespace().collect();
    let ran = sensor(&page, &set);
    assert!(
        failed(&ran).ends_with(
            "no answer within 3.0 s; was set: returns; may be set: rpm; was not tried: fov, host; `show` says what it is \
             set to, once it answers\n"
        ),
        "{}",
        ran.stderr
    );
    assert_eq!(bodies(&page), ["returns=Last", "rpm=1200"]);
    page.restart();
    assert_eq!(page.get("", "returns"), "Strongest", "it was not saved");
}

#[test]
fn what_is_refused_and_what_a_lost_answer_did_is_told() {
    let page = WebPage::failing_from(1, Fault::Refuses);
    let set = ["set", "--returns", "last", "--rpm", "1200", "--yes"];
    let ran = sensor(&page, &set);
    let expected = "it refuses, with status 400; was set: returns; was not set: rpm; it says that this is left: rpm\n";
    assert!(failed(&ran).ends_with(expected), "{}", ran.stderr);

    let page = WebPage::failing_from(1, Fault::ClosesHalfway);
    let ran = sensor(&page, &set);
    let expected = "; was set: returns; may be set: rpm; it says that all is set\n";
    assert!(failed(&ran).ends_with(expected), "{}", ran.stderr);
    assert_eq!(page.get("", "rpm"), "1200");
}

#[test]
fn what_is_not_done_is_found_when_it_is_read_back() {
    let page = WebPage::failing_from(1, Fault::Ignores);
    let set = [
        "set",
        "--laser",
        "off",
        "--returns",
        "dual",
        "--save",
        "--yes",
    ];
    let ran = sensor(&page, &set);
    let expected = "is not set so when it is read back: returns strongest -> dual";
    assert!(failed(&ran).contains(expected), "{}", ran.stderr);
    assert_eq!(
        bodies(&page),
        ["laser=off", "returns=Dual"],
        "and not saved"
    );
}

#[test]
fn a_save_that_fails_is_no_success() {
    let page = WebPage::failing_from(1, Fault::Refuses);
    let ran = sensor(&page, &["set", "--rpm", "1200", "--save", "--yes"]);
    let expected = "it is set as wanted, and did not save it: it refuses, with status 400";
    assert!(failed(&ran).contains(expected), "{}", ran.stderr);
    assert_eq!(page.get("", "rpm"), "1200");
}
