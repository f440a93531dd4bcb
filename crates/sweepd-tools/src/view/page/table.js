// The table of segments: sortable. Only the rows in sight are in the document.

import * as palette from "./palette.js";

const ROW = 24;

/** The columns: heading, what it is sorted by, and its text. */
const COLUMNS = [
  ["label", (segment) => segment.label, String],
  ["nearest", (segment) => segment.nearest_m, (value) => value.toFixed(2)],
  ["azimuth", azimuthOf, (value) => `${value.toFixed(0)}°`],
  ["width", (segment) => spread(segment, 0), (value) => value.toFixed(1)],
  ["depth", (segment) => spread(segment, 1), (value) => value.toFixed(1)],
  ["height", (segment) => spread(segment, 2), (value) => value.toFixed(1)],
  ["points", (segment) => segment.points, String],
];
const TITLES = {
  nearest: "range of the nearest return, metres",
  azimuth: "direction of the middle, clockwise from forward",
  width: "along x, metres",
  depth: "along y, metres",
  height: "along z, metres",
};

export class Table {
  constructor(root, report) {
    this.root = root;
    this.report = report;
    this.sort = { column: -1, down: false };
    this.segments = [];
    this.marked = 0;
    this.rows = [];
    this.head = document.createElement("div");
    this.head.className = "row head";
    this.body = document.createElement("div");
    this.body.className = "rows";
    this.body.tabIndex = 0;
    this.body.setAttribute("role", "rowgroup");
    this.space = document.createElement("div");
    this.body.append(this.space);
    root.append(this.head, this.body);
    root.setAttribute("role", "table");
    COLUMNS.forEach(([name], index) => {
      const button = document.createElement("button");
      button.textContent = name;
      button.title = TITLES[name] ?? "";
      button.addEventListener("click", () => this.sortBy(index));
      this.head.append(button);
    });
    this.body.addEventListener("scroll", () => this.draw());
    this.body.addEventListener("pointermove", (event) => this.report("hover", labelUnder(event)));
    this.body.addEventListener("pointerleave", () => this.report("leave", null));
    this.body.addEventListener("click", (event) => this.report("click", labelUnder(event)));
    new ResizeObserver(() => this.draw()).observe(this.body);
    this.sortBy(1);
  }

  sortBy(column) {
    const isSame = this.sort.column === column;
    this.sort = { column, down: isSame ? !this.sort.down : column === COLUMNS.length - 1 };
    [...this.head.children].forEach((button, index) => {
      button.dataset.sorted = index === column ? (this.sort.down ? "down" : "up") : "";
    });
    this.order();
  }

  show(segments) {
    this.segments = [...segments];
    this.order();
  }

  order() {
    const [, key] = COLUMNS[this.sort.column];
    const sign = this.sort.down ? -1 : 1;
    this.segments.sort((one, other) => sign * (key(one) - key(other)) || one.label - other.label);
    this.draw();
  }

  /** Marks the row of a label, and brings it into sight if the mark came from elsewhere. */
  mark(label, fromHere) {
    const isOther = label !== this.marked;
    this.marked = label;
    const place = this.segments.findIndex((segment) => segment.label === label);
    if (place >= 0 && isOther && !fromHere) {
      const { scrollTop, clientHeight } = this.body;
      const isAbove = place * ROW < scrollTop;
      if (isAbove || (place + 1) * ROW > scrollTop + clientHeight) {
        this.body.scrollTop = Math.max(0, place * ROW - clientHeight / 2);
      }
    }
    this.draw();
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
  COLUMNS.forEach(([, key, text], index) => {
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
