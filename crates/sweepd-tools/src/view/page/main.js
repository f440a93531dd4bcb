// The page of `sweepd view`: the socket, and one selection for all views.
//
// What the page needs of a browser: ES modules, WebGL 2, Canvas 2D, WebSocket with ArrayBuffers, DataView with
// BigInt64, typed arrays, Pointer Events, ResizeObserver, replaceChildren, dialog, inert, CSS grid and inset; the clipboard
// where it is allowed. Chromium 102, Firefox 112 and Safari 15.5 have them all.
//
// Tests read the page's state as `window.sweepd`.

import { CloudView, COLOURS } from "./cloud.js";
import { Facts, model, utc } from "./facts.js";
import { ImageView } from "./image.js";
import * as palette from "./palette.js";
import { Plots } from "./plots.js";
import * as save from "./save.js";
import { Sweep } from "./sweep.js";
import { Table } from "./table.js";
import { Timeline } from "./timeline.js";
import { Tuning } from "./tuning.js";

/** How long is waited before a connection is tried again, milliseconds. */
const AGAIN_MS = 1000;
/** Interval of the facts and the plots: faster, no eye can read them. */
const WORDS_MS = 400;

/** Who asks for less motion gets a picture in this time while it plays, milliseconds. */
const CALM_MS = 1000;

const find = (id) => document.getElementById(id);
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

class Page {
  constructor() {
    this.source = null;
    this.state = { playing: false, speed: 1, words: "connecting", ok: true, facts: {} };
    /** The sweep that is shown, as it is and tuned, and what the server said of it. */
    this.sweeps = [null, null];
    this.notice = null;
    /** The number of the sensor that is shown. */
    this.sensor = null;
    /** The newest sweep as it is, which may wait for its tuned copy. */
    this.newest = null;
    /** The sweep of the side that is looked at, and what the server said of one that is not drawn yet. */
    this.shown = null;
    this.waiting = null;
    /** The timer that will ask for the next sweep, null where none runs; tests make its time longer. */
    this.later = null;
    this.calmMs = CALM_MS;
    this.head = null;
    this.selection = null;
    /** What the pointer is over, or what was clicked: a pixel or a label, and by which view. */
    this.pointed = null;
    this.pinned = null;
    this.wordsAt = 0;
    this.wordsDue = false;
    this.first = "range";
    this.drawn = [];
    this.status = {
      frames: 0, sweeps: 0, points: 0, returns: 0, index: null, sequence: null, tuned: false, connected: false, errors: [],
      latency_ms: null, drawing_ms: null,
    };
    this.cloud = new CloudView(find("cloud"), find("overlay"), (event, hit) => this.point("cloud", event, hit));
    this.images = new ImageView(find("images"), (event, hit) => this.point("image", event, hit));
    this.table = new Table(find("segments"), (event, label) => this.point("table", event, label === null ? null : { label }));
    if (this.cloud.failure !== null) tell(this.cloud.failure);
    this.plots = new Plots(find("plots"));
    this.facts = new Facts(find("facts"), find("selection"));
    const send = (what) => this.send(what);
    this.timeline = new Timeline(find("timeline"), send);
    this.tuning = new Tuning(find("tuning"), send, () => this.compare());
    this.controls();
    this.connect();
    const frame = () => {
      this.frame();
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  // ---- The socket

  connect() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.addEventListener("open", () => {
      this.status.connected = true;
      this.head = null;
      this.tuning.again();
      this.follow();
    });
    socket.addEventListener("message", ({ data }) => {
      try {
        if (typeof data === "string") this.message(JSON.parse(data));
        else this.receive(data);
      } catch (error) {
        this.fail(error);
        this.next();
      }
    });
    socket.addEventListener("close", () => {
      this.status.connected = false;
      this.say({ words: "no connection to sweepd view; trying again", ok: false });
      setTimeout(() => this.connect(), AGAIN_MS);
    });
  }

  send(what) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(what));
  }

  /** Asks for the next sweep. */
  next() {
    clearTimeout(this.later);
    this.later = null;
    this.send({ do: "drawn" });
  }

  message(message) {
    if (message.type === "source") this.takeSource(message);
    else if (message.type === "state") this.say(message);
    else if (message.type === "sweep") this.head = { ...message, received: performance.now() };
    else if (message.type === "empty") this.clear();
    else if (message.type === "refused" && message.of === "tuning") this.refuse(message.text);
    else if (message.type === "refused") tell(`not done: ${message.text}`);
    else if (message.type === "configuration") this.tuning.configuration(message.text);
  }

  takeSource(source) {
    this.source = source;
    const name = (source.name ?? "").split("/").pop();
    find("source").textContent = name;
    find("source").title = source.name ?? "";
    find("kind").textContent = { capture: "capture", simulation: "simulation", sensor: "live sensor", choice: "" }[source.kind] ?? "";
    document.title = name ? `${name} · sweepd` : "sweepd";
    this.timeline.source(source);
    this.tuning.source(source);
    const sensors = source.sensors ?? [];
    const choice = find("sensor");
    choice.hidden = sensors.length < 2 || source.kind === "choice";
    if ([...choice.options].map((option) => option.value).join() !== sensors.join()) {
      choice.replaceChildren(...sensors.map((name) => new Option(name, name)));
    }
    choice.value = source.chosen ?? source.name;
    const list = find("choice");
    list.hidden = source.kind !== "choice";
    for (const behind of document.querySelectorAll("main, aside")) behind.inert = !list.hidden;
    if (source.kind === "choice") {
      const buttons = sensors.map((name) => {
        const button = document.createElement("button");
        button.textContent = name;
        button.addEventListener("click", () => this.send({ do: "choose", sensor: name }));
        return button;
      });
      list.querySelector("div").replaceChildren(...buttons);
      list.querySelector("p").hidden = sensors.length > 0;
    }
  }

  say(state) {
    Object.assign(this.state, state);
    const words = find("state");
    words.textContent = this.state.words;
    words.title = this.state.words;
    words.dataset.ok = String(this.state.ok);
    this.timeline.state(this.state);
    this.link();
    this.wordsDue = true;
    // A step after a pause waits for nothing.
    if (this.later !== null && !this.state.playing) this.next();
  }

  /** One sweep's bytes: shown, and the server is told when it is drawn. */
  receive(buffer) {
    const head = this.head;
    if (head === null) return;
    this.head = null;
    const sweep = new Sweep(buffer);
    this.status.sweeps++;
    // A sweep and its tuned copy may come before either is drawn.
    this.waiting ??= head;
    if (!head.tuned) {
      this.newest = { head, sweep };
      // Where a tuned copy follows, both are shown at once: never the points of one moment and the labels of another.
      if (!head.paired || !this.tuning.active) this.take(null);
    } else if (this.tuning.active && head.sequence === this.newest?.head.sequence) {
      this.tuning.compareCounts(this.newest.sweep, sweep);
      this.take(sweep);
    }
  }

  /** Shows the newest sweep, and its tuned copy where there is one. */
  take(tuned) {
    const { head, sweep } = this.newest;
    // In a capture, another sensor follows without a gap.
    if (head.sensor !== this.sensor) this.forget();
    this.sensor = head.sensor;
    this.notice = head;
    this.status.index = head.index;
    this.status.sequence = head.sequence;
    this.sweeps = [sweep, tuned];
    this.show();
    if (head.index !== null) this.timeline.at(head.index, head.sequence);
    this.link();
  }

  refuse(text) {
    this.tuning.refuse(text);
    // There is no tuned copy of it.
    if (this.newest !== null && this.newest.sweep !== this.sweeps[0]) this.take(null);
  }

  // ---- What is shown

  /** Nothing is shown: another sensor was chosen, of which no sweep has come. */
  clear() {
    this.forget();
    this.sweeps = [null, null];
    this.notice = null;
    this.newest = null;
    this.show();
    if (this.waiting === null) return;
    this.waiting = null;
    this.next();
  }

  /** What was pointed at and plotted, and where the camera is, says nothing of another sensor. */
  forget() {
    this.pointed = null;
    this.pinned = null;
    this.plots.clear();
    this.cloud.camera.look(this.cloud.camera.view);
  }

  /** The sweep of a side, or what there is instead. */
  side(index) {
    return this.sweeps[index] ?? this.sweeps[0];
  }

  /** The pose of the sensor in the frame that was chosen, null in its own. */
  poseOf(sweep) {
    return sweep?.pose(this.cloud.options.frame) ?? null;
  }

  show() {
    const mode = this.sweeps[1] === null ? "before" : this.tuning.mode;
    const sides = { before: [0], after: [1], both: [0, 1] }[mode];
    this.cloud.shown = sides;
    for (const index of sides) this.cloud.show(index, this.side(index));
    const one = sides[sides.length - 1];
    const strips = mode === "both" ? [[0, "label"], [1, "label"]] : [[one, this.first], [one, "label"]];
    this.images.show(this.sweeps.map((_, index) => this.side(index)), strips);
    this.shown = this.side(one);
    this.status.tuned = one === 1;
    this.wordsDue = true;
    this.legend();
    this.table.show(this.cloud.last.segments);
    find("count").textContent = String(this.shown?.segments.length ?? "");
    find("none").hidden = this.shown !== null;
    find("second").hidden = !this.shown?.range2;
    find("unmounted").hidden = this.poseOf(this.shown) === null || this.shown.isMounted;
    // The pointer stays where it is, and other points come to lie under it.
    if (this.pointed?.by === "cloud" && this.cloud.pointer !== null) {
      const hit = this.cloud.pick(this.cloud.pointer.x, this.cloud.pointer.y);
      this.pointed = hit === null ? null : { by: "cloud", ...hit };
    }
    this.resolve();
  }

  /** What is compared has changed, or tuning has ended. */
  compare() {
    if (!this.newest) return;
    if (this.tuning.active) this.show();
    else this.take(null);
  }

  frame() {
    const before = performance.now();
    const isDrawn = this.cloud.draw();
    const isImage = this.images.draw();
    if (isDrawn || isImage) this.status.frames++;
    this.status.points = this.cloud.count;
    this.status.returns = this.shown?.header.returns ?? 0;
    if (this.waiting) this.tellDrawn(before);
    this.plots.age(before);
    const isDue = this.wordsDue || this.plots.dirty;
    if (isDue && (before - this.wordsAt > WORDS_MS || !this.state.playing)) this.write(before);
  }

  tellDrawn(before) {
    const head = this.waiting;
    this.waiting = null;
    find("error").hidden = this.cloud.failure === null;
    const now = performance.now();
    this.drawn.push(now - head.received);
    if (this.drawn.length > 600) this.drawn.shift();
    const sorted = [...this.drawn].sort((one, other) => one - other);
    this.status.latency_ms = sorted[sorted.length >> 1];
    this.status.drawing_ms = now - before;
    if (!head.tuned) this.plot(head, now);
    if (calm.matches && this.state.playing) this.later ??= setTimeout(() => this.next(), this.calmMs);
    else this.next();
  }

  /**
   * Latency is from the arrival of a sensor's last packet to the picture, by the clocks of its host and of this one; of a
   * capture, from receipt to picture.
   */
  plot(head, now) {
    const { header } = this.newest.sweep;
    const age = Date.now() - Number(header.arrival_ns) / 1e6;
    // A capture that is played as a sensor has arrival times of its own.
    const isLive = this.source?.kind === "sensor" && age > -50 && age < 60000;
    const latency = isLive ? Math.max(0, age) : now - head.received;
    this.plots.add({ latency, losses: header.lost_packets, segments: header.segments });
  }

  write(now) {
    this.wordsDue = false;
    this.wordsAt = now;
    this.plots.draw();
    find("now").textContent = this.shown === null ? "" : this.words();
    if (this.shown === null) return;
    this.facts.show(this.shown, this.notice ?? {}, this.state.facts ?? {}, this.plots.newest("latency") ?? 0);
  }

  words() {
    const { header } = this.shown;
    return `${model(this.shown)} · ${utc(header.time_ns)} · ${header.rpm.toFixed(0)} rpm · ${header.returns.toLocaleString("en")} returns`;
  }

  legend() {
    const { legend } = this.cloud.last;
    const canvas = find("legend");
    const key = find("key");
    canvas.hidden = !legend?.colours;
    key.hidden = !legend?.swatches;
    if (legend?.swatches) {
      const text = legend.swatches.map(([, words]) => words).join();
      if (key.dataset.text === text) return;
      key.dataset.text = text;
      key.replaceChildren(...legend.swatches.map(([colour, words]) => {
        const item = document.createElement("span");
        const swatch = document.createElement("i");
        swatch.style.background = palette.css(colour);
        item.append(swatch, words);
        return item;
      }));
      return;
    }
    if (legend) drawScale(canvas, legend);
  }

  // ---- One selection for all

  /** What a view says is under the pointer, or was clicked. A click holds a pixel until the next one. */
  point(by, event, hit) {
    const pointed = hit === null || event === "leave" ? null : { by, ...hit };
    if (event === "click") {
      const isSame = this.pinned !== null && pointed?.pixel === this.pinned.pixel && pointed?.label === this.pinned.label;
      this.pinned = isSame ? null : pointed;
    }
    this.pointed = pointed;
    this.resolve();
  }

  unpin() {
    this.pinned = null;
    this.resolve();
  }

  /** Finds what is selected in the sweep that is shown, and marks it everywhere. */
  resolve() {
    const pointed = this.pointed ?? this.pinned;
    const sweep = pointed ? this.side(pointed.side ?? this.cloud.shown[this.cloud.shown.length - 1]) : null;
    this.selection = sweep === null ? null : selectionOf(sweep, pointed);
    if (this.selection !== null) this.selection.pinned = this.pointed === null;
    const { found, label, row, column, point } = this.selection ?? {};
    this.cloud.mark(label ?? 0, point ?? null);
    this.images.mark(label ?? 0, row ?? null, column ?? null);
    this.table.mark(label ?? 0, pointed?.by === "table");
    this.facts.select(this.selection, sweep, this.poseOf(sweep));
    this.status.selection = this.selection === null ? null : {
      by: pointed.by, label, row: row ?? null, column: column ?? null, other: found?.other ?? false, range: found?.range ?? null,
      pinned: this.selection.pinned, point: point ? [...point] : null,
    };
  }

  // ---- Links

  /** `#sweep=123` goes to the sweep of that number, which its header, its files and its lines of JSON have. */
  follow() {
    const named = /^#sweep=(\d+)$/.exec(location.hash);
    if (named === null || Number(named[1]) === this.linked) return;
    this.linked = Number(named[1]);
    this.send({ do: "pause" });
    this.send({ do: "find", sequence: this.linked });
  }

  /** While it stands still, the address names the sweep. */
  link() {
    const { index, sequence } = this.status;
    if (index === null || this.state.playing || this.linked === sequence) return;
    this.linked = sequence;
    history.replaceState(null, "", `#sweep=${sequence}`);
  }

  // ---- Buttons and keys

  controls() {
    const colour = find("colour");
    for (const [name, words] of Object.entries(COLOURS)) colour.append(new Option(words, name));
    colour.addEventListener("change", () => this.set("colour", colour.value));
    const frame = find("frame");
    frame.addEventListener("change", () => {
      this.cloud.set("frame", frame.value);
      this.show();
    });
    const size = find("size");
    size.addEventListener("input", () => this.set("size", size.valueAsNumber));
    for (const box of document.querySelectorAll("[data-option]")) {
      box.addEventListener("change", () => this.set(box.dataset.option, box.checked));
    }
    for (const button of document.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => this.cloud.look(button.dataset.view));
    }
    for (const button of document.querySelectorAll("[data-strip]")) {
      button.addEventListener("click", () => this.strip(button.dataset.strip));
    }
    find("whole").addEventListener("click", () => this.images.reset());
    const tabs = [...document.querySelectorAll("[data-tab]")];
    tabs.forEach((tab, index) => {
      tab.addEventListener("click", () => this.tab(tab.dataset.tab));
      tab.addEventListener("keydown", (event) => {
        const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
        if (by === undefined) return;
        event.stopPropagation();
        const next = tabs[(index + by + tabs.length) % tabs.length];
        next.focus();
        next.click();
      });
    });
    for (const button of document.querySelectorAll("[data-save]")) {
      button.addEventListener("click", () => this.save(button.dataset.save));
    }
    find("sensor").addEventListener("change", (event) => this.send({ do: "choose", sensor: event.target.value }));
    find("help-open").addEventListener("click", () => find("help").showModal());
    window.addEventListener("hashchange", () => this.follow());
    window.addEventListener("keydown", (event) => this.key(event));
  }

  set(option, value) {
    this.cloud.set(option, value);
    this.legend();
  }

  strip(what) {
    this.first = what;
    for (const button of document.querySelectorAll("[data-strip]")) {
      button.setAttribute("aria-pressed", String(button.dataset.strip === what));
    }
    if (this.sweeps[0]) this.show();
  }

  tab(name) {
    for (const tab of document.querySelectorAll("[data-tab]")) {
      tab.setAttribute("aria-selected", String(tab.dataset.tab === name));
      tab.tabIndex = tab.dataset.tab === name ? 0 : -1;
      find(tab.dataset.tab).hidden = tab.dataset.tab !== name;
    }
    this.wordsDue = true;
  }

  key(event) {
    const isTyping = event.target.matches?.("input[type=number], select") || document.querySelector("dialog[open]");
    const isSliding = event.target.matches?.("input[type=range]") && /^(Arrow|Home|End|Page)/.test(event.key);
    if (isTyping || isSliding || event.ctrlKey || event.metaKey || event.altKey) return;
    const flip = (option) => {
      const box = document.querySelector(`[data-option="${option}"]`);
      box.checked = !box.checked;
      this.set(option, box.checked);
    };
    const colour = find("colour");
    const actions = {
      " ": () => this.timeline.toggle(),
      ",": () => this.timeline.step(-1),
      ".": () => this.timeline.step(1),
      c: () => {
        colour.selectedIndex = (colour.selectedIndex + 1) % colour.length;
        this.set("colour", colour.value);
      },
      g: () => flip("grid"),
      b: () => flip("boxes"),
      n: () => flip("numbers"),
      t: () => this.tuning.toggle(),
      Escape: () => this.unpin(),
      "?": () => find("help").showModal(),
    };
    const action = actions[event.key];
    // A button or a box that has the focus is pressed by the space bar; then it is not ours.
    if (event.key === " " && event.target.matches?.("button, input[type=checkbox]")) return;
    if (action !== undefined) action();
    else if (!this.cloud.key(event)) return;
    event.preventDefault();
  }

  async save(what) {
    if (!this.shown) return;
    const number = String(this.shown.header.sequence).padStart(6, "0");
    const name = `sweep_${number}.${what}`;
    if (what === "png") save.offer(await save.png(this.cloud, this.images, this.words()), name);
    else if (what === "pcd") save.offer(save.pcd(this.shown, this.poseOf(this.shown)), name);
    else if (what === "csv") save.offer(save.csv(this.shown, this.poseOf(this.shown)), name);
    else save.offer(this.shown.buffer, name);
  }

  fail(error) {
    this.status.errors.push(String(error?.message ?? error));
    if (this.status.errors.length > 20) this.status.errors.shift();
    return tell(error?.message ?? error);
  }
}

/** What is selected: the return of a pixel, or the segment of a label. */
function selectionOf(sweep, pointed) {
  if (pointed.pixel === undefined) {
    const segment = sweep.segment(pointed.label);
    return segment === undefined ? null : { label: pointed.label, segment, found: null, point: null };
  }
  if (pointed.pixel >= sweep.rows * sweep.count) return null;
  const row = pointed.pixel % sweep.rows;
  const column = (pointed.pixel - row) / sweep.rows;
  const found = sweep.at(row, column, pointed.other);
  if (found === null) return { row, column, found: null, label: undefined, point: null };
  return { row, column, found, label: found.label, segment: sweep.segment(found.label), point: found.point };
}

/** Shows what went wrong, until the next sweep is drawn. */
function tell(error) {
  const place = find("error");
  place.textContent = String(error);
  place.hidden = false;
  return true;
}

/** A bar of colours with ticks. */
function drawScale(canvas, { colours, ticks }) {
  const ratio = window.devicePixelRatio;
  const [width, height] = [230, 30];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const [left, right] = [14, width - 22];
  for (let x = left; x < right; x++) {
    context.fillStyle = palette.css(colours[Math.floor(((x - left) / (right - left)) * colours.length)]);
    context.fillRect(x, 2, 1, 9);
  }
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = palette.TEXT;
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const [place, words] of ticks) context.fillText(words, left + place * (right - left), 15);
}

// What fails while the page is made is told too.
window.addEventListener("error", (event) => page?.fail(event.error ?? event.message) ?? tell(event.message));
window.addEventListener("unhandledrejection", (event) => page?.fail(event.reason) ?? tell(event.reason));
let page = null;
page = new Page();

/** For tests: the state, and what the page can tell of the sweep that is shown. */
window.sweepd = Object.assign(page.status, {
  page,
  /** The shown sweep as `sweepd replay --csv` writes it. */
  csv: () => save.csv(page.shown, page.poseOf(page.shown)),
  /** x, y, z of every return, in the order of `SweepRef::returns`. */
  positions: () => Array.from(page.cloud.sides[0].points.position.subarray(0, 3 * page.cloud.sides[0].points.count)),
  /** Where the middle of a pixel is over the images, in strip 0 or 1. */
  imagePlace: (strip, row, column) => page.images.place(strip, row, column),
  /** Where a return is in the 3-D view, and its depth; the view's upper left is 0, 0. */
  scenePlace: (row, column, other = false) => page.cloud.place(page.shown.at(row, column, other).point),
  /** Red, green and blue of the 3-D view at a place. */
  scenePixel: (x, y) => page.cloud.pixel(x, y),
});
