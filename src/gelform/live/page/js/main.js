// The page: what comes from the server is kept here and drawn once per screen refresh.

import { drawChart, drawNumbers, drawProfile, drawSparks, NUMBERS, startNumbers, thinned } from "./maps/charts.js";
import { drawMotion, drawMotionLine } from "./maps/motion.js";
import { drawMarkers, Pane, Painting } from "./maps/pane.js";
import { startRuler } from "./maps/ruler.js";
import { VIEWS } from "./maps/views.js";
import { byId, element, setText } from "./page/dom.js";
import { Cadence, showKeys, startKeys, startTabs, startTheme, startWhole, toast } from "./page/page.js";
import { drawCamera, drawControls, drawDevices, drawStarter, startControls } from "./panels/controls.js";
import { drawGuide, drawGuideCircles } from "./panels/guide.js";
import { drawFiles, drawReplay, startReplay } from "./panels/replay.js";
import { drawContacts, drawEmpty, drawFacts, drawFindings, drawForce, drawStatus } from "./panels/status.js";
import { Connection, signIn } from "./server/connection.js";
import { Frame } from "./server/frame.js";
import { Stage } from "./surface/stage.js";

const LOOPBACK = ["127.0.0.1", "localhost", "[::1]"];
const settings = { colors: "viridis", outlines: true, range: 0.3, cursor: null, ruler: null, missing: (view) => missing(view), extra: (...over) => { drawMarkers(...over); drawMotion(...over); } };
const look = { ageMs: 0, drawnHz: 0, surfaces: 0, bytesPerS: 0, renderer: "", encoding: LOOPBACK.includes(location.hostname) ? "raw" : "small" };
const connection = new Connection();
const stages = [], draped = new Painting();
// Between two drawings where the processor does it: of pictures; of surfaces; of numbers and curves. A picture is asked for so long before it is drawn.
const SOFTWARE_MS = 46, SURFACE_MS = 75, CURVES_MS = 200, ASKED_MS = 20, FACTS_MS = 1000, CURVE_PARTS = 600;
const surfaces = new Cadence(SURFACE_MS, schedule), curves = new Cadence(CURVES_MS, schedule), running = new Cadence(FACTS_MS, () => {});
const stale = { pictures: true, surfaces: true, curves: true, panels: false };
let facts = null, number = 0, due = 0, drawnAt = 0, nextAt = 0, owed = 0, drawn = [], panes = [], guidePane = null, page = "live", choosePage = null, guided = false, stateKey = "", drawRulerLine = () => {};

const station = () => facts?.stations[number] ?? null;
const stage = () => stages[number];
const frameNow = () => stage()?.frame ?? null;
const inSoftware = () => stages.some((one) => one.surface.software);
const send = (what, fields = {}) => connection.send({ do: what, station: number, ...fields });

function watch() {
  const planes = new Set(["depth", "unknown"]);
  for (const pane of [...panes, guidePane]) VIEWS[pane.view].planes.forEach((name) => planes.add(name));
  if (byId("drape").value !== "depth") planes.add(byId("drape").value);
  const all = stages.map((one) => one.number);
  connection.watch(all, [...planes], look.encoding, all.filter((one) => one !== number));
}

function missing(view) {
  if (view === "sigma") return "This calibration has no uncertainty.";
  return station()?.calibration ? "This frame does not have it." : "This view needs a calibration.";
}

// -- drawing ------------------------------------------------------------------------------------------------------------

/** There is something newer to draw. */
function redraw() {
  stale.pictures = stale.surfaces = stale.curves = true;
  schedule();
}

/** At the next refresh of the screen; where the processor draws it, 21 times a second, so that it has time for the sensor. */
function schedule() {
  if (due) return;
  const wait = inSoftware() ? nextAt - performance.now() : 0;
  due = wait > 0 ? -setTimeout(() => { due = requestAnimationFrame(draw); }, wait) : requestAnimationFrame(draw);
}

function draw() {
  due = 0;
  drawnAt = performance.now();
  nextAt = Math.max(nextAt + SOFTWARE_MS, drawnAt);
  try {
    drawPage(frameNow());
  } finally {
    if (owed) noteDrawn(frameNow());
  }
}

function drawPage(frame) {
  if (stale.panels) drawPanels();
  if (frame && page === "calibrate" && stale.pictures) guidePane.draw(frame, { ...settings, guide: facts?.guides[number]?.step, outlines: false, cursor: null, ruler: null, extra: (context, _, px) => drawGuideCircles(context, facts?.guides[number], px) });
  if (page === "live") {
    if (frame && stale.pictures) { drawPictures(frame); drawNumbersOf(frame); }
    if (frame && stale.curves && (!inSoftware() || curves.due(drawnAt))) drawCurves(frame);
    if (stale.surfaces && (!inSoftware() || surfaces.due(drawnAt))) drawStages();
  }
  stale.pictures = false;
  for (const one of stages) drawEmpty(one.empty, one.frame, facts?.stations[one.number], facts?.work[one.number]);
  drawReplay(station(), frame);
}

/** Figures and maps of a sensor that gives no new ones, or of a server that does not answer, are dimmed: they are old. */
function sayOld() {
  const old = (one) => !connection.open || (one && !["running", "starting", "ended"].includes(one.state));
  byId("page-live").classList.toggle("old", Boolean(old(station())));
  for (const one of stages) one.node.classList.toggle("old", Boolean(old(facts?.stations[one.number])));
}

/** What the server says of itself; with the pictures, so that the browser lays the page out once. */
function drawPanels() {
  stale.panels = false;
  const calmly = running.due(drawnAt);
  drawControls(station(), facts);
  drawStatus(station(), connection.open, look);
  sayOld();
  drawStarter(station(), facts?.starters, facts?.work[number], { send, calibrate: () => choosePage("calibrate") });
  if (station()) drawGuide(facts.guides[number], station(), facts, { send });
  if (calmly) drawFacts(station(), look);
  drawFiles(station(), facts.files, { send });
  drawDevices(facts.devices, station(), { send }, calmly);
  drawCamera(station(), { send });
}

function drawPictures(frame) {
  settings.range = stage().range;
  settings.cursor = stage().pointer.at(frame);
  settings.ruler = stage().ruler;
  for (const pane of panes) pane.draw(frame, settings);
}

/** The numbers are those of the maps beside them. */
function drawNumbersOf(frame) {
  drawRulerLine(frame);
  drawNumbers(frame);
  drawFindings(frame);
  drawContacts(frame);
  drawForce(frame);
  drawMotionLine(frame);
}

function drawCurves(frame) {
  stale.curves = false;
  for (const label of document.querySelectorAll(".whose")) setText(label, stages.length > 1 ? `of sensor ${number + 1}` : "");
  drawProfile(byId("profile"), byId("profile-at"), frame, settings.cursor);
  drawTime(frame, stage().series);
  drawSparks(frame, stage().series);
}

function drawStages() {
  stale.surfaces = false;
  look.surfaces++;
  const lift = Number(byId("exaggeration").value), dark = document.documentElement.dataset.theme === "dark";
  const over = byId("drape").value, frame = frameNow();
  const drape = over !== "depth" && frame && draped.paint(frame, over, settings) ? draped.canvas : null;
  const common = { lift, colors: settings.colors, ink: dark ? [0.45, 0.6, 0.66, 1] : [0.45, 0.55, 0.6, 1] };
  for (const one of stages) {
    const named = stages.length > 1 ? `${one.number + 1} ${facts?.stations[one.number]?.name ?? ""}` : "";
    one.draw({ ...common, drape: one === stage() ? drape : null, over: one === stage() && drape ? over : "depth" }, named, one === stage());
  }
}

function drawTime(frame, series) {
  const key = byId("against").value, { name, power, least } = NUMBERS[key], last = series.time[series.time.length - 1];
  if (last === undefined) return;
  const spanS = Number(byId("span").value), all = series.recent(key, spanS), { time, values } = thinned(all.time, all.values, CURVE_PARTS);
  drawChart(byId("time"), [{ x: time.map((t) => t - last), y: values, color: "series-a" }], { xUnit: "s", yUnit: frame.unit + power, xRange: [-spanS, 0], yLeast: least, name });
}

/** Give the credit back, and count how often and how late pictures are drawn. */
function noteDrawn(frame) {
  const now = performance.now(), wait = inSoftware() ? nextAt - ASKED_MS - now : 0;
  if (wait > 0) connection.creditLater(owed, wait); // a picture that came sooner would only grow old
  else connection.credit(owed);
  owed = 0;
  drawn = [...drawn.filter((t) => t > now - 2000), now];
  look.drawnHz = drawn.length / 2;
  if (!frame) return;
  const age = 1000 * (connection.now - frame.header.time_s);
  look.ageMs += (age - look.ageMs) * (Math.abs(age - look.ageMs) > 500 ? 1 : 0.15);
  look.ages = [...(look.ages ?? []).slice(-299), age];
}

// -- what comes from the server ------------------------------------------------------------------------------------------

connection.addEventListener("frame", ({ detail }) => {
  owed++;
  const from = detail.header.station;
  detail.header.simulated = facts?.stations[from]?.simulated;
  stages[from]?.take(new Frame(detail));
  redraw();
});

connection.addEventListener("state", ({ detail }) => {
  facts = detail;
  for (const [, level, text] of facts.notices) toast(text, level);
  makeStages(facts.stations.length);
  if (guided && !facts.guides[number] && station()?.calibration) choosePage("live"); // it is in use: look at it
  guided = Boolean(facts.guides[number]);
  stale.panels = true;
  const key = JSON.stringify([facts.guides, facts.work, facts.stations.map((one) => [one.name, one.state, one.calibration, one.paused, one.simulated])]);
  if (key !== stateKey) redraw(); // what is said over pictures may be another thing
  else schedule();
  stateKey = key;
});

connection.addEventListener("done", ({ detail }) => { if (detail.problem) toast(detail.problem, "error"); });
connection.addEventListener("measured", ({ detail }) => { if (String(detail.ends_px) === String(stage().ruler.ends.flat())) { stage().ruler.figures = detail.text; drawRulerLine(frameNow()); } });
connection.addEventListener("snapshot", ({ detail }) => toast(element("span", {}, `Snapshot ${detail.number}: `, ...detail.files.flatMap((name) => [element("a", { href: `/snapshots/${detail.number}/${name}`, download: "", text: name }), " "])), "kept"));
connection.addEventListener("trouble", ({ detail }) => toast(detail, "error"));
connection.addEventListener("open", () => { for (const one of stages) one.series.clear(); drawStatus(station(), true, look); sayOld(); });
connection.addEventListener("closed", () => { owed = 0; drawStatus(station(), false, look); sayOld(); });
setInterval(() => { look.bytesPerS = connection.bytes; connection.bytes = 0; }, 1000);

// -- the page's own controls ----------------------------------------------------------------------------------------------

/** One surface for each sensor, side by side. */
function makeStages(count) {
  if (stages.length >= count) return;
  while (stages.length < count) {
    const made = new Stage(stages.length, { redraw: () => { surfaces.hurry(); redraw(); }, choose });
    stages.push(made);
    byId("stages").append(made.node);
  }
  look.renderer = stages[0].renderer;
  if (inSoftware()) connection.ahead = 1; // each one is drawn, and asked for when there is time for it
  if (guidePane) watch();
}

function choose(chosen) {
  number = chosen;
  settings.cursor = frameNow() ? stage().pointer.at(frameNow()) : null;
  sayFollowing();
  sayMeasuring();
  curves.hurry();
  watch();
  redraw();
}

function pointed(x, y, kind, view) {
  if (kind === "click" && page === "live" && stage().ruler.on) return stage().ruler.click(x, y);
  if (kind === "click" && page === "calibrate" && !station()?.simulated) return facts?.guides[number]?.step === "press" && send("guide_click", { x_px: x, y_px: y });
  if (kind === "click" && view === "image" && station()?.simulated) return send("press", { x_px: x, y_px: y });
  stage().pointer.pointed(x, y, kind);
  sayFollowing();
}

function follow() {
  stage().pointer.follow();
  sayFollowing();
}

function sayFollowing() { byId("follow").setAttribute("aria-pressed", String(stage().pointer.following)); }

/** Two clicks on a map measure instead of choosing a profile or pressing. */
function measure() {
  stage().ruler.toggle();
  sayMeasuring();
}

function sayMeasuring() {
  byId("measure").setAttribute("aria-pressed", String(stage().ruler.on));
  drawRulerLine(frameNow());
}

const replayed = (what, fields) => () => station()?.replay && send(what, fields());
const KEYS = [
  [" ", "pause or continue", () => byId("pause").click()],
  ["b", "take the background", () => byId("background").click()],
  ["z", "set zero, or undo it", () => byId("zero").click()],
  ["s", "take a snapshot", () => byId("snapshot").click()],
  ["r", "start or stop a recording", () => byId("record").click()],
  [",", "recording: one frame back", replayed("step", () => ({ by: -1 }))],
  [".", "recording: one frame forward", replayed("step", () => ({ by: 1 }))],
  ["l", "recording: loop on or off", replayed("loop", () => ({ loop: !station().replay.loop }))],
  ["f", "draw the profile through the deepest point", follow],
  ["m", "ruler on or off", measure],
  ["x", "surface on the whole screen, or back", () => byId("whole").click()],
  ["1", "open the page Live", () => choosePage("live")],
  ["2", "open the page Calibrate", () => choosePage("calibrate")],
  ["n", "choose the next sensor", () => choose((number + 1) % stages.length)],
  ["d", "switch between light and dark", () => byId("theme").click()],
  ["0", "return to the first view of the surface", () => byId("reset-view").click()],
  ["?", "show these shortcuts", () => byId("help").click()],
];

function startPage() {
  const toggle = startTheme(redraw);
  byId("theme").addEventListener("click", toggle);
  byId("help").addEventListener("click", () => showKeys(KEYS));
  startKeys(KEYS);
  startNumbers();
  makeStages(1);
  const actions = { changed: () => guidePane && watch(), pointed };
  panes = ["depth", "image", "normals"].map((view) => new Pane(view, actions));
  guidePane = new Pane("image", actions);
  guidePane.select.parentElement.replaceWith(element("h2", { text: "Camera" }));
  byId("guide-pane").append(guidePane.node);
  choosePage = startTabs((name) => { page = name; redraw(); });
  byId("panes").append(...panes.map((pane) => pane.node));
  startControls({ send, chosen: station, recording: () => facts?.recordings[number], page: connection.page, settings, redraw });
  startReplay({ send, chosen: station });
  for (const id of ["files-back", "devices-back"]) byId(id).addEventListener("click", () => send("open", { name: "" }));
  byId("exaggeration").addEventListener("input", (event) => { setText(byId("exaggeration-value"), `× ${event.target.value}`); redraw(); });
  byId("drape").addEventListener("change", () => { watch(); redraw(); });
  byId("against").addEventListener("change", redraw);
  byId("follow").addEventListener("click", follow);
  byId("measure").addEventListener("click", measure);
  drawRulerLine = startRuler(byId("ruler"), () => stage().ruler, send);
  byId("span").addEventListener("change", redraw);
  startWhole(byId("stage"), byId("whole"));
  byId("reset-view").addEventListener("click", () => stages.forEach((one) => one.surface.orbit.reset()));
  document.addEventListener("laidout", redraw);
}

startPage();
if (await signIn()) {
  watch();
  connection.connect();
} else toast("Wrong token. Open the address that the terminal shows.", "error");

// For people at the browser's console, and for the tests: what is shown right now.
window.gelform = { get frame() { return frameNow(); }, get facts() { return facts; }, get series() { return stage().series; }, get surface() { return stage().surface; }, stages, panes, guidePane, settings, look, connection, views: VIEWS };
