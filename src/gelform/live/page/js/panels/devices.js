// The list of cameras and sources, and the settings of a camera.

import { byId, element, setText } from "../page/dom.js";

const NAMES = { exposure: "Exposure", gain: "Gain", white_balance: "White balance", led_level: "LED level" };
let shown = "", settable = "";

/** `station` is the chosen one, which shows a camera where that is asked for; `does`: {send(do, fields)}; `all`: numbers too. */
export function drawDevices(rows, station, does, all) {
  byId("devices-card").hidden = !rows.length;
  const key = JSON.stringify(rows.map((row) => [row.key, named(row)]));
  if (key !== shown) byId("devices").replaceChildren(...rows.map((row) => element("tr", {}, ...cells(row, does))));
  else if (all) rows.forEach((row, k) => row.camera === null && numbers(row).forEach((text, n) => setText(byId("devices").rows[k].cells[n + 2], text)));
  shown = key;
  const away = Boolean(station?.opened && !station.replay);
  byId("devices-back").hidden = !away;
  if (away) setText(byId("devices-back"), `Back to ${station.spec}`);
}

const named = (row) => [row.name, row.serial ?? "–", row.state];
const numbers = (row) => [row.rate_hz === null ? "–" : row.rate_hz.toFixed(0), row.age_ms === null ? "–" : String(Math.round(row.age_ms / 10) * 10), row.lost ? `${row.skipped}, ${row.lost} lost` : String(row.skipped ?? "–")];

function cells(row, does) {
  const [name, serial, state] = named(row);
  const first = [element("td", {}, element("i", { class: `dot ${state}`, title: state }), name, element("span", { class: "visually-hidden", text: `, ${state}` })), element("td", { text: serial })];
  if (row.camera === null) return [...first, ...numbers(row).map((text) => element("td", { text }))];
  return [...first, element("td", { colspan: 3 }, element("button", { class: "quiet show", text: "Show", title: `Show ${name} in place of the chosen sensor`, "aria-label": `Show ${name}, serial ${serial}`, onclick: () => does.send("show", { camera: row.camera }) }))];
}

/** Settings of the camera with what it has now; `does`: {send(do, fields)}. */
export function drawCamera(station, does) {
  const found = station?.settable ?? {}, names = Object.keys(found), key = JSON.stringify([station?.number, names]);
  byId("camera-card").hidden = !names.length;
  if (key !== settable) {
    settable = key;
    byId("camera-form").replaceChildren(...names.map((name) => element("label", {}, element("span", {}, `${NAMES[name]} `, element("small", { id: `now-${name}` })),
      element("input", { id: `set-${name}`, type: "number", step: "any", value: found[name], onchange: (event) => event.target.value !== "" && does.send("camera", { name, value: Number(event.target.value) }) }))));
  }
  for (const name of names) setText(byId(`now-${name}`), `now ${Number(found[name].toPrecision(6))}`);
  setText(byId("mismatch"), station?.mismatch ?? "");
}
