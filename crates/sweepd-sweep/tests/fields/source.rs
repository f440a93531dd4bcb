//! The table of fields, read from the Rust source that defines them.
//!
//! A struct with `repr(C)` gives its fields; an enum, a module and some constants give numbers with
//! names. Of a doc comment the first paragraph counts.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::Path;

use sweepd_sweep::Model;
use syn::{Attribute, BinOp, Expr, ExprLit, Ident, Item, ItemStruct, Lit, Type};

/// The sources, from the root of the project, and what their contents belong to.
const SOURCES: [(&str, Topic); 4] = [
    ("crates/sweepd-client/src/service.rs", Topic::Sharing),
    ("crates/sweepd-sweep/src/layout.rs", Topic::Sweep),
    ("crates/sweepd-sweep/src/sensor.rs", Topic::Sweep),
    ("crates/sweepd-sweep/src/objects.rs", Topic::Objects),
];

/// Groups of numbers, and what stands before the names of their numbers in other languages.
const PREFIXES: [(&str, &str); 14] = [
    ("constant", ""),
    ("label", ""),
    ("flags", ""),
    ("segment_flags", "SEGMENT_"),
    ("TimeSource", "TIME_"),
    ("ReturnMode", "MODE_"),
    ("ReturnChoice", "CHOICE_"),
    ("Model", "MODEL_"),
    ("ColumnStatus", "COLUMN_"),
    ("ReturnKind", "KIND_"),
    ("Part", "PART_"),
    ("objects::constant", ""),
    ("objects::flags", "OBJECTS_"),
    ("objects::why", "WHY_"),
];

/// Constants outside of modules, and their groups. Other languages do not have the rest.
const CONSTANTS: [(&str, &str); 9] = [
    ("MAGIC", "constant"),
    ("LAYOUT_VERSION", "constant"),
    ("ALIGN", "constant"),
    ("LABEL_NONE", "label"),
    ("LABEL_GROUND", "label"),
    ("LABEL_FIRST_SEGMENT", "label"),
    ("SECOND_BLOCKS", "ReturnKind"),
    ("OBJECTS_MAGIC", "objects::constant"),
    ("OBJECTS_VERSION", "objects::constant"),
];

/// What bytes are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    Sweep,
    Objects,
    Sharing,
}

/// All of it.
#[derive(Default)]
pub struct Table {
    pub structs: Vec<Struct>,
    pub groups: Vec<Group>,
    /// Whole numbers by the names of their constants: some are lengths of arrays.
    constants: BTreeMap<String, u64>,
}

pub struct Struct {
    pub name: String,
    pub topic: Topic,
    pub bytes: usize,
    pub fields: Vec<Field>,
}

pub struct Field {
    pub name: String,
    pub kind: Kind,
    pub offset: usize,
    pub bytes: usize,
    pub doc: String,
}

/// A number, an array of numbers, or a struct.
pub struct Kind {
    pub element: String,
    pub count: Option<usize>,
}

/// Numbers that belong together.
pub struct Group {
    /// `objects::` stands before the name of a group of objects.
    pub key: String,
    pub topic: Topic,
    pub prefix: &'static str,
    pub doc: String,
    pub numbers: Vec<Number>,
}

/// A number with a name, or the magic bytes.
pub struct Number {
    rust_name: String,
    /// Its name in other languages.
    pub name: String,
    /// As a literal: in hexadecimal where it stands so in the source; magic bytes in quotes.
    pub text: String,
    pub doc: String,
}

impl Field {
    fn reserved(kind: Kind, offset: usize, bytes: usize) -> Self {
        Self {
            name: "reserved".to_owned(),
            kind,
            offset,
            bytes,
            doc: "0.".to_owned(),
        }
    }

    pub fn is_reserved(&self) -> bool {
        self.name == "reserved"
    }

    /// Whether it is text and not just bytes.
    pub fn is_text(&self) -> bool {
        self.kind.element == "u8" && self.kind.count == Some(64)
    }

    /// Its name where each field must have another.
    pub fn unique_name(&self) -> String {
        match self.is_reserved() {
            true => format!("reserved_{}", self.offset),
            false => self.name.clone(),
        }
    }
}

impl Struct {
    /// Its name in languages where names have underscores.
    pub fn snake_name(&self) -> String {
        let mut name = String::new();
        for letter in self.name.trim_end_matches("Row").chars() {
            if letter.is_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(letter.to_ascii_lowercase());
        }
        name
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.count {
            Some(count) => write!(f, "{}[{count}]", self.element),
            None => f.write_str(&self.element),
        }
    }
}

impl Table {
    /// The table of the project.
    pub fn read(root: &Path) -> Self {
        let mut table = Self::default();
        for (path, topic) in SOURCES {
            table.add(&fs::read_to_string(root.join(path)).unwrap(), topic);
        }
        table
    }

    /// Adds what a source has.
    pub fn add(&mut self, source: &str, topic: Topic) {
        for item in syn::parse_file(source).unwrap().items {
            match item {
                Item::Struct(item) => self.add_struct(&item, topic),
                _ if topic == Topic::Sharing => {}
                Item::Const(item) => {
                    let name = item.ident.to_string();
                    if let Some(value) = self.value(&item.expr) {
                        self.constants.insert(name.clone(), value);
                    }
                    if let Some((_, key)) = CONSTANTS.iter().find(|(known, _)| *known == name) {
                        let doc = match *key {
                            "label" => "Labels of a pixel; segments count from the last one on.",
                            "constant" => "What all sweeps have in common.",
                            _ => "What all messages of objects have in common.",
                        };
                        self.group(key, topic, doc.to_owned());
                        self.add_number(key, &item.ident, Some(&item.expr), &item.attrs);
                    }
                }
                Item::Enum(item) => {
                    let key = item.ident.to_string();
                    self.group(&key, topic, doc(&item.attrs, &key));
                    for one in &item.variants {
                        let value = one.discriminant.as_ref().map(|(_, value)| value);
                        self.add_number(&key, &one.ident, value, &one.attrs);
                    }
                }
                Item::Mod(item) if !item.attrs.iter().any(|one| one.path().is_ident("cfg")) => {
                    let of = if topic == Topic::Objects {
                        "objects::"
                    } else {
                        ""
                    };
                    let key = format!("{of}{}", item.ident);
                    for one in item.content.iter().flat_map(|(_, items)| items) {
                        let Item::Const(one) = one else {
                            panic!("{key}: holds more than constants");
                        };
                        self.group(&key, topic, doc(&item.attrs, &key));
                        self.add_number(&key, &one.ident, Some(&one.expr), &one.attrs);
                    }
                }
                _ => {}
            }
        }
    }

    fn add_struct(&mut self, item: &ItemStruct, topic: Topic) {
        let attributes = item.attrs.iter().filter(|one| one.path().is_ident("repr"));
        let list = attributes.map(|one| one.meta.require_list().unwrap().tokens.to_string());
        let list: Vec<String> = list.map(|one| one.replace(' ', "")).collect();
        if !list.iter().any(|one| one == "C") {
            return;
        }
        let (name, mut fields, mut offset) = (item.ident.to_string(), Vec::new(), 0);
        for field in &item.fields {
            let field_name = field.ident.as_ref().unwrap().to_string();
            let place = format!("{name}::{field_name}");
            // The types are `IntoBytes`: there is no padding between their fields.
            let (kind, bytes) = self.kind(&field.ty, &place);
            fields.push(match field_name.trim_start_matches('_') {
                reserved if reserved.starts_with("reserved") => {
                    Field::reserved(kind, offset, bytes)
                }
                _ => Field {
                    doc: doc(&field.attrs, &place),
                    name: field_name,
                    ..Field::reserved(kind, offset, bytes)
                },
            });
            offset += bytes;
        }
        let mut align = list
            .iter()
            .filter_map(|one| one.strip_prefix("align(")?.strip_suffix(')'));
        let align = align.next().map_or(1, |align| align.parse().unwrap());
        let bytes = offset.next_multiple_of(align);
        if bytes > offset {
            let (element, count) = ("u8".to_owned(), Some(bytes - offset));
            fields.push(Field::reserved(
                Kind { element, count },
                offset,
                bytes - offset,
            ));
        }
        self.structs.push(Struct {
            name,
            topic,
            bytes,
            fields,
        });
    }

    /// A type and its bytes.
    fn kind(&self, of: &Type, place: &str) -> (Kind, usize) {
        let (element, count) = match of {
            Type::Array(array) => {
                let count = self.value(&array.len);
                let count = count.unwrap_or_else(|| panic!("{place}: its length is not known"));
                (&*array.elem, Some(count as usize))
            }
            _ => (of, None),
        };
        let element = match element {
            Type::Path(path) => path.path.get_ident().map(Ident::to_string),
            _ => None,
        };
        let element = element.unwrap_or_default();
        let known = self.structs.iter().find(|of| of.name == element);
        let bytes = match &element[..] {
            "u8" => 1,
            "u16" => 2,
            "u32" | "i32" | "f32" => 4,
            "u64" | "i64" => 8,
            _ => {
                known
                    .unwrap_or_else(|| panic!("{place}: its type is not known"))
                    .bytes
            }
        };
        (Kind { element, count }, bytes * count.unwrap_or(1))
    }

    /// The number that an expression is.
    fn value(&self, expression: &Expr) -> Option<u64> {
        match expression {
            Expr::Lit(ExprLit {
                lit: Lit::Int(number),
                ..
            }) => number.base10_parse().ok(),
            Expr::Path(path) => self
                .constants
                .get(&path.path.get_ident()?.to_string())
                .copied(),
            Expr::Binary(shift) if matches!(shift.op, BinOp::Shl(_)) => {
                Some(self.value(&shift.left)? << self.value(&shift.right)?)
            }
            _ => None,
        }
    }

    /// An expression as the literal that stands for it in other languages.
    fn text(&self, expression: &Expr) -> Option<String> {
        if let Expr::Lit(ExprLit {
            lit: Lit::Int(number),
            ..
        }) = expression
        {
            return Some(number.to_string());
        }
        if let Expr::Unary(unary) = expression
            && let Expr::Lit(literal) = &*unary.expr
            && let Lit::ByteStr(bytes) = &literal.lit
        {
            return Some(format!("\"{}\"", bytes.value().escape_ascii()));
        }
        self.value(expression).map(|value| value.to_string())
    }

    /// Makes sure that there is a group.
    fn group(&mut self, key: &str, topic: Topic, doc: String) {
        let found = PREFIXES.iter().find(|(known, _)| *known == key);
        let (_, prefix) = found.unwrap_or_else(|| panic!("{key}: it is not in PREFIXES"));
        if !self.groups.iter().any(|group| group.key == key) {
            self.groups.push(Group {
                key: key.to_owned(),
                topic,
                prefix,
                doc,
                numbers: Vec::new(),
            });
        }
    }

    fn add_number(
        &mut self,
        key: &str,
        name: &Ident,
        value: Option<&Expr>,
        attributes: &[Attribute],
    ) {
        let rust_name = name.to_string();
        let place = format!("{key}::{rust_name}");
        // The code of a model is not its number in Rust.
        let mut models = Model::ALL.into_iter();
        let model = models.find(|model| key == "Model" && format!("{model:?}") == rust_name);
        let (word, text) = match model {
            Some(model) => (
                model.flag().replace('-', "_"),
                Some(model.code().to_string()),
            ),
            None => (rust_name.clone(), value.and_then(|value| self.text(value))),
        };
        let text = text.unwrap_or_else(|| panic!("{place}: its value is not known"));
        let groups = &mut self.groups;
        let group = groups.iter_mut().find(|group| group.key == key).unwrap();
        group.numbers.push(Number {
            rust_name,
            name: format!("{}{}", group.prefix, word.to_uppercase()),
            text,
            doc: doc(attributes, &place),
        });
    }

    /// A doc comment with each link to an item in the words of other languages, between back quotes.
    pub fn linked(&self, doc: &str) -> String {
        let mut parts = doc.split("[`");
        let mut linked = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (path, behind) = part.split_once("`]").unwrap();
            let behind = match behind.strip_prefix('(') {
                Some(target) => target.split_once(')').unwrap().1,
                None => behind,
            };
            let segments: Vec<&str> = path.rsplit("::").collect();
            let name = self.number_name(&segments).unwrap_or(segments[0]);
            linked += &format!("`{name}`{behind}");
        }
        linked
    }

    /// The name of a number by the last segments of its path, the last one first.
    fn number_name(&self, segments: &[&str]) -> Option<&str> {
        let groups = self.groups.iter();
        let groups = groups.filter(|it| segments.get(1).is_none_or(|of| it.key.ends_with(of)));
        let mut numbers = groups.flat_map(|group| &group.numbers);
        let number = numbers.find(|number| number.rust_name == segments[0]);
        number.map(|number| &number.name[..])
    }

    /// What comes before the first colon, semicolon or point, in lower case: a comment of a line.
    pub fn clause(&self, doc: &str) -> String {
        let doc = self.linked(doc).replace('`', "");
        let end = [": ", "; ", ". "]
            .iter()
            .filter_map(|mark| doc.find(mark))
            .min();
        begun_small(doc[..end.unwrap_or(doc.len())].trim_end_matches('.'))
    }

    /// The whole, in lower case and without the last point: a cell of a table.
    pub fn cell(&self, doc: &str) -> String {
        begun_small(self.linked(doc).trim_end_matches('.'))
    }
}

/// A text whose first letter is small, unless it begins with a name or an abbreviation.
fn begun_small(text: &str) -> String {
    let mut words = text.split(' ');
    let (first, second) = (
        words.next().unwrap_or_default(),
        words.next().unwrap_or_default(),
    );
    let is_name =
        first.chars().skip(1).any(char::is_uppercase) || second.starts_with(char::is_uppercase);
    match text.chars().next() {
        Some(first) if !is_name => first.to_lowercase().to_string() + &text[first.len_utf8()..],
        _ => text.to_owned(),
    }
}

/// The first paragraph of a doc comment.
fn doc(attributes: &[Attribute], place: &str) -> String {
    let mut lines = Vec::new();
    for attribute in attributes {
        if let Ok(meta) = attribute.meta.require_name_value()
            && meta.path.is_ident("doc")
            && let Expr::Lit(literal) = &meta.value
            && let Lit::Str(line) = &literal.lit
        {
            lines.push(line.value().trim().to_owned());
        }
    }
    let end = lines.iter().position(String::is_empty);
    lines.truncate(end.unwrap_or(lines.len()));
    assert!(!lines.is_empty(), "{place}: it has no doc comment");
    lines.join(" ")
}
