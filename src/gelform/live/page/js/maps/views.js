// The maps that a pane can show: which planes they need, how a pixel gets its colour, what the legend says.

import { packedRamp, rgb } from "./colors.js";
import { eachNormal } from "./normals.js";

const OPAQUE = 0xff000000; // of an ImageData seen as 32 bits, little end first
const pack = (r, g, b) => OPAQUE | (b << 16) | (g << 8) | r;

/** Paints values from low to high with the colours of a map. */
function ramped(name, low, high) {
  return (frame, pixels, settings) => {
    const map = frame.map(name), colors = packedRamp.cached(settings.colors), [from, to] = [low(settings), high(settings)];
    const { values, step } = map, scale = (255 * step) / (to - from || 1), least = map.zero + from / step;
    for (let k = 0; k < pixels.length; k++) {
      const level = (values[k] - least) * scale;
      pixels[k] = colors[level <= 0 ? 0 : level >= 255 ? 255 : level | 0];
    }
  };
}

const kept = {};
packedRamp.cached = (name) => (kept[name] ??= packedRamp(name));

function paintImage(frame, pixels) {
  const { values, kind } = frame.planes.image;
  if (kind === "rgb") for (let k = 0, at = 0; k < pixels.length; k++, at += 3) pixels[k] = pack(values[at], values[at + 1], values[at + 2]);
}

function paintNormals(frame, pixels) {
  const map = frame.map("depth"), [x, y] = frame.pitch(map);
  eachNormal(map, x, y, (k, nx, ny, nz) => (pixels[k] = pack((127.5 + 127.5 * nx) | 0, (127.5 + 127.5 * ny) | 0, (127.5 + 127.5 * nz) | 0)));
}

function paintOther(frame, pixels, settings) {
  const a = frame.map("depth"), b = frame.map("other"), scale = (255 * 5) / (settings.range || 1);
  for (let k = 0; k < pixels.length; k++) { // blue: the other is deeper, orange: this one is
    const level = Math.max(-255, Math.min(255, ((a.values[k] - a.zero) * a.step - (b.values[k] - b.zero) * b.step) * scale)), part = Math.abs(level) / 255;
    pixels[k] = level > 0 ? pack(255 - 25 * part, 255 - 96 * part, 255 - 255 * part) : pack(255 - 255 * part, 255 - 141 * part, 255 - 77 * part);
  }
}

function paintCauses(frame, pixels, settings) {
  const bits = frame.planes.causes.values;
  const image = frame.planes.image?.kind === "rgb" && frame.planes.image.width === frame.planes.causes.width ? frame.planes.image.values : null;
  const colors = (frame.header.cause_colors ?? []).map((color) => pack(...rgb(color)));
  for (let k = 0; k < pixels.length; k++) {
    const first = bits[k] ? Math.log2(bits[k] & -bits[k]) : -1;
    const grey = image ? (image[3 * k] * 2 + image[3 * k + 1] * 5 + image[3 * k + 2]) >> 4 : 40;
    pixels[k] = first >= 0 ? colors[first] : pack(grey, grey, grey);
  }
}

export const VIEWS = {
  depth: { title: "Depth", planes: ["depth"], from: "depth", paint: ramped("depth", () => 0, (s) => s.range), legend: (s, f) => ({ colors: s.colors, low: "0", high: `${s.range.toPrecision(2)} ${f.unit}` }) },
  image: { title: "Camera", planes: ["image"], from: "image", paint: paintImage, legend: (s, f) => ({ text: s.plain ? "yellow: press here; white: what is pressed now" : f.header.simulated ? "click to press here" : "as the calibration's view shows it" }) },
  normals: { title: "Normals", planes: ["depth"], from: "depth", paint: paintNormals, legend: () => ({ text: "red: x to the right, green: y down, blue: towards the camera" }) },
  confidence: { title: "Confidence", planes: ["confidence"], from: "confidence", paint: ramped("confidence", () => 0, () => 1), legend: (s) => ({ colors: s.colors, low: "0", high: "1" }) },
  sigma: { title: "Uncertainty", planes: ["sigma"], from: "sigma", paint: ramped("sigma", () => 0, () => 0.1), legend: (s) => ({ colors: s.colors, low: "0", high: "0.1 mm" }) },
  causes: { title: "Why not trusted", planes: ["causes", "image"], from: "causes", paint: paintCauses, legend: (s, f) => ({ swatches: (f.header.causes ?? []).map((name, k) => [f.header.cause_colors[k].slice(1), name.replace("_", " ")]) }) },
  other: { title: "Other calibration", planes: ["other"], from: "other", paint: ramped("other", () => 0, (s) => s.range), legend: (s, f) => ({ colors: s.colors, low: `deepest ${f.header.other?.peak.toFixed(3)} ${f.unit}; 0`, high: `${s.range.toPrecision(2)} ${f.unit}` }) },
  difference: { title: "Difference", planes: ["depth", "other"], from: "depth", paint: paintOther, legend: (s, f) => ({ text: `orange: deeper than by the other, blue: less deep; full colour at ${(s.range / 5).toPrecision(2)} ${f.unit}; apart by ${f.header.other?.apart?.toFixed(4)} ${f.unit} (RMS)` }) },
};
