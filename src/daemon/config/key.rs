//! A row of the tables of [`keys`](super::keys): all that the daemon knows of a key of its file.

use std::ops::{Range, RangeInclusive};
use std::path::{Path, PathBuf};

use toml::de::DeValue;

use super::error::Problem;
use sweepd_core::assemble::{BodyBox, BodyBoxError};

/// A table of the file, whose keys set a `C`.
pub struct Table<C: 'static> {
    /// Its name in the table around it; empty where it is the file, or a sensor.
    pub name: &'static str,
    /// Its comment in the example, line by line.
    pub doc: &'static [&'static str],
    /// Its header in the example, behind `#` where the table is optional.
    pub header: &'static str,
    /// Its keys, in the order of the example.
    pub keys: &'static [Key<C>],
}

/// A key.
pub struct Key<C: 'static> {
    /// Its name in its table.
    pub name: &'static str,
    /// The lines of its comment in the example; an empty one is a blank line there.
    pub doc: &'static [&'static str],
    /// The default, or another value that it may have, as it is written.
    pub example: &'static str,
    /// How its value is written, and where it is set.
    pub form: Form<C>,
    /// What a reload compares; nothing where another key's rule does.
    pub rules: &'static [ReloadRule<C>],
}

/// A word, and what it sets.
pub type Word<C> = (&'static str, fn(&mut C));

/// The type of a value, its limits, and where it is set.
pub enum Form<C: 'static> {
    /// True or false.
    Flag(fn(&mut C, bool)),
    /// A whole number.
    Whole(RangeInclusive<i64>, fn(&mut C, i64)),
    /// A number, with a fraction or without, and its unit.
    Number(RangeInclusive<f64>, &'static str, fn(&mut C, f64)),
    /// One of several words.
    Words(&'static [Word<C>]),
    /// A text with a meaning.
    Text(fn(&mut C, &str) -> Result<(), Refusal>),
    /// The same, which must be there.
    Required(fn(&mut C, &str) -> Result<(), Refusal>),
    /// A path, relative to the folder of the configuration.
    Path(fn(&mut C, PathBuf)),
    /// A file, which is read when all other keys are set.
    File(fn(&mut C, &Path) -> Result<(), String>),
    /// The same, or a table of it and whether what it shows is removed:
    /// `{ image = PATH, remove = true }`.
    Image(fn(&mut C, &Path) -> Result<(), String>, fn(&mut C, bool)),
    /// Boxes, six numbers each.
    Boxes(fn(&mut C, Vec<BodyBox>)),
    /// A number of the segmenter: `SETTINGS` has its row.
    Segmenter,
}

/// Why a value cannot be meant.
pub struct Refusal {
    /// What is wrong; `None` says that the key cannot be this.
    pub title: Option<String>,
    /// What was expected.
    pub expected: String,
    /// What to do.
    pub cure: Option<String>,
}

impl<T: Into<String>> From<T> for Refusal {
    fn from(expected: T) -> Self {
        Self {
            title: None,
            expected: expected.into(),
            cure: None,
        }
    }
}

/// What is wrong with a value.
pub enum Wrong {
    /// It has another type than this.
    Type(&'static str),
    /// It is none of these words.
    Word(Vec<&'static str>),
    /// It is shown so, and cannot be meant.
    Value(String, Refusal),
}

/// What a change of a setting takes, in the order in which changes are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Takes {
    /// A restart.
    Restart,
    /// A restart, since it makes another sensor of this one.
    OtherSensor,
    /// A reload, or a restart where another sensor does: it was checked for that one.
    WithSensor,
    /// A reload.
    Reload,
}

/// A setting: how it is called, shown and compared, and what a change of it takes.
pub struct ReloadRule<C> {
    pub name: &'static str,
    pub takes: Takes,
    pub show: fn(&C) -> String,
    pub is_same: fn(&C, &C) -> bool,
    /// Sets the first to what the second has.
    pub take: fn(&mut C, &C),
}

impl<C> Form<C> {
    /// Sets a value, or says why not. A file is not read yet.
    pub fn set(&self, to: &mut C, value: &DeValue<'_>, folder: &Path) -> Result<(), Wrong> {
        match self {
            Self::Flag(set) => set(to, value.as_bool().ok_or(Wrong::Type("a boolean"))?),
            Self::Whole(range, set) => {
                let number = whole(value).ok_or(Wrong::Type("a whole number"))?;
                set(to, within(range, number, "")?);
            }
            Self::Number(range, unit, set) => {
                let number = number(value).ok_or(Wrong::Type("a number"))?;
                set(to, within(range, number, &format!(" {unit}"))?);
            }
            Self::Words(words) => {
                let text = text(value)?;
                let word = words.iter().find(|(word, _)| *word == text);
                let names = || Wrong::Word(words.iter().map(|(word, _)| *word).collect());
                word.ok_or_else(names)?.1(to);
            }
            Self::Text(set) | Self::Required(set) => {
                let text = text(value)?;
                set(to, text).map_err(|refusal| Wrong::Value(format!("{text:?}"), refusal))?;
            }
            Self::Path(set) => set(to, path(value, folder)?),
            Self::File(_) | Self::Image(..) => drop(path(value, folder)?),
            Self::Boxes(set) => set(to, boxes(value)?),
            Self::Segmenter => {}
        }
        Ok(())
    }
}

fn text<'a>(value: &'a DeValue<'_>) -> Result<&'a str, Wrong> {
    value.as_str().ok_or(Wrong::Type("a string"))
}

/// A path, brought to the folder of the configuration where it is relative.
pub fn path(value: &DeValue<'_>, folder: &Path) -> Result<PathBuf, Wrong> {
    let text = text(value)?;
    if text.is_empty() || text.contains(char::is_control) {
        return Err(Wrong::Value(format!("{text:?}"), "expected a path".into()));
    }
    Ok(folder.join(text))
}

/// The boxes that are written: `[[-0.4, -0.6, 0, 0.4, 0.5, 1.2]]`.
fn boxes(value: &DeValue<'_>) -> Result<Vec<BodyBox>, Wrong> {
    let wrong_type = || Wrong::Type("a list of boxes, each a list of six numbers");
    let mut boxes = Vec::new();
    for one in value.as_array().ok_or_else(wrong_type)?.iter() {
        let mut corners = Vec::new();
        for one in one.get_ref().as_array().ok_or_else(wrong_type)?.iter() {
            corners.push(number(one.get_ref()).ok_or_else(wrong_type)?);
        }
        let shown = format!("{corners:?}");
        let corners = corners.try_into().map_err(|_| wrong_type())?;
        let refused = |error: BodyBoxError| Wrong::Value(shown, error.to_string().into());
        boxes.push(BodyBox::new(corners).map_err(refused)?);
    }
    Ok(boxes)
}

/// The whole number that is written.
pub fn whole(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// The number that is written; it is infinite only if it is written so.
pub fn number(value: &DeValue<'_>) -> Option<f64> {
    let DeValue::Float(float) = value else {
        return whole(value).map(|number| number as f64);
    };
    let number: f64 = float.as_str().parse().ok()?;
    (!number.is_infinite() || float.as_str().contains("inf")).then_some(number)
}

fn within<T: PartialOrd + ToString>(
    range: &RangeInclusive<T>,
    value: T,
    unit: &str,
) -> Result<T, Wrong> {
    if range.contains(&value) {
        return Ok(value);
    }
    let (least, most) = (range.start().to_string(), range.end().to_string());
    let expected = format!("expected {least} to {most}{unit}");
    Err(Wrong::Value(value.to_string(), expected.into()))
}

impl<C> Table<C> {
    /// Its part of the example.
    pub fn example(&self) -> String {
        let mut text = comment(self.doc);
        if !self.header.is_empty() {
            text += &format!("{}\n", self.header);
        }
        for key in self.keys {
            let is_given = matches!(key.form, Form::Required(_)) && !self.header.starts_with('#');
            let mark = if is_given { "" } else { "#" };
            text += &comment(key.doc);
            text += &format!("{mark}{} = {}\n", key.name, key.example);
        }
        text
    }
}

fn comment(lines: &[&str]) -> String {
    let mut text = String::new();
    for line in lines {
        let mark = if line.is_empty() { "" } else { "#" };
        text += &format!("{mark}{line}\n");
    }
    text
}

impl Refusal {
    /// The problem of a key whose value is shown so.
    pub fn problem(self, at: Range<usize>, key: &str, shown: &str) -> Problem {
        let title = self
            .title
            .unwrap_or_else(|| format!("`{key}` cannot be {shown}"));
        Problem {
            cure: self.cure,
            ..Problem::new(at, title, self.expected)
        }
    }
}
