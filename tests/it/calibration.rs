//! Calibration files that people have: all real ones are read, and broken ones are refused with
//! file, line and key.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use sweepd::files::{self, CalibrationFileError};
use sweepd::sensor::MAX_FILE_LEN;
use sweepd::sensor::compare::Quantity;
use sweepd::sensor::{
    Beam, Calibration, CalibrationError, Model, ModelExt, db_xml, ros_yaml, stream,
};
use sweepd::sensor::{Intensity, TwoPoint};
use sweepd::wire::hdl64::{Clock, DUMP_PACKETS, Dump, Gps, Live, Series, Status, emit};

/// The folder of real calibrations, if it is there.
fn data_dir() -> PathBuf {
    sweepd_testkit::data_dir().join("calib")
}

fn read(dir: &Path, name: &str) -> Calibration {
    files::calibration(&dir.join(name)).unwrap_or_else(|error| panic!("{error}"))
}

/// Files of one model: whatever it is called, it fits that model and no other.
const OF_A_MODEL: [(&str, Model); 10] = [
    ("rosdrivers_VLP16db.yaml", Model::Vlp16),
    ("veloview_VLP-16.xml", Model::Vlp16),
    ("rosdrivers_VLP16_hires_db.yaml", Model::PuckHiRes),
    ("veloview_Puck-Hi-Res.xml", Model::PuckHiRes),
    ("rosdrivers_32db.yaml", Model::Hdl32e),
    ("hdl32e_32db.xml", Model::Hdl32e),
    ("veloview_HDL-32.xml", Model::Hdl32e),
    ("rosdrivers_VeloView-VLP-32C.yaml", Model::Vlp32c),
    ("veloview_VLP-32c.xml", Model::Vlp32c),
    ("rosdrivers_VLS128.yaml", Model::Vls128),
];

/// Puck LITE is a VLP-16 to a calibration.
fn same_beams(a: Model, b: Model) -> bool {
    let plain = |model| {
        if model == Model::PuckLite {
            Model::Vlp16
        } else {
            model
        }
    };
    plain(a) == plain(b)
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn every_real_file_is_in_the_tables_above() {
    let dir = data_dir();
    let mut files: Vec<String> = std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    let models = OF_A_MODEL.iter().map(|row| row.0);
    let mut listed: Vec<&str> = models.chain(sweepd_testkit::HDL64E_UNITS).collect();
    listed.sort_unstable();
    assert_eq!(files, listed);
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn files_of_a_model_fit_it_and_no_other() {
    let dir = data_dir();
    for (name, model) in OF_A_MODEL {
        for other in Model::ALL {
            let fitted = read(&dir, name).for_model(other);
            if same_beams(model, other) {
                let fitted = fitted.unwrap_or_else(|error| panic!("{name}: {error}"));
                assert_eq!(fitted.beams().len(), model.spec().channels, "{name}");
                assert_eq!(fitted.rows(), model.calibration().unwrap().rows(), "{name}");
                for (beam, nominal) in fitted
                    .beams()
                    .iter()
                    .zip(model.calibration().unwrap().beams())
                {
                    let apart = (beam.elevation_rad - nominal.elevation_rad).to_degrees();
                    assert!(
                        apart.abs() < 0.005,
                        "{name}: beam {} is {apart} degrees off",
                        beam.channel
                    );
                    let turned = (beam.rotation_rad - nominal.rotation_rad).to_degrees();
                    assert!(turned.abs() < 0.005, "{name}: beam {}", beam.channel);
                    assert_eq!((beam.two_point, beam.intensity), (None, None), "{name}");
                }
                assert_eq!(
                    fitted.distance_unit_m(),
                    model.spec().distance_unit_m,
                    "{name}"
                );
            } else {
                let error = fitted.unwrap_err();
                assert!(
                    error.contains(&format!("the {other} ")),
                    "{name} as {other}: {error}"
                );
                assert!(
                    error.ends_with(&format!("; this is the calibration of the {model}")),
                    "{name}: {error}"
                );
            }
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_wrong_unit_of_a_vls128_file_is_set_right_and_no_other() {
    let dir = data_dir();
    for (name, model) in OF_A_MODEL {
        let calibration = read(&dir, name);
        let is_wrong = name == "rosdrivers_VLS128.yaml";
        assert_eq!(calibration.has_mistaken_unit(model), is_wrong, "{name}");
        if is_wrong {
            assert_eq!(calibration.distance_unit_m(), 0.007);
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn all_files_of_an_hdl64e_fit_it_and_no_other() {
    let dir = data_dir();
    for name in sweepd_testkit::HDL64E_UNITS {
        let calibration = read(&dir, name);
        for model in Model::ALL {
            let fitted = calibration.clone().for_model(model);
            assert_eq!(fitted.is_ok(), model.is_hdl64e(), "{name} {model}");
            assert!(
                fitted.is_ok()
                    || fitted
                        .unwrap_err()
                        .ends_with("; this is the calibration of the HDL-64E S2")
            );
        }
    }
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_file_that_ignores_enabled_slots_still_fits() {
    let dir = data_dir();
    let text = std::fs::read_to_string(dir.join("veloview_VLP-16.xml")).unwrap();
    let begin = text.find("<enabled_").unwrap();
    let end = text.find("</enabled_>").unwrap();
    let all_on = format!(
        "{}{}{}",
        &text[..begin],
        text[begin..end].replace(">0<", ">1<"),
        &text[end..]
    );
    let calibration = db_xml::parse(&all_on, "db.xml").unwrap();
    assert_eq!(calibration.beams().len(), 64);
    assert!(calibration.clone().for_model(Model::Vlp16).is_ok());
    assert!(calibration.for_model(Model::Hdl32e).is_err());
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn xml_and_yaml_of_one_unit_agree() {
    let dir = data_dir();
    let xml = read(&dir, "hdl64e_s2.1-sztaki.xml");
    let yaml = read(&dir, "rosdrivers_64e_s2.1-sztaki.yaml");
    assert_eq!(xml.rows(), yaml.rows());
    assert!((xml.distance_unit_m() - 0.002).abs() < 1e-12);
    for (x, y) in xml.beams().iter().zip(yaml.beams()) {
        let (xt, yt) = (x.two_point.unwrap(), y.two_point.unwrap());
        // Not compared: the smallest and largest intensities. The converter that made this YAML
        // from the XML counted only the values other than 0 and 255, so it gave most of them to the
        // wrong laser.
        let (xi, yi) = (x.intensity.unwrap(), y.intensity.unwrap());
        let pairs = [
            (x.elevation_rad, y.elevation_rad),
            (x.rotation_rad, y.rotation_rad),
            (x.distance_offset_m, y.distance_offset_m),
            (x.vertical_offset_m, y.vertical_offset_m),
            (x.horizontal_offset_m, y.horizontal_offset_m),
            (xt.distance_offset_x_m, yt.distance_offset_x_m),
            (xt.distance_offset_y_m, yt.distance_offset_y_m),
            (xi.focal_distance_m, yi.focal_distance_m),
            (xi.focal_slope, yi.focal_slope),
        ];
        for (a, b) in pairs {
            assert!((a - b).abs() < 1e-12, "beam {}: {a} {b}", x.channel);
        }
    }
    // The first laser by hand, from the degrees and centimetres of the file.
    let first = xml.beams()[0];
    assert!((first.elevation_rad - (-8.7686234_f64).to_radians()).abs() < 1e-12);
    assert!((first.distance_offset_m - 1.5195264).abs() < 1e-12);
    let intensities = |beam: usize| xml.beams()[beam].intensity.map(|i| (i.min, i.max));
    assert_eq!(
        (intensities(0), intensities(1)),
        (Some((0.0, 235.0)), Some((30.0, 255.0)))
    );
    assert_eq!(intensities(56), Some((0.0, 220.0)));
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn two_point_correction_does_not_need_the_switch() {
    let dir = data_dir();
    let (without, with) = (
        read(&dir, "hdl64e_s3-unit1090_db.yaml"),
        read(&dir, "rosdrivers_64e_s3-xiesc.yaml"),
    );
    assert_eq!(without, with);
    assert!(without.beams().iter().all(|beam| beam.two_point.is_some()));
    // Zeros on both axes are no correction, whatever the switch says.
    assert!(
        read(&dir, "rosdrivers_64e_utexas.yaml")
            .beams()
            .iter()
            .all(|beam| beam.two_point.is_none())
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn a_missing_beam_is_named() {
    let dir = data_dir();
    let text = std::fs::read_to_string(dir.join("hdl64e_s2.1-sztaki.xml")).unwrap();
    for beam in [0, 7, 63] {
        let id = text.find(&format!("<id_>{beam}</id_>")).unwrap();
        let begin = text[..id].rfind("<item").unwrap();
        let end = id + text[id..].find("</item>").unwrap() + "</item>".len();
        let error = refused(db_xml::parse(
            &format!("{}{}", &text[..begin], &text[end..]),
            "db.xml",
        ));
        let line = 1 + text[..text.find("<points_").unwrap()].matches('\n').count();
        assert_eq!(
            error,
            format!("db.xml:{line}: beam {beam} is missing: expected id_ 0 to 63, each once")
        );
    }
}

/// The message of a refusal, which must be one line with a place in the file.
fn refused(result: Result<Calibration, CalibrationError>) -> String {
    let error = result.expect_err("must be refused");
    assert!(
        matches!(error, CalibrationError::At { line: 1.., .. }),
        "{error:?}"
    );
    let message = error.to_string();
    assert!(!message.contains('\n') && message.len() < 200, "{message}");
    message
}

/// Three beams, one a line, from line 4.
const YAML: &str = "\
num_lasers: 3
distance_resolution: 0.002
lasers:
- {laser_id: 0, rot_correction: 0.0, vert_correction: -0.2}
- {laser_id: 1, rot_correction: 0.0, vert_correction: 0.0, dist_correction: 0.1}
- {laser_id: 2, rot_correction: 0.0, vert_correction: 0.2, min_intensity: 10.5, max_intensity: 200}
";

#[test]
fn yaml_leaves_out_what_is_neutral() {
    let calibration = ros_yaml::parse(YAML, "a.yaml").unwrap();
    assert_eq!(calibration.rows(), [2, 1, 0]);
    let beams = calibration.beams();
    assert_eq!(beams[0].intensity, None);
    assert_eq!(beams[1].distance_offset_m, 0.1);
    let intensity = beams[2].intensity.unwrap();
    assert_eq!((intensity.min, intensity.max), (10.5, 200.0));
    assert!(ros_yaml::parse(&format!("\u{feff}{YAML}"), "a.yaml").is_ok());
}

#[test]
fn broken_yaml_is_refused_with_line_and_key() {
    let cases = [
        (
            "vert_correction: -0.2",
            "rot_correction_: 1",
            "4: unknown key \"rot_correction_\"",
        ),
        (
            ", vert_correction: -0.2",
            "",
            "4: beam 0: vert_correction is missing",
        ),
        (
            "vert_correction: -0.2",
            "vert_correction: -15",
            "4: beam 0: vert_correction is -15 radians, expected -1.5708 to 1.5708; are these degrees?",
        ),
        (
            "vert_correction: -0.2",
            "vert_correction: 400",
            "4: beam 0: vert_correction is 400 radians, expected -1.5708 to 1.5708",
        ),
        (
            "vert_correction: -0.2",
            "vert_correction: NaN",
            "4: beam 0: vert_correction is NaN, expected a finite number",
        ),
        (
            "vert_correction: -0.2",
            "vert_correction: .inf",
            "4: beam 0: vert_correction: expected a number, found \".inf\"",
        ),
        (
            "vert_correction: -0.2",
            "vert_correction: up",
            "4: beam 0: vert_correction: expected a number, found \"up\"",
        ),
        (
            "1, rot_correction: 0.0",
            "1, rot_correction: 3.2",
            "5: beam 1: rot_correction is 3.2 radians, expected -3.1416 to 3.1416; are these degrees?",
        ),
        (
            "dist_correction: 0.1",
            "dist_correction: 123.8",
            "5: beam 1: dist_correction is 123.8 metres, expected -5 to 5; are these centimetres?",
        ),
        (
            "dist_correction: 0.1",
            "dist_correction_x: 0.1",
            "5: beam 1: dist_correction_x without dist_correction_y",
        ),
        (
            "dist_correction: 0.1",
            "two_pt_correction_available: maybe",
            "5: beam 1: two_pt_correction_available: expected true or false, found \"maybe\"",
        ),
        (
            "max_intensity: 200",
            "max_intensity: 300",
            "6: beam 2: max_intensity is 300, expected 0 to 255",
        ),
        (
            "max_intensity: 200",
            "max_intensity: 5",
            "6: beam 2: the smallest intensity is 10.5, expected less than the largest, 5",
        ),
        (
            "laser_id: 2",
            "laser_id: 1",
            "6: laser_id 1 is there twice, first on line 5",
        ),
        (
            "laser_id: 1",
            "laser_id: 3",
            "4: beam 1 is missing: expected laser_id 0 to 3, each once",
        ),
        (
            "laser_id: 1",
            "laser_id: -1",
            "5: laser_id: expected 0 to 127, found \"-1\"",
        ),
        ("laser_id: 1, ", "", "5: a laser without laser_id"),
        (
            "num_lasers: 3",
            "num_lasers: 2",
            "1: num_lasers is 2, expected 3, the number of lasers here",
        ),
        (
            "num_lasers: 3",
            "num_lasers: 4",
            "4: beam 3 is missing: expected laser_id 0 to 3, each once",
        ),
        (
            "num_lasers: 3",
            "num_lasers: 1e99",
            "1: num_lasers: expected 0 to 128, found \"1e99\"",
        ),
        (
            "distance_resolution: 0.002",
            "distance_resolution: 0.2",
            "2: distance_resolution is 0.2 metres, expected 0.0005 to 0.05 (0.002 on most models)",
        ),
        (
            "distance_resolution: 0.002\n",
            "",
            "3: distance_resolution is missing: the metres of one unit of distance, 0.002 on most models",
        ),
    ];
    for (from, to, expected) in cases {
        assert!(YAML.contains(from), "{from}");
        let error = refused(ros_yaml::parse(&YAML.replacen(from, to, 1), "a.yaml"));
        assert_eq!(error, format!("a.yaml:{expected}"));
    }
}

/// What the model determines need not be in the file, and a key may be there twice with one value.
#[test]
fn the_unit_of_distance_may_be_that_of_the_model() {
    let nominal = Model::Vlp32c.calibration().unwrap();
    let hdl64: Vec<Beam> = (0..64)
        .map(|channel| Beam::ideal(channel, (2.0 - 0.41 * channel as f64).to_radians()))
        .collect();
    let hdl64 = Calibration::new(hdl64, 0.002).unwrap();
    for (calibration, says) in [(&hdl64, "0.002 metres"), (nominal, "0.004 metres")] {
        let text = ros_yaml::emit(calibration);
        let line = text
            .lines()
            .find(|line| line.starts_with("distance"))
            .unwrap();
        let old = ros_yaml::parse(&text.replace(line, ""), "a.yaml").unwrap();
        assert_eq!(old.beams(), calibration.beams());
        assert_eq!(old.distance_unit_m(), calibration.distance_unit_m());
        let [remark] = old.remarks() else {
            panic!("{:?}", old.remarks())
        };
        assert!(
            !remark.is_warning && remark.text.contains(says),
            "{remark:?}"
        );

        let key = format!("rot_correction: {}", calibration.beams()[0].rotation_rad);
        let twice = text.replacen(&key, &format!("{key}, {key}"), 1);
        let twice = ros_yaml::parse(&twice, "a.yaml").unwrap();
        assert_eq!(twice.beams(), calibration.beams());
        let [remark] = twice.remarks() else {
            panic!("{:?}", twice.remarks())
        };
        assert!(
            remark.is_warning && remark.text.starts_with("a.yaml:4: "),
            "{remark:?}"
        );
    }
}

#[test]
fn text_that_is_no_calibration_is_refused_in_one_line() {
    let texts = [
        "",
        "{",
        "hello",
        "lasers: 3\n",
        "lasers: []\ndistance_resolution: 0.002\n",
        "lasers:\n- 3\n",
        "lasers:\n- {laser_id: [1, 2], vert_correction: 0}\n",
        "lasers:\n- {laser_id: 0, vert_correction: }\n",
        "lasers:\n- {laser_id: 0, vert_correction: 0, vert_correction: 1}\n",
        "angles: [1]\n",
        "lasers: &a [*a]\n",
        "\t- x",
    ];
    for text in texts {
        refused(ros_yaml::parse(text, "a.yaml"));
    }
    for text in [
        "",
        "<",
        "<a>",
        "<a/>",
        "<boost_serialization><DB></DB></boost_serialization>",
        "<a>\n</b>",
        "&x;",
    ] {
        refused(db_xml::parse(text, "db.xml"));
    }
    let list = refused(ros_yaml::parse(
        "lasers:\n- {laser_id: 0, vert_correction: [1, 2]}\n",
        "a.yaml",
    ));
    assert_eq!(
        list,
        "a.yaml:2: expected string scalar: \"vert_correction: [1, 2]}\""
    );
    let twice = refused(ros_yaml::parse(
        &YAML.replacen("laser_id: 1", "laser_id: 1, laser_id: 2", 1),
        "a.yaml",
    ));
    assert!(
        twice.starts_with("a.yaml:5: duplicate mapping key: laser_id"),
        "{twice}"
    );
}

/// A db.xml of this many lasers, five lines each after the first nine.
fn xml(lasers: usize) -> String {
    let list = |name: &str, value: &str| {
        format!(
            "<{name}><count>{lasers}</count>{}</{name}>\n",
            format!("<item>{value}</item>").repeat(lasers)
        )
    };
    let px = |id: usize| {
        format!(
            "<item><px>\n<id_>{id}</id_><rotCorrection_>1</rotCorrection_>\n<vertCorrection_>{id}</vertCorrection_>\n\
             <distCorrection_>100</distCorrection_><vertOffsetCorrection_>20</vertOffsetCorrection_>\n\
             <horizOffsetCorrection_>-2</horizOffsetCorrection_></px></item>\n"
        )
    };
    format!(
        "<?xml version=\"1.0\"?>\n<!DOCTYPE boost_serialization>\n<boost_serialization>\n<DB>\n\
         <distLSB_>0.2</distLSB_>\n{}{}{}<points_><count>{lasers}</count>\n{}</points_>\n\
         </DB>\n</boost_serialization>\n",
        list("enabled_", "1"),
        list("minIntensity_", "0"),
        list("maxIntensity_", "255"),
        (0..lasers).map(px).collect::<String>()
    )
}

#[test]
fn xml_units_are_degrees_and_centimetres() {
    let calibration = db_xml::parse(&xml(16), "db.xml").unwrap();
    let beam = calibration.beams()[15];
    assert!((beam.elevation_rad.to_degrees() - 15.0).abs() < 1e-12);
    assert!((beam.rotation_rad.to_degrees() - 1.0).abs() < 1e-12);
    assert_eq!(
        (
            beam.distance_offset_m,
            beam.vertical_offset_m,
            beam.horizontal_offset_m
        ),
        (1.0, 0.2, -0.02)
    );
    assert!((calibration.distance_unit_m() - 0.002).abs() < 1e-12);
}

#[test]
fn broken_xml_is_refused_with_line_and_key() {
    let good = xml(16);
    let cases = [
        (
            "<id_>1<",
            "<id_>0<",
            "16: id_ 0 is there twice, first on line 11",
        ),
        (
            "<vertCorrection_>1<",
            "<vertCorrection_>91<",
            "17: beam 1: vertCorrection_ is 91 degrees, expected -90 to 90",
        ),
        (
            "<vertCorrection_>1<",
            "<vertCorrection_><",
            "17: beam 1: vertCorrection_: expected a number, found \"\"",
        ),
        (
            "<vertCorrection_>1</vertCorrection_>",
            "",
            "15: beam 1: vertCorrection_ is missing",
        ),
        (
            "<distCorrection_>100<",
            "<distCorrection_>501<",
            "13: beam 0: distCorrection_ is 501 centimetres, expected -500 to 500",
        ),
        (
            "<distLSB_>0.2<",
            "<distLSB_>0.002<",
            "5: distLSB_ is 0.002 centimetres, expected 0.05 to 5 (0.2 on most models)",
        ),
        (
            "<enabled_><count>16</count><item>1<",
            "<enabled_><count>16</count><item>2<",
            "6: enabled_: expected 0 or 1, found \"2\"",
        ),
        (
            "<maxIntensity_><count>16</count><item>255</item>",
            "<maxIntensity_>",
            "8: maxIntensity_ has 15 values, expected 16, one a laser",
        ),
        (
            "<points_><count>16<",
            "<points_><count>15<",
            "9: count is 15, expected 16, the number of lasers here",
        ),
        ("<px>", "<py></py><px>", ""),
        (
            "<DB>",
            "<!-- <!ENTITY --><DB>",
            "4: declares an entity (<!ENTITY), which no db.xml does",
        ),
    ];
    for (from, to, expected) in cases {
        assert!(good.contains(from), "{from}");
        let result = db_xml::parse(&good.replacen(from, to, 1), "db.xml");
        match expected {
            "" => assert!(result.is_ok()),
            _ => assert_eq!(refused(result), format!("db.xml:{expected}")),
        }
    }
}

#[test]
fn entities_do_not_explode() {
    // Quadratic blow-up, which a limit on nesting does not see: one long entity, named very often.
    let long = "x".repeat(1_000_000);
    let text = format!(
        "<!DOCTYPE a [<!ENTITY b \"{long}\">]>\n<a>{}</a>",
        "&b;".repeat(500_000)
    );
    assert!(refused(db_xml::parse(&text, "db.xml")).contains("declares an entity"));
    // Each attribute of a tag is compared with all others; each element keeps the namespaces around
    // it.
    let attributes: String = (0..25_000).map(|n| format!(" a{n}='>'")).collect();
    assert!(
        refused(db_xml::parse(&format!("<a{attributes}/>"), "db.xml"))
            .contains("more than 2000 attributes")
    );
    let spaces: String = (0..15_000).map(|n| format!("<a xmlns:b{n}=''>")).collect();
    assert!(refused(db_xml::parse(&spaces, "db.xml")).contains("declares a namespace"));
    // What the parser says of a name as long as the file is not as long as the file.
    let name = refused(db_xml::parse(
        &format!("<a></{}>", "b".repeat(200_000)),
        "db.xml",
    ));
    assert!(name.ends_with('…'), "{name}");
    let deep = "<a>".repeat(300_000);
    refused(db_xml::parse(&deep, "db.xml"));
    let bomb = format!(
        "a: &a [x]\n{}lasers: *b7\n",
        (0..8)
            .map(|i| {
                let name = |i: u8| char::from(b'a' + i);
                format!(
                    "{}: &{} [{}]\n",
                    name(i + 1),
                    name(i + 1),
                    format!("*{},", name(i)).repeat(9)
                )
            })
            .collect::<String>()
    );
    refused(ros_yaml::parse(&bomb, "a.yaml"));
}

#[test]
fn reading_needs_a_file_of_text_of_sensible_length() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    let file = |bytes: &[u8]| {
        let path = dir.join("table");
        std::fs::write(&path, bytes).unwrap();
        files::calibration(&path)
    };
    assert_eq!(file(YAML.as_bytes()).unwrap().beams().len(), 3);
    assert_eq!(
        file(format!("\u{feff}{}", xml(16).trim_start()).as_bytes())
            .unwrap()
            .beams()
            .len(),
        16
    );
    let error = file(b"num_lasers: 3\n\xff\xfe\n").unwrap_err();
    assert!(
        error.to_string().contains("table:2: not text in UTF-8"),
        "{error}"
    );
    let error = file(&vec![b' '; MAX_FILE_LEN + 1]).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("more than 256 KiB, too long for a calibration"),
        "{error}"
    );
    let error = files::calibration(&dir.join("none.yaml")).unwrap_err();
    assert!(
        matches!(error, CalibrationFileError::Io { .. }) && error.to_string().contains("none.yaml"),
        "{error}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn mutated_texts_never_panic(
        at in any::<prop::sample::Index>(), cut in any::<prop::sample::Index>(), put in ".{0,6}",
    ) {
        for text in [YAML.to_owned(), xml(3)] {
            let boundary = |index: &prop::sample::Index| {
                let mut offset = index.index(text.len() + 1);
                while !text.is_char_boundary(offset) { offset -= 1; }
                offset
            };
            let (from, to) = (boundary(&at), boundary(&cut));
            let spliced = format!("{}{put}{}", &text[..from], &text[to..]);
            for text in [&text[..from], &spliced] {
                let _ = ros_yaml::parse(text, "a");
                let _ = db_xml::parse(text, "a");
            }
        }
    }
}

/// What a sensor with this calibration sends, read.
fn through_the_stream(calibration: &Calibration, series: Series) -> Calibration {
    let dump = Dump::new(series, &stream::records(calibration).unwrap());
    let clock = Clock {
        hour: 0,
        minute: 0,
        second: 0,
        day: 1,
        month: 1,
        year: 0,
    };
    let live = Live {
        clock,
        gps: Gps::None,
        temperature_c: 20,
        firmware: 227,
    };
    let mut status = Status::new();
    for (index, (kind, value)) in emit(&dump, series, &live).enumerate() {
        status.push(kind, value, (index * 288) as u32);
    }
    stream::calibration(status.dump().expect("complete within one dump")).unwrap()
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn real_hdl64e_files_go_through_the_stream_but_for_rounding() {
    let dir = data_dir();
    let mut count = 0;
    for name in sweepd_testkit::HDL64E_UNITS {
        let source = read(&dir, name);
        for series in [Series::S21, Series::S3] {
            let found = through_the_stream(&source, series);
            assert_eq!(found.distance_unit_m(), source.distance_unit_m(), "{name}");
            for (beam, original) in found.beams().iter().zip(source.beams()) {
                let channel = beam.channel;
                for quantity in Quantity::ALL {
                    let per_unit = if quantity.is_angle() { 100.0 } else { 1000.0 };
                    let expected = (quantity.of(original) * per_unit).round() / per_unit;
                    let apart = (quantity.of(beam) - expected).abs();
                    assert!(
                        apart < 1e-9,
                        "{name}: beam {channel}: {quantity:?} is {apart} off {expected}"
                    );
                }
                match (beam.intensity, original.intensity) {
                    (Some(found), Some(source)) => {
                        assert!(
                            (found.focal_distance_m - source.focal_distance_m).abs() <= 0.000_501,
                            "{name} {channel}"
                        );
                        assert!(
                            (found.focal_slope - source.focal_slope).abs() <= 0.050_001,
                            "{name} {channel}"
                        );
                        assert_eq!(
                            (found.min, found.max),
                            (source.min.round(), source.max.round()),
                            "{name}"
                        );
                    }
                    // A slope that is rounded away, with no other correction.
                    (None, Some(source)) => assert!(source.focal_slope < 0.05, "{name} {channel}"),
                    (found, source) => assert_eq!(found, source, "{name} {channel}"),
                }
            }
        }
        assert_eq!(
            ros_yaml::parse(&ros_yaml::emit(&source), "emitted").unwrap(),
            source,
            "{name}"
        );
        count += 1;
    }
    assert_eq!((count, DUMP_PACKETS), (9, 4160));
}

/// Any beam that is not one of those that have two forms (a correction that corrects nothing, or
/// none).
fn any_beam(channel: usize) -> impl Strategy<Value = Beam> {
    let offset = || -5.0..5.0_f64;
    let two_point = proptest::option::of((offset(), offset()));
    let intensity = proptest::option::of((
        0.0..131.0_f64,
        0.01..10.0_f64,
        0.0..100.0_f64,
        101.0..255.0_f64,
    ));
    (
        -1.5..1.5_f64,
        -3.1..3.1_f64,
        offset(),
        offset(),
        offset(),
        two_point,
        intensity,
    )
        .prop_map(
            move |(
                elevation_rad,
                rotation_rad,
                distance,
                vertical,
                horizontal,
                two_point,
                intensity,
            )| Beam {
                channel,
                elevation_rad,
                rotation_rad,
                distance_offset_m: distance,
                vertical_offset_m: vertical,
                horizontal_offset_m: horizontal,
                two_point: two_point.map(|(x, y)| TwoPoint {
                    distance_offset_x_m: x,
                    distance_offset_y_m: y,
                }),
                intensity: intensity.map(|(focal_distance_m, focal_slope, min, max)| Intensity {
                    focal_distance_m,
                    focal_slope,
                    min,
                    max,
                }),
            },
        )
}

proptest! {
    #[test]
    fn yaml_gives_back_what_was_written(
        beams in (1..=128_usize).prop_flat_map(|count| (0..count).map(any_beam).collect::<Vec<_>>()),
        distance_unit_m in 0.0005..0.05,
    ) {
        let calibration = Calibration::new(beams, distance_unit_m).unwrap();
        let text = ros_yaml::emit(&calibration);
        prop_assert_eq!(ros_yaml::parse(&text, "emitted").unwrap(), calibration);
    }
}

#[test]
fn what_the_stream_cannot_say_is_refused() {
    let focused = |focal_distance_m| {
        let intensity = Some(Intensity {
            focal_distance_m,
            focal_slope: 1.0,
            min: 0.0,
            max: 255.0,
        });
        let beams = (0..64).map(|channel| Beam {
            intensity,
            ..Beam::ideal(channel, 0.0)
        });
        stream::records(&Calibration::new(beams.collect(), 0.002).unwrap())
    };
    assert!(focused(32.0).is_ok());
    assert!(
        focused(33.0)
            .unwrap_err()
            .starts_with("beam 0: focal distance is too large for the stream")
    );
    let error = stream::records(Model::Vlp16.calibration().unwrap()).unwrap_err();
    assert_eq!(error, "16 beams, the HDL-64E has 64");
}
