// The page: what comes from the server is kept here and drawn once per screen refresh.

import { drawChart } from "./maps/charts.js";
import { Connection, signIn } from "./server/connection.js";
import { drawControls, startControls } from "./panels/controls.js";
import { showCode } from "./page/dialogs.js";
import { byId, element, setOptions, setText } from "./page/dom.js";
import { Frame } from "./server/frame.js";
import { drawGuide, guideOverlay } from "./panels/guide.js";
import { showKeys, startKeys } from "./page/keys.js";
import { drawNumbers, NUMBERS, startNumbers } from "./maps/numbers.js";
import { Pane } from "./maps/pane.js";
import { markerArrows } from "./maps/markers.js";
import { drawProfile, Pointer } from "./maps/profile.js";
import { Relief } from "./surface/relief.js";
import { Series, SPAN_S } from "./server/series.js";
import { drawContacts } from "./maps/contacts.js";
import { drawEmpty, drawFacts, drawFindings, drawStatus } from "./panels/status.js";
import { Surface } from "./surface/surface.js";
import { startTabs } from "./page/tabs.js";
import { startTheme } from "./page/theme.js";
import { toast } from "./page/toasts.js";
import { VIEWS } from "./maps/views.js";

const LOOPBACK = ["127.0.0.1", "localhost", "[::1]"];
const settings = { colors: "viridis", outlines: true, range: 0.3, cursor: null, missing: (view) => missing(view), extra: markerArrows };
const look = { ageMs: 0, drawnHz: 0, bytesPerS: 0, renderer: "", encoding: LOOPBACK.includes(location.hostname) ? "raw" : "small" };
const connection = new Connection();
const pointer = new Pointer(() => redraw());
const series = new Series();
let facts = null, frame = null, number = 0, due = 0, owed = 0, drawn = [], panes = [], surface = null, guidePane = null, page = "live", choosePage = null, guided = false;

const station = () => facts?.stations[number] ?? null;
const send = (what, fields = {}) => connection.send({ do: what, station: number, ...fields });

function watch() {
  const planes = new Set(["depth", "flags"]);
  for (const pane of [...panes, guidePane]) VIEWS[pane.view].planes.forEach((name) => planes.add(name));
  if (byId("drape").value !== "depth") planes.add(byId("drape").value);
  connection.watch([number], [...planes], look.encoding);
}

function missing(view) {
  if (view === "sigma") return "this calibration says nothing of its uncertainty";
  if (view === "other" || view === "difference") return "choose a calibration under “Compare with”";
  return station()?.calibration ? "not there for this frame" : "needs a calibration";
}

// -- drawing ------------------------------------------------------------------------------------------------------------

function redraw() { if (!due) due = requestAnimationFrame(draw); }

function draw() {
  due = 0;
  if (frame && page === "calibrate") guidePane.draw(frame, { ...settings, plain: true, outlines: false, cursor: null, extra: () => guideOverlay(facts?.guides[number]) });
  if (frame && page === "live") {
    settings.range = depthRange(frame);
    settings.cursor = pointer.at(frame);
    for (const pane of panes) pane.draw(frame, settings);
    drawSurface();
    drawProfile(byId("profile"), byId("profile-at"), frame, settings.cursor);
    drawTime();
    drawNumbers(frame, series);
    drawFindings(frame);
    drawContacts(frame);
  }
  drawEmpty(frame, station(), facts?.work[number]);
  if (owed) noteDrawn();
}

/** The largest depth of the colours: follows the deepest point up at once and down slowly, so that they do not flicker. */
function depthRange({ header }) {
  const wanted = Math.max(header.unit === "px" ? 3 : 0.2, 1.05 * (header.peak ?? 0));
  return wanted > settings.range ? wanted : Math.max(wanted, settings.range * 0.985);
}

function drawSurface() {
  const lift = Number(byId("exaggeration").value), dark = document.documentElement.dataset.theme === "dark";
  const over = byId("drape").value, pane = panes.find((one) => one.view === over);
  const ink = dark ? [0.45, 0.6, 0.66, 1] : [0.45, 0.55, 0.6, 1];
  surface.draw(frame, { range: settings.range, lift, colors: settings.colors, drape: over === "depth" || !pane || pane.pixels.width < 2 ? null : pane.pixels, ink });
  const [x, y] = frame.header.mm_per_px ?? [1, 1];
  setText(byId("surface-note"), frame.has("depth") ? `${(frame.width * x).toFixed(1)} × ${(frame.height * y).toFixed(1)} ${frame.unit}, heights × ${lift}` : "");
}

function drawTime() {
  const key = byId("against").value, { name, power, least } = NUMBERS[key], last = series.time[series.time.length - 1];
  if (last === undefined) return;
  drawChart(byId("time"), [{ x: series.time.map((t) => t - last), y: series[key], color: "series-a" }], { xUnit: "s", yUnit: frame.unit + power, xRange: [-SPAN_S, 0], yLeast: least, name });
}

/** Give the credit back, and count how often and how late pictures are drawn. */
function noteDrawn() {
  const now = performance.now();
  for (; owed; owed--) connection.credit();
  drawn = [...drawn.filter((t) => t > now - 2000), now];
  look.drawnHz = drawn.length / 2;
  const age = 1000 * (connection.now - frame.header.time_s);
  look.ageMs += (age - look.ageMs) * (Math.abs(age - look.ageMs) > 500 ? 1 : 0.15);
  look.ages = [...(look.ages ?? []).slice(-299), age];
}

// -- what comes from the server ------------------------------------------------------------------------------------------

connection.addEventListener("frame", ({ detail }) => {
  owed++;
  if (detail.header.station !== number) return redraw();
  detail.header.simulated = station()?.simulated;
  frame = new Frame(detail);
  series.add(detail.header.numbers);
  redraw();
});

connection.addEventListener("state", ({ detail }) => {
  facts = detail;
  for (const [, level, text] of facts.notices) toast(text, level);
  setOptions(byId("sensor"), facts.stations.map((one) => [String(one.number), one.name]), String(number));
  byId("sensor").parentElement.hidden = facts.stations.length < 2;
  drawControls(station(), facts);
  drawStatus(station(), connection.open, look);
  if (station()) drawGuide(facts.guides[number], station(), facts, { send });
  if (guided && !facts.guides[number] && station()?.calibration) choosePage("live"); // it is in use: look at it
  guided = Boolean(facts.guides[number]);
  drawFacts(station(), look);
  redraw();
});

connection.addEventListener("done", ({ detail }) => { if (detail.problem) toast(detail.problem, "error"); });
connection.addEventListener("code", ({ detail }) => showCode(detail.title, detail.parts));
connection.addEventListener("snapshot", ({ detail }) => toast(element("span", {}, `Snapshot ${detail.number}: `, ...detail.files.flatMap((name) => [element("a", { href: `/snapshots/${detail.number}/${name}`, download: "", text: name }), " "])), "kept"));
connection.addEventListener("trouble", ({ detail }) => toast(detail, "error"));
connection.addEventListener("open", () => { series.clear(); drawStatus(station(), true, look); });
connection.addEventListener("closed", () => { owed = 0; drawStatus(station(), false, look); });
setInterval(() => { look.bytesPerS = connection.bytes; connection.bytes = 0; }, 1000);

// -- the page's own controls ----------------------------------------------------------------------------------------------

function makeSurface() {
  const canvas = byId("surface");
  try {
    surface = new Surface(canvas, redraw);
    look.renderer = surface.software ? "WebGL2, in software" : "WebGL2";
  } catch {
    surface = new Relief(canvas.parentElement.insertBefore(element("canvas", { id: "surface" }), canvas));
    canvas.remove();
    look.renderer = "shaded relief: this browser has no WebGL2";
  }
}

function pointed(x, y, kind, view) {
  if (kind === "click" && view === "image" && station()?.simulated) return send("press", { x_px: x, y_px: y });
  pointer.pointed(x, y, kind);
  byId("follow").setAttribute("aria-pressed", String(pointer.following));
}

function follow() {
  pointer.follow();
  byId("follow").setAttribute("aria-pressed", "true");
}

const KEYS = [
  [" ", "hold the picture, go on", () => byId("pause").click()],
  ["b", "take the background", () => byId("background").click()],
  ["z", "set zero, take it back", () => byId("zero").click()],
  ["s", "snapshot", () => byId("snapshot").click()],
  ["r", "record, finish", () => byId("record").click()],
  ["f", "profile through the deepest point", follow],
  ["1", "page Live", () => choosePage("live")],
  ["2", "page Calibrate", () => choosePage("calibrate")],
  ["c", "Python and command line of the depth", () => send("code", { view: "depth" })],
  ["d", "light or dark", () => byId("theme").click()],
  ["0", "surface as at the start", () => byId("reset-view").click()],
  ["?", "these shortcuts", () => byId("help").click()],
];

function startPage() {
  const toggle = startTheme(redraw);
  byId("theme").addEventListener("click", toggle);
  byId("help").addEventListener("click", () => showKeys(KEYS));
  startKeys(KEYS);
  startNumbers();
  makeSurface();
  const actions = { changed: () => guidePane && watch(), code: (view) => send("code", { view }), pointed };
  panes = ["depth", "image", "normals"].map((view) => new Pane(view, actions));
  guidePane = new Pane("image", actions);
  guidePane.select.parentElement.replaceWith(element("h2", { text: "Camera" }));
  guidePane.code.remove();
  byId("guide-pane").append(guidePane.node);
  choosePage = startTabs((name) => { page = name; redraw(); });
  byId("panes").append(...panes.map((pane) => pane.node));
  startControls({ send, chosen: station, recording: () => facts?.recordings[number], settings, redraw });
  byId("sensor").addEventListener("change", (event) => { number = Number(event.target.value); frame = null; series.clear(); watch(); });
  byId("exaggeration").addEventListener("input", (event) => { setText(byId("exaggeration-value"), `× ${event.target.value}`); redraw(); });
  byId("drape").addEventListener("change", () => { watch(); redraw(); });
  byId("against").addEventListener("change", redraw);
  byId("follow").addEventListener("click", follow);
  byId("reset-view").addEventListener("click", () => surface.orbit.reset());
  for (const button of document.querySelectorAll("button.code[data-view]")) button.addEventListener("click", () => send("code", { view: button.dataset.view }));
  addEventListener("resize", redraw);
}

startPage();
if (await signIn()) {
  watch();
  connection.connect();
} else toast("Wrong token. Open the address that the terminal shows.", "error");

// For people at the browser's console, and for the tests: what is shown right now.
window.gelform = { get frame() { return frame; }, get facts() { return facts; }, settings, look, series, connection, views: VIEWS, get surface() { return surface; } };
