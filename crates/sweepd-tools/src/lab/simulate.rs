//! `sweepd simulate`: simulated sensors in a simulated scene.

mod args;
mod cloud;
mod faults;
mod output;
mod progress;
mod truth;

pub use args::Args;

use std::io::{self, Write};
use std::iter::Peekable;

use self::args::SECONDS;
use self::output::Output;
use self::progress::Progress;
use self::truth::{TruthFile, write_objects};
use sweepd::cli::CliError;
use sweepd::files::output::sensor_folder;
use sweepd_core::wire::data::DATA_PACKET_LEN;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};
use sweepd_lab::simulate::delivery::Delivery;
use sweepd_lab::simulate::{Emitter, EmitterConfig, Faults, Scene, SimulatedDatagram, deliver};

/// Runs the command.
///
/// # Errors
/// [`CliError`]: an invalid value, a file that cannot be read or written, an error of the network.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.check()?;
    if let Some(file) = &args.cloud.from_cloud {
        return cloud::run(args, file);
    }
    let scene = args.scene.build(args.seed);
    let configs = args.configs(&scene)?;
    let existing = args.force.existing();
    let former = args.former_truth()?;
    let mut sensors = configs
        .iter()
        .map(|config| Simulated::new(args, config, &scene))
        .collect::<Result<Vec<_>, _>>()?;
    let mut output = Output::open(&args.target, existing)?;
    let mut progress = Progress::new(Some(args.seconds.unwrap_or(SECONDS)));
    while let Some((mut index, mut datagram)) = next(&mut sensors) {
        let elapsed_ns = datagram.arrival_ns - configs[index].start_utc_ns;
        if index < 2 && args.faults.is_exchanged(elapsed_ns) {
            index = 1 - index;
            datagram.source.set_ip(configs[index].address);
        }
        output.send(index, &datagram)?;
        progress.note(datagram.arrival_ns);
        sensors[index].note(&datagram)?;
    }
    progress.finish();
    output.finish()?;
    former.remove()?;
    if let Some(folder) = &args.truth {
        write_objects(folder, existing, &scene)?;
    }
    sensors.into_iter().try_for_each(Simulated::finish)
}

/// The next datagram of all sensors by time of arrival, and the number of its sensor.
fn next(sensors: &mut [Simulated<'_>]) -> Option<(usize, SimulatedDatagram)> {
    let mut first: Option<(i64, usize)> = None;
    for (index, sensor) in sensors.iter_mut().enumerate() {
        if let Some(datagram) = sensor.datagrams.peek()
            && first.is_none_or(|(arrival_ns, _)| datagram.arrival_ns < arrival_ns)
        {
            first = Some((datagram.arrival_ns, index));
        }
    }
    let (_, index) = first?;
    Some((index, sensors[index].datagrams.next()?))
}

/// A sensor at work.
struct Simulated<'a> {
    config: EmitterConfig,
    faults: Faults,
    datagrams: Peekable<Delivery<Emitter<'a>>>,
    truth: Option<TruthFile>,
    data: u64,
    position: u64,
}

impl<'a> Simulated<'a> {
    fn new(args: &Args, config: &EmitterConfig, scene: &'a Scene) -> Result<Self, CliError> {
        let faults = args.faults.rates().plan(config.seed, config.sent_packets());
        let folder = args
            .truth
            .as_ref()
            .map(|folder| match config.address.octets() {
                [.., 201] => folder.clone(),
                _ => folder.join(sensor_folder(&format!("{}:{DATA_PORT}", config.address))),
            });
        let emitter = Emitter::new(config.clone(), scene);
        let emitter = if folder.is_some() {
            emitter
        } else {
            emitter.untold()
        };
        Ok(Self {
            truth: folder
                .map(|folder| {
                    TruthFile::create(&folder, args.force.existing(), config.start_utc_ns)
                })
                .transpose()?,
            datagrams: deliver(emitter, faults.clone()).peekable(),
            config: config.clone(),
            faults,
            data: 0,
            position: 0,
        })
    }

    fn note(&mut self, sent: &SimulatedDatagram) -> Result<(), CliError> {
        let Some(truth) = &sent.truth else {
            self.position += u64::from(sent.destination.port() == POSITION_PORT);
            return Ok(());
        };
        self.data += 1;
        // A packet of another length is not counted, as in a replay.
        match &mut self.truth {
            Some(file) if sent.payload.len() == DATA_PACKET_LEN => file.packet(truth),
            _ => Ok(()),
        }
    }

    /// Finishes the truth, and prints on standard error what was sent, and its faults.
    fn finish(self) -> Result<(), CliError> {
        self.truth.map_or(Ok(()), TruthFile::finish)?;
        let config = &self.config;
        let switched = match config.mode_switch {
            Some(at) => format!(", {} from data packet {at}", config.mode_of(at)),
            None => String::new(),
        };
        // If standard error is closed, the message is lost.
        let _ = writeln!(
            io::stderr(),
            "{} ({}): data packets {}, position packets {}; injected: {}{switched}",
            config.address,
            config.model,
            self.data,
            self.position,
            self.faults.summary()
        );
        Ok(())
    }
}
