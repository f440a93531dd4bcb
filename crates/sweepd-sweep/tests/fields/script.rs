//! `sweep.js` of the page: numbers and structs of sweeps, and the names of models.

use sweepd_sweep::Model;

use crate::source::{Table, Topic};

/// The one section.
pub fn section(table: &Table) -> String {
    let mut text = String::new();
    let groups = table.groups.iter();
    for group in groups.filter(|group| group.topic == Topic::Sweep && group.key != "Model") {
        text += &format!("// {}\n", table.linked(&group.doc).replace('`', ""));
        for number in &group.numbers {
            text += &format!("export const {} = {};\n", number.name, number.text);
        }
        text += "\n";
    }
    text += "/** The structs of the layout: offset, type and name of each field, and the bytes of the whole. */\n";
    for of in table.structs.iter().filter(|of| of.topic == Topic::Sweep) {
        let name = of.snake_name().to_uppercase();
        text += &format!(
            "export const {name} = {{\n  bytes: {},\n  fields: [\n",
            of.bytes
        );
        for field in of.fields.iter().filter(|field| !field.is_reserved()) {
            text += &format!(
                "    [{}, \"{}\", \"{}\"],\n",
                field.offset, field.kind, field.name
            );
        }
        text += "  ],\n};\n\n";
    }
    let names = Model::ALL
        .map(|model| format!("\"{}\"", model.name()))
        .join(", ");
    text + &format!(
        "/** Models by their code. */\nexport const MODELS = [\n  \"unknown model\", {names},\n];\n"
    )
}
