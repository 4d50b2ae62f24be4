// The websocket: comes back by itself, gives credit for each picture drawn, keeps the server's clock.

import { readMessage } from "./frame.js";

const PAGE_KEY = "gelform-page";

/** How this tab names itself to the server, which knows it again after it was loaded anew. */
function pageName() {
  const kept = sessionStorage.getItem(PAGE_KEY), made = kept ?? Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem(PAGE_KEY, made);
  return made;
}

const FIRST_WAIT_MS = 300, LONGEST_WAIT_MS = 4000, PING_EVERY_MS = 2000, SILENT_MS = 5000, AHEAD = 2;

export class Connection extends EventTarget {
  constructor() {
    super();
    this.page = pageName();
    this.open = false;
    this.clockOffset = 0; // server's clock minus ours, s
    this.bytes = 0;
    this.waitMs = FIRST_WAIT_MS;
    this.bestTrip = Infinity;
    this.watched = null;
    this.lastSerial = new Map();
    this.ahead = AHEAD; // pictures of a station that may be on their way
    setInterval(() => this.look(), PING_EVERY_MS);
    document.addEventListener("visibilitychange", () => { if (!document.hidden && !this.open) this.connect(); });
  }

  connect() {
    clearTimeout(this.timer);
    if (this.socket && this.socket.readyState <= 1) return;
    const socket = new WebSocket(`ws://${location.host}/ws?page=${this.page}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => this.opened();
    socket.onmessage = (event) => this.heard(event.data).catch((problem) => this.say("trouble", String(problem.message || problem)));
    socket.onclose = (event) => this.closed(socket, event);
  }

  /** Ask for a sign of life; a socket that has been silent for long (the machine slept, the network changed) is given up. */
  look() {
    if (this.open && performance.now() - this.heardAt > SILENT_MS) {
      const silent = this.socket;
      this.socket = null; // its own closing may take minutes
      silent.onmessage = silent.onclose = null;
      silent.close();
      this.lost("");
    } else this.ping();
  }

  opened() {
    this.open = true;
    this.heardAt = performance.now();
    this.waitMs = FIRST_WAIT_MS;
    this.bestTrip = Infinity;
    this.lastSerial.clear();
    this.ping();
    if (this.watched) this.send(this.watched);
    this.giveAhead(this.watched?.stations.length ?? 1);
    this.say("open");
  }

  closed(socket, event) {
    if (socket === this.socket) this.lost(event.reason || "");
  }

  lost(reason) {
    this.open = false;
    this.say("closed", reason);
    this.timer = setTimeout(() => this.connect(), this.waitMs);
    this.waitMs = Math.min(LONGEST_WAIT_MS, this.waitMs * 1.6);
  }

  async heard(data) {
    this.heardAt = performance.now();
    if (typeof data === "string") return this.heardWords(JSON.parse(data));
    this.bytes += data.byteLength;
    const message = await readMessage(data).catch((problem) => {
      this.credit(); // it took one, and is never drawn
      throw problem;
    });
    const { station, serial } = message.header;
    if (serial <= (this.lastSerial.get(station) ?? 0)) return this.credit(); // decoded after a newer one
    this.lastSerial.set(station, serial);
    this.say("frame", message);
  }

  heardWords(words) {
    if (words.kind !== "pong") return this.say(words.kind, words);
    const now = performance.now() / 1000, trip = now - words.sent;
    this.bestTrip *= 1.05; // clocks drift: an old short trip does not count for ever
    if (trip < this.bestTrip) {
      this.bestTrip = trip;
      this.clockOffset = words.now_s + trip / 2 - now;
    }
  }

  /** The server's clock now, s. */
  get now() { return performance.now() / 1000 + this.clockOffset; }

  /** `few`: stations of which the surface alone is shown. */
  watch(stations, planes, encoding, few) {
    const more = stations.length - (this.watched?.stations.length ?? 1);
    this.watched = { do: "watch", stations, planes, encoding, few };
    this.lastSerial.clear();
    this.send(this.watched);
    if (more > 0) this.giveAhead(more);
  }

  giveAhead(stations) { this.credit(this.ahead * stations); }

  credit(count = 1) { for (let k = 0; k < count; k++) this.send({ do: "credit" }); }

  /** As `credit`, after a while: for the socket of now alone. */
  creditLater(count, waitMs) {
    const { socket } = this;
    setTimeout(() => { if (socket === this.socket) this.credit(count); }, waitMs);
  }

  ping() { this.send({ do: "ping", sent: performance.now() / 1000 }); }
  send(words) { if (this.socket && this.socket.readyState === 1) this.socket.send(JSON.stringify(words)); }
  say(kind, detail) { this.dispatchEvent(new CustomEvent(kind, { detail })); }
}

/** Change the token of the address for a cookie; takes it out of the address, so that it is not copied along. */
export async function signIn() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (!token) return true;
  history.replaceState(null, "", location.pathname);
  const answer = await fetch("/session", { method: "POST", body: token, headers: { "content-type": "text/plain" } });
  return answer.ok;
}
