//! `docs/layout.md`: a table for each struct and for each group of numbers.

use crate::source::{Group, Struct, Table, Topic};

/// The section of a struct or a group.
pub fn section(table: &Table, key: &str) -> Option<String> {
    if let Some(of) = table.structs.iter().find(|of| of.name == key) {
        return Some(of_struct(table, of));
    }
    let group = table.groups.iter().find(|group| group.key == key);
    group.map(|group| of_group(table, group))
}

fn of_struct(table: &Table, of: &Struct) -> String {
    let level = match of.topic {
        Topic::Sweep => "##",
        Topic::Objects | Topic::Sharing => "###",
    };
    let mut page = format!("\n{level} `{}`: {} bytes\n\n", of.name, of.bytes);
    page += "| offset | type | field | meaning |\n|---|---|---|---|\n";
    for field in &of.fields {
        let meaning = table.cell(&field.doc);
        page += &format!(
            "| {} | {} | {} | {meaning} |\n",
            field.offset, field.kind, field.name
        );
    }
    page + "\n"
}

fn of_group(table: &Table, group: &Group) -> String {
    let title = group.key.rsplit("::").next().unwrap_or_default();
    let mut page = format!("\n| value | {title} | meaning |\n|---|---|---|\n");
    for number in &group.numbers {
        let value = match number.text.strip_prefix('"') {
            Some(bytes) => format!("`{}`", bytes.trim_end_matches('"')),
            None => number.text.clone(),
        };
        page += &format!(
            "| {value} | {} | {} |\n",
            number.name,
            table.cell(&number.doc)
        );
    }
    page + "\n"
}
