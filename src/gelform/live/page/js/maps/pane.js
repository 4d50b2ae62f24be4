// A pane: one view of the frame, its overlays, its legend.

import { ramp } from "./colors.js";
import { element, svgElement } from "../page/dom.js";
import { VIEWS } from "./views.js";

export class Pane {
  /** `actions`: {changed(), code(view), pointed(x, y, kind)}; kind is "move", "leave" or "click". */
  constructor(view, actions) {
    this.actions = actions;
    this.pixels = element("canvas", { class: "pixels", "aria-hidden": "true" });
    this.overlay = svgElement("svg", { "aria-hidden": "true", preserveAspectRatio: "none" });
    this.select = element("select", { onchange: () => this.show(this.select.value) }, ...Object.entries(VIEWS).map(([value, { title }]) => element("option", { value, text: title })));
    this.legend = element("div", { class: "legend" });
    this.bar = element("canvas", { width: 256, height: 1 });
    this.map = element("div", { class: "map" }, this.pixels, this.overlay);
    this.code = element("button", { class: "quiet icon code", title: "Python and command line", text: "</>", onclick: () => actions.code(this.view) });
    this.node = element("section", { class: "card pane" }, element("div", { class: "bar" }, element("label", {}, element("span", { class: "visually-hidden", text: "What this pane shows" }), this.select), element("div", { class: "tools" }, this.code)), this.map, this.legend);
    for (const kind of ["pointermove", "pointerleave", "click"]) this.map.addEventListener(kind, (event) => this.point(event, kind.replace("pointer", "")));
    this.show(view);
  }

  show(view) {
    this.view = view;
    this.select.value = view;
    this.code.setAttribute("aria-label", `Code of ${VIEWS[view].title}`);
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
    const view = VIEWS[this.view];
    this.map.style.aspectRatio = `${frame.width} / ${frame.height}`;
    const source = frame.planes[view.from];
    const missing = view.planes.filter((name) => name !== "flags" && name !== "image" && !frame.has(name));
    if (!source || missing.length) this.blank(settings);
    else this.paint(frame, view, source, settings);
    this.drawOverlay(frame, settings);
  }

  paint(frame, view, source, settings) {
    const { width, height } = source, context = this.pixels.getContext("2d");
    if (this.pixels.width !== width || this.pixels.height !== height || !this.image) {
      this.pixels.width = width;
      this.pixels.height = height;
      this.image = context.createImageData(width, height);
      this.words = new Uint32Array(this.image.data.buffer);
    }
    if (source.kind === "jpeg") context.drawImage(source.values, 0, 0);
    else {
      view.paint(frame, this.words, settings);
      context.putImageData(this.image, 0, 0);
    }
    this.explain(view.legend(settings, frame));
  }

  blank(settings) {
    this.pixels.width = this.pixels.height = 1;
    this.image = null;
    this.explain({ text: settings.missing(this.view) });
  }

  explain(legend) {
    const said = JSON.stringify(legend);
    if (said === this.said) return;
    this.said = said;
    if (legend.text) return this.legend.replaceChildren(legend.text);
    if (legend.swatches) return this.legend.replaceChildren(...legend.swatches.map(([color, name]) => {
      const swatch = element("i", { class: "swatch" });
      swatch.style.background = `#${color}`;
      return element("span", {}, swatch, name);
    }));
    const context = this.bar.getContext("2d"), strip = context.createImageData(256, 1);
    ramp(legend.colors).forEach((rgb, k) => strip.data.set([...rgb, 255], 4 * k));
    context.putImageData(strip, 0, 0);
    this.legend.replaceChildren(legend.low, this.bar, legend.high);
  }

  drawOverlay(frame, settings) {
    const { width, height, header } = frame, drawn = [];
    this.overlay.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    if (settings.outlines) for (const outline of header.outlines ?? []) drawn.push(svgElement("polygon", { class: "outline", points: outline.join(" ") }));
    if (settings.cursor) {
      const [x, y] = settings.cursor;
      drawn.push(svgElement("line", { class: "cross", x1: 0, x2: width, y1: y, y2: y }), svgElement("line", { class: "cross", x1: x, x2: x, y1: 0, y2: height }));
    }
    if (settings.outlines && header.peak_px && header.outlines?.length) drawn.push(svgElement("circle", { class: "deepest", cx: header.peak_px[0], cy: header.peak_px[1], r: width / 90 }));
    drawn.push(...settings.extra(frame), ...scaleBar(frame, this.map.clientWidth));
    this.overlay.replaceChildren(...drawn);
  }
}

/** A bar of a round length in mm at the bottom left. */
function scaleBar(frame, shownWidth) {
  const pitch = frame.header.mm_per_px?.[0];
  if (!pitch || !shownWidth) return [];
  const wanted = (frame.width * pitch) / 5, decade = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].map((k) => k * decade).find((l) => l <= wanted) ?? decade;
  const x = frame.width * 0.035, y = frame.height * 0.95, unit = frame.width / shownWidth;
  const text = svgElement("text", { x, y: y - 6 * unit });
  text.style.fontSize = `${12 * unit}px`;
  text.style.strokeWidth = `${3 * unit}px`;
  text.textContent = `${length} mm`;
  const line = (width, color) => svgElement("line", { x1: x, x2: x + length / pitch, y1: y, y2: y, stroke: color, "stroke-width": width * unit });
  return [line(5, "rgb(0 0 0 / 70%)"), line(3, "#fff"), text];
}
