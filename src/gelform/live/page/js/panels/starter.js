// The banner of a sensor without a calibration of its own: it asks for the make and the background, then names the starter.

import { byId, element } from "../page/dom.js";

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
