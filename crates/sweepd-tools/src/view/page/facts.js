// Words about what is shown: the facts of a sweep and of the sensor, and what the selection is.

import {
  BLANKED, BLIND, CIRCULAR, CHOICE_LAST, CHOICE_STRONGEST, COVERED, DARK_BELOW, FADED, FROZEN, HEIGHT_ESTIMATED, HEIGHT_IN_DOUBT,
  KIND_LAST, LABEL_GROUND, LABEL_NONE, LOSS_ESTIMATED, MODELS, MODE_DUAL, MODE_LAST, PARTIAL, RATE_UNSTABLE, REVERSED, STOPPED, TIME_GPS,
  isWide, moved, movedSegment,
} from "./sweep.js";
import * as palette from "./palette.js";

const DEGREES = 180 / Math.PI;
const FLAGS = [
  [PARTIAL, "part of a turn"],
  [REVERSED, "turns counter-clockwise"],
  [BLANKED, "a sector is left out"],
  [RATE_UNSTABLE, "turning rate unstable"],
  [STOPPED, "the head stands still"],
  [LOSS_ESTIMATED, "losses estimated"],
  [BLIND, "blind: hardly a return"],
  [COVERED, "covered: all is near"],
  [FROZEN, "frozen: turns are alike"],
  [FADED, "faded: far fewer returns"],
  [DARK_BELOW, "dark below the horizon"],
];

/** "0.46 m", with a minus as people write it. */
function metres(value, decimals = 2) {
  return `${signed(value, decimals)} m`;
}

function signed(value, decimals) {
  return value.toFixed(decimals).replace("-", "\u2212");
}

/** A time since 1970 in nanoseconds, to the millisecond. */
export function utc(ns) {
  return new Date(Number(ns / 1000000n)).toISOString().replace("T", " ").replace("Z", " UTC");
}

export function model(sweep) {
  return MODELS[sweep.header.model] ?? MODELS[0];
}

export class Facts {
  /** `list` holds names and values; `selection` the card of what is pointed at. */
  constructor(list, selection) {
    this.list = new Pairs(list);
    this.values = new Map();
    for (const value of selection.querySelectorAll("[data-value]")) this.values.set(value.dataset.value, value);
    this.card = selection;
    this.select(null, null, null);
  }

  /** The facts of a sweep, of its stages, and those that the server counts. */
  show(sweep, { missed = 0, doubt }, server, latency) {
    const { header } = sweep;
    const share = (100 * header.ground) / Math.max(1, header.returns);
    const choice = { [CHOICE_STRONGEST]: "strongest", [CHOICE_LAST]: "last" }[header.return_choice] ?? "nearest";
    const mode = header.return_mode === MODE_DUAL ? `two, ${choice} segmented` : header.return_mode === MODE_LAST ? "last" : "strongest";
    const degrees = (angle) => `${signed(angle * DEGREES, 1)}°`;
    const words = FLAGS.filter(([flag]) => sweep.has(flag)).map(([, text]) => text).concat(doubt ?? []);
    const basis = sweep.has(HEIGHT_ESTIMATED) ? `, estimated${sweep.has(HEIGHT_IN_DOUBT) ? ", in doubt" : ""}` : "";
    const height = header.height_m > 0 ? `${header.height_m.toFixed(2)} m${basis}` : "unknown";
    const micros = (value) => (value >= 1000 ? `${(value / 1000).toFixed(1)} ms` : `${Math.round(value)} µs`);
    const taken = { decode: header.decode_ns / 1e3, ground: header.ground_ns / 1e3, label: header.label_ns / 1e3 };
    const isTimed = Object.values(taken).some((value) => value > 0);
    const known = {
      model: model(sweep),
      from: header.sensor,
      time: utc(header.time_ns),
      clock: header.time_source === TIME_GPS ? "GPS" : "host",
      rpm: `${header.rpm.toFixed(1)}${sweep.has(CIRCULAR) ? "" : ", not a whole turn"}`,
      image: `${sweep.rows} rows × ${sweep.count} columns`,
      returns: `${header.returns.toLocaleString("en")}, ${mode}`,
      ground: `${share.toFixed(0)} %`,
      segments: String(header.segments),
      packets: String(header.packets),
      "packets lost": String(header.lost_packets),
      "columns missing": String(header.missing_columns),
      dropped: `${header.dropped_datagrams} by the kernel`,
      height,
      mounting: `pitch ${degrees(header.pitch_rad)}, roll ${degrees(header.roll_rad)}`,
      remarks: words.join(", ") || "none",
      stages: isTimed ? Object.entries(taken).map(([name, value]) => `${name} ${micros(value)}`).join(", ") : "not timed",
      missed: `${missed} sweeps by this page`,
      latency: `${latency.toFixed(1)} ms`,
    };
    this.list.show({ ...known, ...server });
  }

  /** What is pointed at: a pixel's return, a segment, or nothing; lengths in the frame of a pose. */
  select(selection, sweep, pose) {
    const put = (key, text) => {
      const value = this.values.get(key);
      if (value.textContent !== text) value.textContent = text;
    };
    const { found, label } = selection ?? {};
    const segment = selection?.segment && movedSegment(pose, selection.segment);
    this.card.classList.toggle("empty", selection === null);
    this.card.classList.toggle("pinned", selection?.pinned ?? false);
    put("range", found ? `${found.range.toFixed(3)} m` : "–");
    put("azimuth", found ? `${(found.azimuth * DEGREES).toFixed(2)}°` : "–");
    put("elevation", found ? `${signed(found.elevation * DEGREES, 2)}°` : "–");
    put("time", found ? `+${(found.afterNs / 1e6).toFixed(3)} ms` : "–");
    put("ring", found ? `${sweep.rows - 1 - found.row}` : "–");
    const kind = found?.kind === KIND_LAST ? "last" : "strongest";
    put("pixel", found ? `row ${found.row}, column ${found.column}, ${kind}` : "–");
    put("reflectivity", found ? `${found.reflectivity}` : "–");
    put("place", found ? [...moved(pose, found.point)].map((value) => signed(value, 3)).join("  ") + " m" : "–");
    const name = label === undefined ? "–" : label === LABEL_NONE ? "no label" : label === LABEL_GROUND ? "ground" : `segment ${label}`;
    put("label", found === null && selection !== null && segment === undefined ? "no return" : name);
    const size = segment && segment.max_m.map((most, axis) => (most - segment.min_m[axis]).toFixed(1)).join(" × ");
    put("size", segment ? `${size} m${isWide(segment) ? ", wide" : ""}` : "–");
    put("points", segment ? `${segment.points}, nearest ${metres(segment.nearest_m)}` : "–");
    const swatch = this.values.get("label").previousElementSibling;
    swatch.style.background = label === undefined ? "transparent" : palette.css(palette.label(label));
  }
}

/** A list of names and values of which only what changed is written. */
class Pairs {
  constructor(root) {
    this.root = root;
    this.cells = new Map();
  }

  show(pairs) {
    for (const [name, text] of Object.entries(pairs)) {
      let cell = this.cells.get(name);
      if (cell === undefined) {
        const term = document.createElement("dt");
        term.textContent = name;
        cell = document.createElement("dd");
        this.root.append(term, cell);
        this.cells.set(name, cell);
      }
      if (cell.textContent !== text) cell.textContent = text;
    }
  }
}
