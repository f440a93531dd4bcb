//! The web interface of a sensor: its settings read, set and kept.
//!
//! VLP-16, Puck LITE and Hi-Res, VLP-32C, VLS-128, and an HDL-32E of newer firmware have one; an
//! HDL-64E has none.
//!
//! ```text
//! GET  /cgi/snapshot.hdl        the settings, in `config`
//! GET  /cgi/settings.json       the same, as the sensor's own page reads them
//! GET  /cgi/status.json         speed, phase, pulse per second
//! GET  /cgi/info.json           model and serial number
//! POST /cgi/setting             laser=on, returns=Dual, rpm=600
//! POST /cgi/setting/fov         start=270&end=90, degrees
//! POST /cgi/setting/phaselock   enabled=on&offset=18000&offsetInput=180, offset in hundredths of a degree
//! POST /cgi/setting/host        addr=192.168.1.100, dport=2368, tport=8308
//! POST /cgi/save                submit: what is set outlasts the loss of power
//! ```
//!
//! Sources: VLP-16 User Manual 63-9243 Rev. D and VLP-32C User Manual 63-9325, chapter 10, for all but
//! `settings.json` and the form of the phase lock, which public drivers agree on. Firmware versions
//! differ in whether numbers are text, and in which values they have. A page may answer 200 to what
//! it does not take, so what was set is read back.

mod http;

use std::cell::Cell;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::str::FromStr;
use std::time::{Duration, Instant};

use hyper::StatusCode;
use serde_json::Value;
use sweepd_core::wire::data::ReturnMode;

use crate::sensor_settings::{FieldOfView, Host, PhaseLock, Port, Returns, Rpm, Settings, Switch};
pub(crate) use http::{get_json, runtime};

/// Longest wait for an answer: it is a small computer.
const PATIENCE: Duration = Duration::from_secs(3);
/// Shortest time between commands: drivers recommend one a second at most.
const PAUSE: Duration = Duration::from_secs(1);
/// How often what was set is read until it is what was wanted.
const READS: u32 = 3;

/// Where a web interface is: `IP`, or `IP:PORT` behind a port forwarder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageAddress(pub SocketAddrV4);

impl FromStr for PageAddress {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let alone = text
            .parse()
            .ok()
            .map(|ip: Ipv4Addr| SocketAddrV4::new(ip, 80));
        let at = alone.or_else(|| text.parse().ok());
        let is_host = |at: &SocketAddrV4| {
            let ip = at.ip();
            !ip.is_unspecified() && !ip.is_multicast() && !ip.is_broadcast() && at.port() != 0
        };
        at.filter(is_host).map(Self).ok_or(
            "expected the sensor's own IPv4 address, such as 192.168.1.201, or with the port of its web page, \
             192.168.1.201:80",
        )
    }
}

/// As it was written.
impl std::fmt::Display for PageAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0.port() {
            80 => self.0.ip().fmt(f),
            _ => self.0.fmt(f),
        }
    }
}

/// What a sensor says of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Page {
    /// What it is set to.
    pub settings: Settings,
    /// The speed it turns at, turns a minute.
    pub measured_rpm: Option<f64>,
    /// State of the pulse per second.
    pub pps: Option<String>,
}

impl Page {
    /// Reads `snapshot.hdl` and `status.json`, as far as they are there.
    pub fn of(snapshot: &Value, status: &Value) -> Self {
        let mut settings = settings(&snapshot["config"]);
        settings.laser = settings.laser.or_else(|| switch(&status["laser"]["state"]));
        Self {
            settings,
            measured_rpm: number(&status["motor"]["rpm"]),
            pps: text(&status["gps"]["pps_state"]),
        }
    }
}

/// Why a command did not complete.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// The sensor was not reached: nothing was changed.
    #[error("{0}")]
    NotSent(String),
    /// The sensor refused.
    #[error("it refuses, with status {0}")]
    Refused(u16),
    /// The sensor may have done it or not.
    #[error("{0}")]
    Unknown(String),
}

/// The web interface of a sensor.
pub struct WebInterface {
    at: SocketAddr,
    runtime: tokio::runtime::Runtime,
    /// When the last command was sent.
    commanded: Cell<Option<Instant>>,
}

impl WebInterface {
    /// That at an address; nothing is sent yet.
    ///
    /// # Errors
    /// What the system says when it cannot even begin.
    pub fn new(at: PageAddress) -> io::Result<Self> {
        Ok(Self {
            at: at.0.into(),
            runtime: runtime()?,
            commanded: Cell::new(None),
        })
    }

    /// What the sensor says of itself.
    ///
    /// # Errors
    /// In a few words, why there is no answer, or none of a sensor.
    pub fn read(&self) -> Result<Page, String> {
        self.runtime.block_on(read(self.at, PATIENCE))
    }

    /// Its model and serial number, if it says them.
    pub fn identity(&self) -> Option<String> {
        let info = get_json(self.at, "/cgi/info.json", PATIENCE);
        let info = self.runtime.block_on(info).ok()?;
        let serial = text(&info["serial"]).map(|serial| format!("serial {serial}"));
        let parts: Vec<String> = text(&info["model"]).into_iter().chain(serial).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }

    /// Sets one setting, by its name in [`Settings::list`], to its value in `wanted`.
    ///
    /// # Errors
    /// [`CommandError`].
    pub fn set(&self, name: &str, wanted: &Settings) -> Result<(), CommandError> {
        let form = forms(wanted).into_iter().find(|form| form.name == name);
        match form {
            Some(form) => self.post(form.path, form.body),
            None => Err(CommandError::NotSent(format!("no value for {name}"))),
        }
    }

    /// Keeps all that is set now, for the next start.
    ///
    /// # Errors
    /// [`CommandError`].
    pub fn save(&self) -> Result<(), CommandError> {
        self.post("/cgi/save", "submit".to_owned())
    }

    fn post(&self, path: &'static str, body: String) -> Result<(), CommandError> {
        if let Some(before) = self.commanded.get() {
            std::thread::sleep(PAUSE.saturating_sub(before.elapsed()));
        }
        self.commanded.set(Some(Instant::now()));
        let posted = http::post_form(self.at, path, body, PATIENCE);
        let status = self.runtime.block_on(posted)?;
        match status {
            status if status < StatusCode::BAD_REQUEST => Ok(()),
            status => Err(CommandError::Refused(status.as_u16())),
        }
    }

    /// Reads the settings until they are as wanted, for some seconds; gives the last that were read.
    ///
    /// # Errors
    /// As for [`WebInterface::read`].
    pub fn read_back(&self, wanted: &Settings) -> Result<Settings, String> {
        let mut last = Err(String::new());
        for read in 0..READS {
            if read > 0 {
                std::thread::sleep(PAUSE);
            }
            last = self.read().map(|page| page.settings);
            if let Ok(found) = &last
                && wanted.differences(found).is_empty()
            {
                break;
            }
        }
        last
    }
}

/// Reads the settings and the status of a sensor, waiting for each answer for `patience`.
///
/// # Errors
/// As for [`WebInterface::read`].
pub async fn read(at: SocketAddr, patience: Duration) -> Result<Page, String> {
    let begun = Instant::now();
    let snapshot = get_json(at, "/cgi/snapshot.hdl", patience).await;
    // One that is silent once is not asked again.
    if let Err(error) = &snapshot
        && begun.elapsed() >= patience
    {
        return Err(error.clone());
    }
    let status = get_json(at, "/cgi/status.json", patience).await;
    if let (Err(error), Err(_)) = (&snapshot, &status) {
        return Err(error.clone());
    }
    let mut page = Page::of(&snapshot.unwrap_or_default(), &status.unwrap_or_default());
    if page
        .settings
        .list()
        .iter()
        .any(|(_, value)| value.is_none())
        && let Ok(told) = get_json(at, "/cgi/settings.json", patience).await
    {
        page.settings = or(page.settings, settings(&told));
    }
    if page == Page::default() {
        return Err("what answers there says no setting of a Velodyne".to_owned());
    }
    Ok(page)
}

/// Reads settings as a sensor tells them, as far as they are there.
fn settings(told: &Value) -> Settings {
    let host = &told["host"];
    let fov = &told["fov"];
    let lock = &told["phaselock"];
    let fov = whole(&fov["start"], 359).zip(whole(&fov["end"], 359));
    Settings {
        rpm: whole(&told["rpm"], u16::MAX).map(Rpm),
        returns: text(&told["returns"]).and_then(|text| text.to_lowercase().parse().ok()),
        fov: fov.map(|(start_deg, end_deg)| FieldOfView { start_deg, end_deg }),
        laser: switch(&told["laser"]),
        host: text(&host["addr"]).and_then(|text| text.parse().ok().map(Host)),
        data_port: port(&host["dport"]),
        position_port: port(&host["tport"]),
        phase_lock: match switch(&lock["enabled"]) {
            Some(Switch(true)) => {
                whole(&lock["offset"], 36_000).map(|at| PhaseLock::At(at % 36_000))
            }
            Some(Switch(false)) => Some(PhaseLock::Off),
            None => None,
        },
    }
}

fn or(one: Settings, other: Settings) -> Settings {
    Settings {
        rpm: one.rpm.or(other.rpm),
        returns: one.returns.or(other.returns),
        fov: one.fov.or(other.fov),
        laser: one.laser.or(other.laser),
        host: one.host.or(other.host),
        data_port: one.data_port.or(other.data_port),
        position_port: one.position_port.or(other.position_port),
        phase_lock: one.phase_lock.or(other.phase_lock),
    }
}

/// A form as the sensor's page sends it when Set is pressed.
struct Form {
    name: &'static str,
    path: &'static str,
    body: String,
}

fn forms(wanted: &Settings) -> Vec<Form> {
    let mut forms = Vec::new();
    let mut add = |name, path, body| forms.push(Form { name, path, body });
    if let Some(laser) = wanted.laser {
        add("laser", "/cgi/setting", format!("laser={laser}"));
    }
    if let Some(Returns(mode)) = wanted.returns {
        let returns = match mode {
            ReturnMode::Strongest => "Strongest",
            ReturnMode::Last => "Last",
            ReturnMode::Dual => "Dual",
        };
        add("returns", "/cgi/setting", format!("returns={returns}"));
    }
    if let Some(rpm) = wanted.rpm {
        add("rpm", "/cgi/setting", format!("rpm={rpm}"));
    }
    if let Some(FieldOfView { start_deg, end_deg }) = wanted.fov {
        let body = format!("start={start_deg}&end={end_deg}");
        add("fov", "/cgi/setting/fov", body);
    }
    if let Some(lock) = wanted.phase_lock {
        let body = match lock {
            PhaseLock::Off => "enabled=off".to_owned(),
            PhaseLock::At(cdeg) => format!("enabled=on&offset={cdeg}&offsetInput={lock}"),
        };
        add("phase-lock", "/cgi/setting/phaselock", body);
    }
    if let Some(port) = wanted.position_port {
        add(
            "position-port",
            "/cgi/setting/host",
            format!("tport={port}"),
        );
    }
    if let Some(port) = wanted.data_port {
        add("data-port", "/cgi/setting/host", format!("dport={port}"));
    }
    if let Some(host) = wanted.host {
        add("host", "/cgi/setting/host", format!("addr={host}"));
    }
    forms
}

fn number(value: &Value) -> Option<f64> {
    let number = value
        .as_f64()
        .or_else(|| value.as_str()?.trim().parse().ok())?;
    number.is_finite().then_some(number)
}

/// A whole number up to a greatest one.
fn whole(value: &Value, most: u16) -> Option<u16> {
    let number = number(value).filter(|number| (0.0..=f64::from(most)).contains(number));
    number.map(|number| number.round() as u16)
}

fn port(value: &Value) -> Option<Port> {
    whole(value, u16::MAX).filter(|&port| port != 0).map(Port)
}

fn text(value: &Value) -> Option<String> {
    // What comes over the network is shown on a terminal.
    let clean = value.as_str()?.chars().filter(|one| !one.is_control());
    let text: String = clean.take(64).collect();
    (!text.is_empty()).then_some(text)
}

fn switch(value: &Value) -> Option<Switch> {
    text(value)?.to_ascii_lowercase().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_may_be_text_and_much_may_be_missing() {
        let told = settings(&json!({
            "rpm": "600", "returns": "Dual", "laser": "On", "fov": {"start": "270", "end": 91},
            "host": {"addr": "255.255.255.255", "dport": "2368", "tport": 8308},
            "phaselock": {"enabled": "On", "offset": 9025},
        }));
        let expected = Settings {
            rpm: Some(Rpm(600)),
            returns: Some(Returns(ReturnMode::Dual)),
            fov: "270-91".parse().ok(),
            laser: Some(Switch(true)),
            host: Some(Host(Ipv4Addr::BROADCAST)),
            data_port: Some(Port(2368)),
            position_port: Some(Port(8308)),
            phase_lock: Some(PhaseLock::At(9025)),
        };
        assert_eq!(told, expected);
        let odd = json!({"rpm": "fast", "host": {"addr": "somewhere", "dport": 99999}, "laser": 1,
                         "fov": {"start": -1, "end": 360}, "phaselock": {"enabled": "On", "offset": 1e9}});
        for nothing in [odd, json!({"camera": true}), json!([1, 2]), Value::Null] {
            assert_eq!(settings(&nothing), Settings::default());
        }
    }

    #[test]
    fn every_setting_has_its_form() {
        let wanted = Settings {
            rpm: Some(Rpm(1200)),
            returns: Some(Returns(ReturnMode::Last)),
            fov: "270-90".parse().ok(),
            laser: Some(Switch(true)),
            host: "192.168.1.100".parse().ok(),
            data_port: Some(Port(2369)),
            position_port: Some(Port(8309)),
            phase_lock: Some(PhaseLock::At(9025)),
        };
        let names: Vec<&str> = forms(&wanted).iter().map(|form| form.name).collect();
        assert_eq!(names, wanted.list().map(|(name, _)| name));
        let bodies: Vec<String> = forms(&wanted).into_iter().map(|form| form.body).collect();
        let expected = [
            "laser=on",
            "returns=Last",
            "rpm=1200",
            "start=270&end=90",
            "enabled=on&offset=9025&offsetInput=90.25",
            "tport=8309",
            "dport=2369",
            "addr=192.168.1.100",
        ];
        assert_eq!(bodies, expected);
    }

    #[test]
    fn an_address_is_that_of_one_sensor() {
        for (text, shown) in [
            ("192.168.1.201", "192.168.1.201"),
            ("10.0.0.1:80", "10.0.0.1"),
            ("10.0.0.1:8080", "10.0.0.1:8080"),
        ] {
            let at = text.parse::<PageAddress>();
            assert_eq!(at.map(|at| at.to_string()).as_deref(), Ok(shown));
        }
        for text in [
            "",
            "roof",
            "0.0.0.0",
            "255.255.255.255",
            "239.1.1.1",
            "10.0.0.1:0",
            "::1",
        ] {
            assert!(text.parse::<PageAddress>().is_err(), "{text}");
        }
    }
}
