//! A server that behaves as the web interface of a VLP-16 does: it has settings, takes forms, forgets
//! what is not saved. It is written from the manual (chapter 10) and the requests of public drivers, not
//! from the client. And it can fail as a device does.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use serde_json::{Value, json};

/// What is wrong with a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It takes connections and says nothing.
    Silent,
    /// It closes in the middle of an answer; a form is done before.
    ClosesHalfway,
    /// What should be JSON is not.
    Garbage,
    /// It answers without end.
    Huge,
    /// It answers 200 and does not do it.
    Ignores,
    /// It answers 400.
    Refuses,
}

/// Settings by path and field: `("fov", "start")`.
type Set = BTreeMap<(&'static str, &'static str), String>;

#[derive(Default)]
struct State {
    now: Set,
    saved: Set,
    /// The forms that came: path and body.
    forms: Vec<(String, String)>,
    connections: usize,
    /// From which form on, counted from 0, it fails; `None` fails from the first request on.
    fault: Option<(Option<usize>, Fault)>,
}

/// A running server; it ends when dropped.
pub struct WebPage {
    pub port: u16,
    state: Arc<Mutex<State>>,
    over: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl Default for WebPage {
    /// A VLP-16 as it leaves the factory.
    fn default() -> Self {
        Self::with(None)
    }
}

impl WebPage {
    /// One that fails from its first request on.
    pub fn failing(fault: Fault) -> Self {
        Self::with(Some((None, fault)))
    }

    /// One that fails from this form on, counted from 0.
    pub fn failing_from(form: usize, fault: Fault) -> Self {
        Self::with(Some((Some(form), fault)))
    }

    fn with(fault: Option<(Option<usize>, Fault)>) -> Self {
        let factory: Set = [
            (("", "laser"), "On"),
            (("", "returns"), "Strongest"),
            (("", "rpm"), "600"),
            (("fov", "start"), "0"),
            (("fov", "end"), "359"),
            (("phaselock", "enabled"), "Off"),
            (("phaselock", "offset"), "0"),
            (("host", "addr"), "255.255.255.255"),
            (("host", "dport"), "2368"),
            (("host", "tport"), "8308"),
        ]
        .map(|(key, value)| (key, value.to_owned()))
        .into();
        let state = Arc::new(Mutex::new(State {
            now: factory.clone(),
            saved: factory,
            fault,
            ..State::default()
        }));
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let over = Arc::new(AtomicBool::new(false));
        let (shared, until) = (Arc::clone(&state), Arc::clone(&over));
        let server = std::thread::spawn(move || {
            // One at a time, as a small computer does.
            for stream in listener.incoming().flatten() {
                if until.load(Ordering::Relaxed) {
                    return;
                }
                // A client that goes away is no fault of the server.
                let _ = serve(stream, &shared, &until);
            }
        });
        Self {
            port,
            state,
            over,
            server: Some(server),
        }
    }

    /// Where it is, for `sweepd sensor`.
    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// What it is set to: `("host", "addr")`.
    pub fn get(&self, path: &'static str, field: &'static str) -> String {
        self.state.lock().unwrap().now[&(path, field)].clone()
    }

    /// The forms that came so far: path and body.
    pub fn forms(&self) -> Vec<(String, String)> {
        self.state.lock().unwrap().forms.clone()
    }

    /// How often it was connected to.
    pub fn connections(&self) -> usize {
        self.state.lock().unwrap().connections
    }

    /// Takes its power away and gives it again.
    pub fn restart(&self) {
        let mut state = self.state.lock().unwrap();
        state.now = state.saved.clone();
    }
}

impl Drop for WebPage {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        // Wakes it up.
        let _ = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port));
        if let Some(server) = self.server.take() {
            let _ = server.join();
        }
    }
}

fn serve(mut stream: TcpStream, state: &Mutex<State>, until: &AtomicBool) -> std::io::Result<()> {
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    state.lock().unwrap().connections += 1;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut line = String::new();
    reader.read_line(&mut line)?;
    let mut words = line.split(' ');
    let method = words.next().unwrap_or_default().to_owned();
    let path = words.next().unwrap_or_default().to_owned();
    let mut length = 0;
    loop {
        line.clear();
        if reader.read_line(&mut line)? == 0 || line.trim().is_empty() {
            break;
        }
        if let Some((name, value)) = line.split_once(':')
            && name.eq_ignore_ascii_case("content-length")
        {
            length = value.trim().parse().unwrap_or(0);
        }
    }
    let mut body = vec![0; length.min(1000)];
    reader.read_exact(&mut body)?;
    let body = String::from_utf8_lossy(&body).into_owned();
    let fault = {
        let mut state = state.lock().unwrap();
        let is_form = method == "POST";
        if is_form {
            state.forms.push((path.clone(), body.clone()));
        }
        let count = state.forms.len();
        let fault = state.fault;
        fault.and_then(|(from, fault)| match from {
            None => Some(fault),
            // What is refused or ignored are forms, and one that is silent is so from then on.
            Some(from) if count > from && (is_form || fault == Fault::Silent) => Some(fault),
            Some(_) => None,
        })
    };
    match fault {
        Some(Fault::Silent) => {
            while !until.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(20));
                // The client has had enough.
                stream.set_nonblocking(true)?;
                if matches!(stream.peek(&mut [0]), Ok(0)) {
                    break;
                }
            }
            Ok(())
        }
        Some(Fault::ClosesHalfway) => {
            take(&mut state.lock().unwrap(), &path, &body);
            stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Le")
        }
        Some(Fault::Garbage) => answer(&mut stream, 200, "<html>{\"config\": </html>"),
        Some(Fault::Huge) => {
            stream.write_all(b"HTTP/1.1 200 OK\r\n\r\n{\"config\": \"")?;
            let many = [b'x'; 65_536];
            while !until.load(Ordering::Relaxed) {
                stream.write_all(&many)?;
            }
            Ok(())
        }
        Some(Fault::Ignores) => answer(&mut stream, 200, ""),
        Some(Fault::Refuses) => answer(&mut stream, 400, ""),
        None => {
            let (status, page) = match method.as_str() {
                "GET" => told(&state.lock().unwrap(), &path),
                _ => (
                    take(&mut state.lock().unwrap(), &path, &body),
                    String::new(),
                ),
            };
            answer(&mut stream, status, &page)
        }
    }
}

fn answer(stream: &mut TcpStream, status: u16, body: &str) -> std::io::Result<()> {
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status} -\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
}

/// Does what a form says, all or nothing; the status of the answer.
fn take(state: &mut State, path: &str, body: &str) -> u16 {
    if path == "/cgi/save" {
        if body == "submit" {
            state.saved = state.now.clone();
        }
        return if body == "submit" { 200 } else { 400 };
    }
    let Some(page) = path.strip_prefix("/cgi/setting") else {
        return 404;
    };
    let page = page.trim_start_matches('/');
    let mut next = state.now.clone();
    for pair in body.split('&') {
        let Some((field, value)) = pair.split_once('=') else {
            return 400;
        };
        let place = next.iter_mut().find(|(key, _)| **key == (page, field));
        let new = match (place, allowed(page, field, value)) {
            (Some(place), Some(new)) => (place.1, new),
            // The page sends the degrees as they were typed, too.
            (None, _) if (page, field) == ("phaselock", "offsetInput") => continue,
            _ => return 400,
        };
        *new.0 = new.1;
    }
    state.now = next;
    204
}

/// How a value is told once it is set; `None` for one that is not taken.
fn allowed(page: &str, field: &str, value: &str) -> Option<String> {
    let number: Option<u32> = value.parse().ok();
    let takes = match (page, field) {
        ("", "rpm") => number.is_some_and(|rpm| (300..=1200).contains(&rpm) && rpm % 60 == 0),
        ("", "returns") => ["Strongest", "Last", "Dual"].contains(&value),
        ("", "laser") | ("phaselock", "enabled") => {
            return match value {
                "on" => Some("On".to_owned()),
                "off" => Some("Off".to_owned()),
                _ => None,
            };
        }
        ("fov", _) => number.is_some_and(|degrees| degrees < 360),
        ("phaselock", "offset") => number.is_some_and(|at| at < 36_000),
        ("host", "addr") => value.parse::<Ipv4Addr>().is_ok(),
        ("host", _) => number.is_some_and(|port| (1..=65_535).contains(&port)),
        _ => false,
    };
    takes.then(|| value.to_owned())
}

/// A page that is asked for: numbers are numbers in one of two and text in the other, as firmwares
/// differ.
fn told(state: &State, path: &str) -> (u16, String) {
    let page = match path {
        "/cgi/snapshot.hdl" => json!({"config": settings(state, false)}),
        "/cgi/settings.json" => settings(state, true),
        "/cgi/status.json" => json!({
            "gps": {"pps_state": "Absent", "position": ""},
            "motor": {"state": "On", "rpm": 599, "lock": "Off", "phase": 30_755},
            "laser": {"state": "On"},
        }),
        "/cgi/info.json" => json!({"model": "VLP-16", "serial": "11002162040404"}),
        _ => return (404, "no such page".to_owned()),
    };
    (200, page.to_string())
}

fn settings(state: &State, has_phaselock: bool) -> Value {
    let mut settings = json!({});
    for (&(page, field), value) in &state.now {
        let value = match value.parse::<u32>() {
            Ok(number) if has_phaselock => json!(number),
            _ => json!(value),
        };
        match page {
            "phaselock" if !has_phaselock => {}
            "" => settings[field] = value,
            _ => settings[page][field] = value,
        }
    }
    settings
}
