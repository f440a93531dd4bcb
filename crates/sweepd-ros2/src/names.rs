//! Names of nodes and topics.

/// Where a node is in the graph: `/robot/sweepd` is `sweepd` in `/robot`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// `/`, or tokens with a slash before each.
    pub namespace: String,
    /// One token.
    pub name: String,
}

/// A topic that gets another name: both as they were given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// The name that the program uses.
    pub from: String,
    /// The name that it gets.
    pub to: String,
}

impl NodeName {
    /// The node `name` in `namespace`; the slash at its beginning may be missing.
    pub fn new(namespace: &str, name: &str) -> Self {
        Self {
            namespace: format!("/{}", namespace.trim_matches('/')),
            name: name.to_owned(),
        }
    }

    /// The whole name, such as `/robot/sweepd`.
    pub fn full(&self) -> String {
        join(&self.namespace, &self.name)
    }

    /// The whole name of a topic: `/x` stands as it is, `~/x` is below the node, `x` is in its
    /// namespace.
    pub fn topic(&self, name: &str) -> String {
        match name.strip_prefix("~/") {
            Some(private) => join(&self.full(), private),
            None if name.starts_with('/') => name.to_owned(),
            None => join(&self.namespace, name),
        }
    }

    /// The whole name of a topic after the remaps; the first that fits decides.
    pub fn remapped(&self, name: &str, remaps: &[Remap]) -> String {
        let name = self.topic(name);
        let fits = |remap: &&Remap| self.topic(&remap.from) == name;
        match remaps.iter().find(fits) {
            Some(remap) => self.topic(&remap.to),
            None => name,
        }
    }
}

/// The token of a sensor's name: other characters than letters, digits and `_` become `_`; a
/// leading digit gets `sensor_` before it.
pub fn token(sensor: &str) -> String {
    let token = sensor.replace(|one: char| !one.is_ascii_alphanumeric(), "_");
    match token.starts_with(|one: char| one.is_ascii_digit()) {
        true => format!("sensor_{token}"),
        false => token,
    }
}

fn join(namespace: &str, name: &str) -> String {
    format!("{}/{name}", namespace.trim_end_matches('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_are_resolved_as_ros_does() {
        let root = NodeName::new("/", "sweepd");
        let deep = NodeName::new("fleet/robot/", "lidar");
        assert_eq!(
            (&root.full()[..], &deep.full()[..]),
            ("/sweepd", "/fleet/robot/lidar")
        );
        for (name, at_root, at_deep) in [
            (
                "~/roof/points",
                "/sweepd/roof/points",
                "/fleet/robot/lidar/roof/points",
            ),
            ("/diagnostics", "/diagnostics", "/diagnostics"),
            ("points", "/points", "/fleet/robot/points"),
        ] {
            assert_eq!(
                (root.topic(name), deep.topic(name)),
                (at_root.into(), at_deep.into())
            );
        }
    }

    #[test]
    fn a_remap_holds_for_the_topic_however_it_is_written() {
        let node = NodeName::new("", "sweepd");
        for from in ["~/roof/points", "/sweepd/roof/points", "sweepd/roof/points"] {
            let remaps = [Remap {
                from: from.into(),
                to: "velodyne_points".into(),
            }];
            assert_eq!(node.remapped("~/roof/points", &remaps), "/velodyne_points");
            assert_eq!(
                node.remapped("~/roof/ground", &remaps),
                "/sweepd/roof/ground"
            );
        }
    }

    #[test]
    fn sensors_get_tokens() {
        for (sensor, expected) in [
            ("roof", "roof"),
            ("front-left.2", "front_left_2"),
            ("3d", "sensor_3d"),
        ] {
            assert_eq!(token(sensor), expected);
        }
    }
}
