// Buttons and choices of one sensor.

import { MAP_NAMES } from "../maps/views.js";
import { byId, element, setOptions } from "../page/dom.js";

/** `does`: {send(do, fields), chosen() -> station, recording() -> facts or undefined, page: its name, settings, redraw()}. */
export function startControls(does) {
  const button = (id, text, title, act, main) => element("button", { id, text, title, class: main ? "main" : "", onclick: act });
  const send = (what, fields = {}) => does.send(what, fields);
  const choice = (id, text, act) => element("label", {}, text, element("select", { id, onchange: (event) => act(event.target.value) }));
  byId("actions").append(
    element("div", { class: "row" },
      button("background", "Take background", "Average the next frames as the background image. Touch nothing. (B)", () => send("background"), true),
      button("zero", "Set zero", "Show depth relative to the present state (Z)", () => send("zero")),
      button("snapshot", "Snapshot", "Save this frame and its result (S)", () => send("snapshot")),
      button("record", "Record", "Save the frames as the camera gives them, in the folder of gelform live. It ends when this page is closed. (R)", () => send("record", { on: !does.recording(), page: does.page })),
      button("pause", "Pause", "Hold this frame (space)", () => send("pause", { paused: !holds(does.chosen()) }))));
  byId("choices").append(
    choice("calibration", "Calibration", (name) => name && send("calibration", { name })),
    element("div", { class: "row" },
      choice("solver", "Solver", (name) => send("solver", { name })),
      choice("colors", "Colors", (name) => { does.settings.colors = name; does.redraw(); })),
    element("label", { class: "check" }, element("span", {}, element("input", { id: "outlines", type: "checkbox", checked: true, onchange: (event) => { does.settings.outlines = event.target.checked; does.redraw(); } }), " Outlines and deepest point")));
  setOptions(byId("colors"), MAP_NAMES.map((name) => [name, name]), does.settings.colors);
}

const holds = (station) => station?.replay ? !station.replay.playing : Boolean(station?.paused);

export function drawControls(station, facts) {
  if (!station) return;
  const named = facts.calibrations.map((name) => [name, name]);
  setOptions(byId("calibration"), station.calibration ? named : [["", "none"], ...named], station.calibration);
  setOptions(byId("solver"), facts.solvers.map((name) => [name, name]), station.solver);
  byId("pause").textContent = holds(station) ? "Continue" : "Pause";
  byId("pause").setAttribute("aria-pressed", String(holds(station)));
  const recording = facts.recordings[station.number];
  byId("record").textContent = recording ? `Stop, ${recording.frames} frames, ${Math.round(recording.bytes / 1e6)} MB` : "Record";
  byId("record").setAttribute("aria-pressed", String(Boolean(recording)));
  byId("zero").textContent = station.zero ? "Undo zero" : "Set zero";
  byId("zero").setAttribute("aria-pressed", String(station.zero));
  for (const id of ["background", "zero", "snapshot"]) byId(id).disabled = !station.calibration;
  byId("record").disabled = Boolean(station.replay);
}
