//! Names of nodes and topics.

/// Where a node is in the graph: `/robot/sweepd` is `sweepd` in `/robot`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// `/`, or tokens with a slash before each.
    pub namespace: String,
    /// One token.
    pub name: String,
}

/// A rule of `-r RULE`, such as `sweepd:~/roof/points:=/points`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// The rule, as it was given.
    pub rule: String,
    /// The only node that it is for.
    node: Option<String>,
    what: Renamed,
    to: String,
}

/// What a rule gives another name.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Renamed {
    /// `__node`
    Node,
    /// `__ns`
    Namespace,
    /// A topic, as it was given.
    Topic(String),
    /// This node has none.
    Service,
}

impl Remap {
    /// Reads a rule: `[NODE:][rostopic://]NAME:=NAME`, where the first name may be `__node` or `__ns`.
    ///
    /// # Errors
    /// A sentence: rcl does not take the rule either.
    pub fn parse(rule: &str) -> Result<Self, String> {
        let wrong = || format!("expected [NODE:]NAME:=NAME with names of ROS, not `{rule}`");
        let (from, to) = rule.split_once(":=").ok_or_else(wrong)?;
        // In `rostopic://NAME`, no node stands before the colon.
        let (node, from) = match from.split_once(':') {
            Some((node, from)) if !from.starts_with("//") => (Some(node), from),
            _ => (None, from),
        };
        let (what, is_right) = match from {
            "__node" | "__name" => (Renamed::Node, is_token(to)),
            "__ns" => (
                Renamed::Namespace,
                to == "/" || to.starts_with('/') && is_name(to),
            ),
            _ => match from.strip_prefix("rosservice://") {
                Some(service) => (Renamed::Service, is_name(service) && is_name(to)),
                None => {
                    let topic = from.strip_prefix("rostopic://").unwrap_or(from);
                    let is_right = is_name(topic) && is_name(to);
                    (Renamed::Topic(topic.to_owned()), is_right)
                }
            },
        };
        if !is_right || !node.is_none_or(is_token) {
            return Err(wrong());
        }
        Ok(Self {
            rule: rule.to_owned(),
            node: node.map(str::to_owned),
            what,
            to: to.to_owned(),
        })
    }

    fn is_for(&self, node: &str) -> bool {
        self.node.as_ref().is_none_or(|only| only == node)
    }
}

impl NodeName {
    /// The node `name` in `namespace`; the slash at its beginning may be missing.
    pub fn new(namespace: &str, name: &str) -> Self {
        Self {
            namespace: format!("/{}", namespace.trim_matches('/')),
            name: name.to_owned(),
        }
    }

    /// The name that rules give a node; of two rules for the same, the first counts.
    pub fn remapped(namespace: &str, name: &str, remaps: &[Remap]) -> Self {
        let first = |what, name: &str| {
            let mut fitting = remaps
                .iter()
                .filter(|remap| remap.what == what && remap.is_for(name));
            fitting.next().map(|remap| &remap.to[..])
        };
        let name = first(Renamed::Node, name).unwrap_or(name);
        // A rule for one node names it as the rules before have it.
        Self::new(first(Renamed::Namespace, name).unwrap_or(namespace), name)
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
    pub fn remapped_topic(&self, name: &str, remaps: &[Remap]) -> String {
        match remaps.iter().find(|remap| self.moves(remap, name)) {
            Some(remap) => self.topic(&remap.to),
            None => self.topic(name),
        }
    }

    /// Whether a rule gives a topic another name.
    pub fn moves(&self, remap: &Remap, topic: &str) -> bool {
        let Renamed::Topic(from) = &remap.what else {
            return false;
        };
        remap.is_for(&self.name) && self.topic(from) == self.topic(topic)
    }

    /// Whether a rule renames this node.
    pub fn is_renamed_by(&self, remap: &Remap) -> bool {
        match remap.what {
            Renamed::Node => self.name == remap.to,
            Renamed::Namespace => remap.is_for(&self.name) && self.namespace == remap.to,
            Renamed::Topic(_) | Renamed::Service => false,
        }
    }
}

/// Whether rcl takes a name in a rule: tokens with slashes between them, behind `~/`, `/` or nothing.
fn is_name(name: &str) -> bool {
    let tokens = name.strip_prefix("~/").or(name.strip_prefix('/'));
    tokens.unwrap_or(name).split('/').all(is_token)
}

/// Whether rcl takes a token in a rule.
fn is_token(token: &str) -> bool {
    let is_of_token = |one: char| one.is_ascii_alphanumeric() || one == '_';
    !token.is_empty()
        && token.chars().all(is_of_token)
        && !token.starts_with(|one: char| one.is_ascii_digit())
        && !token.contains("__")
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
            let remaps = [Remap::parse(&format!("{from}:=velodyne_points")).unwrap()];
            let moved = node.remapped_topic("~/roof/points", &remaps);
            assert_eq!(moved, "/velodyne_points");
            let other = node.remapped_topic("~/roof/ground", &remaps);
            assert_eq!(other, "/sweepd/roof/ground");
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
