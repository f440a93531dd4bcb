// Small plots of the last minute.

import * as palette from "./palette.js";

const SPAN_MS = 60000;
const LABEL_WIDTH = 74;
const VALUE_WIDTH = 62;
/** Without a sweep for this long, milliseconds, none comes: the slowest head turns in a quarter of a second. */
const SILENT_MS = 1000;

/** What is plotted: a name, its colour, and how its newest value reads. */
const LINES = [
  { key: "rate", name: "sweeps/s", colour: "#5ab0ff", text: (value) => value.toFixed(1) },
  { key: "latency", name: "latency", colour: "#7fd6a4", text: (value) => `${value.toFixed(value < 10 ? 1 : 0)} ms` },
  { key: "losses", name: "losses", colour: "#ff7a6b", text: (value) => String(value) },
  { key: "segments", name: "segments", colour: "#d3a6ff", text: (value) => String(value) },
];

export class Plots {
  constructor(canvas) {
    this.canvas = canvas;
    this.samples = [];
    this.dirty = true;
    this.drawnAt = 0;
    new ResizeObserver(() => (this.dirty = true)).observe(canvas);
  }

  /** One sweep: milliseconds from its time to now, packets and sweeps lost, and its segments. */
  add({ latency, losses, segments }) {
    const now = performance.now();
    const since = this.samples.filter((sample) => sample.at > now - 2000);
    const rate = since.length === 0 ? 0 : since.length / Math.max(0.1, (now - since[0].at) / 1000);
    this.samples.push({ at: now, rate, latency, losses, segments });
    const old = this.samples.findIndex((sample) => sample.at > now - SPAN_MS);
    if (old > 0) this.samples.splice(0, old);
    this.dirty = true;
  }

  /** The lines move on, and what stalls is seen to. */
  age(now) {
    if (this.samples.length > 0 && now - this.drawnAt > 1000) this.dirty = true;
  }

  clear() {
    this.samples = [];
    this.dirty = true;
  }

  /** The newest value of a line; undefined before the first sweep. */
  newest(key) {
    return this.samples[this.samples.length - 1]?.[key];
  }

  draw() {
    if (!this.dirty) return;
    this.dirty = false;
    const { canvas, samples } = this;
    const ratio = window.devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const each = height / LINES.length;
    const now = performance.now();
    this.drawnAt = now;
    LINES.forEach((line, index) => {
      const top = index * each + 4;
      const bottom = (index + 1) * each - 4;
      const most = palette.roundUp(Math.max(1, ...samples.map((sample) => sample[line.key])));
      context.font = "11px system-ui, sans-serif";
      context.textBaseline = "middle";
      context.textAlign = "left";
      context.fillStyle = palette.DIM;
      context.fillText(line.name, 0, (top + bottom) / 2);
      context.fillStyle = palette.GRID;
      context.fillRect(LABEL_WIDTH, bottom, width - LABEL_WIDTH - VALUE_WIDTH, 1);
      const place = (sample) => [
        LABEL_WIDTH + (1 - (now - sample.at) / SPAN_MS) * (width - LABEL_WIDTH - VALUE_WIDTH),
        bottom - (sample[line.key] / most) * (bottom - top),
      ];
      context.save();
      context.beginPath();
      context.rect(LABEL_WIDTH, top - 2, width - LABEL_WIDTH - VALUE_WIDTH, bottom - top + 4);
      context.clip();
      context.beginPath();
      samples.forEach((sample, number) => (number === 0 ? context.moveTo(...place(sample)) : context.lineTo(...place(sample))));
      context.strokeStyle = line.colour;
      context.lineWidth = 1.5;
      context.stroke();
      context.restore();
      const newest = samples[samples.length - 1];
      if (newest === undefined) return;
      context.textAlign = "right";
      context.font = "12px ui-monospace, monospace";
      context.fillStyle = palette.TEXT;
      const value = line.key === "rate" && now - newest.at > SILENT_MS ? 0 : newest[line.key];
      context.fillText(line.text(value), width, (top + bottom) / 2);
    });
  }
}
