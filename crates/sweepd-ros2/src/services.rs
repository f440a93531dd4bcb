//! The services for parameters, which every node of ROS has: they are listed, got, described, and set where
//! that can be while the node runs. `/parameter_events` tells others of it.

use sweepd_client::host::realtime_ns;
use sweepd_messages::rcl::{
    Description, PARAMETER_SERVICES, Reply, Request, Value, encode_parameter_event,
};
use sweepd_ros2::{Node, NodeError, Publisher, Service, log};

use crate::bridge::Bridge;
use crate::parameters::{Parameters, SensorParameters, description};

/// Requests of one service that are answered before the node looks after other things.
const AT_ONCE: usize = 10;

/// Parameters, of those that a request changes, that the log names.
const MOST_NAMED: usize = 10;

/// The services for the parameters of a node.
pub struct Services {
    services: Vec<Service>,
    events: Publisher,
    /// Full name of the node.
    node: String,
    declared: Declared,
}

/// The parameters as they are now.
struct Declared {
    parameters: Parameters,
    /// Names of all, with those of the sensors that are there.
    names: Vec<String>,
}

impl Services {
    /// Offers them for the node of that full name.
    ///
    /// # Errors
    /// The node's name leaves no room for theirs.
    pub fn new(node: &Node, name: String, parameters: &Parameters) -> Result<Self, NodeError> {
        let services = PARAMETER_SERVICES.iter();
        let services: Result<Vec<Service>, NodeError> =
            services.map(|service| node.service(service)).collect();
        Ok(Self {
            services: services?,
            events: node.parameter_events(),
            node: name,
            declared: Declared {
                parameters: parameters.clone(),
                names: vec![],
            },
        })
    }

    /// How a sensor is to be published now.
    pub fn of(&self, sensor: &str) -> SensorParameters {
        self.declared.parameters.of(sensor)
    }

    /// Answers the requests that wait. Says whether others may wait already; if not, the thread is unparked
    /// when one comes.
    pub fn serve(&mut self, bridges: &[&Bridge]) -> bool {
        let new = self.declared.add(bridges);
        self.tell(&new, &[]);
        let mut is_busy = false;
        for index in 0..self.services.len() {
            for _ in 0..AT_ONCE {
                let Some(request) = self.services[index].take() else {
                    break;
                };
                is_busy = true;
                // What is no request is from no client of ours.
                let Ok(asked) = Request::read(index, request.message()) else {
                    continue;
                };
                let before = self.declared.parameters.clone();
                let mut reply = Vec::new();
                self.declared.answer(&asked).encode(&mut reply);
                let changed = self.declared.changes(&before, bridges);
                self.tell(&[], &changed);
                self.services[index].answer(&request, reply);
            }
            is_busy |= self.services[index].has_early();
        }
        is_busy
    }

    /// Publishes an event, if there is one.
    fn tell(&self, new: &[String], changed: &[String]) {
        if new.is_empty() && changed.is_empty() {
            return;
        }
        let [new, changed] = [new, changed].map(|names| {
            let valued = |name: &String| (name.clone(), self.declared.parameters.value(name));
            names.iter().map(valued).collect::<Vec<_>>()
        });
        let mut message = self.events.buffer();
        encode_parameter_event(realtime_ns(), &self.node, &new, &changed, &mut message);
        self.events.publish(message);
    }
}

impl Declared {
    /// Adds the parameters of sensors that have come, and at first those of the node; returns their names.
    fn add(&mut self, bridges: &[&Bridge]) -> Vec<String> {
        let names = Parameters::names(bridges.iter().map(|bridge| &bridge.name[..]));
        if names.len() == self.names.len() {
            return vec![];
        }
        let is_new = |name: &&String| !self.names.contains(name);
        let new = names.iter().filter(is_new).cloned().collect();
        self.names = names;
        new
    }

    fn answer(&mut self, asked: &Request) -> Reply {
        // As rclpy: where one name is unknown, nothing is told.
        let all_of = |names: &[String]| match names.iter().all(|name| self.names.contains(name)) {
            true => names.to_vec(),
            false => vec![],
        };
        match asked {
            Request::List(prefixes, depth) => {
                let mut names = self.names.clone();
                names.retain(|name| is_listed(name, prefixes, *depth));
                Reply::List(names)
            }
            Request::Get(names) => {
                let names = all_of(names);
                Reply::Get(
                    names
                        .iter()
                        .map(|name| self.parameters.value(name))
                        .collect(),
                )
            }
            Request::Types(names) => {
                let names = all_of(names);
                let types = names.iter().map(|name| self.type_number(name));
                Reply::Types(types.collect())
            }
            Request::Describe(names) => {
                let names = all_of(names);
                Reply::Describe(names.iter().map(|name| self.describe(name)).collect())
            }
            Request::Set(parameters) => {
                let room = self.room(parameters.len());
                let one_by_one = parameters.chunks(1);
                let set = |one| room.clone().and_then(|()| self.set(one));
                Reply::Set(one_by_one.map(set).collect())
            }
            Request::SetAll(parameters) => {
                let room = self.room(parameters.len());
                Reply::SetAll(room.and_then(|()| self.set(parameters)))
            }
        }
    }

    /// Refuses to set more at once than there are.
    fn room(&self, count: usize) -> Result<(), String> {
        let most = self.names.len();
        match count > most {
            true => Err(format!("at most {most} parameters in a request")),
            false => Ok(()),
        }
    }

    fn type_number(&self, name: &str) -> u8 {
        self.parameters.value(name).type_number()
    }

    fn describe(&self, name: &str) -> Description {
        let read_only = Parameters::is_fixed(name);
        Description {
            name: name.to_owned(),
            type_number: self.type_number(name),
            text: description(name).to_owned(),
            constraints: match read_only {
                true => "read at the start".to_owned(),
                false => String::new(),
            },
            read_only,
        }
    }

    /// Sets all of these, or none.
    fn set(&mut self, values: &[(String, Value)]) -> Result<(), String> {
        let mut parameters = self.parameters.clone();
        for (name, value) in values {
            if !self.names.contains(name) {
                return Err(format!("unknown parameter `{name}`"));
            }
            parameters.set_running(name, value)?;
        }
        self.parameters = parameters;
        Ok(())
    }

    /// Gives the bridges what a request has changed, and logs it in one line. Returns the names of what has
    /// another value now: what is set for all sensors is a sensor's, too.
    fn changes(&self, before: &Parameters, bridges: &[&Bridge]) -> Vec<String> {
        if self.parameters == *before {
            return vec![];
        }
        for bridge in bridges {
            bridge.set_parameters(self.parameters.of(&bridge.name));
        }
        let mut changed = self.names.clone();
        changed.retain(|name| self.parameters.value(name) != before.value(name));
        let named = &changed[..changed.len().min(MOST_NAMED)];
        let more = match changed.len() - named.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        if !changed.is_empty() {
            log::info(format_args!("set by a client: {}{more}", named.join(", ")));
        }
        changed
    }
}

/// Whether a name begins with one of these, and has up to so many more parts; 0 is for any number.
fn is_listed(name: &str, prefixes: &[String], depth: u64) -> bool {
    let is_near = |rest: &str| depth == 0 || (rest.matches('.').count() as u64) < depth;
    if prefixes.is_empty() {
        return is_near(name);
    }
    prefixes.iter().any(|prefix| {
        let rest = name.strip_prefix(&prefix[..]);
        let rest = rest.and_then(|rest| rest.strip_prefix('.'));
        name == prefix || rest.is_some_and(is_near)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_listed_as_rcl_lists_them() {
        for (prefixes, depth, listed) in [
            (&[][..], 0, [true, true, true]),
            (&[], 1, [true, false, false]),
            (&["roof"], 0, [false, true, true]),
            (&["roof"], 1, [false, true, false]),
            (&["roo", "stamp"], 0, [true, false, false]),
        ] {
            let prefixes: Vec<String> = prefixes.iter().map(|one| (*one).to_owned()).collect();
            let names = ["stamp", "roof.stamp", "roof.2.stamp"];
            assert_eq!(names.map(|name| is_listed(name, &prefixes, depth)), listed);
        }
    }

    #[test]
    fn a_request_is_one_line_of_the_log_and_has_an_end() {
        let mut declared = Declared {
            parameters: Parameters::default(),
            names: Parameters::names(["roof"].into_iter()),
        };
        let before = declared.parameters.clone();
        let stamp = |value: &str| ("stamp".to_owned(), Value::Text(value.to_owned()));
        let organized = ("organized".to_owned(), Value::Bool(false));
        let set = vec![stamp("middle"), organized, stamp("last"), stamp("centre")];
        let Reply::Set(results) = declared.answer(&Request::Set(set)) else {
            panic!("no answer to a set");
        };
        let done: Vec<bool> = results.iter().map(Result::is_ok).collect();
        assert_eq!(done, [true, true, true, false]);
        assert_eq!(declared.changes(&before, &[]), ["stamp", "roof.stamp"]);
        let told = log::take().into_iter().map(|line| line.text);
        let told: Vec<String> = told.filter(|line| line.contains("by a client")).collect();
        assert_eq!(told, ["set by a client: stamp, roof.stamp"]);

        // Sixteen of the node, and nine of the sensor.
        let many = vec![stamp("first"); 26];
        let refused = Err("at most 25 parameters in a request".to_owned());
        let reply = declared.answer(&Request::Set(many.clone()));
        assert_eq!(reply, Reply::Set(vec![refused.clone(); 26]));
        let reply = declared.answer(&Request::SetAll(many));
        assert_eq!(reply, Reply::SetAll(refused));
        assert_eq!(
            declared.parameters.value("stamp"),
            Value::Text("last".into())
        );
    }
}
