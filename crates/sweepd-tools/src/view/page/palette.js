// The colours, one meaning each: those of the pictures that `sweepd replay --png` makes. A colour is a 32-bit number as
// canvas images and vertex buffers hold it, red in the lowest byte.

import { LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE } from "./sweep.js";

const pack = (r, g, b) => (r | (g << 8) | (b << 16) | (255 << 24)) >>> 0;

/** A packed colour for CSS. */
export function css(colour, alpha = 1) {
  return `rgb(${colour & 255} ${(colour >> 8) & 255} ${(colour >> 16) & 255} / ${alpha})`;
}

export const NO_RETURN = pack(6, 7, 10);
export const UNLABELLED = pack(62, 78, 118);
export const GROUND = pack(112, 112, 112);
/** Ground in space, where it is only the background of what stands on it. */
export const GROUND_FAINT = pack(66, 66, 68);
export const OBJECT = pack(255, 176, 64);
export const MISSING = pack(84, 12, 20);
export const MISSING_STRIPE = pack(40, 8, 12);
export const TEXT = "#e4e7ee";
export const DIM = "#9299aa";
export const GRID = "#343946";
export const WARNING = "#ffb040";
export const ACCENT = "#5ab0ff";

const STEPS = 512;

/** A colour of a table at 0 to 1. */
export function at(colours, position) {
  return colours[Math.round(Math.min(1, Math.max(0, position)) * (STEPS - 1))];
}

function gradient(stops) {
  return Uint32Array.from({ length: STEPS }, (_, step) => {
    const place = (step / (STEPS - 1)) * (stops.length - 1);
    const before = Math.min(Math.floor(place), stops.length - 2);
    const mixed = stops[before].map((value, index) => value + (stops[before + 1][index] - value) * (place - before));
    return pack(...mixed.map(Math.round));
  });
}

// Light to dark or dark to light all the way: people who do not tell red from green see the order too.
/** Ranges: warm near, cold far. */
export const RANGE = gradient([[255, 244, 150], [255, 190, 70], [246, 126, 76], [200, 90, 140], [116, 86, 190], [40, 76, 160]]);
/** Heights, rings and times. */
export const LOW_TO_HIGH = gradient([[70, 60, 150], [52, 110, 170], [36, 150, 150], [70, 190, 110], [180, 215, 60], [253, 231, 90]]);

/** Reflectivities: diffuse surfaces grey, up to 100; retro-reflectors warm. A colour for each value. */
export const REFLECTIVITY = Uint32Array.from({ length: 256 }, (_, value) => {
  const mix = (from, to, part) => pack(...from.map((start, index) => Math.round(start + (to[index] - start) * part)));
  return value < 100
    ? mix([34, 36, 42], [250, 250, 250], Math.sqrt(value / 100))
    : mix([190, 48, 24], [255, 236, 96], (value - 100) / 155);
});

/** Near numbers look different to everybody, see `sweepd_messages::palette`. */
const SEGMENTS = [
  [69, 124, 253], [249, 216, 252], [228, 73, 25], [12, 164, 160], [144, 179, 251], [184, 216, 33], [133, 106, 245],
  [254, 223, 185], [182, 119, 11], [254, 119, 166], [2, 197, 255], [252, 170, 43], [174, 89, 219], [126, 255, 232],
  [115, 136, 0], [242, 237, 43], [200, 174, 250], [121, 195, 22], [20, 134, 194], [184, 239, 254], [4, 152, 31],
  [180, 254, 111], [245, 146, 254], [209, 179, 36],
].map((colour) => pack(...colour));

/** Colour of a label; a number has the same colour everywhere. */
export function label(number) {
  if (number === LABEL_NONE) return UNLABELLED;
  return number === LABEL_GROUND ? GROUND : SEGMENTS[(number - LABEL_FIRST_SEGMENT) % SEGMENTS.length];
}

/** The next of 1, 2, 5, 10, 20, 50... from a positive value up. */
export function roundUp(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5].map((step) => step * decade).find((step) => step >= value * 0.999999) ?? 10 * decade;
}

function roundDown(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [5, 2].map((step) => step * decade).find((step) => step <= value * 1.000001) ?? decade;
}

const CENTIMETRES = new Uint32Array(40000);

/** The ends of a logarithmic scale over nearly all returns of a sweep, metres: round numbers, so that sweeps of one
 *  place share them. */
export function rangeScale(sweep) {
  CENTIMETRES.fill(0);
  let returns = 0;
  for (const range of sweep.range) {
    if (!(range > 0)) continue;
    CENTIMETRES[Math.min(CENTIMETRES.length - 1, Math.floor(range * 100))]++;
    returns++;
  }
  if (returns === 0) return { near: 1, far: 100 };
  const percentile = (part) => {
    let left = Math.floor((returns - 1) * part);
    return CENTIMETRES.findIndex((count) => (left -= count) < 0) / 100;
  };
  const near = Math.max(0.1, roundDown(Math.max(0.01, percentile(0.01))));
  return { near, far: Math.max(2 * near, roundUp(Math.max(0.01, percentile(0.99)))) };
}

/** A function from ranges to packed colours. */
export function rangeColours({ near, far }) {
  const factor = 1 / Math.log(far / near);
  return (range) => at(RANGE, Math.log(range / near) * factor);
}
