// The programs of the surface. A vertex is a pixel of the depth map: its place comes from its number, its height from a texture.

const HEIGHT = `
uniform highp usampler2D depth;
uniform vec2 meaning;      // depth = (number - meaning.x) * meaning.y
uniform highp ivec2 size;  // of the depth map
uniform vec2 extent;       // width and height of the map, its longer side 2
uniform float lift;        // units of height per unit of depth
float depthAt(ivec2 at) { return (float(texelFetch(depth, clamp(at, ivec2(0), size - 1), 0).r) - meaning.x) * meaning.y; }
vec3 normalAt(ivec2 at, int step) {
  vec2 across = 2.0 * float(step) * extent / vec2(size);
  float dx = lift * (depthAt(at + ivec2(step, 0)) - depthAt(at - ivec2(step, 0))) / across.x;
  float dy = lift * (depthAt(at + ivec2(0, step)) - depthAt(at - ivec2(0, step))) / across.y;
  return vec3(-dx, dy, 1.0);
}
`;

export const SURFACE_VERTEX = `#version 300 es
precision highp float;
${HEIGHT}
uniform ivec2 grid;        // vertices along x and y
uniform mat4 camera;
out vec3 normal; out float level; out vec2 place; out vec3 seen;
void main() {
  ivec2 cell = ivec2(gl_VertexID % grid.x, gl_VertexID / grid.x);
  place = vec2(cell) / vec2(grid - 1);
  ivec2 at = ivec2(round(place * vec2(size - 1)));
  normal = normalAt(at, max(1, size.x / grid.x));
  level = depthAt(at);
  vec3 position = vec3((place.x - 0.5) * extent.x, (0.5 - place.y) * extent.y, lift * level);
  seen = position;
  gl_Position = camera * vec4(position, 1.0);
}`;

/** `coarse`: there are few vertices, and each pixel of the screen reads the map itself, so that the shading is as fine. */
export const surfaceFragment = (coarse) => `#version 300 es
precision highp float;
${coarse ? HEIGHT : "uniform highp ivec2 size;"}
uniform highp usampler2D unknown; uniform int hatched;
in vec3 normal; in float level; in vec2 place; in vec3 seen;
uniform sampler2D colors; uniform sampler2D drape; uniform float range; uniform int draped; uniform vec3 eye;
out vec4 color;
void main() {
  ivec2 at = ivec2(round(place * vec2(size - 1)));
  ${coarse ? "vec3 n = normalize(normalAt(at, 1)); float z = depthAt(at);" : "vec3 n = normalize(normal); float z = level;"}
  vec3 base = draped == 1 ? texture(drape, place).rgb : texture(colors, vec2(clamp(z / range, 0.0, 1.0), 0.5)).rgb;
  bool filled = hatched == 1 && (texelFetch(unknown, at, 0).r & 1u) != 0u; // no depth is known here: gray stripes
  if (filled) base = vec3((at.x + at.y) % 6 < 3 ? 0.56 : 0.38);
  vec3 towards = normalize(eye - seen);
  vec3 key = normalize(vec3(-0.5, 0.65, 0.75));
  float lit = 0.52 + 0.5 * max(dot(n, key), 0.0) + 0.14 * max(dot(n, normalize(vec3(0.8, -0.3, 0.35))), 0.0);
  float gloss = pow(max(dot(n, normalize(key + towards)), 0.0), 42.0);
  float rim = 0.12 * pow(1.0 - max(dot(n, towards), 0.0), 3.0);
  color = vec4(base * lit + vec3(0.22 * gloss + rim), 1.0);
}`;

export const LINE_VERTEX = `#version 300 es
precision highp float;
in vec3 position; uniform mat4 camera;
void main() {
  gl_Position = camera * vec4(position, 1.0);
  gl_Position.z -= 3e-4 * gl_Position.w; // a little nearer: the noise of a surface at rest does not cut it into dashes
}`;

export const LINE_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 ink; out vec4 color;
void main() { color = ink; }`;
