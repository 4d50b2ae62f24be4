// Unit normals of a depth map, as `gelform.normals_from_gradients(gelform.gradients_from_depth(...))` gives them:
// (-dz/dx, -dz/dy, 1) / norm, z towards the camera; differences of neighbours, one-sided at the border.

/** Calls back(index, nx, ny, nz) for every pixel. */
export function eachNormal(map, pitchX, pitchY, back) {
  const { width, height, values, step } = map, inside = step / (2 * pitchX), border = step / pitchX;
  for (let row = 0; row < height; row++) {
    const up = row > 0 ? width : 0, down = row < height - 1 ? width : 0;
    const dy = step / (pitchY * ((up > 0) + (down > 0)));
    for (let column = 0; column < width; column++) {
      const at = row * width + column, left = column > 0 ? 1 : 0, right = column < width - 1 ? 1 : 0;
      const p = (values[at + right] - values[at - left]) * (left & right ? inside : border);
      const q = (values[at + down] - values[at - up]) * dy;
      const norm = 1 / Math.sqrt(p * p + q * q + 1);
      back(at, -p * norm, -q * norm, norm);
    }
  }
}
