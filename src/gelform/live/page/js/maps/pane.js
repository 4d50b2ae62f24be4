// A view of a frame on a canvas of its own, which panes show and the surface wears; a pane: a view, the marks over it, its legend.

import { drawRuler } from "./ruler.js";
import { ramp, VIEWS } from "./views.js";
import { element, fit } from "../page/dom.js";

export class Painting {
  constructor() {
    this.canvas = element("canvas");
    this.image = null;
  }

  /** Whether the frame has what the view needs; else the canvas is empty. */
  paint(frame, name, settings) {
    const view = VIEWS[name], source = frame.planes[view.from];
    if (source && view.planes.every((plane) => plane === "image" || frame.has(plane))) this.put(frame, view, source, settings);
    else this.clear();
    return this.image !== null;
  }

  put(frame, view, source, settings) {
    const { canvas } = this, { width, height } = source, context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    if (canvas.width !== width || canvas.height !== height || !this.image) {
      canvas.width = width;
      canvas.height = height;
      this.image = context.createImageData(width, height);
      this.words = new Uint32Array(this.image.data.buffer);
    }
    if (source.kind === "jpeg") return context.drawImage(source.values, 0, 0);
    view.paint(frame, this.words, settings);
    if (view.unknown) hatch(this.words, frame.planes.unknown);
    context.putImageData(this.image, 0, 0);
  }

  clear() {
    this.canvas.width = this.canvas.height = 1;
    this.image = null;
  }
}

const HATCH = ["#8a9499", "#5d676c"], HATCH_PX = 6; // two grays in stripes, so many pixels of the map apart
const [LIGHT_WORD, DARK_WORD] = HATCH.map((color) => 0xff000000 | parseInt(color.slice(1).match(/../g).reverse().join(""), 16));

/** What is not known is hatched, whatever was filled in there. */
function hatch(words, plane) {
  if (!plane || plane.values.length !== words.length) return;
  const { values, width } = plane;
  for (let k = 0; k < words.length; k++) if (values[k]) words[k] = ((k % width) + Math.floor(k / width)) % HATCH_PX < HATCH_PX / 2 ? LIGHT_WORD : DARK_WORD;
}

// Marks: coordinates are pixels of the image, whole numbers at their centers; `px` is the width of a pixel of the style
// sheet in them.
const LIGHT = "#fff", HALO = "rgb(0 0 0 / 60%)";

function drawOutlines(context, frame, px) {
  context.beginPath();
  for (const outline of frame.header.outlines ?? []) {
    for (let k = 0; k < outline.length; k += 2) context[k ? "lineTo" : "moveTo"](outline[k], outline[k + 1]);
    context.closePath();
  }
  stroked(context, 3 * px, HALO);
  stroked(context, 1.6 * px, LIGHT);
}

function drawCross(context, { width, height }, [x, y], px) {
  context.beginPath();
  context.moveTo(0, y); context.lineTo(width, y);
  context.moveTo(x, 0); context.lineTo(x, height);
  stroked(context, px, "rgb(0 0 0 / 35%)"); // seen between white dashes on a bright map
  context.setLineDash([3 * px, 3 * px]);
  stroked(context, px, "rgb(255 255 255 / 85%)");
  context.setLineDash([]);
}

function drawDeepest(context, { header, width }, px) {
  if (header.peak_px && header.outlines?.length) drawRing(context, [...header.peak_px, width / 90], { width: 2 * px, color: LIGHT });
}

/** A circle [x, y, radius]. `look`: {width, color, dash: [on, off] or nothing, fill: a color or nothing}. */
export function drawRing(context, [x, y, radius], { width, color, dash = [], fill = null }) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  if (fill) { context.fillStyle = fill; context.fill(); }
  context.setLineDash(dash);
  stroked(context, width, color);
  context.setLineDash([]);
}

/** A bar of a round length in mm at the bottom left. */
function drawScaleBar(context, frame, px) {
  const pitch = frame.header.mm_per_px?.[0];
  if (!pitch) return;
  const wanted = (frame.width * pitch) / 5, decade = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].map((k) => k * decade).find((l) => l <= wanted) ?? decade;
  const x = frame.width * 0.035, y = frame.height * 0.95;
  context.beginPath();
  context.moveTo(x, y); context.lineTo(x + length / pitch, y);
  stroked(context, 5 * px, "rgb(0 0 0 / 70%)");
  stroked(context, 3 * px, LIGHT);
  context.font = `600 ${12 * px}px system-ui, sans-serif`;
  context.lineWidth = 3 * px;
  context.strokeStyle = "rgb(0 0 0 / 75%)";
  context.fillStyle = LIGHT;
  context.strokeText(`${length} mm`, x, y - 6 * px);
  context.fillText(`${length} mm`, x, y - 6 * px);
}

function stroked(context, width, color) {
  context.lineWidth = width;
  context.strokeStyle = color;
  context.lineJoin = "round";
  context.stroke();
}

const LONGER = 3;

/** Where the gel's dots have moved: a line from rest to now, three times as long as the way, with a dot at its end. */
export function drawMarkers(context, { header, width }, px) {
  const ends = (header.markers ?? []).map(([x, y, nowX, nowY]) => [x, y, x + LONGER * (nowX - x), y + LONGER * (nowY - y)]);
  if (!ends.length) return;
  context.beginPath();
  for (const [x, y, endX, endY] of ends) { context.moveTo(x, y); context.lineTo(endX, endY); }
  context.lineWidth = 1.5 * px;
  context.strokeStyle = "#fff";
  context.stroke();
  context.beginPath();
  for (const [, , x, y] of ends) { context.moveTo(x, y); context.arc(x, y, width / 200, 0, 2 * Math.PI); }
  context.fillStyle = "#ffb454";
  context.fill();
}

function swatch(background, name) {
  const mark = element("i", { class: "swatch" });
  mark.style.background = background;
  return element("span", { class: "named" }, mark, name);
}

export class Pane {
  /** `actions`: {changed(), pointed(x, y, kind)}; kind is "move", "leave" or "click". */
  constructor(view, actions) {
    this.actions = actions;
    this.painting = new Painting();
    this.shown = element("canvas", { class: "shown", "aria-hidden": "true" }); // as large as it is shown, with what is drawn over it
    this.select = element("select", { onchange: () => this.show(this.select.value) }, ...Object.entries(VIEWS).map(([value, { title }]) => element("option", { value, text: title })));
    this.legend = element("div", { class: "legend" });
    this.bar = element("canvas", { width: 256, height: 1 });
    this.map = element("div", { class: "map" }, this.shown);
    this.node = element("section", { class: "card pane" }, element("div", { class: "bar" }, element("label", {}, element("span", { class: "visually-hidden", text: "What this pane shows" }), this.select)), this.map, this.legend);
    for (const kind of ["pointermove", "pointerleave", "click"]) this.map.addEventListener(kind, (event) => this.point(event, kind.replace("pointer", "")));
    this.show(view);
  }

  show(view) {
    this.view = view;
    this.select.value = view;
    this.node.dataset.view = view;
    this.said = "";
    this.actions.changed();
  }

  point(event, kind) {
    const box = this.map.getBoundingClientRect();
    if (!this.frame || !box.width) return;
    this.actions.pointed(((event.clientX - box.left) / box.width) * this.frame.width - 0.5, ((event.clientY - box.top) / box.height) * this.frame.height - 0.5, kind, this.view);
  }

  draw(frame, settings) {
    this.frame = frame;
    const view = VIEWS[this.view], aspect = `${frame.width} / ${frame.height}`;
    if (this.aspect !== aspect) this.map.style.aspectRatio = this.aspect = aspect;
    if (this.painting.paint(frame, this.view, settings)) this.explain({ ...view.legend(settings, frame), hatched: Boolean(view.unknown && frame.has("unknown")) });
    else this.explain({ text: settings.missing(this.view) });
    if (fit(this.shown, Math.min(2, devicePixelRatio || 1))) this.compose(frame, settings);
  }

  explain(legend) {
    const said = JSON.stringify(legend);
    if (said === this.said) return;
    this.said = said;
    this.legend.replaceChildren(...this.legendParts(legend), ...(legend.hatched ? [swatch(`repeating-linear-gradient(135deg, ${HATCH[0]} 0 2px, ${HATCH[1]} 2px 4px)`, "not known")] : []));
  }

  legendParts(legend) {
    if (legend.text) return [element("span", { text: legend.text })];
    if (legend.swatches) return legend.swatches.map(([color, name]) => swatch(`#${color}`, name));
    const context = this.bar.getContext("2d"), strip = context.createImageData(256, 1);
    ramp(legend.colors).forEach((rgb, k) => strip.data.set([...rgb, 255], 4 * k));
    context.putImageData(strip, 0, 0);
    return [legend.low, this.bar, legend.high];
  }

  /** The map at the size of the screen, and the marks over it: one picture for the browser to put there. */
  compose(frame, settings) {
    const { width, height } = this.shown, context = this.shown.getContext("2d"), x = width / frame.width, y = height / frame.height;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    if (this.painting.image) context.drawImage(this.painting.canvas, 0, 0, width, height);
    context.setTransform(x, 0, 0, y, x / 2, y / 2);
    const px = Math.min(2, devicePixelRatio || 1) / x;
    if (settings.outlines) drawOutlines(context, frame, px);
    if (settings.cursor) drawCross(context, frame, settings.cursor, px);
    if (settings.outlines) drawDeepest(context, frame, px);
    drawRuler(context, settings.ruler, px);
    settings.extra(context, frame, px);
    drawScaleBar(context, frame, px);
  }
}
