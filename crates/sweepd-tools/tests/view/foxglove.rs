//! Viewers that speak the protocol of Foxglove: one of ours, and Foxglove's own client.

use std::time::Duration;

use serde_json::{Value, json};
use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::pipeline::Config;
use sweepd::sensor::Model;
use sweepd::sweep::SweepRef;
use sweepd::wire::data::ReturnMode;
use sweepd_testkit::{PATIENCE, TempDomain, stream::Spin};
use tokio_tungstenite::tungstenite::Message;

use crate::captures::{fixture, sweeps};
use crate::live::{Publisher, view};
use crate::page::{Page, View};

/// Numbers of the channels of all sensors, and of the first one.
const DIAGNOSTICS: u32 = 2;
const POINTS: u32 = 3;
const MARKERS: u32 = 4;

fn subscribe(viewer: &mut Page, subscriptions: &[(u32, u32)]) {
    let subscriptions = subscriptions.iter();
    let subscriptions =
        subscriptions.map(|(id, channel)| json!({ "id": id, "channelId": channel }));
    let subscriptions: Vec<Value> = subscriptions.collect();
    viewer.ask(json!({ "op": "subscribe", "subscriptions": subscriptions }));
}

fn advertised(viewer: &mut Page, part: &str) -> Vec<(u64, String)> {
    let message = viewer.until(|message| {
        message["op"] == "advertise" && message["channels"].to_string().contains(part)
    });
    let channels = message["channels"].as_array().unwrap().iter();
    let named = channels.map(|channel| {
        let topic = channel["topic"].as_str().unwrap();
        (channel["id"].as_u64().unwrap(), topic.to_owned())
    });
    named.collect()
}

/// The next message of a channel within this time: its subscription, its time and its bytes.
fn message(viewer: &mut Page, limit: Duration) -> Option<(u32, u64, Vec<u8>)> {
    loop {
        let Message::Binary(bytes) = viewer.within(limit)? else {
            continue;
        };
        if bytes[0] == 1 {
            let subscription = u32::from_le_bytes(*bytes[1..].first_chunk().unwrap());
            let time_ns = u64::from_le_bytes(*bytes[5..].first_chunk().unwrap());
            return Some((subscription, time_ns, bytes[13..].to_vec()));
        }
    }
}

fn status(viewer: &mut Page) -> String {
    let status = viewer.until(|message| message["op"] == "status");
    assert_eq!(status["level"], 2);
    status["message"].as_str().unwrap().to_owned()
}

#[test]
fn a_viewer_gets_what_it_subscribes_to_and_nothing_else() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz"), "--height=1.9"]);
    let mut page = view.page();
    page.pause();
    let first = page.seek(0);
    let time_ns = first.sweep().header.time_ns as u64;
    let mut viewer = view.viewer();
    let info = viewer.until(|message| message["op"] == "serverInfo");
    assert_eq!(info["capabilities"], json!(["time"]));
    let own = ["/tf_static", "/diagnostics"];
    let own = [(1, own[0].to_owned()), (2, own[1].to_owned())];
    assert_eq!(advertised(&mut viewer, "tf_static"), own);
    let of_sensor = advertised(&mut viewer, "points");
    let topic = |name: &str| format!("/sweepd/sensor_192_168_1_201_2368/{name}");
    assert_eq!(of_sensor, [(3, topic("points")), (4, topic("markers"))]);
    // Nothing without a subscription, and then what is shown, though it is paused.
    let short = Duration::from_millis(300);
    assert!(message(&mut viewer, short).is_none());
    subscribe(&mut viewer, &[(70, MARKERS)]);
    let (subscription, time, _) = message(&mut viewer, PATIENCE).unwrap();
    assert_eq!((subscription, time), (70, time_ns));
    let second = page.seek(1);
    let (subscription, time, _) = message(&mut viewer, PATIENCE).unwrap();
    let time_ns = second.sweep().header.time_ns as u64;
    assert_eq!((subscription, time), (70, time_ns));
    assert!(message(&mut viewer, short).is_none());
    viewer.ask(json!({ "op": "unsubscribe", "subscriptionIds": [70, 71] }));
    page.seek(2);
    assert!(message(&mut viewer, short).is_none());
    // Each second, at the time of what is shown.
    subscribe(&mut viewer, &[(70, DIAGNOSTICS)]);
    for _ in 0..2 {
        let (_, time, bytes) = message(&mut viewer, PATIENCE).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(time > time_ns && text.contains("paused"), "{text}");
    }
}

/// Returns that lie anywhere: no floor is among them. Page and viewer have the words of `HeightDoubt`.
#[test]
fn a_floor_that_is_not_seen_is_told_to_page_and_viewer() {
    let own = TempDomain::new("sweepd-view-").unwrap();
    let path = own.path("noise.pcap");
    let mut file = PcapWriter::new(std::fs::File::create(&path).unwrap()).unwrap();
    let here: std::net::SocketAddrV4 = "127.0.0.1:2368".parse().unwrap();
    for sent in Spin::new(Model::Vlp16, ReturnMode::Strongest, 600.0).packets(1.0) {
        let datagram = Addressed {
            arrival_ns: sent.arrival_ns,
            source: here,
            destination: here,
            payload: sent.packet.emit(),
        };
        file.write(&datagram).unwrap();
    }
    drop(file);
    let words =
        "no floor is seen: everything is an obstacle; no level surface is in sight: set height_m";
    let view = View::start(&[path.to_str().unwrap()]);
    let mut page = view.page();
    page.pause();
    assert_eq!(page.seek(1).about["doubt"], words);
    let mut viewer = view.viewer();
    advertised(&mut viewer, "points");
    subscribe(&mut viewer, &[(70, DIAGNOSTICS)]);
    let (_, _, bytes) = message(&mut viewer, PATIENCE).unwrap();
    assert!(String::from_utf8_lossy(&bytes).contains(words));
}

#[test]
fn what_cannot_be_is_refused_by_a_status() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    view.page().pause();
    let mut viewer = view.viewer();
    advertised(&mut viewer, "points");
    subscribe(
        &mut viewer,
        &[(1, POINTS), (1, MARKERS), (2, POINTS), (3, 99)],
    );
    assert_eq!(status(&mut viewer), "there is a subscription 1 already");
    assert_eq!(status(&mut viewer), "channel 3 has a subscription already");
    assert_eq!(status(&mut viewer), "there is no channel 99");
    for request in [
        json!({ "op": "advertise", "channels": [] }),
        json!({ "op": "setParameters", "parameters": [{ "name": "play", "value": true }] }),
        json!({ "op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1 }),
        json!({ "op": "subscribeConnectionGraph" }),
        json!({ "op": "pause" }),
    ] {
        viewer.ask(request);
        assert!(status(&mut viewer).starts_with("a viewer can change nothing here"));
    }
    viewer.send(Message::binary(vec![1, 0, 0, 0, 0, 7]));
    assert!(status(&mut viewer).starts_with("a viewer can change nothing here"));
}

/// Its channels have the name of the sensor that is shown, and go with it.
#[test]
fn another_sensor_has_channels_of_its_own() {
    let own = TempDomain::new("sweepd-view-").unwrap();
    let some = sweeps(&fixture("street_vlp16.pcap.gz"), &Config::default());
    let mut daemons = ["front", "roof-1"].map(|name| Publisher::new(&own.domain(), name));
    let view = view(&own, &[]);
    let mut page = view.page();
    let mut viewer = view.viewer();
    let info = viewer.until(|message| message["op"] == "serverInfo");
    // Its clock is this host's.
    assert_eq!(info["capabilities"], json!([]));
    for (sensor, topic, ids) in [("front", "front", [3, 4]), ("roof-1", "roof_1", [5, 6])] {
        page.until(|message| message["sensors"] == json!(["front", "roof-1"]));
        page.ask(json!({ "do": "choose", "sensor": sensor }));
        page.words(&format!("sweep of {sensor}"));
        for daemon in &mut daemons {
            daemon.publish(&some[0]);
        }
        let topics = ["points", "markers"].map(|name| format!("/sweepd/{topic}/{name}"));
        let expected: Vec<_> = ids.into_iter().zip(topics).collect();
        assert_eq!(advertised(&mut viewer, "points"), expected);
        let id = ids[0] as u32;
        subscribe(&mut viewer, &[(id, id)]);
        let (subscription, time_ns, bytes) = message(&mut viewer, PATIENCE).unwrap();
        let header = SweepRef::open(some[0].as_ref()).unwrap().header;
        assert_eq!((subscription, time_ns), (id, header.time_ns as u64));
        assert!(
            bytes
                .windows(sensor.len())
                .any(|part| part == sensor.as_bytes())
        );
        // Where it sits: its sweeps say that its nose points up.
        subscribe(&mut viewer, &[(1, 1)]);
        while message(&mut viewer, PATIENCE).unwrap().0 != 1 {}
        viewer.ask(json!({ "op": "unsubscribe", "subscriptionIds": [1] }));
        page = view.page();
    }
}

#[cfg(feature = "slow-tests")]
mod peer {
    use std::collections::BTreeMap;
    use std::env;
    use std::io::{BufRead, BufReader};
    use std::path::Path;
    use std::process::{Command, Stdio};
    use std::sync::mpsc::{Receiver, channel};

    use sweepd_testkit::{PATIENCE, Process};

    use super::*;

    /// Foxglove's own client, which subscribes to all that is offered.
    struct Peer {
        _process: Process,
        events: Receiver<Value>,
    }

    impl Peer {
        fn start(view: &View, protocol: &str) -> Self {
            let packages = env::var_os("SWEEPD_NODE_MODULES").expect("SWEEPD_NODE_MODULES");
            let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/view/viewer.cjs");
            let mut command = Command::new("node");
            command
                .arg(script)
                .args([&format!("ws://{}", view.host), protocol])
                .env("NODE_PATH", packages)
                .stdout(Stdio::piped());
            let mut process = Process::start(&mut command).unwrap();
            let lines = BufReader::new(process.child.stdout.take().unwrap()).lines();
            let (sender, events) = channel();
            std::thread::spawn(move || {
                for line in lines.map_while(Result::ok) {
                    let _ = sender.send(serde_json::from_str(&line).unwrap());
                }
            });
            let _process = process;
            Self { _process, events }
        }

        fn next(&self) -> Value {
            let event: Value = self.events.recv_timeout(PATIENCE).expect("an event");
            assert!(
                event["event"] != "error" && event["event"] != "status",
                "{event}"
            );
            event
        }

        /// The next message of a topic that ends like this.
        fn message(&self, topic: &str) -> Value {
            loop {
                let event = self.next();
                if event["topic"]
                    .as_str()
                    .is_some_and(|one| one.ends_with(topic))
                    && event["event"] == "message"
                {
                    return event;
                }
            }
        }
    }

    /// Topic, time and bytes of a message.
    fn content(message: &Value) -> (String, String, String) {
        let text = |key: &str| message[key].as_str().unwrap().to_owned();
        (text("topic"), text("time"), text("bytes"))
    }

    /// The messages of an MCAP file that `sweepd replay` writes, in its order.
    fn recorded(args: &[&str]) -> Vec<(String, String, String)> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("sweeps.mcap");
        let mut command = sweepd_testkit::sweepd(&[&["replay"], args].concat());
        let output = command.arg("--mcap").arg(&file).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        let bytes = std::fs::read(&file).unwrap();
        let messages = mcap::MessageStream::new(&bytes)
            .unwrap()
            .map(Result::unwrap);
        let found = messages.map(|one| {
            let data = one.data.iter().map(|byte| format!("{byte:02x}"));
            (
                one.channel.topic.clone(),
                one.log_time.to_string(),
                data.collect(),
            )
        });
        found.collect()
    }

    /// Byte for byte, of every sweep, by both names of the protocol; and Foxglove's reader finds in it
    /// what the sweeps have.
    #[test]
    #[cfg_attr(without_foxglove, ignore = "no SWEEPD_NODE_MODULES")]
    fn foxglove_gets_what_an_mcap_file_has() {
        for (name, protocol) in [
            ("street_vlp16.pcap.gz", "foxglove.websocket.v1"),
            ("street_hdl32e_dual.pcap.gz", "foxglove.sdk.v1"),
        ] {
            let path = fixture(name);
            let args = [&path[..], "--height", "1.8", "--pitch=-2"];
            let mut expected = recorded(&args);
            let view = View::start(&args);
            let mut page = view.page();
            page.pause();
            let mut shown = page.seek(0);
            let peer = Peer::start(&view, protocol);
            let info = peer.next();
            assert_eq!(
                (&info["event"], &info["protocol"]),
                (&"serverInfo".into(), &protocol.into())
            );
            let mount = peer.message("/tf_static");
            let at = &mount["read"]["transforms"][0];
            assert_eq!(at["header"]["frame_id"], "base_link");
            // Half of two degrees, nose down.
            let y = at["transform"]["rotation"]["y"].as_f64().unwrap();
            assert!((y - 0.017_452_4).abs() < 1e-6, "{y}");
            assert_eq!(content(&mount), expected.remove(0));
            let mut left: BTreeMap<_, _> = expected
                .into_iter()
                .map(|(topic, time, bytes)| ((topic, time), bytes))
                .collect();
            let sweeps = left.len() / 2;
            assert!(sweeps >= 2, "{name}");
            for index in 0..sweeps {
                if index > 0 {
                    shown = page.seek(index as u64);
                }
                let sweep = shown.sweep();
                for topic in ["/points", "/markers"] {
                    let message = peer.message(topic);
                    let (topic, time, bytes) = content(&message);
                    assert_eq!(time, sweep.header.time_ns.to_string());
                    assert!(
                        left.remove(&(topic, time)) == Some(bytes),
                        "{name}, {index}"
                    );
                    let read = &message["read"];
                    if read["boxes"].is_array() {
                        let boxes = sweep.segments.iter().filter(|one| !one.is_wide());
                        let labels = boxes.map(|segment| segment.label);
                        let labels: Vec<u32> = [0].into_iter().chain(labels).collect();
                        assert_eq!(read["boxes"], json!(labels));
                    } else {
                        assert_eq!(read["fields"], "x y z intensity ring time label");
                        assert_eq!(read["points"], sweep.header.returns);
                        assert_eq!(read["whole"], true);
                    }
                }
            }
            assert!(left.is_empty());
            let health = peer.message("/diagnostics");
            let status = &health["read"]["status"][0];
            assert_eq!(
                (&status["level"], &status["message"]),
                (&json!(0), &json!("paused"))
            );
            // Time goes back: where the sensor sits is told again.
            page.seek(0);
            assert_eq!(peer.message("/tf_static")["bytes"], mount["bytes"]);
        }
    }
}
