//! A TOML table read key by key. What is wrong with a key is noted and passed over, so that all of
//! it is found at once.

use std::fmt;
use std::ops::Range;
use std::path::Path;

use serde::de::Unexpected;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::Problem;
use super::key::Wrong;
use super::keys::SENSOR_TABLES;
use crate::suggest::suggestion;

/// What is wrong with a file.
pub struct FileProblems<'a> {
    /// The file.
    text: &'a str,
    /// Its folder.
    pub folder: &'a Path,
    /// Unknown keys, missing keys and wrong types.
    pub problems: Vec<Problem>,
    /// Values that cannot be meant.
    pub values: Vec<Problem>,
    /// Where something was passed over or stands for a required key: further problems of these
    /// places are no news.
    pub replaced: Vec<Range<usize>>,
    /// What is accepted and does nothing, with its line.
    pub warnings: Vec<String>,
}

impl<'a> FileProblems<'a> {
    /// None so far.
    pub fn new(text: &'a str, folder: &'a Path) -> Self {
        Self {
            text,
            folder,
            problems: Vec::new(),
            values: Vec::new(),
            replaced: Vec::new(),
            warnings: Vec::new(),
        }
    }

    fn add(&mut self, at: Range<usize>, title: String, expected: String) {
        let found = self.text.get(at.clone()).unwrap_or_default();
        let cure = suggestion(found, &expected).map(|word| format!("did you mean `{word}`?"));
        self.replaced.push(at.clone());
        self.problems.push(Problem {
            cure,
            ..Problem::new(at, title, expected)
        });
    }

    /// Warns of what is accepted and does nothing, at this byte.
    pub fn warn(&mut self, at: usize, warning: &str) {
        let before = self.text.as_bytes().get(..at).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        self.warnings.push(format!("line {line}: {warning}"));
    }

    /// Notes a value of a wrong type.
    pub fn wrong_type(&mut self, value: &Spanned<DeValue<'_>>, expected: &str) {
        let title = format!("wrong type: {}", Found(value.get_ref()));
        self.add(value.span(), title, format!("expected {expected}"));
    }

    /// Notes what is wrong with the value of a key.
    pub fn wrong(&mut self, key: &str, value: &Spanned<DeValue<'_>>, wrong: Wrong) {
        match wrong {
            Wrong::Type(expected) => self.wrong_type(value, expected),
            Wrong::Word(words) => {
                let text = value.get_ref().as_str().unwrap_or_default();
                self.add(
                    value.span(),
                    format!("unknown value `{text}`"),
                    one_of(&words),
                );
            }
            Wrong::Value(shown, refusal) => {
                self.values.push(refusal.problem(value.span(), key, &shown));
            }
        }
    }
}

/// A table whose keys are taken one by one.
pub struct TableReader<'a, 'p, 't> {
    problems: &'p mut FileProblems<'a>,
    table: DeTable<'t>,
    span: Range<usize>,
    /// The keys that were asked for: all that there are.
    known: Vec<&'static str>,
}

impl<'a, 'p, 't> TableReader<'a, 'p, 't> {
    /// Reads a table, or notes that it is none.
    pub fn new(value: Spanned<DeValue<'t>>, problems: &'p mut FileProblems<'a>) -> Option<Self> {
        let span = value.span();
        match value.into_inner() {
            DeValue::Table(table) => Some(Self::of(Spanned::new(span, table), problems)),
            other => {
                problems.wrong_type(&Spanned::new(span, other), "a table");
                None
            }
        }
    }

    /// Reads a table.
    pub fn of(table: Spanned<DeTable<'t>>, problems: &'p mut FileProblems<'a>) -> Self {
        let span = table.span();
        Self {
            problems,
            table: table.into_inner(),
            span,
            known: Vec::new(),
        }
    }

    /// Where problems are noted.
    pub fn problems(&mut self) -> &mut FileProblems<'a> {
        self.problems
    }

    /// The value of a key as it is written.
    pub fn take(&mut self, key: &'static str) -> Option<Spanned<DeValue<'t>>> {
        self.known.push(key);
        self.table.remove(key)
    }

    /// Passes over a key of an earlier version, with a warning where it is written.
    pub fn removed(&mut self, key: &str, warning: &str) {
        if let Some((key, _)) = self.table.remove_entry(key) {
            self.problems.warn(key.span().start, warning);
        }
    }

    /// The table of a key.
    pub fn table(&mut self, key: &'static str) -> Option<TableReader<'a, '_, 't>> {
        let value = self.take(key)?;
        TableReader::new(value, self.problems)
    }

    /// Where it stands.
    pub fn span(&self) -> Range<usize> {
        self.span.clone()
    }

    /// Notes that a key is missing.
    pub fn missing(&mut self, key: &str) {
        let title = format!("missing key `{key}`");
        self.problems.add(self.span.clone(), title, String::new());
    }

    /// Notes all keys that were not asked for.
    pub fn finish(self) {
        for (key, _) in &self.table {
            let title = format!("unknown key `{}`", key.get_ref());
            self.problems.add(key.span(), title, one_of(&self.known));
            // At the top of a file, what belongs to a sensor.
            let mut tables = SENSOR_TABLES.iter().filter(|table| !table.name.is_empty());
            if self.known.contains(&"sensor")
                && tables.any(|table| table.name == key.get_ref())
                && let Some(problem) = self.problems.problems.last_mut()
            {
                let cure = format!(
                    "write `[sensor.{}]`, below the [[sensor]] that it is of",
                    key.get_ref()
                );
                problem.cure = Some(cure);
            }
        }
    }
}

/// `expected one of `a`, `b``, or in the words for one and two.
fn one_of(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    match &quoted[..] {
        [one] => format!("expected {one}"),
        [one, other] => format!("expected {one} or {other}"),
        _ => format!("expected one of {}", quoted.join(", ")),
    }
}

/// A value in the words of serde, but for tables and lists.
struct Found<'a>(&'a DeValue<'a>);

impl fmt::Display for Found<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            DeValue::String(text) => Unexpected::Str(text).fmt(f),
            DeValue::Integer(number) => write!(f, "integer `{number}`"),
            DeValue::Float(number) => write!(f, "floating point `{number}`"),
            DeValue::Boolean(flag) => Unexpected::Bool(*flag).fmt(f),
            DeValue::Datetime(_) => f.write_str("date"),
            DeValue::Array(_) => f.write_str("list"),
            DeValue::Table(_) => f.write_str("table"),
        }
    }
}
