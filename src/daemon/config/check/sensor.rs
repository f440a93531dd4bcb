//! One `[[sensor]]`.

use std::net::{IpAddr, Ipv4Addr, SocketAddrV4};
use std::ops::{Range, RangeInclusive};
use std::str::FromStr;

use toml::Spanned;

use super::Check;
use crate::daemon::config::error::Problem;
use crate::daemon::config::file;
use crate::daemon::config::{ObjectsConfig, PortConfig, SensorConfig, possible_models};
use crate::daemon::losses::Limits;
use crate::files;
use crate::publish::{NAME_RULE, is_sensor_name};
use crate::sensor_settings::{Rpm, Settings};
use crate::suggest::suggestion;
use sweepd_core::pipeline;
use sweepd_core::segment::{self, ConfigError, Mask, Setting};
use sweepd_core::sensor::{Calibration, Model, ModelExt};

/// Ports that a Velodyne sends to unless it is told others.
const PORT: u16 = 2368;
const POSITION_PORT: u16 = 8308;
const PORTS: RangeInclusive<i64> = 1..=u16::MAX as i64;
/// Consumers that a service has room for.
const MAX_CONSUMERS: usize = 4;
const CONSUMERS: RangeInclusive<i64> = 1..=16;
/// Priorities of SCHED_FIFO (sched(7)).
const REALTIME_PRIORITIES: RangeInclusive<i64> = 1..=99;
/// How long objects may wait, milliseconds, and how wide they may be, degrees.
const OBJECTS_EVERY_MS: RangeInclusive<i64> = 1..=100;
const MAX_OBJECT_DEG: RangeInclusive<f64> = 5.0..=360.0;
/// Shares of packets that may be missing, percent.
const LOSS_PERCENT: RangeInclusive<f64> = 0.1..=100.0;
/// Distances from the origin of a robot, metres, and turns, degrees.
const POSITION_M: RangeInclusive<f64> = -100.0..=100.0;
const TURN_DEG: RangeInclusive<f64> = -360.0..=360.0;

impl Check<'_> {
    /// A sensor; where something is wrong, that has been said and what comes back is of no use.
    pub(super) fn sensor(
        &mut self,
        sensor: &file::Sensor,
        at: Range<usize>,
    ) -> Option<SensorConfig> {
        self.name(&sensor.name);
        let source = self.source(&sensor.address);
        let port = self.port(sensor);
        let position_port = self.whole("position_port", &sensor.position_port, PORTS);
        let max_consumers = self.whole("max_consumers", &sensor.max_consumers, CONSUMERS);
        let objects = self.objects(sensor);
        let losses = self.losses(sensor);
        let model = self.model(&sensor.model);
        self.returns_are_of(model, &sensor.dual);
        let want = self.want(&sensor.want, model);
        let pipeline = self.pipeline(sensor, model, at);
        let (ip, source_port) = source?;
        Some(SensorConfig {
            name: sensor.name.get_ref().clone(),
            address: IpAddr::V4(ip),
            source_port,
            port,
            position_port: position_port.unwrap_or(POSITION_PORT),
            max_consumers: max_consumers.unwrap_or(MAX_CONSUMERS),
            objects,
            dual: sensor.dual.as_ref().map(|dual| *dual.get_ref()),
            want,
            losses,
            pipeline: pipeline?,
        })
    }

    /// A name stands in that of a service and in those of files.
    fn name(&mut self, name: &Spanned<String>) {
        let text = name.get_ref();
        if !is_sensor_name(text) {
            let expected = format!("expected {NAME_RULE}");
            self.problem(
                name.span(),
                format!("a sensor cannot be called {text:?}"),
                expected,
            );
        }
    }

    /// Where packets come from: IP or IP:PORT.
    fn source(&mut self, address: &Spanned<String>) -> Option<(Ipv4Addr, Option<u16>)> {
        let text = address.get_ref();
        let alone = text.parse::<Ipv4Addr>().ok().map(|ip| (ip, None));
        let source = alone.or_else(|| {
            text.parse::<SocketAddrV4>()
                .ok()
                .map(|at| (*at.ip(), Some(at.port())))
        });
        let is_host = |&(ip, port): &(Ipv4Addr, _)| {
            !ip.is_unspecified() && !ip.is_multicast() && !ip.is_broadcast() && port != Some(0)
        };
        let source = source.filter(is_host);
        if source.is_none() {
            let expected = "expected the sensor's own IPv4 address, such as 192.168.1.201, or with its port, 192.168.1.201:2368";
            let cure = "`sweepd inspect` of a recording names the senders";
            let problem = Problem::new(
                address.span(),
                format!("`address` cannot be {text:?}"),
                expected,
            );
            self.problems.push(problem.with_cure(cure));
        }
        source
    }

    fn port(&mut self, sensor: &file::Sensor) -> PortConfig {
        let an_address = "an IPv4 address of this host, such as 192.168.1.100, or 0.0.0.0 for all";
        let bind = self.text("bind", &sensor.bind, an_address, |ip: &Ipv4Addr| {
            !ip.is_multicast() && !ip.is_broadcast()
        });
        let a_group = "a multicast group, 224.0.0.0 to 239.255.255.255";
        // Linux: IFNAMSIZ less the zero at the end.
        let is_interface =
            |name: &String| (1..=15).contains(&name.len()) && !name.contains([' ', '/', '\0']);
        PortConfig {
            bind: bind.unwrap_or(Ipv4Addr::UNSPECIFIED),
            port: self.whole("port", &sensor.port, PORTS).unwrap_or(PORT),
            multicast: self.text(
                "multicast",
                &sensor.multicast,
                a_group,
                Ipv4Addr::is_multicast,
            ),
            interface: self.text(
                "interface",
                &sensor.interface,
                "a network interface such as eth1",
                is_interface,
            ),
            cpu: self.cpu(&sensor.cpu),
            realtime_priority: self.whole(
                "realtime_priority",
                &sensor.realtime_priority,
                REALTIME_PRIORITIES,
            ),
        }
    }

    /// A core that this machine has, where the system tells which it has.
    fn cpu(&mut self, given: &Option<Spanned<i64>>) -> Option<usize> {
        let cpu = self.whole("cpu", given, 0..=u32::MAX.into())?;
        let online = std::fs::read_to_string("/sys/devices/system/cpu/online").unwrap_or_default();
        if let Some(given) = given
            && !online.is_empty()
            && !lists(&online, cpu)
        {
            let title = format!("`cpu` cannot be {cpu}");
            self.problem(
                given.span(),
                title,
                format!("the cores of this machine are {}", online.trim()),
            );
        }
        Some(cpu)
    }

    fn objects(&mut self, sensor: &file::Sensor) -> ObjectsConfig {
        let every_ms: Option<i64> = self.whole(
            "objects_every_ms",
            &sensor.objects_every_ms,
            OBJECTS_EVERY_MS,
        );
        let given = &sensor.max_object_deg;
        let max_deg = self.number("max_object_deg", given, MAX_OBJECT_DEG, "degrees");
        let default = ObjectsConfig::default();
        ObjectsConfig {
            every_ns: every_ms.map_or(default.every_ns, |ms| ms * 1_000_000),
            max_width_rad: max_deg.map_or(default.max_width_rad, |deg| deg.to_radians() as f32),
        }
    }

    /// Where one limit of two is given, the default of the other gives way.
    fn losses(&mut self, sensor: &file::Sensor) -> Limits {
        let given_warning = &sensor.loss_warning_percent;
        let given_fault = &sensor.loss_fault_percent;
        let key = "loss_warning_percent";
        let warning = self.number(key, given_warning, LOSS_PERCENT, "percent");
        let fault = self.number("loss_fault_percent", given_fault, LOSS_PERCENT, "percent");
        if let (Some(written), Some(warning), Some(fault)) = (given_warning, warning, fault)
            && warning > fault
        {
            let title = format!("`loss_warning_percent` cannot be {warning}");
            self.problem(
                written.span(),
                title,
                format!("expected at most `loss_fault_percent`, which is {fault}"),
            );
        }
        let warning = warning.map(|percent| percent / 100.0);
        let fault = fault.map(|percent| percent / 100.0);
        let default = Limits::default();
        Limits {
            warning: warning.unwrap_or(default.warning.min(fault.unwrap_or(1.0))),
            fault: fault.unwrap_or(default.fault.max(warning.unwrap_or(0.0))),
        }
    }

    fn model(&mut self, given: &Option<Spanned<String>>) -> Option<Model> {
        let given = given.as_ref()?;
        let model = given.get_ref().parse();
        if model.is_err() {
            let flags = Model::ALL
                .map(|model| format!("`{}`", model.flag()))
                .join(", ");
            let expected = format!("expected one of {flags}");
            let cure =
                suggestion(given.get_ref(), &flags).map(|flag| format!("did you mean `{flag}`?"));
            self.problem(
                given.span(),
                format!("no supported model is called {:?}", given.get_ref()),
                expected,
            )
            .cure = cure;
        }
        model.ok()
    }

    fn returns_are_of(&mut self, model: Option<Model>, dual: &Option<Spanned<bool>>) {
        if let Some(dual) = dual
            && *dual.get_ref()
            && model == Some(Model::Hdl64eS2)
        {
            self.problem(
                dual.span(),
                "an HDL-64E S2 sends one return",
                "expected \"single\"",
            )
            .cure = Some("one that sends two is an HDL-64E S3: `model = \"hdl64e-s3\"`".to_owned());
        }
    }

    /// What it should be set to.
    fn want(&mut self, written: &file::Want, model: Option<Model>) -> Settings {
        let is_hdl64e = model.is_some_and(Model::is_hdl64e);
        let rpm = self.whole("rpm", &written.rpm, Rpm::RANGE);
        if let (Some(given), Some(rpm)) = (&written.rpm, rpm)
            && i64::from(rpm) % Rpm::STEP != 0
            && !is_hdl64e
        {
            let title = format!("`rpm` cannot be {rpm}");
            self.problem(given.span(), title, "expected a multiple of 60");
        }
        let web_alone = [
            ("laser", &written.laser),
            ("host", &written.host),
            ("phase_lock", &written.phase_lock),
        ];
        for (key, given) in web_alone {
            if let Some(given) = given.as_ref().filter(|_| is_hdl64e) {
                let title = format!("`{key}` of an HDL-64E cannot be read");
                self.problem(given.span(), title, "it has no web interface");
            }
        }
        Settings {
            rpm: rpm.map(Rpm),
            returns: self.wanted("returns", &written.returns),
            fov: self.wanted("fov", &written.fov),
            laser: self.wanted("laser", &written.laser),
            host: self.wanted("host", &written.host),
            phase_lock: self.wanted("phase_lock", &written.phase_lock),
            ..Settings::default()
        }
    }

    /// A setting, in the words of the command line.
    fn wanted<T: FromStr<Err = &'static str>>(
        &mut self,
        key: &str,
        given: &Option<Spanned<String>>,
    ) -> Option<T> {
        let given = given.as_ref()?;
        let value = given.get_ref().parse();
        if let Err(expected) = value {
            let title = format!("`{key}` cannot be {:?}", given.get_ref());
            self.problem(given.span(), title, expected);
        }
        value.ok()
    }

    fn pipeline(
        &mut self,
        sensor: &file::Sensor,
        model: Option<Model>,
        at: Range<usize>,
    ) -> Option<pipeline::Config> {
        let mount = &sensor.mount;
        let position_m = [
            self.position("x_m", &mount.x_m),
            self.position("y_m", &mount.y_m),
            self.position("z_m", &mount.z_m),
        ];
        let yaw_deg = self
            .number("yaw_deg", &mount.yaw_deg, TURN_DEG, "degrees")
            .unwrap_or(0.0);
        let defaults = pipeline::Config::default();
        let cut_azimuth_deg = self.number(
            "cut_azimuth_deg",
            &sensor.cut_azimuth_deg,
            TURN_DEG,
            "degrees",
        );
        let calibration = self.calibration(&sensor.calibration, model);
        Some(pipeline::Config {
            model,
            cut_azimuth_rad: cut_azimuth_deg.map_or(defaults.cut_azimuth_rad, f64::to_radians),
            return_choice: sensor
                .return_choice
                .as_ref()
                .map_or(defaults.return_choice, |choice| *choice.get_ref()),
            segment: self.segment(sensor, model, calibration.as_ref(), at)?,
            calibration,
            gps_without_pps: sensor.gps_without_pps,
            position_m,
            yaw_rad: yaw_deg.to_radians() as f32,
        })
    }

    fn position(&mut self, key: &str, given: &Option<Spanned<f64>>) -> f32 {
        let metres = self.number(key, given, POSITION_M, "metres");
        metres.unwrap_or(0.0) as f32
    }

    fn calibration(
        &mut self,
        given: &Option<Spanned<String>>,
        model: Option<Model>,
    ) -> Option<Calibration> {
        let path = self.path("calibration", given)?;
        let read = files::calibration(&path)
            .map_err(|error| error.to_string())
            .and_then(|calibration| {
                let fits = match model {
                    Some(model) => calibration.clone().for_model(model).map(drop),
                    None if possible_models(None, Some(&calibration)).next().is_some() => Ok(()),
                    None => Err(format!(
                        "{} beams that are those of no supported model",
                        calibration.beams().len()
                    )),
                };
                fits.map(|()| calibration)
                    .map_err(|why| format!("calibration {}: {why}", path.display()))
            });
        self.file_of(given, read, "the calibration that is named here")
    }

    fn mask(
        &mut self,
        given: &Option<Spanned<String>>,
        model: Option<Model>,
        calibration: Option<&Calibration>,
    ) -> Option<Mask> {
        let path = self.path("mask", given)?;
        let read = files::mask(&path)
            .map_err(|error| error.to_string())
            .and_then(|mask| {
                let rows = mask.rows();
                if possible_models(model, calibration).any(|model| model.spec().channels == rows) {
                    return Ok(mask);
                }
                let sensor = model.map_or_else(
                    || "no model that this may be".to_owned(),
                    |model| format!("not the {model}"),
                );
                Err(format!("mask {} has {rows} rows, {sensor}", path.display()))
            });
        self.file_of(given, read, "the mask that is named here")
    }

    /// What was read of a file that is named, or the reason why not.
    fn file_of<T>(
        &mut self,
        given: &Option<Spanned<String>>,
        read: Result<T, String>,
        label: &str,
    ) -> Option<T> {
        let at = given.as_ref().map_or(0..0, Spanned::span);
        match read {
            Ok(value) => Some(value),
            Err(why) => {
                self.problem(at, why, label);
                None
            }
        }
    }

    fn segment(
        &mut self,
        sensor: &file::Sensor,
        model: Option<Model>,
        calibration: Option<&Calibration>,
        at: Range<usize>,
    ) -> Option<segment::Config> {
        let written = &sensor.segment;
        let mut config = segment::Config::default();
        if let Some(method) = &written.method {
            config.method = *method.get_ref();
        }
        let mut numbers = sensor.mount.numbers.iter().chain(&written.numbers);
        for (setting, given) in numbers.clone() {
            self.setting(setting, given, &mut config);
        }
        config.mask = self.mask(&written.mask, model, calibration);
        let Err(error) = config.check() else {
            return Some(config);
        };
        let key = match error {
            ConfigError::Theta { .. } => "theta_deg",
            ConfigError::Range { .. } if config.max_range_m.is_infinite() => "min_range_m",
            ConfigError::Range { .. } => "max_range_m",
            ConfigError::Height { .. } => "height_m",
            // No key of a file sets it, as the gap.
            _ => "",
        };
        let to_blame = numbers.find(|(setting, _)| setting.key == key);
        self.problem(
            to_blame.map_or(at, |(_, given)| given.span()),
            error.to_string(),
            "",
        );
        None
    }

    /// A number within its range; another one is a problem, and the default stays.
    fn setting(&mut self, setting: &Setting, given: &Spanned<f64>, config: &mut segment::Config) {
        let value = *given.get_ref();
        if setting.allows(value) {
            setting.set(config, value);
            return;
        }
        let title = format!("`{}` cannot be {value}", setting.key);
        self.problem(
            given.span(),
            title,
            format!("expected {}", setting.expected()),
        );
    }
}

/// Whether a list of the kernel, such as `0-3,6`, has a number.
fn lists(list: &str, number: usize) -> bool {
    list.trim().split(',').any(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        matches!((first.parse::<usize>(), last.parse::<usize>()), (Ok(first), Ok(last)) if (first..=last).contains(&number))
    })
}
