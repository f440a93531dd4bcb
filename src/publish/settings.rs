//! What is shared under which name.

use sweepd_client::service::Topic;

/// What is shared under which name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServiceSettings {
    /// Name of the sensor.
    pub name: String,
    /// What it carries.
    pub topic: Topic,
    /// Consumers at most.
    pub max_consumers: usize,
    /// Model of the sensor, as far as known: an attribute for people and tools.
    pub model: String,
    /// Where its packets come from: another.
    pub address: String,
}
