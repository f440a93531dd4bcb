//! Tells when an obstacle comes into a zone, a box on the floor in the robot's frame, and when it is gone: `zones SENSOR`.
//! Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.

use std::time::Duration;
use sweepd_client::client::Client;
use sweepd_client::sweep::{LeastReturns, Zone, layout::flags};

/// Least and greatest x (right), y (ahead) and z (up from the floor), metres.
const ZONES: [(&str, [f64; 3], [f64; 3]); 2] = [
    ("ahead", [-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]),
    ("left", [-3.0, -1.0, 0.05], [-1.0, 1.0, 2.0]),
];
/// Whole turns without an obstacle after which it is gone.
const GONE: u64 = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = std::env::args().nth(1).ok_or("which sensor?")?;
    let (mut client, mut empty) = (Client::new(&sensor)?, [GONE; ZONES.len()]);
    loop {
        let Some(sweep) = client.next(Duration::from_secs(1))?.received() else {
            eprintln!("nothing is heard of {sensor}");
            continue;
        };
        let view = sweep.view()?;
        if view.header.height_m == 0.0 {
            eprintln!("the height of {sensor} is not known: set `height_m` in `[sensor.mount]`");
        }
        let is_whole = !view.header.has(flags::PARTIAL | flags::STOPPED);
        for ((zone, least_m, most_m), empty) in ZONES.into_iter().zip(&mut empty) {
            let found = view.obstacle(&Zone::new(least_m, most_m)?, LeastReturns::default());
            let now = found.map_or(*empty + u64::from(is_whole), |_| 0);
            match (*empty, now) {
                (GONE.., 0) => println!("{zone}: occupied"),
                (..GONE, GONE) => println!("{zone}: empty"),
                _ => {}
            }
            *empty = now;
        }
    }
}
