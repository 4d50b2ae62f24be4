// The one dialog: code, shortcuts.

import { byId, element } from "./dom.js";
import { toast } from "./toasts.js";

byId("dialog-close").addEventListener("click", () => byId("dialog").close());

export function openDialog(title, ...content) {
  byId("dialog-title").textContent = title;
  byId("dialog-body").replaceChildren(...content);
  if (!byId("dialog").open) byId("dialog").showModal();
}

/** What reproduces a view: [{language, text}] under their names, each with a button that copies it. */
export function showCode(title, parts) {
  openDialog(`How to get it: ${title}`, ...parts.map(({ language, text }) => element("div", {},
    element("div", { class: "copy" }, element("h3", { text: language }), element("button", { class: "quiet", text: "Copy", onclick: () => copy(text) })),
    element("pre", { tabindex: 0 }, text))));
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    toast("Copied.");
  } catch {
    toast("The browser does not allow copying here. Select the text.", "warning");
  }
}
