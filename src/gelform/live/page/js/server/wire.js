// Reads the server's binary messages: magic, length of the header, header as JSON, planes.

const MAGIC = 0x314c4647; // "GFL1", little end first

/** A message as {header, planes}: planes by name with kind, width, height, zero, step and their values. */
export async function readMessage(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, true) !== MAGIC) throw new Error("This is no message of gelform live.");
  const start = 8 + view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, start - 8)));
  const read = await Promise.all(header.planes.map((plane) => readPlane(plane, buffer, start)));
  const planes = {};
  header.planes.forEach((plane, k) => (planes[plane.name] = { ...plane, values: read[k] }));
  return { header, planes };
}

async function readPlane(plane, buffer, start) {
  const at = start + plane.offset;
  if (plane.kind === "jpeg") return createImageBitmap(new Blob([new Uint8Array(buffer, at, plane.length)], { type: "image/jpeg" }));
  if (!plane.packed) return numbers(plane.kind, buffer, at, plane.length);
  const unpacked = await inflate(new Uint8Array(buffer, at, plane.length));
  return summed(numbers(plane.kind, unpacked, 0, unpacked.byteLength), plane.width);
}

function numbers(kind, buffer, at, length) {
  return kind === "u16" ? new Uint16Array(buffer, at, length / 2) : new Uint8Array(buffer, at, length);
}

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** Rows of differences as rows of values; the arrays wrap round as the server's do. */
function summed(values, width) {
  for (let row = 0; row < values.length; row += width) for (let k = row + 1; k < row + width; k++) values[k] += values[k - 1];
  return values;
}
