//! The page in Chromium without a screen and without a graphics card, driven by the DevTools
//! protocol. Pictures of it are kept in `target/tmp/view`: look at them when the page changes.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use sweepd_testkit::{Daemon, PATIENCE, Process, ReservedPort, TempDomain, daemon::run_command};
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

use sweepd::sweep::SweepRef;

use crate::captures::{assert_same, fixture};
use crate::page::{View, aligned};

pub const SHOWN: &str = "window.sweepd?.frames > 0 && window.sweepd.points > 0";

/// What a test that fails tells of the page.
const STATE: &str = "(() => { const { index, tuned, points, selection, errors } = window.sweepd ?? {}; \
    const words = document.querySelector('#state').textContent; \
    return `${words}; ${index} ${tuned} ${points} ${selection?.label} ${selection?.row} ${errors}`; })()";

/// A tab of a browser of its own.
pub struct Tab {
    process: Process,
    _folder: TempDir,
    stream: WebSocketStream<TcpStream>,
    runtime: Runtime,
    session: Option<String>,
    calls: u64,
    /// What went wrong by the browser's console.
    errors: Vec<String>,
}

impl Tab {
    /// Opens an address.
    pub fn open(address: &str) -> Self {
        Self::open_with(address, &[])
    }

    /// The same in a browser with these arguments.
    fn open_with(address: &str, args: &[&str]) -> Self {
        let folder = TempDir::new().unwrap();
        let mut command = Command::new("chromium");
        command
            .args(["--headless", "--no-sandbox", "--no-first-run"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .args(["--window-size=1600,900", "--remote-debugging-port=0"])
            .args(["--disable-background-networking", "--disable-dev-shm-usage"])
            .args(args)
            .arg(format!("--user-data-dir={}", folder.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null());
        let process = Process::start(&mut command).unwrap();
        let (host, path) = devtools(folder.path());
        let mut tab = Self::connect(process, folder, &host, &path);
        let made = tab.call("Target.createTarget", json!({"url": "about:blank"}));
        let attached = tab.call(
            "Target.attachToTarget",
            json!({"targetId": made["targetId"], "flatten": true}),
        );
        tab.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            tab.call(domain, json!({}));
        }
        tab.call("Page.navigate", json!({"url": address}));
        tab.wait_for(SHOWN);
        tab
    }

    /// Takes hold of a browser with this folder, which is heard there.
    pub fn connect(process: Process, folder: TempDir, host: &str, path: &str) -> Self {
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let request = format!("ws://{host}{path}").into_client_request().unwrap();
        // A sweep as text has 20 MB.
        let any_size = WebSocketConfig::default()
            .max_message_size(None)
            .max_frame_size(None);
        let (stream, _) = runtime.block_on(async {
            let stream = TcpStream::connect(host).await.unwrap();
            client_async_with_config(request, stream, Some(any_size))
                .await
                .unwrap()
        });
        Self {
            process,
            _folder: folder,
            stream,
            runtime,
            session: None,
            calls: 0,
            errors: Vec::new(),
        }
    }

    /// Calls a method of the protocol.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.calls += 1;
        let mut request = json!({"id": self.calls, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        let Self {
            stream, runtime, ..
        } = self;
        runtime
            .block_on(stream.send(Message::text(request.to_string())))
            .unwrap();
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let Self {
                stream, runtime, ..
            } = self;
            let next = runtime.block_on(async { timeout(PATIENCE, stream.next()).await });
            let message = next.expect("an answer of the browser").unwrap().unwrap();
            let message: Value = serde_json::from_str(message.to_text().unwrap()).unwrap();
            if message["id"] == self.calls {
                assert!(message["error"].is_null(), "{method}: {message}");
                return message["result"].clone();
            }
            let is_error = message["method"] == "Runtime.exceptionThrown"
                || message["params"]["entry"]["level"] == "error"
                || message["params"]["type"] == "error"
                || message["params"]["level"] == "error";
            if is_error {
                self.errors.push(message["params"].to_string());
            }
        }
        panic!("{}", self.process.failure(format!("no answer to {method}")));
    }

    /// The value of an expression on the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let answer = self.call(
            "Runtime.evaluate",
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true}),
        );
        let failure = &answer["exceptionDetails"];
        assert!(failure.is_null(), "{expression}: {failure}");
        answer["result"]["value"].clone()
    }

    pub fn text(&mut self, expression: &str) -> String {
        let value = self.value(expression);
        let text = value.as_str();
        text.unwrap_or_else(|| panic!("{expression}: {value}"))
            .to_owned()
    }

    pub fn number(&mut self, expression: &str) -> u64 {
        let value = self.value(expression);
        let number = value.as_u64();
        number.unwrap_or_else(|| panic!("{expression}: {value}"))
    }

    /// Waits until an expression is true on the page.
    pub fn wait_for(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.value(&format!("Boolean({expression})")) != true {
            if begun.elapsed() > PATIENCE {
                self.picture("failed");
                let state = self.value(STATE);
                panic!("{expression} does not come true: {state} {:?}", self.errors);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Moves the pointer to a place of the page, in pixels.
    fn point(&mut self, place: &Value) {
        self.call(
            "Input.dispatchMouseEvent",
            json!({"type": "mouseMoved", "x": place[0], "y": place[1]}),
        );
    }

    /// Puts fingers down, moves them, and lifts them.
    fn touch(&mut self, steps: &[&[[u32; 2]]]) {
        for (step, places) in steps.iter().enumerate() {
            let points: Vec<Value> = places
                .iter()
                .enumerate()
                .map(|(id, [x, y])| json!({"x": x, "y": y, "id": id}))
                .collect();
            let kind = if step == 0 { "touchStart" } else { "touchMove" };
            self.call(
                "Input.dispatchTouchEvent",
                json!({"type": kind, "touchPoints": points}),
            );
        }
        self.call(
            "Input.dispatchTouchEvent",
            json!({"type": "touchEnd", "touchPoints": []}),
        );
    }

    /// What the browser saves goes into this folder.
    fn save_into(&mut self, folder: &Path) {
        let session = self.session.take();
        self.call(
            "Browser.setDownloadBehavior",
            json!({"behavior": "allow", "downloadPath": folder}),
        );
        self.session = session;
    }

    /// Presses a button that saves; returns the file.
    fn saved(&mut self, kind: &str, path: &Path) -> Vec<u8> {
        self.value(&format!(
            "document.querySelector('[data-save={kind}]').click()"
        ));
        let begun = Instant::now();
        // Chromium takes the name with an empty file, and renames the whole one to it.
        loop {
            match fs::read(path) {
                Ok(bytes) if !bytes.is_empty() => return bytes,
                _ => std::thread::sleep(Duration::from_millis(20)),
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "{} is not saved",
                path.display()
            );
        }
    }

    pub fn press(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.call(
                "Input.dispatchKeyEvent",
                json!({"type": kind, "key": key, "text": if kind == "keyDown" { key } else { "" }}),
            );
        }
    }

    /// Presses a key that has a name.
    pub fn press_named(&mut self, key: &str) {
        let (code, text) = match key {
            "Tab" => (9, ""),
            "Enter" => (13, "\r"),
            "Escape" => (27, ""),
            "ArrowLeft" => (37, ""),
            "ArrowUp" => (38, ""),
            "ArrowRight" => (39, ""),
            "ArrowDown" => (40, ""),
            _ => panic!("{key}"),
        };
        let down = if text.is_empty() {
            "rawKeyDown"
        } else {
            "keyDown"
        };
        for kind in [down, "keyUp"] {
            self.call(
                "Input.dispatchKeyEvent",
                json!({"type": kind, "key": key, "text": if kind == down { text } else { "" },
                       "windowsVirtualKeyCode": code}),
            );
        }
    }

    /// Makes the page as large, in pixels.
    pub fn resize(&mut self, width: u32, height: u32) {
        let frames = self.number("window.sweepd.frames");
        self.call(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width.min(height) < 700}),
        );
        self.wait_for(&format!(
            "innerWidth === {width} && innerHeight === {height} && window.sweepd.frames > {frames}"
        ));
    }

    /// Keeps a picture of the page.
    pub fn picture(&mut self, name: &str) {
        let taken = self.call("Page.captureScreenshot", json!({"format": "png"}));
        keep_picture(name, &taken);
    }

    /// Ends the browser, which must have had nothing to complain of.
    pub fn close(mut self) {
        let errors = self.value("window.sweepd.errors.join()");
        assert_eq!((errors.as_str(), &self.errors[..]), (Some(""), &[][..]));
        self.session = None;
        self.call("Browser.close", json!({}));
        self.process.wait(PATIENCE).unwrap();
    }
}

/// Where a browser is heard, which it writes into its folder.
fn devtools(folder: &Path) -> (String, String) {
    let begun = Instant::now();
    loop {
        let said = fs::read_to_string(folder.join("DevToolsActivePort")).unwrap_or_default();
        if let Some((port, path)) = said.split_once('\n')
            && !path.is_empty()
        {
            return (format!("127.0.0.1:{port}"), path.trim_end().to_owned());
        }
        // A browser that is new reads much of the disk.
        assert!(begun.elapsed() < 3 * PATIENCE, "Chromium does not start");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn target(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("view")
        .join(name)
}

/// Keeps a picture that a browser took.
pub fn keep_picture(name: &str, taken: &Value) {
    let folder = target("pictures");
    fs::create_dir_all(&folder).unwrap();
    let png = from_base64(taken["data"].as_str().unwrap());
    fs::write(folder.join(name).with_extension("png"), png).unwrap();
}

fn from_base64(text: &str) -> Vec<u8> {
    let (mut bytes, mut bits, mut have) = (Vec::new(), 0_u32, 0);
    for letter in text.bytes() {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => break,
        };
        bits = bits << 6 | u32::from(value);
        have += 6;
        if have >= 8 {
            have -= 8;
            bytes.push((bits >> have) as u8);
        }
    }
    bytes
}

fn sweepd(args: &[&str]) {
    let output = sweepd_testkit::sweepd(args).output().unwrap();
    assert!(output.status.success(), "{args:?}: {output:?}");
}

/// What `sweepd replay --csv` writes of the whole sweeps of a capture.
fn csvs(name: &str, options: &[&str]) -> BTreeSet<String> {
    let folder = target(&format!("csv_{name}"));
    let _ = fs::remove_dir_all(&folder);
    let path = fixture(name);
    let out = folder.to_str().unwrap();
    let replay = ["replay", &path, "--no-timing", "--csv", out];
    sweepd(&[&replay, options].concat());
    let files = fs::read_dir(&folder).unwrap();
    let texts = files.map(|file| fs::read_to_string(file.unwrap().path()).unwrap());
    texts.collect()
}

/// Points, times, labels and all else that a line has, of every return: read by the page's own
/// reader, and by Rust.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn the_page_reads_sweeps_as_rust_does() {
    fs::create_dir_all(target("")).unwrap();
    let calibration = |name: &str| {
        let file = target(name).with_extension("yaml");
        let file = file.to_str().unwrap().to_owned();
        let capture = fixture(&format!("{name}.pcap.gz"));
        sweepd(&["calib", "from-capture", &capture, "--force", "-o", &file]);
        file
    };
    let (s2, s3) = (
        calibration("street_hdl64e_s2"),
        calibration("street_hdl64e_s3"),
    );
    let cases: [(&str, &[&str]); 6] = [
        ("street_vlp16_dual.pcap.gz", &[]),
        ("street_vlp32c.pcap.gz", &[]),
        ("street_vls128_dual.pcap.gz", &[]),
        ("street_hdl32e.pcap.gz", &[]),
        ("street_hdl64e_s2.pcap.gz", &["--calibration", &s2]),
        ("street_hdl64e_s3_dual.pcap.gz", &["--calibration", &s3]),
    ];
    for (name, options) in cases {
        let written = csvs(name, options);
        let view = View::start(&[&[fixture(name).as_str()], options].concat());
        let mut tab = Tab::open(&format!("http://{}/#sweep=0", view.host));
        let mut read = BTreeSet::new();
        for index in 0..written.len() {
            tab.value(&format!("location.hash = '#sweep={}'", index + 1));
            tab.wait_for(&format!("window.sweepd.index === {index}"));
            read.insert(tab.text("window.sweepd.csv()"));
        }
        assert_eq!(read.len(), written.len(), "{name}");
        for (one, other) in read.iter().zip(&written) {
            let mut lines = one.lines().zip(other.lines());
            let different = lines.find(|(one, other)| one != other);
            assert_eq!(different, None, "{name}");
            assert_eq!(one.len(), other.len(), "{name}");
        }
        tab.close();
    }
}

/// The buttons that save give what `sweepd replay` writes of the same sweep, and its bytes.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn what_is_saved_is_what_replay_writes() {
    let folder = target("saved");
    let _ = fs::remove_dir_all(&folder);
    let (written, saved) = (folder.join("written"), folder.join("saved"));
    let capture = fixture("street_vlp16_dual.pcap.gz");
    let out = written.to_str().unwrap();
    sweepd(&[
        "replay",
        &capture,
        "--no-timing",
        "--csv",
        out,
        "--pcd",
        out,
    ]);
    let view = View::start(&[&capture]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1");
    // It has two returns.
    assert_eq!(
        tab.value("document.querySelector('#second').hidden"),
        Value::Bool(false)
    );
    tab.save_into(&saved);
    for kind in ["csv", "pcd"] {
        let name = format!("sweep_000002.{kind}");
        let (one, other) = (
            tab.saved(kind, &saved.join(&name)),
            fs::read(written.join(&name)),
        );
        assert!(one == other.unwrap(), "{name}");
    }
    let png = tab.saved("png", &saved.join("sweep_000002.png"));
    let reader = png::Decoder::new(std::io::Cursor::new(png))
        .read_info()
        .unwrap();
    assert!(reader.info().width > 500 && reader.info().height > 300);
    let bytes = tab.saved("sweep", &saved.join("sweep_000002.sweep"));
    assert_same(
        &SweepRef::open(aligned(&bytes).as_ref()).unwrap(),
        &view.page().seek(1).sweep(),
    );
    tab.close();
}

/// In the robot's frame the page has the points that `sweepd replay` has there; without a mount it
/// says so.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn the_robots_frame_is_that_of_replay() {
    let capture = fixture("street_hdl32e.pcap.gz");
    let mount = ["--pitch", "10", "--roll", "-20"];
    for (mount, is_known) in [(&mount[..], true), (&[], false)] {
        let out = target("robot_frame");
        let _ = fs::remove_dir_all(&out);
        let replay = [
            "replay",
            &capture,
            "--no-timing",
            "--frame",
            "robot",
            "--csv",
        ];
        sweepd(&[&replay[..], &[out.to_str().unwrap()], mount].concat());
        let written = fs::read_to_string(out.join("sweep_000001.csv")).unwrap();
        let view = View::start(&[&[capture.as_str()], mount].concat());
        let mut tab = Tab::open(&format!("http://{}/#sweep=1", view.host));
        tab.wait_for("window.sweepd.index === 0");
        let choose = "const choice = document.getElementById('frame'); choice.value = 'robot'; \
                      choice.dispatchEvent(new Event('change'));";
        tab.value(choose);
        let read = tab.text("window.sweepd.csv()");
        let mut lines = read.lines().zip(written.lines());
        assert_eq!(lines.find(|(one, other)| one != other), None);
        assert_eq!(read.len(), written.len());
        let is_said = tab.value("!document.getElementById('unmounted').hidden");
        assert_eq!(is_said, Value::Bool(!is_known));
        // The scene is in that frame too: boxes around what is drawn.
        let inside = "(() => { const { segments, points } = window.sweepd.page.cloud.last; let outside = 0; \
             for (let at = 0; at < points.count; at++) { const segment = segments[points.labels[at] - 2]; \
             if (segment && [0, 1, 2].some((axis) => points.position[3 * at + axis] < segment.min_m[axis] - 1e-3 || \
             points.position[3 * at + axis] > segment.max_m[axis] + 1e-3)) outside++; } \
             return segments.length > 10 ? outside : -1; })()";
        assert_eq!(tab.value(inside), Value::from(0));
        // A box has twelve lines of two ends; a wide segment has none, nor has a flat one.
        let boxed = "(() => { const { segments, outlines } = window.sweepd.page.cloud.last; \
             const high = segments.filter(({ min_m, max_m }) => max_m[2] - min_m[2] >= 0.2); \
             const boxed = high.filter(({ flags }) => (flags & 1) === 0); \
             return boxed.length < high.length && outlines.count === 24 * boxed.length; })()";
        assert_eq!(tab.value(boxed), Value::Bool(true));
        tab.close();
    }
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn without_webgl_all_but_the_3d_view_is_there() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    let address = format!("http://{}/#sweep=2", view.host);
    let mut tab = Tab::open_with(&address, &["--disable-3d-apis"]);
    tab.wait_for("window.sweepd.index === 1");
    tab.wait_for("document.querySelector('#error').textContent.includes('WebGL 2')");
    tab.wait_for("!document.querySelector('#error').hidden");
    tab.wait_for("document.querySelectorAll('#segments .row').length > 5");
    let csv = tab.text("window.sweepd.csv()");
    assert!(csv.lines().count() > 10_000);
    tab.picture("without_webgl");
    tab.close();
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn fingers_turn_and_zoom() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=0", view.host));
    tab.call(
        "Emulation.setTouchEmulationEnabled",
        json!({"enabled": true, "maxTouchPoints": 2}),
    );
    let of_camera = |tab: &mut Tab, what: &str| {
        let value = tab.value(&format!("window.sweepd.page.cloud.camera.{what}"));
        value.as_f64().unwrap()
    };
    let [yaw, distance] = ["yaw", "distance"].map(|what| of_camera(&mut tab, what));
    tab.touch(&[&[[300, 300]], &[[360, 300]]]);
    let turned = of_camera(&mut tab, "yaw");
    assert!((turned - yaw).abs() > 0.1, "{yaw} {turned}");
    assert_eq!(of_camera(&mut tab, "distance"), distance);
    // Fingers three times as far apart bring it three times as near.
    tab.touch(&[&[[300, 300], [400, 300]], &[[300, 300], [600, 300]]]);
    let near = of_camera(&mut tab, "distance");
    assert!((distance / near - 3.0).abs() < 0.1, "{distance} {near}");
    tab.close();
}

/// The place of the page that is here over an element.
pub fn over(element: &str, here: &str) -> String {
    format!(
        "(() => {{ const {{ left, top }} = document.querySelector('{element}').getBoundingClientRect(); \
         const [x, y] = {here}; return [left + x, top + y]; }})()"
    )
}

/// A return of a segment, as a sweep's CSV has it.
struct Pixel {
    row: u64,
    column: u64,
    range_m: f64,
}

/// The returns that have this label.
fn labelled(csv: &str, label: u64) -> Vec<Pixel> {
    let mut lines = csv.lines();
    let columns: Vec<&str> = lines.next().unwrap().split(',').collect();
    let wanted = ["label", "row", "column", "range_m"];
    let at = wanted.map(|name| columns.iter().position(|column| *column == name).unwrap());
    let mut pixels = Vec::new();
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let [of, row, column, range_m] = at.map(|at| fields[at]);
        if of == label.to_string() {
            pixels.push(Pixel {
                row: row.parse().unwrap(),
                column: column.parse().unwrap(),
                range_m: range_m.parse().unwrap(),
            });
        }
    }
    pixels
}

/// Points at what is here over an element: this label is marked, and before that nothing.
fn point_at(tab: &mut Tab, element: &str, here: &str, label: u64) {
    let place = tab.value(&over(element, here));
    tab.point(&json!([5, 5]));
    tab.wait_for("window.sweepd.selection === null");
    tab.point(&place);
    tab.wait_for(&format!(
        "window.sweepd.selection?.label === {label} && \
         document.querySelector('#segments .row.marked')?.dataset.label === '{label}'"
    ));
}

const LARGEST: &str = "window.sweepd.page.table.segments[0].label";
const FROM_ABOVE: &str = "document.querySelector('[data-view=above]').click()";

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn what_is_pointed_at_is_marked_everywhere() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1");
    tab.picture("street_hdl32e");
    let csv = tab.text("window.sweepd.csv()");
    let returns = csv.lines().count() as u64 - 1;
    assert_eq!(tab.number("window.sweepd.points"), returns);
    assert_eq!(tab.number("window.sweepd.returns"), returns);

    let label = tab.number(LARGEST);
    let pixels = labelled(&csv, label);
    let Pixel {
        row,
        column,
        range_m,
    } = pixels[pixels.len() / 2];
    for strip in 0..2 {
        let here = format!("window.sweepd.imagePlace({strip}, {row}, {column})");
        point_at(&mut tab, "#images", &here, label);
        let selection = tab.value("window.sweepd.selection");
        assert_eq!(selection["row"], row, "{selection}");
        assert_eq!(selection["column"], column, "{selection}");
        // The page writes tenths of a millimetre.
        let off = selection["range"].as_f64().unwrap() - range_m;
        assert!(off.abs() < 1e-3, "{selection}");
    }
    // In the view from above nothing hides it but what stands over it.
    tab.value(FROM_ABOVE);
    let here = format!("window.sweepd.scenePlace({row}, {column})");
    point_at(&mut tab, "#overlay", &here, label);
    let its_row = format!("#segments .row[data-label=\"{label}\"]");
    point_at(&mut tab, &its_row, "[30, 8]", label);
    tab.picture("pointed_at");
    tab.close();
}

/// The table has that colour, too. Something nearer may hide a point.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn what_is_drawn_has_the_colour_of_its_label() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1");
    tab.value(FROM_ABOVE);
    tab.value("for (const box of document.querySelectorAll('[data-option]')) if (box.checked) box.click()");
    let label = tab.number(LARGEST);
    let colour = tab.text(&format!(
        "getComputedStyle(document.querySelector(`#segments .row[data-label='{label}'] i`)).backgroundColor"
    ));
    let csv = tab.text("window.sweepd.csv()");
    let pixels = labelled(&csv, label);
    let looked = pixels.iter().step_by(pixels.len().div_ceil(40));
    let count = looked.len();
    let mut right = 0;
    for Pixel { row, column, .. } in looked {
        let seen = tab.text(&format!(
            "(() => {{ const [x, y] = window.sweepd.scenePlace({row}, {column}); \
             return `rgb(${{[...window.sweepd.scenePixel(x, y)].slice(0, 3).join(', ')}})`; }})()"
        ));
        right += usize::from(seen == colour);
    }
    assert!(4 * right > 3 * count, "{right} of {count} are {colour}");
    tab.close();
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn keys_and_the_time_line_do_what_they_say() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=0", view.host));
    tab.wait_for("window.sweepd.index === 0");
    tab.value("document.querySelector('#timeline [data-part=on]').click()");
    tab.wait_for("window.sweepd.index === 1");
    tab.press(".");
    tab.wait_for("window.sweepd.index === 2");
    // It stands still, so the address names the sweep.
    tab.wait_for("location.hash === '#sweep=3'");
    tab.press(",");
    tab.wait_for("window.sweepd.index === 1 && location.hash === '#sweep=2'");
    // It plays from there to the end, and begins again.
    tab.press(" ");
    tab.wait_for("window.sweepd.index === 3");
    tab.wait_for("window.sweepd.index === 0");
    tab.press(" ");
    tab.wait_for("document.querySelector('#state').textContent === 'paused'");
    tab.value("location.hash = '#sweep=2'");
    tab.wait_for("window.sweepd.index === 1 && !window.sweepd.tuned");
    tab.close();
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn sliders_do_what_they_say() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1 && !window.sweepd.tuned");
    let segments = "Number(document.querySelector('#count').textContent)";
    // The page writes words a moment later than it draws.
    tab.wait_for(&format!(
        "{segments} === window.sweepd.page.shown.segments.length"
    ));
    let before = tab.number(segments);
    tab.value("document.querySelector('[data-tab=tuning]').click()");
    tab.value(
        "(() => { const { slider } = window.sweepd.page.tuning.rows.get('min_points'); \
         slider.value = slider.min; slider.dispatchEvent(new Event('input')); })()",
    );
    tab.wait_for("window.sweepd.tuned");
    tab.wait_for(&format!(
        "{segments} > {before} && {segments} === window.sweepd.page.shown.segments.length"
    ));
    let after = tab.number(segments);
    tab.picture("tuned");
    // Before and after.
    tab.press("t");
    tab.wait_for(&format!("{segments} === {before}"));
    tab.press("t");
    tab.wait_for(&format!("{segments} === {after}"));
    // Side by side, each half has all points, and the pointer in the right one marks its segment.
    tab.value("document.querySelector('[data-compare=both]').click()");
    tab.wait_for("window.sweepd.points === 2 * window.sweepd.returns");
    tab.picture("side_by_side");
    let place = over(
        "#overlay",
        "(() => { const { cloud } = window.sweepd.page; const { left, width, height } = cloud.area(1); \
         const { position, count } = cloud.sides[1].points; \
         for (let at = 0; at < 3 * count; at += 3) { \
           const [x, y, depth] = cloud.place(position.subarray(at, at + 3)); \
           if (depth > 0 && x > 0.2 * width && x < 0.8 * width && y > 0.3 * height && y < 0.7 * height) \
             return [left + x, y]; \
         } })()",
    );
    let place = tab.value(&place);
    tab.point(&place);
    tab.wait_for("window.sweepd.page.pointed?.side === 1 && window.sweepd.selection !== null");
    tab.point(&json!([5, 5]));
    tab.value("document.querySelector('[data-compare=after]').click()");
    tab.value("document.querySelector('[data-part=copy]').click()");
    tab.wait_for(
        "document.querySelector('[data-part=configuration]').textContent.includes('min_points')",
    );
    let lines = tab.text("document.querySelector('[data-part=configuration]').textContent");
    assert!(lines.starts_with("[sensor.segment]"), "{lines}");
    tab.value("document.querySelector('[data-part=reset]').click()");
    tab.wait_for(&format!("!window.sweepd.tuned && {segments} === {before}"));
    tab.close();
}

/// Types a number for a setting.
fn set(tab: &mut Tab, key: &str, value: &str) {
    tab.value(&format!(
        "(() => {{ const {{ number }} = window.sweepd.page.tuning.rows.get('{key}'); \
         number.value = '{value}'; number.dispatchEvent(new Event('change')); }})()"
    ));
}

/// Theta is of the method `paper`: with the other it has no slider, and is not copied.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn a_setting_that_the_method_does_not_read_is_not_there() {
    let view = View::start(&[&fixture("street_vlp16.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=1", view.host));
    tab.value("document.querySelector('[data-tab=tuning]').click()");
    let is_there = "document.querySelector('[data-key=theta_deg]').checkVisibility()";
    assert_eq!(tab.value(is_there), false);
    for (method, there) in [("paper", true), ("slope", false)] {
        tab.value(&format!(
            "(() => {{ const {{ methods }} = window.sweepd.page.tuning; \
             methods.value = '{method}'; methods.dispatchEvent(new Event('change')); }})()"
        ));
        assert_eq!(tab.value(is_there), there);
        set(&mut tab, "theta_deg", "12");
        set(&mut tab, "min_points", "5");
        tab.value("document.querySelector('[data-part=copy]').click()");
        tab.wait_for("!document.querySelector('[data-part=configuration]').hidden");
        let lines = tab.text("document.querySelector('[data-part=configuration]').textContent");
        assert_eq!(lines.contains("theta_deg = 12"), there, "{lines}");
        assert!(lines.contains("min_points = 5"), "{lines}");
    }
    tab.close();
}

/// A change that is refused says so. The sweeps go on, as they were segmented before.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn a_refused_change_holds_up_no_sweep() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    for is_tuned in [false, true] {
        if is_tuned {
            set(&mut tab, "max_range_m", "40");
            tab.wait_for("window.sweepd.tuned");
        }
        set(&mut tab, "max_range_m", "0");
        tab.wait_for("!document.querySelector('[data-part=refused]').hidden");
        let index = tab.number("window.sweepd.index");
        tab.wait_for(&format!(
            "window.sweepd.index !== {index} && window.sweepd.tuned === {is_tuned}"
        ));
    }
    tab.close();
}

/// While it plays: all that is drawn is of one sweep, and "after" never has the labels of "before".
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn points_and_labels_are_of_one_moment() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    // Small segments are there after the tuning alone.
    tab.value(
        "window.seen = 0; window.wrong = []; \
         const { page } = window.sweepd; const row = page.tuning.rows.get('min_points'); \
         const least = (sweep) => Math.min(...sweep.segments.map((segment) => segment.points)); \
         const draw = page.cloud.draw.bind(page.cloud); \
         page.cloud.draw = () => { const isDrawn = draw(); if (isDrawn && window.watches) { \
           const { shown, sides } = page.cloud; const strips = page.images.strips; \
           const all = [...shown.map((side) => sides[side].sweep), ...strips.map((strip) => strip.sweep), page.shown]; \
           const numbers = new Set(all.map((sweep) => sweep.header.sequence)).add(window.sweepd.sequence); \
           const after = [...strips.filter((strip) => strip.side === 1).map((strip) => strip.sweep), page.shown]; \
           const isRight = new Set([...numbers].map(Number)).size === 1 && \
             after.every((sweep) => least(sweep) < row.setting.default) && \
             page.table.segments.length === page.shown.segments.length; \
           window.seen++; if (!isRight) window.wrong.push([...numbers, ...after.map(least)].join()); \
         } return isDrawn; }; \
         row.slider.value = row.slider.min; row.slider.dispatchEvent(new Event('input'));",
    );
    tab.wait_for("window.sweepd.tuned");
    for mode in ["after", "both"] {
        tab.value(&format!(
            "document.querySelector('[data-compare={mode}]').click(); window.watches = true; window.seen = 0"
        ));
        tab.wait_for("window.seen > 20");
        assert_eq!(tab.text("window.wrong.join(' ')"), "", "{mode}");
    }
    tab.close();
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn a_simulation_is_drawn_as_it_turns() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    // It has 100 sweeps, and a late browser draws only some of them.
    tab.wait_for("window.sweepd.sweeps > 2");
    let index = tab.number("window.sweepd.index");
    tab.wait_for(&format!("window.sweepd.index > {index}"));
    assert!(tab.number("window.sweepd.points") > 10_000);
    tab.picture("simulated_vlp16");
    tab.close();
}

/// A daemon, and what a sensor of this model sends to it, again and again.
pub struct Robot {
    _sensor: Process,
    _daemon: Daemon,
    _ports: [ReservedPort; 3],
    own: TempDomain,
}

impl Robot {
    pub fn start(model: &str, segment: &str) -> Self {
        let own = TempDomain::new("sweepd-").unwrap();
        let ports: [ReservedPort; 3] = std::array::from_fn(|_| ReservedPort::new().unwrap());
        let [http, data, position] = &ports;
        let config = own.path("sweepd.toml");
        let text = format!(
            "http = \"{}\"\nroot = \"{}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\n\
             bind = \"127.0.0.1\"\nport = {}\nposition_port = {}\nsegment = {{ {segment} }}\n",
            http.address(),
            own.root().display(),
            data.number(),
            position.number(),
        );
        fs::write(&config, text).unwrap();
        let program = sweepd_testkit::program();
        let daemon = Daemon::start(&mut run_command(&program, &config), http.address()).unwrap();
        let capture = own.path("sensor.pcap");
        let capture = capture.to_str().unwrap();
        sweepd(&[
            "simulate",
            "--model",
            model,
            "--seconds",
            "5",
            "--pcap",
            capture,
        ]);
        let mut sensor = Command::new(program);
        sensor
            .args([
                "replay",
                "--loop",
                "--to",
                &data.address().to_string(),
                capture,
            ])
            .stdout(Stdio::null());
        Self {
            _sensor: Process::start(&mut sensor).unwrap(),
            _daemon: daemon,
            _ports: ports,
            own,
        }
    }

    fn view(&self) -> View {
        self.view_with(&[])
    }

    pub fn view_with(&self, options: &[&str]) -> View {
        let args = ["roof", "--root", self.own.root().to_str().unwrap()];
        View::start(&[&args, options].concat())
    }
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn a_sensor_of_the_daemon_is_drawn_as_it_turns() {
    let robot = Robot::start("vlp16", "");
    let view = robot.view();
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    tab.wait_for("window.sweepd.sweeps > 20");
    let sequence = tab.number("Number(window.sweepd.sequence)");
    tab.wait_for(&format!("window.sweepd.sequence > {sequence} + 5"));
    // In one evaluation: the next sweep may come between two.
    assert_eq!(
        tab.value("window.sweepd.points === window.sweepd.returns"),
        true
    );
    tab.picture("sensor_vlp16");
    tab.close();
}

/// A line every tenth of the time: what was drawn and missed, and the memory of all processes.
#[test]
#[ignore = "a measurement: prints figures. SWEEPD_SECONDS says how long"]
fn measure_a_live_hdl64e() {
    let seconds = std::env::var("SWEEPD_SECONDS").map_or(60, |text| text.parse().unwrap());
    let robot = Robot::start("hdl64e-s2", "");
    let view = robot.view();
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    tab.wait_for("window.sweepd.sweeps > 20");
    for step in 0..=10 {
        let facts = tab.text(
            "(() => { const { sweeps, sequence, points, latency_ms, drawing_ms } = window.sweepd; \
             return `sequence ${sequence}, drawn ${sweeps}, ${points} points, latency ${latency_ms} ms, drawing ${drawing_ms} ms, \
             heap ${performance.memory.usedJSHeapSize >> 20} MB`; })()",
        );
        let server = resident_kb(view.process.child.id());
        let browser: u64 = descendants(tab.process.child.id()).map(resident_kb).sum();
        println!(
            "{:4} s: {facts}; server {server} kB, browser {browser} kB",
            step * seconds / 10
        );
        std::thread::sleep(Duration::from_secs(seconds / 10));
    }
    tab.close();
}

fn resident_kb(process: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.map_or(0, |line| {
        let number = line.split_whitespace().next().unwrap();
        number.parse().unwrap()
    })
}

/// A process and all that it started.
fn descendants(process: u32) -> impl Iterator<Item = u32> {
    let children = fs::read_dir(format!("/proc/{process}/task"))
        .into_iter()
        .flatten()
        .filter_map(|task| fs::read_to_string(task.ok()?.path().join("children")).ok())
        .flat_map(|ids| {
            ids.split_whitespace()
                .map(|id| id.parse().unwrap())
                .collect::<Vec<u32>>()
        });
    let below: Vec<u32> = children
        .flat_map(|child| descendants(child).collect::<Vec<u32>>())
        .collect();
    std::iter::once(process).chain(below)
}
