// A frame as the page draws it: the header and its maps, in the numbers that came.

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

  /** Width and height of a pixel of a map, in the unit of the depth. */
  pitch(map) {
    const [x, y] = this.header.mm_per_px ?? [1, 1];
    return [x * (this.width / map.width), y * (this.height / map.height)];
  }

  /** Depth at a place of the image, from the nearest pixel; null outside. */
  depthAt(x, y, name = "depth") {
    const map = this.map(name);
    if (!map || x < 0 || y < 0 || x > this.width - 1 || y > this.height - 1) return null;
    const column = Math.min(map.width - 1, Math.round(x / map.scale)), row = Math.min(map.height - 1, Math.round((y * map.height) / this.height));
    return (map.values[row * map.width + column] - map.zero) * map.step;
  }
}
