// The maps that a pane can show: the planes that they need, the color of a pixel, whether unknown pixels are hatched, the legend.

// viridis and cividis grow evenly in lightness, so they read the same to the color-blind and in gray.
const ANCHORS = {
  viridis: "440154 481769 472a7a 433d84 3d4e8a 355e8d 2e6d8e 297b8e 23898e 1f978b 21a585 2eb37c 46c06f 65cb5e 89d548 b0dd2f d8e219 fde725",
  cividis: "00224e 002d68 163770 2e416d 3f4c6c 4e566c 5c616e 696b71 767676 838179 928c78 a09875 afa471 bfb06b cfbd62 dfca57 f0d846 fee838",
  gray: "101010 f4f4f4",
};
export const MAP_NAMES = Object.keys(ANCHORS);

function channels(hex) { return [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16)); }

/** 256 colors [r, g, b] of a map. */
export function ramp(name) {
  const anchors = ANCHORS[name].split(" ").map(channels);
  return Array.from({ length: 256 }, (_, k) => {
    const at = (k / 255) * (anchors.length - 1), low = Math.min(Math.floor(at), anchors.length - 2);
    return anchors[low].map((from, c) => Math.round(from + (anchors[low + 1][c] - from) * (at - low)));
  });
}

/** The same as pixels of an ImageData, in the machine's byte order (alpha last in memory). */
export const packedRamp = (name) => (packed[name] ??= new Uint32Array(new Uint8Array(ramp(name).flatMap((rgb) => [...rgb, 255])).buffer));
const packed = {};

/** [r, g, b] of "#rrggbb". */
const rgb = (color) => channels(color.slice(1));

/**
 * Calls back(index, nx, ny, nz) with the unit normal of every pixel, as `gelform.normals_from_gradients(gelform.gradients_from_depth(...))`
 * gives it: (-dz/dx, -dz/dy, 1) / norm, z towards the camera; differences of second order, one-sided at the border.
 */
export function eachNormal(map, pitchX, pitchY, back) {
  const { width, height, values, step } = map, perX = step / (2 * pitchX), perY = step / (2 * pitchY);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const at = row * width + column;
      const p = difference(values, at, 1, column, width) * perX, q = difference(values, at, width, row, height) * perY;
      const norm = 1 / Math.sqrt(p * p + q * q + 1);
      back(at, -p * norm, -q * norm, norm);
    }
  }
}

/** The difference over two pixels about one, which is at `place` of a row or column of `size` (3 or more) with neighbors `next` apart. */
function difference(values, at, next, place, size) {
  if (place > 0 && place < size - 1) return values[at + next] - values[at - next];
  const inward = place === 0 ? next : -next, sum = 4 * values[at + inward] - 3 * values[at] - values[at + 2 * inward];
  return place === 0 ? sum : -sum;
}

const OPAQUE = 0xff000000; // of an ImageData seen as 32 bits, little end first
const pack = (r, g, b) => OPAQUE | (b << 16) | (g << 8) | r;

/** Paints values from low to high with the colors of a map. */
function ramped(name, low, high) {
  return (frame, pixels, settings) => {
    const map = frame.map(name), colors = packedRamp(settings.colors), [from, to] = [low(settings), high(settings)];
    const { values, step } = map, scale = (255 * step) / (to - from || 1), least = map.zero + from / step;
    for (let k = 0; k < pixels.length; k++) {
      const level = (values[k] - least) * scale;
      pixels[k] = colors[level <= 0 ? 0 : level >= 255 ? 255 : level | 0];
    }
  };
}

function paintImage(frame, pixels) {
  const { values, kind } = frame.planes.image;
  if (kind === "rgb") for (let k = 0, at = 0; k < pixels.length; k++, at += 3) pixels[k] = pack(values[at], values[at + 1], values[at + 2]);
}

function paintNormals(frame, pixels) {
  const map = frame.map("depth"), [x, y] = frame.pitch(map);
  eachNormal(map, x, y, (k, nx, ny, nz) => (pixels[k] = pack((127.5 + 127.5 * nx) | 0, (127.5 + 127.5 * ny) | 0, (127.5 + 127.5 * nz) | 0)));
}

function paintCauses(frame, pixels, settings) {
  const bits = frame.planes.causes.values;
  const image = frame.planes.image?.kind === "rgb" && frame.planes.image.width === frame.planes.causes.width ? frame.planes.image.values : null;
  const colors = (frame.header.cause_colors ?? []).map((color) => pack(...rgb(color)));
  for (let k = 0; k < pixels.length; k++) {
    const first = bits[k] ? Math.log2(bits[k] & -bits[k]) : -1;
    const gray = image ? (image[3 * k] * 2 + image[3 * k + 1] * 5 + image[3 * k + 2]) >> 4 : 40;
    pixels[k] = first >= 0 ? colors[first] : pack(gray, gray, gray);
  }
}

const GUIDE_LEGENDS = { press: "Yellow: press at 1, then at 2 and 3. White: contact now.", report: "Yellow: the places 1, 2 and 3 of the report, to press next. Gray: the presses so far." };

export const VIEWS = {
  depth: { title: "Depth", planes: ["depth"], from: "depth", paint: ramped("depth", () => 0, (s) => s.range), unknown: true, legend: (s, f) => ({ colors: s.colors, low: "0", high: `${s.range.toPrecision(2)} ${f.unit}` }) },
  image: { title: "Camera", planes: ["image"], from: "image", paint: paintImage, legend: (s, f) => ({ text: GUIDE_LEGENDS[s.guide] ?? (f.header.simulated ? "Click to press here." : "The image, after crop, flip and resizing.") }) },
  normals: { title: "Normals", planes: ["depth"], from: "depth", paint: paintNormals, unknown: true, legend: () => ({ text: "Red: x to the right. Green: y down. Blue: toward the camera." }) },
  confidence: { title: "Confidence", planes: ["confidence"], from: "confidence", paint: ramped("confidence", () => 0, () => 1), legend: (s) => ({ colors: s.colors, low: "0", high: "1" }) },
  sigma: { title: "Uncertainty", planes: ["sigma"], from: "sigma", paint: ramped("sigma", () => 0, () => 0.1), unknown: true, legend: (s) => ({ colors: s.colors, low: "0", high: "0.1 mm" }) },
  causes: { title: "Causes of low confidence", planes: ["causes", "image"], from: "causes", paint: paintCauses, legend: (s, f) => ({ swatches: (f.header.causes ?? []).map((name, k) => [f.header.cause_colors[k].slice(1), name.replace("_", " ")]) }) },
};
