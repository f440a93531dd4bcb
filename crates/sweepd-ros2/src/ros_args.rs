//! What a launch file gives a node: `--ros-args -r __node:=x -r __ns:=/y --params-file FILE -p a:=b`.

use std::ffi::OsString;
use std::path::PathBuf;

use crate::names::Remap;

/// Arguments of ROS that a node of one process has no use for, and how many words follow each.
const WITHOUT_USE: [(&str, usize); 8] = [
    ("--log-level", 1),
    ("--log-config-file", 1),
    ("--enclave", 1),
    ("-e", 1),
    ("--enable-stdout-logs", 0),
    ("--disable-stdout-logs", 0),
    ("--enable-external-lib-logs", 0),
    ("--disable-external-lib-logs", 0),
];

/// The arguments of ROS.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RosArgs {
    /// Files and parameters, in the order in which they count.
    pub parameters: Vec<Source>,
    /// Rules for names, in the order in which they count.
    pub remaps: Vec<Remap>,
    /// The log is not to be on `/rosout`.
    pub without_rosout: bool,
}

/// Where parameters come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A file.
    File(PathBuf),
    /// `-p [NODE:]NAME:=VALUE`
    One {
        /// The only node that it is for.
        node: Option<String>,
        /// The parameter.
        name: String,
        /// Its value as YAML.
        value: String,
    },
}

impl RosArgs {
    /// Takes the arguments of ROS out of a command line: from `--ros-args` to `--`, or to the end, and
    /// rules elsewhere, as rcl still does.
    ///
    /// # Errors
    /// A sentence that names the word.
    pub fn split(words: impl Iterator<Item = OsString>) -> Result<(Self, Vec<OsString>), String> {
        let (mut args, mut others) = (Self::default(), Vec::new());
        let mut words = words.peekable();
        while let Some(word) = words.next() {
            if word != "--ros-args" {
                match word.to_str().filter(|word| word.contains(":=")) {
                    Some(rule) => args.remaps.push(Remap::parse(rule)?),
                    None => others.push(word),
                }
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
            // Once more, as by a launch file in a launch file.
            "--ros-args" => {}
            "--enable-rosout-logs" => self.without_rosout = false,
            "--disable-rosout-logs" => self.without_rosout = true,
            "-p" | "--param" => self.parameters.push(one(&value()?)?),
            "-r" | "--remap" => {
                let rule = value()?;
                self.remaps.push(Remap::parse(&rule.to_string_lossy())?);
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

/// Reads `[NODE:]NAME:=VALUE`.
fn one(word: &OsString) -> Result<Source, String> {
    let word = word.to_string_lossy();
    let wrong = || format!("expected [NODE:]NAME:=VALUE, not `{word}`");
    let (name, value) = word.split_once(":=").ok_or_else(wrong)?;
    let (node, name) = match name.split_once(':') {
        Some((node, name)) => (Some(node.to_owned()), name),
        None => (None, name),
    };
    let has_empty =
        node.as_ref().is_some_and(String::is_empty) || name.split('.').any(str::is_empty);
    if has_empty || name.contains([':', ' ']) {
        return Err(wrong());
    }
    Ok(Source::One {
        node,
        name: name.to_owned(),
        value: value.to_owned(),
    })
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
            "roof --ros-args --log-level info -r __node:=lidar -r ~/roof/points:=/points --params-file /tmp/launch \
             -p lidar:stamp:=last -- --root /r --ros-args --disable-rosout-logs",
        )
        .unwrap();
        assert_eq!(others, ["roof", "--root", "/r"]);
        assert!(args.without_rosout);
        let rules: Vec<&str> = args.remaps.iter().map(|remap| &remap.rule[..]).collect();
        assert_eq!(rules, ["__node:=lidar", "~/roof/points:=/points"]);
        let expected = [
            Source::File("/tmp/launch".into()),
            Source::One {
                node: Some("lidar".to_owned()),
                name: "stamp".to_owned(),
                value: "last".to_owned(),
            },
        ];
        assert_eq!(args.parameters, expected);
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
                "expected [NODE:]NAME:=VALUE, not `stamp=last`",
            ),
            (
                "--ros-args -r a=b",
                "expected [NODE:]NAME:=NAME with names of ROS, not `a=b`",
            ),
        ] {
            let error = split(line).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
