// The surface of one sensor with what is said over it; without WebGL2 a shaded relief. Several stand side by side.

import { eachNormal, packedRamp } from "../maps/views.js";
import { element, fit, setText } from "../page/dom.js";
import { Pointer } from "../maps/charts.js";
import { Ruler } from "../maps/ruler.js";
import { Series } from "../server/frame.js";
import { Surface } from "./surface.js";

/** The depth as a relief, lit from the top left. */
class Relief {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.small = document.createElement("canvas");
    this.orbit = { reset() {} };
  }

  draw(frame, look) {
    const map = frame.map("depth");
    if (!map) return this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const { width, height, values, zero, step } = map, unknown = frame.planes.unknown?.values, [x, y] = frame.pitch(map), colors = packedRamp(look.colors);
    this.small.width = width;
    this.small.height = height;
    const small = this.small.getContext("2d"), image = small.createImageData(width, height), bytes = new Uint8Array(colors.buffer);
    eachNormal(map, x / look.lift, y / look.lift, (k, nx, ny, nz) => {
      const level = 4 * Math.max(0, Math.min(255, (255 * step * (values[k] - zero)) / look.range | 0)), lit = 0.35 + 0.75 * Math.max(0, -0.5 * nx - 0.5 * ny + 0.7 * nz);
      for (let c = 0; c < 3; c++) image.data[4 * k + c] = unknown && unknown[k] & 1 ? 140 : Math.min(255, bytes[level + c] * lit);
      image.data[4 * k + 3] = 255;
    });
    small.putImageData(image, 0, 0);
    fit(this.canvas, 1);
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const scale = Math.min(this.canvas.width / frame.width, this.canvas.height / frame.height), shown = [frame.width * scale, frame.height * scale];
    this.context.drawImage(this.small, (this.canvas.width - shown[0]) / 2, (this.canvas.height - shown[1]) / 2, ...shown);
  }
}

const SAID = { confidence: ", colors: confidence from 0 to 1", image: ", colors: camera image" };
const LEAST_RANGE = 0.2, LEAST_RANGE_PX = 3, FALLING = 0.985;

export class Stage {
  /** `does`: {redraw(), choose(number)}. */
  constructor(number, does) {
    this.number = number;
    this.frame = null;
    this.series = new Series();
    this.pointer = new Pointer(does.redraw); // where its profile goes through
    this.ruler = new Ruler(does.redraw);
    this.range = 0.3;
    const id = number ? `surface-${number}` : "surface";
    this.canvas = element("canvas", { id, tabindex: 0, role: "img", "aria-label": "Surface of the gel in three dimensions. Arrow keys turn it, plus and minus zoom." });
    this.note = element("div", { class: "corner" });
    this.empty = element("div", { class: "empty" });
    this.button = element("button", { class: "chooser", hidden: true, onclick: () => does.choose(number) });
    this.node = element("div", { class: "canvas-wrap" }, this.canvas, this.note, this.empty, this.button);
    this.makeSurface(does.redraw, id);
  }

  makeSurface(redraw, id) {
    try {
      this.surface = new Surface(this.canvas, redraw);
      this.renderer = this.surface.software ? "WebGL2, in software" : "WebGL2";
    } catch (problem) {
      const flat = element("canvas", { id, role: "img", "aria-label": "Surface of the gel as a shaded relief, lit from the top left." });
      this.canvas.replaceWith(flat); // a canvas that was asked for WebGL gives no other context
      this.canvas = flat;
      this.surface = new Relief(flat);
      this.renderer = `shaded relief: ${problem.message}`;
    }
  }

  take(frame) {
    this.frame = frame;
    this.series.add(frame.header.numbers);
    this.range = this.rangeOf(frame.header);
  }

  /** The largest depth of the colors: follows the deepest point up at once and down slowly, so that they do not flicker. */
  rangeOf({ unit, peak }) {
    const wanted = Math.max(unit === "px" ? LEAST_RANGE_PX : LEAST_RANGE, 1.05 * (peak ?? 0));
    return wanted > this.range ? wanted : Math.max(wanted, this.range * FALLING);
  }

  /** `look`: {lift, colors, drape, ink}; `named`: which sensor this is, said where there are several. */
  draw(look, named, chosen) {
    this.button.hidden = !named;
    this.button.setAttribute("aria-pressed", String(chosen));
    this.node.classList.toggle("chosen", Boolean(named) && chosen);
    const { frame } = this, [x, y] = frame?.header.mm_per_px ?? [1, 1];
    if (named) setText(this.button, frame?.header.peak === undefined ? named : `${named}: ${frame.header.peak.toFixed(3)} ${frame.unit}`);
    if (!frame) return;
    this.surface.draw(frame, { ...look, range: this.range });
    setText(this.note, frame.has("depth") ? `${(frame.width * x).toFixed(1)} × ${(frame.height * y).toFixed(1)} ${frame.unit}, heights × ${look.lift}${SAID[look.over] ?? ""}` : "");
  }
}
