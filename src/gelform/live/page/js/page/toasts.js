// Short messages that go away by themselves; errors and what is to be fetched stay until they are clicked.

import { byId, element } from "./dom.js";

const SHOWN_MS = 5000, MOST = 4;

export function toast(content, level = "info") {
  const box = byId("toasts"), made = element("div", { class: `toast ${level}`, onclick: () => made.remove() }, content);
  if ([...box.children].some((one) => one.textContent === made.textContent)) return;
  box.append(made);
  while (box.children.length > MOST) box.firstChild.remove();
  if (level !== "error" && level !== "kept") setTimeout(() => made.remove(), SHOWN_MS);
}
