//! What `sweepd replay --publish` says of names and sensors.

use crate::{Folder, Ran, fixture, made, sweepd};
use sweepd_testkit::{TempDomain, temp_domain};

fn publish(own: &TempDomain, capture: &std::path::Path, names: &[&str], options: &[&str]) -> Ran {
    let names: Vec<&str> = names.iter().flat_map(|name| ["--publish", name]).collect();
    let fixed = [
        "replay",
        capture.to_str().unwrap(),
        "--speed=max",
        "--root",
        own.root().to_str().unwrap(),
    ];
    sweepd(&[&fixed[..], &names, options].concat())
}

/// Lines of standard error that speak of sharing.
fn shared(ran: &Ran) -> Vec<&str> {
    ran.stderr
        .lines()
        .filter(|line| line.contains("shared") || line.contains("--publish"))
        .collect()
}

#[test]
fn names_that_no_service_or_file_may_have_are_refused() {
    let own = temp_domain();
    let capture = fixture("street_vlp16_losses.pcap");
    for name in [
        "a/b",
        "../../x",
        "",
        ".hidden",
        "-roof",
        "r\u{f6}f",
        "two words",
        &"x".repeat(64),
    ] {
        let name = format!("--publish={name}");
        let ran = publish(&own, &capture, &[], &[&name]);
        assert_eq!(
            (ran.code, &ran.stdout[..]),
            (2, ""),
            "{name}: {}",
            ran.stderr
        );
        assert!(
            ran.stderr.contains("expected letters, digits"),
            "{}",
            ran.stderr
        );
    }
    let twice = publish(&own, &capture, &["roof", "rear", "roof"], &[]);
    twice.says(&["--publish roof is given twice", "a name of its own"]);
    assert_eq!(twice.stdout, "");
    assert!(own.shared_memory().is_empty());
}

#[test]
fn new_sensors_are_reported_by_name_and_so_are_unused_names() {
    let own = temp_domain();
    let folder = Folder::new("publish");
    let two = made::together(&[&made::vlp16(), &made::datagrams("street_hdl32e.pcap.gz")]);
    let three = made::together(&[
        &two,
        &made::with_ports(&made::vlp16(), "192.168.1.207:2368", 2370),
    ]);
    let [two, three] = [("two.pcap", two), ("three.pcap", three)]
        .map(|(name, all)| folder.write(name, made::pcap(&all)));
    let [first, second] = [
        "note: 192.168.1.201:2368 is shared as roof",
        "note: 192.168.1.202:2368 is shared as rear",
    ];

    // Each once, however often it is played.
    let all = publish(&own, &two, &["roof", "rear"], &["--loop=2"]);
    assert_eq!(
        (all.code, shared(&all)),
        (0, vec![first, second]),
        "{}",
        all.stderr
    );

    // More sensors than names: one line, for the first of them.
    let one_name = publish(&own, &three, &["roof"], &[]);
    assert_eq!(one_name.code, 0, "{}", one_name.stderr);
    let [of_first, of_others] = shared(&one_name)[..] else {
        panic!("{}", one_name.stderr)
    };
    assert_eq!(of_first, first);
    assert!(
        of_others.starts_with("note: 192.168.1.20")
            && of_others.contains("is not shared: no --publish NAME")
    );

    // More names than sensors: an error after the first round, though it was to be played for ever.
    let capture = fixture("street_vlp16_losses.pcap");
    let one_sensor = publish(&own, &capture, &["roof", "rear", "left"], &["--loop"]);
    one_sensor.says(&[
        "no sensor in it for --publish rear, --publish left",
        "sweepd inspect",
    ]);
    assert_eq!((one_sensor.code, shared(&one_sensor)[0]), (1, first));
    assert!(
        one_sensor.stdout.contains("sweeps"),
        "the summary comes all the same: {}",
        one_sensor.stdout
    );
}
