//! The folder of a bag of rosbag2: one MCAP file, and `metadata.yaml` beside it.
//!
//! The version of the metadata is that of Humble, which names qualities of service by the numbers of
//! `rmw`: all of rosbag2 from Foxy on reads it, and so do its readers in other languages.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use crate::files::WriteError;
use crate::files::output::{self, Existing};

const METADATA: &str = "metadata.yaml";
/// Values of `rmw/types.h` by their names.
const QOS_NUMBERS: [(&str, &str); 5] = [
    ("keep_last", "1"),
    ("reliable", "1"),
    ("transient_local", "1"),
    ("volatile", "2"),
    ("automatic", "1"),
];

/// A folder under way.
pub(super) struct BagFolder {
    path: PathBuf,
    existing: Existing,
}

/// What is in the file.
pub(super) struct Contents {
    pub(super) topics: Vec<TopicContents>,
    /// Times of messages, nanoseconds since 1970.
    pub(super) first_ns: u64,
    pub(super) last_ns: u64,
}

/// A topic of it.
pub(super) struct TopicContents {
    pub(super) name: String,
    pub(super) message_type: &'static str,
    /// Quality of service as rosbag2 writes it since Jazzy.
    pub(super) offered: &'static str,
    pub(super) messages: u64,
}

impl BagFolder {
    /// Makes it, with those above it, unless it is there.
    ///
    /// # Errors
    /// [`WriteError`]: it holds a bag that must not be replaced, or cannot be made.
    pub(super) fn create(path: &Path, existing: Existing) -> Result<Self, WriteError> {
        output::check(&path.join(METADATA), existing)?;
        fs::create_dir_all(path).map_err(|cause| WriteError::Directory {
            path: path.to_owned(),
            cause,
        })?;
        Ok(Self {
            path: path.to_owned(),
            existing,
        })
    }

    /// The file in it, which has the name of the folder.
    pub(super) fn file(&self) -> PathBuf {
        self.path.join(self.file_name())
    }

    fn file_name(&self) -> String {
        // The name of `.` is that of the folder it stands for.
        let path = self.path.canonicalize();
        let name = path.as_deref().unwrap_or(&self.path).file_name();
        let name = name.map_or("bag".into(), |name| name.to_string_lossy());
        format!("{name}_0.mcap")
    }

    /// Writes what the file beside it holds.
    ///
    /// # Errors
    /// [`WriteError`].
    pub(super) fn finish(self, contents: &Contents) -> Result<(), WriteError> {
        let metadata = contents.metadata(&self.file_name());
        let path = self.path.join(METADATA);
        output::write(&path, metadata.as_bytes(), self.existing)
    }
}

impl Contents {
    fn metadata(&self, file: &str) -> String {
        let file = quoted(file);
        let messages: u64 = self.topics.iter().map(|one| one.messages).sum();
        let duration_ns = self.last_ns - self.first_ns;
        let begun_ns = self.first_ns;
        let mut topics = String::new();
        for topic in &self.topics {
            let mut offered = topic.offered.to_owned();
            for (name, number) in QOS_NUMBERS {
                offered = offered.replace(&format!(": {name}\n"), &format!(": {number}\n"));
            }
            // Writing to a text cannot fail.
            let _ = write!(
                topics,
                "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
                 offered_qos_profiles: {}\n      message_count: {}\n",
                quoted(&topic.name),
                topic.message_type,
                quoted(&offered),
                topic.messages,
            );
        }
        format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
             duration:\n    nanoseconds: {duration_ns}\n  \
             starting_time:\n    nanoseconds_since_epoch: {begun_ns}\n  \
             message_count: {messages}\n  topics_with_message_count:\n{topics}  \
             compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  \
             files:\n    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {begun_ns}\n      \
             duration:\n        nanoseconds: {duration_ns}\n      message_count: {messages}\n"
        )
    }
}

/// A text of YAML in double quotes.
fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for one in text.chars() {
        match one {
            '\n' => quoted.push_str("\\n"),
            '"' | '\\' => quoted.extend(['\\', one]),
            _ if one.is_control() => quoted.push_str(&format!("\\U{:08X}", u32::from(one))),
            _ => quoted.push(one),
        }
    }
    quoted.push('"');
    quoted
}
