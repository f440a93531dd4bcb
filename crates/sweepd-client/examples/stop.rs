//! Says "stop" while the box of an object reaches into a box ahead of the robot, and how old its
//! newest return is:
//!
//!     cargo run --release -p sweepd-client --example stop -- roof
//!
//! The box stands on the floor: the robot's origin lies there, so `z_m` of `[sensor.mount]` is the
//! height of the sensor over it. **No output does not mean that the way is free.** What lies nearer
//! than the lowest beam, or than the box, is not seen any more. What one row alone strikes can be
//! ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and steps down are no
//! objects. `cargo run --release --example obstacles` prints what is seen by sensor, height and
//! distance.

use std::time::{Duration, SystemTime};

use sweepd_client::client::Client;
use sweepd_client::sweep::objects::flags;

/// The box in the frame of the robot, least and greatest x (right), y (ahead) and z (up), metres.
const STOP_M: [[f64; 3]; 2] = [[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).ok_or("which sensor?")?;
    let mut objects = Client::new(&name)?.objects()?;
    loop {
        let Some(message) = objects.next(Duration::from_secs(1))?.received() else {
            println!("stop: nothing is heard of {name}");
            continue;
        };
        let view = message.view()?;
        if view.header.flags & flags::NO_HEIGHT != 0 {
            println!("stop: the height of {name} is not known yet");
        }
        let mount = view.header.mount();
        if mount.position_m[2] <= 0.0 {
            println!("stop: {name} has no z_m in [sensor.mount]: where is the floor?");
        }
        // Parts too: a wide object is told in parts first.
        for object in view.objects {
            let [least_m, most_m] = mount.bounds(object.segment.min_m, object.segment.max_m);
            if (0..3).all(|at| least_m[at] < STOP_M[1][at] && most_m[at] > STOP_M[0][at]) {
                let now_ns = SystemTime::UNIX_EPOCH.elapsed()?.as_nanos() as i64;
                let age_ns = now_ns - (view.header.time_ns + i64::from(object.last_ns));
                let (age_ms, nearest_m) = (age_ns as f64 * 1e-6, object.segment.nearest_m);
                println!("stop: an object at {nearest_m:.2} m, seen {age_ms:.1} ms ago");
            }
        }
    }
}
