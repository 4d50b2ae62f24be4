// Depth along the row and the column through a point: under the pointer, or the deepest one.

import { drawChart } from "./charts.js";
import { setText } from "../page/dom.js";

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

/** The depth of a row and a column: {x, alongX, y, alongY}, places in the unit of the depth from the image's left and top. */
export function profilesThrough(frame, [column, row]) {
  const map = frame.map("depth"), [pitchX, pitchY] = frame.pitch(map), { width, height, values, zero, step } = map, depth = (number) => (number - zero) * step;
  const c = Math.min(width - 1, Math.round(column / map.scale)), r = Math.min(height - 1, Math.round((row * height) / frame.height));
  return {
    x: Array.from({ length: width }, (_, k) => k * pitchX), alongX: Array.from(values.subarray(r * width, (r + 1) * width), depth),
    y: Array.from({ length: height }, (_, k) => k * pitchY), alongY: Array.from({ length: height }, (_, k) => depth(values[k * width + c])),
  };
}

export function drawProfile(canvas, label, frame, point) {
  if (!point) return;
  const { x, alongX, y, alongY } = profilesThrough(frame, point), depth = frame.depthAt(...point);
  setText(label, `at (${point[0]}, ${point[1]}) px: ${depth.toFixed(3)} ${frame.unit}`);
  drawChart(canvas, [{ x, y: alongX, color: "series-a", name: "along x" }, { x: y, y: alongY, color: "series-b", name: "along y" }],
    { xUnit: frame.unit, yUnit: frame.unit, xRange: [0, Math.max(x.at(-1), y.at(-1))], yLeast: 0.05 });
}
