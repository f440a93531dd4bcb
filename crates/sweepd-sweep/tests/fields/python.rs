//! `python/src/sweepd/layout.py`: numbers, dtypes, and the fields of the preamble for ctypes.

use crate::source::{Field, Struct, Table, Topic};

/// Columns of a line.
const WIDTH: usize = 120;

/// A section by its key.
pub fn section(table: &Table, key: &str) -> Option<String> {
    match key {
        "all" => Some(all(table)),
        _ => table
            .structs
            .iter()
            .find(|of| of.name == key)
            .map(of_ctypes),
    }
}

fn all(table: &Table) -> String {
    let mut text = String::new();
    for group in &table.groups {
        text += &format!("# {}\n", table.linked(&group.doc).replace('`', ""));
        for number in &group.numbers {
            let bytes = if number.text.starts_with('"') {
                "b"
            } else {
                ""
            };
            text += &format!("{} = {bytes}{}\n", number.name, number.text);
        }
        text += "\n";
    }
    for of in table.structs.iter().filter(|of| of.topic != Topic::Sharing) {
        text += &of_numpy(of);
    }
    text
}

fn of_numpy(of: &Struct) -> String {
    let mut text = format!("{} = np.dtype([\n", of.snake_name().to_uppercase());
    let mut line = String::new();
    for field in &of.fields {
        let entry = format!("(\"{}\", {}),", field.unique_name(), dtype(field));
        if line.len() + entry.len() + 5 > WIDTH {
            text += &format!("   {line}\n");
            line.clear();
        }
        line += &format!(" {entry}");
    }
    text + &format!("   {line}\n])  # fmt: skip\n")
}

fn dtype(field: &Field) -> String {
    let element = &field.kind.element;
    let (kind, bits) = element.split_at(1);
    let number = match bits.parse::<usize>() {
        Ok(8) => format!("\"{kind}1\""),
        Ok(bits) => format!("\"<{kind}{}\"", bits / 8),
        Err(_) => element.to_uppercase(),
    };
    match field.kind.count {
        _ if field.is_text() => format!("\"S{}\"", field.bytes),
        Some(_) if element == "u8" => format!("\"V{}\"", field.bytes),
        _ if field.is_reserved() => format!("\"V{}\"", field.bytes),
        Some(count) => format!("{number}, ({count},)"),
        None => number,
    }
}

fn of_ctypes(of: &Struct) -> String {
    let mut text = "    _fields_ = (\n".to_owned();
    for field in &of.fields {
        let kind = match field.kind.element.split_at(1) {
            ("u", bits) => format!("ctypes.c_uint{bits}"),
            ("i", bits) => format!("ctypes.c_int{bits}"),
            _ => panic!("{}: python.rs has no name for {}", field.name, field.kind),
        };
        let count = field
            .kind
            .count
            .map_or(String::new(), |count| format!(" * {count}"));
        text += &format!("        (\"{}\", {kind}{count}),\n", field.unique_name());
    }
    text + "    )\n"
}
