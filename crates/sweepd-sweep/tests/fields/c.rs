//! `examples/sweepd.h`: numbers, structs, and their sizes as the compiler has them.

use crate::source::{Field, Group, Struct, Table};

/// The one section.
pub fn section(table: &Table) -> String {
    let mut text = String::new();
    for group in &table.groups {
        text += &numbers(table, group);
    }
    for of in &table.structs {
        text += &definition(of);
    }
    // No field is behind padding: where the sizes are right, so are all offsets.
    text +=
        "#define SWEEPD_ASSERT(what, name) typedef char sweepd_assert_##name[(what) ? 1 : -1]\n";
    text += "SWEEPD_ASSERT(sizeof(float) == 4 && sizeof(double) == 8, floats);\n";
    for of in &table.structs {
        let name = of.snake_name();
        text += &format!(
            "SWEEPD_ASSERT(sizeof(sweepd_{name}) == {}, {name});\n",
            of.bytes
        );
    }
    text + "#undef SWEEPD_ASSERT\n"
}

fn numbers(table: &Table, group: &Group) -> String {
    let mut text = format!("/* {} */\n", table.linked(&group.doc).replace('`', ""));
    if group.key == "Part" {
        text += "enum sweepd_part {\n";
        for number in &group.numbers {
            text += &format!("    SWEEPD_{},\n", number.name);
        }
        return text + "    SWEEPD_PARTS\n};\n\n";
    }
    for number in &group.numbers {
        let sign = if number.text.starts_with('"') {
            ""
        } else {
            "u"
        };
        let (name, value, clause) = (&number.name, &number.text, table.clause(&number.doc));
        text += &format!("#define SWEEPD_{name} {value}{sign} /* {clause} */\n");
    }
    text + "\n"
}

fn definition(of: &Struct) -> String {
    let name = of.snake_name();
    let mut text = format!("typedef struct sweepd_{name} {{\n");
    for field in &of.fields {
        let count = match field.kind.count {
            None => String::new(),
            Some(_) if field.name == "offsets" => "[SWEEPD_PARTS]".to_owned(),
            Some(count) => format!("[{count}]"),
        };
        text += &format!("    {} {}{count};\n", kind(field), field.unique_name());
    }
    text + &format!("}} sweepd_{name};\n\n")
}

fn kind(field: &Field) -> String {
    match &field.kind.element[..] {
        "u8" if field.is_text() => "char".to_owned(),
        "f32" => "float".to_owned(),
        element if element.starts_with('u') => format!("uint{}_t", &element[1..]),
        element if element.starts_with('i') => format!("int{}_t", &element[1..]),
        of => format!("sweepd_{}", of.to_lowercase()),
    }
}
