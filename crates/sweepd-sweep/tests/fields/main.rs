//! The Rust types are the one table of the fields of the layout. What `docs/layout.md`,
//! `examples/sweepd.h`, the Python package and the page of `sweepd view` have of it is written here,
//! between the lines `begin fields: NAME` and `end fields`; the rest of these files is written by hand.

mod c;
mod markdown;
mod python;
mod script;
mod source;

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use sweepd_sweep::layout::{HOST_FIELDS, TimeSource};
use sweepd_sweep::objects::{Object, ObjectsHeader};
use sweepd_sweep::{BeamRow, Column, Header, Segment};
use zerocopy::{FromBytes, IntoBytes};

use crate::source::{Table, Topic};

const PAGE: &str = "docs/layout.md";
const FILES: [&str; 4] = [
    PAGE,
    "examples/sweepd.h",
    "python/src/sweepd/layout.py",
    "crates/sweepd-tools/src/view/page/sweep.js",
];

const CURE: &str = "SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-sweep --test fields";
const BEGIN: &str = "begin fields: ";
const END: &str = "end fields";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn table() -> Table {
    Table::read(&root())
}

fn section(table: &Table, path: &str, key: &str) -> Option<String> {
    match path {
        PAGE => markdown::section(table, key),
        "examples/sweepd.h" => Some(c::section(table)),
        "python/src/sweepd/layout.py" => Some(python::section(table)),
        _ => Some(script::section(table)),
    }
}

/// The key of a line that begins a section.
fn key(line: &str) -> Option<&str> {
    line.split_once(BEGIN)?.1.split_whitespace().next()
}

/// A file with its sections written anew, and their keys.
fn rewritten(table: &Table, path: &str, text: &str) -> Result<(String, Vec<String>), String> {
    let (mut written, mut keys) = (String::new(), Vec::new());
    let mut lines = text.split_inclusive('\n');
    while let Some(line) = lines.next() {
        written += line;
        let Some(key) = key(line) else { continue };
        let section = section(table, path, key);
        written += &section.ok_or(format!("{path}: the layout has no `{key}`"))?;
        let end = lines.find(|line| line.contains(END));
        written += end.ok_or(format!("{path}: `{END}` is missing behind `{key}`"))?;
        keys.push(key.to_owned());
    }
    match keys.is_empty() {
        true => Err(format!("{path}: no line has `{BEGIN}`")),
        false => Ok((written, keys)),
    }
}

#[test]
fn every_file_has_what_the_rust_types_are() {
    let table = table();
    let structs = table.structs.iter().map(|of| of.name.clone());
    let groups = table.groups.iter().map(|group| group.key.clone());
    let mut every: Vec<String> = structs.chain(groups).collect();
    every.sort_unstable();
    for path in FILES {
        let place = root().join(path);
        let text = fs::read_to_string(&place).unwrap();
        let (written, mut keys) =
            rewritten(&table, path, &text).unwrap_or_else(|error| panic!("{error}"));
        keys.sort_unstable();
        assert!(
            path != PAGE || keys == every,
            "{PAGE} has {keys:?}, the layout {every:?}"
        );
        if text == written {
            continue;
        }
        if std::env::var_os("SWEEPD_WRITE_PAGES").is_some() {
            // The other tests here read the file meanwhile: it is always whole.
            let new = place.with_extension("new");
            fs::write(&new, &written).unwrap();
            fs::rename(&new, &place).unwrap();
            continue;
        }
        let mut both = text.lines().zip(written.lines());
        let differs = both.find(|(text, written)| text != written);
        panic!(
            "{path} differs from the Rust types: {CURE}\n(it has, it should have): {differs:#?}"
        );
    }
}

/// The compiler has the sizes that were read. As there is no padding, it has the offsets, too.
#[test]
fn the_table_has_the_sizes_of_the_rust_types() {
    let sizes = [
        ("Header", size_of::<Header>()),
        ("Column", size_of::<Column>()),
        ("BeamRow", size_of::<BeamRow>()),
        ("Segment", size_of::<Segment>()),
        ("Object", size_of::<Object>()),
        ("ObjectsHeader", size_of::<ObjectsHeader>()),
    ];
    let table = table();
    // sweepd-client asserts that of its own.
    let read = table.structs.iter().filter(|of| of.topic != Topic::Sharing);
    let read: Vec<_> = read.map(|of| (&of.name[..], of.bytes)).collect();
    assert_eq!(read, sizes);
}

/// A C compiler has each field of `examples/sweepd.h` where it is, as large as it is, and of its kind:
/// what becomes of a half and of minus one tells floats, signed and unsigned numbers.
#[test]
fn a_c_compiler_has_every_field_in_its_place() {
    let mut program = "#include <stddef.h>\n#include \"sweepd.h\"\n".to_owned();
    for of in &table().structs {
        let name = format!("sweepd_{}", of.snake_name());
        for field in &of.fields {
            let place = field.unique_name();
            let whole = format!("(({name} *)0)->{place}");
            let one = match field.kind.count {
                Some(_) => format!("{whole}[0]"),
                None => whole.clone(),
            };
            let kind = match &field.kind.element[..] {
                "f32" | "f64" => format!("(__typeof__({one}))0.5 > 0"),
                "u8" => format!("sizeof {one} == 1"),
                element if element.starts_with('u') => format!("(__typeof__({one}))-1 > 0"),
                element if element.starts_with('i') => {
                    format!("(__typeof__({one}))0.5 == 0 && (__typeof__({one}))-1 < 0")
                }
                _ => "1".to_owned(),
            };
            program += &format!(
                "_Static_assert(offsetof({name}, {place}) == {} && sizeof {whole} == {}\n\
                 && {kind}, \"{name}.{place}\");\n",
                field.offset, field.bytes
            );
        }
    }
    assert!(program.matches("_Static_assert").count() > 100);
    let mut compiler = Command::new("cc")
        .args(["-std=gnu11", "-fsyntax-only", "-x", "c", "-", "-I"])
        .arg(root().join("examples"))
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = compiler.stdin.take().unwrap();
    input.write_all(program.as_bytes()).unwrap();
    drop(input);
    assert!(compiler.wait().unwrap().success());
}

/// What stands behind a module of tests counts.
#[test]
fn what_cannot_be_read_is_refused_by_its_place() {
    for (item, error) in [
        (
            "#[repr(C)] struct A { b: u32 }",
            "A::b: it has no doc comment",
        ),
        (
            "#[repr(C)] struct A { /** B. */ b: bool }",
            "A::b: its type is not known",
        ),
        (
            "#[repr(C)] struct A { /** B. */ b: [u8; N] }",
            "A::b: its length is not known",
        ),
        (
            "/** A. */ enum A { /** B. */ B = 1 }",
            "A: it is not in PREFIXES",
        ),
        (
            "/** A. */ enum Part { /** B. */ B }",
            "Part::B: its value is not known",
        ),
        (
            "/** A. */ mod flags { /** B. */ const B: u32 = f(); }",
            "flags::B: its value is not known",
        ),
    ] {
        let source = format!("#[cfg(test)] mod tests {{ const X: f32 = 1.0; }}\n{item}");
        let read = std::panic::catch_unwind(|| Table::default().add(&source, Topic::Sweep));
        let said = read.unwrap_err();
        assert_eq!(said.downcast_ref::<String>().unwrap(), error);
    }
}

#[test]
fn a_change_by_hand_is_seen() {
    let table = table();
    for path in FILES {
        let text = fs::read_to_string(root().join(path)).unwrap();
        for (from, to) in [("sensor_time_ns", "sensor_ns"), ("0x38", "0x39"), (END, "")] {
            assert!(text.contains(from), "{path}: {from}");
            let changed = text.replacen(from, to, 1);
            let written = rewritten(&table, path, &changed);
            assert_ne!(
                written.map(|(written, _)| written),
                Ok(changed),
                "{path}: {from}"
            );
        }
    }
}

/// One list in the code: the page names what is on it, and what is masked is what is on it.
#[test]
fn the_page_names_what_depends_on_the_host() {
    let page = fs::read_to_string(root().join(PAGE)).unwrap();
    let (_, behind) = page
        .split_once("byte for byte, except for the fields that depend on the receiving host:")
        .unwrap();
    let sentence = behind.split(". ").next().unwrap();
    let named: Vec<&str> = sentence.split('`').skip(1).step_by(2).collect();
    assert_eq!(named, HOST_FIELDS);

    let mut header = Header::read_from_bytes(&[0xFF; size_of::<Header>()]).unwrap();
    header.time_source = TimeSource::Host as u32;
    let column = Column::read_from_bytes(&[0xFF; size_of::<Column>()]).unwrap();
    let table = table();
    let mut masked = BTreeSet::new();
    for (name, bytes) in [
        ("Header", header.without_host().as_bytes()),
        ("Column", column.without_host().as_bytes()),
    ] {
        let of = table.structs.iter().find(|of| of.name == name).unwrap();
        for field in &of.fields {
            let is_zero = bytes[field.offset..][..field.bytes]
                .iter()
                .all(|&byte| byte == 0);
            if is_zero && field.name != "time_source" {
                masked.insert(&field.name[..]);
            }
        }
    }
    assert_eq!(masked, BTreeSet::from(HOST_FIELDS));
    header.time_source = TimeSource::Gps as u32;
    let kept = header.without_host().time_ns;
    assert_eq!(kept, header.time_ns, "UTC is the sensor's own");
}
