//! Requests and pages that mean no good.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::json;
use sweepd_testkit::{PATIENCE, Stopwatch};
use tokio_tungstenite::tungstenite::Message;

use crate::captures::fixture;
use crate::page::{Page, View};
use sweepd_testkit::root;

fn view() -> View {
    View::start(&[&fixture("street_vlp16.pcap.gz")])
}

#[test]
fn only_the_files_of_the_page_are_served() {
    let view = view();
    let host = &view.host;
    let page = view.get("/", host);
    assert!(page.starts_with("HTTP/1.1 200 "), "{page}");
    assert!(page.contains("content-type: text/html; charset=utf-8\r\n"));
    let policy = format!(
        "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' ws://{host}; \
         img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n"
    );
    assert!(page.contains(&policy), "{page}");
    for header in [
        "x-content-type-options: nosniff",
        "referrer-policy: no-referrer",
        "cache-control: no-store",
    ] {
        assert!(page.contains(&format!("{header}\r\n")), "{page}");
    }
    assert!(
        view.get("/page/index.html", host)
            .starts_with("HTTP/1.1 200 ")
    );
    for path in [
        "/page/",
        "/page/../Cargo.toml",
        "/page/%2e%2e/Cargo.toml",
        "/page/..%2fmod.rs",
        "/../../etc/passwd",
        "//etc/passwd",
        "/etc/passwd",
        "/page//etc/passwd",
        "/page/index.html/",
        "/page/index.html%00",
        "/socket/",
    ] {
        let answer = view.get(path, host);
        assert!(answer.starts_with("HTTP/1.1 404 "), "{path}: {answer}");
    }
}

#[test]
fn only_this_host_is_served_and_only_by_well_formed_requests() {
    let view = view();
    let host = &view.host;
    let port = host.rsplit(':').next().unwrap();
    // A tunnel may have another port.
    for own in [&format!("localhost:{port}"), "localhost:8080", "127.0.0.1"] {
        let answer = view.get("/", own);
        assert!(answer.starts_with("HTTP/1.1 200 "), "{own}: {answer}");
    }
    for other in [
        "evil.example",
        &format!("evil.example:{port}"),
        "127.0.0.2",
        "",
        &format!("10.0.0.7:{port}"),
    ] {
        let answer = view.get("/", other);
        assert!(answer.starts_with("HTTP/1.1 403 "), "{other}: {answer}");
        assert!(answer.contains(&format!("open http://{host}/")), "{answer}");
    }
    for request in [
        "GET / HTTP/1.1\r\n\r\n".to_owned(),
        format!("GET / HTTP/1.1\r\nHost: {host}\r\nHost: evil.example\r\n\r\n"),
        format!("GET http://evil.example/ HTTP/1.1\r\nHost: {host}\r\n\r\n"),
    ] {
        let answer = view.answer(request.as_bytes());
        assert!(answer.starts_with("HTTP/1.1 403 "), "{request}: {answer}");
    }
    let post = format!("POST / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\n\r\n");
    assert!(view.answer(post.as_bytes()).starts_with("HTTP/1.1 405 "));
    let long = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n",
        "x".repeat(100_000)
    );
    assert!(!view.answer(long.as_bytes()).contains("200 OK"));
    assert!(
        !view
            .answer(b"\x16\x03\x01\x02\x00garbage\r\n\r\n")
            .contains("200 OK")
    );
    // Nor is a plain request to the socket one for a socket.
    let plain = format!("GET /socket HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n\r\n");
    assert!(view.answer(plain.as_bytes()).starts_with("HTTP/1.1 400 "));
}

#[test]
fn only_the_page_itself_gets_a_socket() {
    let view = view();
    let host = &view.host;
    let port = host.rsplit(':').next().unwrap();
    let own = format!("http://{host}");
    let local = format!("localhost:{port}");
    for (host, origin) in [
        (&host[..], None),
        (host, Some("http://evil.example")),
        (host, Some("null")),
        (host, Some("http://127.0.0.1:1")),
        (host, Some(&format!("https://{host}")[..])),
        (host, Some(&format!("http://{local}")[..])),
        ("evil.example", Some("http://evil.example")),
        (
            &format!("evil.example:{port}"),
            Some(&format!("http://evil.example:{port}")[..]),
        ),
        ("evil.example", Some(&own)),
    ] {
        let refused = view.try_page(host, origin).map(|_| ());
        assert_eq!(refused, Err(403), "{host} {origin:?}");
    }
    let mut page = view
        .try_page(&local, Some(&format!("http://{local}")))
        .unwrap();
    page.sweep();
}

/// Nor gets another web page what a viewer gets, unless it is allowed.
#[test]
fn only_programs_and_known_pages_may_read_as_viewers() {
    let args = [
        &fixture("street_vlp16.pcap.gz")[..],
        "--allow-origin",
        "https://robots.example",
    ];
    let view = View::start(&args);
    let host = &view.host;
    let sdk = Some("foxglove.sdk.v1, foxglove.websocket.v1");
    let status = |host: &str, origin| view.open("/", host, origin, sdk).map(|_| ());
    for origin in [
        None,
        Some("file://"),
        Some("https://app.foxglove.dev"),
        Some("https://lichtblick-suite.github.io"),
        Some("https://robots.example"),
        Some("http://localhost:8080"),
        Some("http://127.0.0.1:1"),
    ] {
        assert_eq!(status(host, origin), Ok(()), "{origin:?}");
    }
    for origin in [
        "null",
        "http://evil.example",
        "http://app.foxglove.dev",
        "https://app.foxglove.dev.evil.example",
        "https://robots.example:8443",
        "http://localhost.evil.example",
        "http://10.0.0.7:9178",
        "http://localhost@evil.example",
        "data:text/html,localhost",
    ] {
        assert_eq!(status(host, Some(origin)), Err(403), "{origin}");
    }
    // A name that was redirected to this host.
    assert_eq!(status("evil.example", None), Err(403));
    assert_eq!(
        status("evil.example", Some("http://evil.example")),
        Err(403)
    );
    let port = host.rsplit(':').next().unwrap();
    assert_eq!(status(&format!("localhost:{port}"), None), Ok(()));
    for protocol in [None, Some("foxglove.websocket.v2"), Some("chat")] {
        let refused = view.open("/", host, None, protocol).map(|_| ());
        assert_eq!(refused, Err(400), "{protocol:?}");
    }
}

/// Garbage and floods: each is refused or ends its own socket, and nothing of it is kept.
#[test]
fn a_viewer_that_means_no_good_costs_nothing() {
    let view = View::start(&["--simulate", "vlp16"]);
    // Sweeps are kept, more the longer it plays.
    view.page().pause();
    let resident_kb = || {
        let path = format!("/proc/{}/status", view.process.child.id());
        let status = std::fs::read_to_string(path).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let number = line.unwrap().trim().trim_end_matches(" kB");
        number.parse::<u64>().unwrap()
    };
    let refused = |viewer: &mut Page| {
        let status = viewer.until(|message| message["op"] == "status");
        status["message"].as_str().unwrap().to_owned()
    };
    let subscriptions: Vec<_> = (0..400)
        .map(|id| json!({ "id": id, "channelId": 3 }))
        .collect();
    let mut last_kb = Vec::new();
    // On a busy machine threads of former viewers end late, and each has memory of its own for a while.
    while last_kb
        .last_chunk()
        .is_none_or(|[before, .., now]: &[u64; 4]| now.saturating_sub(*before) >= 4096)
    {
        assert!(last_kb.len() < 24, "{last_kb:?}");
        let mut viewer = view.viewer();
        viewer.until(|message| message["op"] == "advertise" && message["channels"][0]["id"] == 3);
        for garbage in [
            "",
            "[]",
            "{}",
            "{\"op\":1}",
            "{\"op\":\"subscribe\"}",
            "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":-1,\"channelId\":3}]}",
            "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1e99,\"channelId\":3}]}",
            "{\"op\":\"unsubscribe\",\"subscriptionIds\":\"all\"}",
            &"[".repeat(10_000),
        ] {
            viewer.send(Message::text(garbage));
            assert!(
                refused(&mut viewer).starts_with("not understood: "),
                "{garbage}"
            );
        }
        for bytes in [vec![], vec![255; 16], vec![1; 16_000]] {
            viewer.send(Message::binary(bytes));
            assert!(refused(&mut viewer).starts_with("a viewer can change nothing"));
        }
        // One of a thousand is taken, and its messages come.
        for _ in 0..3 {
            viewer.ask(json!({ "op": "subscribe", "subscriptions": subscriptions }));
        }
        for _ in 0..1199 {
            let why = refused(&mut viewer);
            assert!(why.contains("already"), "{why}");
        }
        for _ in 0..1000 {
            viewer
                .ask(json!({ "op": "subscribe", "subscriptions": [{ "id": 9, "channelId": 4 }] }));
            viewer.ask(json!({ "op": "unsubscribe", "subscriptionIds": [9, 10, 11] }));
            viewer
                .ask(json!({ "op": "subscribe", "subscriptions": [{ "id": 9, "channelId": 77 }] }));
            assert_eq!(refused(&mut viewer), "there is no channel 77");
        }
        viewer.send(Message::binary(vec![1; 100_000]));
        assert!(viewer.is_closed());
        last_kb.push(resident_kb());
    }
    is_well(&view);
}

fn is_well(view: &View) {
    view.page().sweep();
    view.viewer().until(|message| message["op"] == "advertise");
}

/// Nor one that sends half of a handshake, or one without its key.
#[test]
fn a_viewer_that_never_is_one_holds_up_nothing() {
    let view = View::start(&["--simulate", "vlp16"]);
    let host = &view.host;
    let head =
        format!("GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n");
    let mut half = TcpStream::connect(host).unwrap();
    half.write_all(head.as_bytes()).unwrap();
    let keyless = format!(
        "{head}Sec-WebSocket-Protocol: foxglove.sdk.v1\r\nSec-WebSocket-Version: 13\r\n\r\n"
    );
    assert!(view.answer(keyless.as_bytes()).starts_with("HTTP/1.1 400 "));
    is_well(&view);
}

/// One that takes nothing of what it is sent holds up no page, and loses its place.
#[cfg(feature = "slow-tests")]
#[test]
fn a_viewer_that_takes_nothing_holds_up_nothing() {
    let _alone = sweepd_testkit::alone();
    let view = View::start(&["--simulate", "hdl32e"]);
    let own = Some("foxglove.websocket.v1");
    let mut stuck: Vec<_> = (0..7).map(|_| view.viewer()).collect();
    for viewer in &mut stuck {
        viewer.until(|message| message["op"] == "advertise" && message["channels"][0]["id"] == 3);
        viewer.ask(json!({ "op": "subscribe", "subscriptions": [{ "id": 0, "channelId": 3 }] }));
    }
    let mut page = view.page();
    let refused = || view.open("/", &view.host, None, own).map(|_| ());
    assert_eq!(refused(), Err(503));
    let begun = Instant::now();
    let mut seen = 0;
    while refused().is_err() {
        assert!(begun.elapsed() < 3 * PATIENCE);
        page.sweep();
        page.drawn();
        seen += 1;
    }
    let seconds = begun.elapsed().as_secs_f64();
    assert!(
        seconds > 8.0 && f64::from(seen) > 5.0 * seconds,
        "{seen} in {seconds} s"
    );
}

#[test]
fn the_ninth_page_is_refused_until_another_is_closed() {
    let view = view();
    let mut pages: Vec<_> = (0..8).map(|_| view.page()).collect();
    let own = format!("http://{}", view.host);
    let refused = || view.try_page(&view.host, Some(&own)).map(|_| ());
    assert_eq!(refused(), Err(503));
    // The files are still served.
    assert!(view.get("/", &view.host).starts_with("HTTP/1.1 200 "));
    pages.pop();
    let begun = Instant::now();
    while refused().is_err() {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
    for page in &mut pages {
        page.sweep();
    }
}

/// A page that asks and asks, and takes nothing of what it is sent, loses its place after 10 s.
#[cfg(feature = "slow-tests")]
#[test]
fn a_page_that_takes_nothing_is_dropped() {
    let view = View::start(&["--simulate", "hdl32e"]);
    let mut pages: Vec<_> = (0..8).map(|_| view.page()).collect();
    let own = format!("http://{}", view.host);
    let refused = || view.try_page(&view.host, Some(&own)).map(|_| ());
    assert_eq!(refused(), Err(503));
    let begun = Instant::now();
    while refused().is_err() {
        assert!(begun.elapsed() < 3 * PATIENCE);
        if begun.elapsed() < Duration::from_secs(5) {
            pages.iter_mut().for_each(Page::drawn);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    // Its bytes did not fit into the sockets, which took some seconds to be full.
    assert!(begun.elapsed() > Duration::from_secs(8));
}

#[test]
fn what_is_not_understood_is_refused_and_what_is_too_long_ends_the_socket() {
    let view = view();
    let mut page = view.page();
    page.sweep();
    for garbage in [
        "",
        "{",
        "null",
        "[]",
        "{}",
        "{\"do\":\"reboot\"}",
        "{\"do\":\"seek\",\"index\":-1}",
        "{\"do\":\"seek\",\"index\":1e300}",
        "{\"do\":\"step\"}",
        "{\"do\":\"speed\",\"factor\":\"fast\"}",
        "{\"do\":\"tune\",\"settings\":[1]}",
    ] {
        page.send(Message::text(garbage));
        let refused = page.next("refused");
        let text = refused["text"].as_str().unwrap();
        assert!(text.starts_with("not understood: "), "{garbage}: {text}");
    }
    page.send(Message::binary(vec![0; 100]));
    assert_eq!(page.next("refused")["text"], "expected text");
    page.ask(json!({ "do": "choose", "sensor": "../../etc" }));
    assert_eq!(page.next("refused")["text"], "there is no such sensor");
    page.ask(json!({ "do": "step", "by": i64::MIN }));
    page.send(Message::text("x".repeat(100_000)));
    assert!(page.is_closed());
    // Bytes that are no frame of a WebSocket, and a frame that claims to be endless.
    for frame in [
        &[0xff; 20][..],
        b"\x81\xff\x7f\xff\xff\xff\xff\xff\xff\xff\0\0\0\0",
    ] {
        let mut stream = TcpStream::connect(&view.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let host = &view.host;
        write!(
            stream,
            "GET /socket HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        .unwrap();
        stream.write_all(frame).unwrap();
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let head = String::from_utf8_lossy(&answer[..answer.len().min(200)]).into_owned();
        // The answer to this key is in RFC 6455, section 1.3.
        assert!(head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="), "{head}");
    }
    view.page().sweep();
}

#[test]
fn a_client_that_says_nothing_is_dropped() {
    let view = view();
    let mut silent: Vec<_> = (0..80)
        .map(|_| TcpStream::connect(&view.host).unwrap())
        .collect();
    let begun = Stopwatch::start();
    let mut first = silent.swap_remove(0);
    first.write_all(b"GET / HT").unwrap();
    first.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut answer = Vec::new();
    let _ = first.read_to_end(&mut answer);
    assert!(begun.elapsed() < Duration::from_secs(15));
    drop(silent);
    let begun = Instant::now();
    while !view.get("/", &view.host).starts_with("HTTP/1.1 200 ") {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The one error of `sweepd view` with these arguments.
fn error(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_sweepd-view"))
        .args(args)
        .arg("--no-open")
        .current_dir(root())
        .env("SWEEPD_ROOT", "/tmp/sweepd-view-none/iox2")
        .output()
        .unwrap();
    assert!(!output.status.success());
    assert_eq!(String::from_utf8(output.stdout).unwrap(), "");
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(
        error.starts_with("error: ") && error.lines().count() == 1,
        "{error}"
    );
    error
}

#[test]
fn what_cannot_be_served_is_one_error_with_its_cure() {
    let capture = fixture("street_vlp16.pcap.gz");
    let view = view();
    let taken = error(&[&capture, "--listen", &view.host]);
    assert!(
        taken.contains("another program does") && taken.contains("--listen 127.0.0.1:"),
        "{taken}"
    );
    let public = error(&[&capture, "--listen", "0.0.0.0:0"]);
    assert!(public.contains("--public"), "{public}");
    let foreign = error(&[&capture, "--listen", "192.0.2.1:0", "--public"]);
    assert!(
        foreign.contains("cannot listen on 192.0.2.1:0")
            && foreign.contains("an address of this host"),
        "{foreign}"
    );
    for missing in ["none.pcap", "none/roof"] {
        let missing = error(&[missing]);
        assert!(
            missing.contains("there is no capture none") && missing.contains("check the path"),
            "{missing}"
        );
    }
    let input = error(&["-"]);
    assert!(input.contains("give the path of a file"), "{input}");
    let other = error(&["Cargo.toml", "--listen", "127.0.0.1:0"]);
    assert!(other.contains("Cargo.toml is no capture"), "{other}");
}
