// Numbers of the last ten seconds of each station, every result's, whether its picture was drawn or not.

const SPAN_S = 10;
const NAMES = ["time", "peak", "area", "volume"];

export class Series {
  constructor() { this.clear(); }

  clear() { for (const name of NAMES) this[name] = []; }

  /** Rows [time_s, peak, area, volume], in the order of time. */
  add(rows) {
    for (const row of rows) {
      if (this.time.length && row[0] <= this.time[this.time.length - 1]) continue;
      NAMES.forEach((name, k) => this[name].push(row[k]));
    }
    const last = this.time[this.time.length - 1], old = this.time.findIndex((t) => t >= last - SPAN_S);
    if (old > 0) for (const name of NAMES) this[name].splice(0, old);
  }
}
export { SPAN_S };
