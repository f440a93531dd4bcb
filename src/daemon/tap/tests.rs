use std::io::{BufRead, Read, Write};
use std::net::SocketAddrV4;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::wire::{Answer, Status, hello};
use super::*;

/// A root folder of a test's own, removed with it.
struct Root(PathBuf);

impl Root {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sweepd-tap-{test}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir(&path).unwrap();
        Self(path)
    }

    fn socket(&self) -> PathBuf {
        socket_path(&self.0)
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn addressed(arrival_ns: i64, payload: &[u8]) -> Addressed<'_> {
    let end = |text: &str| text.parse::<SocketAddrV4>().unwrap();
    Addressed {
        arrival_ns,
        source: end("192.168.1.201:2368"),
        destination: end("239.1.2.3:2369"),
        payload,
    }
}

/// Arrivals and payloads up to the end, and how many got lost.
fn drain(mut client: TapStream) -> (Vec<(i64, Vec<u8>)>, u64) {
    let mut all = Vec::new();
    let begun = Instant::now();
    while client.lost().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(20));
        let each = |one: &Addressed<'_>| {
            assert_eq!(*one, addressed(one.arrival_ns, one.payload));
            all.push((one.arrival_ns, one.payload.to_vec()));
        };
        client.receive(Duration::from_millis(20), each).unwrap();
    }
    (all, client.lost().unwrap())
}

fn error(root: &Root, sensor: &str) -> TapError {
    TapStream::connect(&root.socket(), sensor).unwrap_err()
}

#[test]
fn clients_get_what_they_asked_for_from_the_moment_that_they_did() {
    let root = Root::new("asked");
    let taps = Taps::listen(&root.socket()).unwrap();
    // Two threads may receive the packets of one sensor.
    let (mut roof, mut roof_position, mut rear) = (
        taps.sensor("roof"),
        taps.sensor("roof"),
        taps.sensor("rear"),
    );
    roof.put(&addressed(1, b"nobody listens"));
    let clients = [
        TapStream::connect(&root.socket(), "roof").unwrap(),
        TapStream::connect(&root.socket(), "roof").unwrap(),
        TapStream::connect(&root.socket(), "rear").unwrap(),
    ];
    assert!(roof.is_open() && roof_position.is_open() && rear.is_open());
    for number in 0..500 {
        roof.put(&addressed(number, &[1; 1206]));
        rear.put(&addressed(number, &[2; 1206]));
    }
    roof_position.put(&addressed(1000, &[3; 512]));
    // A tap that is closed has said all before.
    drop(rear);
    let [first, second, third] = clients;
    first.stop();
    let (mut all, lost) = drain(first);
    all.sort();
    let expected = (0..500)
        .map(|number| (number, vec![1; 1206]))
        .chain([(1000, vec![3; 512])]);
    assert!(all.into_iter().eq(expected.clone()) && lost == 0);
    // The end of the daemon is told as well.
    let [second, third] = [second, third].map(|client| std::thread::spawn(move || drain(client)));
    drop(taps);
    let (mut all, lost) = second.join().unwrap();
    all.sort();
    assert!(all.into_iter().eq(expected) && lost == 0);
    assert!(
        third
            .join()
            .unwrap()
            .0
            .into_iter()
            .eq((0..500).map(|number| (number, vec![2; 1206])))
    );
    assert!(!root.socket().exists());
    // Nobody is left to close it; it takes no harm.
    roof.put(&addressed(1, b"x"));
}

#[test]
fn what_a_stuck_client_does_not_take_is_told_to_it_and_nobody_waits() {
    let root = Root::new("stuck");
    let taps = Taps::listen(&root.socket()).unwrap();
    let mut roof = taps.sensor("roof");
    let stuck = TapStream::connect(&root.socket(), "roof").unwrap();
    let awake = TapStream::connect(&root.socket(), "roof").unwrap();
    let awake = std::thread::spawn(move || drain(awake));
    let (mut sent, mut longest) = (0, Duration::ZERO);
    for _ in 0..200 {
        for _ in 0..100 {
            let begun = Instant::now();
            roof.put(&addressed(sent, &[7; 1206]));
            longest = longest.max(begun.elapsed());
            sent += 1;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    // On a machine with all cores taken, a thread may wait for one.
    assert!(longest < Duration::from_millis(500), "{longest:?}");
    stuck.stop();
    let (taken, lost) = drain(stuck);
    assert!(lost > 10_000, "{lost}");
    assert_eq!(taken.len() as u64 + lost, sent as u64);
    assert!(taken.is_sorted());
    drop(taps);
    let (taken, lost) = awake.join().unwrap();
    assert_eq!(taken.len() as u64 + lost, sent as u64);
}

#[test]
fn clients_that_break_the_rules_are_parted_from_and_others_are_served() {
    let root = Root::new("rules");
    let taps = Taps::listen(&root.socket()).unwrap();
    let mut roof = taps.sensor("roof");
    let good = TapStream::connect(&root.socket(), "roof").unwrap();
    let mut rng = fastrand::Rng::with_seed(4);
    for round in 0..100 {
        let mut bad = UnixStream::connect(root.socket()).unwrap();
        bad.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let mut bytes = if round % 2 == 0 {
            hello("roof")
        } else {
            Vec::new()
        };
        bytes.extend((0..rng.usize(1..2000)).map(|_| rng.u8(..)));
        // It may have hung up before all is said.
        let _ = bad.write_all(&bytes);
        // Refused, or parted from after that.
        let _ = bad.read_to_end(&mut Vec::new());
        roof.put(&addressed(round, b"good"));
    }
    // Who is gone without a word, before and after the hello.
    for half in [&hello("roof")[..7], &hello("roof")] {
        UnixStream::connect(root.socket())
            .unwrap()
            .write_all(half)
            .unwrap();
    }
    good.stop();
    let (taken, lost) = drain(good);
    assert!(lost == 0 && taken.into_iter().map(|one| one.0).eq(0..100));
}

#[test]
fn there_are_as_many_clients_as_there_may_be_and_the_silent_are_not_waited_for() {
    let root = Root::new("many");
    let taps = Taps::listen(&root.socket()).unwrap();
    let _roof = taps.sensor("roof");
    let silent: Vec<_> = (0..MAX_CLIENTS)
        .map(|_| UnixStream::connect(root.socket()).unwrap())
        .collect();
    assert!(matches!(error(&root, "roof"), TapError::Busy));
    let begun = Instant::now();
    let found = loop {
        match TapStream::connect(&root.socket(), "roof") {
            Err(TapError::Busy) if begun.elapsed() < Duration::from_secs(20) => {
                std::thread::sleep(Duration::from_millis(50));
            }
            other => break other,
        }
    };
    assert!(found.is_ok() && begun.elapsed() > Duration::from_secs(1));
    drop(silent);
}

#[test]
fn who_cannot_be_served_is_told_why() {
    let root = Root::new("why");
    let none = error(&root, "roof");
    assert!(
        matches!(none, TapError::NoDaemon { .. }) && none.to_string().contains("--root"),
        "{none}"
    );
    let taps = Taps::listen(&root.socket()).unwrap();
    assert!(
        error(&root, "roof")
            .to_string()
            .contains("no sensor roof; it has none")
    );
    let _sensors = ["roof", "rear", "roof"].map(|name| taps.sensor(name));
    assert!(
        error(&root, "front")
            .to_string()
            .contains("no sensor front; it has rear, roof")
    );
    let mut newer = hello("roof");
    newer[8] = 9;
    let mut client = UnixStream::connect(root.socket()).unwrap();
    client.write_all(&newer).unwrap();
    let answer = Answer::read(&mut client).unwrap().unwrap();
    assert_eq!((answer.version, answer.status), (1, Status::OtherVersion));
}

#[test]
fn a_daemon_that_is_none_is_an_error_and_no_panic() {
    let root = Root::new("none");
    let listener = std::os::unix::net::UnixListener::bind(root.socket()).unwrap();
    let frame = |kind: u16, len: u16| [kind.to_le_bytes(), len.to_le_bytes()].concat();
    let granted = Answer::new(Status::Granted, "").bytes();
    for (said, expected) in [
        (
            b"HTTP/1.1 400 Bad Request\r\n".to_vec(),
            "is no sweepd daemon",
        ),
        (granted[..5].to_vec(), "does not answer"),
        (Vec::new(), "does not answer"),
        (granted.clone(), "does not answer"),
        (
            [&granted[..], &frame(7, 0), &[0; 20]].concat(),
            "something of kind 7",
        ),
        (
            [&granted[..], &frame(2, 9), &[0; 29]].concat(),
            "an end of 9 bytes",
        ),
        (
            [&granted[..], &frame(1, 65_535), &[0; 20]].concat(),
            "a datagram of 65535 bytes",
        ),
        (
            [&granted[..], &frame(1, 4), &[0xFF; 24]].concat(),
            "an arrival at -1 ns",
        ),
        (
            [&granted[..], &frame(1, 1000), &[0; 500]].concat(),
            "does not answer",
        ),
    ] {
        let path = root.socket();
        let client = std::thread::spawn(move || {
            let mut client = TapStream::connect(&path, "roof")?;
            while client.lost().is_none() {
                client.receive(Duration::from_secs(5), |_| {})?;
            }
            Ok::<_, TapError>(())
        });
        let (mut stream, _) = listener.accept().unwrap();
        stream
            .read_exact(&mut vec![0; hello("roof").len()])
            .unwrap();
        stream.write_all(&said).unwrap();
        drop(stream);
        let error = client.join().unwrap().unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn the_socket_is_its_users_alone_and_replaces_one_that_was_left() {
    let root = Root::new("own");
    drop(std::os::unix::net::UnixListener::bind(root.socket()).unwrap());
    let taps = Taps::listen(&root.socket()).unwrap();
    assert_eq!(
        root.socket().metadata().unwrap().permissions().mode() & 0o777,
        0o600
    );
    assert!(matches!(
        Taps::listen(&root.socket()),
        Err(TapError::Taken { .. })
    ));
    // All files of the folder deleted, the folder too.
    std::fs::remove_dir_all(&root.0).unwrap();
    // More often than bells are kept.
    for _ in 0..10_000 {
        taps.look_after();
    }
    std::thread::sleep(Duration::from_millis(100));
    assert!(!root.socket().exists());
    std::fs::create_dir(&root.0).unwrap();
    let _roof = taps.sensor("roof");
    let begun = Instant::now();
    while TapStream::connect(&root.socket(), "roof").is_err() {
        assert!(begun.elapsed() < Duration::from_secs(20));
        taps.look_after();
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(taps);
    assert_eq!(std::fs::read_dir(&root.0).unwrap().count(), 0);
    std::fs::write(root.socket(), "mine").unwrap();
    let refused = Taps::listen(&root.socket()).unwrap_err().to_string();
    assert!(refused.contains("something else is there"), "{refused}");
    assert_eq!(std::fs::read(root.socket()).unwrap(), b"mine");
    let nowhere = Taps::listen(&root.0.join("none/tap.sock"))
        .unwrap_err()
        .to_string();
    assert!(nowhere.contains("cannot listen at"), "{nowhere}");
}

#[test]
fn iceoryx2_does_not_mind_the_socket_in_its_folder() {
    use iceoryx2::prelude::*;
    let root = Root::new("iceoryx2");
    let taps = Taps::listen(&root.socket()).unwrap();
    let _roof = taps.sensor("roof");
    let mut config = iceoryx2::config::Config::default();
    config.global.set_root_path(
        &iceoryx2::prelude::Path::new(root.0.as_os_str().as_encoded_bytes()).unwrap(),
    );
    config.global.prefix =
        FileName::new(format!("sweepd_tap_{}_", std::process::id()).as_bytes()).unwrap();
    let node = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled);
    let node = node.create::<ipc::Service>().unwrap();
    let name = "tap".try_into().unwrap();
    let service = node
        .service_builder(&name)
        .publish_subscribe::<u64>()
        .open_or_create()
        .unwrap();
    let mut services = 0;
    let counted = ipc::Service::list(&config, |_| {
        services += 1;
        CallbackProgression::Continue
    });
    assert!(counted.is_ok() && services == 1);
    drop((service, node));
    assert!(TapStream::connect(&root.socket(), "roof").is_ok());
    // The counter by which iceoryx2 numbers the nodes of this prefix.
    let prefix = config.global.prefix.to_string();
    for entry in std::fs::read_dir(sweepd_client::publish::SHARED_MEMORY)
        .unwrap()
        .flatten()
    {
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            std::fs::remove_file(entry.path()).unwrap();
        }
    }
}

/// The user that has nothing.
const NOBODY: u32 = 65_534;

/// Runs [`in_another_process`] as another user, if this one may.
fn as_nobody(role: &str, root: &Root) -> Option<Child> {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args([
            "--exact",
            "daemon::tap::tests::in_another_process",
            "--nocapture",
        ])
        .uid(NOBODY);
    command
        .env("SWEEPD_TAP_ROLE", role)
        .env("SWEEPD_TAP_SOCKET", root.socket());
    match command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn() {
        Ok(child) => Some(child),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "{error}");
            eprintln!("SKIPPED: only root can run a program as another user");
            None
        }
    }
}

/// What the tests below run as another user; in a run of all tests it has nothing to do.
#[test]
fn in_another_process() {
    let Some(path) = std::env::var_os("SWEEPD_TAP_SOCKET").map(PathBuf::from) else {
        return;
    };
    if std::env::var_os("SWEEPD_TAP_ROLE").unwrap() == "daemon" {
        let taps = Taps::listen(&path).unwrap();
        let _roof = taps.sensor("roof");
        println!("ready");
        std::io::stdin().read_to_end(&mut Vec::new()).unwrap();
    } else {
        let mut stream = UnixStream::connect(path).unwrap();
        // It may have been refused before it asked.
        let _ = stream.write_all(&hello("roof"));
        println!("{:?}", Answer::read(&mut stream).unwrap().unwrap());
    }
}

#[test]
fn a_client_of_another_user_is_refused_even_where_it_can_open_the_socket() {
    let root = Root::new("foreign-client");
    let taps = Taps::listen(&root.socket()).unwrap();
    let roof = taps.sensor("roof");
    std::fs::set_permissions(root.socket(), std::fs::Permissions::from_mode(0o666)).unwrap();
    let Some(client) = as_nobody("client", &root) else {
        return;
    };
    let output = client.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("status: OtherUser, text: \"root\""), "{text}");
    assert!(!roof.is_open());
}

#[test]
fn root_is_told_that_a_daemon_is_of_another_user() {
    let root = Root::new("foreign-daemon");
    std::fs::set_permissions(&root.0, std::fs::Permissions::from_mode(0o777)).unwrap();
    let Some(mut daemon) = as_nobody("daemon", &root) else {
        return;
    };
    let mut said = std::io::BufReader::new(daemon.stdout.take().unwrap()).lines();
    assert!(said.any(|line| line.unwrap().contains("ready")));
    let error = error(&root, "roof");
    assert!(matches!(error, TapError::OtherUser { .. }), "{error}");
    let error = error.to_string();
    assert!(
        ["user nobody", "user root", "sudo -u nobody"]
            .iter()
            .all(|part| error.contains(part)),
        "{error}"
    );
    drop(daemon.stdin.take());
    daemon.wait().unwrap();
}
