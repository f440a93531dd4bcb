//! The messages of this crate: names, hashes and definitions as ROS 2 has them.

/// A message of ROS 2.
#[derive(Debug, PartialEq, Eq)]
pub struct MessageType {
    /// Its name in ROS, as `sensor_msgs/msg/PointCloud2`.
    pub name: &'static str,
    /// Hash of its type (REP 2016), `RIHS01_` and 64 digits; the same in Jazzy and Kilted.
    pub hash: &'static str,
    /// Its definition and those of the messages in it, as MCAP has them (`ros2msg`), without
    /// comments.
    pub definition: &'static str,
}

impl MessageType {
    /// Its name in DDS, as `sensor_msgs::msg::dds_::PointCloud2_`.
    pub fn dds_name(&self) -> String {
        match self.name.rsplit_once('/') {
            Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
            None => format!("dds_::{}_", self.name),
        }
    }
}

/// Points: [`crate::cloud`].
pub static POINT_CLOUD: MessageType = MessageType {
    name: "sensor_msgs/msg/PointCloud2",
    hash: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    definition: include_str!("../definitions/PointCloud2.txt"),
};

/// Ranges or labels: [`crate::image`].
pub static IMAGE: MessageType = MessageType {
    name: "sensor_msgs/msg/Image",
    hash: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    definition: include_str!("../definitions/Image.txt"),
};

/// Boxes: [`crate::markers`].
pub static MARKER_ARRAY: MessageType = MessageType {
    name: "visualization_msgs/msg/MarkerArray",
    hash: "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    definition: include_str!("../definitions/MarkerArray.txt"),
};

/// What stands around, from above: [`crate::scan`].
pub static LASER_SCAN: MessageType = MessageType {
    name: "sensor_msgs/msg/LaserScan",
    hash: "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    definition: include_str!("../definitions/LaserScan.txt"),
};

/// Health: [`crate::diagnostics`].
pub static DIAGNOSTIC_ARRAY: MessageType = MessageType {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    definition: include_str!("../definitions/DiagnosticArray.txt"),
};

/// Where a sensor sits: [`crate::transforms`]; where the robot is, to read: [`crate::odometry`].
pub static TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    definition: include_str!("../definitions/TFMessage.txt"),
};

/// Where the robot is, to read: [`crate::odometry`].
pub static ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    hash: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    definition: include_str!("../definitions/Odometry.txt"),
};

/// The time, where it is not the host's: a [`Writer::time`](crate::cdr::Writer::time) is all of it.
pub static CLOCK: MessageType = MessageType {
    name: "rosgraph_msgs/msg/Clock",
    hash: "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    definition: include_str!("../definitions/Clock.txt"),
};

/// The nodes of a participant: [`crate::graph`]. Hash and definition are those since Iron.
pub static PARTICIPANT_ENTITIES_INFO: MessageType = MessageType {
    name: "rmw_dds_common/msg/ParticipantEntitiesInfo",
    hash: "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
    definition: include_str!("../definitions/ParticipantEntitiesInfo.txt"),
};

/// All of them.
pub static ALL: [&MessageType; 9] = [
    &POINT_CLOUD,
    &IMAGE,
    &LASER_SCAN,
    &MARKER_ARRAY,
    &DIAGNOSTIC_ARRAY,
    &TF_MESSAGE,
    &ODOMETRY,
    &CLOCK,
    &PARTICIPANT_ENTITIES_INFO,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_dds_are_those_on_the_wire() {
        assert_eq!(
            POINT_CLOUD.dds_name(),
            "sensor_msgs::msg::dds_::PointCloud2_"
        );
        assert_eq!(
            PARTICIPANT_ENTITIES_INFO.dds_name(),
            "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
        );
    }
}
