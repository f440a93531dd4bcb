//! `examples/sweepd.h` in C99 and in C++11: every point, and every header that is none.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{LayoutError, ReturnKind};

use super::sweeps::{SOURCES, Source};
use super::{folder, of_project};

/// A language, its compiler, and how strict that is told to be.
const LANGUAGES: [(&str, &str, &[&str]); 2] = [
    ("C99", "cc", &["-std=c99", "-x", "c", "-Wconversion"]),
    ("C++11", "c++", &["-std=c++11", "-x", "c++"]),
];

/// Compiles the program in all languages that can be, for a test.
pub fn programs(test: &str) -> Vec<(&'static str, PathBuf)> {
    let folder = folder(test);
    let compiled = |(language, compiler, options): (&'static str, &str, &[&str])| {
        let program = folder.join(language);
        let mut command = Command::new(compiler);
        command
            .args(options)
            .args(["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
            .arg(of_project("examples"))
            .arg(of_project("tests/slow/consumers/layout.c"));
        let output = command
            .args(["-x", "none", "-o"])
            .arg(&program)
            .arg("-lm")
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{language}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        (language, program)
    };
    LANGUAGES.into_iter().map(compiled).collect()
}

pub fn run(program: &Path, args: &[&Path]) -> Vec<u8> {
    let output = Command::new(program).args(args).output().unwrap();
    assert!(output.status.success(), "{args:?}: {:?}", output.status);
    output.stdout
}

/// The records of the program.
fn records(bytes: &[u8]) -> impl Iterator<Item = ([f64; 10], i64)> {
    let (records, rest) = bytes.as_chunks::<88>();
    assert!(rest.is_empty());
    records.iter().map(|record| {
        let number = |at: usize| f64::from_le_bytes(record[at * 8..][..8].try_into().unwrap());
        (
            std::array::from_fn(number),
            i64::from_le_bytes(record[80..].try_into().unwrap()),
        )
    })
}

#[test]
fn the_header_has_the_points_of_every_return() {
    let programs = programs("points");
    let file = folder("points_of").join("sweep");
    for source in SOURCES {
        for sweep in source.sweeps() {
            std::fs::write(&file, sweep.as_ref()).unwrap();
            let view = SweepRef::open(sweep.as_ref()).unwrap();
            for (language, program) in &programs {
                let said = run(program, &["points".as_ref(), &file]);
                let mut said = records(&said);
                for one in view.returns() {
                    let place = format!(
                        "{language}, {source:?}, row {}, column {}",
                        one.row, one.column
                    );
                    let (
                        [
                            row,
                            column,
                            kind,
                            label,
                            reflectivity,
                            range,
                            azimuth,
                            x,
                            y,
                            z,
                        ],
                        time_ns,
                    ) = said.next().unwrap_or_else(|| panic!("{place} is missing"));
                    assert_eq!(
                        (row, column, time_ns),
                        (one.row as f64, one.column as f64, one.time_ns),
                        "{place}"
                    );
                    let is_last = f64::from(one.kind as u8) == kind
                        && (kind == 2.0) == (one.kind == ReturnKind::Last);
                    assert!(is_last && label == f64::from(one.label), "{place}");
                    assert_eq!(
                        (reflectivity, range),
                        (one.reflectivity.into(), one.range_m.into()),
                        "{place}"
                    );
                    assert_eq!(azimuth, view.azimuth_rad(one.row, one.column), "{place}");
                    let off = [x, y, z]
                        .into_iter()
                        .zip(one.point_m)
                        .map(|(one, other)| (one - other).abs());
                    assert!(
                        off.fold(0.0, f64::max) < 1e-9,
                        "{place}: {x} {y} {z}, {:?}",
                        one.point_m
                    );
                }
                assert!(
                    said.next().is_none(),
                    "{language}, {source:?}: more returns than there are"
                );
            }
        }
    }
}

/// A number in the header that is something else, and how many of the bytes there are, from where.
pub struct Fault {
    pub at: usize,
    pub value: u32,
    pub len: usize,
    pub shift: usize,
}

#[test]
fn the_header_refuses_what_rust_refuses() {
    let sweep = Source::StreetVlp16Dual.sweeps().swap_remove(1);
    let bytes: &[u8] = sweep.as_ref();
    let old = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let mut faults = Vec::new();
    for at in (0..152).chain(236..240).step_by(4) {
        let others = [
            0,
            1,
            2,
            3,
            16,
            63,
            64,
            256,
            257,
            1 << 20,
            (1 << 20) + 1,
            1 << 28,
            u32::MAX,
        ];
        let near = [
            old(at),
            old(at).wrapping_add(1),
            old(at).wrapping_sub(1),
            old(at).wrapping_mul(2),
        ];
        faults.extend(others.into_iter().chain(near).map(|value| Fault {
            at,
            value,
            len: bytes.len(),
            shift: 0,
        }));
    }
    // Columns and margin that are just too many together.
    let spare = old(112) - old(108) - old(236);
    faults.extend([0, 1].map(|more| Fault {
        at: 236,
        value: old(236) + spare + more,
        len: bytes.len(),
        shift: 0,
    }));
    let lengths = [0, 7, 447, 448, 1000, bytes.len() - 1];
    faults.extend(lengths.map(|len| Fault {
        at: 8,
        value: old(8),
        len,
        shift: 0,
    }));
    faults.extend([4, 8, 64].map(|shift| Fault {
        at: 8,
        value: old(8),
        len: bytes.len(),
        shift,
    }));

    let open = |bytes: &[u8]| SweepRef::open(bytes).map(|_| ());
    compare_refusals("check", bytes, &faults, &[0, 1, 2, 3], open);
}

/// The status that the program finds of bytes with each fault, against the error of Rust.
pub fn compare_refusals(
    check: &str,
    bytes: &[u8],
    faults: &[Fault],
    statuses: &[u8],
    open: impl Fn(&[u8]) -> Result<(), LayoutError>,
) {
    // Aligned to 64 as a sweep is, with room for the shift.
    let mut buffer = sweepd::buffers::Buffers::take(
        &mut sweepd::buffers::HeapBuffers::default(),
        bytes.len() + 64,
    );
    let buffer: &mut [u8] = buffer.as_mut();
    let (mut lines, mut expected) = (String::new(), String::new());
    for Fault {
        at,
        value,
        len,
        shift,
    } in faults
    {
        writeln!(lines, "{at} {value} {len} {shift}").unwrap();
        let shifted = &mut buffer[*shift..][..bytes.len()];
        shifted.copy_from_slice(bytes);
        shifted[*at..at + 4].copy_from_slice(&value.to_le_bytes());
        let status = match open(&shifted[..*len]) {
            Ok(()) => 0,
            Err(LayoutError::Bytes { .. } | LayoutError::Torn { .. }) => 1,
            Err(
                LayoutError::Foreign
                | LayoutError::Version { .. }
                | LayoutError::ObjectsVersion { .. },
            ) => 2,
            Err(LayoutError::Inconsistent) => 3,
            Err(other) => panic!("{other}"),
        };
        writeln!(expected, "{status}").unwrap();
    }
    assert!(
        statuses
            .iter()
            .all(|status| expected.contains(&status.to_string())),
        "all are there"
    );
    let file = folder(&format!("refused_{check}")).join("bytes");
    std::fs::write(&file, bytes).unwrap();
    for (language, program) in programs(check) {
        let mut child = Command::new(program)
            .args([check.as_ref(), file.as_os_str()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        let lines = lines.clone();
        let writer = std::thread::spawn(move || input.write_all(lines.as_bytes()).unwrap());
        let output = child.wait_with_output().unwrap();
        writer.join().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        for ((said, expected), fault) in said.lines().zip(expected.lines()).zip(faults) {
            let Fault {
                at,
                value,
                len,
                shift,
            } = fault;
            assert_eq!(
                said, expected,
                "{language}: {value} at {at}, {len} bytes from {shift}"
            );
        }
        assert_eq!(said.lines().count(), faults.len(), "{language}");
    }
}
