//! What a launch file gives a node: `--ros-args -r __node:=x -r __ns:=/y --params-file FILE -p a:=b`.

use std::ffi::OsString;
use std::path::PathBuf;

use crate::names::Remap;

/// Arguments of ROS that a node of one process has no use for, and how many words follow each.
const WITHOUT_USE: [(&str, usize); 10] = [
    ("--log-level", 1),
    ("--log-config-file", 1),
    ("--enclave", 1),
    ("-e", 1),
    ("--enable-rosout-logs", 0),
    ("--disable-rosout-logs", 0),
    ("--enable-stdout-logs", 0),
    ("--disable-stdout-logs", 0),
    ("--enable-external-lib-logs", 0),
    ("--disable-external-lib-logs", 0),
];

/// The arguments of ROS.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosArgs {
    /// Name of the node.
    pub node: Option<String>,
    /// Its namespace.
    pub namespace: Option<String>,
    /// Files and parameters, in the order in which they count.
    pub parameters: Vec<Source>,
    /// Topics that get another name.
    pub remaps: Vec<Remap>,
}

/// Where parameters come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A file.
    File(PathBuf),
    /// A name and a value.
    One(String, String),
}

impl RosArgs {
    /// Takes the arguments of ROS out of a command line: from `--ros-args` to `--`, or to the end.
    ///
    /// # Errors
    /// A sentence that names the word.
    pub fn split(words: impl Iterator<Item = OsString>) -> Result<(Self, Vec<OsString>), String> {
        let (mut args, mut others) = (Self::default(), Vec::new());
        let mut words = words.peekable();
        while let Some(word) = words.next() {
            if word != "--ros-args" {
                others.push(word);
                continue;
            }
            while let Some(word) = words.next_if(|word| word != "--") {
                args.take(&word, &mut words)?;
            }
            words.next();
        }
        Ok((args, others))
    }

    fn take(
        &mut self,
        word: &OsString,
        words: &mut impl Iterator<Item = OsString>,
    ) -> Result<(), String> {
        let word = word.to_string_lossy();
        let mut value = || {
            words
                .next()
                .ok_or(format!("{word} of --ros-args needs a value"))
        };
        match &*word {
            "--params-file" => self.parameters.push(Source::File(value()?.into())),
            "-p" | "--param" => {
                let (name, value) = pair(&value()?)?;
                self.parameters.push(Source::One(name, value));
            }
            "-r" | "--remap" => {
                let (from, to) = pair(&value()?)?;
                match &from[..] {
                    "__node" | "__name" => self.node = Some(to),
                    "__ns" => self.namespace = Some(to),
                    _ => self.remaps.push(Remap { from, to }),
                }
            }
            _ => {
                let known = WITHOUT_USE.iter().find(|(name, _)| *name == word);
                let (_, values) = known.ok_or_else(|| {
                    format!(
                        "unknown argument {word} of --ros-args; known are -r, -p and --params-file"
                    )
                })?;
                for _ in 0..*values {
                    value()?;
                }
            }
        }
        Ok(())
    }
}

/// Both sides of `:=`.
fn pair(word: &OsString) -> Result<(String, String), String> {
    let word = word.to_string_lossy();
    match word.split_once(":=") {
        Some((left, right)) => Ok((left.to_owned(), right.to_owned())),
        None => Err(format!("expected NAME:=VALUE, not `{word}`")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(line: &str) -> Result<(RosArgs, Vec<OsString>), String> {
        RosArgs::split(line.split_whitespace().map(OsString::from))
    }

    #[test]
    fn what_a_launch_file_gives_is_taken_and_the_rest_is_left() {
        let (args, others) = split(
            "roof --ros-args --log-level info -r __node:=lidar -r __ns:=/robot -r ~/roof/points:=/points \
             --params-file /tmp/launch -p stamp:=last -- --root /r --ros-args --disable-rosout-logs",
        )
        .unwrap();
        assert_eq!(others, ["roof", "--root", "/r"]);
        let expected = RosArgs {
            node: Some("lidar".to_owned()),
            namespace: Some("/robot".to_owned()),
            parameters: vec![
                Source::File("/tmp/launch".into()),
                Source::One("stamp".to_owned(), "last".to_owned()),
            ],
            remaps: vec![Remap {
                from: "~/roof/points".to_owned(),
                to: "/points".to_owned(),
            }],
        };
        assert_eq!(args, expected);
        assert_eq!(split("roof --root /r").unwrap().0, RosArgs::default());
    }

    #[test]
    fn a_wrong_word_is_named() {
        for (line, part) in [
            ("--ros-args --parms-file x", "unknown argument --parms-file"),
            ("--ros-args -p", "-p of --ros-args needs a value"),
            (
                "--ros-args --log-level",
                "--log-level of --ros-args needs a value",
            ),
            (
                "--ros-args -p stamp=last",
                "expected NAME:=VALUE, not `stamp=last`",
            ),
        ] {
            let error = split(line).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
