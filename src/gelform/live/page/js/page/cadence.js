// A pace for what need not be drawn each time.

export class Cadence {
  /** At most every `everyMs`; what is passed over is drawn later: `redraw` is called then. */
  constructor(everyMs, redraw) {
    this.everyMs = everyMs;
    this.redraw = redraw;
    this.at = -Infinity;
    this.timer = 0;
  }

  /** Whether its time has come. */
  due(now) {
    const wait = this.at + this.everyMs - now;
    if (wait <= 0) this.at = now;
    else this.timer ||= setTimeout(() => { this.timer = 0; this.redraw(); }, wait);
    return wait <= 0;
  }

  /** Draw it the next time in any case. */
  hurry() { this.at = -Infinity; }
}
