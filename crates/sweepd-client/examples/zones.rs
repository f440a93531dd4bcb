//! Tells when an obstacle comes into a zone, a box on the floor in the robot's frame, and when it is gone: `zones SENSOR`.
//! Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.

use std::time::Duration;
use sweepd_client::client::Client;
use sweepd_client::sweep::{LeastReturns, Zone};

/// Least and greatest x (right), y (ahead) and z (up from the floor), metres.
const ZONES: [(&str, [f64; 3], [f64; 3]); 2] = [
    ("ahead", [-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]),
    ("left", [-3.0, -1.0, 0.05], [-1.0, 1.0, 2.0]),
];
/// Sweeps without an obstacle after which it is gone.
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
            eprintln!("the height of {sensor} is not known yet, nor is what is ground");
            continue;
        }
        for ((zone, least_m, most_m), empty) in ZONES.into_iter().zip(&mut empty) {
            let found = view.obstacle(&Zone::new(least_m, most_m)?, LeastReturns::default());
            match *empty {
                GONE.. if found.is_some() => println!("{zone}: occupied"),
                before if found.is_none() && before + 1 == GONE => println!("{zone}: empty"),
                _ => {}
            }
            *empty = if found.is_some() { 0 } else { *empty + 1 };
        }
    }
}
