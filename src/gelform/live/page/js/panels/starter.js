// A sensor that was never calibrated: its make, its untouched gel, and that what is shown is a starter's.

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
  const choice = element("select", { id: "starter-sensor", "aria-label": "Which sensor it is" }, element("option", { value: "", text: "which sensor?" }), ...starters.map(([value, text]) => element("option", { value, text })));
  const take = element("button", { class: "main", id: "starter-take", text: "Take the background", disabled: !sensor, onclick: () => does.send("starter", { sensor: sensor || choice.value }) });
  choice.addEventListener("change", () => { take.disabled = !choice.value; });
  if (sensor) return [element("p", { text: `Nothing touches the gel? Take the background. This ${make} was never calibrated; what other units have shown is enough for depth in mm.` }), take];
  return [element("p", { text: "This sensor has no calibration. If it is of a make in the list, and nothing touches the gel, its background is enough to begin with." }), choice, take];
}

function used({ make, percent }, does) {
  return [element("p", {}, element("strong", { text: "Starter" }), `: made on other units of a ${make}, ± ${percent.toFixed(0)} %.`), element("button", { class: "main", id: "starter-calibrate", text: "Five presses make it yours", onclick: does.calibrate })];
}
