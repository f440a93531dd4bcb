// What is shown, as files: the same PCD and CSV as `sweepd replay` writes, the sweep's bytes, and a picture.

import * as palette from "./palette.js";
import { KIND_LAST, KIND_SECOND_BLOCKS, MODE_DUAL, MODELS, moved } from "./sweep.js";

const POINT_BYTES = 26;
const CSV_HEADER =
  "packet,block,row,column,channel,return,azimuth_deg,elevation_deg,range_m,x_m,y_m,z_m,reflectivity,time_ns,label\n";
const RECORDS = 32;
const DEGREES = 180 / Math.PI;

/** All returns of a sweep with all their properties, in the order of the image and of a CSV; points in the frame of a pose. */
export function* returns(sweep, pose) {
  for (let column = 0; column < sweep.count; column++) {
    for (let row = 0; row < sweep.rows; row++) {
      for (const other of sweep.range2 === null ? [false] : [false, true]) {
        const found = sweep.at(row, column, other);
        if (found !== null) yield { ...found, point: moved(pose, found.point) };
      }
    }
  }
}

export function csv(sweep, pose) {
  const lines = [CSV_HEADER];
  const { header, beams, columns } = sweep;
  for (const found of returns(sweep, pose)) {
    const { row, column, azimuth, elevation, range, point, reflectivity, label, afterNs } = found;
    const firing = sweep.firedIn(row, column);
    const { channel } = beams[row];
    const degrees = four(azimuth * DEGREES);
    lines.push([
      columns.packet(firing),
      (columns.block[firing] + blocksAfter(sweep, found)) & 255,
      row,
      column,
      channel,
      found.kind === KIND_LAST ? "last" : "strongest",
      degrees === "360.0000" ? "0.0000" : degrees,
      four(elevation * DEGREES),
      four(range),
      ...Array.from(point, four),
      reflectivity,
      header.time_ns + BigInt(afterNs),
      label,
    ].join(",") + "\n");
  }
  return lines.join("");
}

/** Blocks from the first of a firing to that of a return. */
function blocksAfter(sweep, { row, column, other }) {
  const name = MODELS[sweep.header.model] ?? "";
  const banks = name === "VLS-128" ? 4 : name.startsWith("HDL-64E") ? 2 : 1;
  const isDual = sweep.header.return_mode === MODE_DUAL;
  const kind = sweep.kind?.[column * sweep.rows + row] ?? 0;
  const isSecond = sweep.kind !== null && ((kind & KIND_SECOND_BLOCKS) !== 0) !== other;
  const bank = Math.floor(sweep.beams[row].channel / RECORDS);
  const [bankStep, returnStep] = name === "VLS-128" ? [isDual ? 2 : 1, 1] : [1, banks];
  return bank * bankStep + (isSecond ? returnStep : 0);
}

/** Four decimals, never "-0.0000". */
function four(value) {
  const words = value.toFixed(4);
  return words === "-0.0000" ? "0.0000" : words;
}

export function pcd(sweep, pose) {
  // As they were measured; of those at once, the earlier firing and the higher row first.
  const firing = ({ row, column }) => sweep.firedIn(row, column);
  const all = [...returns(sweep, pose)].sort((one, other) =>
    one.afterNs - other.afterNs || firing(one) - firing(other) || one.row - other.row);
  const head =
    "# .PCD v0.7 - Point Cloud Data file format\n" +
    `# time 0 is ${sweep.header.time_ns} ns since 1970\n` +
    "VERSION 0.7\nFIELDS x y z intensity ring label time\nSIZE 4 4 4 4 2 4 4\nTYPE F F F F U U F\n" +
    `COUNT 1 1 1 1 1 1 1\nWIDTH ${all.length}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS ${all.length}\nDATA binary\n`;
  const view = new DataView(new ArrayBuffer(all.length * POINT_BYTES));
  all.forEach(({ point, reflectivity, row, label, afterNs }, index) => {
    const at = index * POINT_BYTES;
    [...point, reflectivity].forEach((value, field) => view.setFloat32(at + 4 * field, value, true));
    view.setUint16(at + 16, sweep.rows - 1 - row, true);
    view.setUint32(at + 18, label, true);
    view.setFloat32(at + 22, afterNs * 1e-9, true);
  });
  return new Blob([head, view.buffer]);
}

/** The view, the images and a line of words as one picture. */
export function png(cloud, images, words) {
  const ratio = window.devicePixelRatio;
  const [width, title, gap] = [cloud.canvas.width, 34 * ratio, 8 * ratio];
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = title + cloud.canvas.height + gap + images.canvas.height;
  const context = canvas.getContext("2d");
  context.fillStyle = "#14161c";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = palette.TEXT;
  context.font = `${13 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.fillText(words, 12 * ratio, title / 2);
  // What WebGL drew is there until the browser shows it: it is drawn anew and taken at once.
  cloud.touch();
  cloud.draw();
  context.drawImage(cloud.canvas, 0, title);
  context.drawImage(cloud.overlay, 0, title);
  context.drawImage(images.canvas, 0, title + cloud.canvas.height + gap);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
}

/** Gives a file to the person. */
export function offer(content, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
