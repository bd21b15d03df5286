// The trial as it is edited: roles, calibrations, windows; what the server makes of it, and what is missing.

import { ask, hertz, tell } from "./tools.js";

const PREVIEW_MS = 250;

// What a channel can be, as TRIAL.toml has it and as the page says it.
export const ROLES = {
  set_point: "set point", command: "command, no governor", torque: "torque", rack: "fuel rack", load: "load", speed: "speed", train: "pulse train",
};

export class Draft extends EventTarget {
  constructor(view, doc, say) {
    super();
    Object.assign(this, { view, doc, say, state: null, problems: [], changed: false, found: null });
    view.addEventListener("marked", (event) => this.mark(event.detail));
    view.addEventListener("layers", () => this.show());
  }

  async load() {
    const told = await ask("draft", { doc: this.doc });
    Object.assign(this, told, { state: told.draft, from: told.version ? told.file : null });
    const kept = JSON.parse(sessionStorage.getItem(this.key));
    if (kept?.version === told.version) Object.assign(this, kept, { changed: true });
    this.show();
    this.dispatchEvent(new Event("loaded"));
    this.findWindows();
    this.preview();
  }

  // What is not saved yet is kept for this tab under this name, and is here again after a reload.
  get key() {
    return `${location.pathname} ${this.doc}`;
  }

  channel(column) {
    return this.state.channels.find((channel) => channel.column === column);
  }

  columnOf(role) {
    return this.state?.channels.find((channel) => channel.role === role)?.column ?? null;
  }

  // The channel that was asked for: the set point, the command of a drive without governor, or else the load alone.
  get driver() {
    return this.columnOf("set_point") ?? this.columnOf("command") ?? this.columnOf("load");
  }

  // Whether a speed's unit leads to rpm by a calibration alone: per cent, volts.
  asks({ column, unit }) {
    return !this.speed_units.includes(unit) && (this.factors[column]?.speed?.asks ?? true);
  }

  // Say what a channel is; a unit that needs no calibration gets that unit's factor.
  setRole(column, role, unit) {
    this.state.channels = this.state.channels.filter((channel) => channel.column !== column);
    if (role) {
      const { factor = null, quantity = "torque" } = this.factors[column]?.[role] ?? {};
      this.state.channels.push({
        column, role, unit, calibration: { scale: factor, offset: 0, table: null }, location: "gauge", quantity, name: "", pulses_per_rev: null, shaft: role === "speed" ? "engine" : "", threshold: null,
      });
    }
    this.change();
    this.findWindows();
  }

  take(channels) {
    this.state.channels = channels;
    this.change();
    this.findWindows();
  }

  change() {
    this.changed = true;
    sessionStorage.setItem(this.key, JSON.stringify({ state: this.plain, file: this.file, version: this.version, steadyFound: this.steadyFound }));
    this.show();
    this.dispatchEvent(new Event("changed"));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.preview(), PREVIEW_MS);
  }

  // What the server would write, and all that is missing or wrong, each with the label of its field.
  async preview() {
    const turn = (this.turn = (this.turn ?? 0) + 1);
    let told;
    try {
      told = await tell("preview", { doc: this.doc, draft: this.plain, file: this.file });
    } catch (error) {
      told = { text: "", problems: [{ at: "", text: error.message }] };
    }
    if (turn !== this.turn) return;
    Object.assign(this, { text: told.text, problems: told.problems });
    this.dispatchEvent(new Event("previewed"));
  }

  // Rows in the values that calibrations give, windows as bands, roles on the labels.
  show() {
    if (!this.state) return;
    const { view } = this;
    for (const row of view.rows) {
      if (row.layer !== "raw") continue;
      const channel = this.channel(row.series[0].name);
      row.role.textContent = channel ? ROLES[channel.role] : "";
      row.calibration = channel && view.layers.calibrated ? lineOf(channel) : null;
      row.train = (channel ?? this.guess.find((one) => one.column === row.series[0].name))?.role === "train";
      row.turns = view.layers.calibrated ? channel?.pulses_per_rev : null;
      if (!row.train) row.rate = null;
    }
    view.marks = this.state.windows.filter((window) => this.isHere(window)).map((window) => ({ ...window, kind: "window" }));
    if (this.state.steady_s) view.marks.push({ start_s: this.state.steady_s[0], stop_s: this.state.steady_s[1], kind: "steady" });
    view.arrange();
  }

  // Whether a window is cut from this log; those without a log are of the first one.
  isHere(window) {
    return this.logs.length < 2 || (window.log ?? this.logs[0].name).split(/[\\/]/).pop() === this.logName;
  }

  get logName() {
    return this.logs.find((log) => log.doc === this.doc)?.name ?? null;
  }

  // Rests and excitations of the set point; the longest rest is the steady stretch until another one is marked.
  async findWindows() {
    const driver = this.driver, load = this.columnOf("load"), asked = `${driver} ${load}`;
    if (!driver || this.asked === asked) return;
    this.asked = asked;
    try {
      for (;;) {
        const told = await ask("windows", { doc: this.doc, driver, load: load ?? "" });
        if (told.state === "working") { await new Promise((resolve) => setTimeout(resolve, 300)); continue; }
        if (this.asked !== asked) return; // another channel was chosen meanwhile
        this.mover = told.column;
        this.found = told.state === "done" ? told.windows.filter((window) => window.kind !== "steady") : [];
        if (told.rest && (!this.state.steady_s || this.steadyFound)) {
          this.steadyFound = true;
          this.state.steady_s = told.rest.map(round);
          this.change();
        }
        break;
      }
    } catch (error) {
      this.say(error.message, "bad");
    }
    this.dispatchEvent(new Event("changed"));
  }

  async mark({ kind, start_s, stop_s }) {
    const { view } = this;
    view.setMode(null);
    [start_s, stop_s] = [round(start_s), round(stop_s)];
    if (kind === "steady") {
      this.setSteady(start_s, stop_s);
      this.change();
      return;
    }
    const window = { name: this.newName("W"), kind: "", start_s, stop_s, log: this.logs.length > 1 ? this.logName : null };
    this.state.windows.push(window);
    this.state.windows.sort((a, b) => a.start_s - b.start_s);
    this.change();
    await this.look(window);
  }

  // What a window holds, told beside it; its kind and name follow where nobody chose others.
  async look(window) {
    if (!this.driver) return;
    try {
      const { main } = await ask("within", { doc: this.doc, driver: this.driver, load: this.columnOf("load") ?? "", from: window.start_s, to: window.stop_s });
      window.holds = main;
      if (main && !window.kind) window.kind = main.kind;
      if (main && /^W\d+$/.test(window.name)) {
        const letter = main.name.replace(/\d+$/, "");
        window.name = this.newName(letter);
      }
    } catch (error) {
      this.say(error.message, "bad");
    }
    this.change();
  }

  // The steady stretch that somebody chose stays, whatever is found.
  setSteady(start_s, stop_s) {
    this.state.steady_s = [start_s, stop_s];
    this.steadyFound = false;
  }

  // The words of the report for what was found, and its frequencies.
  kindOf({ kind, frequency_hz: frequency }) {
    return [Object.fromEntries(this.kinds)[kind] ?? kind, hertz(frequency)].filter(Boolean).join(", ");
  }

  newName(letter) {
    for (let number = 1; ; number++) {
      if (!this.state.windows.some((window) => window.name === `${letter}${number}`)) return `${letter}${number}`;
    }
  }

  addFound() {
    for (const found of this.found ?? []) {
      if (this.state.windows.some((window) => window.start_s < found.stop_s && window.stop_s > found.start_s)) continue;
      const name = this.state.windows.some((window) => window.name === found.name) ? this.newName(found.name.replace(/\d+$/, "")) : found.name;
      this.state.windows.push({ name, kind: found.kind, start_s: round(found.start_s), stop_s: round(found.stop_s), log: null, holds: found });
    }
    this.state.windows.sort((a, b) => a.start_s - b.start_s);
    this.change();
  }

  // What is sent: nothing that only the page knows.
  get plain() {
    return { ...this.state, windows: this.state.windows.map(({ holds, ...window }) => window) };
  }
}

const round = (seconds) => Math.round(seconds * 1000) / 1000;

const READINGS = ["", "%", "V", "mV", "A", "mA"];
export const unitOf = ({ role, quantity, unit = "" }) =>
  ({ set_point: "rpm", torque: "Nm", load: { power: "W", other: "" }[quantity] ?? "Nm", speed: READINGS.includes(unit) ? "rpm" : unit })[role] ?? "";

// The straight line of a calibration: as given, or by least squares through its table; nothing where it is not complete.
export const lineOf = (channel) => {
  const { role, calibration } = channel;
  if (role === "train") return null;
  const unit = unitOf(channel);
  if (!calibration.table) return calibration.scale ? { scale: calibration.scale, offset: calibration.offset, unit } : null;
  const rows = calibration.table;
  const mean = (column) => rows.reduce((sum, row) => sum + row[column], 0) / rows.length;
  const [x, y] = [mean(0), mean(1)];
  const spread = rows.reduce((sum, row) => sum + (row[0] - x) ** 2, 0);
  if (rows.length < 2 || !spread) return null;
  const scale = rows.reduce((sum, row) => sum + (row[0] - x) * (row[1] - y), 0) / spread;
  return scale ? { scale, offset: y - scale * x, unit } : null;
};
