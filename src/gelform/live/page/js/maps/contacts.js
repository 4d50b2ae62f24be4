// The contacts of a frame, the largest first.

import { byId, element } from "../page/dom.js";

const MOST = 5;

export function drawContacts({ header }) {
  const contacts = (header.contacts ?? []).slice(0, MOST), card = byId("contacts-card");
  card.hidden = contacts.length < 2; // of one contact the numbers above say it all
  if (card.hidden) return;
  const rows = contacts.map(({ deepest_mm, area_mm2, deepest_px, cut }) => element("tr", {}, ...[`${deepest_px[0]}, ${deepest_px[1]}`, deepest_mm?.toFixed(3) ?? "–", area_mm2?.toFixed(1) ?? "–", cut ? "at the border" : ""].map((text) => element("td", { text }))));
  byId("contacts").replaceChildren(...rows);
}
