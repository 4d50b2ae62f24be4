// Where the gel's dots have moved: a line from rest to now, three times as long as the way, with a dot at its end.

const LONGER = 3;

export function drawMarkers(context, { header, width }, px) {
  const ends = (header.markers ?? []).map(([x, y, nowX, nowY]) => [x, y, x + LONGER * (nowX - x), y + LONGER * (nowY - y)]);
  if (!ends.length) return;
  context.beginPath();
  for (const [x, y, endX, endY] of ends) { context.moveTo(x, y); context.lineTo(endX, endY); }
  context.lineWidth = 1.5 * px;
  context.strokeStyle = "#fff";
  context.stroke();
  context.beginPath();
  for (const [, , x, y] of ends) { context.moveTo(x, y); context.arc(x, y, width / 200, 0, 2 * Math.PI); }
  context.fillStyle = "#ffb454";
  context.fill();
}
