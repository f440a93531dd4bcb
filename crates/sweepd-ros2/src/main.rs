//! `sweepd-ros2`: the sweeps that a daemon shares, as topics of a ROS 2 node.

// The fuzzer has a `main` of its own, in C++.
#![cfg_attr(not(fuzzing), forbid(unsafe_code))]
#![cfg_attr(fuzzing, no_main, allow(dead_code))]

mod bridge;
mod clock;
#[cfg(any(test, fuzzing))]
mod fuzz;
mod health;
mod names;
mod odometry;
mod parameters;
#[cfg(test)]
mod rcl;
mod ros_args;
mod services;
mod track;
mod transforms;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::io;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

use clap::Parser;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use sweepd_client::client::{Client, Domain};
use sweepd_messages::MessageType;
use sweepd_messages::message_type::{self, DIAGNOSTIC_ARRAY, TF_MESSAGE};
use sweepd_messages::rcl::encode_log;
use sweepd_ros2::args::Args;
use sweepd_ros2::{Durability, Environment, Node, NodeError, Publisher, log};

use crate::bridge::{Bridge, Seen, Topic};
use crate::health::Diagnostics;
use crate::names::{NodeName, Remap, token};
use crate::odometry::Odometry;
use crate::parameters::{ParameterError, Parameters};
use crate::ros_args::RosArgs;
use crate::services::Services;
use crate::transforms::Transforms;

/// Between looks for the first sweep, and for the next request of a client that has just been answered.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Signals that end the program.
const ENDS: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];
/// Between searches for sensors that are new.
const SEARCH_EVERY: Duration = Duration::from_millis(500);
/// Between messages of `/diagnostics`.
const DIAGNOSE_EVERY: Duration = Duration::from_secs(1);

/// The topics beside those of the sensors.
const DIAGNOSTICS: &str = "/diagnostics";
const TF_STATIC: &str = "/tf_static";
const CLOCK: &str = "/clock";

/// Exit code where a file that was given is not there, is a folder, or may not be read (sysexits.h): a
/// supervisor need not retry.
const EX_NOINPUT: u8 = 66;
/// Exit code where only other parameters help: it need not, either.
const EX_CONFIG: u8 = 78;

/// Why the program ends, and its exit code.
struct Failure {
    what: String,
    code: u8,
}

fn main() -> ExitCode {
    let (ros, words) = match RosArgs::split(std::env::args_os()) {
        Ok(split) => split,
        Err(what) => {
            log::error(what);
            return ExitCode::from(2);
        }
    };
    match run(&Args::parse_from(words), &ros) {
        Ok(code) => code,
        Err(failure) => failure.tell(),
    }
}

/// Returns the exit code; an error after the node was there is told by then.
fn run(args: &Args, ros: &RosArgs) -> Result<ExitCode, Failure> {
    let name = NodeName::remapped(&args.namespace, &args.node, &ros.remaps);
    let parameters = Parameters::of_command_line(args, ros, &name)?;
    for ignored in &parameters.ignored {
        log::warn(format_args!("{ignored}"));
    }
    let environment = Environment::from_env().map_err(Failure::config)?;
    let over = end_flag().map_err(|error| Failure::cannot("handle signals", &error))?;
    let node = Node::new(&environment, &name.namespace, &name.name)?;
    let rosout = (!ros.without_rosout).then(|| Rosout {
        publisher: node.rosout(),
        logger: name.full().trim_start_matches('/').replace('/', "."),
    });
    let services = Services::new(&node, name.full(), &parameters)?;
    let domain = Domain::at_or_default(parameters.root.as_deref());
    log::info(format_args!(
        "node {} on ROS domain {}, sweeps from {}",
        name.full(),
        environment.domain,
        domain.root().display()
    ));
    let graph = Graph {
        node: &node,
        name: &name,
        remaps: &ros.remaps,
    };
    let transforms = graph.transforms(&parameters)?;
    let odometry = graph.odometry(&parameters)?;
    let diagnostics = graph.publisher(DIAGNOSTICS, &DIAGNOSTIC_ARRAY, Durability::Volatile)?;
    let clock = match parameters.clock {
        false => None,
        true => Some(graph.publisher(CLOCK, &message_type::CLOCK, Durability::Volatile)?),
    };
    thread::scope(|scope| {
        let sensors = Sensors {
            scope,
            graph,
            parameters: &parameters,
            domain: &domain,
            transforms: transforms.as_ref(),
            odometry,
            clock,
            over: &over,
            bridges: BTreeMap::new(),
            refused: BTreeSet::new(),
            remaps_are_told: false,
            services,
            rosout: rosout.as_ref(),
        };
        let code = match sensors.watch(Diagnostics::new(diagnostics, parameters.health)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => failure.tell(),
        };
        // After an error too, or the threads would go on.
        over.store(true, Ordering::Relaxed);
        if let Some(rosout) = &rosout {
            rosout.publish();
        }
        Ok(code)
    })
}

impl Failure {
    /// Tells of it.
    fn tell(self) -> ExitCode {
        log::error(self.what);
        ExitCode::from(self.code)
    }

    fn config(error: impl Display) -> Self {
        Self {
            what: error.to_string(),
            code: EX_CONFIG,
        }
    }

    fn cannot(what: &str, error: &io::Error) -> Self {
        Self {
            what: format!("cannot {what}: {error}"),
            code: 1,
        }
    }
}

impl From<ParameterError> for Failure {
    fn from(error: ParameterError) -> Self {
        Self {
            what: error.to_string(),
            code: error.exit,
        }
    }
}

impl From<NodeError> for Failure {
    fn from(error: NodeError) -> Self {
        let code = match error {
            NodeError::Name { .. } => EX_CONFIG,
            _ => 1,
        };
        Self {
            what: error.to_string(),
            code,
        }
    }
}

/// A flag that is set when the program must end, for which this thread is unparked; a second signal ends
/// the program at once.
fn end_flag() -> io::Result<Arc<AtomicBool>> {
    let over = Arc::new(AtomicBool::new(false));
    for signal in ENDS {
        flag::register_conditional_default(signal, Arc::clone(&over))?;
        flag::register(signal, Arc::clone(&over))?;
    }
    let (mut signals, this) = (Signals::new(ENDS)?, thread::current());
    let unpark = move || signals.forever().for_each(|_| this.unpark());
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(unpark)?;
    Ok(over)
}

/// The log, as others see it.
struct Rosout {
    publisher: Publisher,
    /// Who writes it.
    logger: String,
}

impl Rosout {
    /// Publishes the lines that wait.
    fn publish(&self) {
        for line in log::take() {
            let mut message = self.publisher.buffer();
            encode_log(
                line.stamp_ns,
                line.level,
                &self.logger,
                &line.text,
                &mut message,
            );
            self.publisher.publish(message);
        }
    }
}

/// The node, and the rules for its names.
struct Graph<'a> {
    node: &'a Node,
    name: &'a NodeName,
    remaps: &'a [Remap],
}

impl Graph<'_> {
    fn publisher(
        &self,
        topic: &str,
        message_type: &'static MessageType,
        durability: Durability,
    ) -> Result<Publisher, NodeError> {
        let topic = self.name.remapped_topic(topic, self.remaps);
        self.node.publisher(&topic, message_type, durability)
    }

    fn transforms(&self, parameters: &Parameters) -> Result<Option<Transforms>, NodeError> {
        let base = &parameters.base_frame[..];
        if base.is_empty() {
            return Ok(None);
        }
        let publisher = self.publisher(TF_STATIC, &TF_MESSAGE, Durability::TransientLocal)?;
        Ok(Some(Transforms::new(publisher, base)))
    }

    fn odometry(&self, parameters: &Parameters) -> Result<Option<Arc<Odometry>>, NodeError> {
        let Some(source) = parameters.deskew else {
            return Ok(None);
        };
        let topic = source.topic(&parameters.odometry);
        let topic = self.name.remapped_topic(topic, self.remaps);
        let odometry = Odometry::new(self.node, source, &topic, &parameters.base_frame)?;
        Ok(Some(Arc::new(odometry)))
    }
}

/// The sensors, each with a thread.
struct Sensors<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    graph: Graph<'env>,
    parameters: &'env Parameters,
    domain: &'env Domain,
    transforms: Option<&'env Transforms>,
    odometry: Option<Arc<Odometry>>,
    /// Publisher of the time of the first sensor that has sweeps, until there is one.
    clock: Option<Publisher>,
    over: &'env AtomicBool,
    /// By the token in their topics.
    bridges: BTreeMap<String, Arc<Bridge>>,
    /// Sensors whose token another one has.
    refused: BTreeSet<String>,
    remaps_are_told: bool,
    services: Services,
    rosout: Option<&'env Rosout>,
}

impl Sensors<'_, '_> {
    /// Looks after the sensors until the program is over.
    fn watch(mut self, mut diagnostics: Diagnostics) -> Result<(), Failure> {
        for name in &self.parameters.sensors {
            self.add(name)?;
        }
        let start = Instant::now();
        let mut diagnose_at = start + DIAGNOSE_EVERY;
        // Those with names are not searched for.
        let mut search_at = self.parameters.sensors.is_empty().then_some(start);
        let mut trouble = None;
        while !self.over.load(Ordering::Relaxed) {
            let now = Instant::now();
            let mut is_settled = search_at.is_none();
            if search_at.is_some_and(|at| at <= now) {
                search_at = Some(now + SEARCH_EVERY);
                let known = self.bridges.len();
                self.search(&mut trouble)?;
                // A daemon that starts publishes one sensor after another.
                is_settled = known == self.bridges.len();
            }
            if is_settled && !self.bridges.is_empty() && !self.remaps_are_told {
                self.remaps_are_told = true;
                self.tell_remaps();
            }
            self.start_clock()?;
            if diagnose_at <= now {
                diagnose_at += DIAGNOSE_EVERY;
                if diagnose_at <= now {
                    diagnose_at = now + DIAGNOSE_EVERY;
                }
                let bridges = self.bridges.values().map(|bridge| &**bridge);
                diagnostics.publish(self.domain, self.graph.node, bridges);
            }
            let bridges: Vec<&Bridge> = self.bridges.values().map(|bridge| &**bridge).collect();
            let is_busy = self.services.serve(&bridges);
            if let Some(rosout) = self.rosout {
                rosout.publish();
            }
            if is_busy || self.clock.is_some() {
                thread::sleep(LOOK_EVERY);
            } else {
                // Until then there is something to do for a request, a line of the log or a signal alone.
                let next = search_at.map_or(diagnose_at, |at| at.min(diagnose_at));
                thread::park_timeout(next.saturating_duration_since(Instant::now()));
            }
        }
        Ok(())
    }

    /// What is published of each sensor.
    fn topics(&self) -> &'static [Topic] {
        Topic::published(self.odometry.is_some())
    }

    /// Starts `/clock` with the first sweep, if it is wanted: of several sensors, one has the time.
    fn start_clock(&mut self) -> Result<(), Failure> {
        if self.clock.is_none() {
            return Ok(());
        }
        let has_sweeps = |bridge: &&Arc<Bridge>| bridge.seen.newest().is_some();
        let Some(bridge) = self.bridges.values().find(has_sweeps) else {
            return Ok(());
        };
        let Some(publisher) = self.clock.take() else {
            return Ok(());
        };
        log::info(format_args!(
            "{}: {} is the time of its sweeps, and of no other sensor's",
            bridge.name,
            publisher.topic()
        ));
        let (bridge, over) = (Arc::clone(bridge), self.over);
        thread::Builder::new()
            .name("clock".to_owned())
            .spawn_scoped(self.scope, move || clock::run(&publisher, &bridge, over))
            .map_err(|error| Failure::cannot("start a thread", &error))?;
        Ok(())
    }

    /// Warns of the rules that rename nothing, once the first sensors are there.
    fn tell_remaps(&self) {
        let tokens = self.bridges.keys();
        let of_sensor = self.topics();
        let mut topics: Vec<String> = tokens
            .flat_map(|token| of_sensor.iter().map(|topic| topic.of(token)))
            .collect();
        topics.extend([TF_STATIC, DIAGNOSTICS].map(str::to_owned));
        topics.extend(self.parameters.clock.then(|| CLOCK.to_owned()));
        let source = self.parameters.deskew;
        topics.extend(source.map(|source| source.topic(&self.parameters.odometry).to_owned()));
        for remap in self.graph.remaps {
            let moves = |topic: &String| self.graph.name.moves(remap, topic);
            if !self.graph.name.is_renamed_by(remap) && !topics.iter().any(moves) {
                log::warn(format_args!(
                    "the rule `{}` renames nothing so far: the node is {}, its topics are {}",
                    remap.rule,
                    self.graph.name.full(),
                    topics.join(", ")
                ));
            }
        }
    }

    /// Adds the sensors that are new. A trouble is told once.
    fn search(&mut self, trouble: &mut Option<String>) -> Result<(), Failure> {
        match Client::sensors(self.domain) {
            Ok(names) => {
                *trouble = None;
                names.iter().try_for_each(|name| self.add(name))
            }
            Err(error) => {
                let now = error.to_string();
                if trouble.as_ref() != Some(&now) {
                    log::warn(format_args!("{now}"));
                    *trouble = Some(now);
                }
                Ok(())
            }
        }
    }

    fn add(&mut self, sensor: &str) -> Result<(), Failure> {
        let token = token(sensor);
        if let Some(other) = self.bridges.get(&token) {
            if other.name != sensor && self.refused.insert(sensor.to_owned()) {
                log::warn(format_args!(
                    "{sensor}: not published: its topics would be those of {}",
                    other.name
                ));
            }
            return Ok(());
        }
        let publishers: Result<Vec<Publisher>, NodeError> = self
            .topics()
            .iter()
            .map(|topic| {
                let (name, durability) = (topic.of(&token), Durability::Volatile);
                self.graph
                    .publisher(&name, topic.message_type(), durability)
            })
            .collect();
        let bridge = Arc::new(Bridge {
            name: sensor.to_owned(),
            parameters: Mutex::new(Arc::new(self.services.of(sensor))),
            odometry: self.odometry.clone(),
            publishers: publishers?,
            seen: Seen::default(),
        });
        self.bridges.insert(token, Arc::clone(&bridge));
        let (domain, transforms, over) = (self.domain, self.transforms, self.over);
        thread::Builder::new()
            .name(sensor.to_owned())
            .spawn_scoped(self.scope, move || bridge.run(domain, transforms, over))
            .map_err(|error| Failure::cannot("start a thread", &error))?;
        Ok(())
    }
}

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(init: fuzz::write_seeds(), |input: &[u8]| fuzz::run(input));
