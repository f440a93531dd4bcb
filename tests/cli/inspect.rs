//! What `sweepd inspect` tells.

use crate::{Folder, fixture, inspect, made};

/// The value of a row of the text.
fn row<'a>(text: &'a str, name: &str) -> &'a str {
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("  ")?.strip_prefix(name));
    line.unwrap_or_else(|| panic!("no {name} in\n{text}"))
        .trim()
}

/// The encoder's noise is some tenths of a turn a minute.
fn is_about_600(speed: &str) -> bool {
    speed.starts_with("600.") || speed.starts_with("599.")
}

#[test]
fn a_capture_is_described_in_full() {
    let text = inspect(&fixture("street_vlp16_losses.pcap")).done();
    assert_eq!(
        row(&text, "time"),
        "2026-05-04 10:17:23.004 UTC to 2026-05-04 10:17:23.404 UTC, 0.399 s"
    );
    assert_eq!(row(&text, "link type"), "Ethernet");
    assert_eq!(
        row(&text, "model"),
        "VLP-16, by its factory bytes and packet period"
    );
    assert_eq!(row(&text, "return mode"), "strongest");
    assert!(row(&text, "data").starts_with("286 packets (71"), "{text}");
    assert!(
        is_about_600(row(&text, "speed")) && row(&text, "speed").contains(" rpm ("),
        "{text}"
    );
    assert_eq!(
        row(&text, "losses"),
        "18 packets lost, 2 out of order, 2 received twice"
    );
    assert!(
        row(&text, "GPS").starts_with("PPS locked, RMC valid: 2026-05-04 10:17:23"),
        "{text}"
    );
    let text = inspect(&fixture("street_hdl32e_dual.pcap.gz")).done();
    assert_eq!(
        (row(&text, "return mode"), row(&text, "GPS")),
        ("dual", "PPS not reported by this model, no sentence")
    );
}

#[test]
fn a_head_that_turns_the_other_way_is_reported() {
    let folder = Folder::new("reversed");
    let path = folder.write("reversed.pcap", made::pcap(&made::reversed(made::vlp16())));
    let text = inspect(&path).done();
    let speed = row(&text, "speed");
    assert!(
        is_about_600(speed) && speed.ends_with("counter-clockwise") && !speed.contains("-6"),
        "{speed}"
    );
    let table = crate::replay(&path, &["--no-timing"]).done();
    assert!(
        row(&table, "speed").ends_with("rpm (600.0 to 600.0), counter-clockwise"),
        "{table}"
    );
}

#[test]
fn a_change_of_return_mode_and_shared_addresses_are_reported() {
    let folder = Folder::new("modes");
    let mut changed = made::datagrams("street_vlp16.pcap.gz");
    let dual = made::datagrams("street_vlp16_dual.pcap.gz");
    let later_ns = changed.last().unwrap().arrival_ns - dual[0].arrival_ns + 1_000_000_000;
    changed.extend(dual.into_iter().map(|sent| made::Sent {
        arrival_ns: sent.arrival_ns + later_ns,
        ..sent
    }));
    let text = inspect(&folder.write("changed.pcap", made::pcap(&changed))).done();
    assert_eq!(row(&text, "return mode"), "strongest, dual");

    let other = made::with_ports(&made::vlp16(), "192.168.1.201:2369", 2369);
    let both = made::together(&[&made::vlp16(), &other]);
    let text = inspect(&folder.write("both.pcap", made::pcap(&both))).done();
    assert!(
        text.contains("\n192.168.1.201:2368 to port 2368\n"),
        "{text}"
    );
    assert!(
        text.contains("\n192.168.1.201:2369 to port 2369\n"),
        "{text}"
    );
    assert!(
        row(&text, "position").ends_with("of all sensors at this address"),
        "{text}"
    );
}
