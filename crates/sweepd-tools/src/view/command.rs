//! `sweepd view`: a page in the browser.

use hyper::http::uri::Authority;
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use sweepd::cli::CliError;
use sweepd::cli::options::{SegmentOptions, SensorOptions, model};
use sweepd::cli::publish::RootOptions;
use sweepd::cli::sections::Sections;
use sweepd::publish::is_sensor_name;
use sweepd_core::sensor::Model;
use sweepd_lab::simulate::Setting;

use super::source::reader::{Origin, SourceConfig};
use super::source::simulation::Simulation;
use super::{Source, serve};
use crate::scene::scene;

/// Where the page is by default.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9178);

/// Options of `sweepd view`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The page shows the points, the range image, the labels and the segments, plays and pauses a capture, \
and tries other options of the segmentation. It is a consumer of its own: the daemon serves no page, \
and nothing that a browser does can slow a sensor. Foxglove and Lichtblick show the same: open the connection \
ws://localhost:9178 in them.

Examples:
  sweepd view pcap_fixtures/street_vlp16.pcap.gz
  sweepd view --simulate hdl32e
  sweepd view --simulate vlp16 --scene warehouse --height 0.4 --pitch -10
  sweepd view roof
  ssh -t -L 9178:localhost:9178 ROBOT sweepd view --no-open")]
pub struct Args {
    /// A capture, as of `sweepd replay`, or the name of a sensor of the running daemon [default: the
    /// only sensor; of several, the page lists them]
    #[arg(value_name = "SOURCE")]
    source: Option<PathBuf>,
    /// A simulated sensor of this model, instead of a SOURCE; it is mounted as --height, --pitch and
    /// --roll say
    #[arg(long, value_name = "MODEL", value_parser = model(), hide_possible_values = true, conflicts_with = "source")]
    simulate: Option<Model>,
    /// Scene of the simulated sensor
    #[arg(long, default_value = "street", value_parser = scene(), requires = "simulate")]
    scene: Setting,
    /// Where to serve the page; port 0 takes a free one
    #[arg(long, value_name = "IP:PORT", default_value_t = LISTEN)]
    listen: SocketAddr,
    /// Allow --listen at an address that others can reach. There is no password and no encryption:
    /// everyone in that network can see what the sensor sees, and play, pause, seek and choose what
    /// all pages show
    #[arg(long)]
    public: bool,
    /// Let web pages of this origin read by the protocol of Foxglove, beside those of this host, Foxglove
    /// and Lichtblick, such as `https://lichtblick.example`; give it again for another
    #[arg(long, value_name = "ORIGIN", value_parser = origin)]
    allow_origin: Vec<String>,
    /// Do not open the browser
    #[arg(long)]
    no_open: bool,
    /// At the end of a capture, begin again; a simulation, and a capture of at most 100 sweeps, always
    /// do
    #[arg(long = "loop")]
    is_endless: bool,
    #[command(flatten)]
    sensor: SensorOptions,
    #[command(flatten)]
    segment: SegmentOptions,
    #[command(flatten)]
    root: RootOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: there is no such source, or the page cannot be served.
pub fn run(args: &Args) -> Result<(), CliError> {
    let sections = Sections::read(&args.sensor, &args.segment)?;
    let source = match args.source.as_deref() {
        None if let Some(model) = args.simulate => {
            let sections = sections.for_any_sender(&args.sensor.config)?;
            let mount = &sections.all()[0].sensor.pipeline.segment.mount;
            let simulation = Simulation::new(model, args.scene, mount).map_err(|error| {
                CliError::Failed(format!("{error}; give another --height or --scene"))
            })?;
            Source::Capture {
                source_config: SourceConfig {
                    origin: Origin::Simulation(Arc::new(simulation)),
                    sections: Arc::new(sections),
                },
                is_endless: true,
            }
        }
        Some(path) if !args.is_sensor(path)? => Source::Capture {
            source_config: SourceConfig {
                origin: Origin::Capture(path.to_owned()),
                sections: Arc::new(sections),
            },
            is_endless: args.is_endless,
        },
        _ if args.is_endless || args.sensor.is_given() || args.segment.removes() => {
            let message = "a sensor's sweeps are shared decoded, by the daemon's configuration, which the page begins with: --loop, \
                 --config, --model, --calibration, --sensor, --cut-azimuth, --return, --gps-without-pps, --remove and --remove-box are \
                 for captures; leave them out";
            return Err(CliError::Usage(message.to_owned()));
        }
        named => Source::Sensor {
            domain: args.root.domain(),
            name: named.and_then(Path::to_str).map(str::to_owned),
            options: Box::new(args.segment.clone()),
        },
    };
    let listener = args.bind()?;
    let address = listener
        .local_addr()
        .map_err(|source| args.cannot_listen(&source))?;
    let origins = args.allow_origin.clone();
    serve(source, listener, address, origins, || {
        args.announce(address)
    })
}

impl Args {
    /// Whether a source is the name of a sensor, and no file.
    fn is_sensor(&self, source: &Path) -> Result<bool, CliError> {
        if source == Path::new("-") {
            let message =
                "standard input cannot be played again and again: give the path of a file";
            return Err(CliError::Usage(message.to_owned()));
        }
        if source.exists() {
            return Ok(false);
        }
        let name = source.to_str().filter(|name| is_sensor_name(name));
        // A name with a dot is more likely a file that was mistyped, unless there is such a sensor.
        let is_likely = |name: &str| {
            !name.contains('.')
                || sweepd_client::client::Client::sensors(&self.root.domain())
                    .is_ok_and(|sensors| sensors.iter().any(|sensor| sensor == name))
        };
        if name.is_some_and(is_likely) {
            return Ok(true);
        }
        Err(CliError::NoInput(format!(
            "there is no capture {}, and no sensor of that name is published in {}: check the path, or start the daemon first",
            source.display(),
            self.root.domain().root().display()
        )))
    }

    fn bind(&self) -> Result<TcpListener, CliError> {
        if !self.listen.ip().is_loopback() && !self.public {
            return Err(CliError::Usage(format!(
                "--listen {}: others could reach that address, and there is no password; add --public if they may see the \
                 sensor, or listen on 127.0.0.1 and use `ssh -t -L 9178:localhost:9178`",
                self.listen
            )));
        }
        TcpListener::bind(self.listen).map_err(|source| self.cannot_listen(&source))
    }

    fn cannot_listen(&self, source: &io::Error) -> CliError {
        let listen = self.listen;
        CliError::Failed(match source.kind() {
            io::ErrorKind::AddrInUse => format!(
                "cannot listen on {listen}: another program does, maybe another `sweepd view`; end that one, or give another \
                 port, such as --listen {}:{}",
                listen.ip(),
                listen.port().wrapping_add(1).max(1024)
            ),
            _ => format!(
                "cannot listen on {listen}: {source}; give an address of this host and a port from 1024 on with --listen"
            ),
        })
    }

    /// Prints where the page is, and opens it.
    fn announce(&self, address: SocketAddr) -> Result<(), CliError> {
        let mut shown = address;
        if address.ip().is_unspecified() {
            shown.set_ip(Ipv4Addr::LOCALHOST.into());
        }
        if self.public {
            let port = address.port();
            // Without standard error it cannot be told.
            let _ = writeln!(
                io::stderr(),
                "others open it at port {port} of this host's IP address: without a password they see what the sensor sees, and \
                 play, pause, seek and choose what all pages show"
            );
        }
        let url = format!("http://{shown}/");
        let mut out = io::stdout().lock();
        writeln!(out, "{url}")
            .and_then(|()| out.flush())
            .map_err(CliError::Stdout)?;
        if !self.no_open {
            open(&url);
        }
        Ok(())
    }
}

/// An origin as a browser writes it: without the port that its scheme has by default.
fn origin(text: &str) -> Result<String, String> {
    let text = text.to_ascii_lowercase();
    let [http, https] = ["http", "https"].map(|scheme| text.strip_prefix(&format!("{scheme}://")));
    let usual_port = if https.is_some() { ":443" } else { ":80" };
    match https.or(http).map(Authority::try_from) {
        Some(Ok(host)) if !host.as_str().contains('@') => {
            Ok(text.strip_suffix(usual_port).unwrap_or(&text).to_owned())
        }
        _ => Err("expected scheme and host alone, such as https://lichtblick.example".to_owned()),
    }
}

/// Opens a page in the browser, if there are a display and a program that does it.
fn open(url: &str) {
    let has_display = ["DISPLAY", "WAYLAND_DISPLAY"]
        .iter()
        .any(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()));
    if !has_display {
        return;
    }
    let opener = Command::new("xdg-open")
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    // The address is printed: without a browser, people open it themselves.
    if let Ok(mut opener) = opener {
        std::thread::spawn(move || opener.wait());
    }
}

#[cfg(test)]
mod tests {
    use super::origin;

    #[test]
    fn an_origin_is_scheme_and_host() {
        assert_eq!(
            origin("https://Robots.example:8443").as_deref(),
            Ok("https://robots.example:8443")
        );
        let usual = origin("https://robots.example:443");
        assert_eq!(usual.as_deref(), Ok("https://robots.example"));
        for text in [
            "",
            "null",
            "robots.example",
            "https://",
            "https://robots.example/",
            "https://robots.example?all",
            "https://me@robots.example",
            "https://robots example",
        ] {
            assert!(origin(text).is_err(), "{text}");
        }
    }
}
