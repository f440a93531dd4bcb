//! A page that looks: what it is sent, and what it asks for; and the socket that it has as other
//! viewers.
//!
//! A page gets the newest sweep, and the next only when it says that it has drawn that: a slow one
//! misses sweeps, is told how many, and holds up nothing.

use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use hyper::body::Bytes;
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use serde_json::{Value, json};
use sweepd::floor;
use sweepd_core::segment::Config;
use sweepd_core::sweep::SweepRef;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use super::channels::{Channels, Command, Frame};
use super::tuning::{self, Tuner, TuningRequest};

/// Time limit for a page to take a message.
const PATIENCE: Duration = Duration::from_secs(10);
/// Most bytes of a message from a page.
const MESSAGE_BYTES: usize = 16 * 1024;
/// Factors of the speed.
const FACTORS: std::ops::RangeInclusive<f64> = 0.1..=16.0;

/// What a page asks for.
#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase")]
enum Request {
    Drawn,
    Play,
    Pause,
    Step { by: i64 },
    Speed { factor: f64 },
    Seek { index: u64 },
    Find { sequence: u64 },
    Choose { sensor: String },
    Tune(TuningRequest),
    Configuration,
}

/// The page closed its socket, or does not take what it is sent.
pub(super) struct Gone;

/// A WebSocket with limits.
pub(super) struct Socket(WebSocketStream<TokioIo<Upgraded>>);

impl Socket {
    /// One whose handshake is done.
    pub(super) async fn open(stream: TokioIo<Upgraded>) -> Self {
        let limits = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_BYTES))
            .max_frame_size(Some(MESSAGE_BYTES));
        Self(WebSocketStream::from_raw_socket(stream, Role::Server, Some(limits)).await)
    }

    /// The next message.
    pub(super) async fn next(&mut self) -> Result<Message, Gone> {
        match self.0.next().await {
            Some(Ok(message)) => Ok(message),
            _ => Err(Gone),
        }
    }

    /// Sends a message.
    pub(super) async fn send(&mut self, message: Message) -> Result<(), Gone> {
        match timeout(PATIENCE, self.0.send(message)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(Gone),
        }
    }

    /// Says good-bye, if anyone listens.
    pub(super) async fn close(mut self) {
        let _ = timeout(Duration::from_secs(1), self.0.close(None)).await;
    }
}

/// Talks with a page until it is gone.
pub(super) async fn converse(stream: TokioIo<Upgraded>, channels: Channels) {
    let page = Page {
        socket: Socket::open(stream).await,
        channels,
        is_ready: true,
        last: None,
        missed: 0,
        config: None,
        tuning: Tuning::Idle(Box::default()),
        untuned: false,
    };
    page.run().await;
}

struct Page {
    socket: Socket,
    channels: Channels,
    /// It has drawn what it was sent.
    is_ready: bool,
    /// The sweep that it was sent last.
    last: Option<Arc<Frame>>,
    /// Sweeps that it did not get.
    missed: u64,
    /// How it wants sweeps segmented beside.
    config: Option<Config>,
    tuning: Tuning,
    /// The sweep that was sent last is yet to be segmented as it wants.
    untuned: bool,
}

/// At most one sweep at a time is segmented for a page.
enum Tuning {
    Idle(Box<Tuner>),
    Busy(Arc<Frame>, JoinHandle<(Box<Tuner>, Result<Bytes, String>)>),
}

/// The end of a tuning: never, if none is under way.
async fn tuned(tuning: &mut Tuning) -> Option<(Box<Tuner>, Result<Bytes, String>)> {
    match tuning {
        Tuning::Idle(_) => std::future::pending().await,
        Tuning::Busy(_, work) => work.await.ok(),
    }
}

impl Page {
    async fn run(mut self) {
        self.channels.description.mark_changed();
        self.channels.state.mark_changed();
        self.channels.frame.mark_changed();
        let mut second = interval(Duration::from_secs(1));
        second.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            // Both of a pair are sent before the next.
            let is_ready = self.is_ready && !self.is_tuning();
            let done = tokio::select! {
                biased;
                message = self.socket.next() => match message {
                    Ok(message) => self.hear(message).await,
                    Err(gone) => Err(gone),
                },
                tuned = tuned(&mut self.tuning) => self.show_tuned(tuned).await,
                changed = self.channels.description.changed() => match changed {
                    Ok(()) => self.describe().await,
                    Err(_) => Err(Gone),
                },
                changed = self.channels.state.changed() => match changed {
                    Ok(()) => self.state().await,
                    Err(_) => Err(Gone),
                },
                changed = self.channels.frame.changed(), if is_ready => match changed {
                    Ok(()) => self.show().await,
                    Err(_) => Err(Gone),
                },
                _ = second.tick() => self.state().await,
            };
            if done.is_err() {
                break;
            }
        }
        self.socket.close().await;
    }

    fn is_tuning(&self) -> bool {
        self.untuned || matches!(self.tuning, Tuning::Busy(..))
    }

    async fn hear(&mut self, message: Message) -> Result<(), Gone> {
        let text = match &message {
            Message::Text(text) => text.as_str(),
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Binary(_) => return self.refuse("expected text").await,
            Message::Close(_) | Message::Frame(_) => return Err(Gone),
        };
        let command = match serde_json::from_str(text) {
            Err(error) => return self.refuse(&format!("not understood: {error}")).await,
            Ok(Request::Drawn) => {
                self.is_ready = true;
                return Ok(());
            }
            Ok(Request::Tune(request)) => return self.tune(&request).await,
            Ok(Request::Configuration) => return self.configuration().await,
            Ok(Request::Play) => Command::Play,
            Ok(Request::Pause) => Command::Pause,
            Ok(Request::Step { by }) => Command::Step(by.clamp(-1, 1)),
            Ok(Request::Seek { index }) => Command::Seek(index),
            Ok(Request::Find { sequence }) => Command::Find(sequence),
            Ok(Request::Choose { sensor }) => {
                if !self.channels.description.borrow().sensors.contains(&sensor) {
                    return self.refuse("there is no such sensor").await;
                }
                Command::Choose(sensor)
            }
            Ok(Request::Speed { factor }) if FACTORS.contains(&factor) => Command::Speed(factor),
            Ok(Request::Speed { .. }) => {
                let (least, most) = (FACTORS.start(), FACTORS.end());
                return self
                    .refuse(&format!("speed: expected {least} to {most}"))
                    .await;
            }
        };
        match self.channels.commands.try_send(command) {
            Ok(()) => Ok(()),
            Err(_) => self.refuse("too many commands at once").await,
        }
    }

    async fn say(&mut self, kind: &str, mut message: Value) -> Result<(), Gone> {
        message["type"] = kind.into();
        self.socket.send(Message::text(message.to_string())).await
    }

    async fn refuse(&mut self, why: &str) -> Result<(), Gone> {
        self.say("refused", json!({ "text": why })).await
    }

    async fn refuse_tuning(&mut self, why: &str) -> Result<(), Gone> {
        self.say("refused", json!({ "text": why, "of": "tuning" }))
            .await
    }

    async fn describe(&mut self) -> Result<(), Gone> {
        let description = self.channels.description.borrow_and_update().clone();
        let mut message = json!(description);
        message["settings"] = tuning::settings(&description.segment);
        message["methods"] = tuning::methods();
        message["method"] = tuning::method(&description.segment).into();
        self.say("source", message).await
    }

    async fn state(&mut self) -> Result<(), Gone> {
        let message = json!(*self.channels.state.borrow_and_update());
        self.say("state", message).await
    }

    /// Sends the newest sweep.
    async fn show(&mut self) -> Result<(), Gone> {
        let Some(frame) = self.channels.frame.borrow_and_update().clone() else {
            self.untuned = false;
            return match self.last.take() {
                Some(_) => self.say("empty", json!({})).await,
                None => Ok(()),
            };
        };
        if let Some(last) = &self.last {
            self.missed += frame.ordinal.saturating_sub(last.ordinal.saturating_add(1));
        }
        self.is_ready = false;
        self.last = Some(Arc::clone(&frame));
        self.sweep(&frame, &frame.bytes, false).await?;
        self.untuned = self.config.is_some();
        self.begin_tuning();
        Ok(())
    }

    async fn sweep(&mut self, frame: &Frame, bytes: &Bytes, is_tuned: bool) -> Result<(), Gone> {
        let Ok(sweep) = SweepRef::open(bytes) else {
            return Ok(());
        };
        let message = json!({
            "index": frame.index,
            "sequence": sweep.header.sequence,
            "sensor": frame.sensor,
            "missed": self.missed,
            "doubt": floor::of_header(sweep.header).map(|finding| finding.to_string()),
            "tuned": is_tuned,
            // Of a sweep as it is: its tuned copy follows, or why there is none.
            "paired": self.config.is_some(),
        });
        self.say("sweep", message).await?;
        self.socket.send(Message::Binary(bytes.clone())).await
    }

    async fn tune(&mut self, request: &TuningRequest) -> Result<(), Gone> {
        let base = self.channels.description.borrow().segment.clone();
        match request.config(&base) {
            Ok(config) => {
                self.untuned = config.is_some() && self.last.is_some();
                self.config = config;
                self.begin_tuning();
                Ok(())
            }
            Err(why) => self.refuse_tuning(&why).await,
        }
    }

    /// Has the last sweep segmented, unless another is at work: what is wanted then is done next.
    fn begin_tuning(&mut self) {
        let (Some(config), Some(frame), true) = (&self.config, &self.last, self.untuned) else {
            return;
        };
        let idle = Tuning::Idle(Box::default());
        let mut tuner = match std::mem::replace(&mut self.tuning, idle) {
            Tuning::Idle(tuner) => tuner,
            busy @ Tuning::Busy(..) => {
                self.tuning = busy;
                return;
            }
        };
        self.untuned = false;
        let (config, bytes) = (config.clone(), frame.bytes.clone());
        let work = spawn_blocking(move || {
            let tuned = tuner.segment(&bytes, &config);
            (tuner, tuned)
        });
        self.tuning = Tuning::Busy(Arc::clone(frame), work);
    }

    async fn show_tuned(
        &mut self,
        tuned: Option<(Box<Tuner>, Result<Bytes, String>)>,
    ) -> Result<(), Gone> {
        let (tuner, tuned) = tuned.unwrap_or_else(|| {
            let failed = "this sweep cannot be segmented like that".to_owned();
            (Box::default(), Err(failed))
        });
        let before = std::mem::replace(&mut self.tuning, Tuning::Idle(tuner));
        let is_wanted = self.config.is_some();
        self.begin_tuning();
        match (before, tuned) {
            (Tuning::Busy(frame, _), Ok(bytes)) if is_wanted => {
                self.sweep(&frame, &bytes, true).await
            }
            (_, Err(why)) => self.refuse_tuning(&why).await,
            _ => Ok(()),
        }
    }

    async fn configuration(&mut self) -> Result<(), Gone> {
        let text = {
            let description = self.channels.description.borrow();
            let config = self.config.as_ref().unwrap_or(&description.segment);
            tuning::lines(config, &description.configured)
        };
        self.say("configuration", json!({ "text": text })).await
    }
}
