// What is drawn over a map: outlines, the profile's cross, the deepest point, a scale bar. Coordinates are pixels of the
// image, whole numbers at their centres; `px` is the width of a pixel of the style sheet in them.

const LIGHT = "#fff", HALO = "rgb(0 0 0 / 60%)";

export function drawOutlines(context, frame, px) {
  context.beginPath();
  for (const outline of frame.header.outlines ?? []) {
    for (let k = 0; k < outline.length; k += 2) context[k ? "lineTo" : "moveTo"](outline[k], outline[k + 1]);
    context.closePath();
  }
  stroked(context, 3 * px, HALO);
  stroked(context, 1.6 * px, LIGHT);
}

export function drawCross(context, { width, height }, [x, y], px) {
  context.beginPath();
  context.moveTo(0, y); context.lineTo(width, y);
  context.moveTo(x, 0); context.lineTo(x, height);
  context.setLineDash([3 * px, 3 * px]);
  stroked(context, px, "rgb(255 255 255 / 85%)");
  context.setLineDash([]);
}

export function drawDeepest(context, { header, width }, px) {
  if (header.peak_px && header.outlines?.length) drawRing(context, [...header.peak_px, width / 90], { width: 2 * px, color: LIGHT });
}

/** A circle [x, y, radius]. `look`: {width, color, dash: [on, off] or nothing, fill: a colour or nothing}. */
export function drawRing(context, [x, y, radius], { width, color, dash = [], fill = null }) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  if (fill) { context.fillStyle = fill; context.fill(); }
  context.setLineDash(dash);
  stroked(context, width, color);
  context.setLineDash([]);
}

/** A bar of a round length in mm at the bottom left. */
export function drawScaleBar(context, frame, px) {
  const pitch = frame.header.mm_per_px?.[0];
  if (!pitch) return;
  const wanted = (frame.width * pitch) / 5, decade = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].map((k) => k * decade).find((l) => l <= wanted) ?? decade;
  const x = frame.width * 0.035, y = frame.height * 0.95;
  context.beginPath();
  context.moveTo(x, y); context.lineTo(x + length / pitch, y);
  stroked(context, 5 * px, "rgb(0 0 0 / 70%)");
  stroked(context, 3 * px, LIGHT);
  context.font = `600 ${12 * px}px system-ui, sans-serif`;
  context.lineWidth = 3 * px;
  context.strokeStyle = "rgb(0 0 0 / 75%)";
  context.fillStyle = LIGHT;
  context.strokeText(`${length} mm`, x, y - 6 * px);
  context.fillText(`${length} mm`, x, y - 6 * px);
}

function stroked(context, width, color) {
  context.lineWidth = width;
  context.strokeStyle = color;
  context.lineJoin = "round";
  context.stroke();
}
