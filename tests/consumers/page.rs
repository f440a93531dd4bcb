//! `docs/layout.md` against the Rust types: its tables are read and compared.

use std::collections::BTreeMap;

use sweepd::sweep::layout::{Column, HOST_FIELDS, Header, TimeSource};
use zerocopy::{FromBytes, IntoBytes};

use super::fields::{Field, numbers, structs};
use super::of_project;

/// The rows of the tables below each heading, cell by cell, without their back quotes.
fn tables() -> BTreeMap<String, Vec<Vec<String>>> {
    let page = std::fs::read_to_string(of_project("docs/layout.md")).unwrap();
    let mut tables: BTreeMap<String, Vec<Vec<String>>> = BTreeMap::new();
    let mut heading = String::new();
    for line in page.lines() {
        if let Some(title) = line
            .trim_start_matches('#')
            .strip_prefix(' ')
            .filter(|_| line.starts_with('#'))
        {
            heading = title
                .split(['`', ':'])
                .find(|part| !part.trim().is_empty())
                .unwrap()
                .trim()
                .to_owned();
        }
        let Some(row) = line
            .strip_prefix("| ")
            .and_then(|row| row.strip_suffix(" |"))
        else {
            continue;
        };
        let cells = row
            .split(" | ")
            .map(|cell| cell.trim().trim_matches('`').to_owned());
        tables
            .entry(heading.clone())
            .or_default()
            .push(cells.collect());
    }
    tables
}

fn bytes_of(kind: &str) -> usize {
    if let Some(of) = structs().iter().find(|of| of.name == kind) {
        return of.bytes;
    }
    let (element, count) = kind
        .split_once('[')
        .map_or((kind, "1]"), |(element, count)| (element, count));
    let count: usize = count.trim_end_matches(']').parse().unwrap();
    let bits: usize = element[1..].parse().unwrap();
    bits / 8 * count
}

#[test]
fn the_page_has_every_byte_of_every_struct() {
    let tables = tables();
    for of in structs() {
        let rows = tables
            .get(of.name)
            .unwrap_or_else(|| panic!("no table below a heading {}", of.name));
        let mut fields = of.fields.iter().peekable();
        let mut end = 0;
        for row in rows
            .iter()
            .filter(|row| row.len() == 4 && row[0] != "offset")
        {
            let [offset, kind, name, _meaning] = &row[..] else {
                panic!("{}: {row:?}", of.name)
            };
            let place = format!("{}, {name}", of.name);
            assert_eq!(
                offset.parse::<usize>().unwrap(),
                end,
                "{place}: the bytes before"
            );
            end += bytes_of(kind);
            if name == "reserved" {
                continue;
            }
            let field = fields
                .next()
                .unwrap_or_else(|| panic!("{place}: no such field"));
            assert_eq!(
                (name, kind),
                (&field.name.to_owned(), &field.kind),
                "{place}"
            );
            assert_eq!(offset.parse::<usize>().unwrap(), field.offset, "{place}");
        }
        assert_eq!((end, fields.peek()), (of.bytes, None), "{}", of.name);
    }
}

#[test]
fn the_page_has_every_number() {
    let rows: Vec<Vec<String>> = tables()
        .into_values()
        .flatten()
        .filter(|row| row.len() == 3)
        .collect();
    for (name, value) in numbers().into_iter().filter(|(name, _)| *name != "ALIGN") {
        let row = rows
            .iter()
            .find(|row| row[1] == name)
            .unwrap_or_else(|| panic!("{name} is in no table"));
        let said = row[0]
            .strip_prefix("0x")
            .map_or_else(|| row[0].parse(), |hex| u64::from_str_radix(hex, 16));
        assert_eq!(said, Ok(value), "{name}");
    }
}

/// One list in the code: the page names what is on it, and what is masked is what is on it.
#[test]
fn the_page_names_what_depends_on_the_host() {
    let page = std::fs::read_to_string(of_project("docs/layout.md")).unwrap();
    let (_, rest) = page
        .split_once("The same packets give the same sweep, byte for byte, except for the fields that depend on the receiving host:")
        .unwrap();
    let sentence = rest.split(". ").next().unwrap();
    let named: Vec<&str> = sentence.split('`').skip(1).step_by(2).collect();
    assert_eq!(named, HOST_FIELDS);

    let mut header = Header::read_from_bytes(&[0xFF; size_of::<Header>()]).unwrap();
    header.time_source = TimeSource::Host as u32;
    let column = Column::read_from_bytes(&[0xFF; size_of::<Column>()]).unwrap();
    let masked = [
        header.without_host().as_bytes().to_vec(),
        column.without_host().as_bytes().to_vec(),
    ];
    let mut found = Vec::new();
    for (of, bytes) in structs()
        .iter()
        .filter(|of| ["Header", "Column"].contains(&of.name))
        .zip(&masked)
    {
        let is_masked = |field: &&Field| {
            bytes[field.offset..field.offset + field.bytes]
                .iter()
                .all(|&byte| byte == 0)
        };
        found.extend(
            of.fields
                .iter()
                .filter(is_masked)
                .map(|field| field.name)
                .filter(|name| *name != "time_source"),
        );
    }
    let sorted = |mut names: Vec<&'static str>| {
        names.sort_unstable();
        names
    };
    assert_eq!(sorted(found), sorted(HOST_FIELDS.to_vec()));
    header.time_source = TimeSource::Gps as u32;
    assert_eq!(
        header.without_host().time_ns,
        header.time_ns,
        "UTC is the sensor's own"
    );
}
