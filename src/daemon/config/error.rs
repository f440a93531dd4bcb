//! What is wrong with a configuration, shown where it is wrong.

use std::fmt;
use std::io;
use std::ops::Range;
use std::path::PathBuf;

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use serde::Serialize;

use crate::text::visible;

/// Why there is no [`Config`](super::Config).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read at all.
    #[error("cannot read the configuration {}: {source}", visible(path.display()))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// What stands in it cannot be meant.
    #[error(transparent)]
    Invalid(#[from] Problems),
}

/// All that is wrong with a file, at least one thing. Shown as rustc shows errors: several lines,
/// each problem with its place, its text underlined, and a cure.
#[derive(Clone, Debug)]
pub struct Problems {
    file: String,
    text: String,
    problems: Vec<Problem>,
}

/// One thing that is wrong.
#[derive(Clone, Debug)]
pub(super) struct Problem {
    /// Where, bytes of the text.
    pub at: Range<usize>,
    /// What.
    pub title: String,
    /// What was expected there, or another word about it; shown under the place.
    pub expected: String,
    /// Another place that has to do with it, and what it is.
    pub other: Option<(Range<usize>, String)>,
    /// What to do.
    pub cure: Option<String>,
}

impl Problem {
    pub fn new(at: Range<usize>, title: impl Into<String>, expected: impl Into<String>) -> Self {
        Self {
            at,
            title: title.into(),
            expected: expected.into(),
            other: None,
            cure: None,
        }
    }

    pub fn with_other(mut self, at: Range<usize>, what: impl Into<String>) -> Self {
        self.other = Some((at, what.into()));
        self
    }

    pub fn with_cure(mut self, cure: impl Into<String>) -> Self {
        self.cure = Some(cure.into());
        self
    }

    /// A slip in the syntax, as the TOML reader found it.
    pub fn of_toml(error: &toml::de::Error) -> Self {
        let at = error.span().unwrap_or(0..0);
        // Its words for `port =` without a value.
        if error.message() == "string values must be quoted, expected literal string"
            && at.is_empty()
        {
            return Self::new(
                at,
                "a value is missing",
                "expected one behind the equals sign",
            );
        }
        match error.message().split_once(", expected ") {
            Some((title, expected)) => Self::new(at, title, format!("expected {expected}")),
            None => Self::new(at, error.message(), ""),
        }
    }

    fn report<'a>(&'a self, file: &'a str, text: &'a str) -> Vec<Group<'a>> {
        let label = Some(&self.expected[..]).filter(|expected| !expected.is_empty());
        let mut snippet = Snippet::source(text)
            .path(file)
            .annotation(AnnotationKind::Primary.span(self.at.clone()).label(label));
        if let Some((at, what)) = &self.other {
            snippet = snippet.annotation(AnnotationKind::Context.span(at.clone()).label(&what[..]));
        }
        let group = Level::ERROR.primary_title(&self.title[..]).element(snippet);
        vec![match &self.cure {
            Some(cure) => group.element(Level::HELP.message(&cure[..])),
            None => group,
        }]
    }
}

/// A problem, for programs.
#[derive(Clone, Debug, Serialize)]
pub struct ProblemReport<'a> {
    /// Its line, from 1.
    pub line: usize,
    /// Its first character in the line, from 1.
    pub column: usize,
    /// What is wrong.
    pub what: &'a str,
    /// What was expected there.
    pub expected: Option<&'a str>,
    /// What to do.
    pub cure: Option<&'a str>,
}

impl Problems {
    pub(super) fn new(file: String, text: &str, mut problems: Vec<Problem>) -> Self {
        problems.sort_by_key(|problem| problem.at.start);
        Self {
            file,
            text: text.to_owned(),
            problems,
        }
    }

    /// The lines that are to blame, from 1; one for each problem.
    pub fn lines(&self) -> Vec<usize> {
        self.reports().iter().map(|report| report.line).collect()
    }

    /// All of them, for programs.
    pub fn reports(&self) -> Vec<ProblemReport<'_>> {
        let mut reports = Vec::new();
        for problem in &self.problems {
            let before = self.text.get(..problem.at.start).unwrap_or(&self.text);
            let beside = before.rsplit('\n').next().unwrap_or_default();
            reports.push(ProblemReport {
                line: 1 + before.matches('\n').count(),
                column: 1 + beside.chars().count(),
                what: &problem.title,
                expected: Some(&problem.expected[..]).filter(|expected| !expected.is_empty()),
                cure: problem.cure.as_deref(),
            });
        }
        reports
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.problems.len()
    }

    /// Never: there is at least one.
    pub fn is_empty(&self) -> bool {
        self.problems.is_empty()
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let renderer = Renderer::plain();
        for (number, problem) in self.problems.iter().enumerate() {
            let blank = if number == 0 { "" } else { "\n\n" };
            write!(
                f,
                "{blank}{}",
                renderer.render(&problem.report(&self.file, &self.text))
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for Problems {}
