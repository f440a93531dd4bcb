//! Clients and recordings over a real socket, with ports whose threads the test plays.

use std::future::Future;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver};

use tokio::net::UnixStream;
use tokio::time::{sleep, timeout};

use super::client::{RemoteRecordError, RemoteRecording, segment_settings};
use super::protocol::{Connection, Ended, Reply, SegmentSettings, VERSION};
use super::server::{ControlServer, SocketError, Told};
use super::*;
use crate::admission::Refusal;
use crate::files::WriteError;
use crate::files::sequence::Rotation;
use crate::input::Capture;
use std::io;
use sweepd_core::segment::{self, SETTINGS};

const SOON: Duration = Duration::from_secs(60);

/// A port: the sensors whose packets come through it, and what its thread has.
struct Port {
    changes: Receiver<PortChange>,
    recordings: Vec<PortRecording>,
}

impl Port {
    fn turn(&mut self) {
        while let Ok(change) = self.changes.try_recv() {
            change.apply(&mut self.recordings);
        }
    }

    /// Receives a datagram of a sensor, by its number at admission.
    fn receive(&mut self, sensor: usize, port: u16, arrival_ns: i64, payload: &[u8]) {
        self.turn();
        let datagram = Addressed {
            arrival_ns,
            source: SocketAddrV4::new([192, 168, 1, 201].into(), 2368),
            destination: SocketAddrV4::new(Ipv4Addr::BROADCAST, port),
            payload,
        };
        for recording in &mut self.recordings {
            recording.put(Some(sensor), &datagram);
        }
    }
}

/// Two sensors with a data port, and the port of their positions, where they have other numbers.
struct Daemon {
    folder: PathBuf,
    recordings: Recordings,
    ports: Vec<Port>,
    server: ControlServer,
}

impl Daemon {
    fn start(test: &str) -> Self {
        let name = format!("sweepd-asked-{test}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder).unwrap();
        let mut recordings = Recordings::default();
        let mut ports = Vec::new();
        let mut links = Vec::new();
        for sensors in [vec![0, 1], vec![1, 0]] {
            let (changes, to_port) = mpsc::channel();
            links.push(PortLink {
                sensors,
                counters: Arc::default(),
                changes,
            });
            ports.push(Port {
                changes: to_port,
                recordings: Vec::new(),
            });
        }
        recordings.connect(vec!["roof".to_owned(), "rear".to_owned()], links);
        let told = Told::default();
        let segment = segment::Config {
            min_points: 33,
            ..segment::Config::default()
        };
        let settings = SegmentSettings::of(&segment);
        told.lock().unwrap().insert("roof".to_owned(), settings);
        let server = ControlServer::start(&socket_path(&folder), recordings.event_sender(), told);
        Self {
            folder,
            recordings,
            ports,
            server: server.unwrap(),
        }
    }

    /// Does what the control thread and the ports do, until something else is done.
    async fn during<T>(&mut self, action: impl Future<Output = T>) -> T {
        tokio::pin!(action);
        loop {
            tokio::select! {
                done = &mut action => return done,
                event = self.recordings.next_event() => self.recordings.handle(event),
                () = sleep(Duration::from_millis(10)) => self.turn(),
            }
        }
    }

    fn turn(&mut self) {
        self.recordings.look();
        self.ports.iter_mut().for_each(Port::turn);
    }

    fn request(&self, file: &str) -> Request {
        Request {
            version: VERSION,
            sensor: "roof".to_owned(),
            senders: Vec::new(),
            path: self.folder.join(file),
            replaces: false,
            rotation: Rotation::default(),
            duration: None,
        }
    }

    async fn begin(&mut self, request: &Request) -> Result<RemoteRecording, RemoteRecordError> {
        let socket = socket_path(&self.folder);
        let begun = self.during(RemoteRecording::begin(&socket, request)).await;
        begun.map(|(recording, _)| recording)
    }

    /// Why a request is refused.
    async fn refusal(&mut self, request: &Request) -> String {
        self.begin(request).await.unwrap_err().to_string()
    }

    /// Ends a recording as Ctrl-C does.
    async fn end(&mut self, mut recording: RemoteRecording) -> Ended {
        self.during(async {
            recording.end().await;
            ended(&mut recording).await
        })
        .await
    }

    fn read(&self, file: &str) -> Vec<(i64, u16, Vec<u8>)> {
        let mut capture = Capture::open(self.folder.join(file)).unwrap();
        let mut all = Vec::new();
        while let Some(one) = capture.next_datagram().unwrap() {
            all.push((one.arrival_ns, one.destination_port, one.payload.to_vec()));
        }
        assert_eq!(capture.truncation(), None);
        all
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// What a recording came to; progress before is passed over.
async fn ended(recording: &mut RemoteRecording) -> Ended {
    loop {
        match recording.next(SOON).await.unwrap() {
            Some(Reply::Ended(ended)) => return ended,
            Some(Reply::Progress(_)) => {}
            other => panic!("{other:?}"),
        }
    }
}

fn data_packet(number: u8) -> Vec<u8> {
    let mut packet = sweepd_core::wire::DataPacket::new(0, 0x37, 0x22)
        .emit()
        .to_vec();
    packet[4] = number;
    packet
}

#[tokio::test(flavor = "current_thread")]
async fn what_two_ports_receive_of_a_sensor_is_recorded_in_the_order_of_arrival() {
    for _ in 0..10 {
        if is_recorded_in_the_order_of_arrival().await {
            return;
        }
    }
    panic!("the machine is late each time");
}

/// Whether this machine was in time.
async fn is_recorded_in_the_order_of_arrival() -> bool {
    let mut daemon = Daemon::start("order");
    let mut request = daemon.request("roof.pcap");
    request.rotation.bytes = Some(1_000_000);
    let recording = daemon.begin(&request).await.unwrap();
    let mut expected = Vec::new();
    // The thread of the positions is behind that of the data, most when it has not yet turned to
    // the recording.
    for (begin, behind_ms, latest_ms) in [(0, 260, 280), (1_000, 10, 100)] {
        let begun = Instant::now();
        for number in begin..begin + 1_000 {
            let packet = data_packet(number as u8);
            daemon.ports[0].receive(0, 2368, 2 * number, &packet);
            daemon.ports[0].receive(1, 2368, 2 * number, &packet);
            expected.push((2 * number, 2368, packet));
        }
        std::thread::sleep(Duration::from_millis(behind_ms));
        for number in (begin..begin + 1_000).step_by(50) {
            daemon.ports[1].receive(1, 8308, 2 * number + 1, &[0; 512]);
            daemon.ports[1].receive(0, 8308, 2 * number + 1, &[0; 512]);
            expected.push((2 * number + 1, 8308, vec![0; 512]));
        }
        // Else the writer may not have waited for it: OPENING is 300 ms, PERIOD 120.
        if begun.elapsed() > Duration::from_millis(latest_ms) {
            return false;
        }
        std::thread::sleep(Duration::from_millis(500));
    }
    let ended = daemon.end(recording).await;
    assert_eq!((ended.error, ended.written.records), (None, 2_040));
    assert_eq!(
        (ended.received.datagrams, ended.received.positions),
        (2_040, 40)
    );
    let senders = ended.received.senders.iter();
    let senders: Vec<_> = senders
        .map(|one| (one.destination_port, one.packets))
        .collect();
    assert_eq!(senders, [(2368, 2_000)]);
    expected.sort_by_key(|one| one.0);
    let files = (0..3).map(|number| daemon.read(&format!("roof-00{number}.pcap")));
    assert!(files.flatten().eq(expected));
    assert_eq!(ended.written.files, 3);
    assert_eq!(daemon.recordings.status().on_demand_datagrams, 2_040);
    true
}

#[tokio::test(flavor = "current_thread")]
async fn a_client_that_is_killed_ends_its_recording_and_leaves_it_whole() {
    let mut daemon = Daemon::start("killed");
    let recording = daemon.begin(&daemon.request("roof.pcap.gz")).await.unwrap();
    daemon.ports[0].receive(0, 2368, 5, &data_packet(1));
    assert_eq!(daemon.recordings.status().on_demand.len(), 1);
    drop(recording);
    let begun = Instant::now();
    while !daemon.recordings.list.is_empty() || !daemon.recordings.ending.is_empty() {
        assert!(begun.elapsed() < SOON);
        daemon.during(sleep(Duration::from_millis(10))).await;
    }
    assert_eq!(daemon.read("roof.pcap.gz"), [(5, 2368, data_packet(1))]);
    assert!(daemon.ports.iter().all(|port| port.recordings.is_empty()));
}

#[tokio::test(flavor = "current_thread")]
async fn the_end_of_the_daemon_ends_recordings_and_tells_their_clients() {
    let mut daemon = Daemon::start("daemon-ends");
    let mut recording = daemon.begin(&daemon.request("roof.pcap")).await.unwrap();
    daemon.ports[0].receive(0, 2368, 5, &data_packet(1));
    daemon.ports.clear();
    daemon.recordings.finish();
    let socket = socket_path(&daemon.folder);
    let (ended, ()) = tokio::join!(ended(&mut recording), async {
        let server = ControlServer::start(
            &daemon.folder.join("other"),
            daemon.recordings.event_sender(),
            Told::default(),
        );
        std::mem::replace(&mut daemon.server, server.unwrap())
            .finish()
            .await;
    });
    assert_eq!((ended.error, ended.written.records), (None, 1));
    assert!(!socket.exists());
}

#[tokio::test(flavor = "current_thread")]
async fn a_disk_that_fails_ends_the_recording_and_what_is_lost_is_counted() {
    let mut daemon = Daemon::start("full");
    std::os::unix::fs::symlink("/dev/full", daemon.folder.join("full.pcap")).unwrap();
    let mut recording = daemon.begin(&daemon.request("full.pcap")).await.unwrap();
    for number in 0..200 {
        daemon.ports[0].receive(0, 2368, number, &data_packet(1));
    }
    let ended = daemon.during(ended(&mut recording)).await;
    let error = ended.error.unwrap();
    assert!(
        error.contains("full.pcap: No space left on device") && error.contains("free space there"),
        "{error}"
    );
    assert_eq!((ended.received.datagrams, ended.written.records), (200, 0));
}

#[tokio::test(flavor = "current_thread")]
async fn senders_that_are_not_wanted_are_counted_and_not_recorded() {
    let mut daemon = Daemon::start("senders");
    let mut request = daemon.request("roof.pcap");
    request.senders = vec!["192.168.1.202".to_owned()];
    let recording = daemon.begin(&request).await.unwrap();
    daemon.ports[0].receive(0, 2368, 5, &data_packet(1));
    let ended = daemon.end(recording).await;
    assert_eq!(
        (
            ended.written.records,
            ended.received.refusals.get(Refusal::Source)
        ),
        (0, 1)
    );
}

#[tokio::test(flavor = "current_thread")]
async fn what_cannot_be_recorded_is_refused_with_the_cure() {
    let mut daemon = Daemon::start("refused");
    let mut request = daemon.request("x.pcap");
    request.sensor = "front".to_owned();
    assert_eq!(
        daemon.refusal(&request).await,
        "the daemon has no sensor front; it has rear, roof"
    );
    request = daemon.request("x.pcap");
    request.version += 1;
    assert!(
        daemon
            .refusal(&request)
            .await
            .contains("use the same release of sweepd")
    );
    request = daemon.request("x.pcap");
    request.path = "x.pcap".into();
    assert!(daemon.refusal(&request).await.contains("no absolute path"));
    request = daemon.request("x.pcap");
    request.senders = vec!["roof".to_owned()];
    assert!(daemon.refusal(&request).await.contains("names no sensor"));
    for (file, part) in [
        ("x.txt", "ends in .pcap or .pcap.gz"),
        ("none/x.pcap", "make its folder first"),
        ("mine.pcap", "mine.pcap exists; --force replaces it"),
    ] {
        std::fs::write(daemon.folder.join("mine.pcap"), "mine").unwrap();
        let refusal = daemon.refusal(&daemon.request(file)).await;
        assert!(refusal.contains(part), "{refusal}");
    }
    // One that replaces a file does so when it is whole.
    request = daemon.request("mine.pcap");
    request.replaces = true;
    let recording = daemon.begin(&request).await.unwrap();
    assert_eq!(std::fs::read(&request.path).unwrap(), b"mine");
    let again = daemon.refusal(&request).await;
    assert!(
        again.contains("records to") && again.contains("already"),
        "{again}"
    );
    daemon.ports[0].receive(0, 2368, 5, &data_packet(1));
    let ended = daemon.end(recording).await;
    assert_eq!((ended.written.last, ended.written.files), (request.path, 1));
    assert_eq!(daemon.read("mine.pcap").len(), 1);
    assert!(!daemon.folder.join("mine.pcap.part").exists());
}

#[test]
fn a_folder_that_the_daemon_may_not_write_to_is_named_with_the_cure() {
    for kind in [
        io::ErrorKind::PermissionDenied,
        io::ErrorKind::ReadOnlyFilesystem,
    ] {
        let text = explain(&WriteError::Recording {
            path: "/home/me/x.pcap".into(),
            cause: kind.into(),
        });
        for part in [
            "may not write to the folder /home/me: ",
            "/var/lib/sweepd",
            "docs/install.md",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}

#[tokio::test(flavor = "current_thread")]
async fn clients_are_few_and_hostile_ones_keep_nobody_waiting() {
    let mut daemon = Daemon::start("hostile");
    let mut silent = Vec::new();
    for _ in 0..MAX_ON_DEMAND {
        silent.push(
            UnixStream::connect(socket_path(&daemon.folder))
                .await
                .unwrap(),
        );
    }
    let refusal = daemon.refusal(&daemon.request("x.pcap")).await;
    assert!(refusal.contains("4 recordings under way"), "{refusal}");
    // Those that say nothing, too much, or nonsense are shown out.
    silent.truncate(1);
    let mut endless = Connection::new(
        UnixStream::connect(socket_path(&daemon.folder))
            .await
            .unwrap(),
    );
    let message = "x".repeat(100 << 10);
    let _ = daemon.during(timeout(SOON, endless.send(&message))).await;
    assert!(!matches!(
        daemon.during(endless.receive()).await,
        Ok(Some(_))
    ));
    let mut nonsense = Connection::new(
        UnixStream::connect(socket_path(&daemon.folder))
            .await
            .unwrap(),
    );
    nonsense.send(&"hello").await.unwrap();
    let answer = daemon.during(nonsense.receive()).await.unwrap().unwrap();
    assert!(
        String::from_utf8(answer)
            .unwrap()
            .contains("does not understand")
    );
    let mut recordings = Vec::new();
    for number in 0..MAX_ON_DEMAND - 1 {
        let request = daemon.request(&format!("{number}.pcap"));
        recordings.push(daemon.begin(&request).await.unwrap());
    }
    // The one that said nothing loses its place.
    let begun = Instant::now();
    recordings.push(loop {
        match daemon.begin(&daemon.request("last.pcap")).await {
            Ok(last) => break last,
            Err(error) => assert!(begun.elapsed() < SOON, "{error}"),
        }
    });
    // One that reads nothing loses progress, and nothing else.
    daemon.ports[0].receive(0, 2368, 5, &data_packet(1));
    for recording in recordings {
        assert_eq!(daemon.end(recording).await.written.records, 1);
    }
}

#[tokio::test(flavor = "current_thread")]
async fn the_settings_of_a_sensor_are_told() {
    let mut daemon = Daemon::start("settings");
    let ask = |sensor: &'static str| {
        let path = socket_path(&daemon.folder);
        tokio::task::spawn_blocking(move || segment_settings(&path, sensor))
    };
    let (told, none) = (ask("roof"), ask("attic"));
    let told = daemon.during(told).await.unwrap().unwrap();
    assert_eq!(
        (&told.method[..], told.masked, told.settings.len()),
        ("slope", false, SETTINGS.len())
    );
    assert_eq!(
        (told.settings["min_points"], told.settings["height_m"]),
        (Some(33.0), None)
    );
    assert!(daemon.during(none).await.unwrap().is_err());
}

#[tokio::test(flavor = "current_thread")]
async fn the_socket_is_its_owners_and_comes_back_when_it_is_deleted() {
    use std::os::unix::fs::PermissionsExt;
    let mut daemon = Daemon::start("socket");
    let path = socket_path(&daemon.folder);
    let mode = path.metadata().unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let taken = ControlServer::start(&path, daemon.recordings.event_sender(), Told::default());
    assert!(matches!(taken, Err(SocketError::Taken { .. })));
    std::fs::remove_file(&path).unwrap();
    let begun = Instant::now();
    while !path.exists() {
        assert!(begun.elapsed() < SOON);
        daemon.during(sleep(Duration::from_millis(10))).await;
    }
    daemon.begin(&daemon.request("x.pcap")).await.unwrap();
    // What a killed daemon left behind is replaced; what is no socket is not.
    let left = daemon.folder.join("left");
    let unready = daemon.folder.join("left.unready");
    drop(std::os::unix::net::UnixListener::bind(&left).unwrap());
    drop(std::os::unix::net::UnixListener::bind(&unready).unwrap());
    ControlServer::start(&left, daemon.recordings.event_sender(), Told::default()).unwrap();
    assert!(!unready.exists());
    let file = daemon.folder.join("file");
    std::fs::write(&file, "mine").unwrap();
    let error =
        ControlServer::start(&file, daemon.recordings.event_sender(), Told::default()).unwrap_err();
    assert!(
        error.to_string().contains("something else is there"),
        "{error}"
    );
}

#[tokio::test(flavor = "current_thread")]
async fn a_client_that_goes_before_the_beginning_replaces_nothing() {
    let mut daemon = Daemon::start("gone-early");
    let mut request = daemon.request("x.pcap");
    request.replaces = true;
    std::fs::write(&request.path, "good").unwrap();
    let stream = UnixStream::connect(socket_path(&daemon.folder)).await;
    let mut connection = Connection::new(stream.unwrap());
    connection.send(&request).await.unwrap();
    let on_demand = daemon.recordings.next_event().await;
    daemon.recordings.handle(on_demand);
    // It is begun, and the control thread does not know yet; the client goes first.
    drop(connection);
    let begun = daemon.recordings.next_event().await;
    sleep(Duration::from_millis(300)).await;
    daemon.recordings.handle(begun);
    daemon.recordings.finish();
    assert_eq!(std::fs::read(&request.path).unwrap(), b"good");
    assert!(!daemon.folder.join("x.pcap.part").exists());
}

#[tokio::test(flavor = "current_thread")]
async fn a_pipe_that_no_program_reads_is_refused() {
    let mut daemon = Daemon::start("pipe");
    let request = daemon.request("x.pcap");
    let mkfifo = std::process::Command::new("mkfifo")
        .arg(&request.path)
        .status();
    assert!(mkfifo.unwrap().success());
    let refusal = daemon.refusal(&request).await;
    assert!(refusal.contains("no program reads it"), "{refusal}");
}

#[tokio::test(flavor = "current_thread")]
async fn a_client_that_is_stopped_records_no_longer_than_it_wanted() {
    let mut daemon = Daemon::start("overdue");
    let mut request = daemon.request("x.pcap");
    request.duration = Some(Duration::from_millis(100));
    let mut recording = daemon.begin(&request).await.unwrap();
    let ended = daemon.during(ended(&mut recording)).await;
    assert_eq!(ended.error, None);
    assert!(daemon.recordings.list.is_empty());
}
