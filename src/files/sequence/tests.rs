use super::*;

#[test]
fn names_are_numbered_before_their_ending() {
    for (path, ending, number, expected) in [
        ("a/drive.pcap", ".pcap", 0, "a/drive-000.pcap"),
        ("drive.x.pcap.gz", ".pcap.gz", 12, "drive.x-012.pcap.gz"),
        ("/drive.mcap", ".mcap", 1234, "/drive-1234.mcap"),
    ] {
        assert_eq!(numbered(path.as_ref(), ending, number), Path::new(expected));
    }
}

/// Programs read these keys.
#[test]
fn the_keys_of_what_was_written_stay() {
    let written = Written {
        records: 7,
        bytes: 24,
        first: "a".into(),
        last: "b".into(),
        files: 2,
    };
    let json = r#"{"datagrams":7,"bytes":24,"first":"a","last":"b","files":2}"#;
    assert_eq!(serde_json::to_string(&written).unwrap(), json);
    assert_eq!(serde_json::from_str::<Written>(json).unwrap(), written);
    assert_eq!(written.names(), "a to b (2 files)");
}
