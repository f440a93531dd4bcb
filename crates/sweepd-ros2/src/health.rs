//! `/diagnostics`: how each sensor is, by its sweeps and by what the daemon says.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use sweepd_client::client::Domain;
use sweepd_client::host::realtime_ns;
use sweepd_messages::diagnostics::{self, DAEMON, Level, Status};
use sweepd_ros2::{Node, Publisher, Subscriber};
use sweepd_sweep::Header;
use sweepd_sweep::eye::{eye_faults, eye_sentence};
use sweepd_sweep::height::HeightDoubt;

use crate::bridge::{Bridge, PATIENCE, Tally, Topic, USUAL_NOT_DESKEWED};

/// Longest wait for the daemon's answer, and longest answer in bytes.
const ANSWER_WITHIN: Duration = Duration::from_millis(200);
const ANSWER_BYTES: usize = 1 << 20;

/// Numbers of `/health` that are no counters, and what its words tell.
const UNTOLD: [&str; 3] = ["port", "position_port", "losses"];

/// Most values of a status with the numbers of the daemon, and longest name of one in bytes: anyone may answer in
/// the place of the daemon.
const MOST_VALUES: usize = 500;
const LONGEST_NAME: usize = 100;

/// Subscribers of a topic that are named for what they lost, those that lost most, and others with whom
/// something is wrong.
const MOST_NAMED: usize = 10;

/// Incomplete sweeps in a row that a run which ends and begins again has: its last and its first.
const USUAL_INCOMPLETE: u64 = 2;

/// The publisher of `/diagnostics`.
pub struct Diagnostics {
    publisher: Publisher,
    /// Where the daemon is asked, if it is.
    health: Option<SocketAddr>,
    /// The sums at the message before, and when that was.
    before: BTreeMap<String, (Instant, Tally)>,
}

impl Diagnostics {
    /// Nothing is known yet.
    pub fn new(publisher: Publisher, health: Option<SocketAddr>) -> Self {
        Self {
            publisher,
            health,
            before: BTreeMap::new(),
        }
    }

    /// Publishes how the sensors are, if somebody reads it.
    pub fn publish<'a>(
        &mut self,
        domain: &Domain,
        node: &Node,
        bridges: impl Iterator<Item = &'a Bridge>,
    ) {
        if self.publisher.readers() == 0 {
            return;
        }
        let daemon = self.health.map(|at| (at, of_this(ask(at), domain.root())));
        let mut statuses: Vec<Status> = daemon
            .iter()
            .map(|(at, said)| of_daemon(*at, said))
            .collect();
        for bridge in bridges {
            let said = daemon
                .as_ref()
                .and_then(|(_, said)| sensor(said, &bridge.name));
            statuses.push(self.of_sensor(bridge, said));
        }
        statuses.push(of_others(node.findings()));
        let mut message = Vec::new();
        diagnostics::encode(realtime_ns(), &statuses, &mut message);
        self.publisher.publish(message);
    }

    fn of_sensor(&mut self, bridge: &Bridge, said: Option<&Value>) -> Status {
        let (now, tally) = (Instant::now(), bridge.seen.tally());
        let before = self
            .before
            .insert(bridge.name.clone(), (now, tally.clone()));
        let (since, before) = before.unwrap_or_else(|| (now, tally.clone()));
        let seconds = now.duration_since(since).as_secs_f64();
        let sweeps = tally.sweeps.saturating_sub(before.sweeps);
        let rate = if seconds > 0.0 {
            sweeps as f64 / seconds
        } else {
            0.0
        };
        let (level, message) = judge(&tally, &before, rate, said);
        let mut values = Values::default();
        let mut hardware_id = String::new();
        if let Some((header, _)) = &tally.newest {
            (hardware_id, values.0) = diagnostics::of_header(header);
            let latency_ms = 1e3 * tally.latency.as_secs_f64();
            values.add("latency ms", format!("{latency_ms:.2}"));
        }
        values.add("sweeps/s", format!("{rate:.1}"));
        values.add("sweeps", tally.sweeps);
        values.add("incomplete sweeps", tally.incomplete_sweeps);
        values.add("missed sweeps", tally.missed_sweeps);
        values.add("lost packets", tally.lost_packets);
        values.add("dropped datagrams", tally.dropped_datagrams);
        values.add("missing columns", tally.missing_columns);
        if bridge.odometry.is_some() {
            let wait_ms = 1e3 * tally.odometry_wait.as_secs_f64();
            values.add("odometry wait ms", format!("{wait_ms:.1}"));
            values.add("deskewed sweeps", tally.deskewed_sweeps);
            values.add("not deskewed sweeps", tally.not_deskewed_sweeps);
        }
        for (topic, publisher) in Topic::ALL.into_iter().zip(&bridge.publishers) {
            let computed = bridge.seen.computed(topic);
            values.add_topic(topic.name(), computed, &publisher.statistics().subscribers);
        }
        let said = said.unwrap_or(&Value::Null);
        values.add_said(said, &["state", "gps", "temperature_c", "consumers"]);
        values.add_numbers("daemon ", said);
        Status {
            level,
            name: diagnostics::name_of(&bridge.name),
            message,
            hardware_id,
            values: values.0,
        }
    }
}

/// Keys and their values, in the order in which they are shown.
#[derive(Default)]
struct Values(Vec<(String, String)>);

impl Values {
    fn add(&mut self, key: impl Into<String>, value: impl ToString) {
        self.0.push((key.into(), value.to_string()));
    }

    /// The subscribers of a topic, how often it was computed, and what those lost that lost most.
    fn add_topic(&mut self, name: &str, computed: u64, subscribers: &[Subscriber]) {
        let lost: u64 = subscribers.iter().map(|one| one.lost_messages).sum();
        self.add(format!("{name} subscribers"), subscribers.len());
        self.add(format!("{name} computed"), computed);
        self.add(format!("{name} lost"), lost);
        let mut losers: Vec<&Subscriber> = subscribers.iter().collect();
        losers.retain(|one| one.lost_messages > 0);
        losers.sort_by_key(|one| Reverse(one.lost_messages));
        for one in losers.into_iter().take(MOST_NAMED) {
            let dropped = match one.dropped_datagrams {
                Some(dropped) => format!(", its socket dropped {dropped} datagrams"),
                None => String::new(),
            };
            let lost = format!("{} messages lost{dropped}", one.lost_messages);
            self.add(format!("{name} to {}", one.address), lost);
        }
    }

    /// What the daemon says under these keys, as far as it says something.
    fn add_said(&mut self, said: &Value, keys: &[&str]) {
        for &key in keys {
            match &said[key] {
                Value::Null => {}
                Value::String(text) => self.add(key, text),
                other => self.add(key, other),
            }
        }
    }

    /// Every number that the daemon says of a sensor or of a port, by its name there.
    fn add_numbers(&mut self, before: &str, said: &Value) {
        for (name, value) in said.as_object().into_iter().flatten() {
            let key = format!("{before}{name}");
            match value {
                _ if UNTOLD.contains(&&name[..]) => {}
                _ if key.len() > LONGEST_NAME || self.0.len() >= MOST_VALUES => {}
                Value::Number(number) => self.add(key, number),
                by_reason => self.add_numbers(&format!("{key} "), by_reason),
            }
        }
    }
}

/// Trouble that the header of a sweep tells: without a daemon that is asked, nothing else does.
fn by_header(header: &Header) -> Option<(Level, String)> {
    let level = match eye_faults(header.flags).any(|fault| fault.is_fault) {
        true => Level::Error,
        false => Level::Warn,
    };
    let doubt = HeightDoubt::of(header).map(|doubt| doubt.sentence(header.height_m));
    let said: Vec<String> = eye_sentence(header.flags)
        .into_iter()
        .chain(doubt)
        .collect();
    (!said.is_empty()).then(|| (level, said.join("; ")))
}

/// How a sensor is, in words: by what is worst.
fn judge(tally: &Tally, before: &Tally, rate: f64, said: Option<&Value>) -> (Level, String) {
    if let Some(trouble) = &tally.trouble {
        return (Level::Error, trouble.clone());
    }
    let reason = said.and_then(|said| said["reason"].as_str());
    let state = said.and_then(|said| said["state"].as_str());
    let words = match (state, reason) {
        (Some(state), Some(reason)) => format!("{state}: {reason}"),
        (Some(state), None) => state.to_owned(),
        _ => String::new(),
    };
    if said.is_some_and(|said| said["is_fault"] == true) {
        return (Level::Error, words);
    }
    match &tally.newest {
        None => return (Level::Stale, "no sweep yet".to_owned()),
        Some((_, at)) if at.elapsed() >= PATIENCE => {
            let seconds = at.elapsed().as_secs();
            return (Level::Stale, format!("no sweep for {seconds} s"));
        }
        Some(_) => {}
    }
    if reason.is_some() {
        return (Level::Warn, words);
    }
    let newest = tally.newest.as_ref();
    if let Some(told) = newest.and_then(|(header, _)| by_header(header)) {
        return told;
    }
    let left_out = tally.incomplete_in_a_row;
    if left_out > USUAL_INCOMPLETE {
        let message = format!(
            "nothing is published: the last {left_out} sweeps are no whole turns, or have too few columns"
        );
        return (Level::Warn, message);
    }
    let not_deskewed = tally
        .not_deskewed_sweeps
        .saturating_sub(before.not_deskewed_sweeps);
    if let Some(why) = &tally.not_deskewed
        && not_deskewed > USUAL_NOT_DESKEWED
    {
        let message = format!("{not_deskewed} sweeps are not deskewed: {why}");
        return (Level::Warn, message);
    }
    let lost = tally.lost_packets.saturating_sub(before.lost_packets);
    let dropped = tally
        .dropped_datagrams
        .saturating_sub(before.dropped_datagrams);
    if lost > 0 || dropped > 0 {
        let message =
            format!("{lost} packets lost and {dropped} datagrams dropped since the message before");
        return (Level::Warn, message);
    }
    (Level::Ok, format!("streaming, {rate:.1} sweeps/s"))
}

/// What the daemon says, if it is the one whose sweeps come from `root`.
fn of_this(said: Result<Value, String>, root: &Path) -> Result<Value, String> {
    let said = said?;
    match said["root"].as_str() {
        Some(its) if Path::new(its) != root => Err(format!(
            "the daemon there shares its sweeps in {its}, these come from {}",
            root.display()
        )),
        _ => Ok(said),
    }
}

/// How others on the domain get on with this node.
fn of_others(mut findings: Vec<String>) -> Status {
    let more = findings.len().saturating_sub(MOST_NAMED);
    findings.truncate(MOST_NAMED);
    let (level, message) = match (findings.is_empty(), more) {
        (true, _) => (Level::Ok, "nothing is wrong with others".to_owned()),
        (false, 0) => (Level::Warn, findings.join("; ")),
        (false, more) => (
            Level::Warn,
            format!("{}; and {more} more", findings.join("; ")),
        ),
    };
    Status {
        level,
        name: diagnostics::name_of("ROS 2"),
        message,
        hardware_id: String::new(),
        values: vec![],
    }
}

fn of_daemon(at: SocketAddr, said: &Result<Value, String>) -> Status {
    let (level, message) = match said {
        Ok(said) => {
            let reasons = said["reasons"].as_array();
            let reasons: Vec<&str> = reasons
                .into_iter()
                .flatten()
                .filter_map(Value::as_str)
                .collect();
            let level = match said["status"].as_str() {
                Some("ok") => Level::Ok,
                Some("warning") => Level::Warn,
                _ => Level::Error,
            };
            let message = if reasons.is_empty() {
                "all sensors stream".to_owned()
            } else {
                reasons.join("; ")
            };
            (level, message)
        }
        Err(why) => (Level::Stale, format!("its health is not known: {why}")),
    };
    let mut values = Values::default();
    values.add("health", format!("http://{at}/health"));
    let said = said.as_ref().unwrap_or(&Value::Null);
    values.add_said(said, &["version", "pid", "uptime_s", "root"]);
    for port in said["ports"].as_array().into_iter().flatten() {
        let name = port["name"].as_str().unwrap_or("port");
        values.add_numbers(&format!("{name} "), port);
    }
    Status {
        level,
        name: DAEMON.to_owned(),
        message,
        hardware_id: String::new(),
        values: values.0,
    }
}

/// What the daemon says of a sensor.
fn sensor<'a>(said: &'a Result<Value, String>, name: &str) -> Option<&'a Value> {
    let sensors = said.as_ref().ok()?["sensors"].as_array()?;
    sensors.iter().find(|one| one["name"] == name)
}

/// The daemon's `/health`; the error says in a few words why there is none.
fn ask(at: SocketAddr) -> Result<Value, String> {
    let answer = get(at).map_err(|error| format!("no answer from {at}: {error}"))?;
    let (_, body) = answer
        .split_once("\r\n\r\n")
        .ok_or_else(|| format!("what answers at {at} is no web server"))?;
    serde_json::from_str(body).map_err(|error| format!("the answer of {at} is no JSON: {error}"))
}

fn get(at: SocketAddr) -> io::Result<String> {
    let deadline = Instant::now() + ANSWER_WITHIN;
    let mut stream = TcpStream::connect_timeout(&at, ANSWER_WITHIN)?;
    stream.set_write_timeout(Some(ANSWER_WITHIN))?;
    stream.write_all(format!("GET /health HTTP/1.0\r\nHost: {at}\r\n\r\n").as_bytes())?;
    let (mut answer, mut buffer) = (Vec::new(), [0; 4096]);
    while answer.len() < ANSWER_BYTES {
        // One limit for all of it: who sends a byte now and then must not hold this program up.
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(bytes) => answer.extend_from_slice(&buffer[..bytes]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    String::from_utf8(answer).map_err(|_| io::ErrorKind::InvalidData.into())
}

/// Reads an answer of anyone at `/health`, and sees that the message made of it is not much longer.
#[cfg(any(test, fuzzing))]
pub fn fuzz(input: &[u8]) {
    let said = serde_json::from_slice(input).map_err(|error| error.to_string());
    let said = of_this(said, Path::new("/run/sweepd"));
    let mut status = of_daemon(SocketAddr::from(([127, 0, 0, 1], 9177)), &said);
    let tally = Tally::default();
    let sensor = sensor(&said, "roof");
    let (_, words) = judge(&tally, &tally, 0.0, sensor);
    let mut values = Values(std::mem::take(&mut status.values));
    values.add("words", words);
    values.add_numbers("daemon ", sensor.unwrap_or(&Value::Null));
    status.values = values.0;
    let mut message = Vec::new();
    diagnostics::encode(0, &[status], &mut message);
    let most = 4096 + 200 * input.len();
    assert!(
        message.len() <= most,
        "{} bytes of {}",
        message.len(),
        input.len()
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::NotDeskewed;
    use serde_json::json;
    use std::net::TcpListener;

    /// A server that gives this answer once.
    fn server(answer: &'static str) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let at = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 1024];
            let _ = stream.read(&mut request).unwrap();
            stream.write_all(answer.as_bytes()).unwrap();
        });
        at
    }

    #[test]
    fn a_server_that_drips_is_left() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let at = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            // Until who asks has gone.
            while stream.write_all(b"x").is_ok() {
                std::thread::sleep(ANSWER_WITHIN / 10);
            }
        });
        assert!(ask(at).unwrap_err().starts_with("no answer"));
    }

    #[test]
    fn the_daemon_is_asked_and_a_strange_answer_is_named() {
        let answer = "HTTP/1.0 503 Service Unavailable\r\nContent-Type: application/json\r\n\r\n{\"status\": \"fault\"}";
        // The server's thread may get no core within the time for an answer.
        let asked = |answer| {
            let mut tries = (0..20).map(|_| ask(server(answer)));
            let is_answer = |said: &Result<Value, String>| !matches!(said, Err(why) if why.starts_with("no answer"));
            tries.find(is_answer).expect("an answer")
        };
        assert_eq!(asked(answer), Ok(json!({"status": "fault"})));
        for (answer, part) in [
            ("SSH-2.0", "no web server"),
            ("HTTP/1.0 200 OK\r\n\r\n<html>", "no JSON"),
        ] {
            assert!(asked(answer).unwrap_err().contains(part), "{answer}");
        }
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let silent = ask(listener.local_addr().unwrap()).unwrap_err();
        assert!(silent.starts_with("no answer from 127.0.0.1:"), "{silent}");
    }

    #[test]
    fn numbers_of_anyone_take_no_more_room_than_those_of_a_daemon() {
        let numbers: Vec<String> = (0..1000).map(|number| format!("\"{number}\":1")).collect();
        let numbers = numbers.join(",");
        for (text, added) in [
            (format!("{{{numbers}}}"), MOST_VALUES),
            (format!("{{\"{}\": {{{numbers}}}}}", "a".repeat(8192)), 0),
        ] {
            let mut values = Values::default();
            values.add_numbers("", &serde_json::from_str(&text).unwrap());
            assert_eq!(values.0.len(), added);
        }
    }

    #[test]
    fn a_number_of_health_that_nobody_knows_is_told() {
        let roof = json!({"name": "roof", "scratched": 271});
        let ports = json!([{"name": "127.0.0.1:2368", "scrubbed": {"soap": 300}}]);
        let said = Ok(json!({"sensors": [roof], "ports": ports}));
        let at = SocketAddr::from(([127, 0, 0, 1], 9177));
        let mut values = Values(of_daemon(at, &said).values);
        values.add_numbers("daemon ", sensor(&said, "roof").unwrap());
        for (key, value) in [
            ("daemon scratched", "271"),
            ("127.0.0.1:2368 scrubbed soap", "300"),
        ] {
            let told = (key.to_owned(), value.to_owned());
            assert!(values.0.contains(&told), "{:?}", values.0);
        }
    }

    #[test]
    fn a_daemon_of_another_root_is_not_this_one() {
        let (root, other) = (Path::new("/run/a"), Path::new("/run/b"));
        let said = json!({"root": "/run/a", "status": "ok", "sensors": [{"name": "roof"}]});
        let this = of_this(Ok(said.clone()), root);
        assert_eq!(sensor(&this, "roof"), Some(&json!({"name": "roof"})));
        assert_eq!(sensor(&this, "front"), None);
        let foreign = of_this(Ok(said), other);
        assert!(foreign.as_ref().unwrap_err().contains("/run/a"));
        let status = of_daemon(server(""), &foreign);
        assert_eq!((status.level, &status.name[..]), (Level::Stale, "sweepd"));
    }

    #[test]
    fn the_worst_is_what_a_sensor_is_said_to_be() {
        let seen = |lost_packets, age_s| {
            let newest = Instant::now()
                .checked_sub(Duration::from_secs(age_s))
                .unwrap();
            Tally {
                lost_packets,
                newest: Some((header(), newest)),
                ..Tally::default()
            }
        };
        let (none, well) = (Tally::default(), seen(0, 0));
        let in_parts = |incomplete_in_a_row| Tally {
            incomplete_in_a_row,
            ..seen(0, 0)
        };
        let not_deskewed = |not_deskewed_sweeps| Tally {
            not_deskewed_sweeps,
            not_deskewed: Some(NotDeskewed::Silent {
                what: "nothing".to_owned(),
                topic: "/odom".to_owned(),
            }),
            ..seen(0, 0)
        };
        let unreadable = Tally {
            trouble: Some("another user's".to_owned()),
            ..Tally::default()
        };
        let fault = json!({"state": "wrong model", "reason": "an HDL-32E sends", "is_fault": true});
        let losing = json!({"state": "losing packets", "reason": "0.1 %", "is_fault": false});
        let streaming = json!({"state": "streaming", "reason": null, "is_fault": false});
        for (tally, said, level, message) in [
            (&well, None, Level::Ok, "streaming, 10.0 sweeps/s"),
            (
                &well,
                Some(&streaming),
                Level::Ok,
                "streaming, 10.0 sweeps/s",
            ),
            (&well, Some(&losing), Level::Warn, "losing packets: 0.1 %"),
            (
                &well,
                Some(&fault),
                Level::Error,
                "wrong model: an HDL-32E sends",
            ),
            (
                &seen(3, 0),
                None,
                Level::Warn,
                "3 packets lost and 0 datagrams dropped since the message before",
            ),
            (&in_parts(2), None, Level::Ok, "streaming, 10.0 sweeps/s"),
            (
                &not_deskewed(2),
                None,
                Level::Ok,
                "streaming, 10.0 sweeps/s",
            ),
            (
                &not_deskewed(3),
                None,
                Level::Warn,
                "3 sweeps are not deskewed: nothing comes on /odom",
            ),
            (
                &in_parts(3),
                Some(&streaming),
                Level::Warn,
                "nothing is published: the last 3 sweeps are no whole turns, or have too few columns",
            ),
            (&seen(0, 5), Some(&losing), Level::Stale, "no sweep for 5 s"),
            (&none, None, Level::Stale, "no sweep yet"),
            (
                &unreadable,
                Some(&streaming),
                Level::Error,
                "another user's",
            ),
        ] {
            let judged = judge(tally, &none, 10.0, said);
            assert_eq!(judged, (level, message.to_owned()));
        }
    }

    #[test]
    fn a_height_in_doubt_is_a_warning_by_the_header_where_no_daemon_is_asked() {
        let mut header = header();
        header.height_m = 1.2;
        header.height_doubt = HeightDoubt::Small { far_dm: 9 }.word();
        let tally = Tally {
            newest: Some((header, Instant::now())),
            ..Tally::default()
        };
        let message = "the height is a guess: 1.20 m; it ends 0.9 m from the sensor: it may be the robot's deck, or a table: \
                       set height_m";
        let judged = judge(&tally, &Tally::default(), 10.0, None);
        assert_eq!(judged, (Level::Warn, message.to_owned()));
    }

    #[test]
    fn the_header_tells_what_is_not_seen_where_no_daemon_is_asked() {
        use sweepd_sweep::layout::flags;
        for (bits, level, begins) in [
            (0, Level::Ok, "streaming"),
            (flags::DARK_BELOW, Level::Warn, "dark below the horizon: "),
            (flags::BLIND | flags::DARK_BELOW, Level::Error, "blind: "),
        ] {
            let mut header = header();
            header.flags = bits;
            let tally = Tally {
                newest: Some((header, Instant::now())),
                ..Tally::default()
            };
            let (judged, message) = judge(&tally, &Tally::default(), 10.0, None);
            assert_eq!(judged, level);
            assert!(message.starts_with(begins), "{message}");
        }
    }

    fn header() -> Header {
        Header::new(&sweepd_sweep::layout::Shape {
            rows: 16,
            columns_capacity: 1,
            dual: false,
            segments_capacity: 0,
        })
    }
}
