// Where the touching object moved since it touched: its path and its axes over the maps, and a line of numbers.

import { byId, setText } from "../page/dom.js";

const HALO = "rgb(0 0 0 / 70%)", AXES = ["#ff5d5d", "#4fd66b", "#63a4ff"]; // x, y and z
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

/** The motion in numbers, or why there are none; hidden while nobody asks for it. */
export function drawMotionLine({ header: { motion } }) {
  byId("motion-card").hidden = !motion;
  if (!motion) return;
  setText(byId("motion"), motionText(motion));
  setText(byId("motion-blind"), motion.blind.length ? `Not seen: ${motion.blind.join("; ")}.` : "");
}

function motionText({ state, why, shift_mm, shift_sigma_mm, turn_deg, turn_sigma_deg }) {
  if (state !== "found") return why ? `${state}: ${why}` : `${state}: it has hardly moved`;
  const shift = shift_mm ? ["x", "y"].map((name, k) => `${name} ${shift_mm[k].toFixed(2)} ± ${shift_sigma_mm[k].toFixed(2)} mm`).join(", ") : "shift not known";
  return `Middle of the contact: ${shift}, ${turn_deg === null ? "turn not known" : `turn ${turn_deg.toFixed(2)} ± ${turn_sigma_deg.toFixed(2)}°`}`;
}
