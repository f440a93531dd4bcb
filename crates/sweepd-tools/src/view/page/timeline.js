// The time line of a capture or a simulation: play, pause, step, speed, and a bar to scrub, with marks where packets
// were lost and sensors began anew.

import * as palette from "./palette.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];
const COLOURS = { loss: "#ff7a6b", gap: palette.WARNING, stop: palette.WARNING, restart: palette.ACCENT };

export class Timeline {
  /** `send` takes what is to be done; see main.js. */
  constructor(root, send) {
    this.root = root;
    this.send = send;
    this.sweeps = 0;
    this.index = 0;
    this.sequence = 0;
    this.marks = [];
    this.playing = false;
    /** The sweep that the pointer is at, and whether it is about to be asked for. */
    this.wanted = null;
    this.isAsked = false;
    const part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.play = part("play");
    this.bar = part("bar");
    this.words = part("words");
    this.speed = part("speed");
    this.tip = part("tip");
    for (const factor of SPEEDS) this.speed.append(new Option(`${factor} ×`, String(factor), factor === 1, factor === 1));
    this.play.addEventListener("click", () => this.toggle());
    part("back").addEventListener("click", () => this.step(-1));
    part("on").addEventListener("click", () => this.step(1));
    this.speed.addEventListener("change", () => send({ do: "speed", factor: Number(this.speed.value) }));
    this.bar.addEventListener("pointerdown", (event) => {
      this.bar.setPointerCapture(event.pointerId);
      this.scrub(event);
    });
    this.bar.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) this.scrub(event);
      this.point(event);
    });
    for (const end of ["pointerleave", "blur"]) this.bar.addEventListener(end, () => (this.tip.hidden = true));
    this.bar.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10, Home: -Infinity, End: Infinity };
      if (!(event.key in steps)) return;
      event.preventDefault();
      event.stopPropagation();
      this.seek(this.index + steps[event.key]);
    });
    new ResizeObserver(() => this.draw()).observe(this.bar);
  }

  /** Takes the source: live sensors have no time line. */
  source({ kind, sweeps, marks }) {
    this.root.hidden = kind !== "capture" && kind !== "simulation";
    this.sweeps = sweeps ?? 0;
    this.marks = marks ?? [];
    this.draw();
  }

  state({ playing, speed }) {
    this.playing = playing;
    this.play.dataset.icon = playing ? "pause" : "play";
    this.play.setAttribute("aria-label", playing ? "pause" : "play");
    const near = SPEEDS.reduce((one, other) => (Math.abs(other - speed) < Math.abs(one - speed) ? other : one));
    if (document.activeElement !== this.speed) this.speed.value = String(near);
  }

  /** The sweep that is shown now: its place among the whole sweeps of the capture, and its number. */
  at(index, sequence) {
    this.index = index;
    this.sequence = sequence;
    this.draw();
  }

  toggle() {
    this.send({ do: this.playing ? "pause" : "play" });
  }

  step(by) {
    this.send({ do: "step", by });
  }

  seek(index) {
    if (this.sweeps === 0) return;
    this.send({ do: "seek", index: Math.min(this.sweeps - 1, Math.max(0, Math.round(index))) });
  }

  scrub(event) {
    const index = this.under(event);
    if (index === this.wanted && event.type === "pointermove") return;
    this.wanted = index;
    // At most one seek a picture: the newest.
    if (!this.isAsked) requestAnimationFrame(() => this.ask());
    this.isAsked = true;
  }

  ask() {
    this.isAsked = false;
    this.seek(this.wanted);
  }

  under(event) {
    const { left, width } = this.bar.getBoundingClientRect();
    const part = Math.min(1, Math.max(0, (event.clientX - left) / width));
    return Math.round(part * Math.max(0, this.sweeps - 1));
  }

  /** Says what is marked next to the pointer. */
  point(event) {
    const { left } = this.bar.getBoundingClientRect();
    this.tell(this.wordsOf(this.under(event)), event.clientX - left);
  }

  /** The place of a sweep, and what is marked there. */
  wordsOf(index) {
    const reach = (this.sweeps / this.bar.clientWidth) * 5;
    const near = this.marks.filter((mark) => Math.abs(mark.sweep - index) <= Math.max(0.5, reach)).slice(0, 4);
    return [`${index + 1} of ${this.sweeps}`, ...near.map((mark) => mark.text)].join(" · ");
  }

  tell(words, x) {
    this.tip.textContent = words;
    this.tip.hidden = false;
    const most = this.bar.clientWidth - this.tip.clientWidth;
    this.tip.style.transform = `translateX(${Math.min(most, Math.max(0, x - this.tip.clientWidth / 2))}px)`;
  }

  draw() {
    const { bar, sweeps, index, sequence, marks } = this;
    this.words.textContent = sweeps === 0 ? `sweep ${sequence}` : `sweep ${sequence}, ${index + 1} of ${sweeps}`;
    bar.setAttribute("aria-valuemax", String(Math.max(0, sweeps - 1)));
    bar.setAttribute("aria-valuenow", String(index));
    bar.setAttribute("aria-valuetext", this.wordsOf(index));
    const [width, height] = [bar.clientWidth, bar.clientHeight];
    if (width === 0) return;
    const ratio = window.devicePixelRatio;
    bar.width = Math.round(width * ratio);
    bar.height = Math.round(height * ratio);
    const context = bar.getContext("2d");
    context.scale(ratio, ratio);
    const place = (sweep) => 6 + (sweep / Math.max(1, sweeps - 1)) * (width - 12);
    const middle = height / 2;
    if (document.activeElement === bar && bar.matches(":focus-visible")) this.tell(this.wordsOf(index), place(index));
    context.fillStyle = palette.GRID;
    context.fillRect(6, middle - 2, width - 12, 4);
    context.fillStyle = palette.ACCENT;
    context.fillRect(6, middle - 2, place(index) - 6, 4);
    for (const mark of marks) {
      context.fillStyle = COLOURS[mark.what] ?? palette.WARNING;
      context.fillRect(Math.round(place(mark.sweep)) - 1, middle - 8, 2, 16);
    }
    context.beginPath();
    context.arc(place(index), middle, 6, 0, 2 * Math.PI);
    context.fillStyle = "#fff";
    context.fill();
  }
}
