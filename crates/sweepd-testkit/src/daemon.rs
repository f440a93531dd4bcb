//! `sweepd run` in a process of its own, watched from outside: its HTTP pages, its log, its exit
//! code.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::net::{SocketAddrV4, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use super::{Failure, PATIENCE, Process, cannot};

/// A daemon that runs. It is killed when it is dropped.
#[derive(Debug)]
pub struct Daemon {
    /// Its process.
    pub process: Process,
    http: SocketAddrV4,
}

/// An answer over HTTP.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Response {
    /// The status code.
    pub status: u16,
    /// The body.
    pub body: String,
}

/// The command that runs `program` as a daemon with this configuration, without what the caller's
/// environment says about its log and its service manager.
pub fn run_command(program: &Path, config: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .args(["run", "--config"])
        .arg(config)
        .env_remove("SWEEPD_LOG")
        .env_remove("NOTIFY_SOCKET")
        .stdout(Stdio::null());
    command
}

impl Daemon {
    /// Starts a daemon whose configuration has `http` as its HTTP address, and waits until it
    /// answers there.
    ///
    /// # Errors
    /// It does not run, or does not answer within [`PATIENCE`].
    pub fn start(command: &mut Command, http: SocketAddrV4) -> Result<Self, Failure> {
        let mut process = Process::start(command).map_err(cannot("start the daemon"))?;
        process.until(PATIENCE, "the daemon answers on its HTTP port", |_| {
            get(http, "/health").is_ok()
        })?;
        Ok(Self { process, http })
    }

    /// The answer to `GET path`.
    ///
    /// # Errors
    /// There is none.
    pub fn get(&self, path: &str) -> io::Result<Response> {
        get(self.http, path)
    }

    /// The report of its health.
    ///
    /// # Errors
    /// It does not answer, or not in JSON.
    pub fn health(&mut self) -> Result<Value, Failure> {
        let body = self.body("/health")?;
        serde_json::from_str(&body)
            .map_err(|error| self.process.failure(format!("/health: {error}: {body}")))
    }

    /// Its metrics, by name and labels: `sweepd_lost_total{sensor="roof"}`.
    ///
    /// # Errors
    /// It does not answer.
    pub fn metrics(&mut self) -> Result<BTreeMap<String, f64>, Failure> {
        let mut metrics = BTreeMap::new();
        for line in self.body("/metrics")?.lines() {
            if let Some((name, value)) = line.rsplit_once(' ')
                && let Ok(value) = value.parse()
                && !line.starts_with('#')
            {
                metrics.insert(name.to_owned(), value);
            }
        }
        Ok(metrics)
    }

    fn body(&mut self, path: &str) -> Result<String, Failure> {
        match self.get(path) {
            Ok(response) => Ok(response.body),
            Err(error) => Err(self.process.failure(format!("{path}: {error}"))),
        }
    }
}

/// The answer of a server to `GET path`.
///
/// # Errors
/// There is none within [`PATIENCE`].
pub fn get(server: SocketAddrV4, path: &str) -> io::Result<Response> {
    let mut stream = TcpStream::connect_timeout(&server.into(), PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    )?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    let response = text.split_once("\r\n\r\n").and_then(|(head, body)| {
        Some(Response {
            status: head.split(' ').nth(1)?.parse().ok()?,
            body: body.to_owned(),
        })
    });
    response.ok_or_else(|| io::ErrorKind::InvalidData.into())
}
