//! A recording that the daemon writes.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::args::Args;
use super::live::{TICK, announce, describe, live_line};
use super::report::{InputReport, Report};
use crate::cli::CliError;
use crate::daemon::record::client::{RemoteRecordError, RemoteRecording};
use crate::daemon::record::protocol::{Ended, Reply, Request, VERSION};
use crate::daemon::record::socket_path;
use crate::export::Existing;
use crate::publish::Domain;

/// Has the daemon record a sensor until `over` is set, the time is up, or the daemon ends it.
pub fn record(
    args: &Args,
    sensor: &str,
    path: &Path,
    over: &AtomicBool,
) -> Result<(Report, Result<(), CliError>), CliError> {
    let request = request(args, sensor, path)?;
    let domain = Domain::at_or_default(args.root.as_deref());
    let socket = socket_path(domain.root());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| CliError::System {
            what: "wait for the daemon",
            source,
        })?;
    let name = format!("sensor {sensor} of the daemon");
    runtime.block_on(async {
        let (mut recording, path) = RemoteRecording::begin(&socket, &request).await?;
        announce(&name, &path);
        let begun = Instant::now();
        let mut ended_early = true;
        let line = live_line();
        let ended = loop {
            if ended_early && (over.load(Ordering::Relaxed) || args.is_due(begun)) {
                recording.end().await;
                ended_early = false;
            }
            match recording.next(TICK).await? {
                None => {}
                Some(Reply::Progress(progress)) => line.set_message(describe(begun, &progress)),
                Some(Reply::Ended(ended)) => break ended,
                Some(_) => return Err(recording.unexpected().into()),
            }
        };
        line.finish_and_clear();
        let Ended {
            written,
            received,
            error,
        } = ended;
        let report = Report {
            inputs: vec![InputReport {
                name,
                received,
                // The daemon ends an overdue recording itself.
                ended_early: ended_early && !args.is_due(begun),
            }],
            written,
            took: begun.elapsed(),
        };
        let result = error.map_or(Ok(()), |why| Err(RemoteRecordError::Daemon(why).into()));
        Ok((report, result))
    })
}

fn request(args: &Args, sensor: &str, path: &Path) -> Result<Request, CliError> {
    // The daemon has another working directory.
    let path = std::path::absolute(path).map_err(|source| CliError::System {
        what: "find the current folder",
        source,
    })?;
    if path.to_str().is_none() {
        let path = path.display();
        return Err(CliError::Usage(format!(
            "{path}: a file that the daemon writes needs a name in UTF-8"
        )));
    }
    Ok(Request {
        version: VERSION,
        sensor: sensor.to_owned(),
        senders: args.sensor.iter().map(ToString::to_string).collect(),
        path,
        replaces: args.force.existing() == Existing::Replace,
        rotation: args.rotation(),
        duration: args.seconds.map(Duration::from_secs_f64),
    })
}
