// Colour maps. viridis and cividis grow evenly in lightness, so they read the same to the colour-blind and in grey.

const ANCHORS = {
  viridis: "440154 481769 472a7a 433d84 3d4e8a 355e8d 2e6d8e 297b8e 23898e 1f978b 21a585 2eb37c 46c06f 65cb5e 89d548 b0dd2f d8e219 fde725",
  cividis: "00224e 002d68 163770 2e416d 3f4c6c 4e566c 5c616e 696b71 767676 838179 928c78 a09875 afa471 bfb06b cfbd62 dfca57 f0d846 fee838",
  grey: "101010 f4f4f4",
};
export const MAP_NAMES = Object.keys(ANCHORS);

function channels(hex) { return [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16)); }

/** 256 colours [r, g, b] of a map. */
export function ramp(name) {
  const anchors = ANCHORS[name].split(" ").map(channels);
  return Array.from({ length: 256 }, (_, k) => {
    const at = (k / 255) * (anchors.length - 1), low = Math.min(Math.floor(at), anchors.length - 2);
    return anchors[low].map((from, c) => Math.round(from + (anchors[low + 1][c] - from) * (at - low)));
  });
}

/** The same as pixels of an ImageData, in the machine's byte order (alpha last in memory). */
export function packedRamp(name) {
  const bytes = new Uint8Array(1024);
  ramp(name).forEach((rgb, k) => bytes.set([...rgb, 255], 4 * k));
  return new Uint32Array(bytes.buffer);
}

/** [r, g, b] of "#rrggbb". */
export const rgb = (color) => channels(color.slice(1));
