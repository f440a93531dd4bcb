//! `sweepd view` in a process of its own, and a page that looks at it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use sweepd::buffers::{Buffers, HeapBuffers};
use sweepd::sweep::SweepRef;
use sweepd_testkit::{PATIENCE, Process};
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use sweepd_testkit::root;

/// The server.
pub struct View {
    pub process: Process,
    /// `127.0.0.1:PORT`
    pub host: String,
}

impl View {
    /// Serves on a free port.
    pub fn start(args: &[&str]) -> Self {
        Self::start_with(args, |_| {})
    }

    pub fn start_with(args: &[&str], change: impl FnOnce(&mut Command)) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-view"));
        command
            .args(args)
            .args(["--no-open", "--listen", "127.0.0.1:0"])
            .current_dir(root())
            .stdout(Stdio::piped());
        change(&mut command);
        let mut process = Process::start(&mut command).unwrap();
        let mut line = String::new();
        let stdout = process.child.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let host = line
            .strip_prefix("http://")
            .and_then(|line| line.strip_suffix("/\n"));
        let host = host.unwrap_or_else(|| panic!("{line:?}")).to_owned();
        Self { process, host }
    }

    /// What it answers to these bytes, whole.
    pub fn answer(&self, request: &[u8]) -> String {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // It may have heard enough, and close.
        let _ = stream.write_all(request);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// What it answers to `GET path` with this host.
    pub fn get(&self, path: &str, host: &str) -> String {
        self.answer(
            format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes(),
        )
    }

    /// Opens the page.
    pub fn page(&self) -> Page {
        let origin = format!("http://{}", self.host);
        self.try_page(&self.host, Some(&origin)).unwrap()
    }

    /// The same as this host, and asked for by that origin: the status where it is refused.
    pub fn try_page(&self, host: &str, origin: Option<&str>) -> Result<Page, u16> {
        self.open("/socket", host, origin, None)
    }

    /// A viewer that is no browser.
    pub fn viewer(&self) -> Page {
        let protocol = Some("foxglove.websocket.v1");
        self.open("/", &self.host, None, protocol).unwrap()
    }

    /// Opens a socket at a path: the status where it is refused.
    pub fn open(
        &self,
        path: &str,
        host: &str,
        origin: Option<&str>,
        protocol: Option<&str>,
    ) -> Result<Page, u16> {
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let opened = runtime.block_on(async {
            let stream = tokio::net::TcpStream::connect(&self.host).await.unwrap();
            let mut request = format!("ws://{}{path}", self.host)
                .into_client_request()
                .unwrap();
            let headers = request.headers_mut();
            headers.insert("Host", HeaderValue::from_str(host).unwrap());
            let more = [("Origin", origin), ("Sec-WebSocket-Protocol", protocol)];
            for (name, value) in more {
                if let Some(value) = value {
                    headers.insert(name, HeaderValue::from_str(value).unwrap());
                }
            }
            client_async(request, stream).await
        });
        match opened {
            Ok((stream, _)) => Ok(Page { stream, runtime }),
            Err(Error::Http(response)) => Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }
}

/// A page that looks.
pub struct Page {
    stream: WebSocketStream<tokio::net::TcpStream>,
    runtime: Runtime,
}

/// A copy of a sweep's bytes that Rust can read: the page needs no alignment.
pub fn aligned(bytes: &[u8]) -> <HeapBuffers as Buffers>::Buffer {
    let mut aligned = HeapBuffers::default().take(bytes.len());
    aligned.as_mut()[..bytes.len()].copy_from_slice(bytes);
    aligned
}

/// A sweep, as a page gets it.
pub struct Shown {
    /// What comes before it.
    pub about: Value,
    bytes: <HeapBuffers as Buffers>::Buffer,
}

impl Shown {
    pub fn index(&self) -> u64 {
        self.about["index"].as_u64().unwrap()
    }

    pub fn missed(&self) -> u64 {
        self.about["missed"].as_u64().unwrap()
    }

    pub fn is_tuned(&self) -> bool {
        self.about["tuned"].as_bool().unwrap()
    }

    pub fn sweep(&self) -> SweepRef<'_> {
        SweepRef::open(self.bytes.as_ref()).unwrap()
    }
}

fn has_words(message: &Value, part: &str) -> bool {
    message["words"]
        .as_str()
        .is_some_and(|words| words.contains(part))
}

impl Page {
    pub fn send(&mut self, message: Message) {
        let Self { stream, runtime } = self;
        runtime.block_on(stream.send(message)).unwrap();
    }

    pub fn ask(&mut self, request: Value) {
        self.send(Message::text(request.to_string()));
    }

    pub fn drawn(&mut self) {
        self.ask(json!({ "do": "drawn" }));
    }

    /// The next message; `None` within this time, or where the socket was closed.
    pub fn within(&mut self, limit: Duration) -> Option<Message> {
        let Self { stream, runtime } = self;
        let next = runtime.block_on(async { timeout(limit, stream.next()).await });
        next.ok()?.and_then(Result::ok)
    }

    /// Whether it is closed, soon.
    pub fn is_closed(&mut self) -> bool {
        let Self { stream, runtime } = self;
        let end = async {
            while let Some(Ok(message)) = stream.next().await {
                if message.is_close() {
                    break;
                }
            }
        };
        runtime
            .block_on(async { timeout(PATIENCE, end).await })
            .is_ok()
    }

    /// The next message of a type; all others are passed over.
    pub fn next(&mut self, kind: &str) -> Value {
        self.until(|message| message["type"] == kind)
    }

    /// The next message that is so; all others are passed over.
    pub fn until(&mut self, is_so: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        let mut last = Value::Null;
        while begun.elapsed() < PATIENCE {
            let Some(Message::Text(text)) = self.within(PATIENCE) else {
                continue;
            };
            last = serde_json::from_str(&text).unwrap();
            if is_so(&last) {
                return last;
            }
        }
        panic!("it does not come; the last was {last}");
    }

    /// Waits until the state has words with this in it.
    pub fn words(&mut self, part: &str) -> Value {
        self.until(|message| has_words(message, part))
    }

    /// The state with these words, if it comes within this time.
    pub fn words_within(&mut self, part: &str, limit: Duration) -> Option<Value> {
        let begun = Instant::now();
        loop {
            if let Message::Text(text) = self.within(limit.saturating_sub(begun.elapsed()))? {
                let message = serde_json::from_str(&text).unwrap();
                if has_words(&message, part) {
                    return Some(message);
                }
            }
        }
    }

    /// The next sweep within this time; it is not drawn yet.
    pub fn sweep_within(&mut self, limit: Duration) -> Option<Shown> {
        let begun = Instant::now();
        let about = loop {
            let Message::Text(text) = self.within(limit.saturating_sub(begun.elapsed()))? else {
                panic!("bytes before their description");
            };
            let about: Value = serde_json::from_str(&text).unwrap();
            if about["type"] == "sweep" {
                break about;
            }
        };
        let Some(Message::Binary(bytes)) = self.within(PATIENCE) else {
            panic!("a description without bytes");
        };
        let shown = Shown {
            about,
            bytes: aligned(&bytes),
        };
        assert_eq!(shown.sweep().header.total_bytes, bytes.len() as u64);
        Some(shown)
    }

    /// The next sweep; it is not drawn yet.
    pub fn sweep(&mut self) -> Shown {
        self.sweep_within(PATIENCE).expect("a sweep")
    }

    /// Goes to a sweep, and draws all until it comes.
    pub fn seek(&mut self, index: u64) -> Shown {
        self.ask(json!({ "do": "seek", "index": index }));
        self.draw_until(|shown| shown.index() == index && !shown.is_tuned())
    }

    /// Draws sweeps until one is so, and that.
    pub fn draw_until(&mut self, is_so: impl Fn(&Shown) -> bool) -> Shown {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let shown = self.sweep();
            self.drawn();
            if is_so(&shown) {
                return shown;
            }
        }
        panic!("it does not come");
    }

    /// Pauses, and takes what was sent before.
    pub fn pause(&mut self) {
        self.ask(json!({ "do": "pause" }));
        while self.sweep_within(Duration::from_millis(400)).is_some() {
            self.drawn();
        }
    }
}
