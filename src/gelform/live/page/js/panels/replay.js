// The controls of a recording (slider, step, play, speed, loop, share) and the list of recordings.

import { byId, element, setText } from "../page/dom.js";

const SPEEDS = [["0.125", "1/8 ×"], ["0.25", "1/4 ×"], ["0.5", "1/2 ×"], ["1", "1 ×"], ["2", "2 ×"], ["4", "4 ×"], ["8", "8 ×"]];
const clock = (seconds) => `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(2).padStart(5, "0")}`;
const size = (bytes) => (bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);
let held = false; // the slider, by a finger or the mouse
let listed = "";

/** `does`: {send(do, fields), chosen() -> station}. */
export function startReplay(does) {
  const button = (id, text, title, act) => element("button", { id, text, title, "aria-label": text.length > 1 ? null : title, onclick: act }); // a sign has no name
  const scrub = element("input", { type: "range", id: "scrub", min: 0, max: 1, step: 1, value: 0, "aria-label": "Frame of the recording" });
  scrub.addEventListener("pointerdown", () => (held = true));
  for (const kind of ["pointerup", "pointercancel"]) scrub.addEventListener(kind, () => (held = false));
  scrub.addEventListener("input", () => does.send("seek", { frame: Number(scrub.value) }));
  byId("replay").append(
    button("step-back", "‹", "One frame back (,)", () => does.send("step", { by: -1 })),
    button("play", "Play", "Play or pause (space)", ({ target }) => does.send("play", { playing: target.getAttribute("aria-pressed") !== "true" })), // what it says, though the end may have come meanwhile
    button("step-on", "›", "One frame forward (.)", () => does.send("step", { by: 1 })),
    scrub,
    element("output", { id: "replay-at", for: "scrub" }),
    element("label", {}, element("span", { class: "visually-hidden", text: "Speed" }), element("select", { id: "speed", onchange: (event) => does.send("speed", { speed: Number(event.target.value) }) }, ...SPEEDS.map(([value, text]) => element("option", { value, text })))),
    button("loop", "Loop", "Start again at the end (L)", () => does.send("loop", { loop: !does.chosen()?.replay?.loop })),
    button("share", "Share", "Make one file of the frames and the calibration in use", () => does.send("share")),
  );
}

/** The bar below the surface. */
export function drawReplay(station, frame) {
  const replay = station?.replay ?? null;
  byId("replay").hidden = !replay;
  if (!replay) return;
  const number = frame?.header.replay?.[0] ?? replay.number, time = frame?.header.replay?.[1] ?? replay.time_s, scrub = byId("scrub");
  scrub.max = Math.max(0, replay.count - 1);
  if (!held) scrub.value = number;
  scrub.setAttribute("aria-valuetext", `frame ${number + 1} of ${replay.count}`);
  setText(byId("replay-at"), `${number + 1} / ${replay.count}, ${clock(time)} of ${clock(replay.duration_s)}`);
  setText(byId("play"), replay.playing ? "Pause" : "Play");
  byId("play").setAttribute("aria-pressed", String(replay.playing));
  byId("loop").setAttribute("aria-pressed", String(replay.loop));
  if (document.activeElement !== byId("speed")) byId("speed").value = String(replay.speed);
}

/** The list of what can be opened and fetched. */
export function drawFiles(station, files, does) {
  const key = JSON.stringify([files, station?.opened, station?.replay?.file]);
  if (key === listed) return;
  listed = key;
  byId("files-card").hidden = !files.length;
  const rows = files.map(({ name, bytes }, number) => element("li", {},
    element("button", { class: "quiet open", text: name, title: `Open ${name}`, "aria-pressed": String(station?.replay?.file === name), onclick: () => does.send("open", { name }) }),
    bytes === null ? "" : element("a", { href: `/recordings/${number}`, download: "", text: size(bytes), title: `Download ${name}`, "aria-label": `Download ${name}, ${size(bytes)}` })));
  byId("files").replaceChildren(...rows);
  byId("files-back").hidden = !station?.replay || !station.opened;
}
