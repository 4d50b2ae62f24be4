// Cameras and sources with serial, rate, age and drops; which one it is that somebody unplugs; how a camera is set.

import { byId, element, setText } from "../page/dom.js";

const NAMES = { exposure: "Exposure", gain: "Gain", white_balance: "White balance", led_level: "LED level" };
let shown = "", settable = "";

export function drawDevices({ rows, asking, gone, gone_name, back }) {
  byId("devices-card").hidden = !rows.length;
  const content = rows.map((row) => [row.name, row.serial ?? "–", row.rate_hz === null ? "–" : row.rate_hz.toFixed(0), row.age_ms === null ? "–" : String(Math.round(row.age_ms / 10) * 10), row.drops ?? "–"]);
  const key = JSON.stringify([content, rows.map((row) => row.state), gone]);
  if (key !== shown) byId("devices").replaceChildren(...content.map((cells, k) => element("tr", { class: rows[k].key === gone ? "gone" : "" }, ...cells.map((text, n) => (n ? element("td", { text }) : element("td", {}, element("i", { class: `dot ${rows[k].state}`, title: rows[k].state }), text, element("span", { class: "visually-hidden", text: `, ${rows[k].state}` })))))));
  shown = key;
  byId("identify").setAttribute("aria-pressed", String(asking));
  setText(byId("identified"), gone ? `It is ${gone_name}${back ? ". It is back." : ". Plug it in again."}` : asking ? "Unplug one now: the one that goes away is named here." : "");
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
  for (const name of names) setText(byId(`now-${name}`), `is ${Number(found[name].toPrecision(6))}`);
  setText(byId("mismatch"), station?.mismatch ?? "");
}
