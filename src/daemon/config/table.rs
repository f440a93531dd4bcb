//! A TOML table read key by key. What is wrong with a key is noted and passed over, so that all of
//! it is found at once.

use std::fmt;
use std::ops::Range;

use serde::de::Unexpected;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::Problem;
use crate::suggest::suggestion;

/// What is wrong with the form of a file.
pub struct FormProblems<'a> {
    /// The file.
    text: &'a str,
    /// Unknown keys, missing keys and wrong types.
    pub problems: Vec<Problem>,
    /// Where something was passed over or stands for a required key: further problems of these
    /// places are no news.
    pub replaced: Vec<Range<usize>>,
    /// What is accepted and does nothing, with its line.
    pub warnings: Vec<String>,
}

impl<'a> FormProblems<'a> {
    /// None so far.
    pub fn new(text: &'a str) -> Self {
        Self {
            text,
            problems: Vec::new(),
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

    /// Notes a value of a wrong type.
    pub fn wrong_type(&mut self, value: &Spanned<DeValue<'_>>, expected: &str) {
        let title = format!("wrong type: {}", Found(value.get_ref()));
        self.add(value.span(), title, format!("expected {expected}"));
    }
}

/// A table whose keys are taken one by one.
pub struct TableReader<'a, 'p, 't> {
    problems: &'p mut FormProblems<'a>,
    table: DeTable<'t>,
    span: Range<usize>,
    /// The keys that were asked for: all that there are.
    known: Vec<&'static str>,
}

impl<'a, 'p, 't> TableReader<'a, 'p, 't> {
    /// Reads a table, or notes that it is none.
    pub fn new(value: Spanned<DeValue<'t>>, problems: &'p mut FormProblems<'a>) -> Option<Self> {
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
    pub fn of(table: Spanned<DeTable<'t>>, problems: &'p mut FormProblems<'a>) -> Self {
        let span = table.span();
        Self {
            problems,
            table: table.into_inner(),
            span,
            known: Vec::new(),
        }
    }

    /// Where problems are noted.
    pub fn problems(&mut self) -> &mut FormProblems<'a> {
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
            let before = self.problems.text.as_bytes().get(..key.span().start);
            let line = 1 + before.map_or(0, |before| {
                before.iter().filter(|&&byte| byte == b'\n').count()
            });
            self.problems
                .warnings
                .push(format!("line {line}: {warning}"));
        }
    }

    /// The table of a key, to be read by `read`.
    pub fn table<T>(
        &mut self,
        key: &'static str,
        read: impl FnOnce(TableReader<'a, '_, 't>) -> T,
    ) -> Option<T> {
        let value = self.take(key)?;
        TableReader::new(value, self.problems).map(read)
    }

    /// The value of a key, if `read` can read it.
    fn value<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        read: impl FnOnce(&DeValue<'t>) -> Option<T>,
    ) -> Option<Spanned<T>> {
        let value = self.take(key)?;
        let read = read(value.get_ref());
        if read.is_none() {
            self.problems.wrong_type(&value, expected);
        }
        read.map(|read| Spanned::new(value.span(), read))
    }

    /// A text.
    pub fn text(&mut self, key: &'static str) -> Option<Spanned<String>> {
        self.value(key, "a string", |value| value.as_str().map(str::to_owned))
    }

    /// A text that must be there. Where it is not, that is noted, and an empty one stands for it.
    pub fn required_text(&mut self, key: &'static str) -> Spanned<String> {
        let written = self.table.get(key).map(Spanned::span);
        if let Some(text) = self.text(key) {
            return text;
        }
        let at = written.unwrap_or_else(|| {
            let title = format!("missing key `{key}`");
            self.problems.add(self.span.clone(), title, String::new());
            self.span.clone()
        });
        Spanned::new(at, String::new())
    }

    /// True or false; false where the key is missing.
    pub fn flag(&mut self, key: &'static str) -> bool {
        let flag = self.value(key, "a boolean", |value| value.as_bool());
        flag.is_some_and(Spanned::into_inner)
    }

    /// A whole number.
    pub fn whole(&mut self, key: &'static str) -> Option<Spanned<i64>> {
        self.value(key, "a whole number", whole)
    }

    /// A number, with a fraction or without.
    pub fn number(&mut self, key: &'static str) -> Option<Spanned<f64>> {
        self.value(key, "a number", |value| match value {
            DeValue::Float(float) => finite_or_written(float.as_str()),
            _ => whole(value).map(|number| number as f64),
        })
    }

    /// One of several words.
    pub fn choice<T: Copy>(
        &mut self,
        key: &'static str,
        choices: &[(&str, T)],
    ) -> Option<Spanned<T>> {
        let word = self.text(key)?;
        let chosen = choices.iter().find(|(name, _)| name == word.get_ref());
        if chosen.is_none() {
            let title = format!("unknown value `{}`", word.get_ref());
            let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
            self.problems.add(word.span(), title, one_of(&names));
        }
        chosen.map(|&(_, value)| Spanned::new(word.span(), value))
    }

    /// Notes all keys that were not asked for.
    pub fn finish(self) {
        for (key, _) in &self.table {
            let title = format!("unknown key `{}`", key.get_ref());
            self.problems.add(key.span(), title, one_of(&self.known));
        }
    }
}

fn whole(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// A number that is infinite only if it is written so.
fn finite_or_written(text: &str) -> Option<f64> {
    let number: f64 = text.parse().ok()?;
    (!number.is_infinite() || text.contains("inf")).then_some(number)
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
