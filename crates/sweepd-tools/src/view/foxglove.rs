//! A viewer that speaks the WebSocket protocol of Foxglove: what it is sent, and what it asks for.
//!
//! It gets the messages that an MCAP file of the same sweeps has, in topics of the same names, and
//! `/diagnostics`. Each is computed only while the viewer subscribes to it. While a sweep is sent, only
//! the newest of those that come is kept: a slow viewer misses sweeps, and holds up nothing. It can
//! change nothing: all but `subscribe` and `unsubscribe` is refused.

use std::future::ready;
use std::sync::Arc;
use std::time::Duration;

use hyper::body::Bytes;
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use serde_json::{Value, json};
use sweepd::VERSION;
use sweepd::export::mcap::{self, MessageForm, SensorNames};
use sweepd::floor;
use sweepd_client::host::realtime_ns;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::eye::{eye_faults, eye_sentence};
use sweepd_messages::diagnostics::{self, Level, Status};
use sweepd_messages::message_type::DIAGNOSTIC_ARRAY;
use sweepd_messages::transforms::{self, Transform};
use sweepd_messages::{Cloud, MessageHeader, MessageType, Stamp, markers};
use tokio::time::{MissedTickBehavior, interval};
use tokio_tungstenite::tungstenite::Message;

use super::channels::{Channels, Frame, Kind};
use super::socket::{Gone, Socket};

/// Names of the protocol in a handshake. Servers of Foxglove's SDK have the second, and newer viewers
/// ask for that; the messages here are the same in both.
pub(super) const PROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];

/// First bytes of binary messages.
const MESSAGE_DATA: u8 = 1;
const TIME: u8 = 2;
/// The head of a message of a channel: first byte, subscription, time.
const HEAD: usize = 1 + 4 + 8;
/// Level of a status that refuses.
const ERROR: u8 = 2;

/// What a viewer asks for.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

/// What a channel has.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Topic {
    Transforms,
    Diagnostics,
    Points,
    Markers,
}

impl Topic {
    /// Its name for the sensor with this name in topics, and its messages.
    fn of(self, sensor: &str) -> (String, &'static MessageType) {
        let topic = match self {
            Self::Diagnostics => return ("/diagnostics".to_owned(), &DIAGNOSTIC_ARRAY),
            Self::Transforms => mcap::TRANSFORMS,
            Self::Points => mcap::POINTS,
            Self::Markers => mcap::MARKERS,
        };
        (topic.name(sensor), topic.message_type())
    }
}

/// A channel that the viewer knows.
struct Channel {
    id: u32,
    topic: Topic,
    /// The one subscription that it may have.
    subscription: Option<u32>,
    /// That is new: the newest message is still to be sent.
    is_due: bool,
}

/// Talks with a viewer until it is gone.
pub(super) async fn converse(stream: TokioIo<Upgraded>, source: Channels) {
    let kind = source.description.borrow().kind;
    let mut viewer = Viewer {
        socket: Socket::open(stream).await,
        is_played: matches!(kind, Kind::Capture | Kind::Simulation),
        source,
        frame: None,
        names: None,
        time_ns: 0,
        mount: None,
        channels: Vec::new(),
        last_id: 0,
    };
    let Err(Gone) = viewer.run().await;
    viewer.socket.close().await;
}

struct Viewer {
    socket: Socket,
    source: Channels,
    /// The time of its sweeps is not that of this host: the viewer is told it.
    is_played: bool,
    /// The newest sweep, its names and its time.
    frame: Option<Arc<Frame>>,
    names: Option<SensorNames>,
    time_ns: u64,
    /// Where the sensor sits, as the viewer was told.
    mount: Option<Transform>,
    /// Those of all sensors, then those of the one that is shown.
    channels: Vec<Channel>,
    /// Number of the newest channel: no number is given twice.
    last_id: u32,
}

impl Viewer {
    async fn run(&mut self) -> Result<std::convert::Infallible, Gone> {
        let capabilities: &[&str] = if self.is_played { &["time"] } else { &[] };
        let name = format!("sweepd {VERSION}");
        self.say(json!({ "op": "serverInfo", "name": name, "capabilities": capabilities }))
            .await?;
        self.advertise(&[Topic::Transforms, Topic::Diagnostics])
            .await?;
        self.source.frame.mark_changed();
        let mut second = interval(Duration::from_secs(1));
        second.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let due = self.channels.iter().find(|channel| channel.is_due);
            let due = due.map(|channel| channel.topic);
            tokio::select! {
                biased;
                message = self.socket.next() => self.hear(message?).await?,
                changed = self.source.frame.changed() => {
                    changed.map_err(|_| Gone)?;
                    self.show().await?;
                }
                _ = second.tick() => {
                    // One that has gone without a word is noticed by what is sent to it.
                    self.socket.send(Message::Ping(Bytes::new())).await?;
                    self.send(Topic::Diagnostics).await?;
                }
                // Behind the requests that wait: one message is made for all of them.
                Some(topic) = ready(due) => self.send(topic).await?,
            }
        }
    }

    async fn say(&mut self, message: Value) -> Result<(), Gone> {
        self.socket.send(Message::text(message.to_string())).await
    }

    async fn refuse(&mut self, why: &str) -> Result<(), Gone> {
        self.say(json!({ "op": "status", "level": ERROR, "message": why }))
            .await
    }

    /// Offers new channels.
    async fn advertise(&mut self, topics: &[Topic]) -> Result<(), Gone> {
        let sensor = self.names.as_ref().map_or("", |names| &names.topic);
        let mut offered = Vec::new();
        for &topic in topics {
            self.last_id += 1;
            let (name, message_type) = topic.of(sensor);
            offered.push(json!({
                "id": self.last_id,
                "topic": name,
                "encoding": "cdr",
                "schemaName": message_type.name,
                "schema": message_type.definition,
                "schemaEncoding": "ros2msg",
            }));
            self.channels.push(Channel {
                id: self.last_id,
                topic,
                subscription: None,
                is_due: false,
            });
        }
        self.say(json!({ "op": "advertise", "channels": offered }))
            .await
    }

    async fn hear(&mut self, message: Message) -> Result<(), Gone> {
        let request = match &message {
            Message::Text(text) => serde_json::from_str(text),
            Message::Binary(_) => Ok(Request::Other),
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Close(_) | Message::Frame(_) => return Err(Gone),
        };
        match request {
            Ok(Request::Subscribe { subscriptions }) => {
                for subscription in subscriptions {
                    self.subscribe(&subscription).await?;
                }
                Ok(())
            }
            // Of a channel that is gone, it may come late.
            Ok(Request::Unsubscribe { subscription_ids }) => {
                for channel in &mut self.channels {
                    channel.subscription = channel
                        .subscription
                        .filter(|id| !subscription_ids.contains(id));
                }
                Ok(())
            }
            Ok(Request::Other) => {
                let why =
                    "a viewer can change nothing here: only subscribe and unsubscribe are taken";
                self.refuse(why).await
            }
            Err(error) => self.refuse(&format!("not understood: {error}")).await,
        }
    }

    async fn subscribe(&mut self, wanted: &Subscription) -> Result<(), Gone> {
        let Subscription { id, channel_id } = *wanted;
        let is_taken = |one: &Channel| one.subscription == Some(id);
        let is_wanted = |one: &&mut Channel| one.id == channel_id;
        let why = if self.channels.iter().any(is_taken) {
            format!("there is a subscription {id} already")
        } else if let Some(channel) = self.channels.iter_mut().find(is_wanted) {
            if channel.subscription.is_none() {
                // A capture may be paused, and then nothing newer comes.
                (channel.subscription, channel.is_due) = (Some(id), true);
                if channel.topic == Topic::Transforms {
                    self.mount = None;
                }
                return Ok(());
            }
            format!("channel {channel_id} has a subscription already")
        } else {
            format!("there is no channel {channel_id}")
        };
        self.refuse(&why).await
    }

    /// Sends what there is of the newest sweep.
    async fn show(&mut self) -> Result<(), Gone> {
        self.frame
            .clone_from(&self.source.frame.borrow_and_update());
        let Some((names, time_ns)) = self.frame.as_ref().and_then(|frame| {
            let header = SweepRef::open(&frame.bytes).ok()?.header;
            Some((MessageForm::default().names(header), mcap::time_ns(header)))
        }) else {
            return Ok(());
        };
        if self.names.as_ref() != Some(&names) {
            self.names = Some(names);
            self.mount = None;
            let others = self.channels.split_off(2);
            let ids: Vec<u32> = others.iter().map(|channel| channel.id).collect();
            if !ids.is_empty() {
                self.say(json!({ "op": "unadvertise", "channelIds": ids }))
                    .await?;
            }
            self.advertise(&[Topic::Points, Topic::Markers]).await?;
        }
        // Viewers forget transforms when time goes back.
        if time_ns < self.time_ns {
            self.mount = None;
        }
        self.time_ns = time_ns;
        if self.is_played {
            let mut message = vec![TIME];
            message.extend_from_slice(&time_ns.to_le_bytes());
            self.socket.send(Message::binary(message)).await?;
        }
        for topic in [Topic::Transforms, Topic::Points, Topic::Markers] {
            self.send(topic).await?;
        }
        Ok(())
    }

    /// Sends the newest of a topic, if it has a subscription.
    async fn send(&mut self, topic: Topic) -> Result<(), Gone> {
        let mut channels = self.channels.iter_mut();
        let Some(channel) = channels.find(|channel| channel.topic == topic) else {
            return Ok(());
        };
        channel.is_due = false;
        let Some(subscription) = channel.subscription else {
            return Ok(());
        };
        let mut message = vec![0; HEAD];
        let Some(time_ns) = self.encode(topic, &mut message) else {
            return Ok(());
        };
        message[0] = MESSAGE_DATA;
        message[1..5].copy_from_slice(&subscription.to_le_bytes());
        message[5..HEAD].copy_from_slice(&time_ns.to_le_bytes());
        self.socket.send(Message::binary(message)).await
    }

    /// Appends a message; gives its time. `None` if there is nothing to say.
    fn encode(&mut self, topic: Topic, message: &mut Vec<u8>) -> Option<u64> {
        if topic == Topic::Diagnostics {
            // Before its first sweep, a capture has no time.
            return (!self.is_played || self.frame.is_some()).then(|| self.diagnose(message));
        }
        let sweep = SweepRef::open(&self.frame.as_ref()?.bytes).ok()?;
        let names = self.names.as_ref()?;
        let header = MessageHeader {
            frame_id: &names.frame_id,
            stamp: Stamp::First,
        };
        match topic {
            Topic::Points => Cloud::default().encode(&sweep, &header, message),
            Topic::Markers => markers::encode(&sweep, &header, message),
            _ => {
                let mount = names.mount(sweep.header)?;
                if self.mount.as_ref() == Some(&mount) {
                    return None;
                }
                let mount = std::slice::from_ref(self.mount.insert(mount));
                transforms::encode(self.time_ns as i64, mount, message);
            }
        }
        Some(self.time_ns)
    }

    /// Appends how the sensor is; gives the time of that.
    fn diagnose(&self, message: &mut Vec<u8>) -> u64 {
        let state = self.source.state.borrow();
        let mut status = Status {
            level: if state.ok { Level::Ok } else { Level::Error },
            name: diagnostics::name_of(&self.source.description.borrow().name),
            message: state.words.clone(),
            hardware_id: String::new(),
            values: Vec::new(),
        };
        let frame = self.frame.as_ref();
        if let Some(sweep) = frame.and_then(|frame| SweepRef::open(&frame.bytes).ok()) {
            let header = sweep.header;
            status.name = diagnostics::name_of(header.sensor_name());
            (status.hardware_id, status.values) = diagnostics::of_header(header);
            let unseen = eye_sentence(header.flags);
            let doubt = floor::of_header(header).map(|finding| finding.to_string());
            let said: Vec<String> = unseen.into_iter().chain(doubt).collect();
            if state.ok && !said.is_empty() {
                let is_fault = eye_faults(header.flags).any(|fault| fault.is_fault);
                status.level = if is_fault { Level::Error } else { Level::Warn };
                status.message = said.join("; ");
            }
        }
        let facts = state.facts.iter();
        let facts = facts.map(|(key, value)| ((*key).to_owned(), value.clone()));
        status.values.extend(facts);
        let time_ns = match self.is_played {
            true => self.time_ns as i64,
            false => realtime_ns(),
        };
        diagnostics::encode(time_ns, &[status], message);
        time_ns.max(0) as u64
    }
}
