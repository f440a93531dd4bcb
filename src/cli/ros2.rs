//! How sweeps become messages of ROS 2, in the words of `sweepd-ros2`.

use clap::ValueEnum;

use super::CliError;
use super::publish::{refuse_twice, sensor_name};
use crate::export::mcap::MessageForm;
use sweepd_messages::{Cloud, Fields, Layout};

/// Group of the options that write messages.
pub const OUTPUTS: &str = "messages";

/// The form of messages.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Messages of ROS 2")]
pub struct MessageOptions {
    /// Name of the sensor in its topics, /sweepd/NAME/points, and of its frame; give it again for the
    /// second sensor, and so on [default: its name in the configuration, else its address]
    // The sensor of `watch` is its argument `name`.
    #[arg(id = "message_name", long = "name", value_name = "NAME", requires = OUTPUTS, value_parser = sensor_name)]
    name: Vec<String>,
    /// Frame of the messages; give it again for the second sensor, and so on [default: the name of
    /// the sensor]
    #[arg(long, value_name = "FRAME", requires = OUTPUTS)]
    frame_id: Vec<String>,
    /// What a point holds
    #[arg(long, value_name = "LAYOUT", requires = OUTPUTS, default_value = "xyzirt")]
    layout: LayoutName,
    /// Clouds with rows and columns, and NaN where there is no return, instead of lists of returns
    #[arg(long, requires = OUTPUTS)]
    organized: bool,
}

/// What a point holds.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum LayoutName {
    /// x y z intensity ring time label
    Xyzirt,
    /// Autoware's PointXYZIRCAEDT
    Autoware,
}

impl MessageOptions {
    /// The form of a sensor's messages, by the sensor's number.
    pub fn form(&self, sensor: usize) -> MessageForm {
        MessageForm {
            name: self.name.get(sensor).cloned(),
            frame_id: self.frame_id.get(sensor).cloned(),
            cloud: Cloud {
                layout: match self.layout {
                    LayoutName::Xyzirt => Layout::Fields(Fields::ALL),
                    LayoutName::Autoware => Layout::Autoware,
                },
                organized: self.organized,
                ..Cloud::default()
            },
        }
    }

    /// What is left over after this many sensors, as it was given.
    pub fn left_over(&self, sensors: usize) -> Vec<String> {
        let mut left_over = Vec::new();
        for (option, names) in [("--name", &self.name), ("--frame-id", &self.frame_id)] {
            for name in names.iter().skip(sensors) {
                left_over.push(format!("{option} {name}"));
            }
        }
        left_over
    }

    /// Refuses a name or frame that is given twice.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub fn check(&self) -> Result<(), CliError> {
        refuse_twice("--name", &self.name)?;
        refuse_twice("--frame-id", &self.frame_id)
    }
}
