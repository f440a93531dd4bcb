//! `python/src/sweepd/layout.py`: numbers and dtypes.

use crate::source::{Field, Struct, Table, Topic};

/// Columns of a line.
const WIDTH: usize = 120;

/// All of it.
pub fn section(table: &Table) -> String {
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
