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

const channel = (value) => Math.floor(Math.min(255, Math.max(0, value)));

/** Turbo (A. Mikhailov), 0 to 1, as a polynomial. */
function turbo(t) {
  return pack(
    channel(34.61 + t * (1172.33 - t * (10793.56 - t * (33300.12 - t * (38394.49 - t * 14825.05))))),
    channel(23.31 + t * (557.33 + t * (1225.33 - t * (3574.96 - t * (1073.77 + t * 707.56))))),
    channel(27.2 + t * (3211.1 - t * (15327.97 - t * (27814 - t * (22569.18 - t * 6838.66))))),
  );
}

const STEPS = 512;
const table = (colourAt) => Uint32Array.from({ length: STEPS }, (_, step) => colourAt(step / (STEPS - 1)));

/** A colour of a table at 0 to 1. */
export function at(colours, position) {
  return colours[Math.round(Math.min(1, Math.max(0, position)) * (STEPS - 1))];
}

function gradient(stops) {
  return table((position) => {
    const place = position * (stops.length - 1);
    const before = Math.min(Math.floor(place), stops.length - 2);
    const mixed = stops[before].map((value, index) => value + (stops[before + 1][index] - value) * (place - before));
    return pack(...mixed.map(Math.round));
  });
}

/** Ranges: warm near, cold far. The ends of Turbo are too dark to be seen on the page. */
export const RANGE = table((position) => turbo(0.92 - 0.84 * position));
export const HEIGHT = gradient([[70, 60, 150], [52, 110, 170], [36, 150, 150], [70, 190, 110], [180, 215, 60], [253, 231, 90]]);
export const TIME = gradient([[60, 60, 200], [140, 40, 180], [210, 70, 120], [245, 135, 70], [250, 230, 90]]);
export const RING = gradient([[240, 120, 90], [235, 190, 90], [130, 205, 120], [80, 180, 215], [140, 120, 235]]);

/** Reflectivities: diffuse surfaces grey, up to 100; retro-reflectors warm. A colour for each value. */
export const REFLECTIVITY = Uint32Array.from({ length: 256 }, (_, value) => {
  const mix = (from, to, part) => pack(...from.map((start, index) => Math.round(start + (to[index] - start) * part)));
  return value < 100
    ? mix([34, 36, 42], [250, 250, 250], Math.sqrt(value / 100))
    : mix([190, 48, 24], [255, 236, 96], (value - 100) / 155);
});

const SEGMENTS = Uint32Array.from({ length: 1000 }, (_, index) => {
  const turns = (index * 0.618034 + 0.35) % 1;
  return vivid([0.78, 0.62, 0.89, 0.7][index % 4], turns * 2 * Math.PI);
});

/** Colour of a label; a number has the same colour everywhere. */
export function label(number) {
  if (number === LABEL_NONE) return UNLABELLED;
  return number === LABEL_GROUND ? GROUND : SEGMENTS[(number - LABEL_FIRST_SEGMENT) % SEGMENTS.length];
}

/** The most saturated colour of this lightness and hue that a screen shows, limited so that it does not glare. */
function vivid(lightness, hue) {
  for (let chroma = 19; chroma >= 4; chroma--) {
    const shown = oklch(lightness, chroma * 0.01, hue);
    if (shown.every((part) => part >= 0 && part <= 1)) return pack(...shown.map(srgb));
  }
  return pack(...[lightness, lightness, lightness].map(srgb));
}

function srgb(linear) {
  return Math.round(255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055));
}

/** OKLCH to linear sRGB (B. Ottosson, "A perceptual color space for image processing", 2020). */
function oklch(lightness, chroma, hue) {
  const [a, b] = [chroma * Math.cos(hue), chroma * Math.sin(hue)];
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
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
