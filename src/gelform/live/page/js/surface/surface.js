// The surface in three dimensions, by WebGL2: the depth map is a texture that lifts a grid of vertices; its camera.

import { ramp } from "../maps/views.js";
import { fit } from "../page/dom.js";
import { LINE_FRAGMENT, LINE_VERTEX, SURFACE_VERTEX, surfaceFragment } from "./shaders.js";

const ZOOM = 1 / Math.tan(0.35), FILLED = 0.94, TURNS = 32; // of the lens; how much of the screen is filled; directions that are tried
const FIRST = { turn: -0.5, tilt: 0.88, distance: 2.95, x: 0, y: 0 };

/** Turned by mouse, finger and keys. */
class Orbit {
  constructor(canvas, changed) {
    this.changed = changed;
    this.pointers = new Map();
    this.reset();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.pointers.set(event.pointerId, event); });
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(0.0012 * event.deltaY)); }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("keydown", (event) => this.pressed(event));
  }

  reset() { Object.assign(this, FIRST); this.changed(); }

  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    const others = [...this.pointers.values()].filter((one) => one.pointerId !== event.pointerId);
    if (others.length) { // two fingers: pinch
      const apart = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY);
      this.zoom(apart(before) / Math.max(1, apart(event)));
    } else if (event.shiftKey || event.buttons & 6) this.shift(dx / 300, dy / 300);
    else this.rotate(-0.008 * dx, -0.008 * dy);
    this.pointers.set(event.pointerId, event);
  }

  pressed(event) {
    const turns = { ArrowLeft: [-0.12, 0], ArrowRight: [0.12, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] };
    if (turns[event.key]) this.rotate(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.9);
    else if (event.key === "-") this.zoom(1.1);
    else return;
    event.preventDefault();
  }

  rotate(turn, tilt) { this.turn += turn; this.tilt = Math.min(1.5, Math.max(0.05, this.tilt + tilt)); this.changed(); }
  zoom(by) { this.distance = Math.min(9, Math.max(1.2, this.distance * by)); this.changed(); }
  shift(x, y) { this.x -= x; this.y += y; this.changed(); }

  /** Where the eye is. */
  get eye() {
    const across = Math.sin(this.tilt) * this.distance;
    return [across * Math.sin(this.turn), -across * Math.cos(this.turn), Math.cos(this.tilt) * this.distance];
  }

  /** By how much a picture from the first distance has to be made larger, and moved up, so that the surface fills the screen however it is turned. */
  fitted(aspect, radius) {
    const { sin, cos, PI } = Math, rising = sin(this.tilt), up = cos(this.tilt);
    const seen = Array.from({ length: TURNS }, (_, k) => {
      const x = radius * cos((2 * PI * k) / TURNS), y = radius * sin((2 * PI * k) / TURNS), away = FIRST.distance + rising * y;
      return [(ZOOM * x) / away / aspect, (ZOOM * up * y) / away];
    });
    const low = Math.min(...seen.map(([, y]) => y)), high = Math.max(...seen.map(([, y]) => y)), wide = Math.max(...seen.map(([x]) => x));
    return { scale: FILLED / Math.max(wide, (high - low) / 2), middle: (low + high) / 2 };
  }

  /** 4x4 matrix, column by column, from the surface's space, where it lies in a circle of that radius, to the screen. */
  matrix(aspect, radius) {
    const eye = this.eye, length = Math.hypot(...eye), back = eye.map((v) => v / length);
    const side = [Math.cos(this.turn), Math.sin(this.turn), 0];
    const up = [back[1] * side[2] - back[2] * side[1], back[2] * side[0] - back[0] * side[2], back[0] * side[1] - back[1] * side[0]];
    const { scale, middle } = this.fitted(aspect, radius), zoom = ZOOM * scale, near = 0.05, far = 30;
    const rows = [side, up, back].map((axis) => [...axis, -axis.reduce((sum, v, k) => sum + v * eye[k], 0)]);
    rows[0][3] -= this.x;
    rows[1][3] -= this.y;
    const [a, b, c] = rows, deep = (far + near) / (near - far), shift = (2 * far * near) / (near - far);
    return new Float32Array([0, 1, 2, 3].flatMap((k) => [(zoom / aspect) * a[k], zoom * b[k] + scale * middle * c[k], deep * c[k] + (k === 3 ? shift : 0), -c[k]]));
  }
}

// Computed by the processor a triangle takes about a microsecond, however small it is.
const MOST_VERTICES = 100_000, MOST_IN_SOFTWARE = 1_600, SCALE_IN_SOFTWARE = 0.5;

export class Surface {
  /** Throws where the browser has no WebGL2. */
  constructor(canvas, redraw) {
    this.canvas = canvas;
    this.software = inSoftware();
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "low-power" });
    if (!gl) throw new Error("this browser has no WebGL2");
    this.gl = gl;
    this.lost = false;
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.lost = true; });
    canvas.addEventListener("webglcontextrestored", () => { this.lost = false; this.prepare(); redraw(); });
    this.prepare();
    this.orbit = new Orbit(canvas, redraw);
  }

  prepare() {
    const { gl } = this;
    this.program = program(gl, SURFACE_VERTEX, surfaceFragment(this.software));
    this.lines = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.depth = texture(gl, gl.NEAREST);
    this.colors = texture(gl, gl.LINEAR);
    this.drape = texture(gl, gl.LINEAR);
    this.unknown = texture(gl, gl.NEAREST);
    this.indices = gl.createBuffer();
    this.corners = gl.createBuffer();
    this.gridKey = this.colorsKey = "";
    this.drapes = this.hatching = null;
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1); // the border lies in the surface: it is drawn before it
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  }

  /** Draw a frame. `look`: {range, lift, colors, drape: null or a canvas, ink: [r, g, b, a]}; lift exaggerates the height. */
  draw(frame, look) {
    if (this.lost) return;
    const { gl } = this, map = frame.map("depth");
    if (!map) return this.clear(); // what was known of another frame says nothing of this one
    const pitch = frame.pitch(map);
    const spans = [map.width * pitch[0], map.height * pitch[1]], unit = 2 / Math.max(...spans);
    if (!fit(this.canvas, this.software ? SCALE_IN_SOFTWARE : Math.min(2, devicePixelRatio || 1))) return;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    this.upload(map, look);
    this.uploadUnknown(frame.planes.unknown, map);
    this.clear();
    const extent = spans.map((span) => span * unit), camera = this.orbit.matrix(this.canvas.width / this.canvas.height, Math.hypot(...extent) / 2);
    this.drawSurface(map, camera, extent, unit * look.lift, look);
    this.drawFrame(camera, extent, look.ink);
  }

  clear() {
    this.gl.clearColor(0, 0, 0, 0);
    this.gl.clear(this.gl.COLOR_BUFFER_BIT | this.gl.DEPTH_BUFFER_BIT);
  }

  drawSurface(map, camera, extent, lift, look) {
    const { gl } = this, set = uniforms(gl, this.program);
    gl.useProgram(this.program);
    this.bind(0, this.depth); this.bind(1, this.colors); this.bind(2, this.drape); this.bind(3, this.unknown);
    gl.uniform1i(set("unknown"), 3); gl.uniform1i(set("hatched"), this.hatched ? 1 : 0);
    gl.uniform1i(set("depth"), 0); gl.uniform1i(set("colors"), 1); gl.uniform1i(set("drape"), 2);
    gl.uniform2i(set("size"), map.width, map.height); gl.uniform2i(set("grid"), ...this.grid);
    gl.uniform2f(set("meaning"), map.zero, map.step);
    gl.uniform2f(set("extent"), ...extent); gl.uniform1f(set("lift"), lift);
    gl.uniform1f(set("range"), look.range); gl.uniform1i(set("draped"), look.drape ? 1 : 0);
    gl.uniform3f(set("eye"), ...this.orbit.eye); gl.uniformMatrix4fv(set("camera"), false, camera);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
  }

  /** The border of the image at depth 0, so that one sees what is pressed and what is drawn down. */
  drawFrame(camera, [width, height], ink) {
    const { gl } = this, x = width / 2, y = height / 2, set = uniforms(gl, this.lines);
    gl.useProgram(this.lines);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-x, -y, 0, x, -y, 0, x, y, 0, -x, y, 0]), gl.DYNAMIC_DRAW);
    const position = gl.getAttribLocation(this.lines, "position");
    gl.enableVertexAttribArray(position);
    gl.vertexAttribPointer(position, 3, gl.FLOAT, false, 0, 0);
    gl.uniformMatrix4fv(set("camera"), false, camera);
    gl.uniform4f(set("ink"), ...ink);
    gl.drawArrays(gl.LINE_LOOP, 0, 4);
    gl.disableVertexAttribArray(position);
  }

  upload(map, look) {
    const { gl } = this;
    this.makeGrid(map);
    this.bind(0, this.depth);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16UI, map.width, map.height, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, map.values);
    if (this.colorsKey !== look.colors) {
      this.colorsKey = look.colors;
      this.bind(1, this.colors);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(ramp(look.colors).flat()));
    }
    if (!look.drape && this.drapes === false) return;
    this.drapes = Boolean(look.drape);
    this.bind(2, this.drape);
    if (look.drape) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, look.drape);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  /** Where nothing is known, in the map's own pixels; nothing where all is. */
  uploadUnknown(plane, map) {
    const { gl } = this;
    this.hatched = Boolean(plane && plane.width === map.width && plane.height === map.height);
    this.bind(3, this.unknown);
    if (this.hatched) gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8UI, map.width, map.height, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, plane.values);
    else if (this.hatching !== false) gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8UI, 1, 1, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, new Uint8Array(1));
    this.hatching = this.hatched;
  }

  /** Triangles over the map, of every pixel or of every second, third ... where there are too many. */
  makeGrid({ width, height }) {
    const key = `${width}x${height}`;
    if (this.gridKey === key) return;
    this.gridKey = key;
    const stride = Math.max(1, Math.ceil(Math.sqrt((width * height) / (this.software ? MOST_IN_SOFTWARE : MOST_VERTICES))));
    const columns = Math.ceil(width / stride), rows = Math.ceil(height / stride);
    this.grid = [columns, rows];
    const indices = new Uint32Array(6 * (columns - 1) * (rows - 1));
    let at = 0;
    for (let row = 0; row < rows - 1; row++) for (let column = 0; column < columns - 1; column++) {
      const a = row * columns + column, b = a + columns;
      indices.set([a, b, a + 1, a + 1, b, b + 1], at);
      at += 6;
    }
    this.count = at;
    this.gl.bindBuffer(this.gl.ELEMENT_ARRAY_BUFFER, this.indices);
    this.gl.bufferData(this.gl.ELEMENT_ARRAY_BUFFER, indices, this.gl.STATIC_DRAW);
  }

  bind(unit, what) { this.gl.activeTexture(this.gl.TEXTURE0 + unit); this.gl.bindTexture(this.gl.TEXTURE_2D, what); }
}

let software = null;

/** Whether WebGL is computed by the processor. Asked once, of a canvas of its own, before the real ones are made with antialiasing or without. */
function inSoftware() {
  return (software ??= asked());
}

function asked() {
  const gl = document.createElement("canvas").getContext("webgl2"), named = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = named ? gl.getParameter(named.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made) || "a WebGL program does not link");
  return made;
}

function texture(gl, filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  return made;
}

const uniforms = (gl, made) => (name) => (made[`at_${name}`] ??= gl.getUniformLocation(made, name));
