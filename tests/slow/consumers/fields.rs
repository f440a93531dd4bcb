//! One made-up sweep and one message of objects, in which every field has another value, read by the
//! consumers in Rust, C, C++, Python and JavaScript: they agree on every field. The fields are those
//! of the leaf's table, and the programs are written from it.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fmt::{Debug, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::client::Client;
use sweepd::sweep::{Shape, SweepMut, SweepRef};
use zerocopy::IntoBytes;

use super::python::{LIMIT, Talk, loans};
use super::source::{Field, Struct, Table, Topic};
use super::{folder, objects, of_project};
use sweepd_testkit::{library::compile, python_package, python_with_numpy, temp_domain};

const SHAPE: Shape = Shape {
    rows: 3,
    columns_capacity: 11,
    dual: true,
    segments_capacity: 13,
};

/// What must be as it is, or no reader opens it.
const KEPT: [&str; 13] = [
    "magic",
    "version",
    "header_bytes",
    "total_bytes",
    "offsets",
    "rows",
    "columns",
    "columns_capacity",
    "segments",
    "segments_capacity",
    "margin_columns",
    "objects",
    "labels",
];

/// Writes another value into each field of some entries of a struct: large enough for the bytes of
/// its type, so that none is cut off; floats of few bits, which all languages write alike.
struct Values(u32);

impl Values {
    fn fill(&mut self, of: &Struct, bytes: &mut [u8]) {
        assert_eq!(bytes.len() % of.bytes, 0);
        for entry in bytes.chunks_mut(of.bytes) {
            for field in &of.fields {
                let place = &mut entry[field.offset..][..field.bytes];
                if !field.is_reserved() && !KEPT.contains(&&field.name[..]) {
                    self.fill_field(field, place);
                }
            }
        }
    }

    fn fill_field(&mut self, field: &Field, place: &mut [u8]) {
        let element = &field.kind.element[..];
        if field.is_text() {
            place.fill(0);
            place[..field.name.len()].copy_from_slice(field.name.as_bytes());
            return;
        }
        for one in place.chunks_mut(field.bytes / field.kind.count.unwrap_or(1)) {
            self.0 += 1;
            let number = i64::from(self.0);
            match element {
                "u8" => one[0] = (self.0 % 251) as u8,
                "u16" => one.copy_from_slice(&(40_000 + self.0 as u16).to_le_bytes()),
                "u32" => one.copy_from_slice(&(4_000_000_000 + self.0).to_le_bytes()),
                "i32" => one.copy_from_slice(&(-(self.0 as i32) - 1_000_000).to_le_bytes()),
                "f32" => one.copy_from_slice(&(self.0 as f32 + 0.25).to_le_bytes()),
                "u64" => one.copy_from_slice(&(u64::MAX - u64::from(self.0)).to_le_bytes()),
                "i64" => one.copy_from_slice(&(i64::MIN + number).to_le_bytes()),
                // A struct within, whose own fields are filled by the caller.
                _ => {}
            }
        }
    }
}

fn of<'a>(table: &'a Table, name: &str) -> &'a Struct {
    table.structs.iter().find(|of| of.name == name).unwrap()
}

/// A sweep of which nothing is wrong but that it makes no sense.
fn sweep(table: &Table) -> Vec<u8> {
    let mut buffer = HeapBuffers::default().take(SHAPE.total_bytes());
    let sweep = SweepMut::create(buffer.as_mut(), &SHAPE).unwrap();
    (sweep.header.columns, sweep.header.margin_columns) = (5, 4);
    sweep.header.segments = 2;
    let mut values = Values(0);
    values.fill(of(table, "Header"), sweep.header.as_mut_bytes());
    values.fill(of(table, "Column"), sweep.columns.as_mut_bytes());
    values.fill(of(table, "BeamRow"), sweep.beams.as_mut_bytes());
    values.fill(of(table, "Segment"), sweep.segments.as_mut_bytes());
    for (at, range_m) in [sweep.range, sweep.range2]
        .into_iter()
        .flatten()
        .enumerate()
    {
        *range_m = at as f32 + 0.75;
    }
    for (at, label) in [sweep.label, sweep.label2]
        .into_iter()
        .flatten()
        .enumerate()
    {
        *label = 3_000_000_000 + at as u32;
    }
    let bytes = [sweep.reflectivity, sweep.reflectivity2, sweep.kind];
    for (at, byte) in bytes.into_iter().flatten().enumerate() {
        *byte = at as u8;
    }
    buffer.as_ref().to_vec()
}

/// Three objects and four labels.
fn message(table: &Table) -> Vec<u64> {
    let mut words = objects::honest();
    let header = of(table, "ObjectsHeader");
    let (first, rest) = words.as_mut_bytes().split_at_mut(header.bytes);
    let object = of(table, "Object");
    let (told, labels) = rest.split_at_mut(3 * object.bytes);
    let mut values = Values(0);
    values.fill(header, first);
    values.fill(object, told);
    for told in told.chunks_mut(object.bytes) {
        values.fill(of(table, "Segment"), &mut told[..64]);
    }
    labels
        .iter_mut()
        .zip(201..)
        .for_each(|(to, byte)| *to = byte);
    words
}

/// What a reader in Rust has of a struct, by the name of each field: what its `Debug` writes.
fn of_rust(lines: &mut String, prefix: &str, of: &Struct, table: &Table, value: &impl Debug) {
    write_fields(lines, prefix, of, table, &format!("{value:?}"));
}

fn write_fields(lines: &mut String, prefix: &str, of: &Struct, table: &Table, written: &str) {
    let mut rest = written.split_once("{ ").unwrap().1;
    for field in &of.fields {
        // The name may have an underscore in front: then it is reserved.
        let (name, behind) = rest.split_once(": ").unwrap();
        let inner = table
            .structs
            .iter()
            .find(|of| of.name == field.kind.element);
        let end = match (inner, field.kind.count) {
            (Some(_), _) => behind.find(" }").unwrap() + 2,
            (_, Some(_)) => behind.find(']').unwrap() + 1,
            _ => behind.find([',', ' ']).unwrap(),
        };
        let (value, behind) = behind.split_at(end);
        rest = behind.trim_start_matches([',', ' ']);
        if field.is_reserved() {
            continue;
        }
        assert_eq!(name, field.name);
        let place = format!("{prefix}.{name}");
        match inner {
            Some(inner) => write_fields(lines, &place, inner, table, value),
            None if field.is_text() => {
                let bytes = value.trim_matches(['[', ']']).split(", ");
                let bytes = bytes.map(|byte| byte.parse().unwrap());
                let text: Vec<u8> = bytes.take_while(|&byte| byte != 0).collect();
                let text = String::from_utf8(text).unwrap();
                writeln!(lines, "{place} {text}").unwrap();
            }
            None => write_numbers(lines, &place, field, value),
        }
    }
}

fn write_numbers(lines: &mut String, place: &str, field: &Field, value: &str) {
    for (at, number) in value.trim_matches(['[', ']']).split(", ").enumerate() {
        let at = field.kind.count.map_or(String::new(), |_| format!(".{at}"));
        match &field.kind.element[..] {
            "f32" => writeln!(lines, "{place}{at} {:.2}", number.parse::<f32>().unwrap()),
            _ => writeln!(lines, "{place}{at} {number}"),
        }
        .unwrap();
    }
}

fn plane<T: Copy>(lines: &mut String, name: &str, values: &[T], text: fn(T) -> String) {
    for (at, &value) in values.iter().enumerate() {
        writeln!(lines, "{name}.{at} {}", text(value)).unwrap();
    }
}

fn rust_of_sweep(table: &Table, view: &SweepRef<'_>) -> String {
    let mut lines = String::new();
    of_rust(
        &mut lines,
        "header",
        of(table, "Header"),
        table,
        view.header,
    );
    for (at, column) in view.columns.iter().enumerate() {
        of_rust(
            &mut lines,
            &format!("column{at}"),
            of(table, "Column"),
            table,
            column,
        );
    }
    for (at, beam) in view.beams.iter().enumerate() {
        of_rust(
            &mut lines,
            &format!("beam{at}"),
            of(table, "BeamRow"),
            table,
            beam,
        );
    }
    for (at, segment) in view.segments.iter().enumerate() {
        of_rust(
            &mut lines,
            &format!("segment{at}"),
            of(table, "Segment"),
            table,
            segment,
        );
    }
    for (name, values) in [("range", view.range), ("range2", view.range2)] {
        plane(&mut lines, name, values, |value| format!("{value:.2}"));
    }
    for (name, values) in [("label", view.label), ("label2", view.label2)] {
        plane(&mut lines, name, values, |value| value.to_string());
    }
    let bytes = [
        ("reflectivity", view.reflectivity),
        ("reflectivity2", view.reflectivity2),
        ("kind", view.kind),
    ];
    for (name, values) in bytes {
        plane(&mut lines, name, values, |value| value.to_string());
    }
    lines
}

/// A function in C, and in C++, that writes the lines of each struct.
fn c_functions(table: &Table) -> String {
    let mut text = "#include <inttypes.h>\n#include <stdio.h>\n".to_owned();
    for of in table.structs.iter().filter(|of| of.topic != Topic::Sharing) {
        let name = of.snake_name();
        text +=
            &format!("static void put_{name}(const char *prefix, const sweepd_{name} *of) {{\n");
        for field in of.fields.iter().filter(|field| !field.is_reserved()) {
            let place = &field.name;
            let element = &field.kind.element[..];
            let (format, cast) = match element {
                _ if field.is_text() => ("%s".to_owned(), ""),
                "f32" => ("%.2f".to_owned(), "(double)"),
                "u8" | "u16" => ("%u".to_owned(), "(unsigned)"),
                _ if element.starts_with(['u', 'i']) => {
                    let sign = if element.starts_with('u') { "u" } else { "d" };
                    (format!("%\" PRI{sign}{} \"", &element[1..]), "")
                }
                _ => {
                    text += &format!(
                        "    {{ char inner[64]; snprintf(inner, sizeof inner, \"%s.{place}\", prefix); \
                         put_{}(inner, &of->{place}); }}\n",
                        element.to_lowercase()
                    );
                    continue;
                }
            };
            let count = field.kind.count.filter(|_| !field.is_text());
            text += &match count {
                None => {
                    format!("    printf(\"%s.{place} {format}\\n\", prefix, {cast}of->{place});\n")
                }
                Some(count) => format!(
                    "    for (int at = 0; at < {count}; at++) \
                     printf(\"%s.{place}.%d {format}\\n\", prefix, at, {cast}of->{place}[at]);\n"
                ),
            };
        }
        text += "}\n";
    }
    text
}

/// How a language has the parts of a sweep and of a message: the structs, then the planes.
const STRUCTS: [(&str, &str, [&str; 2]); 3] = [
    ("column", "columns", ["columns_len", "firings"]),
    ("beam", "beams", ["rows", "beams"]),
    ("segment", "segments", ["segments_len", "segments"]),
];
const PLANES: [(&str, &str); 7] = [
    ("range", "%.2f"),
    ("range2", "%.2f"),
    ("label", "%u"),
    ("label2", "%u"),
    ("reflectivity", "%u"),
    ("reflectivity2", "%u"),
    ("kind", "%u"),
];

fn c_program(table: &Table) -> String {
    let mut text = format!("#include \"sweepd.h\"\n{}", c_functions(table));
    text += "int main(int argc, char **argv) {\n    char name[32];\n    uint32_t at;\n    size_t len;\n\
             sweepd_sample *sample;\n    sweepd_sweep sweep;\n    sweepd_objects told;\n\
             sweepd_client *client = sweepd_client_open(\"roof\", argv[1]);\n    const void *bytes;\n\
             if (argc == 3) client = sweepd_client_objects(client);\n    printf(\"there\\n\");\n    fflush(stdout);\n\
             if (sweepd_client_next(client, -1, &sample) != SWEEPD_NEXT_RECEIVED) return 1;\n\
             bytes = sweepd_sample_bytes(sample, &len);\n\
             if (argc == 3) {\n        if (sweepd_objects_open(bytes, len, &told) != SWEEPD_OK) return 2;\n\
             put_objects_header(\"header\", &told.header);\n\
             for (at = 0; at < told.objects_len; at++) {\n            snprintf(name, sizeof name, \"object%u\", at);\n\
             put_object(name, &told.objects[at]);\n        }\n\
             for (at = 0; at < told.labels_len; at++) printf(\"label.%u %u\\n\", at, told.labels[at]);\n\
             printf(\"end\\n\");\n        return 0;\n    }\n\
             if (sweepd_open(bytes, len, &sweep) != SWEEPD_OK) return 3;\n    put_header(\"header\", &sweep.header);\n";
    for (one, all, [count, _]) in STRUCTS {
        text += &format!(
            "    for (at = 0; at < sweep.{count}; at++) {{ snprintf(name, sizeof name, \"{one}%u\", at); \
             put_{one}(name, &sweep.{all}[at]); }}\n"
        );
    }
    for (plane, format) in PLANES {
        let cast = cast(format);
        text += &format!(
            "    for (at = 0; at < sweep.rows * sweep.columns_len; at++) \
             printf(\"{plane}.%u {format}\\n\", at, {cast}sweep.{plane}[at]);\n"
        );
    }
    text + "    printf(\"end\\n\");\n    return 0;\n}\n"
}

/// What printf takes for this format.
fn cast(format: &str) -> &'static str {
    if format == "%u" {
        "(unsigned)"
    } else {
        "(double)"
    }
}

fn cpp_program(table: &Table) -> String {
    let mut text = format!("#include \"sweepd.hpp\"\n{}", c_functions(table));
    text += "template <class T, class U> void each(const char *one, const T &all, void (*put)(const char *, const U *)) {\n\
             for (size_t at = 0; at < all.size(); at++) put((one + std::to_string(at)).c_str(), &all[at]);\n}\n\
             int main(int argc, char **argv) {\n    sweepd::Client client(\"roof\", argv[1]);\n\
             sweepd::ObjectsClient objects = client.objects();\n    printf(\"there\\n\");\n    fflush(stdout);\n\
             if (argc == 3) {\n        for (const auto &told : objects) {\n            put_objects_header(\"header\", &told.header());\n\
             each(\"object\", told.objects(), put_object);\n            int at = 0;\n\
             for (uint32_t label : told.labels()) printf(\"label.%d %u\\n\", at++, label);\n            break;\n        }\n\
             printf(\"end\\n\");\n        return 0;\n    }\n\
             for (const auto &sweep : client) {\n    put_header(\"header\", &sweep.header());\n";
    for (one, _, [_, all]) in STRUCTS {
        text += &format!("    each(\"{one}\", sweep.{all}(), put_{one});\n");
    }
    for (plane, format) in PLANES {
        let cast = cast(format);
        text += &format!(
            "    {{ int at = 0; for (auto value : sweep.{plane}()) printf(\"{plane}.%d {format}\\n\", at++, {cast}value); }}\n"
        );
    }
    text + "    break;\n    }\n    printf(\"end\\n\");\n    return 0;\n}\n"
}

const PYTHON: &str = r#"
import sys
import numpy as np
import sweepd

def put(prefix, record):
    for name in record.dtype.names:
        value = record[name]
        if name.startswith("reserved"):
            continue
        if isinstance(value, np.void) and value.dtype.names:
            put(f"{prefix}.{name}", value)
        elif isinstance(value, bytes):
            print(f"{prefix}.{name} {value.decode()}")
        elif isinstance(value, np.void):
            numbers(f"{prefix}.{name}", np.frombuffer(value, np.uint8))
        elif isinstance(value, np.ndarray):
            numbers(f"{prefix}.{name}", value)
        else:
            print(f"{prefix}.{name} {text(value)}")

def text(value):
    return f"{value:.2f}" if isinstance(value, np.floating) else str(value)

def numbers(prefix, values):
    for at, value in enumerate(values.ravel()):
        print(f"{prefix}.{at} {text(value)}")

data = np.fromfile(sys.argv[1], np.uint8)
if len(sys.argv) == 3:
    told = sweepd.ObjectsMessage(data)
    put("header", told.header)
    for at, one in enumerate(told.objects):
        put(f"object{at}", one)
    numbers("label", told.labels)
else:
    sweep = sweepd.Sweep(data)
    put("header", sweep.header)
    for one, records in ("column", sweep.columns), ("beam", sweep.beams), ("segment", sweep.segments):
        for at, record in enumerate(records):
            put(f"{one}{at}", record)
    for name in "range", "range2", "label", "label2", "reflectivity", "reflectivity2", "kind":
        numbers(name, getattr(sweep, name))
"#;

const SCRIPT: &str = r#"
import { readFileSync } from "node:fs";
import { COLUMN, Sweep } from "./sweep.mjs";

const text = (value) => (typeof value === "number" && !Number.isInteger(value) ? value.toFixed(2) : String(value));
function put(prefix, found) {
  for (const [name, value] of Object.entries(found)) {
    if (Array.isArray(value)) value.forEach((one, at) => console.log(`${prefix}.${name}.${at} ${text(one)}`));
    else console.log(`${prefix}.${name} ${text(value)}`);
  }
}
const bytes = readFileSync(process.argv[2]);
const sweep = new Sweep(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
put("header", sweep.header);
// The page has of its columns an array a field, by names of its own.
const { azimuth, rate, time, block, status } = sweep.columns;
for (let at = 0; at < sweep.count; at++) {
  put(`column${at}`, { packet: sweep.columns.packet(at), azimuth_rad: azimuth[at], azimuth_rate_rad_s: rate[at],
    time_ns: time[at], block: block[at], status: status[at] });
}
sweep.beams.forEach((beam, at) => put(`beam${at}`, beam));
sweep.segments.forEach((segment, at) => put(`segment${at}`, segment));
for (const name of ["range", "range2", "label", "label2", "reflectivity", "reflectivity2", "kind"]) {
  sweep[name].forEach((value, at) => console.log(`${name}.${at} ${text(value)}`));
}
"#;

/// What a program says that ends by itself.
fn said(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

#[track_caller]
fn compare(language: &str, found: &str, expected: &str) {
    for (found, expected) in found.lines().zip(expected.lines()) {
        assert_eq!(found, expected, "{language}");
    }
    assert_eq!(
        found.lines().count(),
        expected.lines().count(),
        "{language}"
    );
}

/// A consumer that was sent what `publish` sends until it has it.
fn received(program: &Path, args: &[&OsStr], mut publish: impl FnMut()) -> String {
    let talk = Talk::start(program.as_os_str(), args);
    assert_eq!(talk.line(), "there");
    let mut lines = String::new();
    loop {
        publish();
        let Some(first) = talk.try_line(Duration::from_millis(100)) else {
            continue;
        };
        writeln!(lines, "{first}").unwrap();
        while let Some(line) = Some(talk.line()).filter(|line| line != "end") {
            writeln!(lines, "{line}").unwrap();
        }
        return lines;
    }
}

/// The programs in C, C++ and Python.
struct Readers {
    folder: PathBuf,
}

impl Readers {
    fn new(table: &Table, test: &str) -> Self {
        let folder = folder(test);
        let write = |name: &str, content: &str| {
            let path = folder.join(name);
            std::fs::write(&path, content).unwrap();
            path
        };
        let source = write("fields.c", &c_program(table));
        compile("cc", &["-std=c99"], &source, &folder.join("C"));
        let source = write("fields.cpp", &cpp_program(table));
        compile("c++", &["-std=c++17"], &source, &folder.join("C++"));
        write("fields.py", PYTHON);
        write("fields.mjs", SCRIPT);
        Self { folder }
    }

    /// Compares what they say of what `publish` sends, and of the same bytes in a file.
    fn compare(&self, args: &[&OsStr], bytes: &[u8], expected: &str, mut publish: impl FnMut()) {
        for language in ["C", "C++"] {
            let found = received(&self.folder.join(language), args, &mut publish);
            compare(language, &found, expected);
        }
        std::fs::write(self.folder.join("bytes"), bytes).unwrap();
        let mut python = Command::new(python_with_numpy());
        python
            .arg(self.folder.join("fields.py"))
            .arg(self.folder.join("bytes"))
            .args(&args[1..])
            .envs(python_package());
        compare("Python", &said(&mut python), expected);
    }
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers, without_node),
    ignore = "no SWEEPD_PYTHON, no compilers, or no node"
)]
fn every_language_has_every_field_of_a_sweep() {
    let table = Table::read(&of_project(""));
    let readers = Readers::new(&table, "fields");
    let own = temp_domain();
    let bytes = sweep(&table);
    let mut sweeps = loans(&own);
    let mut publish = || {
        let mut slot = sweeps.take(bytes.len());
        slot.as_mut().copy_from_slice(&bytes);
        slot.publish().unwrap();
    };
    let mut client = Client::within(&own.domain(), "roof").unwrap();
    assert!(client.next(Duration::ZERO).unwrap().received().is_none());
    publish();
    let sweep = client.next(LIMIT).unwrap().received().unwrap();
    let expected = rust_of_sweep(&table, &sweep.view().unwrap());
    drop((sweep, client));
    // All values differ: a swapped one would show.
    let is_free = |line: &&str| {
        let place = line.strip_prefix("header.").unwrap_or("magic");
        !KEPT.contains(&place.split([' ', '.']).next().unwrap())
    };
    let values: Vec<&str> = expected.lines().filter(is_free).collect();
    let different: BTreeSet<_> = values.iter().map(|line| line.rsplit(' ').next()).collect();
    assert!(
        values.len() > 30 && different.len() == values.len(),
        "{values:#?}"
    );

    readers.compare(&[own.root().as_os_str()], &bytes, &expected, &mut publish);
    let page = of_project("crates/sweepd-tools/src/view/page/sweep.js");
    std::fs::copy(page, readers.folder.join("sweep.mjs")).unwrap();
    let mut node = Command::new("node");
    node.args(["fields.mjs", "bytes"])
        .current_dir(&readers.folder);
    compare("JavaScript", &said(&mut node), &expected);
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn every_language_has_every_field_of_objects() {
    let table = Table::read(&of_project(""));
    let readers = Readers::new(&table, "fields_of_objects");
    let own = temp_domain();
    let words = message(&table);
    let message = objects::message(&words);
    let view = objects::view(message);
    let mut expected = String::new();
    of_rust(
        &mut expected,
        "header",
        of(&table, "ObjectsHeader"),
        &table,
        view.header,
    );
    for (at, object) in view.objects.iter().enumerate() {
        of_rust(
            &mut expected,
            &format!("object{at}"),
            of(&table, "Object"),
            &table,
            object,
        );
    }
    plane(&mut expected, "label", view.labels, |label| {
        label.to_string()
    });
    let mut told = objects::loans(&own);
    let args = [own.root().as_os_str(), "objects".as_ref()];
    readers.compare(&args, message, &expected, || {
        objects::publish(&mut told, message);
    });
}
