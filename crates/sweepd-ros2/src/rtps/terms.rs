//! What writers offer and readers ask for, and how the two go together (DDS 1.4, section 2.2.3).

use std::time::Duration;

use super::discovery::Endpoint;

/// What an endpoint of ours offers, or asks for.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Its topic in DDS, as `rt/points`.
    pub topic: String,
    /// Its type in DDS, as `sensor_msgs::msg::dds_::PointCloud2_`.
    pub type_name: String,
    /// The hash of its type, as ROS 2 has it since Iron.
    pub type_hash: &'static str,
    /// Whether readers get all samples, also those that were lost on their way.
    pub reliable: bool,
    /// Whether readers that come late get what was written before.
    pub transient_local: bool,
    /// Samples that are kept: the newest.
    pub depth: usize,
    /// For how long readers that come late get them, if not for ever.
    pub lifespan: Option<Duration>,
    /// Set if nobody else is to write to the topic.
    pub is_sole: bool,
}

/// How a reader and a writer go together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Match {
    /// They do.
    Yes,
    /// Another topic or type.
    No,
    /// The reader asks for this, which is not offered.
    AsksFor(&'static str),
}

const HISTORY: &str = "messages from before it was there (durability transient local)";
const ALL_MESSAGES: &str = "all messages (reliability reliable)";

impl Terms {
    /// Whether a reader of others gets our samples.
    pub fn offered_to(&self, reader: &Endpoint) -> Match {
        match self.with(reader) {
            Match::Yes if reader.transient_local && !self.transient_local => {
                Match::AsksFor(HISTORY)
            }
            Match::Yes if reader.reliable && !self.reliable => Match::AsksFor(ALL_MESSAGES),
            other => other,
        }
    }

    /// Whether we get the samples of a writer of others.
    pub fn asked_of(&self, writer: &Endpoint) -> Match {
        match self.with(writer) {
            Match::Yes if self.transient_local && !writer.transient_local => {
                Match::AsksFor(HISTORY)
            }
            Match::Yes if self.reliable && !writer.reliable => Match::AsksFor(ALL_MESSAGES),
            other => other,
        }
    }

    /// True if a writer of others writes to a topic that is ours alone.
    pub fn has_rival(&self, writer: &Endpoint) -> bool {
        self.is_sole && self.is_of(writer)
    }

    fn is_of(&self, other: &Endpoint) -> bool {
        self.topic == other.topic && self.type_name == other.type_name
    }

    fn with(&self, other: &Endpoint) -> Match {
        if !self.is_of(other) {
            Match::No
        } else {
            other.promise.map_or(Match::Yes, Match::AsksFor)
        }
    }

    /// Its topic in ROS, as `/points`.
    pub fn ros_topic(&self) -> &str {
        self.topic.trim_start_matches("rt")
    }
}
