// A pane: one view of the frame, its overlays, its legend.

import { ramp } from "./colors.js";
import { element } from "../page/dom.js";
import { fit } from "../page/sizes.js";
import { drawCross, drawDeepest, drawOutlines, drawScaleBar } from "./marks.js";
import { VIEWS } from "./views.js";

export class Pane {
  /** `actions`: {changed(), code(view), pointed(x, y, kind)}; kind is "move", "leave" or "click". */
  constructor(view, actions) {
    this.actions = actions;
    this.pixels = element("canvas"); // the map, a pixel for each of its own
    this.shown = element("canvas", { class: "shown", "aria-hidden": "true" }); // as large as it is shown, with what is drawn over it
    this.select = element("select", { onchange: () => this.show(this.select.value) }, ...Object.entries(VIEWS).map(([value, { title }]) => element("option", { value, text: title })));
    this.legend = element("div", { class: "legend" });
    this.bar = element("canvas", { width: 256, height: 1 });
    this.map = element("div", { class: "map" }, this.shown);
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
    const view = VIEWS[this.view], aspect = `${frame.width} / ${frame.height}`;
    if (this.aspect !== aspect) this.map.style.aspectRatio = this.aspect = aspect;
    const source = frame.planes[view.from];
    const missing = view.planes.filter((name) => name !== "image" && !frame.has(name));
    if (!source || missing.length) this.blank(settings);
    else this.paint(frame, view, source, settings);
    if (fit(this.shown, Math.min(2, devicePixelRatio || 1))) this.compose(frame, settings);
  }

  paint(frame, view, source, settings) {
    const { width, height } = source, context = this.pixels.getContext("2d", { alpha: false, willReadFrequently: true });
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

  /** The map at the size of the screen, and the marks over it: one picture for the browser to put there. */
  compose(frame, settings) {
    const { width, height } = this.shown, context = this.shown.getContext("2d"), x = width / frame.width, y = height / frame.height;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    if (this.image) context.drawImage(this.pixels, 0, 0, width, height);
    context.setTransform(x, 0, 0, y, x / 2, y / 2);
    const px = Math.min(2, devicePixelRatio || 1) / x;
    if (settings.outlines) drawOutlines(context, frame, px);
    if (settings.cursor) drawCross(context, frame, settings.cursor, px);
    if (settings.outlines) drawDeepest(context, frame, px);
    settings.extra(context, frame, px);
    drawScaleBar(context, frame, px);
  }
}
