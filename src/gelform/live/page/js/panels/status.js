// The state of the sensor: the line at the top, the banner, the text in place of the surface, the details, findings and contacts.

import { byId, element, fixed, setText } from "../page/dom.js";

const WORDS = { running: "live", starting: "starting", reconnecting: "reconnecting", missing: "not connected", ended: "ended", offline: "server offline", paused: "paused" };
const ADVICE = {
  missing: "Plug the sensor in. gelform tries again every second.",
  busy: "If another gelform live has it, open its address instead. Any number of pages may show one camera.",
  reconnecting: "The camera was disconnected. gelform continues when the camera is plugged in again.",
  ended: "The recording is over. The page keeps its last frame.",
};

export function drawStatus(station, online, look) {
  const held = station?.paused || station?.replay?.playing === false;
  const state = !online ? "offline" : held ? "paused" : (station?.state ?? "starting");
  const line = byId("status"), numbers = online && station && state === "running" ? [["", `${station.rate_hz.toFixed(0)} Hz`], ["age", `${look.ageMs.toFixed(0)} ms`], ["skipped", String(station.skipped)], ...(station.lost ? [["lost", String(station.lost)]] : [])] : [];
  if (line.dataset.state !== state || line.children.length !== 1 + numbers.length) line.replaceChildren(element("span", {}, element("i", { class: `dot ${state === "paused" ? "starting" : state}` }), element("b", { text: WORDS[state] ?? state })), ...numbers.map(([name]) => fact(name, "")));
  numbers.forEach(([, value], k) => setText(line.children[k + 1].lastChild, value));
  line.dataset.state = state;
  const banner = byId("banner"), said = bannerText(station, online);
  banner.hidden = !said;
  banner.classList.toggle("bad", !online || station?.state === "missing");
  setText(banner, said);
}

function bannerText(station, online) {
  if (!online) return "The server does not answer. Start gelform live again in the terminal, or wait. This page reconnects by itself.";
  if (station?.replay?.problem) return station.replay.problem;
  if (!station || station.state === "running" || station.state === "starting") return "";
  const reason = station.reason ? `${station.reason.replace(/\.?$/, ".")} ` : "", advice = / is in use /.test(reason) ? ADVICE.busy : (ADVICE[station.state] ?? "");
  return reason.includes(advice) ? reason : reason + advice;
}

/** The text in place of the surface: the reason, and the next step. */
export function drawEmpty(box, frame, station, work) {
  const content = emptyContent(frame, station, work), key = content.map((one) => one.outerHTML).join("");
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.replaceChildren(...content);
}

function emptyContent(frame, station, work) {
  if (frame?.has("depth")) return [];
  if (work) {
    const [what, done, total] = work;
    return [element("strong", { text: "Calibrating" }), element("span", { text: what }), element("progress", { max: Math.max(1, total), value: done, "aria-label": what })];
  }
  if (frame?.header.problem) return [element("strong", { text: "This frame cannot be reconstructed" }), element("span", { text: frame.header.problem })];
  if (!frame) return [element("strong", { text: station?.state === "missing" ? "No sensor" : "Waiting for the first frame" }), element("span", { text: station?.state === "missing" ? ADVICE.missing : "" })];
  if (station?.starter?.sensor && !station.calibration) return [element("strong", { text: "Touch nothing" }), element("span", { text: "Then press “Take the background” above." })];
  if (station && !station.calibration) return [element("strong", { text: "No calibration yet" }), element("span", { text: "Choose one in the list, or make one with a ball in ten minutes on the page Calibrate." })];
  return [];
}

const UNITS = { width: "px", height: "px", fps: "Hz" };

export function drawFacts(station, look) {
  if (!station) return;
  const rows = [["sensor", station.name], ["serial", station.serial ?? "–"], ["camera rate", `${(station.camera_hz ?? 0).toFixed(1)} Hz`], ["reconstruction rate", `${station.rate_hz.toFixed(1)} Hz`],
    ["drawing rate", `${look.drawnHz.toFixed(1)} Hz`], ["reconstruction time", `${station.took_ms.toFixed(1)} ms`], ["capture to screen", `${look.ageMs.toFixed(0)} ms`], ["skipped frames", String(station.skipped)], ["lost frames", String(station.lost)], ["reconnections", String(station.reopened ?? 0)],
    ["data format", look.encoding === "raw" ? "16-bit depth, raw image" : "16-bit depth of half size, JPEG image"], ["data rate", `${(look.bytesPerS / 1e6).toFixed(2)} MB/s`], ["surface drawn by", look.renderer],
    ["background", station.background], ...Object.entries(station.settings).map(([name, value]) => [name.replace("_", " "), UNITS[name] ? `${value} ${UNITS[name]}` : String(value)])];
  byId("facts").replaceChildren(...rows.flatMap(([name, value]) => [element("dt", { text: name }), element("dd", { text: value })]));
}

export function drawFindings(frame) {
  const findings = frame?.header.health ?? [], key = JSON.stringify(findings.map(([name]) => name)), list = byId("findings");
  const texts = findings.length ? findings.map(([name, message]) => element("li", { text: message, "data-name": name })) : [element("li", { class: "well", text: frame?.has("depth") ? "Nothing to report." : "–" })];
  if (list.dataset.key !== key + texts[0].textContent) list.replaceChildren(...texts);
  list.dataset.key = key + texts[0].textContent;
}

const fact = (name, value) => element("span", {}, name ? `${name} ` : "", element("b", { text: value }));

const MOST_CONTACTS = 5;

/** The contacts of a frame, the largest first. */
export function drawContacts({ header }) {
  const contacts = (header.contacts ?? []).slice(0, MOST_CONTACTS), card = byId("contacts-card");
  card.hidden = contacts.length < 2; // the numbers above already show a single contact
  if (card.hidden) return;
  const rows = contacts.map(({ deepest_mm, area_mm2, deepest_px, cut_by_border }) => element("tr", {}, ...[`${deepest_px[0]}, ${deepest_px[1]}`, deepest_mm === null ? "–" : fixed(deepest_mm, 3), area_mm2?.toFixed(1) ?? "–", cut_by_border ? "cut by the border" : ""].map((text) => element("td", { text }))));
  byId("contacts").replaceChildren(...rows);
}

const FORCES = [["into the gel", "normal_n", "normal_sigma_n", "N"], ["shear x", "shear_x_n", "shear_sigma_n", "N"], ["shear y", "shear_y_n", "shear_sigma_n", "N"], ["torsion", "torsion_n_mm", "torsion_sigma_n_mm", "N mm"]];

/** The known forces with one standard deviation, and the reason for the others; hidden without known loads. */
export function drawForce({ header: { force } }) {
  byId("force-card").hidden = !force;
  if (!force) return;
  const said = ([name, value, sigma, unit]) => [element("dt", { text: name }), element("dd", { text: force[value] === null ? "–" : `${fixed(force[value], 2)} ± ${force[sigma].toFixed(2)} ${unit}` })];
  byId("force").replaceChildren(...FORCES.flatMap(said));
  setText(byId("force-reason"), force.force_reason && `– ${force.force_reason}`);
}
