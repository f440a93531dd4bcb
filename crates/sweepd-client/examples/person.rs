//! Tells a person who walks in, once, some milliseconds after the last beam on them: `person SENSOR`. That is an
//! object of a person's size that has gone half a metre since it was first seen. The robot stands still.

use std::time::{Duration, UNIX_EPOCH};
use sweepd_client::{client::Client, sweep::Frame};

/// How far one goes at least until it is told, and less than that from turn to turn, metres.
const WALK_M: f64 = 0.5;
const FORGOTTEN_NS: i64 = 1_000_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = std::env::args().nth(1).ok_or("which sensor?")?;
    let mut objects = Client::new(&sensor)?.objects()?;
    // Where each was first and last, metres, when it was last, and whether it was told.
    let mut tracks: Vec<([f64; 2], [f64; 2], i64, bool)> = Vec::new();
    while let Some(message) = objects.next(Duration::MAX)?.received() {
        let view = message.view()?;
        for (object, [from, to]) in view.objects.iter().zip(view.boxes(Frame::Robot)) {
            let (width_m, height_m) = ((to[0] - from[0]).max(to[1] - from[1]), to[2] - from[2]);
            if !(0.2..1.2).contains(&width_m) || !(0.8..2.1).contains(&height_m) {
                continue;
            }
            let [x, y] = [0, 1].map(|axis| (from[axis] + to[axis]) / 2.0);
            let away_m = |from: [f64; 2]| (x - from[0]).hypot(y - from[1]);
            let seen_ns = view.header.time_ns + i64::from(object.last_ns);
            tracks.retain(|track| seen_ns - track.2 < FORGOTTEN_NS);
            let Some(track) = tracks.iter_mut().find(|track| away_m(track.1) < WALK_M) else {
                tracks.push(([x, y], [x, y], seen_ns, false));
                continue;
            };
            (track.1, track.2) = ([x, y], seen_ns);
            if !track.3 && away_m(track.0) > WALK_M {
                track.3 = true;
                let age_ms = UNIX_EPOCH.elapsed()?.as_millis() as i64 - seen_ns / 1_000_000;
                println!("a person: {x:.2} m right, {y:.2} m ahead, seen {age_ms} ms ago");
            }
        }
    }
    Ok(())
}
