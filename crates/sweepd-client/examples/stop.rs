//! Says "stop" while the box of an object reaches into a box ahead of the robot, and how old its
//! newest return is:
//!
//!     cargo run --release -p sweepd-client --example stop -- roof [MODEL]
//!
//! It also says so while sweeps stay away for 0.3 s, while the sensor does not see what it should, and
//! of a sweep of another model: a number of docs/layout.md, by default that of the first sweep.
//!
//! The box stands on the floor. In the robot's frame the sensor is `z_m` of `[sensor.mount]` over
//! the origin, and over the floor its height, configured as `height_m` or estimated: the floor is
//! where these say, but never above the origin. **No output does not mean that the way is free.** What lies nearer
//! than the lowest beam, or than the box, is not seen any more. What one row alone strikes can be
//! ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and steps down are no
//! objects. `cargo run --release --example obstacles` prints what is seen by sensor, height and
//! distance.

use std::time::{Duration, Instant, SystemTime};

use sweepd_client::client::Client;
use sweepd_client::sweep::eye::eye_sentence;
use sweepd_client::sweep::objects::flags;
use sweepd_client::sweep::{Frame, Header};

/// The box, least and greatest x (right), y (ahead) and z (up from the floor), metres.
const STOP_M: [[f64; 3]; 2] = [[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]];

/// A sensor that is well gives a sweep at least this often: it turns five times a second or faster.
const SILENCE: Duration = Duration::from_millis(300);

/// Says "stop" if the sensor of a sweep is not of the model, or does not see.
fn look(name: &str, header: &Header, model: u32) {
    if header.model != model {
        println!("stop: {name} is of model {}, not {model}", header.model);
    }
    if let Some(sentence) = eye_sentence(header.flags) {
        println!("stop: {name}: {sentence}");
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).ok_or("which sensor?")?;
    let mut model: Option<u32> = std::env::args()
        .nth(2)
        .map(|code| code.parse())
        .transpose()?;
    let mut client = Client::new(&name)?;
    let mut objects = client.objects()?;
    let mut heard: Option<Instant> = None;
    loop {
        let message = objects.next(SILENCE)?.received();
        while let Some(sweep) = client.next(Duration::ZERO)?.received() {
            heard = Some(Instant::now());
            let header = sweep.view()?.header;
            look(&name, header, *model.get_or_insert(header.model));
        }
        if message.is_none() || heard.is_none_or(|heard| heard.elapsed() > SILENCE) {
            println!("stop: nothing is heard of {name}");
        }
        let Some(message) = message else { continue };
        let view = message.view()?;
        if view.header.flags & flags::NO_HEIGHT != 0 {
            println!("stop: the height of {name} is not known yet");
        }
        let (up_m, height_m) = (view.header.position_m[2], view.header.height_m);
        if up_m <= 0.0 && height_m <= 0.0 {
            println!(
                "stop: {name} has no z_m in [sensor.mount] and no height: where is the floor?"
            );
        }
        let floor_m = (f64::from(up_m) - f64::from(height_m)).min(0.0);
        // Parts too: a wide object is told in parts first.
        for (object, [mut least_m, mut most_m]) in view.objects.iter().zip(view.boxes(Frame::Robot))
        {
            least_m[2] -= floor_m;
            most_m[2] -= floor_m;
            if (0..3).all(|at| least_m[at] < STOP_M[1][at] && most_m[at] > STOP_M[0][at]) {
                let now_ns = SystemTime::UNIX_EPOCH.elapsed()?.as_nanos() as i64;
                let age_ns = now_ns - (view.header.time_ns + i64::from(object.last_ns));
                let (age_ms, nearest_m) = (age_ns as f64 * 1e-6, object.segment.nearest_m);
                println!("stop: an object at {nearest_m:.2} m, seen {age_ms:.1} ms ago");
            }
        }
    }
}
