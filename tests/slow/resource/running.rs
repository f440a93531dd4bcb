//! What goes away while it runs, and comes back.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use sweepd_testkit::PATIENCE;

use crate::resource::world::{World, binary};

const DECODED: &str = "sweepd_sweeps_total{sensor=\"roof\"}";

/// Sweeps go on being counted.
#[track_caller]
fn goes_on(world: &World) {
    let (begun, before) = (Instant::now(), world.metric(DECODED));
    while world.metric(DECODED) < before + 3 {
        assert!(begun.elapsed() < PATIENCE, "no sweeps: {}", world.log());
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn full_shared_memory_is_reported_and_sweeps_are_shared_again_when_there_is_room() {
    let mut world = World::new();
    // The model is told by the packets: so the memory is taken when they come.
    world.configure("", "");
    world.start(&["-m"], "mount -t tmpfs -o size=64m none /dev/shm");
    world.until_it_says("waiting for packets");
    world.inside("head -c 63m /dev/zero > /dev/shm/other 2>/dev/null || true");
    world.simulate(120.0);
    world.until_it_says("roof: sweeps are not shared: /dev/shm has");
    world.until_health(503, "sweeps are not shared: /dev/shm has");
    goes_on(&world);
    world.inside("rm /dev/shm/other");
    world.until_it_says("roof: sweeps are shared again");
    world.until_health(200, "streaming");
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0));
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn without_descriptors_sweeps_go_on_and_health_answers_again_when_there_are_some() {
    let mut world = World::new();
    world.configure("", "");
    world.start(&["-m"], "");
    world.until_it_says("waiting for packets");
    world.simulate(120.0);
    world.until_health(200, "streaming");
    let before = world.metric(DECODED);
    let pid = world.pid();
    let limit = |files: usize| {
        let limit = format!("--nofile={files}:4096");
        assert!(
            Command::new("prlimit")
                .args(["--pid", &pid.to_string(), &limit])
                .status()
                .unwrap()
                .success()
        );
    };
    // Below all that are open: no more can be had, whichever are free.
    limit(3);
    let held: Vec<TcpStream> = (0..5)
        .map(|_| TcpStream::connect(("127.0.0.1", world.http)).unwrap())
        .collect();
    let mut asks = &held[0];
    asks.write_all(b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .unwrap();
    asks.set_read_timeout(Some(Duration::from_secs(3))).unwrap();
    assert!(asks.read(&mut [0]).is_err(), "nobody can answer");
    limit(1024);
    drop(held);
    world.until_health(200, "streaming");
    assert!(world.metric(DECODED) > before + 8, "sweeps went on");
    assert!(!world.log().contains("panicked"), "{}", world.log());
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_full_disk_ends_the_recording_and_no_sensor_and_it_goes_on_by_itself_when_there_is_room() {
    let mut world = World::new();
    world.configure("", "[record]\npath = \"/mnt/drive.pcap\"\n");
    world.start(&["-m"], "mount -t tmpfs -o size=256k none /mnt");
    world.until_it_says("recording to /mnt/drive-000.pcap");
    world.simulate(120.0);
    world.until_it_says(
        "the recording has ended: cannot write /mnt/drive-000.pcap: No space left on device",
    );
    world.until_it_says("free space there, or record to another disk");
    world.until_health(503, "nothing is recorded: cannot write /mnt/drive-00");
    assert_eq!(world.metric("sweepd_recording_failed{}"), 1);
    goes_on(&world);
    world.until_metric("sweepd_recording_retries_total{}", 2);
    let unrecorded = world.metric("sweepd_unrecorded_total{}");
    assert!(unrecorded > 0, "{}", world.log());
    world.inside("test $(ls /mnt | wc -l) = 1 && mount -o remount,size=64m /mnt");
    world.until_it_says("recording to /mnt/drive-001.pcap again");
    world.until_health(200, "streaming");
    assert_eq!(world.metric("sweepd_recording_failed{}"), 0);
    assert!(
        world.metric("sweepd_unrecorded_total{}") >= unrecorded,
        "what was not recorded stays counted"
    );
    assert_eq!(world.says("the recording has ended"), 1, "{}", world.log());
    assert_eq!(world.metric("sweepd_lost_total{sensor=\"roof\"}"), 0);
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0), "{}", world.log());
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn where_nothing_can_be_written_nothing_is_recorded_and_it_is_begun_when_something_can() {
    for (script, why) in [
        (
            "mount -t tmpfs -o ro none /mnt",
            "Read-only file system (os error 30); choose a folder that this user may write to",
        ),
        (
            "mount -t tmpfs none /mnt\nmkdir /mnt/drive-000.pcap\nmount -o remount,ro /mnt",
            "Read-only file system",
        ),
    ] {
        let mut world = World::new();
        world.configure("", "[record]\npath = \"/mnt/drive.pcap\"\n");
        world.start(&["-m"], script);
        world.until_it_says("nothing is recorded: cannot write /mnt/drive-0");
        assert!(world.log().contains(why), "{}", world.log());
        world.simulate(120.0);
        world.until_health(503, "nothing is recorded: cannot write /mnt/drive-0");
        goes_on(&world);
        world.inside("mount -o remount,rw /mnt");
        world.until_it_says("recording to /mnt/drive-0");
        world.until_health(200, "streaming");
        let recorded = world.metric("sweepd_recorded_total{}");
        world.until_metric("sweepd_recorded_total{}", recorded + 100);
        assert_eq!(world.says("nothing is recorded"), 1, "{}", world.log());
    }
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_closed_log_pipe_does_not_stop_the_daemon() {
    let mut world = World::new();
    world.configure("", "");
    let (reader, writer) = std::io::pipe().unwrap();
    world.start_with_log(&["-m"], "", Stdio::from(writer));
    world.simulate(120.0);
    world.until_health(200, "streaming");
    drop(reader);
    // A line for each of these.
    for _ in 0..3 {
        world.signal("-HUP");
        std::thread::sleep(Duration::from_millis(100));
    }
    goes_on(&world);
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0));
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn an_interface_that_goes_away_and_comes_back_is_listened_on_again() {
    let mut world = World::new();
    world.configure(
        "bind = \"0.0.0.0\"\ninterface = \"lidar0\"\naddress = \"10.77.0.2\"\n",
        "",
    );
    let mut sensor = Command::new("unshare");
    let sensor = world.background({
        sensor.args(["-n", "sleep", "300"]);
        sensor
    });
    world.start(&["-m", "-n"], "ip link set lo up");
    world.until_it_says("cannot listen on interface lidar0");
    world.until_health(503, "cannot listen on interface lidar0");
    // An interface that was moved before that would stay in this network.
    world.until_own_network(sensor);
    for times in 1..=2 {
        world.inside(&format!(
            "ip link add lidar0 type veth peer name sensor0 netns {sensor}\nip address add 10.77.0.1/24 dev lidar0\n\
             ip link set lidar0 up\n\
             nsenter -t {sensor} -n sh -ec 'ip address add 10.77.0.2/24 dev sensor0; ip link set sensor0 up'"
        ));
        if times == 1 {
            world.until_it_says("listening on port ");
        } else {
            world.until_it_says("its interface is back");
        }
        let (to, pid) = (format!("10.77.0.1:{}", world.port), sensor.to_string());
        let mut simulate = Command::new("nsenter");
        simulate.args([
            "-t",
            &pid,
            "-n",
            &binary(),
            "simulate",
            "--model",
            "vlp16",
            "--seconds",
            "120",
            "--to",
            &to,
        ]);
        let simulate = world.background(simulate);
        if times == 1 {
            // After an outage it is said again only if that was long enough to be told.
            world.until_it_says("roof: streaming, VLP-16");
        }
        world.until_health(200, "streaming");
        goes_on(&world);
        world.inside("ip link delete lidar0");
        world.until_it_says_again("the interface lidar0 is gone", times);
        world.until_health(503, "the interface lidar0 is gone");
        world.stop(simulate);
    }
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0), "{}", world.log());
}
