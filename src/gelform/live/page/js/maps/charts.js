// Line charts on canvases: profiles, a number against time, a line behind a number.

import { byId, element, fit, fixed, setText, sizeOf } from "../page/dom.js";

const LEFT = 58, BOTTOM = 24, TOP = 10, RIGHT = 12, LEGEND = 18; // px around the plot; height of the legend

const styles = (names) => { const all = getComputedStyle(document.documentElement); return names.map((name) => all.getPropertyValue(`--${name}`).trim()); };

function prepared(canvas) {
  const scale = Math.min(2, devicePixelRatio || 1), { width, height } = sizeOf(canvas);
  fit(canvas, scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** Round numbers between low and high, about `count` of them. */
function ticks(low, high, count = 4) {
  const rough = (high - low) / count || 1, decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * decade).find((s) => s >= rough);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => Number(((first + k) * step).toPrecision(10)));
}

/** `lines`: [{x, y, color, name}] of equal-length arrays; `mark`: x of a vertical line. */
export function drawChart(canvas, lines, { xUnit, yUnit, xRange, yLeast = 0.1, mark = null, ink = null }) {
  const { context, width, height } = prepared(canvas), [soft, grid] = styles(["soft", "grid"]);
  if (!width) return;
  const all = lines.flatMap((line) => Array.from(line.y)).filter((v) => !Number.isNaN(v));
  const high = Math.max(yLeast, ...all) * 1.08, low = Math.min(0, ...all) * 1.1 - 0.03 * high;
  const toX = (v) => LEFT + ((v - xRange[0]) / (xRange[1] - xRange[0] || 1)) * (width - LEFT - RIGHT);
  const top = lines.some(({ name }) => name) ? TOP + LEGEND : TOP; // below the legend
  const toY = (v) => height - BOTTOM - ((v - low) / (high - low)) * (height - BOTTOM - top);
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = soft;
  context.strokeStyle = grid;
  context.lineWidth = 1;
  context.textAlign = "right";
  const marks = ticks(low, high);
  marks.forEach((v, k) => { line(context, LEFT, toY(v), width - RIGHT, toY(v)); context.fillText(`${v}${k === marks.length - 1 ? ` ${yUnit}` : ""}`, LEFT - 6, toY(v) + 4); });
  context.textAlign = "center";
  const below = ticks(...xRange, 5);
  below.forEach((v, k) => {
    const text = `${v}${k === below.length - 1 ? ` ${xUnit}` : ""}`;
    context.fillText(text, Math.min(width - RIGHT / 2 - context.measureText(text).width / 2, toX(v)), height - 8);
  });
  if (mark !== null) { context.setLineDash([3, 3]); context.strokeStyle = soft; line(context, toX(mark), top, toX(mark), height - BOTTOM); context.setLineDash([]); }
  lines.forEach((one, k) => trace(context, one, toX, toY, k));
  legend(context, lines, width, ink ?? soft);
}

function trace(context, { x, y, color }, toX, toY, nth) {
  context.strokeStyle = styles([color])[0];
  context.lineWidth = 2;
  if (nth % 2) context.setLineDash([7, 3]); // told apart without colors too
  context.beginPath();
  for (let k = 0; k < y.length; k++) if (!Number.isNaN(y[k])) context[k && !Number.isNaN(y[k - 1]) ? "lineTo" : "moveTo"](toX(x[k]), toY(y[k])); // interrupted where nothing is known
  context.stroke();
  context.setLineDash([]);
}

function legend(context, lines, width, ink) {
  context.textAlign = "left";
  let at = width - RIGHT - lines.reduce((sum, { name }) => sum + (name ? context.measureText(name).width + 34 : 0), 0);
  lines.forEach(({ name, color }, k) => {
    if (!name) return;
    context.strokeStyle = styles([color])[0];
    context.lineWidth = 2;
    if (k % 2) context.setLineDash([5, 2]);
    line(context, at, TOP + 4, at + 16, TOP + 4);
    context.setLineDash([]);
    context.fillStyle = ink;
    context.fillText(name, at + 20, TOP + 8);
    at += context.measureText(name).width + 34;
  });
}

/** The least and the largest of the values in each of so many parts of their time: as good as all of them on a screen. */
export function thinned(time, values, parts) {
  if (values.length <= 2 * parts) return { time, values };
  const kept = [], from = time[0], per = (time[time.length - 1] - from) / parts || 1;
  for (let start = 0; start < time.length; ) {
    const part = Math.floor((time[start] - from) / per);
    let low = start, high = start, k = start;
    for (; k < time.length && Math.floor((time[k] - from) / per) === part; k++) {
      if (values[k] < values[low]) low = k;
      if (values[k] > values[high]) high = k;
    }
    kept.push(...(low === high ? [low] : [Math.min(low, high), Math.max(low, high)]));
    start = k;
  }
  return { time: kept.map((k) => time[k]), values: kept.map((k) => values[k]) };
}

/** A line without axes. */
function drawSpark(canvas, values, least) {
  const { context, width, height } = prepared(canvas);
  if (!width || values.length < 2) return;
  const high = Math.max(least, ...values), low = Math.min(0, ...values);
  context.strokeStyle = styles(["series-a"])[0];
  context.lineWidth = 1.5;
  context.beginPath();
  values.forEach((v, k) => context[k ? "lineTo" : "moveTo"]((k / (values.length - 1)) * width, height - 2 - ((v - low) / (high - low)) * (height - 4)));
  context.stroke();
}

function line(context, x1, y1, x2, y2) { context.beginPath(); context.moveTo(x1, y1); context.lineTo(x2, y2); context.stroke(); }

/** Which point the profile goes through. */
export class Pointer {
  constructor(changed) {
    this.changed = changed;
    this.pinned = this.hover = null;
  }

  get following() { return !this.pinned && !this.hover; }

  follow() { this.pinned = this.hover = null; this.changed(); }

  pointed(x, y, kind) {
    if (kind === "leave") this.hover = null;
    else if (kind === "click") this.pinned = this.pinned ? null : [x, y];
    else this.hover = [x, y];
    this.changed();
  }

  /** The point (x, y) in px of the image; the middle where nothing touches. */
  at(frame) {
    if (!frame.has("depth")) return null;
    const touched = frame.header.outlines?.length, middle = [frame.width / 2, frame.height / 2];
    const point = this.hover ?? this.pinned ?? (touched ? frame.header.peak_px : middle);
    return [Math.round(Math.max(0, Math.min(frame.width - 1, point[0]))), Math.round(Math.max(0, Math.min(frame.height - 1, point[1])))];
  }
}

/** The depth of a row and a column, and where they cross, NaN where it is not known: {x, alongX, y, alongY, depth}, places in the unit of the depth from the image's left and top. */
export function profilesThrough(frame, [column, row]) {
  const map = frame.map("depth"), [pitchX, pitchY] = frame.pitch(map), { width, height } = map, place = frame.placeIn(map, column, row);
  const depths = (count, from, step) => Array.from({ length: count }, (_, k) => frame.depthIn(map, from + k * step));
  return {
    x: Array.from({ length: width }, (_, k) => k * pitchX), alongX: depths(width, place - (place % width), 1),
    y: Array.from({ length: height }, (_, k) => k * pitchY), alongY: depths(height, place % width, width),
    depth: frame.depthIn(map, place),
  };
}

export function drawProfile(canvas, label, frame, point) {
  if (!point) {
    setText(label, "–");
    return void prepared(canvas);
  }
  const { x, alongX, y, alongY, depth } = profilesThrough(frame, point);
  setText(label, `at (${point[0]}, ${point[1]}) px: ${Number.isNaN(depth) ? "not known" : `${depth.toFixed(3)} ${frame.unit}`}`);
  drawChart(canvas, [{ x, y: alongX, color: "series-a", name: "along x" }, { x: y, y: alongY, color: "series-b", name: "along y" }],
    { xUnit: frame.unit, yUnit: frame.unit, xRange: [0, Math.max(x.at(-1), y.at(-1))], yLeast: 0.05 });
}

export const NUMBERS = {
  peak: { name: "Deepest point", power: "", digits: 3, least: 0.05 },
  area: { name: "Contact area", power: "²", digits: 1, least: 1 },
  volume: { name: "Volume", power: "³", digits: 2, least: 0.2 },
};
const tiles = {};

export function startNumbers() {
  for (const [key, { name }] of Object.entries(NUMBERS)) {
    const value = element("span"), unit = element("small"), line = element("canvas", { "aria-hidden": "true" });
    tiles[key] = { value, unit, line };
    byId("numbers").append(element("div", { class: "card number", id: `number-${key}` }, element("div", { class: "name", text: name }), element("div", { class: "value" }, value, unit), line));
  }
}

export function drawNumbers(frame) {
  for (const [key, { power, digits }] of Object.entries(NUMBERS)) {
    const number = frame?.header[key], tile = tiles[key];
    setText(tile.value, number === undefined ? "–" : fixed(number, digits));
    setText(tile.unit, number === undefined ? "" : `${frame.unit}${power}`);
  }
}

export function drawSparks(frame, series) {
  for (const [key, { least }] of Object.entries(NUMBERS)) if (frame.header[key] !== undefined) drawSpark(tiles[key].line, series.recent(key).values, least);
}
