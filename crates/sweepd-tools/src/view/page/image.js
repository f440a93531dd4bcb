// The range image and the label image below it, on one canvas with one zoom. A wheel zooms where the pointer is, a drag
// moves, a double click shows all.

import * as palette from "./palette.js";
import { COLUMN_MISSING, COLUMN_UNFIRED, LABEL_FIRST_SEGMENT } from "./sweep.js";

const LEFT = 52;
const RIGHT = 10;
const CAPTION = 18;
const AXIS = 18;
const FONT = "11px system-ui, sans-serif";

export class ImageView {
  constructor(canvas, report) {
    this.canvas = canvas;
    this.report = report;
    /** The strips: the side whose sweep each shows, and what it shows. */
    this.strips = [new Strip(0, "range"), new Strip(0, "label")];
    this.window = { left: 0, top: 0, width: 1, height: 1 };
    this.marked = { label: 0, row: null, column: null };
    /** Row and column at which keys point. */
    this.cursor = null;
    this.dirty = true;
    this.listen();
    new ResizeObserver(() => this.touch()).observe(canvas);
  }

  touch() {
    this.dirty = true;
  }

  /** Takes the sweeps before and after, and what the strips show of them. */
  show(sweeps, strips) {
    strips.forEach(([side, what], index) => {
      const strip = this.strips[index];
      Object.assign(strip, { side, what });
      strip.paint(sweeps[side] ?? sweeps[0]);
    });
    this.touch();
  }

  mark(label, row, column) {
    this.marked = { label, row, column };
    this.touch();
  }

  /** Shows the whole image. */
  reset() {
    this.window = { left: 0, top: 0, width: 1, height: 1 };
    this.touch();
  }

  area(index) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const each = Math.max(8, (height - AXIS) / this.strips.length - CAPTION);
    return { left: LEFT, top: index * (each + CAPTION) + CAPTION, width: Math.max(1, width - LEFT - RIGHT), height: each };
  }

  draw() {
    if (!this.dirty) return false;
    this.dirty = false;
    const { canvas } = this;
    const ratio = window.devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = false;
    this.strips.forEach((strip, index) => this.drawStrip(context, strip, this.area(index)));
    const last = this.strips[this.strips.length - 1];
    if (last.sweep !== null) this.drawAzimuths(context, last.sweep, this.area(this.strips.length - 1));
    return true;
  }

  drawStrip(context, strip, area) {
    const { sweep } = strip;
    context.fillStyle = palette.css(palette.NO_RETURN);
    context.fillRect(area.left, area.top, area.width, area.height);
    this.drawCaption(context, strip, area);
    if (sweep === null || sweep.count === 0) return;
    const { window: seen } = this;
    context.save();
    context.beginPath();
    context.rect(area.left, area.top, area.width, area.height);
    context.clip();
    const source = [seen.left * sweep.count, seen.top * sweep.rows, seen.width * sweep.count, seen.height * sweep.rows];
    const target = [area.left, area.top, area.width, area.height];
    context.drawImage(strip.canvas, ...source, ...target);
    this.drawMark(context, strip, source, target);
    if (strip.what === "label") this.drawNumbers(context, sweep, area);
    this.drawCross(context, sweep, area);
    context.restore();
    context.font = FONT;
    context.fillStyle = palette.DIM;
    context.textAlign = "right";
    const elevation = (part) => {
      const row = Math.min(sweep.rows - 1, Math.max(0, Math.floor(part * sweep.rows)));
      const degrees = (sweep.beams[row].elevation_rad * 180) / Math.PI;
      return `${degrees < 0 ? "\u2212" : "+"}${Math.abs(degrees).toFixed(1)}°`;
    };
    context.textBaseline = "top";
    context.fillText(elevation(seen.top), area.left - 6, area.top);
    context.textBaseline = "bottom";
    context.fillText(elevation(seen.top + seen.height - 1e-9), area.left - 6, area.top + area.height);
  }

  drawCaption(context, { what, side }, area) {
    const titles = { range: "range", reflectivity: "reflectivity", label: "labels" };
    const isCompared = this.strips[0].what === this.strips[1].what && this.strips[0].side !== this.strips[1].side;
    context.font = `600 ${FONT}`;
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.fillStyle = palette.TEXT;
    const words = titles[what] + (isCompared ? [" before", " after"][side] : "");
    context.fillText(words, area.left, area.top - CAPTION / 2);
  }

  /** Paints the returns of the marked segment white. */
  drawMark(context, strip, source, target) {
    const marked = strip.marked(this.marked.label);
    if (marked !== null) context.drawImage(marked, ...source, ...target);
  }

  drawNumbers(context, sweep, area) {
    context.font = "600 11px ui-monospace, monospace";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const taken = [];
    const order = [...sweep.segments].sort((one, other) => other.points - one.points).slice(0, 200);
    for (const segment of order) {
      const { row_first: top, row_last: bottom, column_first: first, column_last: last } = segment;
      const [x0, y0] = this.toPage(sweep, area, top, first <= last ? first : 0);
      const [x1, y1] = this.toPage(sweep, area, bottom + 1, last + 1);
      const words = String(segment.label);
      const half = 4 * words.length + 1;
      const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
      const isSmall = x1 - x0 < 2 * half || y1 - y0 < 9 || segment.points * (area.width / sweep.count) < 60;
      if (isSmall || taken.some((box) => Math.abs(box.x - x) < box.half + half && Math.abs(box.y - y) < 12)) continue;
      taken.push({ x, y, half });
      context.lineWidth = 3;
      context.strokeStyle = "rgb(0 0 0 / 0.8)";
      context.strokeText(words, x, y);
      context.fillStyle = "#fff";
      context.fillText(words, x, y);
    }
  }

  drawCross(context, sweep, area) {
    const { row, column } = this.marked;
    if (row === null) return;
    const [x, y] = this.toPage(sweep, area, row + 0.5, column + 0.5);
    context.fillStyle = "rgb(255 255 255 / 0.55)";
    context.fillRect(Math.round(x), area.top, 1, area.height);
    context.fillRect(area.left, Math.round(y), area.width, 1);
    context.strokeStyle = "#fff";
    context.lineWidth = 1.5;
    context.strokeRect(x - 4, y - 4, 8, 8);
  }

  /** Degrees below the last strip: round azimuths where a column crosses them. */
  drawAzimuths(context, sweep, area) {
    const { left, width } = this.window;
    const degreesOf = (column) => (sweep.columns.azimuth[column] * 180) / Math.PI;
    const step = palette.roundUp((width * 360 * 80) / area.width) > 20 ? 30 : palette.roundUp((width * 360 * 80) / area.width);
    context.font = FONT;
    context.fillStyle = palette.DIM;
    context.textAlign = "center";
    context.textBaseline = "top";
    const first = Math.max(1, Math.floor(left * sweep.count));
    const end = Math.min(sweep.count, Math.ceil((left + width) * sweep.count));
    let lastX = -Infinity;
    for (let column = first; column < end; column++) {
      if (sweep.columns.status[column] === COLUMN_UNFIRED) continue;
      const [before, here] = [degreesOf(column - 1), degreesOf(column)];
      // A jump is the turn's end, or the noise of an encoder.
      const crossed = here > before ? Math.floor(here / step) : Math.floor(before / step);
      if (Math.floor(before / step) === Math.floor(here / step) || Math.abs(here - before) > 180) continue;
      const [x] = this.toPage(sweep, area, 0, column);
      if (x - lastX < 34) continue;
      lastX = x;
      context.fillRect(Math.round(x), area.top + area.height, 1, 4);
      context.fillText(`${Number((crossed * step).toFixed(2))}°`, x, area.top + area.height + 5);
    }
    context.textAlign = "right";
    context.fillText("azimuth", LEFT - 6, area.top + area.height + 5);
  }

  toPage(sweep, area, row, column) {
    const { left, top, width, height } = this.window;
    return [
      area.left + ((column / sweep.count - left) / width) * area.width,
      area.top + ((row / sweep.rows - top) / height) * area.height,
    ];
  }

  /** The pixel at a place of the page; null beside the strips. */
  pick(x, y) {
    for (const [index, strip] of this.strips.entries()) {
      const area = this.area(index);
      const [across, down] = [(x - area.left) / area.width, (y - area.top) / area.height];
      if (strip.sweep === null || across < 0 || across >= 1 || down < 0 || down >= 1) continue;
      const { left, top, width, height } = this.window;
      const { rows, count } = strip.sweep;
      const column = Math.min(count - 1, Math.floor((left + across * width) * count));
      const row = Math.min(rows - 1, Math.floor((top + down * height) * rows));
      if (column < 0) return null;
      return { side: strip.side, pixel: column * rows + row, other: false };
    }
    return null;
  }

  /** Where a pixel of the image is on the page: the middle of it in a strip. */
  place(index, row, column) {
    return this.toPage(this.strips[index].sweep, this.area(index), row + 0.5, column + 0.5);
  }

  move(right, down) {
    const { window: seen } = this;
    seen.left = Math.min(1 - seen.width, Math.max(0, seen.left + right));
    seen.top = Math.min(1 - seen.height, Math.max(0, seen.top + down));
    this.touch();
  }

  zoom(factor, x, y) {
    const area = this.area(y > this.area(1).top - CAPTION ? 1 : 0);
    const { window: seen } = this;
    const across = Math.min(1, Math.max(0, (x - area.left) / area.width));
    const down = Math.min(1, Math.max(0, (y - area.top) / area.height));
    const width = Math.min(1, Math.max(0.01, seen.width * factor));
    // Rows are few: they grow once the columns are about as wide.
    const height = Math.min(1, Math.max(0.12, width * 5));
    const [right, lower] = [(seen.width - width) * across, (seen.height - height) * down];
    Object.assign(seen, { width, height });
    this.move(right, lower);
  }

  /** Points at a pixel by a key, holds it, or zooms there; gives whether the key means anything here. */
  key(event) {
    const { side, sweep } = this.strips[1];
    if (sweep === null || sweep.count === 0) return false;
    const arrow = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    const zoom = { "+": 0.8, "=": 0.8, "-": 1.25 }[event.key];
    const far = event.shiftKey ? 10 : 1;
    const { row = sweep.rows >> 1, column = sweep.count >> 1 } = this.cursor ?? {};
    if (zoom !== undefined) this.zoom(zoom, ...this.place(1, row, column));
    else if (event.key === "Enter") this.report("click", { side, pixel: column * sweep.rows + row, other: false });
    else if (arrow === undefined) return false;
    else {
      const to = { row: row + far * arrow[0], column: (column + far * arrow[1] + sweep.count) % sweep.count };
      this.cursor = { ...to, row: Math.min(sweep.rows - 1, Math.max(0, to.row)) };
      this.report("hover", { side, pixel: this.cursor.column * sweep.rows + this.cursor.row, other: false });
      this.reveal(this.cursor, sweep);
    }
    return true;
  }

  /** Moves the images so that a pixel is in sight. */
  reveal({ row, column }, sweep) {
    const { left, top, width, height } = this.window;
    const off = (part, from, length) => Math.min(0, part - from) + Math.max(0, part - from - length);
    this.move(off((column + 0.5) / sweep.count, left, width), off((row + 0.5) / sweep.rows, top, height));
  }

  listen() {
    const { canvas } = this;
    const held = new Map();
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !this.key(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    canvas.addEventListener("blur", () => this.report("leave", null));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, { x: event.offsetX, y: event.offsetY, moved: 0, button: event.button });
      // A second finger makes a pinch of it, which is no click.
      if (held.size > 1) for (const one of held.values()) one.moved = Infinity;
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = [event.offsetX, event.offsetY];
      const before = held.get(event.pointerId);
      if (before === undefined) return this.report("hover", this.pick(x, y));
      const area = this.area(0);
      const [right, down] = [x - before.x, y - before.y];
      if (held.size === 2) {
        const other = [...held.values()].find((one) => one !== before);
        this.zoom(Math.max(10, Math.abs(other.x - before.x)) / Math.max(10, Math.abs(other.x - x)), (other.x + x) / 2, y);
      }
      Object.assign(before, { x, y, moved: before.moved + Math.abs(right) + Math.abs(down) });
      this.move((-right / area.width) * this.window.width, (-down / area.height) * this.window.height);
    });
    const release = (event) => {
      const before = held.get(event.pointerId);
      held.delete(event.pointerId);
      const isClick = event.type === "pointerup" && before?.moved < 4 && before.button === 0;
      if (isClick) this.report("click", this.pick(before.x, before.y));
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("pointerleave", () => this.report("leave", null));
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * (event.deltaMode === 0 ? 0.0016 : 0.05)), event.offsetX, event.offsetY);
    }, { passive: false });
  }
}

/** An image of a sweep, a canvas pixel a pixel. */
class Strip {
  constructor(side, what) {
    Object.assign(this, { side, what, sweep: null });
    this.canvas = document.createElement("canvas");
    this.white = document.createElement("canvas");
    this.whiteOf = 0;
  }

  paint(sweep) {
    this.sweep = sweep ?? null;
    this.whiteOf = 0;
    if (this.sweep === null || sweep.count === 0 || sweep.rows === 0) return;
    const { rows, count, range, label, reflectivity } = sweep;
    const image = this.blank(this.canvas, count, rows);
    const pixels = new Uint32Array(image.data.buffer);
    const rangeColour = this.what === "range" ? palette.rangeColours(palette.rangeScale(sweep)) : null;
    for (let column = 0, pixel = 0; column < count; column++) {
      const isMissing = sweep.columns.status[column] === COLUMN_MISSING;
      for (let row = 0; row < rows; row++, pixel++) {
        let colour = palette.NO_RETURN;
        if (range[pixel] > 0) {
          if (this.what === "range") colour = rangeColour(range[pixel]);
          else colour = this.what === "label" ? palette.label(label[pixel]) : palette.REFLECTIVITY[reflectivity[pixel]];
        } else if (isMissing) {
          colour = (column + row) % 8 < 4 ? palette.MISSING : palette.MISSING_STRIPE;
        }
        pixels[row * count + column] = colour;
      }
    }
    this.canvas.getContext("2d").putImageData(image, 0, 0);
  }

  /** A canvas in which the returns of a segment are white; null for what is no segment. */
  marked(number) {
    const { sweep, white } = this;
    const segment = number < LABEL_FIRST_SEGMENT ? undefined : sweep?.segment(number);
    if (segment === undefined) return null;
    if (this.whiteOf === number) return white;
    const { rows, count, label, range } = sweep;
    const image = this.blank(white, count, rows);
    const pixels = new Uint32Array(image.data.buffer);
    pixels.fill(0);
    for (let column = 0, pixel = 0; column < count; column++) {
      for (let row = 0; row < rows; row++, pixel++) {
        if (label[pixel] === number && range[pixel] > 0) pixels[row * count + column] = 0xc8ffffff;
      }
    }
    white.getContext("2d").putImageData(image, 0, 0);
    this.whiteOf = number;
    return white;
  }

  /** An image of a size, the canvas made as large; reused while the size stays. */
  blank(canvas, width, height) {
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const kept = canvas === this.white ? "whiteImage" : "image";
    if (this[kept]?.width !== width || this[kept]?.height !== height) this[kept] = new ImageData(width, height);
    return this[kept];
  }
}
