// The time axis that all rows share: what is shown, what is drawn when, pointer, wheel and keys.

import { Row, LEFT, RIGHT } from "./draw.js";
import { Tiles, levelFor, tilesOf, FACTOR } from "./tiles.js";
import { ask, clock, day, niceTime, short } from "./tools.js";

const LEAST_SAMPLES = 4;
const IDLE_MS = 80;
const NEXT_ZOOMS = [1, 2, 3, 4].map((step) => FACTOR ** -step); // what the wheel will want next, nearest first

export class View extends EventTarget {
  constructor(doc) {
    super();
    this.tiles = new Tiles(doc, () => { if (this.unsharp) this.draw(); });
    this.rows = [];
    this.marks = [];
    this.layers = { raw: true, processed: true, faults: true, calibrated: true };
    this.mode = null; // what a drag marks: "window", "steady" or nothing (zoom)
    this.startUtc = null;
    this.absolute = true;
    this.pinned = null;
    this.pointer = null;
    this.settling = [];
    this.stage = document.getElementById("stage");
    this.rowBox = document.getElementById("rows");
    this.axis = document.getElementById("axis");
    this.hair = this.overlay("hair");
    this.pin = this.overlay("hair pinned");
    this.rubber = this.overlay("rubber");
    new ResizeObserver(() => this.arrange()).observe(this.stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.colours = null; this.later(); });
    this.stage.addEventListener("scroll", () => this.later());
    this.listen();
  }

  overlay(kind) {
    const made = document.createElement("div");
    made.className = kind;
    made.hidden = true;
    this.rowBox.append(made);
    return made;
  }

  // Every series of the document; rows stay where they are.
  load(facts) {
    this.startUtc = facts.start_utc;
    this.series = facts.series.map((series, index) => ({ ...series, index }));
    const known = this.series.filter((series) => series.samples > 0);
    const raw = known.filter((series) => series.layer === "raw");
    this.first = Math.min(...raw.map((series) => series.start_s));
    this.last = Math.max(...raw.map((series) => series.start_s + series.samples / series.rate_hz));
    this.least = LEAST_SAMPLES / Math.max(...raw.map((series) => series.rate_hz));
    const before = new Map(this.rows.map((row) => [row.key, row]));
    for (const row of this.rows) row.series = [];
    for (const series of known) {
      const key = series.layer === "raw" ? `raw ${series.name}` : series.layer;
      let row = before.get(key);
      if (!row) {
        row = new Row(key, this.rowBox);
        row.hidden = false;
        before.set(key, row);
        this.rows.push(row);
      }
      row.series.push(series);
      row.name.textContent = series.layer === "raw" ? series.name : series.layer;
      row.layer = series.layer.split(" ")[0];
      row.recorded = series.unit;
    }
    for (const row of this.rows.filter((one) => !one.series.length)) row.element.remove();
    this.rows = this.rows.filter((row) => row.series.length);
    if (this.from === undefined) [this.from, this.to] = [this.first, this.last];
    this.arrange();
  }

  arrange() {
    const shown = this.rows.filter((row) => !row.hidden && this.layers[row.layer]).length || 1;
    // Few rows share the height there is, many scroll.
    const room = (this.stage.clientHeight - this.axis.clientHeight) / shown - 24;
    const high = Math.round(Math.min(Math.max(room, innerWidth > 800 ? 84 : 72), 260));
    this.rowBox.style.setProperty("--high", `${high}px`);
    for (const row of this.rows) {
      row.element.hidden = row.hidden || !this.layers[row.layer];
      row.unit.textContent = row.calibration && this.layers.calibrated ? row.calibration.unit : row.recorded;
      this.rowBox.append(row.element);
    }
    this.later();
  }

  get inner() {
    return Math.max(this.axis.clientWidth - LEFT - RIGHT, 10);
  }

  timeAt(clientX) {
    const box = this.axis.getBoundingClientRect();
    const share = Math.min(Math.max((clientX - box.left - LEFT) / this.inner, 0), 1);
    return this.from + share * (this.to - this.from);
  }

  xOf(seconds) {
    return LEFT + ((seconds - this.from) / (this.to - this.from)) * this.inner;
  }

  show(from, to) {
    if (this.first === undefined) return;
    const whole = this.last - this.first;
    const wide = Math.min(Math.max(to - from, this.least), whole);
    const middle = 0.5 * (from + to);
    this.from = Math.min(Math.max(middle - 0.5 * wide, this.first), this.last - wide);
    this.to = this.from + wide;
    this.turn = this.tiles.error = null;
    this.tiles.want(this.keys(this.from, this.to)); // before anything is drawn
    this.later();
    this.dispatchEvent(new Event("shown"));
  }

  all() { this.show(this.first, this.last); }
  shift(share) { const by = share * (this.to - this.from); this.show(this.from + by, this.to + by); }
  zoom(factor, about = this.pointer ?? 0.5 * (this.from + this.to)) {
    const wide = Math.max((this.to - this.from) * factor, this.least);
    const share = (about - this.from) / (this.to - this.from);
    this.show(about - share * wide, about + (1 - share) * wide);
  }

  // The tiles that a stretch is drawn from; a wider or nearer one's, as if it were shown.
  keys(from, to, scale = to - from) {
    const keys = [];
    const count = Math.round(this.inner * (devicePixelRatio || 1));
    for (const row of this.visible()) {
      for (const series of row.series) {
        const level = levelFor(series, scale / count);
        const [first, last] = tilesOf(series, level, from, to);
        for (let index = first; index <= last; index++) keys.push(`${series.index}.${level}.${index}`);
      }
    }
    return keys;
  }

  // What is likely shown next: nearer about the pointer, then beside, then from further away. One request at a time and
  // none once something else is shown, so that nothing that is looked at waits for what may be.
  async lookAhead() {
    const { from, to, pointer } = this, wide = to - from;
    const about = pointer ?? 0.5 * (from + to), turn = (this.turn = {});
    const near = NEXT_ZOOMS.map((factor) => this.keys(about - (about - from) * factor, about + (to - about) * factor));
    const rest = [this.keys(from - wide, to + wide, wide), this.keys(about - (about - from) * FACTOR, about + (to - about) * FACTOR)];
    for (const keys of [...near, ...rest]) {
      await this.tiles.want(keys);
      if (this.turn !== turn || this.tiles.error) return;
    }
  }

  visible() {
    const top = this.stage.scrollTop - 200, bottom = this.stage.scrollTop + this.stage.clientHeight + 200;
    return this.rows.filter((row) => !row.element.hidden && row.element.offsetTop < bottom && row.element.offsetTop + row.element.offsetHeight > top);
  }

  later() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => this.draw());
  }

  palette() {
    const style = getComputedStyle(document.documentElement);
    const names = ["ink", "soft", "line", "raw", "done", "fault", "window", "steady"];
    return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  draw() {
    cancelAnimationFrame(this.waiting);
    this.waiting = null;
    if (!this.series) return;
    this.colours ??= this.palette();
    for (const mark of this.marks) mark.colour = this.colours[mark.kind === "steady" ? "steady" : "window"];
    const missing = [];
    for (const row of this.visible()) row.draw(this, missing);
    this.drawAxis();
    this.place();
    this.unsharp = missing.length > 0;
    if (this.unsharp && !this.tiles.error) {
      this.tiles.want(missing);
      return;
    }
    if (this.tiles.error) this.dispatchEvent(new CustomEvent("failed", { detail: this.tiles.error.message }));
    this.settled = performance.now();
    this.settling.splice(0).forEach((resolve) => resolve(this.settled));
    if (!this.turn) this.lookAhead();
    clearTimeout(this.asking);
    this.asking = setTimeout(() => this.askRates(), IDLE_MS);
  }

  // The rate of each train whose pulses are too many to be told apart.
  async askRates() {
    const { from, to } = this, shown = `${from} ${to}`;
    for (const row of this.visible().filter((one) => one.train && one.asked !== shown)) {
      row.asked = shown;
      const told = await ask("pulses", { doc: this.tiles.doc, series: row.series[0].index, from, to }).catch(() => null);
      if (from !== this.from || to !== this.to) return;
      row.rate = row.train && told?.time.length ? told : null;
      this.later();
    }
  }

  // Resolves when what is shown is drawn from its own tiles.
  whenSettled() {
    return new Promise((resolve) => { this.settling.push(resolve); this.later(); });
  }

  drawAxis() {
    const ratio = devicePixelRatio || 1, canvas = this.axis;
    const wide = canvas.clientWidth, tall = canvas.clientHeight;
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(tall * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const span = this.to - this.from;
    const step = niceTime((span / this.inner) * 105);
    const start = this.absolute ? this.startUtc : null;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillStyle = context.strokeStyle = this.colours.soft;
    // From a whole hour of the day, where the time of day is shown.
    const zero = start === null ? 0 : -(start % 86400);
    for (let mark = zero + Math.ceil((this.from - zero) / step - 1e-9) * step; mark <= this.to; mark += step) {
      const x = this.xOf(mark);
      context.fillRect(x, 0, 1, 5);
      const half = context.measureText(clock(mark, step, start)).width / 2;
      if (x - half > 0 && x + half < wide) context.fillText(clock(mark, step, start), x, 18);
    }
    context.textAlign = "left";
    const zone = start === null ? "since the log's start" : `${day(this.from, start)} UTC`;
    context.fillText(`${zone} · ${short(span, 4)} s shown`, LEFT, 34, wide - LEFT);
    for (const mark of this.marks) {
      const x = Math.max(this.xOf(mark.start_s), LEFT), right = Math.min(this.xOf(mark.stop_s), LEFT + this.inner);
      if (right <= x) continue;
      context.fillStyle = mark.colour;
      context.fillRect(x, 0, right - x, 3);
    }
  }

  place() {
    const set = (element, seconds) => {
      element.hidden = seconds === null || seconds < this.from || seconds > this.to;
      if (!element.hidden) element.style.left = `${this.xOf(seconds)}px`;
    };
    this.rowBox.style.position = "relative";
    set(this.hair, this.pointer);
    set(this.pin, this.pinned);
    this.tellValues();
  }

  tellValues() {
    const at = this.pointer ?? this.pinned;
    for (const row of this.rows) {
      if (row.element.hidden) continue;
      const values = at === null ? null : row.at(this, at);
      let text = "";
      if (values) {
        text = values[0] === values[1] ? short(values[0], 6) : `${short(values[0], 5)} … ${short(values[1], 5)}`;
        if (this.pinned !== null && this.pointer !== null) {
          const other = row.at(this, this.pinned);
          const middle = (pair) => 0.5 * (pair[0] + pair[1]);
          if (other) text += `  Δ ${short(middle(values) - middle(other), 5)}`;
        }
      }
      row.value.textContent = text;
    }
    this.dispatchEvent(new Event("cursor"));
  }

  setPointer(seconds) {
    this.pointer = seconds;
    this.place();
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.lookAhead(), IDLE_MS);
  }

  togglePin(seconds) {
    this.pinned = this.pinned === null || Math.abs(this.xOf(seconds) - this.xOf(this.pinned)) > 4 ? seconds : null;
    this.place();
  }

  setMode(mode) {
    this.mode = this.mode === mode ? null : mode;
    this.dispatchEvent(new Event("mode"));
  }

  listen() {
    const fingers = new Map();
    let begun = null, pinch = null;
    this.stage.addEventListener("wheel", (event) => {
      if (this.first === undefined) return;
      if (event.ctrlKey === false && Math.abs(event.deltaX) > Math.abs(event.deltaY)) this.shift(event.deltaX / this.inner);
      else if (event.shiftKey) this.shift((event.deltaY || event.deltaX) / this.inner);
      else if (event.altKey) return; // scrolls the rows
      else this.zoom(Math.exp(Math.min(Math.max(event.deltaY, -240), 240) * 0.003), this.timeAt(event.clientX));
      event.preventDefault();
    }, { passive: false });
    this.stage.addEventListener("pointerdown", (event) => {
      if (event.button > 1 || this.first === undefined) return;
      fingers.set(event.pointerId, event);
      this.stage.setPointerCapture(event.pointerId);
      if (fingers.size === 2) {
        const [one, two] = [...fingers.values()];
        pinch = { apart: Math.max(Math.abs(one.clientX - two.clientX), 10), from: this.from, to: this.to, about: this.timeAt(0.5 * (one.clientX + two.clientX)) };
        begun = null;
        this.rubber.hidden = true;
        return;
      }
      const pan = event.button === 1 || event.altKey || (event.pointerType === "touch" && !this.mode);
      begun = { x: event.clientX, time: this.timeAt(event.clientX), from: this.from, to: this.to, pan };
    });
    this.stage.addEventListener("pointermove", (event) => {
      if (fingers.has(event.pointerId)) fingers.set(event.pointerId, event);
      if (pinch && fingers.size === 2) {
        const [one, two] = [...fingers.values()];
        const factor = pinch.apart / Math.max(Math.abs(one.clientX - two.clientX), 10);
        this.show(pinch.about - (pinch.about - pinch.from) * factor, pinch.about + (pinch.to - pinch.about) * factor);
        return;
      }
      if (begun?.pan) {
        const by = ((begun.x - event.clientX) / this.inner) * (begun.to - begun.from);
        this.show(begun.from + by, begun.to + by);
      } else if (begun && Math.abs(event.clientX - begun.x) > 3) {
        const [left, right] = [begun.time, this.timeAt(event.clientX)].sort((a, b) => a - b).map((time) => this.xOf(time));
        this.rubber.hidden = false;
        this.rubber.className = this.mode ? "rubber mark" : "rubber";
        this.rubber.style.left = `${left}px`;
        this.rubber.style.width = `${right - left}px`;
      }
      this.setPointer(this.timeAt(event.clientX));
    });
    const end = (event) => {
      fingers.delete(event.pointerId);
      if (pinch) { if (!fingers.size) pinch = null; return; }
      const from = begun;
      begun = null;
      this.rubber.hidden = true;
      if (!from || from.pan || event.type === "pointercancel") return;
      const times = [from.time, this.timeAt(event.clientX)].sort((a, b) => a - b);
      if (Math.abs(event.clientX - from.x) <= 3) { this.togglePin(times[0]); return; }
      if (this.mode) this.dispatchEvent(new CustomEvent("marked", { detail: { kind: this.mode, start_s: times[0], stop_s: times[1] } }));
      else this.show(...times);
    };
    this.stage.addEventListener("pointerup", end);
    this.stage.addEventListener("pointercancel", end);
    this.stage.addEventListener("pointerleave", () => { if (!begun) this.setPointer(null); });
    this.stage.addEventListener("dblclick", () => this.all());
  }
}
