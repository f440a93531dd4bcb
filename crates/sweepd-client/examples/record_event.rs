//! Records for 10 s when something comes into a box ahead of the robot: `record_event SENSOR [SECONDS]`. The daemon
//! writes event_TIME.pcap into this folder, if it may (docs/install.md), with what comes from then on.

use std::process::Command;
use std::time::{Duration, SystemTime};
use sweepd_client::{client::Client, sweep::Frame};

/// Least and greatest x (right), y (ahead) and z (up), metres. It reaches below the ground, which is no thing.
const BOX_M: [[f64; 3]; 2] = [[-1.0, 0.5, -5.0], [1.0, 5.0, 2.0]];
/// Fewest returns of a thing.
const RETURNS: usize = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = std::env::args().nth(1).ok_or("which sensor?")?;
    let seconds = std::env::args().nth(2).unwrap_or("10".to_owned());
    let mut client = Client::new(&sensor)?;
    loop {
        let Some(sweep) = client.next(Duration::from_secs(1))?.received() else {
            eprintln!("nothing is heard of {sensor}");
            continue;
        };
        let view = sweep.view()?;
        if view.header.height_m == 0.0 {
            eprintln!("there are no objects before the height of {sensor} is known");
        }
        let things = view.points(Frame::Robot).filter(|one| one.label >= 2);
        let is_in = |at: [f64; 3]| (0..3).all(|i| BOX_M[0][i] < at[i] && at[i] < BOX_M[1][i]);
        if things.filter(|one| is_in(one.point_m)).count() >= RETURNS {
            let time_ms = SystemTime::UNIX_EPOCH.elapsed()?.as_millis();
            let file = format!("event_{time_ms}.pcap");
            println!("recording {file}");
            let args = format!("record --from {sensor} -o {file} --seconds {seconds}");
            let status = Command::new("sweepd").args(args.split(' ')).status()?;
            if !status.success() {
                return Err(format!("sweepd {args}: {status}").into());
            }
        }
    }
}
