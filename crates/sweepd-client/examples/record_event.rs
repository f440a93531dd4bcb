//! Records for 10 s when an obstacle comes into a box ahead of the robot: `record_event SENSOR [SECONDS]`. The daemon
//! writes event_TIME.pcap into this folder, if it may (docs/install.md), with what comes from then on.

use std::process::Command;
use std::time::{Duration, SystemTime};
use sweepd_client::client::Client;
use sweepd_client::sweep::{LeastReturns, Zone};

const USAGE: &str = "SENSOR [SECONDS]: SECONDS is 0.1 to 1e9";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let seconds = args.get(1).map_or(Ok(10.0), |text| text.parse());
    let (Some(sensor), Ok(seconds @ 0.1..=1e9), ..=2) = (args.first(), seconds, args.len()) else {
        return Err(USAGE.into());
    };
    // Least and greatest x (right), y (ahead) and z (up from the floor), metres.
    let zone = Zone::new([-1.0, 0.5, 0.05], [1.0, 5.0, 2.0])?;
    let mut client = Client::new(sensor)?;
    loop {
        let Some(sweep) = client.next(Duration::from_secs(1))?.received() else {
            eprintln!("nothing is heard of {sensor}");
            continue;
        };
        let view = sweep.view()?;
        if view.header.height_m == 0.0 {
            eprintln!("the height of {sensor} is not known: set `height_m` in `[sensor.mount]`");
        }
        if view.obstacle(&zone, LeastReturns::default()).is_some() {
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
