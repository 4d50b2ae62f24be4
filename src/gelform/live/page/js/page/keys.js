// Keyboard shortcuts: one table, used and shown.

import { element } from "./dom.js";
import { openDialog } from "./dialogs.js";

/** `table`: [[key, what it does, action]]; not heard while somebody types or chooses. */
export function startKeys(table) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.key === " " && event.target.tagName === "BUTTON") return;
    const found = table.find(([key]) => key.toLowerCase() === event.key.toLowerCase());
    if (!found) return;
    event.preventDefault();
    found[2]();
  });
}

export function showKeys(table) {
  const rows = [...table.map(([key, what]) => [key === " " ? "Space" : key.toUpperCase(), what]), ["← ↑ → ↓", "turn the surface, where it has the focus"], ["+ −", "nearer, farther"]];
  openDialog("Keyboard", element("div", { class: "keys" }, ...rows.flatMap(([key, what]) => [element("span", {}, element("kbd", { text: key })), element("span", { text: what })])));
}
