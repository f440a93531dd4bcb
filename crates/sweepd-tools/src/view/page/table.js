// The table of segments: sortable. Only the rows in sight are in the document.

import * as palette from "./palette.js";

const ROW = 24;

/** The columns: heading and unit, what it is sorted by, its text, and what it is. */
const COLUMNS = [
  ["label", "", (segment) => segment.label, String, ""],
  ["nearest", "m", (segment) => segment.nearest_m, (value) => value.toFixed(2), "range of the nearest return"],
  ["azimuth", "°", azimuthOf, (value) => value.toFixed(0), "direction of the middle, clockwise from forward"],
  ["width", "m", (segment) => spread(segment, 0), (value) => value.toFixed(1), "along x"],
  ["depth", "m", (segment) => spread(segment, 1), (value) => value.toFixed(1), "along y"],
  ["height", "m", (segment) => spread(segment, 2), (value) => value.toFixed(1), "along z"],
  ["points", "", (segment) => segment.points, String, ""],
];

export class Table {
  constructor(root, report) {
    this.root = root;
    this.report = report;
    this.sort = { column: -1, down: false };
    this.segments = [];
    this.marked = 0;
    this.rows = [];
    this.head = root.querySelector(".head");
    this.body = root.querySelector(".rows");
    this.space = document.createElement("div");
    this.body.append(this.space);
    COLUMNS.forEach(([name, unit, , , title], index) => {
      const cell = document.createElement("span");
      cell.setAttribute("role", "columnheader");
      const button = document.createElement("button");
      const of = document.createElement("small");
      of.textContent = unit;
      button.append(name, of);
      button.title = title;
      button.addEventListener("click", () => this.sortBy(index));
      cell.append(button);
      this.head.append(cell);
    });
    this.body.addEventListener("scroll", () => this.draw());
    this.body.addEventListener("pointermove", (event) => this.report("hover", labelUnder(event)));
    this.body.addEventListener("pointerleave", () => this.report("leave", null));
    this.body.addEventListener("click", (event) => this.report("click", labelUnder(event)));
    this.body.addEventListener("keydown", (event) => this.key(event));
    this.body.addEventListener("blur", () => this.report("leave", null));
    new ResizeObserver(() => this.draw()).observe(this.body);
    this.sortBy(1);
  }

  sortBy(column) {
    const isSame = this.sort.column === column;
    this.sort = { column, down: isSame ? !this.sort.down : column === COLUMNS.length - 1 };
    [...this.head.children].forEach((cell, index) => {
      if (index === column) cell.setAttribute("aria-sort", this.sort.down ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
    this.order();
  }

  /** Goes through the rows; Enter is a click. */
  key(event) {
    const steps = { ArrowUp: -1, ArrowDown: 1, PageUp: -10, PageDown: 10, Home: -Infinity, End: Infinity };
    if (!(event.key in steps) && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    if (event.key === "Enter") return this.report("click", this.marked === 0 ? null : this.marked);
    const last = this.segments.length - 1;
    if (last < 0) return;
    const place = Math.min(last, Math.max(0, this.placeOf(this.marked) + steps[event.key]));
    this.reveal(place);
    this.report("hover", this.segments[place].label);
  }

  placeOf(label) {
    return this.segments.findIndex((segment) => segment.label === label);
  }

  show(segments) {
    this.segments = [...segments];
    this.root.classList.toggle("empty", segments.length === 0);
    this.order();
  }

  order() {
    const [, , key] = COLUMNS[this.sort.column];
    const sign = this.sort.down ? -1 : 1;
    this.segments.sort((one, other) => sign * (key(one) - key(other)) || one.label - other.label);
    this.draw();
  }

  /** Marks the row of a label, and brings it into sight if the mark came from elsewhere. */
  mark(label, fromHere) {
    const isOther = label !== this.marked;
    this.marked = label;
    const place = this.placeOf(label);
    if (place >= 0 && isOther && !fromHere) this.reveal(place);
    this.draw();
  }

  /** Brings a row into sight. */
  reveal(place) {
    const { scrollTop, clientHeight } = this.body;
    const isInSight = place * ROW >= scrollTop && (place + 1) * ROW <= scrollTop + clientHeight;
    if (!isInSight) this.body.scrollTop = Math.max(0, place * ROW - clientHeight / 2);
  }

  draw() {
    const { body, segments } = this;
    const first = Math.max(0, Math.floor(body.scrollTop / ROW));
    const count = Math.ceil(body.clientHeight / ROW) + 1;
    this.space.style.height = `${segments.length * ROW}px`;
    while (this.rows.length < count) this.rows.push(newRow(body));
    this.rows.forEach((row, index) => fill(row, index < count ? segments[first + index] : undefined, first + index, this.marked));
  }
}

function newRow(body) {
  const line = document.createElement("div");
  line.className = "row";
  line.setAttribute("role", "row");
  const cells = COLUMNS.map(() => document.createElement("span"));
  for (const cell of cells) cell.setAttribute("role", "gridcell");
  const swatch = document.createElement("i");
  const number = document.createTextNode("");
  cells[0].append(swatch, number);
  line.append(...cells);
  body.append(line);
  return { line, cells, swatch, number, texts: [] };
}

function fill(row, segment, place, marked) {
  row.line.hidden = segment === undefined;
  if (segment === undefined) return;
  row.line.style.transform = `translateY(${place * ROW}px)`;
  row.line.dataset.label = segment.label;
  row.line.classList.toggle("marked", segment.label === marked);
  row.line.setAttribute("aria-selected", String(segment.label === marked));
  COLUMNS.forEach(([, , key, text], index) => {
    const words = text(key(segment));
    if (row.texts[index] === words) return;
    row.texts[index] = words;
    if (index > 0) row.cells[index].textContent = words;
    else row.number.data = words;
  });
  row.swatch.style.background = palette.css(palette.label(segment.label));
}

function labelUnder(event) {
  const line = event.target.closest?.(".row");
  return line === null || line === undefined ? null : Number(line.dataset.label);
}

function spread(segment, axis) {
  return segment.max_m[axis] - segment.min_m[axis];
}

function azimuthOf(segment) {
  const [x, y] = segment.centroid_m;
  return ((Math.atan2(x, y) * 180) / Math.PI + 360) % 360;
}
