//! The page in Firefox, driven by WebDriver BiDi, on a display in memory: without one it has no WebGL.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd_testkit::{PATIENCE, Process};
use tempfile::TempDir;

use crate::browser::{SHOWN, Tab, keep_picture, over};
use crate::captures::fixture;
use crate::page::View;

/// A window of Firefox, and the display on which it is.
struct Window {
    tab: Tab,
    context: Value,
    _display: Process,
}

impl Window {
    fn open(address: &str) -> Self {
        let mut command = Command::new("Xvfb");
        command
            .args([
                "-displayfd",
                "1",
                "-screen",
                "0",
                "1280x900x24",
                "-nolisten",
                "tcp",
            ])
            .stdout(Stdio::piped());
        let mut display = Process::start(&mut command).unwrap();
        let mut number = String::new();
        let stdout = display.child.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut number).unwrap();
        let folder = TempDir::new().unwrap();
        let preferences = "user_pref(\"webgl.force-enabled\", true);\nuser_pref(\"webgl.forbid-software\", false);\n";
        fs::write(folder.path().join("user.js"), preferences).unwrap();
        let mut command = Command::new("firefox-esr");
        command
            .args(["--no-remote", "--remote-debugging-port=0", "--profile"])
            .arg(folder.path())
            .arg("about:blank")
            .env("HOME", folder.path())
            .env("DISPLAY", format!(":{}", number.trim()))
            .stdout(Stdio::null());
        let process = Process::start(&mut command).unwrap();
        let said = folder.path().join("WebDriverBiDiServer.json");
        let begun = Instant::now();
        let port = loop {
            let said = fs::read_to_string(&said).unwrap_or_default();
            if let Ok(said) = serde_json::from_str::<Value>(&said) {
                break said["ws_port"].clone();
            }
            assert!(begun.elapsed() < 3 * PATIENCE, "Firefox does not start");
            std::thread::sleep(Duration::from_millis(20));
        };
        let mut tab = Tab::connect(process, folder, &format!("127.0.0.1:{port}"), "/session");
        tab.call("session.new", json!({"capabilities": {}}));
        tab.call("session.subscribe", json!({"events": ["log.entryAdded"]}));
        let tree = tab.call("browsingContext.getTree", json!({}));
        let context = tree["contexts"][0]["context"].clone();
        let mut window = Self {
            tab,
            context,
            _display: display,
        };
        window.ask(
            "browsingContext.navigate",
            json!({"url": address, "wait": "complete"}),
        );
        window.wait_for(SHOWN);
        window
    }

    /// Calls a method of the protocol in this window.
    fn ask(&mut self, method: &str, mut parameters: Value) -> Value {
        parameters["context"] = self.context.clone();
        self.tab.call(method, parameters)
    }

    /// The value of an expression on the page.
    fn value(&mut self, expression: &str) -> Value {
        let target = json!({"context": self.context});
        let json =
            format!("Promise.resolve({expression}).then((value) => JSON.stringify(value ?? null))");
        let answer = self.tab.call(
            "script.evaluate",
            json!({"expression": json, "target": target, "awaitPromise": true}),
        );
        let text = answer["result"]["value"].as_str();
        let text = text.unwrap_or_else(|| panic!("{expression}: {answer}"));
        serde_json::from_str(text).unwrap()
    }

    fn wait_for(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.value(&format!("Boolean({expression})")) != true {
            let errors = self.value("window.sweepd?.errors");
            assert!(begun.elapsed() < PATIENCE, "{expression}: {errors}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn act(&mut self, device: &str, actions: Value) {
        let source = json!({"type": device, "id": device, "actions": actions});
        self.ask("input.performActions", json!({ "actions": [source] }));
    }
}

/// It draws every return, and answers to a key, to the pointer, and to a slider.
#[test]
#[cfg_attr(without_firefox, ignore = "no firefox-esr or Xvfb")]
fn the_page_loads_draws_and_answers() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut window = Window::open(&format!("http://{}/#sweep=2", view.host));
    window.wait_for("window.sweepd.index === 1");
    assert_eq!(
        window.value("window.sweepd.points === window.sweepd.returns"),
        true
    );
    let taken = window.ask("browsingContext.captureScreenshot", json!({}));
    keep_picture("firefox", &taken);
    // From above, where returns are, the view is not empty.
    let drawn = window.value(
        "(() => { const { page, scenePlace, scenePixel } = window.sweepd; page.cloud.look('above'); \
         const { range, rows } = page.shown; let [looked, drawn] = [0, 0]; \
         for (let pixel = 0; pixel < range.length; pixel += 997) { \
           if (!(range[pixel] > 0)) continue; \
           const [x, y] = scenePlace(pixel % rows, Math.floor(pixel / rows)); \
           const { width, height } = page.cloud.area(0); \
           if (x < 1 || y < 1 || x > width - 1 || y > height - 1) continue; \
           looked++; drawn += scenePixel(x, y).join() !== '6,7,10'; \
         } return looked > 20 ? drawn / looked : 0; })()",
    );
    assert!(drawn.as_f64().unwrap() > 0.95, "{drawn}");
    window.act(
        "key",
        json!([{"type": "keyDown", "value": "."}, {"type": "keyUp", "value": "."}]),
    );
    window.wait_for("window.sweepd.index === 2");
    let segment = "window.sweepd.page.shown.segments.reduce((one, other) => (other.points > one.points ? other : one))";
    let middle = format!(
        "(() => {{ const sweep = window.sweepd.page.shown; const {{ label }} = {segment}; \
         const pixel = sweep.label.indexOf(label); \
         return window.sweepd.imagePlace(1, pixel % sweep.rows, Math.floor(pixel / sweep.rows)); }})()"
    );
    let place = window.value(&over("#images", &middle));
    let [x, y] = [0, 1].map(|axis| place[axis].as_f64().unwrap().round());
    window.act("pointer", json!([{"type": "pointerMove", "x": x, "y": y}]));
    window.wait_for(
        "window.sweepd.selection !== null && document.querySelector('#segments .row.marked')",
    );
    window.value(
        "(() => { const { slider } = window.sweepd.page.tuning.rows.get('min_points'); \
         slider.value = slider.min; slider.dispatchEvent(new Event('input')); })()",
    );
    window.wait_for("window.sweepd.tuned");
    assert_eq!(window.value("window.sweepd.errors"), json!([]));
    window.tab.call("browser.close", json!({}));
}
