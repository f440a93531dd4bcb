//! A sensor that sends and does not see is told by /health, the log and /metrics.

use std::time::Duration;

use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;

use crate::daemon::child::Daemon;
use crate::daemon::rig::{Sending, free_port, stream, until};

/// Bytes of a block of a data packet before its records.
const BLOCK_HEADER: usize = 4;
const BLOCK: usize = 100;
const BLOCKS_END: usize = 1200;

#[test]
fn the_eye_of_a_sensor_without_returns_is_told_with_cause_and_cure() {
    let port = free_port();
    let daemon = Daemon::start(&[[107, port, port]], free_port(), Duration::from_secs(8));
    daemon.until_ready();
    let mut blind = stream(Model::Vlp16, ReturnMode::Strongest, 200.0);
    let from = Duration::from_secs(6);
    for sent in &mut blind {
        if sent.is_data && sent.after >= from {
            for block in sent.payload[..BLOCKS_END].chunks_mut(BLOCK) {
                block[BLOCK_HEADER..].fill(0);
            }
        }
    }
    let _sending = Sending::start(107, (port, port), blind);
    until("it sees", || daemon.health().0 == 200);
    until("it does not", || daemon.health().0 == 503);
    let health = daemon.health().1;
    let sensor = &health["sensors"][0];
    assert_eq!(sensor["state"], "not seeing");
    assert!(sensor["eye"].as_array().unwrap().contains(&"blind".into()));
    let reason = sensor["reason"].as_str().unwrap();
    assert!(reason.contains("blind: hardly a shot returns: take off what covers"));
    until("it is logged", || daemon.log().contains("s107: blind: "));
    let metrics = daemon.ask("GET /metrics").1;
    let metric = metrics
        .lines()
        .find(|line| line.starts_with("sweepd_eye{") && line.contains("fault=\"blind\""));
    assert!(
        metric.is_some_and(|line| line.ends_with(" 1.0")),
        "{metrics}"
    );
}
