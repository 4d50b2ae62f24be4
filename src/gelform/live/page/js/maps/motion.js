// Where the touching object moved since it touched: its path and its axes over the maps, and a line of numbers.

import { byId, fixed, setText } from "../page/dom.js";

const HALO = "rgb(0 0 0 / 70%)", AXES = ["#ff5d5d", "#4fd66b", "#63a4ff"]; // x, y and z
const STILL_MM = 0.005, STILL_DEG = 0.05; // what the words round to zero
const AXIS = 0.09; // length of an axis, of the image's width

/** The path as far as it is known, and the axes where the turn is. */
export function drawMotion(context, { header: { motion }, width }, px) {
  if (!motion?.path.length) return;
  context.beginPath();
  motion.path.forEach((place, k) => place && context[motion.path[k - 1] ? "lineTo" : "moveTo"](...place));
  twice(context, px, "#ffe14d");
  if (!motion.shift_mm) return;
  const [x, y] = motion.path[motion.path.length - 1];
  context.beginPath();
  context.arc(x, y, 3 * px, 0, 2 * Math.PI);
  twice(context, px, "#ffe14d");
  motion.axes?.forEach((axis, k) => {
    if (!axis) return;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + AXIS * width * axis[0], y + AXIS * width * axis[1]);
    twice(context, px, AXES[k]);
  });
}

function twice(context, px, color) {
  for (const [width, style] of [[4, HALO], [2, color]]) {
    context.lineWidth = width * px;
    context.strokeStyle = style;
    context.stroke();
  }
}

/** The motion in words, or what is waited for, and on demand its numbers; hidden while nobody asks for it. */
export function drawMotionLine({ header: { motion } }) {
  byId("motion-card").hidden = !motion;
  if (!motion) return;
  setText(byId("motion"), inWords(motion));
  const unseen = [...new Set(motion.blind.map((words) => words.replace(/ (at|through) \(.*$/, "")))].join(", ");
  setText(byId("motion-blind"), unseen && `${unseen[0].toUpperCase()}${unseen.slice(1)} cannot be seen.`);
  byId("motion-more").hidden = motion.state !== "found";
  setText(byId("motion-numbers"), motion.state === "found" ? inNumbers(motion) : "");
}

function inWords({ state, why, shift_mm, turn_deg }) {
  if (why === "nothing touches") return "Waiting for a touch.";
  if (state === "cannot tell yet") return "The object has hardly moved.";
  if (state !== "found") return `The object is lost: ${why}.`;
  const ways = shift_mm ? [["right", "left"], ["down", "up"]].flatMap(([on, back], k) => (STILL_MM < Math.abs(shift_mm[k]) ? [`${fixed(Math.abs(shift_mm[k]), 2)} mm ${shift_mm[k] > 0 ? on : back}`] : [])) : null;
  const turn = turn_deg === null ? "how far it turned is not known" : Math.abs(turn_deg) < STILL_DEG ? "not turned" : `turned ${fixed(Math.abs(turn_deg), 1)}° ${turn_deg > 0 ? "clockwise" : "counterclockwise"}`;
  return `Since the touch: ${ways === null ? "how far it moved is not known" : ways.length ? `moved ${ways.join(" and ")}` : "not moved"}, ${turn}.`;
}

function inNumbers({ shift_mm, shift_sigma_mm, turn_deg, turn_sigma_deg }) {
  const shift = shift_mm ? ["x", "y"].map((name, k) => `${name} ${fixed(shift_mm[k], 2)} ± ${shift_sigma_mm[k].toFixed(2)} mm`) : ["shift not known"];
  return [...shift, turn_deg === null ? "turn not known" : `turn ${fixed(turn_deg, 2)} ± ${turn_sigma_deg.toFixed(2)}°`].join(", ");
}
