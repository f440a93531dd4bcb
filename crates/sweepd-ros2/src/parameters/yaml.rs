//! YAML, and the values in it: text that parameters take for what they are.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::options::{DuplicateKeyPolicy, NonFiniteFloatPolicy};
use serde_saphyr::{Location, Spanned, UserMessageFormatter};
use sweepd_messages::rcl::Value;

use crate::EX_CONFIG;

/// The key above the parameters of a node.
const SECTION: &str = "ros__parameters";

/// Parameters that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {what}")]
pub struct ParameterError {
    /// The file and the line, or the argument.
    pub(super) place: String,
    pub(super) what: String,
    /// The exit code of the program.
    pub exit: u8,
}

/// A value of YAML. Scalars are text: each parameter knows what it may be.
#[derive(Clone, Debug)]
pub(super) enum Tree {
    Scalar(String),
    List(Vec<Spanned<Tree>>),
    Map(Vec<(Spanned<String>, Spanned<Tree>)>),
}

impl<'de> Deserialize<'de> for Tree {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AnyTree;

        impl<'de> Visitor<'de> for AnyTree {
            type Value = Tree;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a value, a list or a map")
            }

            fn visit_unit<E>(self) -> Result<Tree, E> {
                Ok(Tree::Scalar(String::new()))
            }

            fn visit_bool<E>(self, value: bool) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_string()))
            }

            fn visit_str<E>(self, value: &str) -> Result<Tree, E> {
                Ok(Tree::Scalar(value.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Tree, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = seq.next_element()? {
                    values.push(value);
                }
                Ok(Tree::List(values))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Tree, A::Error> {
                let mut pairs = Vec::new();
                while let Some(key) = map.next_key()? {
                    pairs.push((key, map.next_value()?));
                }
                Ok(Tree::Map(pairs))
            }
        }

        deserializer.deserialize_any(AnyTree)
    }
}

/// A value as it would stand in a file.
pub(super) fn tree(value: &Value) -> Spanned<Tree> {
    fn scalar(value: impl ToString) -> Spanned<Tree> {
        spanned(Tree::Scalar(value.to_string()))
    }
    fn spanned(tree: Tree) -> Spanned<Tree> {
        Spanned::new(tree, Location::UNKNOWN, Location::UNKNOWN)
    }
    fn list(values: &[impl ToString]) -> Spanned<Tree> {
        spanned(Tree::List(
            values
                .iter()
                .map(|value| scalar(value.to_string()))
                .collect(),
        ))
    }
    match value {
        Value::NotSet => scalar(""),
        Value::Bool(value) => scalar(value),
        Value::Integer(value) => scalar(value),
        Value::Double(value) => scalar(value),
        Value::Text(value) => scalar(value),
        Value::Bytes(values) => list(values),
        Value::Bools(values) => list(values),
        Value::Integers(values) => list(values),
        Value::Doubles(values) => list(values),
        Value::Texts(values) => list(values),
    }
}

/// A line of a file, or an argument, which is one line.
pub(super) fn place(file: &str, location: Location) -> String {
    match file.starts_with("-p ") {
        true => file.to_owned(),
        false => format!("{file}:{}", location.line().max(1)),
    }
}

pub(super) fn text(value: &Spanned<Tree>) -> Result<String, String> {
    match &value.value {
        Tree::Scalar(text) => Ok(text.clone()),
        _ => Err("expected one value".to_owned()),
    }
}

/// A text; nothing where it is empty.
pub(super) fn optional(value: &Spanned<Tree>) -> Result<Option<String>, String> {
    Ok(Some(text(value)?).filter(|text| !text.is_empty()))
}

pub(super) fn texts(value: &Spanned<Tree>) -> Result<Vec<String>, String> {
    match &value.value {
        Tree::List(values) => values.iter().map(text).collect(),
        _ => Err("expected a list, `[a, b]`".to_owned()),
    }
}

/// The words are those of YAML 1.1, as in ROS.
pub(super) fn switch(value: &Spanned<Tree>) -> Result<bool, String> {
    match &text(value)?.to_ascii_lowercase()[..] {
        "true" | "yes" | "y" | "on" => Ok(true),
        "false" | "no" | "n" | "off" => Ok(false),
        other => Err(format!("expected true or false, not `{other}`")),
    }
}

pub(super) fn number<T: FromStr>(value: &Spanned<Tree>) -> Result<T, String> {
    let text = text(value)?;
    let number = text.parse();
    number.map_err(|_| format!("expected a whole number from 0 on, not `{text}`"))
}

pub(super) fn choice<T: Copy>(value: &Spanned<Tree>, choices: &[(&str, T)]) -> Result<T, String> {
    let text = text(value)?;
    if let Some((_, choice)) = choices.iter().find(|(name, _)| *name == text) {
        return Ok(*choice);
    }
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
    Err(format!("expected {}, not `{text}`", names.join(" or ")))
}

/// Finds the sections with parameters, and the names of the nodes that they are for.
pub(super) fn find_sections<'a>(
    tree: &'a Spanned<Tree>,
    name: &str,
    file: &str,
    found: &mut Vec<(String, &'a Spanned<Tree>)>,
) -> Result<(), ParameterError> {
    let wrong = |location, what| {
        let place = place(file, location);
        Err(ParameterError {
            place,
            what,
            exit: EX_CONFIG,
        })
    };
    let Tree::Map(pairs) = &tree.value else {
        return match &tree.value {
            // All of the file is comments.
            Tree::Scalar(text) if text.is_empty() && name.is_empty() => Ok(()),
            _ => wrong(
                tree.referenced,
                format!("no `{SECTION}`: a file begins with `/**:`, and below it `{SECTION}:`"),
            ),
        };
    };
    for (key, value) in pairs {
        let below = format!("{name}/{}", key.value.trim_start_matches('/'));
        match (&key.value[..], &value.value) {
            (SECTION, Tree::Map(_)) => found.push((name.to_owned(), value)),
            (SECTION, Tree::Scalar(text)) if text.is_empty() => {
                found.push((name.to_owned(), value))
            }
            (SECTION, _) => {
                return wrong(
                    value.referenced,
                    "expected parameters, `name: value`".to_owned(),
                );
            }
            _ => find_sections(value, &below, file, found)?,
        }
    }
    Ok(())
}

/// Whether a section's name means the node: `*` is one token, `**` any number of them.
pub(super) fn names(section: &str, node: &str) -> bool {
    fn fit(section: &[&str], node: &[&str]) -> bool {
        match (section, node) {
            (["**", rest @ ..], _) => (0..=node.len()).any(|skipped| fit(rest, &node[skipped..])),
            ([token, rest @ ..], [own, others @ ..]) => {
                (*token == "*" || token == own) && fit(rest, others)
            }
            (rest, others) => rest.is_empty() && others.is_empty(),
        }
    }
    let tokens = |name| str::split(name, '/').filter(|token: &&str| !token.is_empty());
    let (mut section, node): (Vec<&str>, Vec<&str>) =
        (tokens(section).collect(), tokens(node).collect());
    // Many mean what one means, and would be many calls within each other.
    section.dedup_by(|one, before| *one == "**" && *before == "**");
    fit(&section, &node)
}

pub(super) fn read_tree(text: &str, file: &str) -> Result<Spanned<Tree>, ParameterError> {
    let options = serde_saphyr::options! {
        // Or the field `y` would be read as yes.
        strict_booleans: true,
        // As in ROS, where files have parameters of other nodes, too.
        duplicate_keys: DuplicateKeyPolicy::LastWins,
        non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
    };
    serde_saphyr::from_str_with_options(text, options).map_err(|error: serde_saphyr::Error| {
        let message = error
            .without_snippet()
            .render_with_formatter(&UserMessageFormatter);
        let message = message.lines().next().unwrap_or_default();
        let what = message
            .rsplit_once(" at line ")
            .map_or(message, |(what, _)| what);
        ParameterError {
            place: place(file, error.location().unwrap_or(Location::UNKNOWN)),
            what: what.to_owned(),
            exit: EX_CONFIG,
        }
    })
}
