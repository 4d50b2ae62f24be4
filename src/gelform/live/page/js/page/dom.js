// Making and finding elements, and their sizes.

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

/** A number with so many digits; what rounds to zero has no minus sign. */
export const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]*$)/, "");

// Sizes as they were laid out last: asking an element itself makes the browser lay the page out again at once.
const known = new WeakMap();
const watcher = new ResizeObserver((entries) => {
  for (const { target, contentRect } of entries) known.set(target, contentRect);
  document.dispatchEvent(new Event("laidout"));
});

/** {width, height} in px of the style sheet; when it changes the document hears "laidout". */
export function sizeOf(node) {
  if (!known.has(node)) {
    known.set(node, { width: node.clientWidth, height: node.clientHeight });
    watcher.observe(node);
  }
  return known.get(node);
}

/** Give a canvas as many pixels as it has room for, times `scale`; whether it has any. */
export function fit(canvas, scale) {
  const { width, height } = sizeOf(canvas), wanted = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== wanted[0]) canvas.width = wanted[0];
  if (canvas.height !== wanted[1]) canvas.height = wanted[1];
  return wanted[0] > 0 && wanted[1] > 0;
}
