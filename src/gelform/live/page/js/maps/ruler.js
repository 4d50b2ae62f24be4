// A ruler between two points of the maps: how far they are apart along the gel, and how much deeper one is than the other.

import { element, setText } from "../page/dom.js";

const NAMES = ["A", "B"], COLOR = "#ffd166", HALO = "rgb(0 0 0 / 70%)";

export class Ruler {
  constructor(changed) {
    this.changed = changed;
    this.on = false;
    this.ends = []; // [x, y] in px of the image, whole numbers at the pixels' centers
    this.asked = { key: "", at: 0 };
    this.figures = ""; // of the groove or ridge between both ends, as the server said them last
  }

  toggle() { this.on = !this.on; this.changed(); }

  /** The first click is one end, the second the other; a third begins anew. */
  click(x, y) {
    this.ends = [...(this.ends.length < 2 ? this.ends : []), [Math.round(x), Math.round(y)]];
    this.changed();
  }

  /** An end's coordinates, typed in the frame's unit from the top left corner. */
  set(nth, axis, value, frame) {
    while (this.ends.length <= nth) this.ends.push([0, 0]);
    this.ends[nth][axis] = Math.round(value / pitchOf(frame)[axis]);
    this.changed();
  }

  /** {distance, rise} in the frame's unit; rise is how much deeper B is, NaN where either is not known. null without two ends or a depth. */
  measured(frame) {
    if (this.ends.length < 2 || !frame?.has("depth")) return null;
    const [a, b] = this.ends, [x, y] = pitchOf(frame);
    return { distance: Math.hypot((b[0] - a[0]) * x, (b[1] - a[1]) * y), rise: frame.depthAt(...b) - frame.depthAt(...a) };
  }

  /** Whether to ask for the figures: once where the ends moved, every two seconds where frames come. */
  due(frame) {
    if (!this.on || this.ends.length < 2 || frame?.unit !== "mm" || !frame.has("depth")) return false;
    const ends = this.ends.join(), key = `${ends} ${frame.header.time_s}`;
    if (key === this.asked.key || (this.asked.key.startsWith(`${ends} `) && performance.now() < this.asked.at + 2000)) return false;
    if (!this.asked.key.startsWith(`${ends} `)) this.figures = "";
    this.asked = { key, at: performance.now() };
    return true;
  }

  /** The measurement as a sentence. */
  said(frame) {
    const found = this.measured(frame);
    if (!found) return this.ends.length < 2 ? `Click ${this.ends.length ? "the other point" : "two points"} on a map, or type the coordinates.` : "This frame has no depth.";
    const { distance, rise } = found, height = Number.isNaN(rise) ? "their difference in depth is not known" : `B is ${Math.abs(rise).toFixed(3)} ${frame.unit} ${rise < 0 ? "less deep" : "deeper"}`;
    return `A and B are ${distance.toFixed(2)} ${frame.unit} apart, ${height}.`;
  }
}

const pitchOf = (frame) => frame?.header.mm_per_px ?? [1, 1];

/** Over a map; `px` is the width of a pixel of the style sheet in pixels of the image. */
export function drawRuler(context, ruler, px) {
  if (!ruler?.on) return;
  for (const [width, color] of [[4 * px, HALO], [2 * px, COLOR]]) {
    context.lineWidth = width;
    context.strokeStyle = color;
    context.beginPath();
    ruler.ends.forEach(([x, y], k) => context[k ? "lineTo" : "moveTo"](x, y));
    for (const [x, y] of ruler.ends) { context.moveTo(x + 5 * px, y); context.arc(x, y, 5 * px, 0, 2 * Math.PI); }
    context.stroke();
  }
  context.font = `700 ${13 * px}px system-ui, sans-serif`;
  context.lineWidth = 3 * px;
  context.strokeStyle = HALO;
  context.fillStyle = COLOR;
  ruler.ends.forEach(([x, y], k) => { context.strokeText(NAMES[k], x + 8 * px, y - 6 * px); context.fillText(NAMES[k], x + 8 * px, y - 6 * px); });
}

/** The line below the profile: the ends as numbers, which can be typed, and what is measured. `chosen` gives the ruler, `send` asks the server. */
export function startRuler(box, chosen, send) {
  let shown = null;
  const inputs = NAMES.map((name, nth) => ["x", "y"].map((axis, k) => element("input", { type: "number", min: 0, step: "any", oninput: ({ target }) => target.value !== "" && chosen().set(nth, k, Number(target.value), shown) })));
  const said = element("output", {}), unit = element("small", {}), figures = element("small", { role: "status" });
  box.append(...NAMES.flatMap((name, nth) => [element("b", { text: name }), ...inputs[nth]]), unit, said, figures);
  return (frame) => {
    const ruler = chosen();
    shown = frame;
    box.hidden = !ruler.on;
    if (!ruler.on) return;
    inputs.forEach((pair, nth) => pair.forEach((input, k) => {
      const pitch = pitchOf(frame)[k], at = ruler.ends[nth]?.[k], value = at === undefined ? "" : pitch === 1 ? String(at) : (at * pitch).toFixed(2);
      if (document.activeElement !== input && input.value !== value) input.value = value;
      input.max = frame ? ([frame.width, frame.height][k] - 1) * pitch : "";
      input.setAttribute("aria-label", `${NAMES[nth]}, ${"xy"[k]} in ${frame?.unit ?? "mm"}`);
    }));
    setText(unit, frame?.unit ?? "");
    setText(said, ruler.said(frame));
    if (ruler.due(frame)) send("measure", { ends_px: ruler.ends.flat() });
    setText(figures, ruler.figures);
  };
}
