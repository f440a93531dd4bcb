//! What systemd/ ships: units and drop-ins that systemd itself takes without a word, and values
//! that fit the program.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use tempfile::TempDir;

use sweepd::daemon::config::Config;
use sweepd::input::udp::ample_buffer_bytes;

/// The exposure that `systemd-analyze security` may give the unit, of 10. What is left is what the
/// daemon needs: the network, the host's /dev/shm, real-time priorities.
const EXPOSURE: f64 = 2.0;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("systemd")
        .join(name)
}

fn text(name: &str) -> String {
    std::fs::read_to_string(shipped(name)).unwrap()
}

/// A program of systemd's.
fn tool(name: &str) -> Command {
    let mut command = Command::new(name);
    command
        .env("SYSTEMD_COLORS", "0")
        .env("SYSTEMD_PAGER", "")
        .stdin(Stdio::null());
    command
}

/// The units, and the programs that they run.
const UNITS: [(&str, &str); 2] = [
    ("sweepd.service", "sweepd"),
    ("sweepd-ros2.service", "sweepd-ros2"),
];

/// A unit with these lines more, its program being the one that was built: the other is not
/// installed here. Beside it are the units that it names.
fn unit(folder: &TempDir, name: &str, more: &str) -> PathBuf {
    for (file, program) in UNITS {
        let built = Path::new(env!("CARGO_BIN_EXE_sweepd")).with_file_name(program);
        let installed = format!("ExecStart=/usr/bin/{program} ");
        let text = text(file);
        assert_eq!(text.matches(&installed).count(), 1);
        let text = text.replace(&installed, &format!("ExecStart={} ", built.display()));
        let more = if file == name { more } else { "" };
        let text = text.replace("[Install]", &format!("{more}\n[Install]"));
        std::fs::write(folder.path().join(file), text).unwrap();
    }
    folder.path().join(name)
}

/// All that the program says; its exit status is 0 even when it ignores a line.
fn said(command: &mut Command, arguments: &[&OsStr]) -> (bool, String) {
    let output = command.args(arguments).output().unwrap();
    let text =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (output.status.success(), text.concat())
}

#[test]
#[cfg_attr(without_systemd, ignore = "no systemd")]
fn the_unit_is_taken_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    for (name, _) in UNITS {
        let verify = |more: &str| {
            let path = unit(&folder, name, more);
            said(
                &mut tool("systemd-analyze"),
                &["verify".as_ref(), "--man=no".as_ref(), path.as_os_str()],
            )
        };
        let found = verify("");
        assert_eq!(found, (true, String::new()), "{name}");
        // Notice of what is wrong is given: else the silence would mean nothing.
        let (_, complaint) = verify("Nonsense=yes");
        assert!(complaint.contains("Nonsense"), "{name}: {complaint:?}");
    }
}

#[test]
#[cfg_attr(without_systemd, ignore = "no systemd")]
fn the_unit_exposes_no_more_than_it_must() {
    let folder = tempfile::tempdir().unwrap();
    for (name, _) in UNITS {
        let path = unit(&folder, name, "");
        let (_, table) = said(
            &mut tool("systemd-analyze"),
            &[
                "security".as_ref(),
                "--offline=true".as_ref(),
                path.as_os_str(),
            ],
        );
        let overall = table
            .lines()
            .find(|line| line.contains("Overall exposure level"))
            .expect(&table);
        let exposure = overall
            .split_whitespace()
            .find_map(|word| word.parse::<f64>().ok())
            .expect(overall);
        assert!(exposure <= EXPOSURE, "{name}: {table}");
    }
}

/// What iceoryx2.md found to fail silently, and what the daemon says and needs.
#[test]
fn the_unit_leaves_shared_memory_alone() {
    let daemon = text("sweepd.service");
    let bridge = text("sweepd-ros2.service");
    for line in [
        "Type=notify",
        "NotifyAccess=main",
        "User=sweepd",
        "RemoveIPC=no",
        "PrivateTmp=no",
        "RuntimeDirectory=sweepd",
        "RuntimeDirectoryPreserve=yes",
        "ExecReload=sh -c 'kill -HUP $MAINPID'",
        "RestartPreventExitStatus=66 78",
    ] {
        assert!(daemon.lines().any(|own| own == line), "{line}");
    }
    for line in [
        "Wants=sweepd.service",
        "User=sweepd",
        "RemoveIPC=no",
        "PrivateTmp=no",
        "ReadWritePaths=-/run/sweepd",
        "RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK",
        "RestartPreventExitStatus=66 78",
    ] {
        assert!(bridge.lines().any(|own| own == line), "{line}");
    }
    for setting in [
        "DynamicUser=yes",
        "PrivateIPC=yes",
        "PrivateUsers=yes",
        "TemporaryFileSystem=",
    ] {
        let mut lines = daemon.lines().chain(bridge.lines());
        assert!(!lines.any(|line| line.starts_with(setting)), "{setting}");
    }
    assert!(!daemon.contains("RestrictRealtime=yes"));
}

#[test]
fn the_sysctl_allows_the_buffer_that_is_asked_for() {
    let text = text("sysctl.d/60-sweepd.conf");
    let settings: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let [setting] = settings[..] else {
        panic!("{settings:?}")
    };
    let bytes: usize = setting
        .strip_prefix("net.core.rmem_max = ")
        .unwrap()
        .parse()
        .unwrap();
    // The kernel gives twice what a program asks for, up to twice this.
    assert!(
        2 * bytes >= ample_buffer_bytes(),
        "{bytes} {}",
        ample_buffer_bytes()
    );
}

#[test]
#[cfg_attr(without_systemd, ignore = "no systemd")]
fn the_user_of_the_unit_is_made() {
    let mut sysusers = tool("systemd-sysusers");
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("etc")).unwrap();
    let root = format!("--root={}", folder.path().display());
    let file = shipped("sysusers.d/sweepd.conf");
    let (done, plan) = said(
        &mut sysusers,
        &["--dry-run".as_ref(), root.as_ref(), file.as_os_str()],
    );
    assert!(
        done && plan.contains("Creating user 'sweepd'") && plan.contains("Creating group 'sweepd'"),
        "{plan}"
    );
}

#[test]
fn the_example_is_the_one_that_the_program_prints_and_passes_its_check() {
    let sweepd =
        |arguments: &[&OsStr]| said(&mut Command::new(env!("CARGO_BIN_EXE_sweepd")), arguments);
    let (done, printed) = sweepd(&["config".as_ref(), "example".as_ref()]);
    assert!(done);
    assert_eq!(printed, text("sweepd.toml"));
    let path = shipped("sweepd.toml");
    let (done, told) = sweepd(&["config".as_ref(), "check".as_ref(), path.as_os_str()]);
    assert!(done, "{told}");
    assert_eq!(Config::read(&path).unwrap().sensors.len(), 1);
}

/// Read by iceoryx2 itself: it shows foreign tools the root and prefix of the unit's daemon.
#[test]
fn foreign_tools_find_the_daemon() {
    use iceoryx2::prelude::SemanticString;
    let path = shipped("iceoryx2.toml");
    let path = iceoryx2::prelude::FilePath::new(path.to_str().unwrap().as_bytes()).unwrap();
    let config = iceoryx2::config::Config::from_file(&path).unwrap();
    assert_eq!(config.global.root_path().as_bytes(), b"/run/sweepd/iox2");
    assert_eq!(config.global.prefix.as_bytes(), b"sweepd_");
}

/// The words of docs/install.md that name a file of the project.
#[test]
fn what_the_instructions_name_is_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let install = std::fs::read_to_string(root.join("docs/install.md")).unwrap();
    let named: Vec<&str> = install
        .split_whitespace()
        .filter(|word| word.starts_with("systemd/"))
        .collect();
    assert!(named.len() > 5, "{named:?}");
    for name in named {
        assert!(root.join(name).exists(), "{name}");
    }
}

/// The lines of docs/install.md that put files into /usr and give /run/sweepd to the robot's user,
/// in a folder instead of `/`.
#[test]
#[cfg_attr(without_systemd, ignore = "no systemd")]
fn an_upgrade_keeps_what_the_administrator_changed() {
    let mut tmpfiles = tool("systemd-tmpfiles");
    let folder = tempfile::tempdir().unwrap();
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let instructions = std::fs::read_to_string(project.join("docs/install.md")).unwrap();
    let in_folder = |line: &str| {
        let root = folder.path().display();
        let line = line
            .replace(" /usr/", &format!(" {root}/usr/"))
            .replace(" /etc/", &format!(" {root}/etc/"));
        let script = format!("set -e; sudo() {{ \"$@\"; }}; {line}");
        let done = Command::new("sh")
            .args(["-c", &script])
            .current_dir(project)
            .stdout(Stdio::null())
            .status();
        assert!(done.unwrap().success(), "{line}");
    };
    let commands = || {
        instructions
            .lines()
            .filter_map(|line| line.strip_prefix("    "))
    };
    let install = || {
        let copies: Vec<&str> = commands()
            .filter(|line| line.starts_with("sudo install -D -m 644 -t /usr/lib"))
            .collect();
        assert_eq!(copies.len(), 2, "{copies:?}");
        copies.into_iter().for_each(in_folder);
    };
    install();
    std::fs::create_dir_all(folder.path().join("etc/tmpfiles.d")).unwrap();
    in_folder(
        commands()
            .find(|line| line.starts_with("sed ") && line.contains("tmpfiles.d"))
            .unwrap(),
    );
    install();
    let root = format!("--root={}", folder.path().display());
    let (done, taken) = said(
        &mut tmpfiles,
        &[
            "--cat-config".as_ref(),
            root.as_ref(),
            "sweepd.conf".as_ref(),
        ],
    );
    assert!(
        done && taken.contains("d /run/sweepd 0750 robot robot -")
            && !taken.contains("sweepd sweepd"),
        "{taken}"
    );
}
