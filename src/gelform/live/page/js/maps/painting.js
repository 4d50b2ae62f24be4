// A view of a frame on a canvas of its own, a pixel for each of the map's: what panes show, and what the surface is draped with.

import { VIEWS } from "./views.js";
import { element } from "../page/dom.js";

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

export const HATCH = ["#8a9499", "#5d676c"], HATCH_PX = 6; // two grays in stripes, so many pixels of the map apart
const [LIGHT, DARK] = HATCH.map((color) => 0xff000000 | parseInt(color.slice(1).match(/../g).reverse().join(""), 16));

/** What is not known is hatched, whatever was filled in there. */
function hatch(words, plane) {
  if (!plane || plane.values.length !== words.length) return;
  const { values, width } = plane;
  for (let k = 0; k < words.length; k++) if (values[k]) words[k] = ((k % width) + Math.floor(k / width)) % HATCH_PX < HATCH_PX / 2 ? LIGHT : DARK;
}
