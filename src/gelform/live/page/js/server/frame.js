// What the server sends, as the page draws it: a binary message, a frame of it, numbers of the last ten seconds.

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

/** The header and its maps, in the numbers that came. */
export class Frame {
  constructor({ header, planes }) {
    this.header = header;
    this.planes = planes;
  }

  get width() { return this.header.width; }
  get height() { return this.header.height; }
  get unit() { return this.header.unit ?? "mm"; }
  has(name) { return name in this.planes; }

  /** {width, height, values, zero, step, scale}: a value is (number - zero) * step; scale is image pixels per its pixel (2 at half resolution). */
  map(name) {
    const plane = this.planes[name];
    return plane ? { ...plane, scale: this.width / plane.width } : null;
  }

  /** The place of the pixel of a map that shows a pixel of the image. */
  placeIn(map, x, y) {
    const column = Math.min(map.width - 1, Math.round(x / map.scale)), row = Math.min(map.height - 1, Math.round((y * map.height) / this.height));
    return row * map.width + column;
  }

  /** The depth at a place of its map; NaN where it is not known. */
  depthIn(map, place) { return (this.planes.unknown?.values[place] ?? 0) & 1 ? NaN : (map.values[place] - map.zero) * map.step; }

  /** The depth at a pixel of the image; NaN where it is not known, or beside the image. */
  depthAt(x, y) {
    const map = this.map("depth");
    return map && x >= 0 && y >= 0 && x <= this.width - 1 && y <= this.height - 1 ? this.depthIn(map, this.placeIn(map, x, y)) : NaN;
  }

  /** Width and height of a pixel of a map, in the unit of the depth. */
  pitch(map) {
    const [x, y] = this.header.mm_per_px ?? [1, 1];
    return [x * (this.width / map.width), y * (this.height / map.height)];
  }
}

export const SPAN_S = 10, LONGEST_S = 300; // of the curves: at first, and what is kept
const SPLICED = 256; // rows that are too old are taken out so many at once
const NAMES = ["time", "peak", "area", "volume"];

/** Every result's numbers, whether its picture was drawn or not. */
export class Series {
  constructor() { this.clear(); }

  clear() { for (const name of NAMES) this[name] = []; }

  /** The place of the first row that is not before a time. */
  firstSince(timeS) {
    let low = 0, high = this.time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[middle] < timeS) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** {time, values} of a number over the last `spanS`. */
  recent(name, spanS = SPAN_S) {
    const from = this.firstSince(this.time[this.time.length - 1] - spanS);
    return { time: this.time.slice(from), values: this[name].slice(from) };
  }

  /** Rows [time_s, peak, area, volume], in the order of time. */
  add(rows) {
    for (const row of rows) {
      if (this.time.length && row[0] <= this.time[this.time.length - 1]) continue;
      NAMES.forEach((name, k) => this[name].push(row[k]));
    }
    const last = this.time[this.time.length - 1], old = this.firstSince(last - LONGEST_S);
    if (old > SPLICED) for (const name of NAMES) this[name].splice(0, old);
  }
}
