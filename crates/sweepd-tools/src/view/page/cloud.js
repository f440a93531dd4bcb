// The 3-D view: every return a point, boxes and numbers of segments, a grid on the ground. WebGL 2 draws points and
// lines; a Canvas 2D over it draws texts and marks. Before and after of a tuning lie in two halves with one camera.

import { Camera, VIEWS, project } from "./camera.js";
import * as palette from "./palette.js";
import { LABEL_FIRST_SEGMENT, LABEL_GROUND, OTHER, PARTIAL, Points, isWide, moved, movedSegment } from "./sweep.js";

/** What points can be coloured by. */
export const COLOURS = {
  label: "label",
  range: "range",
  reflectivity: "reflectivity",
  height: "height",
  ring: "ring",
  time: "time in the turn",
  ground: "ground or not",
};

// A vertex: x, y, z as f32, the colour as four bytes, the label as u32.
const WORDS = 5;
const NONE = 0xffffffff;
/** Pixels around the pointer in which a point is found. */
const REACH = 9;
const MOST_TEXTS = 70;
const SEGMENT_LINES = 24;

const POINTS_VERTEX = `#version 300 es
uniform mat4 matrix;
uniform float size;
uniform uint marked;
layout(location = 0) in vec3 position;
layout(location = 1) in vec4 colour;
layout(location = 2) in uint label;
out vec3 shade;
void main() {
  gl_Position = matrix * vec4(position, 1.0);
  bool isMarked = label == marked;
  gl_PointSize = clamp(size * (0.55 + 9.0 / gl_Position.w), 1.0, 3.0 * size) + (isMarked ? 1.0 : 0.0);
  shade = isMarked ? mix(colour.rgb, vec3(1.0), 0.65) : colour.rgb;
}`;
const LINES_VERTEX = `#version 300 es
uniform mat4 matrix;
layout(location = 0) in vec3 position;
layout(location = 1) in vec4 colour;
out vec4 shade;
void main() {
  gl_Position = matrix * vec4(position, 1.0);
  shade = colour;
}`;
const POINTS_FRAGMENT = `#version 300 es
precision mediump float;
in vec3 shade;
out vec4 pixel;
void main() { pixel = vec4(shade, 1.0); }`;
const LINES_FRAGMENT = `#version 300 es
precision mediump float;
in vec4 shade;
out vec4 pixel;
void main() { pixel = shade; }`;

export class CloudView {
  /** `canvas` and the transparent `overlay` over it; `report(hit)` is called with what is under the pointer. */
  constructor(canvas, overlay, report) {
    this.canvas = canvas;
    this.overlay = overlay;
    this.report = report;
    this.camera = new Camera();
    this.options = { colour: "label", size: 2, boxes: true, numbers: true, grid: true, other: true, frame: "sensor" };
    this.sides = [new Side(), new Side()];
    /** Which sides are shown: [0], [1] or both, side by side. */
    this.shown = [0];
    this.marked = { label: NONE, point: null };
    this.dirty = true;
    this.pointer = null;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
    /** Why there is no 3-D view; all else works without it. */
    this.failure = gl === null ? "this browser has no WebGL 2: there is no 3-D view" : null;
    this.gl = gl;
    this.start();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.start();
      for (const side of this.sides) this.upload(side);
    });
    this.listen();
    new ResizeObserver(() => this.touch()).observe(overlay);
  }

  /** Makes all that the graphics card holds. */
  start() {
    const { gl } = this;
    if (gl === null) return;
    this.pointsProgram = program(gl, POINTS_VERTEX, POINTS_FRAGMENT, ["matrix", "size", "marked"]);
    this.linesProgram = program(gl, LINES_VERTEX, LINES_FRAGMENT, ["matrix"]);
    for (const side of this.sides) side.start(gl);
    this.grid = new Lines(gl);
    this.grid.step = 0;
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  touch() {
    this.dirty = true;
  }

  /** Takes a sweep for a side; null empties it. */
  show(index, sweep) {
    const side = this.sides[index];
    side.sweep = sweep;
    side.pose = sweep?.pose(this.options.frame) ?? null;
    side.segments = sweep === null ? [] : sweep.segments.map((segment) => movedSegment(side.pose, segment));
    if (sweep === null) side.points.count = 0;
    else sweep.fill(side.points, this.options.other);
    if (side.pose !== null) side.points.move(side.pose);
    this.upload(side);
  }

  set(option, value) {
    this.options[option] = value;
    if (option === "other" || option === "frame") this.sides.forEach((side, index) => this.show(index, side.sweep));
    if (option === "frame") this.look(this.camera.view);
    if (option === "colour") this.sides.forEach((side) => this.upload(side));
    this.touch();
  }

  mark(label, point) {
    const drawn = label >= LABEL_FIRST_SEGMENT ? label : NONE;
    this.marked = { label: drawn, point };
    this.touch();
  }

  look(view) {
    this.camera.look(view);
    this.fit();
    this.touch();
  }

  /** Fits the camera to the points that it was not fitted to yet; where nobody moved it, to another shape of the view. */
  fit() {
    const { camera, last } = this;
    const { width, height } = this.area(0);
    const isMine = camera.held && camera.aspect !== null;
    if (height > 0 && !isMine && camera.aspect !== width / height) camera.fit(last.points, width / height);
    // As the sensor sees, from where it is.
    if (camera.view === "sensor") camera.target = [...moved(last.pose, [0, 0, 0])];
  }

  /** The side that is shown last. */
  get last() {
    return this.sides[this.shown[this.shown.length - 1]];
  }

  /** Points of the sides that are shown. */
  get count() {
    return this.shown.reduce((sum, index) => sum + this.sides[index].points.count, 0);
  }

  upload(side) {
    const { gl } = this;
    if (gl === null) return;
    const { points, sweep } = side;
    side.reserve(points.count);
    const { floats, words } = side;
    const { position, labels } = points;
    for (let index = 0, at = 0; index < points.count; index++, at += WORDS) {
      floats[at] = position[3 * index];
      floats[at + 1] = position[3 * index + 1];
      floats[at + 2] = position[3 * index + 2];
      words[at + 4] = labels[index];
    }
    side.legend = sweep === null ? null : paint(side, this.options.colour);
    gl.bindBuffer(gl.ARRAY_BUFFER, side.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, floats.subarray(0, points.count * WORDS), gl.DYNAMIC_DRAW);
    side.outlines.fill(gl, boxes(side.segments));
    this.touch();
  }

  /** The rectangle of a shown side on the page, in its pixels. */
  area(place) {
    const width = this.overlay.clientWidth / this.shown.length;
    return { left: place * width, top: 0, width, height: this.overlay.clientHeight };
  }

  /** Draws what changed. Gives whether anything was drawn. */
  draw() {
    if (!this.dirty || this.gl === null) return false;
    this.dirty = false;
    const { gl, canvas, overlay } = this;
    const ratio = window.devicePixelRatio;
    const [width, height] = [overlay.clientWidth, overlay.clientHeight];
    for (const one of [canvas, overlay]) {
      if (one.width === Math.round(width * ratio) && one.height === Math.round(height * ratio)) continue;
      one.width = Math.round(width * ratio);
      one.height = Math.round(height * ratio);
    }
    const context = overlay.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (width === 0 || height === 0) return false;
    // Part of a turn does not tell where the points of the next one are.
    if (this.last.sweep?.has(PARTIAL) === false) this.fit();
    gl.enable(gl.SCISSOR_TEST);
    this.shown.forEach((index, place) => {
      const area = this.area(place);
      const matrix = this.camera.matrix(area.width / area.height);
      this.drawSide(this.sides[index], area, matrix, ratio);
      this.write(context, this.sides[index], area, matrix);
    });
    if (this.shown.length > 1) this.drawSeam(context);
    return true;
  }

  drawSide(side, area, matrix, ratio) {
    const { gl, options, marked } = this;
    const place = [area.left, area.top, area.width, area.height].map((length) => Math.round(length * ratio));
    gl.viewport(...place);
    gl.scissor(...place);
    gl.clearColor(6 / 255, 7 / 255, 10 / 255, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.useProgram(this.linesProgram.program);
    gl.uniformMatrix4fv(this.linesProgram.matrix, false, matrix);
    if (options.grid) {
      this.layGrid(side);
      gl.depthMask(false);
      this.grid.draw(gl);
      gl.depthMask(true);
    }
    gl.useProgram(this.pointsProgram.program);
    gl.uniformMatrix4fv(this.pointsProgram.matrix, false, matrix);
    gl.uniform1f(this.pointsProgram.size, options.size * ratio);
    gl.uniform1ui(this.pointsProgram.marked, marked.label);
    if (side.points.count > 0) {
      gl.bindVertexArray(side.array);
      gl.drawArrays(gl.POINTS, 0, side.points.count);
    }
    gl.useProgram(this.linesProgram.program);
    if (options.boxes) side.outlines.draw(gl);
    const segment = side.segments[marked.label - LABEL_FIRST_SEGMENT];
    if (segment !== undefined && !isWide(segment)) {
      side.markedOutline.fill(gl, outline(segment, 0xffffffff));
      side.markedOutline.draw(gl);
    }
  }

  /** The grid: rings around the origin on the ground, their distance by how far the camera is. */
  layGrid(side) {
    const step = palette.roundUp(Math.max(1, this.camera.distance / 6 || 10));
    const ground = groundHeight(side);
    const up = plumb(side);
    const key = [step, ground, ...up].join();
    if (this.grid.key === key) return;
    this.grid.key = key;
    this.grid.step = step;
    const rings = Math.min(20, Math.ceil(200 / step));
    const lines = [];
    const colour = (ring) => ((Math.round(150 * (1 - ring / (rings + 1))) << 24) | 0x685f56) >>> 0;
    const onGround = (x, y) => level(up, x, y, ground);
    for (let ring = 1; ring <= rings; ring++) {
      const radius = ring * step;
      const parts = 96;
      for (let part = 0; part < parts; part++) {
        for (const end of [part, part + 1]) {
          const angle = (end / parts) * 2 * Math.PI;
          lines.push([...onGround(radius * Math.sin(angle), radius * Math.cos(angle)), colour(ring)]);
        }
      }
    }
    const reach = rings * step;
    for (let ray = 0; ray < 12; ray++) {
      const angle = (ray / 12) * 2 * Math.PI;
      for (let ring = ray % 3 === 0 ? 0 : 1; ring < rings; ring++) {
        for (const end of [ring, ring + 1]) {
          const [x, y] = [end * step * Math.sin(angle), end * step * Math.cos(angle)];
          lines.push([...onGround(x, y), colour(ray % 3 === 0 ? ring / 2 : ring + rings / 3)]);
        }
      }
    }
    this.grid.reach = reach;
    this.grid.fill(this.gl, lines);
  }

  /** Texts and marks over a side. */
  write(context, side, area, matrix) {
    const { sweep } = side;
    context.save();
    context.beginPath();
    context.rect(area.left, area.top, area.width, area.height);
    context.clip();
    context.textAlign = "center";
    context.textBaseline = "middle";
    const taken = [];
    const text = (words, at, colour, font) => {
      const [x, y, depth] = project(matrix, at, area);
      if (depth < 0.1) return false;
      context.font = font;
      const half = context.measureText(words).width / 2 + 3;
      const isTaken = taken.some((box) => Math.abs(box.x - x) < box.half + half && Math.abs(box.y - y) < 15);
      const isOutside = x < area.left - half || x > area.left + area.width + half || y < -8 || y > area.height + 8;
      if (isTaken || isOutside) return false;
      taken.push({ x, y, half });
      context.lineWidth = 3;
      context.strokeStyle = "rgb(6 7 10 / 0.85)";
      context.strokeText(words, x, y);
      context.fillStyle = colour;
      context.fillText(words, x, y);
      return true;
    };
    drawSensor(context, matrix, area, side.pose);
    if (this.options.numbers && sweep !== null) this.writeNumbers(side, text);
    if (this.options.grid) this.writeMetres(side, text);
    const { point } = this.marked;
    if (point !== null) {
      const [x, y, depth] = project(matrix, moved(side.pose, point), area);
      if (depth > 0) ring(context, x, y);
    }
    context.restore();
  }

  writeNumbers({ segments }, text) {
    const { marked } = this;
    const eye = this.camera.eye();
    const away = (segment) => Math.hypot(...segment.centroid_m.map((value, axis) => value - eye[axis]));
    const order = segments
      .filter((segment) => segment.max_m[2] - segment.min_m[2] > 0.2)
      .map((segment) => ({ segment, weight: Math.sqrt(segment.points) / away(segment) }))
      .sort((one, other) => other.weight - one.weight)
      .slice(0, 2 * MOST_TEXTS);
    const chosen = segments[marked.label - LABEL_FIRST_SEGMENT];
    if (chosen !== undefined) order.unshift({ segment: chosen });
    let written = 0;
    for (const { segment } of order) {
      const [x, y] = segment.centroid_m;
      const isMarked = segment.label === marked.label;
      const colour = isMarked ? "#fff" : palette.css(palette.label(segment.label));
      const font = isMarked ? "bold 13px ui-monospace, monospace" : "11px ui-monospace, monospace";
      if (text(String(segment.label), [x, y, segment.max_m[2] + 0.25], colour, font)) written++;
      if (written === MOST_TEXTS) break;
    }
  }

  writeMetres(side, text) {
    const { step, reach } = this.grid;
    const ground = groundHeight(side);
    const up = plumb(side);
    const font = "11px system-ui, sans-serif";
    for (let radius = step; radius <= reach; radius += step) {
      for (const [x, y] of [[0, 1], [1, 0], [0, -1], [-1, 0]]) {
        text(`${radius} m`, level(up, x * radius, y * radius, ground), palette.DIM, font);
      }
    }
  }

  drawSeam(context) {
    const { width, height } = this.area(0);
    context.fillStyle = palette.GRID;
    context.fillRect(width - 1, 0, 2, height);
    context.font = "600 12px system-ui, sans-serif";
    context.textBaseline = "top";
    context.textAlign = "right";
    context.fillStyle = palette.TEXT;
    context.fillText("before", width - 12, 44);
    context.fillText("after", 2 * width - 12, 44);
  }

  /** The return next to a place of the page, and its side; null where there is none. */
  pick(x, y) {
    const place = Math.min(this.shown.length - 1, Math.floor(x / this.area(0).width));
    const area = this.area(place);
    const side = this.sides[this.shown[place]];
    const { points } = side;
    const matrix = this.camera.matrix(area.width / area.height);
    const { position } = points;
    // The pointer in clip space, and a pixel there.
    const [atX, atY] = [((x - area.left) / area.width) * 2 - 1, 1 - (y / area.height) * 2];
    const [perX, perY] = [area.width / 2, area.height / 2];
    const [m0, m1, m3, m4, m5, m7] = [0, 1, 3, 4, 5, 7].map((index) => matrix[index]);
    const [m8, m9, m11, m12, m13, m15] = [8, 9, 11, 12, 13, 15].map((index) => matrix[index]);
    let best = Infinity;
    let found = -1;
    for (let index = 0, at = 0; index < points.count; index++, at += 3) {
      const px = position[at];
      const py = position[at + 1];
      const pz = position[at + 2];
      const depth = m3 * px + m7 * py + m11 * pz + m15;
      if (depth < 0.1) continue;
      const dx = ((m0 * px + m4 * py + m8 * pz + m12) / depth - atX) * perX;
      const dy = ((m1 * px + m5 * py + m9 * pz + m13) / depth - atY) * perY;
      const off = dx * dx + dy * dy;
      if (off > REACH * REACH) continue;
      // What is nearer to the eye covers what is a little nearer to the pointer.
      const cost = off + 60 * Math.log(depth);
      if (cost < best) [best, found] = [cost, index];
    }
    if (found < 0) return null;
    const pixel = points.pixels[found];
    return { side: this.shown[place], pixel: pixel & ~OTHER, other: (pixel & OTHER) !== 0 };
  }

  /** Where a point of the sensor is over the canvas, in the first side that is shown: x, y and its depth. */
  place(point) {
    const area = this.area(0);
    const { pose } = this.sides[this.shown[0]];
    return project(this.camera.matrix(area.width / area.height), moved(pose, point), area);
  }

  /** Red, green and blue at a place over the canvas, drawn anew. */
  pixel(x, y) {
    const { gl, canvas } = this;
    this.touch();
    this.draw();
    const ratio = window.devicePixelRatio;
    const found = new Uint8Array(4);
    gl.readPixels(Math.floor(x * ratio), canvas.height - 1 - Math.floor(y * ratio), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
    return [...found.subarray(0, 3)];
  }

  listen() {
    const { overlay, camera } = this;
    const held = new Map();
    const at = (event) => ({ x: event.offsetX, y: event.offsetY });
    overlay.addEventListener("pointerdown", (event) => {
      overlay.focus({ preventScroll: true });
      overlay.setPointerCapture(event.pointerId);
      held.set(event.pointerId, { ...at(event), moved: 0, button: event.button, shift: event.shiftKey });
      // A second finger makes a pinch of it, which is no click.
      if (held.size > 1) for (const one of held.values()) one.moved = Infinity;
    });
    overlay.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      const now = at(event);
      this.pointer = now;
      if (before === undefined) return this.report("hover", this.pick(now.x, now.y));
      const [right, down] = [now.x - before.x, now.y - before.y];
      Object.assign(before, now, { moved: before.moved + Math.abs(right) + Math.abs(down) });
      const height = overlay.clientHeight;
      if (held.size === 2) {
        const other = [...held.values()].find((one) => one !== before);
        const apart = (x, y) => Math.max(10, Math.hypot(other.x - x, other.y - y));
        camera.zoom(apart(now.x - right, now.y - down) / apart(now.x, now.y));
        camera.pan(right / 2, down / 2, height);
      } else if (before.button !== 0 || before.shift) {
        camera.pan(right, down, height);
      } else {
        const speed = camera.distance === 0 ? camera.field / height : 3.5 / height;
        camera.turn(right * speed, down * speed);
      }
      this.touch();
    });
    const release = (event) => {
      const before = held.get(event.pointerId);
      held.delete(event.pointerId);
      const isClick = event.type === "pointerup" && before?.moved < 4 && before.button === 0;
      if (isClick) this.report("click", this.pick(before.x, before.y));
    };
    overlay.addEventListener("pointerup", release);
    overlay.addEventListener("pointercancel", release);
    overlay.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.report("leave", null);
    });
    overlay.addEventListener("contextmenu", (event) => event.preventDefault());
    overlay.addEventListener("wheel", (event) => {
      event.preventDefault();
      camera.zoom(Math.exp(event.deltaY * (event.deltaMode === 0 ? 0.0012 : 0.04)));
      this.touch();
    }, { passive: false });
    overlay.addEventListener("dblclick", () => this.look(camera.view));
  }

  /** Moves the camera by a key; gives whether the key means anything here. */
  key(event) {
    const { camera } = this;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[event.key];
    const view = Object.keys(VIEWS)[Number(event.key) - 1];
    if (arrow !== undefined && event.shiftKey) camera.pan(-arrow[0] * 30, -arrow[1] * 30, this.overlay.clientHeight);
    else if (arrow !== undefined) camera.turn(arrow[0] * 0.06, arrow[1] * 0.06);
    else if (event.key === "+" || event.key === "=") camera.zoom(0.87);
    else if (event.key === "-") camera.zoom(1.15);
    else if (view !== undefined) this.look(view);
    else return false;
    this.touch();
    return true;
  }
}

/** A sweep's points and lines on the graphics card. */
class Side {
  constructor() {
    this.sweep = null;
    /** The pose of the sensor in the frame that is drawn, null in its own; and the segments in that frame. */
    this.pose = null;
    this.segments = [];
    this.legend = null;
    this.points = new Points();
    this.floats = new Float32Array(0);
    this.words = new Uint32Array(0);
  }

  start(gl) {
    this.buffer = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const place of [0, 1, 2]) gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, WORDS * 4, 0);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, WORDS * 4, 12);
    gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_INT, WORDS * 4, 16);
    this.outlines = new Lines(gl);
    this.markedOutline = new Lines(gl);
  }

  reserve(points) {
    if (this.words.length >= points * WORDS) return;
    this.floats = new Float32Array(Math.ceil(points * 1.1) * WORDS);
    this.words = new Uint32Array(this.floats.buffer);
  }
}

/** Lines on the graphics card: pairs of vertices, each x, y, z and a packed colour. */
class Lines {
  constructor(gl) {
    this.count = 0;
    this.buffer = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 16, 0);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 16, 12);
  }

  fill(gl, vertices) {
    const floats = new Float32Array(vertices.length * 4);
    const words = new Uint32Array(floats.buffer);
    vertices.forEach(([x, y, z, colour], index) => {
      floats.set([x, y, z], index * 4);
      words[index * 4 + 3] = colour;
    });
    this.count = vertices.length;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, floats, gl.DYNAMIC_DRAW);
  }

  draw(gl) {
    if (this.count === 0) return;
    gl.bindVertexArray(this.array);
    gl.drawArrays(gl.LINES, 0, this.count);
  }
}

function program(gl, vertex, fragment, uniforms) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`the shaders do not link: ${gl.getProgramInfoLog(made)}`);
  }
  return { program: made, ...Object.fromEntries(uniforms.map((name) => [name, gl.getUniformLocation(made, name)])) };
}

/** How high the ground lies in the frame that is drawn, metres; a guess where the sweep does not know. */
function groundHeight({ sweep, pose }) {
  const depth = sweep === null || !(sweep.header.height_m > 0) ? 1.8 : sweep.header.height_m;
  return (pose === null ? 0 : pose[2][3]) - depth;
}

/** The direction up from the ground in the frame that is drawn; the sensor is rolled about y, then pitched about x. */
function plumb({ sweep, pose }) {
  if (sweep === null || pose !== null) return [0, 0, 1];
  const { pitch_rad: pitch, roll_rad: roll } = sweep.header;
  return [-Math.sin(roll) * Math.cos(pitch), Math.sin(pitch), Math.cos(roll) * Math.cos(pitch)];
}

/** The point of the ground below or above x, y. */
function level([upX, upY, upZ], x, y, height) {
  return [x, y, (height - upX * x - upY * y) / (Math.abs(upZ) > 0.2 ? upZ : 1)];
}

/** Gives each point of a side its colour, and what the legend says of it: colours, and ticks at 0 to 1. */
function paint(side, by) {
  const { sweep, points, words } = side;
  const { count, labels, pixels } = points;
  const { rows } = sweep;
  const each = (colourAt) => {
    for (let index = 0, at = 0; index < count; index++, at += WORDS) words[at + 3] = colourAt(index, at);
  };
  const planes = (index, first, second) => {
    const pixel = pixels[index];
    return (pixel & OTHER) === 0 ? first[pixel] : second[pixel & ~OTHER];
  };
  const ticks = (values, place, unit) => values.map((value) => [place(value), `${value}${unit}`]);
  if (by === "range") {
    const scale = palette.rangeScale(sweep);
    const colour = palette.rangeColours(scale);
    each((index) => colour(planes(index, sweep.range, sweep.range2)));
    const values = [];
    for (let value = scale.near; value <= scale.far * 1.0001; value = palette.roundUp(value * 1.01)) values.push(value);
    const place = (value) => Math.log(value / scale.near) / Math.log(scale.far / scale.near);
    return { colours: palette.RANGE, ticks: ticks(values.map((value) => Number(value.toPrecision(3))), place, " m") };
  }
  if (by === "reflectivity") {
    each((index) => palette.REFLECTIVITY[planes(index, sweep.reflectivity, sweep.reflectivity2)]);
    return { colours: palette.REFLECTIVITY, ticks: ticks([0, 50, 100, 175, 255], (value) => value / 255, "") };
  }
  if (by === "height") {
    const height = heights(side);
    const top = palette.roundUp(Math.max(1, mostly(height)));
    each((index) => palette.at(palette.LOW_TO_HIGH, height[index] / top));
    return { colours: palette.LOW_TO_HIGH, ticks: ticks([0, top / 2, top], (value) => value / top, " m") };
  }
  if (by === "ring") {
    each((index) => palette.at(palette.LOW_TO_HIGH, (rows - 1 - ((pixels[index] & ~OTHER) % rows)) / Math.max(1, rows - 1)));
    return { colours: palette.LOW_TO_HIGH, ticks: ticks([0, rows >> 1, rows - 1], (value) => value / Math.max(1, rows - 1), "") };
  }
  if (by === "time") {
    const whole = Math.max(1, Number(sweep.header.duration_ns));
    each((index) => {
      const pixel = pixels[index] & ~OTHER;
      const row = pixel % rows;
      return palette.at(palette.LOW_TO_HIGH, sweep.afterNs(row, (pixel - row) / rows) / whole);
    });
    return { colours: palette.LOW_TO_HIGH, ticks: [[0, "0 ms"], [1, `${(whole / 1e6).toFixed(0)} ms`]] };
  }
  if (by === "ground") {
    each((index) => {
      if (labels[index] === LABEL_GROUND) return palette.GROUND;
      return labels[index] >= LABEL_FIRST_SEGMENT ? palette.OBJECT : palette.UNLABELLED;
    });
    return { swatches: [[palette.GROUND, "ground"], [palette.OBJECT, "segments"], [palette.UNLABELLED, "no label"]] };
  }
  each((index) => (labels[index] === LABEL_GROUND ? palette.GROUND_FAINT : palette.label(labels[index])));
  return { swatches: [[palette.GROUND_FAINT, "ground"], [palette.UNLABELLED, "no label"], [palette.label(2), "a colour a segment"]] };
}

/** Heights of points over the ground, metres. */
function heights(side) {
  const { position, count } = side.points;
  const ground = groundHeight(side);
  const [x, y, z] = plumb(side);
  return Float32Array.from({ length: count }, (_, index) => {
    const at = 3 * index;
    return x * position[at] + y * position[at + 1] + z * position[at + 2] - ground;
  });
}

/** The value that nearly all are below. */
function mostly(values) {
  const step = Math.max(1, Math.floor(values.length / 2000));
  const some = values.filter((_, index) => index % step === 0).sort();
  return some.length === 0 ? 0 : some[Math.floor((some.length - 1) * 0.98)];
}

/** The boxes of segments. Those of walls and the like, which may hold others, are faint; wide segments have none. */
function boxes(segments) {
  return segments.flatMap((segment) => {
    const size = segment.max_m.map((most, axis) => most - segment.min_m[axis]);
    if (size[2] < 0.2 || isWide(segment)) return [];
    const alpha = Math.max(...size) > 8 ? 40 : 150;
    return outline(segment, ((palette.label(segment.label) & 0xffffff) | (alpha << 24)) >>> 0);
  });
}

function outline({ min_m: least, max_m: most }, colour) {
  const lines = new Array(SEGMENT_LINES);
  let at = 0;
  const corner = (bits) => [0, 1, 2].map((axis) => ((bits >> axis) & 1 ? most[axis] : least[axis]));
  for (let bits = 0; bits < 8; bits++) {
    for (let axis = 0; axis < 3; axis++) {
      if ((bits >> axis) & 1) continue;
      lines[at++] = [...corner(bits), colour];
      lines[at++] = [...corner(bits | (1 << axis)), colour];
    }
  }
  return lines;
}

/** The sensor: an arrow head that points forward. */
function drawSensor(context, matrix, area, pose) {
  const arrow = [[0, 0.9, 0], [0.5, -0.5, 0], [0, -0.25, 0], [-0.5, -0.5, 0]];
  const corners = arrow.map((at) => project(matrix, moved(pose, at), area));
  if (corners.some(([, , depth]) => depth < 0.1)) return;
  context.beginPath();
  corners.forEach(([x, y], index) => (index === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
  context.closePath();
  context.fillStyle = palette.TEXT;
  context.fill();
}

function ring(context, x, y) {
  for (const [width, colour] of [[4, "#000"], [1.5, "#fff"]]) {
    context.lineWidth = width;
    context.strokeStyle = colour;
    context.beginPath();
    context.arc(x, y, 8, 0, 2 * Math.PI);
    context.stroke();
  }
}
