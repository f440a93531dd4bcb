//! The services for parameters, which every node of ROS has: they are listed, got, described, and set where
//! that can be while the node runs.

use std::collections::BTreeSet;

use sweepd_messages::rcl::{Description, PARAMETER_SERVICES, Reply, Request, Value};
use sweepd_ros2::{Node, NodeError, Service, log};

use crate::bridge::Bridge;
use crate::parameters::{Parameters, SensorParameters, description};

/// Requests of one service that are answered before the node looks after other things.
const AT_ONCE: usize = 10;

/// Parameters that one request sets, and of those the ones that the log names.
const MOST_SET: usize = 100;
const MOST_NAMED: usize = 10;

/// The services, and the parameters as they are now.
pub struct Services {
    services: Vec<Service>,
    parameters: Parameters,
}

impl Services {
    /// Offers them.
    ///
    /// # Errors
    /// The node's name leaves no room for theirs.
    pub fn new(node: &Node, parameters: &Parameters) -> Result<Self, NodeError> {
        let services = PARAMETER_SERVICES.iter();
        let services: Result<Vec<Service>, NodeError> =
            services.map(|service| node.service(service)).collect();
        Ok(Self {
            services: services?,
            parameters: parameters.clone(),
        })
    }

    /// How a sensor is to be published now.
    pub fn of(&self, sensor: &str) -> SensorParameters {
        self.parameters.of(sensor)
    }

    /// Answers the requests that wait. Says whether others may wait already; if not, the thread is unparked
    /// when one comes.
    pub fn serve(&mut self, bridges: &[&Bridge]) -> bool {
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
                let mut reply = Vec::new();
                self.answer(&asked, bridges).encode(&mut reply);
                self.services[index].answer(&request, reply);
            }
            is_busy |= self.services[index].has_early();
        }
        is_busy
    }

    fn answer(&mut self, asked: &Request, bridges: &[&Bridge]) -> Reply {
        let known = Parameters::names(bridges.iter().map(|bridge| &bridge.name[..]));
        // As rclpy: where one name is unknown, nothing is told.
        let all_of = |names: &[String]| match names.iter().all(|name| known.contains(name)) {
            true => names.to_vec(),
            false => vec![],
        };
        match asked {
            Request::List(prefixes, depth) => {
                let mut names = known;
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
                let before = self.parameters.clone();
                let mut results = vec![too_many(parameters.len()); parameters.len()];
                if parameters.len() <= MOST_SET {
                    let one_by_one = parameters.chunks(1);
                    results = one_by_one.map(|one| self.set(one, &known)).collect();
                }
                self.tell_changes(&before, parameters, bridges);
                Reply::Set(results)
            }
            Request::SetAll(parameters) => {
                let before = self.parameters.clone();
                let result = too_many(parameters.len());
                let result = result.and_then(|()| self.set(parameters, &known));
                self.tell_changes(&before, parameters, bridges);
                Reply::SetAll(result)
            }
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
    fn set(&mut self, values: &[(String, Value)], known: &[String]) -> Result<(), String> {
        let mut parameters = self.parameters.clone();
        for (name, value) in values {
            if !known.contains(name) {
                return Err(format!("unknown parameter `{name}`"));
            }
            parameters.set_running(name, value)?;
        }
        self.parameters = parameters;
        Ok(())
    }

    /// Gives the bridges what a request has changed, and tells of it in one line of the log.
    fn tell_changes(&self, before: &Parameters, set: &[(String, Value)], bridges: &[&Bridge]) {
        if self.parameters == *before {
            return;
        }
        for bridge in bridges {
            bridge.set_parameters(self.parameters.of(&bridge.name));
        }
        let names = set.iter().map(|(name, _)| &name[..]);
        let changed = |name: &&str| self.parameters.value(name) != before.value(name);
        let names: BTreeSet<&str> = names.filter(changed).collect();
        let named: Vec<&str> = names.iter().copied().take(MOST_NAMED).collect();
        let more = match names.len() - named.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        log::info(format_args!("set by a client: {}{more}", named.join(", ")));
    }
}

/// Refuses to set so many at once.
fn too_many(count: usize) -> Result<(), String> {
    match count > MOST_SET {
        true => Err(format!("at most {MOST_SET} parameters in a request")),
        false => Ok(()),
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
        let mut services = Services {
            services: vec![],
            parameters: Parameters::default(),
        };
        let stamp = |value: &str| ("stamp".to_owned(), Value::Text(value.to_owned()));
        let organized = ("organized".to_owned(), Value::Bool(false));
        let set = vec![stamp("middle"), organized, stamp("last"), stamp("centre")];
        let Reply::Set(results) = services.answer(&Request::Set(set), &[]) else {
            panic!("no answer to a set");
        };
        let done: Vec<bool> = results.iter().map(Result::is_ok).collect();
        assert_eq!(done, [true, true, true, false]);
        let told = log::take().into_iter().map(|line| line.text);
        let told: Vec<String> = told.filter(|line| line.contains("by a client")).collect();
        assert_eq!(told, ["set by a client: stamp"]);

        let many = vec![stamp("first"); 101];
        let refused = Err("at most 100 parameters in a request".to_owned());
        let reply = services.answer(&Request::Set(many.clone()), &[]);
        assert_eq!(reply, Reply::Set(vec![refused.clone(); 101]));
        let reply = services.answer(&Request::SetAll(many), &[]);
        assert_eq!(reply, Reply::SetAll(refused));
        assert_eq!(
            services.parameters.value("stamp"),
            Value::Text("last".into())
        );
    }
}
