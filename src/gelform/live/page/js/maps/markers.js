// Where the gel's dots have moved: a line from rest to now, three times as long as the way, with a dot at its end.

import { svgElement } from "../page/dom.js";

const LONGER = 3;

export function markerArrows({ header, width }) {
  return (header.markers ?? []).flatMap(([x, y, nowX, nowY]) => {
    const endX = x + LONGER * (nowX - x), endY = y + LONGER * (nowY - y);
    return [svgElement("line", { class: "marker", x1: x, y1: y, x2: endX, y2: endY }), svgElement("circle", { class: "marker-end", cx: endX, cy: endY, r: width / 200 })];
  });
}
