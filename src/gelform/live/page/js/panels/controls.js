// Buttons and choices of one sensor; the list of cameras, and a camera's settings; the banner of a sensor without a calibration.

import { MAP_NAMES } from "../maps/views.js";
import { byId, element, setOptions, setText } from "../page/dom.js";

/** `does`: {send(do, fields), chosen() -> station, recording() -> facts or undefined, page: its name, settings, redraw()}. */
export function startControls(does) {
  const button = (id, text, title, act, main) => element("button", { id, text, title, class: main ? "main" : "", onclick: act });
  const send = (what, fields = {}) => does.send(what, fields);
  const choice = (id, text, act) => element("label", {}, text, element("select", { id, onchange: (event) => act(event.target.value) }));
  byId("actions").append(
    element("div", { class: "row" },
      button("background", "Take background", "Average the next frames as the background image. Touch nothing. (B)", () => send("background"), true),
      button("undo-background", "Undo background", "Use the background before the one that was taken", () => send("undo_background")),
      button("zero", "Set zero", "Show depth relative to the present state (Z)", () => send("zero")),
      button("snapshot", "Snapshot", "Save this frame and its result (S)", () => send("snapshot")),
      button("record", "Record", "Save the frames as the camera gives them, in the folder of gelform live. It ends when this page is closed. (R)", () => send("record", { on: !does.recording(), page: does.page })),
      button("pause", "Pause", "Hold this frame (space)", () => send("pause", { paused: !holds(does.chosen()) }))));
  byId("choices").append(
    choice("calibration", "Calibration", (name) => name && send("calibration", { name })),
    choice("colors", "Colors", (name) => { does.settings.colors = name; does.redraw(); }),
    element("label", { class: "check" }, element("span", {}, element("input", { id: "outlines", type: "checkbox", checked: true, onchange: (event) => { does.settings.outlines = event.target.checked; does.redraw(); } }), " Outlines and deepest point")),
    element("label", { class: "check", title: "Follow the touching object: its path since it touched, and its turn. Off and on again begins anew." }, element("span", {}, element("input", { id: "motion-on", type: "checkbox", onchange: (event) => send("motion", { on: event.target.checked }) }), " Motion since the touch")));
  setOptions(byId("colors"), MAP_NAMES.map((name) => [name, name]), does.settings.colors);
}

const holds = (station) => station?.replay ? !station.replay.playing : Boolean(station?.paused);

export function drawControls(station, facts) {
  if (!station) return;
  const named = facts.calibrations.map((name) => [name, name]);
  setOptions(byId("calibration"), station.calibration ? named : [["", "none"], ...named], station.calibration);
  byId("pause").textContent = holds(station) ? "Continue" : "Pause";
  byId("pause").setAttribute("aria-pressed", String(holds(station)));
  byId("motion-on").checked = station.motion;
  const recording = facts.recordings[station.number];
  byId("record").textContent = recording ? `Stop, ${recording.frames} frames, ${Math.round(recording.bytes / 1e6)} MB` : "Record";
  byId("record").setAttribute("aria-pressed", String(Boolean(recording)));
  byId("undo-background").hidden = !station.can_undo;
  byId("zero").textContent = station.zero ? "Undo zero" : "Set zero";
  byId("zero").setAttribute("aria-pressed", String(station.zero));
  for (const id of ["background", "zero", "snapshot"]) byId(id).disabled = !station.calibration;
  byId("record").disabled = Boolean(station.replay);
}

// -- cameras ---------------------------------------------------------------------------------------------------------------

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
}

// -- starter ---------------------------------------------------------------------------------------------------------------

let drawnKey = "";

/** `work`: the sensor is being calibrated; `does`: {send(do, fields), calibrate() opens the guide}. */
export function drawStarter(station, starters, work, does) {
  const starter = work ? null : station?.starter, box = byId("starter");
  const key = JSON.stringify([station?.number, starter]);
  if (key === drawnKey) return;
  drawnKey = key;
  box.hidden = !starter;
  if (!starter) return box.replaceChildren();
  const said = starter.said.length ? [element("ul", {}, ...starter.said.map((text) => element("li", { text })))] : [];
  box.replaceChildren(...(starter.state === "ask" ? asked(starter, starters, does) : used(starter, does)), ...said);
}

function asked({ sensor, make }, starters, does) {
  const choice = element("select", { id: "starter-sensor", "aria-label": "Make of the sensor" }, element("option", { value: "", text: "choose the sensor" }), ...starters.map(([value, text]) => element("option", { value, text })));
  const take = element("button", { class: "main", id: "starter-take", text: "Take the background", disabled: !sensor, onclick: () => does.send("starter", { sensor: sensor || choice.value }) });
  choice.addEventListener("change", () => { take.disabled = !choice.value; });
  if (sensor) return [element("p", { text: `This ${make} has no calibration. Touch nothing and take the background. A starter, made from other units, then gives depth in mm.` }), take];
  return [element("p", { text: "This sensor has no calibration. If its make is in the list, touch nothing and take the background. A starter, made from other units, then gives depth in mm." }), choice, take];
}

function used({ make, percent }, does) {
  return [element("p", {}, element("strong", { text: "Starter" }), `: a model from other units of a ${make}. Slopes and depth may be off by ${percent.toFixed(0)} % (one standard deviation).`), element("button", { class: "main", id: "starter-calibrate", text: "Five presses make it yours", onclick: does.calibrate })];
}
