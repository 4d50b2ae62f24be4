// The programs of the surface. A vertex is a pixel of the depth map: its place comes from its number, its height from a texture.

const HEIGHT = `
uniform highp sampler2D depth;
uniform ivec2 size;        // of the depth map
uniform ivec2 grid;        // vertices along x and y
uniform vec2 extent;       // width and height of the map, its longer side 2
uniform float lift;        // units of height per unit of depth
float heightAt(ivec2 at) { return lift * texelFetch(depth, clamp(at, ivec2(0), size - 1), 0).r; }
`;

export const SURFACE_VERTEX = `#version 300 es
precision highp float;
${HEIGHT}
uniform mat4 camera;
out vec3 normal; out float level; out vec2 place; out vec3 seen;
void main() {
  ivec2 cell = ivec2(gl_VertexID % grid.x, gl_VertexID / grid.x);
  place = vec2(cell) / vec2(grid - 1);
  ivec2 at = ivec2(round(place * vec2(size - 1)));
  int step = max(1, size.x / grid.x);
  vec2 pixel = extent / vec2(size);
  float z = heightAt(at);
  float dx = (heightAt(at + ivec2(step, 0)) - heightAt(at - ivec2(step, 0))) / (2.0 * float(step) * pixel.x);
  float dy = (heightAt(at + ivec2(0, step)) - heightAt(at - ivec2(0, step))) / (2.0 * float(step) * pixel.y);
  normal = vec3(-dx, dy, 1.0);
  level = texelFetch(depth, at, 0).r;
  vec3 position = vec3((place.x - 0.5) * extent.x, (0.5 - place.y) * extent.y, z);
  seen = position;
  gl_Position = camera * vec4(position, 1.0);
}`;

export const SURFACE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal; in float level; in vec2 place; in vec3 seen;
uniform sampler2D colors; uniform sampler2D drape; uniform float range; uniform int draped; uniform vec3 eye;
out vec4 color;
void main() {
  vec3 n = normalize(normal);
  vec3 base = draped == 1 ? texture(drape, place).rgb : texture(colors, vec2(clamp(level / range, 0.0, 1.0), 0.5)).rgb;
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
void main() { gl_Position = camera * vec4(position, 1.0); }`;

export const LINE_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 ink; out vec4 color;
void main() { color = ink; }`;
