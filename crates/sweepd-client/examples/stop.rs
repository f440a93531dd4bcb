//! Says "stop" while an obstacle is in the way: in a box ahead of the robot that stands on the floor.
//!
//!     cargo run --release -p sweepd-client --example stop -- SENSOR [WIDTH [LENGTH [MODEL]]]
//!
//! The way is WIDTH wide and LENGTH long, metres, from the robot's origin; it begins 0.5 m ahead and
//! goes from 5 cm to 2 m over the floor. "stop" is also said while whole turns stay away for 0.3 s, while
//! the sensor does not see what it should or its height is not known, and of a sweep of another model:
//! a number of docs/layout.md, 0 (the default) for that of the first sweep.
//!
//! "stop" takes sweeps. "object ahead, not confirmed" comes earlier, while the head turns: the
//! box of an object reaches into the way. So does that of a wall beside it: slow down, do not stop.
//!
//! **No output does not mean that the way is free.** What lies nearer than the lowest beam, or than
//! the way, is not seen any more. What one row alone strikes can be ground, and so can a low thing that
//! is deeper than 1 m, or a pallet. Holes and steps down are no obstacles. `cargo run --release
//! --example obstacles` prints what is seen by sensor, height and distance.

use std::time::{Duration, Instant};

use sweepd_client::sweep::{Frame, LeastReturns, SweepRef, Zone};
use sweepd_client::sweep::{eye::eye_sentence, layout::flags, objects::ObjectsRef};
use sweepd_client::{client::Client, host::realtime_ns};

/// A sensor that is well gives a sweep at least this often: it turns five times a second or faster.
const SILENCE: Duration = Duration::from_millis(300);

/// Says why the robot must stop by a sweep.
fn sweep_says(name: &str, sweep: &SweepRef<'_>, way: &Zone, model: u32) {
    let header = sweep.header;
    if header.model != model {
        println!("stop: {name} is of model {}, not {model}", header.model);
    }
    if let Some(sentence) = eye_sentence(header.flags) {
        println!("stop: {name}: {sentence}");
    }
    if header.height_m == 0.0 {
        println!("stop: the height of {name} is not known: set `height_m` in `[sensor.mount]`");
    } else if let Some(found) = sweep.obstacle(way, LeastReturns::default()) {
        let (at_m, number) = (found.distance_m, header.sequence);
        println!("stop: an obstacle at {at_m:.2} m, sweep {number}");
    }
}

/// Says which objects may be in the way.
fn objects_say(message: &ObjectsRef<'_>, way: &Zone) {
    let way = way.on_floor(message.header.floor_m());
    let since_ns = realtime_ns().saturating_sub(message.header.time_ns);
    for (object, bounds_m) in message.objects.iter().zip(message.boxes(Frame::Robot)) {
        // What is wide was there in parts before, whose boxes say more.
        if !object.segment.is_wide() && way.meets(bounds_m) {
            let (at_m, last_ns) = (object.segment.nearest_m, i64::from(object.last_ns));
            let ms = since_ns.saturating_sub(last_ns) / 1_000_000;
            println!("object ahead, not confirmed: {at_m:.2} m from the sensor, seen {ms} ms ago");
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let text = |at: usize, absent| args.get(at).map_or(absent, String::as_str);
    let [width_m, length_m] = [text(1, "2"), text(2, "5")].map(|m| m.parse().unwrap_or(f64::NAN));
    let (least_m, most_m) = ([-width_m / 2.0, 0.5, 0.05], [width_m / 2.0, length_m, 2.0]);
    let (way, model) = (Zone::new(least_m, most_m), text(3, "0").parse::<u32>());
    let (Ok(way), Ok(mut model), 1..=4) = (way, model, args.len()) else {
        return Err("SENSOR [WIDTH [LENGTH [MODEL]]]: WIDTH is at least 0 and LENGTH 0.5, metres; MODEL is a number of docs/layout.md".into());
    };
    let mut client = Client::new(&args[0])?;
    let (mut objects, mut heard) = (client.objects()?, Instant::now());
    loop {
        // Not longer, as a sweep may come meanwhile.
        if let Some(message) = objects.next(Duration::from_millis(10))?.received() {
            objects_say(&message.view()?, &way);
        }
        while let Some(sweep) = client.next(Duration::ZERO)?.received() {
            let view = sweep.view()?;
            model = if model == 0 { view.header.model } else { model };
            sweep_says(&args[0], &view, &way, model);
            // Only a whole turn has looked everywhere.
            if !view.header.has(flags::PARTIAL | flags::STOPPED) {
                heard = Instant::now();
            }
        }
        if heard.elapsed() > SILENCE {
            println!("stop: no whole turn of {} came for 0.3 s", args[0]);
            heard = Instant::now();
        }
    }
}
