// The three numbers with the line of their last ten seconds.

import { drawSpark } from "./charts.js";
import { byId, element, setText } from "../page/dom.js";

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

export function drawNumbers(frame, series) {
  for (const [key, { power, digits, least }] of Object.entries(NUMBERS)) {
    const number = frame?.header[key], tile = tiles[key];
    setText(tile.value, number === undefined ? "–" : number.toFixed(digits));
    setText(tile.unit, number === undefined ? "" : `${frame.unit}${power}`);
    if (number !== undefined) drawSpark(tile.line, series[key], least);
  }
}
