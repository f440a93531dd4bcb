//! One sensor: of each sweep, what somebody subscribed to is computed and published.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sweepd_client::client::{Client, ClientError, Domain, Sweep};
use sweepd_client::host::realtime_ns;
use sweepd_messages::cloud::{Cloud, Points};
use sweepd_messages::diagnostics::model_of;
use sweepd_messages::message_type::{IMAGE, LASER_SCAN, MARKER_ARRAY, POINT_CLOUD};
use sweepd_messages::{MessageHeader, MessageType, Motion, Slice, image, markers};
use sweepd_ros2::Publisher;
use sweepd_sweep::layout::flags;
use sweepd_sweep::{Header, Pose, SweepRef};

use crate::log;
use crate::odometry::{NotDeskewed, Odometry};
use crate::parameters::{SCAN_HEIGHTS_M, SensorParameters};
use crate::transforms::Transforms;

/// Longest wait for a sweep, and so for the end of the program.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// A sensor is silent when no sweep comes for this long, as the daemon judges.
pub const PATIENCE: Duration = Duration::from_secs(2);
/// Sweeps that may be not deskewed in a row, or between two messages of `/diagnostics`, before it is told:
/// odometry may be late once.
pub const USUAL_NOT_DESKEWED: u64 = 2;
/// Before it is told that sweeps are deskewed again.
const DESKEWED_FOR: Duration = Duration::from_secs(1);
/// Before shared memory that cannot be read is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// What is published of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// All returns.
    Points,
    /// Those of the ground.
    Ground,
    /// All others.
    Nonground,
    /// Those of segments.
    Objects,
    /// The nearest of `Nonground` in each direction, seen from above.
    Scan,
    /// A box for each segment.
    Markers,
    /// Ranges as an image.
    RangeImage,
    /// Labels as an image.
    LabelImage,
    /// All returns, deskewed; only where there is odometry.
    PointsDeskewed,
}

impl Topic {
    /// All, as they are numbered.
    pub const ALL: [Self; 9] = [
        Self::Points,
        Self::Ground,
        Self::Nonground,
        Self::Objects,
        Self::Scan,
        Self::Markers,
        Self::RangeImage,
        Self::LabelImage,
        Self::PointsDeskewed,
    ];

    /// Those that are published, with odometry or without.
    pub fn published(with_odometry: bool) -> &'static [Self] {
        match with_odometry {
            true => &Self::ALL,
            false => &Self::ALL[..Self::PointsDeskewed as usize],
        }
    }

    /// Whether odometry deskews it.
    fn is_deskewed(self) -> bool {
        !matches!(self, Self::Points | Self::RangeImage | Self::LabelImage)
    }

    /// Its name below the sensor's.
    pub fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::Ground => "ground",
            Self::Nonground => "nonground",
            Self::Objects => "objects",
            Self::Scan => "scan",
            Self::Markers => "markers",
            Self::RangeImage => "range_image",
            Self::LabelImage => "label_image",
            Self::PointsDeskewed => "points_deskewed",
        }
    }

    /// Its name for the sensor whose token this is, before rules for names.
    pub fn of(self, token: &str) -> String {
        format!("~/{token}/{}", self.name())
    }

    /// Its messages.
    pub fn message_type(self) -> &'static MessageType {
        match self {
            Self::Points
            | Self::Ground
            | Self::Nonground
            | Self::Objects
            | Self::PointsDeskewed => &POINT_CLOUD,
            Self::Scan => &LASER_SCAN,
            Self::Markers => &MARKER_ARRAY,
            Self::RangeImage | Self::LabelImage => &IMAGE,
        }
    }

    /// The message of a sweep, deskewed by the motion of its sensor, if that is known.
    fn encode(
        self,
        sweep: &SweepRef<'_>,
        parameters: &SensorParameters,
        motion: Option<&Motion>,
        message: &mut Vec<u8>,
    ) {
        let header = MessageHeader {
            frame_id: &parameters.frame_id,
            stamp: parameters.stamp,
        };
        let points = match self {
            Self::Points | Self::PointsDeskewed => Points::All,
            Self::Ground => Points::Ground,
            Self::Nonground => Points::Nonground,
            Self::Objects => Points::Objects,
            Self::Scan => return parameters.scan(sweep, motion, message),
            Self::Markers => return markers::encode_deskewed(sweep, &header, motion, message),
            Self::RangeImage => return image::encode_ranges(sweep, &header, message),
            Self::LabelImage => return image::encode_labels(sweep, &header, message),
        };
        let cloud = Cloud {
            points,
            layout: parameters.layout,
            organized: parameters.organized,
        };
        cloud.encode_deskewed(sweep, &header, motion, message);
    }
}

/// A sensor with its topics.
pub struct Bridge {
    /// Its name.
    pub name: String,
    /// How it is published.
    pub parameters: Mutex<Arc<SensorParameters>>,
    /// What deskews it, if something does.
    pub odometry: Option<Arc<Odometry>>,
    /// One for each [published](Topic::published) topic.
    pub publishers: Vec<Publisher>,
    /// What came of it, for `/diagnostics`.
    pub seen: Seen,
}

/// What came of a sensor so far.
#[derive(Debug, Default)]
pub struct Seen {
    /// Messages that were computed, for each [`Topic`].
    computed: [AtomicU64; Topic::ALL.len()],
    tally: Mutex<Tally>,
    deskewing: Mutex<Deskewing>,
}

/// Sums over sweeps.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Sweeps.
    pub sweeps: u64,
    /// Sweeps that were left out because they are not complete, or have too few columns.
    pub incomplete_sweeps: u64,
    /// Those since the last one that was not.
    pub incomplete_in_a_row: u64,
    /// Sweeps that the bridge was too slow for.
    pub missed_sweeps: u64,
    /// Packets missing by the sensor's clock.
    pub lost_packets: u64,
    /// Datagrams that the daemon's host dropped.
    pub dropped_datagrams: u64,
    /// Columns without a packet.
    pub missing_columns: u64,
    /// The newest sweep, and when it came.
    pub newest: Option<(Header, Instant)>,
    /// From the newest sweep's completion to its receipt here.
    pub latency: Duration,
    /// Why no sweep can be had.
    pub trouble: Option<String>,
    /// How long the newest sweep waited for odometry.
    pub odometry_wait: Duration,
    /// Sweeps that were deskewed for somebody.
    pub deskewed_sweeps: u64,
    /// Sweeps that were published as they were measured, as no odometry was there.
    pub not_deskewed_sweeps: u64,
    /// Why the newest of them was not.
    pub not_deskewed: Option<NotDeskewed>,
}

/// What was told of sweeps that are not deskewed, and what came since: the log has a line where that changes.
#[derive(Debug, Default)]
struct Deskewing {
    /// Sweeps since the last one that was deskewed, and the newest of them for one kind of reason.
    in_a_row: u64,
    of_a_kind: u64,
    why: Option<NotDeskewed>,
    /// The reason that was told, until they are deskewed again.
    told: Option<NotDeskewed>,
    /// Since when all are deskewed.
    deskewed_since: Option<Instant>,
}

impl Deskewing {
    /// Takes a sweep that is not deskewed. Gives whether that is to be told.
    fn fails(&mut self, why: &NotDeskewed) -> bool {
        let is_of_kind = |other: &Option<NotDeskewed>| {
            let other = other.as_ref();
            other.is_some_and(|other| other.kind() == why.kind())
        };
        self.in_a_row += 1;
        self.of_a_kind = if is_of_kind(&self.why) {
            self.of_a_kind + 1
        } else {
            1
        };
        self.why = Some(why.clone());
        self.deskewed_since = None;
        let so_many = match self.told {
            None => self.in_a_row,
            Some(_) => self.of_a_kind,
        };
        let is_due = so_many > USUAL_NOT_DESKEWED && !is_of_kind(&self.told);
        if is_due {
            self.told = Some(why.clone());
        }
        is_due
    }

    /// Takes a sweep that is deskewed at a moment. Gives whether that is to be told.
    fn works(&mut self, at: Instant) -> bool {
        self.in_a_row = 0;
        self.why = None;
        let since = *self.deskewed_since.get_or_insert(at);
        at.duration_since(since) >= DESKEWED_FOR && self.told.take().is_some()
    }
}

impl Seen {
    /// The sums so far.
    pub fn tally(&self) -> Tally {
        self.with_tally(|tally| tally.clone())
    }

    /// The newest sweep, and when it came.
    pub fn newest(&self) -> Option<(Header, Instant)> {
        self.with_tally(|tally| tally.newest)
    }

    /// Messages that were computed of a topic.
    pub fn computed(&self, topic: Topic) -> u64 {
        self.computed[topic as usize].load(Ordering::Relaxed)
    }

    fn deskewing(&self) -> MutexGuard<'_, Deskewing> {
        let deskewing = self.deskewing.lock();
        deskewing.unwrap_or_else(PoisonError::into_inner)
    }

    fn with_tally<T>(&self, action: impl FnOnce(&mut Tally) -> T) -> T {
        action(&mut self.tally.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Tally {
    fn add(&mut self, header: &Header, is_taken: bool) {
        self.sweeps += 1;
        if is_taken {
            self.incomplete_in_a_row = 0;
        } else {
            self.incomplete_sweeps += 1;
            self.incomplete_in_a_row += 1;
        }
        self.lost_packets += u64::from(header.lost_packets);
        self.dropped_datagrams += u64::from(header.dropped_datagrams);
        self.missing_columns += u64::from(header.missing_columns);
        let latency_ns = realtime_ns().saturating_sub(header.completed_ns);
        self.latency = Duration::from_nanos(u64::try_from(latency_ns).unwrap_or(0));
        self.newest = Some((*header, Instant::now()));
        self.trouble = None;
    }
}

impl Bridge {
    /// How it is published from now on, until that changes.
    pub fn parameters(&self) -> Arc<SensorParameters> {
        let parameters = self.parameters.lock();
        Arc::clone(&parameters.unwrap_or_else(PoisonError::into_inner))
    }

    /// Changes how it is published, from the next sweep on.
    pub fn set_parameters(&self, parameters: SensorParameters) {
        let current = self.parameters.lock();
        *current.unwrap_or_else(PoisonError::into_inner) = Arc::new(parameters);
    }

    /// Publishes the sensor's sweeps until the program is over: before there is a daemon, over its
    /// restarts, and when it is gone.
    pub fn run(&self, domain: &Domain, transforms: Option<&Transforms>, over: &AtomicBool) {
        // Kept after an error, for its count.
        let mut client = None;
        while !over.load(Ordering::Relaxed) {
            let Err(error) = self.follow(&mut client, domain, transforms, over) else {
                return;
            };
            let trouble = error.to_string();
            if self.seen.tally().trouble.as_ref() != Some(&trouble) {
                log::warn(format_args!("{}: {trouble}", self.name));
            }
            self.seen.with_tally(|tally| tally.trouble = Some(trouble));
            let begun = Instant::now();
            while begun.elapsed() < RETRY_AFTER && !over.load(Ordering::Relaxed) {
                std::thread::sleep(LOOK_EVERY);
            }
        }
    }

    fn follow(
        &self,
        client: &mut Option<Client>,
        domain: &Domain,
        transforms: Option<&Transforms>,
        over: &AtomicBool,
    ) -> Result<(), ClientError> {
        let client = match client {
            Some(client) => client,
            None => client.insert(Client::within(domain, &self.name)?),
        };
        let mut last: Option<Instant> = None;
        while !over.load(Ordering::Relaxed) {
            match client.next(LOOK_EVERY)?.received() {
                Some(sweep) => {
                    let is_first = last.replace(Instant::now()).is_none();
                    self.seen
                        .with_tally(|tally| tally.missed_sweeps = client.missed());
                    self.publish(sweep, is_first, transforms)?;
                }
                None if last.is_some_and(|last| last.elapsed() >= PATIENCE) => {
                    last = None;
                    self.note_silence(client);
                }
                None => {}
            }
        }
        Ok(())
    }

    fn publish(
        &self,
        sweep: Sweep,
        is_first: bool,
        transforms: Option<&Transforms>,
    ) -> Result<(), ClientError> {
        let view = sweep.view().map_err(|source| ClientError::Layout {
            name: self.name.clone(),
            source,
        })?;
        if is_first {
            self.note_streaming(view.header);
        }
        let parameters = self.parameters();
        let is_taken = parameters.takes(view.header);
        self.seen
            .with_tally(|tally| tally.add(view.header, is_taken));
        if let Some(transforms) = transforms {
            transforms.see(&self.name, &parameters.frame_id, view.header);
        }
        if !is_taken {
            self.note_left_out(view.header);
            return Ok(());
        }
        let mut messages = self.encode(&view, &parameters, false, None);
        if self.has_reader(true) {
            // What is not deskewed does not wait for odometry.
            publish(messages);
            let asked = Instant::now();
            let motion = self.motion(&view, &parameters.frame_id);
            (self.seen).with_tally(|tally| tally.odometry_wait = asked.elapsed());
            messages = self.encode(&view, &parameters, true, motion.as_ref());
        } else {
            // Nobody asks for odometry, so that nothing is known of it.
            *self.seen.deskewing() = Deskewing::default();
        }
        // The daemon has the memory back before the network is waited for.
        drop(sweep);
        publish(messages);
        Ok(())
    }

    /// The topics that odometry deskews, or the others, with their publishers.
    fn topics(&self, deskewed: bool) -> impl Iterator<Item = (Topic, &Publisher)> {
        let topics = Topic::ALL.into_iter().zip(&self.publishers);
        topics
            .filter(move |(topic, _)| deskewed == (self.odometry.is_some() && topic.is_deskewed()))
    }

    fn has_reader(&self, deskewed: bool) -> bool {
        self.topics(deskewed)
            .any(|(_, publisher)| publisher.readers() > 0)
    }

    /// The messages that somebody reads.
    fn encode(
        &self,
        view: &SweepRef<'_>,
        parameters: &SensorParameters,
        deskewed: bool,
        motion: Option<&Motion>,
    ) -> Vec<(&Publisher, Vec<u8>)> {
        let mut messages = Vec::new();
        for (topic, publisher) in self.topics(deskewed) {
            if publisher.readers() > 0 {
                let before = self.seen.computed[topic as usize].fetch_add(1, Ordering::Relaxed);
                if topic == Topic::Scan && before == 0 {
                    self.note_band(view.header);
                }
                let mut message = publisher.buffer();
                topic.encode(view, parameters, motion, &mut message);
                messages.push((publisher, message));
            }
        }
        messages
    }

    /// How the sensor moved, if that is known.
    fn motion(&self, view: &SweepRef<'_>, frame_id: &str) -> Option<Motion> {
        let odometry = self.odometry.as_ref()?;
        match odometry.motion(view, frame_id) {
            Ok(motion) => {
                let deskewed = self.seen.with_tally(|tally| {
                    tally.deskewed_sweeps += 1;
                    tally.deskewed_sweeps
                });
                if self.seen.deskewing().works(Instant::now()) {
                    log::info(format_args!(
                        "{}: sweeps are deskewed from now on",
                        self.name
                    ));
                }
                if deskewed == 1 {
                    self.note_frames(odometry, frame_id, view.header);
                }
                Some(motion)
            }
            Err(why) => {
                self.note_not_deskewed(why);
                None
            }
        }
    }

    /// Tells whose poses deskew it, and warns where nobody says how the sensor sits there.
    fn note_frames(&self, odometry: &Odometry, frame_id: &str, header: &Header) {
        let [child, parent] = odometry.frames();
        log::info(format_args!(
            "{}: deskewed by poses of `{}` in `{}`",
            self.name,
            child.escape_debug(),
            parent.escape_debug()
        ));
        if !Pose::of_mount(header).is_given() && child != frame_id {
            log::warn(format_args!(
                "{}: no mount is given: it is deskewed as if it sits at the origin of the robot's frame, and looks ahead: \
                 give the daemon a [sensor.mount]",
                self.name
            ));
        }
    }

    /// Tells that sweeps are not deskewed, once for each reason; `/diagnostics` counts them all.
    fn note_not_deskewed(&self, why: NotDeskewed) {
        self.seen.with_tally(|tally| {
            tally.not_deskewed_sweeps += 1;
            tally.not_deskewed = Some(why.clone());
        });
        if self.seen.deskewing().fails(&why) {
            log::warn(format_args!(
                "{}: sweeps are published as they are measured, not deskewed: {why}; /diagnostics counts such sweeps",
                self.name
            ));
        }
    }

    fn note_streaming(&self, header: &Header) {
        log::info(format_args!(
            "{}: {} at {} is published as {}",
            self.name,
            model_of(header),
            header.sensor(),
            self.publishers[Topic::Points as usize].topic(),
        ));
    }

    /// Tells of the first sweep that is left out; `/diagnostics` counts them all.
    fn note_left_out(&self, header: &Header) {
        if self.seen.tally().incomplete_sweeps > 1 {
            return;
        }
        let what = match header.has(flags::PARTIAL) {
            true => "is no whole turn (`only_complete`)",
            false => "has too few measured columns (`min_columns`)",
        };
        log::info(format_args!(
            "{}: sweep {} is left out: it {what}; /diagnostics counts such sweeps",
            self.name, header.sequence
        ));
    }

    /// Warns where the default heights of a scan do not count from the robot.
    fn note_band(&self, header: &Header) {
        let parameters = self.parameters();
        let is_default = parameters.slice == Slice::Heights(SCAN_HEIGHTS_M);
        if is_default && !parameters.scans_for_robot(header) {
            log::warn(format_args!(
                "{}: the band of its scan, {SCAN_HEIGHTS_M:?} m, counts from the sensor, as no mount or no `base_frame` is \
                 given: give the daemon a [sensor.mount], or `scan_heights`",
                self.name
            ));
        }
    }

    fn note_silence(&self, client: &Client) {
        let why = match client.is_published() {
            true => "does the sensor send? `sweepd doctor` finds out",
            false => "it is not published any more: was the daemon stopped?",
        };
        let seconds = PATIENCE.as_secs();
        log::warn(format_args!(
            "{}: no sweep for {seconds} s: {why}",
            self.name
        ));
    }
}

fn publish(messages: Vec<(&Publisher, Vec<u8>)>) {
    for (publisher, message) in messages {
        publisher.publish(message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::Missing;

    /// Lines of the log for sweeps each 100 ms: `d` is deskewed, `l` has late odometry, `o` that of
    /// another clock.
    fn lines(sweeps: &str) -> String {
        let (mut deskewing, mut at) = (Deskewing::default(), Instant::now());
        let mut told = String::new();
        for (number, sweep) in (1..).zip(sweeps.chars()) {
            at += Duration::from_millis(100);
            let is_told = match sweep {
                'd' => deskewing.works(at),
                // The same reason, though not with the same number.
                'l' => deskewing.fails(&Missing::Late(number).into()),
                _ => deskewing.fails(&Missing::OtherClock(number).into()),
            };
            if is_told {
                told += &format!("{sweep}{number} ");
            }
        }
        told
    }

    #[test]
    fn the_log_tells_each_change_once_and_is_not_flooded() {
        assert_eq!(lines("dddllddddolddd"), "");
        assert_eq!(lines("llllllll"), "l3 ");
        assert_eq!(lines("llllooooo"), "l3 o7 ");
        assert_eq!(lines("lolololo"), "l3 ");
        // A second of deskewed sweeps.
        assert_eq!(lines("lllddddddddddddlll"), "l3 d14 l18 ");
        assert_eq!(lines(&"lllddd".repeat(20)), "l3 ");
    }
}
