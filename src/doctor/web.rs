//! Reads the settings of a sensor from its web page, without changing them.
//!
//! VLP-16 and HDL-32E answer `/cgi/snapshot.hdl` (settings) and `/cgi/status.json` (status); VLP-16
//! User Manual, chapter 10. Firmware versions differ in whether numbers are text, and in which
//! values they have.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use serde_json::Value;

use super::http::{get_json, runtime};
use super::observe::Web;

/// How long an answer may take: it is a small computer.
const PATIENCE: Duration = Duration::from_millis(1500);

/// Asks sensors for their settings, all at once. Those that do not answer are left out.
///
/// # Errors
/// What the system says when it cannot even begin.
pub fn ask(addresses: &[Ipv4Addr], port: u16) -> std::io::Result<Vec<Web>> {
    if addresses.is_empty() {
        return Ok(Vec::new());
    }
    let runtime = runtime()?;
    let pages: Vec<_> = addresses
        .iter()
        .map(|&address| runtime.spawn(ask_one(address, port)))
        .collect();
    Ok(runtime.block_on(async {
        let mut answers = Vec::new();
        for page in pages {
            answers.extend(page.await.ok().flatten());
        }
        answers
    }))
}

async fn ask_one(address: Ipv4Addr, port: u16) -> Option<Web> {
    let to = SocketAddr::from((address, port));
    let snapshot = get_json(to, "/cgi/snapshot.hdl", PATIENCE).await;
    let status = get_json(to, "/cgi/status.json", PATIENCE).await;
    if snapshot.is_err() && status.is_err() {
        return None;
    }
    let snapshot = snapshot.unwrap_or_default();
    let web = read(address, &snapshot, &status.unwrap_or_default());
    // Otherwise it is the web page of another device.
    (web != Web::unknown(address)).then_some(web)
}

/// Reads both pages of a sensor, as far as they are there.
pub fn read(address: Ipv4Addr, snapshot: &Value, status: &Value) -> Web {
    let config = &snapshot["config"];
    let host = &config["host"];
    let fov = &config["fov"];
    Web {
        address,
        rpm: number(&config["rpm"]),
        measured_rpm: number(&status["motor"]["rpm"]),
        returns: text(&config["returns"]),
        view_deg: number(&fov["start"]).zip(number(&fov["end"])),
        destination: text(&host["addr"]).and_then(|text| text.parse().ok()),
        data_port: port(&host["dport"]),
        position_port: port(&host["tport"]),
        lasers_on: on_or_off(&config["laser"]).or_else(|| on_or_off(&status["laser"]["state"])),
        pps: text(&status["gps"]["pps_state"]),
    }
}

fn number(value: &Value) -> Option<f64> {
    let number = value
        .as_f64()
        .or_else(|| value.as_str()?.trim().parse().ok())?;
    number.is_finite().then_some(number)
}

fn text(value: &Value) -> Option<String> {
    // What comes over the network is shown on a terminal.
    let clean = value.as_str()?.chars().filter(|one| !one.is_control());
    Some(clean.take(64).collect())
}

fn port(value: &Value) -> Option<u16> {
    let port = number(value).filter(|port| (1.0..=65535.0).contains(port));
    port.map(|port| port as u16)
}

fn on_or_off(value: &Value) -> Option<bool> {
    match value.as_str()?.to_ascii_lowercase().as_str() {
        "on" => Some(true),
        "off" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 201);

    #[test]
    fn numbers_may_be_text_and_much_may_be_missing() {
        let told = read(
            ADDRESS,
            &json!({"config": {"rpm": "600", "returns": "Dual", "laser": "On", "fov": {"start": "270", "end": 91},
                               "host": {"addr": "255.255.255.255", "dport": "2368", "tport": 8308}}}),
            &json!({"motor": {"rpm": 599, "state": "On"}, "gps": {"pps_state": "Absent"}}),
        );
        let expected = Web {
            address: ADDRESS,
            rpm: Some(600.0),
            measured_rpm: Some(599.0),
            returns: Some("Dual".to_owned()),
            view_deg: Some((270.0, 91.0)),
            destination: Some(Ipv4Addr::BROADCAST),
            data_port: Some(2368),
            position_port: Some(8308),
            lasers_on: Some(true),
            pps: Some("Absent".to_owned()),
        };
        assert_eq!(told, expected);
        assert_eq!(
            read(ADDRESS, &json!({"camera": true}), &Value::Null),
            Web::unknown(ADDRESS)
        );
        let odd = json!({"config": {"rpm": "fast", "host": {"addr": "somewhere", "dport": 99999}, "laser": 1}});
        assert_eq!(read(ADDRESS, &odd, &json!([1, 2])), Web::unknown(ADDRESS));
    }

    #[test]
    fn without_a_web_page_there_is_no_answer() {
        let free = std::net::TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port();
        assert_eq!(ask(&[Ipv4Addr::LOCALHOST], free).unwrap(), []);
    }
}
