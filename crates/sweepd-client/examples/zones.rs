//! Tells when something comes into a zone, a box in the robot's frame, and when it is gone: `zones SENSOR`.
//! Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.

use std::time::Duration;
use sweepd_client::{client::Client, sweep::Frame};

/// Least and greatest x (right), y (ahead) and z (up), metres. They reach below the ground, which is no thing.
const ZONES: [(&str, [f64; 3], [f64; 3]); 2] = [
    ("ahead", [-1.0, 0.5, -5.0], [1.0, 5.0, 2.0]),
    ("left", [-3.0, -1.0, -5.0], [-1.0, 1.0, 2.0]),
];
/// Fewest returns of a thing, and sweeps without them after which it is gone.
const RETURNS: usize = 3;
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
            eprintln!("there are no objects before the height of {sensor} is known");
        }
        for ((zone, least, most), empty) in ZONES.iter().zip(&mut empty) {
            let things = view.points(Frame::Robot).filter(|one| one.label >= 2);
            let is_in = |at: [f64; 3]| (0..3).all(|i| least[i] < at[i] && at[i] < most[i]);
            let is_occupied = things.filter(|one| is_in(one.point_m)).count() >= RETURNS;
            match *empty {
                GONE.. if is_occupied => println!("{zone}: occupied"),
                before if !is_occupied && before + 1 == GONE => println!("{zone}: empty"),
                _ => {}
            }
            *empty = if is_occupied { 0 } else { *empty + 1 };
        }
    }
}
