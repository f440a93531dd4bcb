//! `crates/sweepd-tools/src/view/page/sweep.js` against the Rust types. What it makes of sweeps is seen in a browser:
//! tests/view/browser.rs.

use super::fields::{numbers_of_sweeps, structs_of_sweeps};
use super::of_project;

fn script() -> String {
    std::fs::read_to_string(of_project("crates/sweepd-tools/src/view/page/sweep.js")).unwrap()
}

#[test]
fn the_script_has_every_byte_of_every_struct() {
    let script = script();
    for of in structs_of_sweeps() {
        let name = of.c_name.trim_start_matches("sweepd_").to_uppercase();
        let head = format!(
            "export const {name} = {{\n  bytes: {},\n  fields: [\n",
            of.bytes
        );
        let (_, rest) = script
            .split_once(&head)
            .unwrap_or_else(|| panic!("{head} is missing"));
        let (listed, _) = rest.split_once("  ],\n").unwrap();
        let expected: String = of
            .fields
            .iter()
            .map(|field| {
                format!(
                    "    [{}, \"{}\", \"{}\"],\n",
                    field.offset, field.kind, field.name
                )
            })
            .collect();
        assert_eq!(listed, expected, "{name}");
    }
}

#[test]
fn the_script_has_every_number() {
    let script = script();
    for (name, value) in numbers_of_sweeps() {
        let head = format!("export const {name} = ");
        let line = script.lines().find_map(|line| line.strip_prefix(&head));
        let said = line.unwrap_or_else(|| panic!("{name} is missing"));
        let said = said.trim_end_matches(';');
        let number = said
            .strip_prefix("0x")
            .map_or_else(|| said.parse(), |hex| u64::from_str_radix(hex, 16));
        assert_eq!(number, Ok(value), "{name}");
    }
}
