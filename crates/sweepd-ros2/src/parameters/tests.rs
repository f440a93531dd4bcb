use super::*;
use sweepd_sweep::Shape;

fn node() -> NodeName {
    NodeName::new("/robot", "sweepd")
}

fn parse(text: &str) -> Result<Parameters, String> {
    let mut parameters = Parameters::default();
    let parsed = parameters.parse(text, "ros2.yaml", &node());
    parsed
        .and_then(|()| parameters.judge())
        .map_err(|error| error.to_string())
        .map(|()| parameters)
}

#[test]
fn what_is_not_given_has_its_default() {
    let parameters = parse("/**:\n  ros__parameters: {}\n").unwrap();
    assert_eq!(parameters, Parameters::default());
    assert_eq!(parameters.health, Some("127.0.0.1:9177".parse().unwrap()));
    let expected = SensorParameters {
        frame_id: "roof".to_owned(),
        stamp: Stamp::First,
        organized: false,
        layout: Layout::Fields(Fields::ALL),
        only_complete: true,
        min_columns: 0,
        slice: Slice::Heights([-0.5, 2.0]),
        base_frame: "base_link".to_owned(),
    };
    assert_eq!(parameters.of("roof"), expected);
}

#[test]
fn the_example_has_the_defaults_and_every_name() {
    let example = include_str!("../../../../systemd/ros2.yaml");
    assert_eq!(parse(example).unwrap(), Parameters::default());
    for name in OF_NODE.iter().chain(&OF_SENSOR) {
        assert!(example.contains(&format!(" {name}: ")) || example.contains(&format!("#{name}: ")));
    }
    // Prose has one space behind its #.
    let is_prose = |line: &&str| {
        let prose = line.trim_start().strip_prefix("# ");
        prose.is_some_and(|prose| !prose.starts_with(' '))
    };
    let lines = example.lines().filter(|line| !is_prose(line));
    let lines: Vec<String> = lines.map(|line| line.replacen('#', "", 1)).collect();
    let parameters = parse(&lines.join("\n")).unwrap();
    assert_eq!(parameters.of("roof"), Parameters::default().of("roof"));
    assert_eq!(parameters.sensors, ["roof"]);
    let expected = Parameters::default();
    assert_eq!(
        (parameters.health, parameters.base_frame),
        (expected.health, expected.base_frame)
    );
}

#[test]
fn a_sensor_has_its_own_and_what_holds_for_all() {
    let text = "
/robot/sweepd:
  ros__parameters:
    sensors: [roof, front-left]
    root: /run/x
    health: ''
    base_frame: base
    deskew: odom
    odometry: /wheels
    use_sim_time: true
    stamp: last
    fields: [x, y, z]
    roof:
      frame_id: lidar_top
      organized: true
      layout: autoware
      min_columns: 1600
    front-left.stamp: first
";
    let parameters = parse(text).unwrap();
    assert_eq!(parameters.sensors, ["roof", "front-left"]);
    assert_eq!(parameters.root, Some(PathBuf::from("/run/x")));
    assert_eq!(
        (parameters.health, &parameters.base_frame[..]),
        (None, "base")
    );
    assert_eq!(
        (parameters.deskew, &parameters.odometry[..]),
        (Some(OdometrySource::Odometry), "/wheels")
    );
    let (roof, front) = (parameters.of("roof"), parameters.of("front-left"));
    assert_eq!((roof.stamp, front.stamp), (Stamp::Last, Stamp::First));
    assert_eq!((roof.organized, front.organized), (true, false));
    assert_eq!((roof.min_columns, front.min_columns), (1600, 0));
    let layouts = (Layout::Autoware, Layout::Fields(Fields::NONE));
    assert_eq!((roof.layout, front.layout), layouts);
    assert_eq!(
        (&roof.frame_id[..], &front.frame_id[..]),
        ("lidar_top", "front-left")
    );
}

#[test]
fn sweeps_are_taken_by_their_turn_and_their_measured_columns() {
    let mut header = Header::new(&Shape {
        rows: 16,
        columns_capacity: 100,
        dual: false,
        segments_capacity: 0,
    });
    (
        header.columns,
        header.missing_columns,
        header.unfired_columns,
    ) = (100, 20, 10);
    for (parameters, whole, part) in [
        ("stamp: first", true, false),
        ("only_complete: false", true, true),
        ("min_columns: 70", true, false),
        ("min_columns: 71", false, false),
        ("{only_complete: false, min_columns: 70}", true, true),
    ] {
        let parameters = parse(&format!("/**:\n  ros__parameters:\n    {parameters}\n"));
        let roof = parameters.unwrap().of("roof");
        for (bits, is_taken) in [(flags::CIRCULAR, whole), (flags::PARTIAL, part)] {
            header.flags = bits;
            assert_eq!(roof.takes(&header), is_taken, "{roof:?}");
        }
    }
}

#[test]
fn sections_mean_nodes_as_in_ros() {
    for (section, is_meant) in [
        ("/**", true),
        ("/**/sweepd", true),
        ("/*/sweepd", true),
        ("/robot/*", true),
        ("/robot/sweepd", true),
        ("robot/sweepd", true),
        ("/robot/**/sweepd", true),
        ("/*", false),
        ("sweepd", false),
        ("/robot/sweepd/x", false),
        ("/other/sweepd", false),
    ] {
        assert_eq!(names(section, "/robot/sweepd"), is_meant, "{section}");
    }
    let long = "/**".repeat(100_000);
    assert!(names(&long, "/robot/sweepd") && !names(&format!("{long}/x"), "/robot/sweepd"));
    let nested = "/robot:\n  sweepd:\n    ros__parameters: {stamp: last}\n  camera:\n    ros__parameters: {rate: 3}\n";
    assert_eq!(parse(nested).unwrap().of("roof").stamp, Stamp::Last);
}

#[test]
fn what_is_wrong_is_named_with_its_line_and_what_is_known() {
    for (parameters, line, part) in [
        (
            "stamp: centre",
            3,
            "`stamp`: expected first or middle or last, not `centre`",
        ),
        ("stamp: [last]", 3, "`stamp`: expected one value"),
        ("organized: 1", 3, "expected true or false, not `1`"),
        ("sensors: roof", 3, "expected a list"),
        ("sensors: [a/b]", 3, "`a/b` is no name of a sensor: letters"),
        ("health: nine", 3, "expected IP:PORT such as 127.0.0.1:9177"),
        (
            "fields: [x, colour]",
            3,
            "a point has no field \"colour\": fields are x, y, z, intensity, ring, time and label",
        ),
        ("layout: xyz", 3, "expected xyzirt or autoware"),
        ("scan_heights: [1, 0]", 3, "the lower one first"),
        ("scan_heights: [0, 1, x]", 3, "expected two heights"),
        ("scan_ring: top", 3, "expected a whole number"),
        (
            "min_columns: -1",
            3,
            "expected a whole number from 0 on, not `-1`",
        ),
        (
            "{sensors: [roof], roof: {stamp: x}}",
            3,
            "expected first or middle or last",
        ),
        ("deskew: imu", 3, "`deskew`: expected odom or tf, not `imu`"),
        ("stamp: {", 3, "unclosed bracket"),
    ] {
        let error = parse(&format!("/**:\n  ros__parameters:\n    {parameters}\n")).unwrap_err();
        assert!(
            error.starts_with(&format!("ros2.yaml:{line}: ")) && error.contains(part),
            "{error}"
        );
    }
    for (text, part) in [
        ("stamp: last", "ros2.yaml:1: no `ros__parameters`"),
        ("/**:\n  ros__parameters: 3", "expected parameters"),
        (
            "/**:\n  ros__parameters: {deskew: tf, base_frame: ''}",
            "`deskew: tf` with an empty `base_frame`: it needs the name",
        ),
    ] {
        assert!(
            parse(text).unwrap_err().contains(part),
            "{text}: {:?}",
            parse(text)
        );
    }
    let missing = Parameters::default().read(Path::new("/none.yaml"), &node());
    assert!(
        missing
            .unwrap_err()
            .to_string()
            .starts_with("/none.yaml: cannot be read: ")
    );
}

#[test]
fn what_means_nothing_here_is_told_and_ends_nothing() {
    for (text, line, part) in [
        (
            "/**:\n  ros__parameters: {stmap: last}",
            "2",
            "unknown parameter `stmap`: known are sensors, root, health, base_frame, deskew, odometry, clock, frame_id, stamp",
        ),
        (
            "/**:\n  ros__parameters:\n    roof:\n      frame_id: a\n      rate: 3",
            "5",
            "unknown parameter `roof.rate`: of a sensor are known frame_id",
        ),
        (
            "/**:\n  ros__parameters: {qos_overrides: {/sweepd/roof/points: {publisher: {depth: 3}}}}",
            "2",
            "the qualities of publishers are fixed",
        ),
        (
            "/camera:\n  ros__parameters: {}",
            "",
            " nothing for the node /robot/sweepd, only for `/camera`",
        ),
        ("", "", " no parameters"),
        (
            "/**:\n  ros__parameters: {camera: {layout: rgb}}",
            "2",
            "`camera.layout`: expected xyzirt or autoware",
        ),
    ] {
        let ignored = parse(text).unwrap().ignored;
        let begin = format!("ros2.yaml:{line}");
        let is_told = ignored[0].starts_with(&begin) && ignored[0].contains(part);
        assert!(is_told && ignored.len() == 1, "{ignored:?}");
    }
}

#[test]
fn what_a_client_gets_it_can_set() {
    let text = "
/robot/sweepd:
  ros__parameters:
    stamp: last
    fields: [x, y, z, ring]
    scan_heights: [0.1, 1]
    roof: {organized: true, layout: autoware, scan_ring: 3}
";
    let mut parameters = parse(text).unwrap();
    let before = parameters.of("roof");
    for name in Parameters::names(["roof"].into_iter()) {
        let value = parameters.value(&name);
        assert_ne!(value, Value::NotSet, "{name}: no file can set it");
        assert_eq!(parameters.set_running(&name, &value), Ok(()), "{name}");
        assert_eq!(parameters.value(&name), value);
        let other = parameters.set_running(&name, &Value::Text("other".to_owned()));
        let is_fixed = other.is_err_and(|why| why.contains("is read at the start"));
        assert_eq!(is_fixed, Parameters::is_fixed(&name), "{name}");
        assert!(!description(&name).is_empty(), "{name}");
    }
    assert_eq!(parameters.of("roof"), before);
    let heights_m = Value::Doubles(vec![0.1, 1.0]);
    assert_eq!(parameters.value("roof.scan_heights"), heights_m);
    // As in a file, a list of whole numbers will do.
    let heights_m = Value::Integers(vec![0, 2]);
    assert_eq!(parameters.set_running("scan_heights", &heights_m), Ok(()));
    // No ring: of all, or of a sensor beside others that have one.
    for value in [
        Value::Integer(-1),
        Value::NotSet,
        Value::Text(String::new()),
    ] {
        for (name, ring) in [("scan_ring", 5), ("roof.scan_ring", 3)] {
            let given = parameters.set_running(name, &Value::Integer(ring));
            assert_eq!(given, Ok(()), "{name}");
        }
        assert_eq!(parameters.set_running("roof.scan_ring", &value), Ok(()));
        let rings = [Slice::Heights([0.1, 1.0]), Slice::Ring(5)];
        assert_eq!(["roof", "front"].map(|one| parameters.of(one).slice), rings);
        assert_eq!(parameters.value("roof.scan_ring"), Value::Integer(-1));
    }
    let wrong = parameters.set_running("scan_ring", &Value::Integer(-2));
    let words = "`scan_ring`: expected a whole number from 0 on, not `-2`";
    assert_eq!(wrong, Err(words.to_owned()));
    let wrong = parameters.set_running("roof.stamp", &Value::Bool(true));
    let words = "`roof.stamp`: expected first or middle or last, not `true`";
    assert_eq!(wrong, Err(words.to_owned()));
}

#[test]
fn arguments_are_parameters_too() {
    let mut parameters = Parameters::default();
    for (name, value) in [
        ("stamp", "last"),
        ("roof.frame_id", "top"),
        ("sensors", "[roof]"),
        ("health", ""),
    ] {
        parameters.set(name, value).unwrap();
    }
    let roof = parameters.of("roof");
    assert_eq!((&roof.frame_id[..], roof.stamp), ("top", Stamp::Last));
    assert_eq!((parameters.sensors.len(), parameters.health), (1, None));
    for (name, value) in [("stamp", "x"), ("stamp", "[")] {
        let error = parameters.set(name, value).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("-p {name}:={value}: ")),
            "{error}"
        );
    }
}
