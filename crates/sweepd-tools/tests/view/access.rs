//! The page in windows of five sizes, for fingers, keys alone, and who asks for less motion.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::browser::Tab;
use crate::captures::fixture;
use crate::page::View;

const SIZES: [(u32, u32); 5] = [
    (1920, 1080),
    (1280, 800),
    (768, 1024),
    (390, 844),
    (844, 390),
];

/// What can be clicked, typed into or turned, and is shown.
const CONTROLS: &str = "const controls = [...document.querySelectorAll('button, select, input, [tabindex=\"0\"]')] \
     .filter((one) => one.checkVisibility() && !one.disabled && one.tabIndex >= 0); \
     const nameOf = (one) => one.id || one.getAttribute('aria-label') || one.parentElement.textContent.trim();";

/// The names of controls that cannot be scrolled to, are cut off, or are below others.
const OUT_OF_REACH: &str = "controls.filter((one) => { one.scrollIntoView({ block: 'center' }); \
     const { left, right, top, bottom } = one.getBoundingClientRect(); \
     const found = document.elementFromPoint((left + right) / 2, (top + bottom) / 2); \
     return left < 0 || right > innerWidth || !(one.contains(found) || found?.contains(one)); }).map(nameOf).join()";

/// Cells of the table whose text is wider than they are.
const CUT_CELLS: &str = "[...document.querySelectorAll('#segments .row:not([hidden]) > span, #segments .head button')] \
     .filter((cell) => cell.scrollWidth > cell.clientWidth).map((cell) => cell.textContent).join()";

/// The part of the points that is in sight, and how much of the view's shorter side they span.
const IN_SIGHT: &str = "(() => { const { cloud } = window.sweepd.page; const { position, count } = cloud.last.points; \
     const { width, height } = cloud.area(0); const all = []; \
     for (let at = 0; at < 3 * count; at += 30) { \
       const [x, y, depth] = cloud.place(position.subarray(at, at + 3)); \
       if (depth > 0 && x >= 0 && x <= width && y >= 0 && y <= height) all.push([x, y]); } \
     const span = [0, 1].map((axis) => Math.max(...all.map((one) => one[axis])) - Math.min(...all.map((one) => one[axis]))); \
     return [all.length / Math.floor(count / 10), Math.max(...span) / Math.min(width, height), height]; })()";

fn run(tab: &mut Tab, lines: &str) -> String {
    tab.text(&format!("(() => {{ {CONTROLS} return {lines}; }})()"))
}

fn axe() -> String {
    let modules = std::env::var_os("SWEEPD_NODE_MODULES").expect("SWEEPD_NODE_MODULES");
    fs::read_to_string(PathBuf::from(modules).join("axe-core/axe.min.js")).unwrap()
}

/// What is wrong with the page by axe-core, or has a contrast that it cannot tell, unless that is
/// because it is yet to be scrolled to.
const AXE: &str = "axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'] }) \
     .then(({ passes, violations, incomplete }) => JSON.stringify([passes.length > 10, \
       ...violations.map(({ id, nodes }) => [id, ...nodes.map(({ html }) => html)]), \
       ...incomplete.filter(({ id }) => id === 'color-contrast').flatMap(({ nodes }) => nodes) \
         .filter(({ any }) => !/bgOverlap|Obscur|outside/.test(any[0].data?.messageKey)).map(({ html }) => html)]))";

/// A room is as large as the view, every control is in reach, no text is cut; and axe-core has
/// nothing to say. The pictures are `room_WIDTHxHEIGHT.png`: look at them.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
#[cfg_attr(without_foxglove, ignore = "no SWEEPD_NODE_MODULES")]
fn windows_of_five_sizes_have_all_in_reach() {
    let view = View::start(&["--simulate", "vlp16", "--scene", "room"]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1");
    tab.value(&axe());
    let hidden = "['second', 'none'].every((id) => document.getElementById(id).hidden)";
    assert_eq!(tab.value(hidden), true, "one return, and a sweep is there");
    for (width, height) in SIZES {
        let size = format!("{width}x{height}");
        tab.resize(width, height);
        for name in ["above", "behind", "orbit"] {
            tab.value(&format!(
                "document.querySelector('[data-view={name}]').click()"
            ));
            let sight = tab.value(IN_SIGHT);
            let [part, span, high] = [0, 1, 2].map(|at| sight[at].as_f64().unwrap());
            assert!(
                part > 0.93 && span > 0.85 && high > 190.0,
                "{size} {name}: {sight}"
            );
        }
        tab.value("for (const one of [document.documentElement, ...document.querySelectorAll('main, aside')]) one.scrollTop = 0");
        tab.picture(&format!("room_{size}"));
        for panel in ["tuning", "sweep", "segments"] {
            tab.value(&format!(
                "document.querySelector('[data-tab={panel}]').click()"
            ));
            assert_eq!(run(&mut tab, OUT_OF_REACH), "", "{size} {panel}");
            assert_eq!(tab.text(AXE), "[true]", "{size} {panel}");
        }
        assert_eq!(tab.text(CUT_CELLS), "", "{size}");
        let fits = "document.documentElement.scrollWidth <= innerWidth && document.body.scrollWidth <= innerWidth";
        assert_eq!(tab.value(fits), true, "{size}");
    }
    tab.value("document.querySelector('#help-open').click()");
    assert_eq!(tab.text(AXE), "[true]", "help");
    tab.close();
}

fn focus(tab: &mut Tab, what: &str) {
    tab.value(&format!("document.querySelector('{what}').focus()"));
}

/// Each control gets the focus, and shows it; what the pointer does in the images and the table, keys
/// do.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn keys_alone_suffice() {
    let view = View::start(&[&fixture("street_hdl32e.pcap.gz")]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=2", view.host));
    tab.wait_for("window.sweepd.index === 1");
    let count: usize = run(&mut tab, "String(controls.length)").parse().unwrap();
    tab.value("window.reached = new Set()");
    for _ in 0..count {
        tab.press_named("Tab");
        let is_seen = tab.value(
            "(() => { const one = document.activeElement; window.reached.add(one); \
             return one.matches(':focus-visible') && getComputedStyle(one).outlineStyle === 'solid'; })()",
        );
        assert_eq!(is_seen, true);
    }
    let missed = "controls.filter((one) => !window.reached.has(one)).map(nameOf).join()";
    assert_eq!(run(&mut tab, missed), "");

    // A row of the table is pointed at, held, and let go.
    focus(&mut tab, "#segments .rows");
    tab.press_named("ArrowDown");
    tab.press_named("ArrowDown");
    tab.wait_for("window.sweepd.selection?.label === window.sweepd.page.table.segments[1].label");
    tab.press_named("Enter");
    focus(&mut tab, "#images");
    tab.wait_for("window.sweepd.selection?.pinned");
    tab.press_named("Escape");
    tab.wait_for("window.sweepd.selection === null");
    // A pixel.
    tab.press_named("ArrowRight");
    tab.press_named("ArrowUp");
    let at = "const { rows, count } = window.sweepd.page.shown;";
    let there = format!(
        "(() => {{ {at} const {{ row, column }} = window.sweepd.selection ?? {{}}; \
         return row === (rows >> 1) - 1 && column === (count >> 1) + 1; }})()"
    );
    tab.wait_for(&there);
    tab.press("+");
    tab.wait_for("window.sweepd.page.images.window.width < 1");
    // The tabs, the time line, a view, and help, which Escape closes.
    focus(&mut tab, "[data-tab=segments]");
    tab.press_named("ArrowRight");
    tab.wait_for("!document.querySelector('#tuning').hidden && document.activeElement.dataset.tab === 'tuning'");
    focus(&mut tab, "#timeline canvas");
    tab.press_named("ArrowRight");
    tab.wait_for("window.sweepd.index === 2 && !document.querySelector('.tip').hidden");
    focus(&mut tab, "[data-view=above]");
    tab.press_named("Enter");
    tab.wait_for("window.sweepd.page.cloud.camera.view === 'above'");
    tab.press("?");
    tab.wait_for("document.querySelector('dialog').open");
    tab.press_named("Escape");
    tab.wait_for("!document.querySelector('dialog').open");
    tab.close();
}

#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn who_asks_for_less_motion_gets_a_picture_a_second() {
    let view = View::start(&["--simulate", "vlp16"]);
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    // The next picture would come long after this test has failed.
    tab.value("window.sweepd.page.calmMs = 1e9");
    let features = json!([{"name": "prefers-reduced-motion", "value": "reduce"}]);
    tab.call(
        "Emulation.setEmulatedMedia",
        json!({ "features": features }),
    );
    tab.wait_for("window.sweepd.page.later !== null");
    // What it stands at, and a step from there, are shown at once.
    tab.press(" ");
    tab.wait_for("document.querySelector('#state').textContent === 'paused'");
    let index = view.page().sweep().index();
    tab.wait_for(&format!("window.sweepd.index === {index}"));
    let (key, next) = if index > 0 {
        (",", index - 1)
    } else {
        (".", 1)
    };
    tab.press(key);
    tab.wait_for(&format!("window.sweepd.index === {next}"));
    tab.value("window.sweepd.page.calmMs = 1000");
    tab.press(" ");
    let (begun, before) = (Instant::now(), tab.number("window.sweepd.sweeps"));
    std::thread::sleep(Duration::from_millis(3500));
    tab.wait_for(&format!("window.sweepd.sweeps > {before}"));
    let drawn = tab.number("window.sweepd.sweeps") - before;
    // One a second.
    let most = begun.elapsed().as_secs() + 2;
    assert!(drawn <= most, "{drawn}, not {most}");
    assert_eq!(tab.value("window.sweepd.errors.length"), Value::from(0));
    tab.close();
}
