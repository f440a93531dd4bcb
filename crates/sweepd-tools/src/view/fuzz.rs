//! Requests and messages that any program of this host can send to the page: for a test, and for the fuzzer (tests/fuzz).

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{panic, thread};

use serde_json::Value;
use sweepd_core::segment::Config;

use super::channels::{Command, Description, Kind, Publisher, State, channels};
use super::http::Server;

/// Time limit for the end of a connection of which one side is closed.
const PATIENCE: Duration = Duration::from_secs(20);
/// Name of the threads that serve.
const SERVER: &str = "fuzzed";
const HANDSHAKE: &str = "Upgrade: websocket\r\nConnection: upgrade\r\nSec-WebSocket-Version: 13\r\n\
                         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

/// Set where one of them has panicked: a task that does ends no server.
static PANICKED: AtomicBool = AtomicBool::new(false);
static ADDRESS: LazyLock<SocketAddr> = LazyLock::new(serve);

/// Starts a server of a source without a sweep.
fn serve() -> SocketAddr {
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |panicked| {
        if thread::current().name() == Some(SERVER) {
            PANICKED.store(true, Ordering::Relaxed);
        }
        before(panicked);
    }));
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("its address");
    listener.set_nonblocking(true).expect("a socket");
    let (publisher, channels) = channels(description(), state(), AtomicBool::new(false).into());
    let taking = thread::Builder::new().name(SERVER.to_owned());
    taking
        .spawn(move || take_commands(&publisher))
        .expect("a thread");
    let serving = move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .expect("a runtime");
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).expect("a socket");
            Server::new(listener, address, channels, Vec::new())
                .serve()
                .await
        })
    };
    let serving = thread::Builder::new()
        .name(SERVER.to_owned())
        .spawn(serving);
    serving.expect("a thread");
    address
}

/// Takes what pages ask of the source.
fn take_commands(publisher: &Publisher) {
    for command in &publisher.commands {
        match command {
            Command::Speed(factor) => assert!((0.1..=16.0).contains(&factor)),
            Command::Step(by) => assert!((-1..=1).contains(&by)),
            Command::Choose(sensor) => assert_eq!(sensor, "roof"),
            _ => {}
        }
    }
}

fn description() -> Description {
    Description {
        kind: Kind::Sensor,
        name: "roof".to_owned(),
        sensors: vec!["roof".to_owned()],
        chosen: Some("roof".to_owned()),
        sweeps: None,
        marks: Vec::new(),
        told: true,
        masked: false,
        floor: Value::Null,
        segment: Config::default(),
        configured: Config::default(),
    }
}

fn state() -> State {
    State {
        words: String::new(),
        ok: true,
        playing: false,
        speed: 1.0,
        facts: Default::default(),
    }
}

/// Sends this, and waits for the end of what is answered.
fn send(bytes: &[u8]) {
    let mut stream = TcpStream::connect(*ADDRESS).expect("a connection");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    // The server may have closed it.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    let end = stream.read_to_end(&mut Vec::new());
    let is_late =
        end.is_err_and(|error| matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut));
    assert!(!is_late, "the server does not end a connection");
    assert!(!PANICKED.load(Ordering::Relaxed), "the server panicked");
}

/// A frame of a WebSocket with a text, masked with zeros, which leave it as it is.
fn frame(text: &[u8]) -> Vec<u8> {
    let len = text.len().min(u16::MAX.into());
    let head = match u8::try_from(len) {
        Ok(len @ ..126) => vec![0x81, 0x80 | len],
        _ => [&[0x81, 0x80 | 126][..], &(len as u16).to_be_bytes()].concat(),
    };
    [&head, &[0; 4][..], &text[..len]].concat()
}

/// Text messages, one a line, behind a request for a socket.
fn send_lines(request: &str, lines: &[u8]) {
    let frames: Vec<u8> = lines.split(|&byte| byte == b'\n').flat_map(frame).collect();
    send(&[request.as_bytes(), HANDSHAKE.as_bytes(), b"\r\n", &frames].concat());
}

/// Behind a zero the bytes of a request, else what a page says, a message a line.
pub fn page(input: &[u8]) {
    match input {
        [0, request @ ..] => send(request),
        lines => {
            let address = *ADDRESS;
            let request =
                format!("GET /socket HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n");
            send_lines(&request, lines);
        }
    }
}

/// Messages of a Foxglove viewer, one a line.
pub fn viewer(input: &[u8]) {
    let request =
        "GET / HTTP/1.1\r\nHost: localhost\r\nSec-WebSocket-Protocol: foxglove.websocket.v1\r\n";
    send_lines(request, input);
}

/// Inputs of [`page`] that make sense.
pub const PAGES: [&[u8]; 4] = [
    b"\0GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"\0GET /page/main.js HTTP/1.1\r\nHost: 127.0.0.1:1\r\nOrigin: http://127.0.0.1:1\r\nUpgrade: websocket\r\n\r\n",
    b"{\"do\": \"drawn\"}\n{\"do\": \"speed\", \"factor\": 2}\n{\"do\": \"choose\", \"sensor\": \"roof\"}\n{\"do\": \"step\", \"by\": -1}",
    b"{\"do\": \"tune\", \"method\": \"paper\", \"settings\": {\"min_points\": 5, \"max_range_m\": null}}\n{\"do\": \"configuration\"}",
];

/// Inputs of [`viewer`] that make sense.
pub const VIEWERS: [&[u8]; 2] = [
    b"{\"op\": \"subscribe\", \"subscriptions\": [{\"id\": 7, \"channelId\": 1}, {\"id\": 8, \"channelId\": 2}]}\n\
      {\"op\": \"unsubscribe\", \"subscriptionIds\": [7]}",
    b"{\"op\": \"advertise\", \"channels\": []}\n[1]",
];

#[cfg(test)]
mod tests {
    use super::*;
    use fastrand::Rng;
    use sweepd_testkit::mutate::mutated;

    /// Connections for each target.
    const ROUNDS: usize = 300;

    #[test]
    fn whatever_is_sent_the_server_goes_on() {
        let mut rng = Rng::with_seed(1);
        for (run, seeds) in [(page as fn(&[u8]), &PAGES[..]), (viewer, &VIEWERS[..])] {
            seeds.iter().for_each(|seed| run(seed));
            for _ in 0..ROUNDS {
                let [one, other] = [(); 2].map(|()| seeds[rng.usize(..seeds.len())]);
                let input = mutated(&mut rng, one, other);
                let done = panic::catch_unwind(|| run(&input));
                assert!(done.is_ok(), "\"{}\"", input.escape_ascii());
            }
        }
        // It still speaks as it should.
        let mut stream = TcpStream::connect(*ADDRESS).unwrap();
        stream.write_all(&PAGES[0][1..]).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200 OK"), "{answer}");
    }
}
