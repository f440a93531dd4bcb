//! Options of the commands that share sweeps, and the completion of a shared sweep.

use std::path::PathBuf;

use super::CliError;
use crate::publish::{
    Domain, Loans, NAME_RULE, PublishError, ServiceSettings, Slot, Topic, is_sensor_name,
};
use sweepd_client::host::{monotonic_ns, realtime_ns};
use sweepd_core::sweep::SweepMut;
use sweepd_core::sweep::layout::Completion;

/// Where sweeps are shared.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sharing")]
pub struct RootOptions {
    /// Folder by which the daemon and its consumers find each other [default: $SWEEPD_ROOT, else
    /// /run/sweepd/iox2 where there is a /run/sweepd, else /tmp/sweepd/iox2]
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
}

impl RootOptions {
    /// The domain that they name.
    pub fn domain(&self) -> Domain {
        Domain::at_or_default(self.root.as_deref())
    }
}

/// Options to publish sweeps as the daemon does.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Sharing")]
pub struct PublishOptions {
    /// Share the sweeps as the daemon would, under this sensor name; give it again for the second
    /// sensor in the capture, and so on
    #[arg(long, value_name = "NAME", value_parser = sensor_name)]
    pub publish: Vec<String>,
    /// Maximum number of consumers of each sensor
    #[arg(long, value_name = "N", default_value = "4", value_parser = clap::value_parser!(u8).range(1..=16))]
    pub max_consumers: u8,
    #[command(flatten)]
    root: RootOptions,
}

impl PublishOptions {
    /// Whether anything is shared.
    pub fn is_wanted(&self) -> bool {
        !self.publish.is_empty()
    }

    /// The name under which a sensor is shared, if it is: the first one in the capture is number 0.
    pub fn name(&self, sensor: usize) -> Option<&str> {
        self.publish.get(sensor).map(String::as_str)
    }

    /// Refuses a name that is given twice.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub fn check(&self) -> Result<(), CliError> {
        refuse_twice("--publish", &self.publish)
    }

    /// A note about a new sensor: the name under which it is published, or, only for the first such
    /// sensor, that it is not.
    pub fn note(&self, sensor: usize, address: &str) -> Option<String> {
        match self.name(sensor) {
            Some(name) => Some(format!("{address} is shared as {name}")),
            None if self.is_wanted() && sensor == self.publish.len() => Some(format!(
                "{address} is not shared: no --publish NAME is left for it"
            )),
            None => None,
        }
    }

    /// The unused names after this many sensors.
    pub fn left_over(&self, sensors: usize) -> &[String] {
        self.publish.get(sensors..).unwrap_or_default()
    }

    /// Shared memory for the sweeps of a sensor, if it is shared.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn loans(&self, sensor: usize, address: &str) -> Result<Loans, PublishError> {
        let Some(name) = self.name(sensor) else {
            return Ok(Loans::default());
        };
        let settings = ServiceSettings {
            name: name.to_owned(),
            topic: Topic::Sweeps,
            max_consumers: self.max_consumers.into(),
            model: String::new(),
            address: address.to_owned(),
        };
        Loans::create(&self.root.domain(), &settings)
    }
}

/// Refuses a name that an option gives to two sensors.
///
/// # Errors
/// [`CliError::Usage`].
pub(super) fn refuse_twice(option: &str, names: &[String]) -> Result<(), CliError> {
    for (index, name) in names.iter().enumerate() {
        if names[..index].contains(name) {
            return Err(CliError::Usage(format!(
                "{option} {name} is given twice; give each sensor a name of its own"
            )));
        }
    }
    Ok(())
}

/// A name as the configuration has it.
pub(super) fn sensor_name(text: &str) -> Result<String, String> {
    if is_sensor_name(text) {
        Ok(text.to_owned())
    } else {
        Err(format!("expected {NAME_RULE}"))
    }
}

/// Completes the header of a sweep and publishes it to all consumers.
///
/// # Errors
/// [`PublishError`].
pub fn publish(mut slot: Slot, name: &str, run_ns: i64) -> Result<usize, PublishError> {
    if let Ok(sweep) = SweepMut::open(slot.as_mut()) {
        sweep.header.complete(&Completion {
            name,
            run_ns,
            completed_ns: realtime_ns(),
            completed_monotonic_ns: monotonic_ns(),
            dropped_datagrams: 0,
        });
    }
    slot.publish()
}
