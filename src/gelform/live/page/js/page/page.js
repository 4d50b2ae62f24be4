// What is around the pages: dialog, keyboard shortcuts, tabs, light or dark, short messages, paces.

import { byId, element } from "./dom.js";

byId("dialog-close").addEventListener("click", () => byId("dialog").close());

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
  const rows = [...table.map(([key, what]) => [key === " " ? "Space" : key.toUpperCase(), what]), ["← ↑ → ↓", "turn the surface while it has the focus"], ["+ −", "zoom in, zoom out"]];
  byId("dialog-body").replaceChildren(element("div", { class: "keys" }, ...rows.flatMap(([key, what]) => [element("span", {}, element("kbd", { text: key })), element("span", { text: what })])));
  if (!byId("dialog").open) byId("dialog").showModal();
}

/** Arrow keys move between tabs, as screen readers expect. */
export function startTabs(changed) {
  const tabs = [...document.querySelectorAll("[role=tab]")];
  const choose = (chosen) => {
    for (const tab of tabs) {
      const on = tab === chosen;
      tab.setAttribute("aria-selected", String(on));
      tab.tabIndex = on ? 0 : -1;
      document.getElementById(tab.getAttribute("aria-controls")).hidden = !on;
    }
    changed(chosen.id.replace("tab-", ""));
  };
  tabs.forEach((tab, k) => {
    tab.addEventListener("click", () => choose(tab));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      const next = tabs[(k + step + tabs.length) % tabs.length];
      next.focus();
      choose(next);
    });
  });
  return (name) => choose(document.getElementById(`tab-${name}`));
}

const THEME_KEY = "gelform-theme", system = matchMedia("(prefers-color-scheme: dark)");

/** As the system has it until somebody chooses. */
export function startTheme(changed) {
  const apply = () => {
    document.documentElement.dataset.theme = localStorage.getItem(THEME_KEY) ?? (system.matches ? "dark" : "light");
    changed();
  };
  system.addEventListener("change", apply);
  apply();
  return () => {
    localStorage.setItem(THEME_KEY, document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    apply();
  };
}

const TOAST_MS = { info: 5000, warning: 10_000, error: 15_000, kept: 30_000 }, MOST_TOASTS = 3; // kept: with something to fetch

/** A message in the page's head, where it covers nothing. It goes away by itself, but not while it is pointed at or has the focus. */
export function toast(content, level = "info") {
  const box = byId("toasts"), made = element("div", { class: `toast ${level}` }, element("div", {}, content));
  if ([...box.children].some((one) => one.firstChild.textContent === made.textContent)) return;
  let timer = 0;
  const stay = () => clearTimeout(timer), leave = () => { stay(); timer = setTimeout(() => made.remove(), TOAST_MS[level]); };
  made.append(element("button", { class: "quiet icon", "aria-label": "Dismiss this message", title: "Dismiss", text: "✕", onclick: () => made.remove() }));
  for (const kind of ["pointerenter", "focusin"]) made.addEventListener(kind, stay);
  for (const kind of ["pointerleave", "focusout"]) made.addEventListener(kind, leave);
  box.append(made);
  while (box.children.length > MOST_TOASTS) box.firstChild.remove();
  leave();
}

/** A pace for what need not be drawn each time. */
export class Cadence {
  /** At most every `everyMs`; what is passed over is drawn later: `redraw` is called then. */
  constructor(everyMs, redraw) {
    this.everyMs = everyMs;
    this.redraw = redraw;
    this.at = -Infinity;
    this.timer = 0;
  }

  /** Whether its time has come. */
  due(now) {
    const wait = this.at + this.everyMs - now;
    if (wait <= 0) this.at = now;
    else this.timer ||= setTimeout(() => { this.timer = 0; this.redraw(); }, wait);
    return wait <= 0;
  }

  /** Draw it the next time in any case. */
  hurry() { this.at = -Infinity; }
}

/** A button that gives a part of the page the whole screen, where the browser can do that, and else the whole window. */
export function startWhole(part, button) {
  const show = (whole) => {
    part.classList.toggle("whole", whole);
    button.setAttribute("aria-pressed", String(whole));
  };
  button.addEventListener("click", async () => {
    const whole = !part.classList.contains("whole");
    show(whole);
    if (!whole && document.fullscreenElement) await document.exitFullscreen();
    else if (whole) await part.requestFullscreen?.().catch(() => {}); // not allowed here: the window it is
  });
  document.addEventListener("fullscreenchange", () => { if (!document.fullscreenElement) show(false); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape" && !document.getElementById("dialog").open) show(false); });
}
