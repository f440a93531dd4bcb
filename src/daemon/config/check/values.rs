//! Single values: within their limits, or a problem that names these.

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use toml::Spanned;

use super::Check;

impl Check<'_> {
    /// A number within `range`.
    pub(super) fn number(
        &mut self,
        key: &str,
        given: &Option<Spanned<f64>>,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Option<f64> {
        let given = given.as_ref()?;
        let value = *given.get_ref();
        if range.contains(&value) {
            return Some(value);
        }
        let expected = format!("expected {} to {} {unit}", range.start(), range.end());
        self.problem(given.span(), format!("`{key}` cannot be {value}"), expected);
        None
    }

    /// A whole number within `range`, all of which `T` holds.
    pub(super) fn whole<T: TryFrom<i64>>(
        &mut self,
        key: &str,
        given: &Option<Spanned<i64>>,
        range: RangeInclusive<i64>,
    ) -> Option<T> {
        let given = given.as_ref()?;
        let value = *given.get_ref();
        if range.contains(&value)
            && let Ok(value) = T::try_from(value)
        {
            return Some(value);
        }
        let expected = format!("expected {} to {}", range.start(), range.end());
        self.problem(given.span(), format!("`{key}` cannot be {value}"), expected);
        None
    }

    /// A text that says a value of which `holds`.
    pub(super) fn text<T: FromStr>(
        &mut self,
        key: &str,
        given: &Option<Spanned<String>>,
        expected: &str,
        holds: impl Fn(&T) -> bool,
    ) -> Option<T> {
        let given = given.as_ref()?;
        let value = given.get_ref().parse().ok().filter(holds);
        if value.is_none() {
            let title = format!("`{key}` cannot be {:?}", given.get_ref());
            self.problem(given.span(), title, format!("expected {expected}"));
        }
        value
    }

    /// A path, brought to the folder of the configuration where it is relative.
    pub(super) fn path(&mut self, key: &str, given: &Option<Spanned<String>>) -> Option<PathBuf> {
        let given = given.as_ref()?;
        let text = given.get_ref();
        if text.is_empty() || text.contains(char::is_control) {
            self.problem(
                given.span(),
                format!("`{key}` cannot be {text:?}"),
                "expected a path",
            );
            return None;
        }
        Some(self.folder.join(text))
    }
}
