//! The command line of `sweepd-ros2`, but for what ROS adds.

use std::path::PathBuf;

use clap::Parser;
use sweepd_client::service::{NAME_RULE, is_sensor_name};

/// Publishes the sweeps that sweepd shares on the ROS 2 graph; it needs no ROS
#[derive(Debug, Parser)]
#[command(name = "sweepd-ros2", version, max_term_width = 100)]
#[command(after_help = "\
Topics of the sensor `roof`, each computed only while it has a subscriber:
  ~/roof/points       sensor_msgs/PointCloud2, x y z intensity ring time label
  ~/roof/ground       the same, ground alone
  ~/roof/nonground    the same, all but ground
  ~/roof/objects      the same, segments alone
  ~/roof/scan         sensor_msgs/LaserScan, the nearest of nonground seen from above
  ~/roof/markers      visualization_msgs/MarkerArray, a box a segment that is not wide
  ~/roof/range_image  sensor_msgs/Image, 32FC1, metres
  ~/roof/label_image  sensor_msgs/Image, 16UC1
  ~/roof/points_deskewed  as points, where the parameter `deskew` is given
  /diagnostics        diagnostic_msgs/DiagnosticArray, each second
  /tf_static          tf2_msgs/TFMessage, where the daemon's configuration has a mount
  /clock              rosgraph_msgs/Clock, the time of a replay, with the parameter `clock`

ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY and ROS_STATIC_PEERS count as in ROS. \
What a launch file adds is taken: --ros-args with -r __node:=NAME, -r __ns:=/NAMESPACE, \
-r TOPIC:=TOPIC, --params-file FILE, -p NAME:=VALUE.

Exit codes:
  0   done
  1   failed: standard error says what
  2   wrong options or arguments
  66  a file of parameters is not there, is a folder, or may not be read
  78  the parameters or the environment are invalid: correct them, then start again

Examples:
  sweepd-ros2                           all sensors
  sweepd-ros2 roof --parameters ros2.yaml
  sweepd-ros2 roof --ros-args -r ~/roof/points:=/velodyne_points -p stamp:=last")]
pub struct Args {
    /// Sensors to publish [default: `sensors` of the parameters, else all, also those that come
    /// later]
    #[arg(value_name = "NAME", value_parser = sensor_name)]
    pub sensors: Vec<String>,
    /// Parameters: YAML in the form of ROS, with `sensors`, `root`, `health`, `base_frame`, `deskew`,
    /// `odometry`, `clock`, `frame_id`, `stamp`, `organized`, `layout`, `fields`, `only_complete`,
    /// `min_columns`, `scan_heights`, `scan_ring`
    #[arg(long, value_name = "FILE", visible_alias = "params-file")]
    pub parameters: Option<PathBuf>,
    /// Name of the node
    #[arg(long, value_name = "NAME", default_value = "sweepd")]
    pub node: String,
    /// Its namespace
    #[arg(long, value_name = "NAMESPACE", default_value = "/")]
    pub namespace: String,
    /// Folder by which the daemon and its consumers find each other [default: `root` of the
    /// parameters, else $SWEEPD_ROOT, else /run/sweepd/iox2 where there is a /run/sweepd, else
    /// /tmp/sweepd/iox2]
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
}

fn sensor_name(name: &str) -> Result<String, String> {
    match is_sensor_name(name) {
        true => Ok(name.to_owned()),
        false => Err(format!("a sensor's name has {NAME_RULE}")),
    }
}
