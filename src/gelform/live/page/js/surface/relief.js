// The surface where there is no WebGL2: the same depth as a shaded relief, lit from the top left.

import { packedRamp } from "../maps/colors.js";
import { eachNormal } from "../maps/normals.js";
import { fit } from "../page/sizes.js";

export class Relief {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.small = document.createElement("canvas");
    this.orbit = { reset() {} };
  }

  draw(frame, look) {
    const map = frame.map("depth");
    if (!map) return;
    const { width, height, values, zero, step } = map, [x, y] = frame.pitch(map), colors = packedRamp.cached(look.colors);
    this.small.width = width;
    this.small.height = height;
    const small = this.small.getContext("2d"), image = small.createImageData(width, height), bytes = new Uint8Array(colors.buffer);
    eachNormal(map, x / look.lift, y / look.lift, (k, nx, ny, nz) => {
      const level = 4 * Math.max(0, Math.min(255, (255 * step * (values[k] - zero)) / look.range | 0)), lit = 0.35 + 0.75 * Math.max(0, -0.5 * nx - 0.5 * ny + 0.7 * nz);
      for (let c = 0; c < 3; c++) image.data[4 * k + c] = Math.min(255, bytes[level + c] * lit);
      image.data[4 * k + 3] = 255;
    });
    small.putImageData(image, 0, 0);
    fit(this.canvas, 1);
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const scale = Math.min(this.canvas.width / frame.width, this.canvas.height / frame.height), shown = [frame.width * scale, frame.height * scale];
    this.context.drawImage(this.small, (this.canvas.width - shown[0]) / 2, (this.canvas.height - shown[1]) / 2, ...shown);
  }
}
