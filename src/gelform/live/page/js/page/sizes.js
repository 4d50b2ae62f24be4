// Sizes of elements as they were laid out last. Asking an element itself makes the browser lay the page out again at once.

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
