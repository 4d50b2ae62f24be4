// The guided calibration: the next step, the next places to press, the coverage, the fit, the report.

import { drawRing } from "../maps/pane.js";
import { byId, element, setText } from "../page/dom.js";

const STEPS = [["start", "Ball"], ["background", "Background"], ["press", "Press"], ["fit", "Fit"], ["report", "Report"]];
const HELP = {
  start: "Press a ball of known size 20 times, all over the gel, or 5 times if gelform knows the make. The page shows where. It takes a few minutes.",
  fit: "gelform finds the circles, and compares color models on held-out presses.",
};
let shownKey = "";

/** Circles over the camera image: the next places, the present contact, the accepted presses; also beside the report, which names the places. */
export function drawGuideCircles(context, guide, px) {
  if (!["press", "report"].includes(guide?.step)) return;
  for (const circle of guide.accepted) drawRing(context, circle, { width: px, color: "rgb(255 255 255 / 65%)", fill: "rgb(255 255 255 / 10%)" });
  guide.places.forEach((place, k) => drawPlace(context, place, k, px));
  if (guide.live && guide.step === "press") drawRing(context, guide.live, { width: 2.5 * px, color: "#fff" });
}

const YELLOW = "#ffd166", LATER = "rgb(255 209 102 / 85%)", DARK = "rgb(0 0 0 / 70%)";

/** A place to press: 1 is the next one, 2 and 3 come after it. */
function drawPlace(context, [x, y, radius], nth, px) {
  const now = nth === 0, color = now ? YELLOW : LATER;
  drawRing(context, [x, y, radius], { width: (now ? 3 : 1.5) * px, color, dash: [(now ? 7 : 3) * px, (now ? 5 : 4) * px] });
  context.font = `700 ${(now ? 26 : 17) * px}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 4 * px;
  context.strokeStyle = DARK;
  context.strokeText(nth + 1, x, y);
  context.fillStyle = color;
  context.fillText(nth + 1, x, y);
  context.textAlign = "start";
  context.textBaseline = "alphabetic";
}

/** `does`: {send(do, fields)}; `work` is [what, done, total] while it fits. */
export function drawGuide(guide, station, facts, does) {
  const step = guide?.step ?? "start", work = facts.work[station.number];
  const at = STEPS.findIndex(([name]) => name === step);
  byId("steps").replaceChildren(...STEPS.map(([, title], k) => element("li", { class: k < at ? "done" : k === at ? "now" : "", "aria-current": k === at ? "step" : false, text: title })));
  setText(byId("guide-hint"), guide?.hint ?? "Calibrate with a ball");
  const key = step === "start" ? `start${station.number}${station.simulated}${station.starter?.state}` : JSON.stringify([step, guide.count, guide.untouched, guide.enough, work, Math.round(guide.still * 10)]);
  if (key === shownKey) return;
  shownKey = key;
  byId("guide-body").replaceChildren(...{ start: startForm, background, press, fit, report }[step](guide, station, facts, does, work));
}

function startForm(_, station, facts, does) {
  const ball = element("input", { type: "number", min: 0.5, max: 100, step: "any", value: 5, required: true, id: "ball" });
  const profile = element("select", { id: "profile" }, ...facts.profiles.map(([value, name, pitch]) => element("option", { value, text: `${name} (${pitch} mm per pixel)` })), element("option", { value: "", text: "another sensor" }));
  const pitch = element("input", { type: "number", min: 0.001, max: 1, step: "any", value: 0.06, id: "pitch" });
  const scale = element("label", {}, "Scale: width of one pixel on the gel (mm)", pitch);
  const show = () => (scale.hidden = profile.value !== "");
  profile.addEventListener("change", show);
  show();
  const begin = (event) => { event.preventDefault(); does.send("guide_start", { ball_diameter_mm: Number(ball.value), profile: begun ? begun.sensor : station.simulated ? "" : profile.value, mm_per_px: Number(pitch.value) }); };
  const begun = station.starter?.state === "used" ? station.starter : null;
  const sensor = begun ? [element("p", { text: `The starter knows the scale of a ${begun.make}. Five presses can be fitted, with an angle error of about 2.5 degrees; more fit better.` })] : station.simulated ? [element("p", { text: "The simulated sensor knows its scale. It presses itself where the guide asks." })] : [element("label", {}, "Sensor", profile), scale];
  return [element("form", { onsubmit: begin }, element("p", { text: HELP.start }), element("label", {}, "Ball diameter (mm)", ball), ...sensor, element("button", { class: "main", id: "guide-start", text: "Start" }))];
}

function background(guide, _, __, does) {
  return [element("div", { class: "part" }, element("progress", { max: guide.untouched[1], value: guide.untouched[0], "aria-label": "frames of the gel at rest" }), stopButton(does))];
}

function press(guide, _, __, does) {
  const { tiles: [rows, columns], directions, share, level, wanted } = guide.coverage ?? { tiles: [1, 1], directions: [0], share: 0, level: "poor", wanted: 0 };
  const map = element("div", { class: "tiles", role: "img", "aria-label": `Presses show ${Math.round(100 * share)} % of the places and slope directions` }, ...directions.map((seen) => element("i", { "data-seen": seen })));
  map.style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
  const fitButton = element("button", { class: guide.enough ? "main" : "", id: "guide-fit", text: "Fit now", onclick: () => does.send("guide_fit") });
  fitButton.disabled = !guide.can_fit;
  return [
    element("div", { class: "part" }, element("div", {}, element("span", { class: "count", text: guide.count }), ` presses, of at least ${guide.wanted}`), element("progress", { max: guide.wanted, value: Math.min(guide.count, guide.wanted), "aria-label": "presses" }), element("label", {}, "Ball held still", element("progress", { max: 1, value: guide.still }))),
    element("div", { class: "part" }, element("p", {}, `Coverage: presses show ${Math.round(100 * share)} % of the places and slope directions. It is `, element("b", { class: `level-${level}`, id: "coverage-level", text: level }), level === "poor" ? `: press on, until it is ${wanted} %.` : "."), map, element("div", { class: "row" }, fitButton, " ", stopButton(does))),
  ];
}

function fit(_, __, ___, ____, work) {
  const [what, done, total] = work ?? ["starting", 0, 1];
  return [element("div", { class: "part" }, element("p", { text: HELP.fit }), element("progress", { max: Math.max(1, total), value: done, "aria-label": what }), element("p", { text: what }))];
}

function report(guide, station, _, does) {
  const { headline, level, next, checks, model, accepted, rejected, folder } = guide.report;
  const rows = checks.map((check) => element("tr", {}, element("td", { text: check.label }), element("td", { text: check.value === null ? "not known" : `${Number(check.value.toPrecision(3))} ${check.unit}`.replace(" °", "°") }), element("td", { class: `level-${check.level}`, text: check.level })));
  return [
    element("div", { class: "part" }, element("h3", { class: `level-${level}`, id: "verdict", text: headline }), element("p", {}, element("strong", { text: "Next: " }), next), element("table", { class: "checks" }, ...rows)),
    element("div", { class: "part" }, element("p", { text: `The calibration uses ${accepted} presses and rejects ${rejected.length}. Its color model is ${model}. The presses, the calibration and the full report are in ${folder}/. Nothing uses it until you say so.` }), element("div", { class: "row" },
      element("button", { class: level === "poor" ? "" : "main", id: "guide-use", text: "Use this calibration", onclick: () => does.send("guide_use") }), " ",
      element("button", { class: level === "poor" ? "main" : "", id: "guide-more", text: "Press more", onclick: () => does.send("guide_more") }), " ",
      element("a", { class: "button", id: "guide-report", text: "Open report", href: `/reports/${station.number}`, target: "_blank", rel: "noopener" }), " ",
      stopButton(does, "Do not use it"))),
  ];
}

const stopButton = (does, text = "Stop") => element("button", { class: "quiet", id: "guide-stop", text, onclick: () => does.send("guide_stop") });
