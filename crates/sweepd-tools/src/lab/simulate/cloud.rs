//! `--from-cloud`: a real scan as the packets of an HDL-64E.

use std::path::{Path, PathBuf};

use super::args::Args;
use super::output::Output;
use super::progress::Progress;
use super::truth::TruthFile;
use crate::lab::read_file;
use crate::lab::segment::MAX_CLOUD_LEN;
use sweepd::cli::{CliError, complain};
use sweepd::files::output;
use sweepd_core::sensor::ros_yaml;
use sweepd_lab::cloud::points;
use sweepd_lab::simulate::cloud::{FromCloudError, MODEL, Options, Sender, Sending, Turn};
use sweepd_lab::simulate::{Faults, config, deliver};

/// Runs the command for the cloud in a file.
///
/// # Errors
/// [`CliError`]: an invalid cloud or calibration, a file that cannot be read or written.
pub fn run(args: &Args, cloud: &Path) -> Result<(), CliError> {
    let fitted = args
        .cloud
        .fit_elevations
        .then(|| fitted_file(args))
        .transpose()?;
    let turn = encode(args, cloud)?;
    let start_utc_ns = args.start_utc_ns();
    let sending = Sending {
        seconds: args.seconds,
        clock: args.gps.clock(),
        start_utc_ns,
        address: config::address(MODEL),
    };
    let sender = Sender::new(&turn, sending).map_err(|error| cloud_error(cloud, error))?;
    let faults = args.faults.rates().plan(args.seed, sender.packets());
    let existing = args.force.existing();
    let former = args.former_truth()?;
    let mut truth = match &args.truth {
        Some(folder) => Some(TruthFile::create(folder, existing, start_utc_ns)?),
        None => None,
    };
    let mut output = Output::open(&args.target, existing)?;
    if let Some(path) = fitted {
        output::write(
            &path,
            ros_yaml::emit(turn.calibration()).as_bytes(),
            existing,
        )?;
    }
    let mut progress = Progress::new(args.seconds);
    let mut packets = 0;
    for datagram in deliver(sender, faults.clone()) {
        output.send(0, &datagram)?;
        progress.note(datagram.arrival_ns);
        packets += 1;
        if let (Some(file), Some(truth)) = (&mut truth, &datagram.truth) {
            file.packet(truth)?;
        }
    }
    progress.finish();
    output.finish()?;
    former.remove()?;
    truth.map_or(Ok(()), TruthFile::finish)?;
    conclude(cloud, &turn, packets, &faults);
    Ok(())
}

/// The cloud as a turn of the sensor.
fn encode(args: &Args, cloud: &Path) -> Result<Turn, CliError> {
    let Some(calibration) = args.calibration(MODEL)? else {
        let message = "--from-cloud needs --calibration FILE, that of an HDL-64E: each unit has beams of its own";
        return Err(CliError::Usage(message.to_owned()));
    };
    let points = points(&read_file(cloud, MAX_CLOUD_LEN)?)
        .map_err(|error| cloud_error(cloud, error.into()))?;
    let options = Options {
        fit: args.cloud.fit_elevations,
        rpm: args.rpm,
    };
    Turn::new(&points, &calibration, options).map_err(|error| cloud_error(cloud, error))
}

fn cloud_error(cloud: &Path, error: FromCloudError) -> CliError {
    CliError::Failed(format!("{}: {error}", cloud.display()))
}

/// The file of the fitted calibration: beside the capture by default. Never the file that is
/// fitted.
fn fitted_file(args: &Args) -> Result<PathBuf, CliError> {
    let beside = args.target.pcap.as_deref().and_then(yaml_beside);
    let named = args.cloud.fitted.clone().or(beside);
    let Some(path) = named else {
        let message = "--fit-elevations: give --fitted FILE.yaml, where the calibration goes; without a --pcap \
                       NAME.pcap it has no place";
        return Err(CliError::Usage(message.to_owned()));
    };
    let existing = path.canonicalize().ok();
    let fitted_to = (args.calibration.as_ref()).and_then(|path| path.canonicalize().ok());
    if existing.is_some() && existing == fitted_to {
        let message = format!(
            "{} would be overwritten; give another --fitted FILE.yaml",
            path.display()
        );
        return Err(CliError::Usage(message));
    }
    output::check(&path, args.force.existing())?;
    Ok(path)
}

/// NAME.yaml beside NAME.pcap or NAME.pcap.gz.
fn yaml_beside(capture: &Path) -> Option<PathBuf> {
    let name = capture.file_name()?.to_str()?;
    let stem = name
        .strip_suffix(".gz")
        .unwrap_or(name)
        .strip_suffix(".pcap")?;
    Some(capture.with_file_name(format!("{stem}.yaml")))
}

/// Prints on standard error how many points were encoded, and what was sent.
fn conclude(cloud: &Path, turn: &Turn, packets: u64, faults: &Faults) {
    complain(&cloud.display().to_string(), turn.report());
    let message = format!(
        "data packets {packets}, {:.1} turns a minute; injected: {}",
        turn.rpm(),
        faults.summary()
    );
    complain(&format!("{} ({MODEL})", config::address(MODEL)), message);
}
