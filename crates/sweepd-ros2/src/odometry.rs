//! The odometry of the robot, as the ROS graph tells it.

use std::mem::{Discriminant, discriminant};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sweepd_messages::message_type::{MessageType, ODOMETRY, TF_MESSAGE};
use sweepd_messages::odometry::Located;
use sweepd_messages::{Motion, Stamp};
use sweepd_ros2::{Node, NodeError, Quality, Subscription};
use sweepd_sweep::{Header, Pose, SweepRef};

use crate::log;
use crate::track::{LONGEST_STEP_NS, Missing, Poses, Track};

/// Messages that wait until a sweep needs them; no more are read at once.
const DEPTH: usize = 256;
/// Between looks for the pose of a sweep's end.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Odometry is silent when nothing comes for this long.
const PATIENCE: Duration = Duration::from_secs(1);

/// Which messages tell where the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `/tf`: the transform whose child is the robot's frame.
    Transforms,
}

impl Source {
    /// Its name among the parameters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odom",
            Self::Transforms => "tf",
        }
    }

    /// Its topic, before rules for names.
    pub fn topic(self, odometry: &str) -> &str {
        match self {
            Self::Odometry => odometry,
            Self::Transforms => "/tf",
        }
    }

    fn message_type(self) -> &'static MessageType {
        match self {
            Self::Odometry => &ODOMETRY,
            Self::Transforms => &TF_MESSAGE,
        }
    }
}

/// Where the robot was lately. All sensors share it.
pub struct Odometry {
    source: Source,
    subscription: Subscription,
    /// The frame of the robot.
    base: String,
    heard: Mutex<Heard>,
    /// Whether it was told that several nodes publish it.
    several_are_told: AtomicBool,
}

#[derive(Default)]
struct Heard {
    track: Track,
    /// When the newest message of it came.
    at: Option<Instant>,
}

/// Why a sweep is not deskewed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotDeskewed {
    /// There is no publisher.
    #[error("nobody publishes {0}: is it the right topic?")]
    Unpublished(String),
    /// Nothing comes.
    #[error("{what} comes on {topic}")]
    Silent {
        /// What does not come.
        what: String,
        /// Its topic.
        topic: String,
    },
    /// Nothing comes any more.
    #[error("{what} has come on {topic} for {} s", since.as_secs())]
    Stopped {
        /// What does not come.
        what: String,
        /// Its topic.
        topic: String,
        /// Since the newest message.
        since: Duration,
    },
    /// It is about another frame.
    #[error(
        "{topic} tells where `{}` is, not `{base}`: give `base_frame` the name of the frame that it tells of, and the \
         sensor's mount from there", child.escape_debug()
    )]
    OtherFrame {
        /// Its topic.
        topic: String,
        /// The frame that it is about.
        child: String,
        /// The robot's.
        base: String,
    },
    /// There are no poses of that time.
    #[error(transparent)]
    Missing(#[from] Missing),
}

impl NotDeskewed {
    /// What distinguishes it from other reasons, but for its numbers.
    pub fn kind(&self) -> (Discriminant<Self>, Option<Discriminant<Missing>>) {
        let missing = match self {
            Self::Missing(missing) => Some(discriminant(missing)),
            _ => None,
        };
        (discriminant(self), missing)
    }
}

impl Odometry {
    /// Subscribes to it.
    ///
    /// # Errors
    /// A name that ROS does not take.
    pub fn new(node: &Node, source: Source, topic: &str, base: &str) -> Result<Self, NodeError> {
        // Publishers of both qualities match, and a message that is lost is made up for by the next.
        let quality = Quality::BestEffort;
        Ok(Self {
            source,
            subscription: node.subscription(topic, source.message_type(), quality, DEPTH)?,
            base: base.to_owned(),
            heard: Mutex::default(),
            several_are_told: AtomicBool::new(false),
        })
    }

    /// The frame that it tells of, and the one in which it tells where that is.
    pub fn frames(&self) -> [String; 2] {
        let heard = self.hear();
        [heard.track.child(), heard.track.parent()].map(str::to_owned)
    }

    /// How a sensor moved during a sweep. Waits for at most half a turn where poses come, but not that of
    /// the last shot yet.
    ///
    /// # Errors
    /// [`NotDeskewed`].
    pub fn motion(&self, sweep: &SweepRef<'_>, frame_id: &str) -> Result<Motion, NotDeskewed> {
        self.note_several();
        let ends_ns = [Stamp::First, Stamp::Last].map(|stamp| stamp.time_ns(sweep));
        let (poses, is_of_sensor) = self.wait(ends_ns, half_a_turn(sweep.header), frame_id)?;
        let sensor = match is_of_sensor {
            true => Pose::ROS,
            false => Pose::ROS * mount(sweep.header),
        };
        Ok(Motion::of(sweep, |time_ns| poses.at(time_ns) * sensor))
    }

    /// The poses around a sweep, and whether they are those of the sensor itself.
    fn wait(
        &self,
        ends_ns: [i64; 2],
        patience: Duration,
        frame_id: &str,
    ) -> Result<(Poses, bool), NotDeskewed> {
        let begun = Instant::now();
        loop {
            let heard = self.hear();
            let guess = begun.elapsed() >= patience;
            let found = self.around(&heard, ends_ns, guess, frame_id);
            drop(heard);
            match found {
                // Odometry that is later than that does not come in time.
                Err(NotDeskewed::Missing(Missing::Late(late_ns)))
                    if !guess && late_ns <= LONGEST_STEP_NS =>
                {
                    std::thread::sleep(LOOK_EVERY);
                }
                found => return found,
            }
        }
    }

    /// Takes what has come.
    fn hear(&self) -> MutexGuard<'_, Heard> {
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        for message in (0..DEPTH).map_while(|_| self.subscription.take()) {
            let located = match self.source {
                Source::Odometry => Located::of_odometry(&message).ok(),
                Source::Transforms => Located::of_transforms(&message, &self.base).ok().flatten(),
            };
            if let Some(located) = located {
                // Whether it is of use or not: what is wrong with it is not that nothing comes.
                heard.at = Some(Instant::now());
                heard.track.add(&located);
            }
        }
        heard
    }

    /// What does not come, in words.
    fn nothing(&self) -> String {
        match self.source {
            Source::Odometry => "nothing".to_owned(),
            Source::Transforms => format!("no transform of `{}`", self.base),
        }
    }

    /// Warns once where several nodes publish it: a track of two tells nothing of either.
    fn note_several(&self) {
        let publishers = self.subscription.publishers();
        let is_one = self.source == Source::Transforms || publishers <= 1;
        if !is_one && !self.several_are_told.swap(true, Ordering::Relaxed) {
            log::warn(format_args!(
                "{publishers} nodes publish {}: sweeps need the odometry of one: give it a topic of its own (`odometry`)",
                self.subscription.topic()
            ));
        }
    }

    fn around(
        &self,
        heard: &Heard,
        ends_ns: [i64; 2],
        guess: bool,
        frame_id: &str,
    ) -> Result<(Poses, bool), NotDeskewed> {
        let topic = || self.subscription.topic().to_owned();
        let silent = heard.at.map(|at| at.elapsed());
        match silent {
            Some(silent) if silent < PATIENCE => {}
            _ if self.subscription.publishers() == 0 => {
                return Err(NotDeskewed::Unpublished(topic()));
            }
            Some(since) => {
                let (what, topic) = (self.nothing(), topic());
                return Err(NotDeskewed::Stopped { what, topic, since });
            }
            None => {
                let (what, topic) = (self.nothing(), topic());
                return Err(NotDeskewed::Silent { what, topic });
            }
        }
        if heard.track.is_empty() {
            return Err(Missing::Nothing.into());
        }
        let child = heard.track.child();
        let is_of_sensor = child == frame_id;
        if !is_of_sensor && child != self.base {
            return Err(NotDeskewed::OtherFrame {
                topic: topic(),
                child: child.to_owned(),
                base: self.base.clone(),
            });
        }
        Ok((heard.track.around(ends_ns, guess)?, is_of_sensor))
    }
}

/// Where the sensor sits on the robot; at its origin where the daemon does not know.
fn mount(header: &Header) -> Pose {
    Some(Pose::of_mount(header))
        .filter(Pose::is_given)
        .unwrap_or(Pose::IDENTITY)
}

/// How long the sensor takes for half a turn.
fn half_a_turn(header: &Header) -> Duration {
    let seconds = 30.0 / f64::from(header.rpm);
    // No sensor turns more slowly than 300 times a minute.
    Duration::try_from_secs_f64(seconds.min(0.1)).unwrap_or_default()
}
