// Making and finding elements.

export const byId = (id) => document.getElementById(id);

/** An element with attributes and children; `on*` attributes are listeners, strings become text. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "text") made.textContent = value;
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

/** Replace the options of a select where they changed; keeps what is chosen. */
export function setOptions(select, options, chosen) {
  const wanted = JSON.stringify(options);
  if (select.dataset.options !== wanted) {
    select.dataset.options = wanted;
    select.replaceChildren(...options.map(([value, text]) => element("option", { value, text })));
  }
  if (select.value !== chosen && document.activeElement !== select) select.value = chosen;
}

/** Set text only where it differs: the browser need not lay it out again. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
