//! What it cannot start without: it says what is missing and how to mend it, and ends; what may
//! come later it waits for.

use std::os::unix::fs::PermissionsExt;

use crate::resource::world::World;

/// What is wrong at the start, and what must come of it.
struct Case {
    name: &'static str,
    /// Lines of the sensor, and of the whole.
    config: (&'static str, &'static str),
    unshare: &'static [&'static str],
    /// What is done before; `$FOLDER` is the test's.
    script: &'static str,
    /// The exit code, and what its last words hold.
    code: i32,
    says: &'static [&'static str],
}

const CASES: [Case; 8] = [
    Case {
        name: "/dev/shm is too small",
        config: ("model = \"vlp16\"", ""),
        unshare: &["-m"],
        script: "mount -t tmpfs -o size=1m none /dev/shm",
        code: 1,
        says: &[
            "error: roof: /dev/shm has",
            "bytes free and",
            "are needed,",
            "more:",
            "remount,size=",
        ],
    },
    Case {
        name: "no descriptors",
        config: ("", ""),
        unshare: &["-m"],
        script: "ulimit -n 8",
        code: 1,
        says: &["error: ", "Too many open files"],
    },
    Case {
        name: "fewer descriptors than tokio opens",
        config: ("", ""),
        unshare: &["-m"],
        script: "ulimit -n 6",
        code: 1,
        says: &["error: cannot start the control thread: Too many open files"],
    },
    Case {
        name: "no descriptors for shared memory",
        config: ("", ""),
        unshare: &["-m"],
        script: "ulimit -n 16",
        code: 1,
        says: &[
            "error: roof: this process may open 16 files and",
            "ulimit -n",
        ],
    },
    Case {
        name: "the folder is read-only",
        config: ("", "root = \"/mnt/iox2\"\n---"),
        unshare: &["-m"],
        script: "mount -t tmpfs -o ro none /mnt",
        code: 1,
        says: &[
            "error: cannot use /mnt/iox2 for shared memory: Read-only file system",
            "name a folder of this user with --root",
        ],
    },
    Case {
        name: "the folder is another user's",
        config: ("", "root = \"/mnt\"\n---"),
        unshare: &["-m"],
        script: "mount -t tmpfs -o mode=755 none /mnt\nPREFIX='setpriv --reuid=65534 --regid=65534 --clear-groups'",
        code: 1,
        says: &[
            "error: /mnt belongs to user root, this program runs as nobody",
            "sudo -u root",
        ],
    },
    Case {
        name: "a privileged port",
        config: ("", "root = \"/mnt/iox2\"\n---"),
        unshare: &["-m", "-n"],
        script: "ip link set lo up\nmount -t tmpfs -o mode=1777 none /mnt\nsed -i 's/port = .*/port = 99/' $FOLDER/sweepd.toml\n\
                 PREFIX='setpriv --reuid=65534 --regid=65534 --clear-groups'",
        code: 1,
        says: &["error: cannot listen on 127.0.0.1:99: Permission denied"],
    },
    Case {
        name: "a configuration that cannot be read",
        config: ("", ""),
        unshare: &["-m"],
        script: "mount -t tmpfs none $FOLDER 2>/dev/null; rm -f $FOLDER/sweepd.toml",
        code: 66,
        says: &["error: ", "sweepd.toml", "No such file"],
    },
];

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn what_it_cannot_start_without_is_named_with_the_cure() {
    for case in CASES {
        let mut world = World::new();
        std::fs::set_permissions(world.folder(), std::fs::Permissions::from_mode(0o755)).unwrap();
        world.configure(case.config.0, case.config.1);
        let folder = world.folder().display().to_string();
        world.start(case.unshare, &case.script.replace("$FOLDER", &folder));
        let status = world.end();
        let log = world.log();
        assert_eq!(status.code(), Some(case.code), "{}: {log}", case.name);
        let last = log.lines().last().unwrap_or_default();
        for text in case.says {
            assert!(
                last.contains(text),
                "{}: `{text}` is not in: {log}",
                case.name
            );
        }
        assert!(!log.contains("panicked"), "{}: {log}", case.name);
    }
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn a_port_that_is_taken_is_an_error_that_names_the_holder() {
    let mut world = World::new();
    world.configure("", "");
    let _holder = std::net::UdpSocket::bind(("127.0.0.1", world.port)).unwrap();
    world.start(&["-m"], "");
    assert_eq!(world.end().code(), Some(1));
    let text = format!("error: port {} is held by ", world.port);
    assert!(
        world.log().contains(&text) && world.log().contains("choose another port"),
        "{}",
        world.log()
    );
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn an_address_that_is_not_there_at_boot_is_waited_for() {
    let mut world = World::new();
    world.configure("bind = \"10.77.0.1\"\n", "");
    world.start(&["-m", "-n"], "ip link set lo up");
    world.until_it_says("no interface of this host has the address 10.77.0.1");
    world.until_health(503, "no interface of this host has the address 10.77.0.1");
    world.inside("ip address add 10.77.0.1/24 dev lo");
    world.until_it_says("listening on port 10.77.0.1:");
    world.until_health(503, "waiting");
    assert_eq!(world.says("it is waited for"), 1, "{}", world.log());
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0), "{}", world.log());
}

#[test]
#[cfg_attr(without_root, ignore = "not root, or no namespaces")]
fn it_ends_at_once_while_it_waits_for_an_interface() {
    let mut world = World::new();
    world.configure("bind = \"0.0.0.0\"\ninterface = \"lidar0\"\n", "");
    world.start(&["-m", "-n"], "ip link set lo up");
    world.until_it_says("cannot listen on interface lidar0");
    world.signal("-TERM");
    assert_eq!(world.end().code(), Some(0), "{}", world.log());
}
