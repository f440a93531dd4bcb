//! State of a sensor: derives it from counts, and a message from each change. Pure: time is an
//! input.

mod changes;

use std::fmt;
use std::time::Duration;

use changes::{Changes, HostClock, Receiver};

use super::losses::{Losses, Turn};
use crate::judge::losses::{Level, Limits, Recent, SensorAddress, Tally};
use crate::judge::{self, Finding, Fix, Remark, Severity, Topic};
use crate::sensor_settings::{FieldOfView, Settings};
use crate::strangers::Cause;
use crate::{beams, floor, gps};
use sweepd_core::assemble::GpsDoubt;
use sweepd_core::floor::Sight;
use sweepd_core::pipeline::DarkBeam;
use sweepd_core::sensor::{Model, detect};
use sweepd_core::sweep::eye::{eye_faults, eye_sentence};
use sweepd_core::sweep::layout::TimeSource;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::position::Pps;

/// A sensor no longer streams after this time without packets, or without a steady sweep while
/// packets come.
pub const PATIENCE: Duration = Duration::from_secs(2);
/// Least interval between two reasons in the log why no packets come.
const TELL_EVERY: Duration = Duration::from_secs(60);
/// Greatest deviation from the configured speed without a message, as a share of it; the message is
/// withdrawn within half of that.
const RPM_TOLERANCE: f32 = 0.05;

/// How a sensor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No packet has come.
    Waiting,
    /// Packets come, but no whole sweep at a steady speed yet.
    SpinningUp,
    /// Sweeps come.
    Streaming,
    /// Sweeps come, but do not show what is there: see [`eye_faults`].
    NotSeeing,
    /// More packets are lost or unusable than the first limit allows: see [`Limits::warning`].
    Losing,
    /// The same above the second limit: see [`Limits::fault`].
    LosingMany,
    /// Packets came, and come no more.
    Stalled,
    /// The packets are of an unsupported model, or of another than configured.
    WrongModel,
    /// An HDL-64E without a calibration: waits for the one that it sends.
    NoCalibration,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Waiting,
        Self::SpinningUp,
        Self::Streaming,
        Self::NotSeeing,
        Self::Losing,
        Self::LosingMany,
        Self::Stalled,
        Self::WrongModel,
        Self::NoCalibration,
    ];

    /// Its name in output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::SpinningUp => "spinning up",
            Self::Streaming => "streaming",
            Self::NotSeeing => "not seeing",
            Self::Losing => "losing packets",
            Self::LosingMany => "losing many packets",
            Self::Stalled => "stalled",
            Self::WrongModel => "wrong model",
            Self::NoCalibration => "no calibration",
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Counts of a sensor at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// The moment: time since any fixed one.
    pub now: Duration,
    /// Data packets admitted so far.
    pub data: u64,
    /// Position packets admitted so far.
    pub position: u64,
    /// Whole sweeps at a steady speed so far.
    pub steady_sweeps: u64,
    /// State of the sensor from the newest sweep.
    pub running: Option<Running>,
    /// Counts of its packets so far.
    pub tally: Tally,
    /// What else its packets told.
    pub facts: Facts,
}

/// What the packets of a sensor tell of it, beside its sweeps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Facts {
    /// The factory byte, if it says other beams than the given model has.
    pub other_product: Option<u8>,
    /// Times that its clock began anew after a silence.
    pub restarts: u64,
    /// Times that its clock jumped while packets came.
    pub clock_jumps: u64,
    /// The pulse per second, and the GPS receiver.
    pub pulse: Option<(Pps, Fix)>,
    /// How far the host's clock is ahead of UTC by GPS, seconds, where GPS vouches for it.
    pub host_ahead_s: Option<f64>,
    /// Whether it leaves out a part of each turn.
    pub is_view_limited: bool,
}

/// State of the sensor from a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Running {
    /// The model.
    pub model: Model,
    /// Turns a minute.
    pub rpm: f32,
    /// Which returns it reports.
    pub return_mode: ReturnMode,
    /// What it measures of a turn, if sweeps have shown it.
    pub fov: Option<FieldOfView>,
}

impl fmt::Display for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let returns = if self.return_mode == ReturnMode::Dual {
            "two returns"
        } else {
            "one return"
        };
        write!(f, "{} at {:.0} rpm, {returns}", self.model, self.rpm)
    }
}

/// Why the pipeline decodes nothing while packets come.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Hindrance {
    WrongModel(String),
    NoCalibration,
}

/// A sentence for the log, and its level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Whether it needs action.
    pub is_warning: bool,
    /// The sentence, with the name of the sensor.
    pub text: String,
}

/// Condition of a sensor, for other threads.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// In a word.
    pub state: State,
    /// Why it is not well; `None` if it is.
    pub complaint: Option<String>,
    /// Whether it counts as failed: it does not stream, or loses more than [`Limits::fault`]
    /// allows.
    pub is_fault: bool,
    /// What is wrong with it and what else is worth knowing, with cures, its state first.
    pub findings: Vec<Finding>,
    /// Counts over the last seconds, while packets come.
    pub recent: Option<Recent>,
    /// The same in words, if packets are missing: share and cause, and the cure.
    pub losses: Option<[String; 2]>,
    /// What it sees of the floor.
    pub floor: floor::Seen,
}

/// Watches one sensor.
#[derive(Clone, Debug)]
pub struct Watcher {
    name: String,
    /// Source and port of its packets.
    place: SensorAddress,
    losses: Losses,
    /// The log has the kernel as the cause of the losses.
    log_blames_kernel: bool,
    /// What it should be set to.
    want: Settings,
    state: State,
    hindrance: Option<Hindrance>,
    /// The hindrance that was last logged.
    told_hindrance: Option<Hindrance>,
    before: Observation,
    newest_data: Duration,
    newest_sweep: Duration,
    /// When packets that are decoded last began to come.
    begun: Duration,
    /// Whether it was logged that no packets come at all.
    has_hinted: bool,
    /// Why no packets come, as far as this host knows.
    silence: Option<Cause>,
    /// The same as last logged, and when.
    told_silence: Option<(Cause, Duration)>,
    is_off_speed: bool,
    /// Other settings that packets show to be other than wanted, by name and in words.
    unlike: Vec<(&'static str, String)>,
    /// The beams that have been dark for so long that people are to be warned.
    dark: Vec<DarkBeam>,
    /// Bits of the newest sweep that say that it does not see.
    eye: u32,
    floor: floor::Seen,
    /// What was logged of the floor.
    told_floor: Sight,
    /// The clock of its sweeps, and what is doubtful about GPS time.
    time: (TimeSource, Option<GpsDoubt>),
    /// What its packets tell beside its sweeps.
    remarks: Vec<Remark>,
    /// Those that the log has, as grave as they were there.
    told_remarks: Vec<(Remark, Finding)>,
    /// What is wrong with its calibration.
    calibration: Option<Remark>,
    changes: Changes,
    host_clock: HostClock,
    receiver: Receiver,
    /// Model and mode as last logged.
    told: Option<(Model, ReturnMode)>,
}

impl Watcher {
    /// A watcher of a sensor that has sent nothing yet; `now` as in [`Observation::now`].
    pub fn new(
        name: &str,
        place: SensorAddress,
        want: Settings,
        limits: Limits,
        now: Duration,
    ) -> Self {
        Self {
            name: name.to_owned(),
            place,
            losses: Losses::new(limits),
            log_blames_kernel: false,
            want,
            state: State::Waiting,
            hindrance: None,
            told_hindrance: None,
            before: Observation::default(),
            newest_data: now,
            newest_sweep: now,
            begun: now,
            has_hinted: false,
            silence: None,
            told_silence: None,
            is_off_speed: false,
            unlike: Vec::new(),
            dark: Vec::new(),
            eye: 0,
            floor: Default::default(),
            told_floor: Sight::Unknown,
            time: (TimeSource::Host, None),
            remarks: Vec::new(),
            told_remarks: Vec::new(),
            calibration: None,
            changes: Changes::default(),
            host_clock: HostClock::default(),
            receiver: Receiver::default(),
            told: None,
        }
    }

    /// How the sensor is.
    pub fn state(&self) -> State {
        match (self.state, self.losses.level()) {
            (State::Streaming, _) if eye_faults(self.eye).any(|fault| fault.is_fault) => {
                State::NotSeeing
            }
            (State::Streaming, Some(Level::Warning)) => State::Losing,
            // Losses so high that no sweep is steady count too.
            (State::Streaming | State::SpinningUp, Some(Level::Fault)) => State::LosingMany,
            (state, _) => state,
        }
    }

    /// How the sensor is, and why.
    pub fn condition(&self) -> Condition {
        let state = self.state();
        let complaint = self.complaint();
        let recent = self.losses.recent();
        let is_fault = match state {
            State::Streaming | State::Losing => self.is_off_speed || self.drops_many(),
            _ => true,
        };
        let losses = recent
            .filter(|recent| recent.share() > 0.0)
            .map(|recent| [recent.what(&self.place), recent.cure(&self.place)]);
        Condition {
            state,
            complaint,
            is_fault,
            findings: self.findings(),
            recent,
            losses,
            floor: self.floor,
        }
    }

    /// Changes the limits of losses.
    pub fn limit_losses(&mut self, limits: Limits) {
        self.losses.limit(limits);
    }

    /// It is decoded with another configuration from now on: earlier counts are not comparable.
    pub fn reconfigured(&mut self) {
        self.hindrance = None;
        self.losses.begin_anew();
        self.floor = Default::default();
        self.told_floor = Sight::Unknown;
        self.calibration = None;
    }

    /// Other settings are wanted from now on.
    pub fn expect(&mut self, want: Settings) {
        self.is_off_speed &= want.rpm == self.want.rpm;
        self.want = want;
    }

    /// Why the sensor is not well; `None` where it is.
    pub fn complaint(&self) -> Option<String> {
        let mut all = Vec::new();
        for finding in self.findings().iter().filter(|one| one.is_trouble()) {
            all.push(match finding.topic {
                // What is to be cleaned is told by the beams.
                Topic::Lasers => finding.what.clone(),
                _ => finding.to_string(),
            });
        }
        (!all.is_empty()).then(|| all.join("; "))
    }

    /// What is wrong with it and what else is worth knowing, its state first.
    fn findings(&self) -> Vec<Finding> {
        let mut all = match (self.state(), &self.hindrance) {
            (State::Streaming | State::NotSeeing | State::Losing | State::LosingMany, _) => {
                self.shortcomings()
            }
            (State::Waiting | State::Stalled, _) => vec![self.silence()],
            (State::WrongModel, Some(Hindrance::WrongModel(why))) => {
                vec![Finding::new(Severity::Error, Topic::Model, why, "")]
            }
            (State::NoCalibration, _) => vec![no_calibration()],
            (State::SpinningUp, _) if self.has_begun() => vec![first_turn()],
            (State::SpinningUp | State::WrongModel, _) => vec![no_sweep()],
        };
        let is_silent = matches!(self.state, State::Waiting | State::Stalled);
        for remark in &self.remarks {
            if !self.is_told_by_losses(remark) && (!is_silent || remark.is_change()) {
                all.extend(remark.finding());
            }
        }
        all
    }

    /// Whether the losses tell it too, with the kernel as their cause.
    fn is_told_by_losses(&self, remark: &Remark) -> bool {
        let are_told = self.state() != State::SpinningUp && self.losses.tell_drops();
        are_told && matches!(remark, Remark::Dropped { .. })
    }

    /// Whether packets have come for so short a time that there need be no whole turn yet.
    fn has_begun(&self) -> bool {
        self.before.now - self.begun < PATIENCE && self.newest_sweep <= self.begun
    }

    /// What is not as it should be while packets come.
    fn shortcomings(&self) -> Vec<Finding> {
        let mut all = judge::of_eye(self.eye);
        let loses = self.losses.level().map(Level::severity);
        if let Some((severity, recent)) = loses.zip(self.losses.recent()) {
            let what = recent.what(&self.place);
            all.push(Finding::new(
                severity,
                Topic::Loss,
                what,
                recent.cure(&self.place),
            ));
        }
        if self.is_off_speed {
            let it = if loses.is_some() { "it " } else { "" };
            let what = format!("{it}{}", self.off_speed());
            all.push(Finding::new(
                Severity::Error,
                Topic::Speed,
                what,
                CHANGE_ONE,
            ));
        }
        if !self.unlike.is_empty() {
            let what = self.unlike();
            all.push(Finding::new(
                Severity::Warning,
                Topic::Settings,
                what,
                CHANGE_ONE,
            ));
        }
        if let Some(what) = beams::sentence(&self.dark) {
            all.push(Finding::new(
                Severity::Warning,
                Topic::Lasers,
                what,
                beams::CURE,
            ));
        }
        all.extend(self.floor.finding());
        all.extend(self.time.1.as_ref().map(gps::finding));
        all
    }

    /// Whether the kernel drops more datagrams than the second limit allows.
    fn drops_many(&self) -> bool {
        (self.losses.dropping()).is_some_and(|(level, _)| level == Level::Fault)
    }

    /// The calibration in use is not right. It is told until the sensor is decoded anew.
    pub fn doubts_calibration(&mut self, remark: Remark) {
        self.calibration = Some(remark);
    }

    /// Takes what the packets tell beside sweeps, and gives a message for each that is new, graver
    /// than before, or over.
    fn remark(&mut self, now: &Observation) -> Vec<Message> {
        self.remarks = self.remarks_of(now);
        let mut told = std::mem::take(&mut self.told_remarks);
        let mut still = Vec::new();
        let mut messages = Vec::new();
        // What a silent sensor sent before is no news.
        let is_silent = matches!(self.state, State::Waiting | State::Stalled);
        for remark in &self.remarks {
            let Some(finding) = remark.finding().filter(Finding::is_trouble) else {
                continue;
            };
            let at = told.iter().position(|(one, _)| one.is_like(remark));
            let before = at.map(|at| told.swap_remove(at));
            let is_grave = (before.as_ref()).is_none_or(|(_, one)| finding.severity < one.severity);
            let is_news = is_grave && (!is_silent || remark.is_change());
            let is_in_log = self.log_blames_kernel && self.is_told_by_losses(remark);
            if is_news && !is_in_log {
                messages.push(self.message(true, &finding.to_string()));
                still.push((*remark, finding));
            } else {
                still.extend(before);
            }
        }
        for (_, finding) in told {
            let over = format!("this is over: {}", finding.what);
            messages.push(self.message(false, &over));
        }
        self.told_remarks = still;
        messages
    }

    fn remarks_of(&mut self, now: &Observation) -> Vec<Remark> {
        let facts = &now.facts;
        let mut remarks = self.changes.observe(now);
        if matches!(self.state, State::Waiting | State::Stalled) {
            // Silence says neither that they hold nor that they are over.
            remarks.extend(self.remarks.iter().filter(|one| !one.is_change()));
            return remarks;
        }
        remarks.extend(self.calibration);
        let model = now.running.map(|running| running.model);
        if let Some((given, product)) = model.zip(facts.other_product) {
            let said = detect::model_of(product);
            remarks.push(Remark::OtherBeams { given, said });
        }
        if let Some((level, recent)) = self.losses.dropping() {
            remarks.push(Remark::Dropped {
                is_fault: level == Level::Fault,
                dropped: recent.counted.dropped,
                of: recent.sent_to_port(),
                port: self.place.port,
            });
        }
        remarks.extend(self.losses.duplicates().map(Remark::Duplicates));
        let pulse = self.receiver.take(now.now, facts.pulse);
        remarks.extend(pulse.and_then(|(pps, fix)| Remark::of_gps(model, pps, fix)));
        // The doubt has both dates.
        let is_far = matches!(self.time.1, Some(GpsDoubt::Far { .. }));
        let ahead_s = facts.host_ahead_s.filter(|_| !is_far);
        remarks.extend(self.host_clock.take(now.now, ahead_s));
        if facts.is_view_limited && self.want.fov.is_none() {
            remarks.push(Remark::LimitedView);
        }
        remarks
    }

    /// The pipeline reports why it decodes nothing. The message for the log comes with the next
    /// observation.
    pub fn refused(&mut self, why: String) {
        self.hindrance = Some(Hindrance::WrongModel(why));
    }

    /// The pipeline reports that it waits for the calibration of an HDL-64E.
    pub fn awaits_calibration(&mut self) {
        self.hindrance = Some(Hindrance::NoCalibration);
    }

    /// Whatever hindered the pipeline is over.
    pub fn unhindered(&mut self) {
        self.hindrance = None;
    }

    /// For how long no data packet has come.
    pub fn quiet_for(&self, now: Duration) -> Duration {
        now.saturating_sub(self.newest_data)
    }

    /// Takes why no packets come; `None` where nothing tells it.
    pub fn explain_silence(&mut self, why: Option<Cause>) {
        self.silence = why;
    }

    /// Takes the present counts, and gives new messages, each once.
    pub fn observe(&mut self, now: &Observation) -> Vec<Message> {
        let before = std::mem::replace(&mut self.before, *now);
        if now.data > before.data {
            self.newest_data = now.now;
        }
        if now.steady_sweeps > before.steady_sweeps {
            (self.newest_sweep, self.hindrance) = (now.now, None);
        }
        let state = self.next(now, now.steady_sweeps > before.steady_sweeps);
        let was = std::mem::replace(&mut self.state, state);
        if !matches!(was, State::SpinningUp | State::Streaming) {
            self.begun = now.now;
        }
        let running = now.running.filter(|_| state == State::Streaming);
        let mut messages = Vec::new();
        let is_other =
            running.is_some_and(|running| self.told != Some((running.model, running.return_mode)));
        let is_other_hindrance =
            state == State::WrongModel && self.hindrance != self.told_hindrance;
        if was != state || is_other || is_other_hindrance {
            self.told = running.map(|running| (running.model, running.return_mode));
            self.told_hindrance = self.hindrance.clone();
            messages.push(self.transition(was, running));
        } else if state == State::Waiting
            && !self.has_hinted
            && now.now - self.newest_data >= PATIENCE
        {
            self.has_hinted = true;
            messages.push(self.message(true, &self.silence().to_string()));
        } else if matches!(state, State::Waiting | State::Stalled) && self.is_news(now.now) {
            messages.push(self.message(true, &self.silence().to_string()));
        }
        if matches!(state, State::Waiting | State::Stalled) && !messages.is_empty() {
            self.told_silence = self.silence.clone().map(|why| (why, now.now));
        }
        if let Some(running) = running {
            messages.extend(self.watch_speed(running.rpm));
            messages.extend(self.watch_settings(&running));
        }
        messages.extend(self.observe_losses(now));
        messages.extend(self.remark(now));
        messages
    }

    /// Takes the beams that have been dark for so long that people are to be warned, and gives a
    /// message if there are others than before.
    pub fn observe_beams(&mut self, dark: Vec<DarkBeam>) -> Option<Message> {
        let was = std::mem::replace(&mut self.dark, dark);
        let is_new = |beam: &DarkBeam| was.iter().all(|before| before.row != beam.row);
        if self.dark.iter().any(is_new) {
            let sentence = beams::sentence(&self.dark)?;
            return Some(self.message(true, &sentence));
        }
        let is_over = self.dark.is_empty() && !was.is_empty();
        is_over.then(|| self.message(false, BEAMS_ARE_BACK))
    }

    /// Takes the bits of the newest sweep that say that it does not see, and gives a message if they
    /// are others than before.
    pub fn observe_eye(&mut self, bits: u32) -> Option<Message> {
        let was = std::mem::replace(&mut self.eye, bits);
        if bits & !was != 0 {
            let sentence = eye_sentence(bits)?;
            return Some(self.message(true, &sentence));
        }
        let is_over = bits == 0 && was != 0;
        is_over.then(|| self.message(false, "it sees again"))
    }

    /// Takes what is seen of the floor, and gives a message if that is news: how the sensor is mounted
    /// by it and whether that is how it is set, or what is in doubt.
    pub fn see_floor(&mut self, seen: floor::Seen) -> Option<Message> {
        self.floor = seen;
        if seen.sight == Sight::Unknown {
            self.told_floor = Sight::Unknown;
        }
        // Once is enough to tell that a mount cannot be checked.
        let is_unchecked = !seen.is_estimated && seen.sight.doubt().is_some();
        let is_told = is_unchecked && self.told_floor != Sight::Unknown;
        if is_told || !seen.sight.is_news_after(&self.told_floor) {
            return None;
        }
        self.told_floor = seen.sight;
        let finding = seen.finding()?;
        Some(self.message(finding.is_trouble(), &finding.to_string()))
    }

    /// Takes the clock of the newest sweep and what is doubtful about GPS time; gives a message for
    /// each that is another one.
    pub fn see_time(&mut self, source: TimeSource, doubt: Option<GpsDoubt>) -> Vec<Message> {
        let (was_source, was_doubt) = std::mem::replace(&mut self.time, (source, doubt));
        let mut messages = Vec::new();
        match doubt {
            Some(doubt) if was_doubt.is_none_or(|was| !was.is_kind_of(&doubt)) => {
                messages.push(self.message(true, &gps::finding(&doubt).to_string()));
            }
            None if was_doubt.is_some() => {
                messages.push(self.message(false, "the GPS receiver is no longer in doubt"));
            }
            _ => {}
        }
        match source {
            TimeSource::Gps if was_source != source => {
                messages.push(self.message(false, "times are UTC by GPS"));
            }
            TimeSource::Host if was_source != source => {
                let text = "GPS time is lost: times are of this host's clock";
                messages.push(self.message(true, text));
            }
            _ => {}
        }
        messages
    }

    fn next(&self, now: &Observation, has_swept: bool) -> State {
        if now.data == 0 {
            return State::Waiting;
        }
        if now.now - self.newest_data >= PATIENCE {
            return State::Stalled;
        }
        match (&self.hindrance, self.state) {
            (Some(Hindrance::WrongModel(_)), _) => State::WrongModel,
            (Some(Hindrance::NoCalibration), _) => State::NoCalibration,
            _ if has_swept => State::Streaming,
            // Measured up to the newest packet: if packets end in the middle of a turn, that is
            // silence, not a slow head.
            (None, State::Streaming)
                if self.newest_data.saturating_sub(self.newest_sweep) < PATIENCE =>
            {
                State::Streaming
            }
            _ => State::SpinningUp,
        }
    }

    fn transition(&self, was: State, running: Option<Running>) -> Message {
        match self.state {
            State::Waiting | State::Stalled => self.message(true, &self.silence().to_string()),
            State::SpinningUp if was == State::Streaming => {
                self.message(true, &no_sweep().to_string())
            }
            State::SpinningUp => {
                let text = format!(
                    "packets arrive from {}, waiting for its first whole turn",
                    self.place.address
                );
                self.message(false, &text)
            }
            State::Streaming | State::NotSeeing | State::Losing | State::LosingMany => {
                match running {
                    Some(running) => self.message(false, &format!("streaming, {running}")),
                    None => self.message(false, "streaming"),
                }
            }
            State::WrongModel => {
                let why = self.findings().first().map(Finding::to_string);
                self.message(true, &why.unwrap_or_default())
            }
            State::NoCalibration => self.message(false, &no_calibration().to_string()),
        }
    }

    fn watch_speed(&mut self, rpm: f32) -> Option<Message> {
        let set = f32::from(self.want.rpm?.0);
        let share = (rpm - set).abs() / set;
        let is_off = share
            > if self.is_off_speed {
                RPM_TOLERANCE / 2.0
            } else {
                RPM_TOLERANCE
            };
        let was_off = std::mem::replace(&mut self.is_off_speed, is_off);
        match (was_off, is_off) {
            (false, true) => {
                let text = format!("{}: {CHANGE_ONE}", self.off_speed());
                Some(self.message(true, &text))
            }
            (true, false) => Some(self.message(
                false,
                &format!("turns at {rpm:.0} rpm again, as it is set to"),
            )),
            _ => None,
        }
    }

    /// A message if packets begin or cease to show other settings than wanted.
    fn watch_settings(&mut self, running: &Running) -> Option<Message> {
        let unlike = self.want.unlike(running.return_mode, running.fov);
        let before = std::mem::replace(&mut self.unlike, unlike);
        // The edges of a field of view are measured to a degree, and never quite the same.
        let names = before.iter().map(|(name, _)| name);
        if names.eq(self.unlike.iter().map(|(name, _)| name)) {
            return None;
        }
        Some(match self.unlike.is_empty() {
            true => self.message(false, "is set as wanted again"),
            false => self.message(true, &self.unlike()),
        })
    }

    fn unlike(&self) -> String {
        let words: Vec<&str> = self.unlike.iter().map(|(_, what)| &what[..]).collect();
        words.join("; ")
    }

    fn observe_losses(&mut self, now: &Observation) -> Option<Message> {
        // For a sensor that is silent or cannot be decoded, there are other messages.
        if !matches!(self.state, State::Streaming | State::SpinningUp) {
            self.losses.forget();
            return None;
        }
        let turn = self.losses.observe(now.now, now.tally)?;
        let recent = self.losses.recent()?;
        Some(match turn {
            Turn::Begun(_) => {
                self.log_blames_kernel = recent.blames_kernel();
                self.message(true, &recent.sentence(&self.place))
            }
            Turn::Over(lasted) => self.message(false, &recent.over(lasted)),
        })
    }

    fn off_speed(&self) -> String {
        let rpm = self.before.running.map_or(0.0, |running| running.rpm);
        let set = self.want.rpm.map_or(0, |rpm| rpm.0);
        format!("turns at {rpm:.0} rpm, [sensor.want] says {set}")
    }

    /// Whether why no packets come is known now and was not told, or not lately: whoever sends from
    /// changing addresses must not fill the log.
    fn is_news(&self, now: Duration) -> bool {
        let told = self.told_silence.as_ref();
        self.quiet_for(now) >= PATIENCE
            && self.silence.as_ref().is_some_and(|why| {
                told.is_none_or(|(told, at)| told != why && now - *at >= TELL_EVERY)
            })
    }

    /// Why nothing is there to decode, and the cure.
    fn silence(&self) -> Finding {
        let address = &self.place.address;
        let port = self.place.port.unwrap_or_default();
        let (topic, what, question) = if self.before.position > 0 && self.before.data == 0 {
            (
                Topic::PositionOnly,
                format!("only position packets from {address}, no data on port {port}"),
                "does it send its data to another port?",
            )
        } else {
            let what = format!("no packets from {address} on port {port}");
            match self.before.data {
                0 => (
                    Topic::Silent,
                    what,
                    "is it powered, and is this host its destination?",
                ),
                _ => (
                    Topic::Silent,
                    what + ", though they came before",
                    "has it lost its power or its cable, or was its destination changed?",
                ),
            }
        };
        match &self.silence {
            Some(cause) => {
                let what = format!("{what}: {}", cause.what);
                Finding::new(Severity::Error, topic, what, &cause.cure[..])
            }
            None => Finding::new(Severity::Error, topic, what, question).asking(),
        }
    }

    fn message(&self, is_warning: bool, text: &str) -> Message {
        Message {
            is_warning,
            text: format!("{}: {text}", self.name),
        }
    }
}

const CHANGE_ONE: &str = "change one of the two";
const BEAMS_ARE_BACK: &str =
    "the beams that had not returned return again, or their counts were reset";

fn no_calibration() -> Finding {
    let what = "an HDL-64E without a calibration file";
    let cure = "waiting for the calibration in its packets, about 2 s";
    Finding::new(Severity::Error, Topic::Calibration, what, cure)
}

fn first_turn() -> Finding {
    let what = "packets come, and the first whole turn is awaited";
    Finding::new(Severity::Error, Topic::Speed, what, "")
}

fn no_sweep() -> Finding {
    let what = "packets come and no whole turn at a steady speed";
    let cure = "does its head turn, and is its motor set?";
    Finding::new(Severity::Error, Topic::Speed, what, cure).asking()
}

#[cfg(test)]
mod tests;
