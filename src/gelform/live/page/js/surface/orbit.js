// The camera of the surface: turned by mouse, finger and keys.

const FIRST = { turn: -0.5, tilt: 0.88, distance: 2.95, x: 0, y: 0 };

export class Orbit {
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

  /** 4x4 matrix, column by column, from the surface's space to the screen. */
  matrix(aspect) {
    const eye = this.eye, length = Math.hypot(...eye), back = eye.map((v) => v / length);
    const side = [Math.cos(this.turn), Math.sin(this.turn), 0];
    const up = [back[1] * side[2] - back[2] * side[1], back[2] * side[0] - back[0] * side[2], back[0] * side[1] - back[1] * side[0]];
    const zoom = 1 / Math.tan(0.35) / Math.max(1, 1.4 / aspect), near = 0.05, far = 30;
    const rows = [side, up, back].map((axis) => [...axis, -axis.reduce((sum, v, k) => sum + v * eye[k], 0)]);
    rows[0][3] -= this.x;
    rows[1][3] -= this.y;
    const [a, b, c] = rows, deep = (far + near) / (near - far), shift = (2 * far * near) / (near - far);
    return new Float32Array([0, 1, 2, 3].flatMap((k) => [(zoom / aspect) * a[k], zoom * b[k], deep * c[k] + (k === 3 ? shift : 0), -c[k]]));
  }
}
