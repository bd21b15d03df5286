// Panels that say what the channels are, mark windows, save TRIAL.toml, check and run it.

import { lineOf, ROLES, unitOf } from "./draft.js";
import { ask, button, field, make, menu, short, tell, until } from "./tools.js";
import { verdictBox } from "./results.js";
import { vesselForm } from "./vessel.js";

const PLACES = [["gauge", "strain gauge between the inertias"], ["brake", "engine's brake torque"], ["shaft", "shaft behind the gearbox"]];
const number = (text) => (text.trim() === "" ? null : Number.isFinite(Number(text.replace(",", "."))) ? Number(text.replace(",", ".")) : null);

// Each problem stands at its field, as soon as the field is there.
const showProblems = ({ problems }) => {
  for (const old of document.querySelectorAll(".problem")) old.remove();
  for (const field of document.querySelectorAll("[aria-invalid]")) for (const name of ["aria-invalid", "aria-describedby"]) field.removeAttribute(name);
  [...problems].reverse().forEach(({ at, text }, index) => { // the first one of a line comes next to it
    const field = fieldOf(at);
    if (!field) return;
    field.setAttribute("aria-invalid", "true");
    field.setAttribute("aria-describedby", `problem-${index}`);
    field.closest(".line").after(make(null, "p", { class: "told bad problem", id: `problem-${index}` }, text));
  });
};
const fieldOf = (at) => at && document.querySelector(`[aria-label="${CSS.escape(at)}"]`);

export class ChannelsPanel {
  constructor(view, draft) {
    Object.assign(this, { view, draft, box: document.getElementById("channels") });
    for (const event of ["loaded", "changed"]) draft.addEventListener(event, () => this.build());
    document.addEventListener("rows", () => this.build());
    this.build();
  }

  build() {
    const { box, view, draft } = this;
    if (box.contains(document.activeElement) && document.activeElement.tagName === "INPUT") return; // somebody types
    const focused = document.activeElement?.dataset?.key, scrolled = box.scrollTop;
    box.replaceChildren();
    make(box, "p", { class: "soft" }, "Say what each channel is. What needs no role stays without one.");
    if (draft.state && !draft.state.channels.length && draft.guess.length) {
      button(box, "take the roles that names and units tell", () => draft.take(draft.guess));
    }
    view.rows.forEach((row, index) => this.card(row, index));
    showProblems(draft);
    box.scrollTop = scrolled;
    if (focused) box.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  }

  card(row, index) {
    const { view, draft } = this, name = row.name.textContent;
    const card = make(this.box, "div", { class: "card" });
    const line = make(card, "div", { class: "line" });
    const seen = make(line, "input", { type: "checkbox", "aria-label": `show ${name}`, "data-key": `show ${name}` });
    seen.checked = !row.hidden;
    seen.addEventListener("change", () => { row.hidden = !seen.checked; view.arrange(); });
    make(line, "strong", { class: "grow" }, name);
    const move = (by) => {
      const other = index + by;
      if (other < 0 || other >= view.rows.length) return;
      [view.rows[index], view.rows[other]] = [view.rows[other], view.rows[index]];
      view.arrange();
      this.build();
    };
    button(line, "↑", () => move(-1), { "aria-label": `${name} up`, "data-key": `up ${name}`, disabled: index === 0 });
    button(line, "↓", () => move(1), { "aria-label": `${name} down`, "data-key": `down ${name}`, disabled: index === view.rows.length - 1 });
    const series = row.series[0];
    const gaps = row.layer === "raw" && series.gap_count ? `, ${series.gap_count} gaps` : "";
    make(card, "p", { class: "soft told" }, `${series.unit || "no unit"}, ${short(series.rate_hz)} Hz, ${series.samples.toLocaleString("en")} samples${gaps}`);
    if (row.faultsTold?.length) make(card, "p", { class: "told bad" }, `Faults: ${row.faultsTold.join(", ")}`);
    if (row.layer !== "raw" || !draft.state) return;
    const channel = draft.channel(series.name);
    const role = make(card, "div", { class: "line" });
    make(role, "span", { class: "soft" }, "is");
    menu(role, `role of ${name}`, [["", "—"], ...Object.entries(ROLES)], channel?.role ?? "", (value) => draft.setRole(series.name, value, series.unit), { "data-key": `role ${name}` });
    if (channel) this.details(card, channel, series);
  }

  details(card, channel, series) {
    const { draft } = this, name = channel.column;
    const line = make(card, "div", { class: "line" });
    const isTrain = channel.role === "train";
    if (isTrain) {
      make(line, "span", { class: "soft" }, "pulses a turn");
      field(line, `pulses a turn of ${name}`, channel.pulses_per_rev, (text) => { channel.pulses_per_rev = Math.round(number(text) ?? 0) || null; draft.change(); }, { type: "number", min: 1, step: 1, required: true });
    }
    if (isTrain || channel.role === "speed") {
      make(line, "span", { class: "soft" }, "of the");
      menu(line, `shaft of ${name}`, [...(channel.shaft ? [] : [["", "— which shaft?"]]), ["engine", "engine"], ["propeller", "propeller shaft"]], channel.shaft, (value) => { channel.shaft = value; draft.change(); });
    }
    if (isTrain) return;
    if (channel.role === "torque") {
      make(line, "span", { class: "soft" }, "measured by");
      menu(line, `place of ${name}`, PLACES, channel.location, (value) => { channel.location = value; draft.change(); });
    }
    if (channel.role === "load") {
      make(line, "span", { class: "soft" }, "measured as");
      menu(line, `quantity of ${name}`, [["torque", "torque of the shaft"], ["power", "power"], ["other", "another cause, such as pitch"]], channel.quantity, (value) => { channel.quantity = value; draft.change(); });
    }
    if (!series.unit || channel.unit !== series.unit) {
      make(line, "span", { class: "soft" }, "recorded in");
      field(line, `unit of ${name}`, channel.unit, (text) => { channel.unit = text.trim(); draft.change(); }, { class: "short" });
    }
    if (channel.role !== "speed" || draft.asks(channel)) this.calibration(card, channel, series);
  }

  calibration(card, channel, series) {
    const { draft, view } = this, { calibration } = channel, name = channel.column;
    const unit = unitOf(channel) || "its own unit";
    const line = make(card, "div", { class: "line" });
    make(line, "span", { class: "soft" }, `to ${unit} by`);
    menu(line, `calibration of ${name}`, [["scale", "scale and offset"], ["table", "two points or a table"]], calibration.table ? "table" : "scale", (value) => {
      channel.calibration = value === "table" ? { scale: null, offset: 0, table: [] } : { scale: null, offset: 0, table: null };
      draft.change();
    });
    if (!calibration.table) {
      const pair = make(card, "div", { class: "line" });
      field(pair, `scale of ${name}`, calibration.scale, (text) => { calibration.scale = number(text); draft.change(); }, { class: "short", placeholder: `${unit} per ${channel.unit || "unit"}`, inputmode: "decimal" });
      make(pair, "span", { class: "soft" }, "× recorded +");
      field(pair, `offset of ${name}`, calibration.offset, (text) => { calibration.offset = number(text) ?? 0; draft.change(); }, { class: "short", inputmode: "decimal" });
    } else {
      calibration.table.forEach((row, index) => this.reading(card, channel, row, index, unit));
      const more = make(card, "div", { class: "line" });
      button(more, "add a reading", () => { calibration.table.push([0, 0]); draft.change(); });
      button(more, "add the mean of what is shown", async () => {
        const { mean } = await ask("mean", { doc: draft.doc, series: series.index, from: view.from, to: view.to });
        if (mean !== null) { calibration.table.push([Number(mean.toPrecision(6)), 0]); draft.change(); }
      });
    }
    const fitted = lineOf(channel);
    make(card, "p", { class: fitted ? "told good" : "told bad" }, fitted ? `${short(fitted.scale, 6)} × recorded ${fitted.offset < 0 ? "−" : "+"} ${short(Math.abs(fitted.offset), 6)} ${fitted.unit}` : "not calibrated yet");
  }

  reading(card, channel, row, index, unit) {
    const { draft } = this, name = channel.column;
    const line = make(card, "div", { class: "line" });
    field(line, `reading ${index + 1} of ${name}`, row[0], (text) => { row[0] = number(text) ?? 0; draft.change(); }, { class: "short", inputmode: "decimal" });
    make(line, "span", { class: "soft" }, `${channel.unit || "recorded"} is`);
    field(line, `value ${index + 1} of ${name}`, row[1], (text) => { row[1] = number(text) ?? 0; draft.change(); }, { class: "short", inputmode: "decimal" });
    make(line, "span", { class: "soft" }, unit);
    button(line, "×", () => { channel.calibration.table.splice(index, 1); draft.change(); }, { "aria-label": `remove reading ${index + 1} of ${name}` });
  }
}

export class TrialPanel {
  constructor(view, draft, doc, say, showPanel) {
    Object.assign(this, { view, draft, doc, say, showPanel, box: document.getElementById("trial"), jobs: new Map() });
    for (const event of ["loaded", "changed"]) draft.addEventListener(event, () => this.build());
    draft.addEventListener("previewed", () => this.tellState());
    this.form = make(this.box, "div");
    draft.addEventListener("loaded", () => vesselForm(this.own, draft), { once: true });
    this.own = make(this.box, "details", { class: "card" });
    this.state = make(this.box, "p", { class: "told", role: "status" });
    this.list = make(this.box, "ul");
    this.acts = make(this.box, "div", { class: "line" });
    this.work = make(this.box, "div");
    this.text = make(this.box, "details");
    make(this.text, "summary", {}, "TRIAL.toml as it would be written");
    this.shown = make(this.text, "pre", { tabindex: 0 });
    this.make = button(this.acts, "processed signals", () => this.process(), { title: "speed, torque and set point of the windows, as the fit would see them" });
    this.save = button(this.acts, "save", () => this.saveFile(), { class: "main" });
    this.check = button(this.acts, "check", () => this.begin("check"));
    this.run = button(this.acts, "run", () => this.begin("run"));
  }

  build() {
    const { draft, form } = this, { state } = draft;
    if (!state || (form.contains(document.activeElement) && document.activeElement.tagName === "INPUT")) return;
    const focused = document.activeElement?.getAttribute("aria-label");
    form.replaceChildren();
    const head = make(form, "div", { class: "card" });
    if (draft.from) make(head, "p", { class: "soft told" }, `Roles, calibrations and windows are those of ${draft.from}.`);
    if (draft.others.length) {
      const others = make(head, "p", { class: "soft told" }, "Other trials of this log:");
      for (const other of draft.others) { others.append(" "); make(others, "a", { href: `?doc=${other.doc}` }, other.name); }
    }
    const one = make(head, "div", { class: "line" });
    make(one, "span", { class: "soft" }, "trial");
    field(one, "name of the trial", state.name, (text) => { state.name = text.trim() || "Trial"; draft.change(); }, { class: "grow" });
    const two = make(head, "div", { class: "line" });
    make(two, "span", { class: "soft" }, "ship");
    const vessels = [...new Set([state.vessel, ...draft.vessels])].filter(Boolean);
    menu(two, "ship", [["", "none: engine and propeller turn alike"], ...vessels.map((name) => [name, name])], state.vessel, (value) => { state.vessel = value; draft.change(); });
    const three = make(head, "div", { class: "line" });
    make(three, "span", { class: "soft" }, "file");
    field(three, "file of the trial", draft.file, (text) => { if (text.trim() !== draft.file) { draft.file = text.trim(); draft.version = ""; } draft.change(); }, { class: "grow" });
    if (draft.logs.length > 1) {
      const four = make(head, "div", { class: "line" });
      make(four, "span", { class: "soft" }, "log");
      menu(four, "log of the trial", draft.logs.map((log) => [String(log.doc), log.name]), String(this.doc), (value) => { location.search = `?doc=${value}`; });
    }
    this.steady(form);
    this.windows(form);
    if (focused) [...form.querySelectorAll("[aria-label]")].find((element) => element.getAttribute("aria-label") === focused)?.focus();
    this.tellState();
  }

  steady(form) {
    const { draft, view } = this, { state } = draft;
    make(form, "h3", {}, "Steady stretch");
    const line = make(form, "div", { class: "line" });
    if (state.steady_s) this.times(line, "steady", state.steady_s[0], state.steady_s[1], (start, stop) => draft.setSteady(start, stop));
    else make(line, "span", { class: "soft" }, "none: drag over a stretch with a constant set point");
    button(line, "mark", () => view.setMode("steady"), { "aria-label": "mark the steady stretch" });
  }

  windows(form) {
    const { draft, view } = this, { state } = draft;
    make(form, "h3", {}, "Windows");
    for (const window of state.windows.filter((one) => draft.isHere(one))) {
      const card = make(form, "div", { class: "card" });
      const line = make(card, "div", { class: "line" });
      field(line, "name of the window", window.name, (text) => { window.name = text.trim(); draft.change(); }, { class: "short" });
      const known = [["", "any kind"], ...draft.kinds];
      const kinds = known.some(([kind]) => kind === window.kind) ? known : [...known, [window.kind, window.kind]];
      menu(line, `kind of ${window.name}`, kinds, window.kind, (value) => { window.kind = value; draft.change(); });
      button(line, "show", () => { const space = 0.05 * (window.stop_s - window.start_s); view.show(window.start_s - space, window.stop_s + space); }, { "aria-label": `show ${window.name}` });
      button(line, "×", () => { state.windows = state.windows.filter((other) => other !== window); draft.change(); }, { "aria-label": `remove ${window.name}` });
      const span = make(card, "div", { class: "line" });
      this.times(span, window.name, window.start_s, window.stop_s, (start, stop) => { [window.start_s, window.stop_s] = [start, stop]; draft.look(window); });
      if (window.holds) make(card, "p", { class: "soft told" }, `found in it: ${draft.kindOf(window.holds)}`);
    }
    const line = make(form, "div", { class: "line" });
    button(line, "mark a window", () => view.setMode("window"), { "aria-label": "mark a window" });
    const left = (draft.found ?? []).filter((found) => !state.windows.some((window) => window.start_s < found.stop_s && window.stop_s > found.start_s));
    if (left.length) {
      button(line, `add all ${left.length} that were found`, () => draft.addFound());
      const told = left.slice(0, 6).map((found) => `${draft.kindOf(found)}, at ${short(found.start_s)} s`).join("; ");
      make(form, "p", { class: "soft told" }, `Found in ${draft.mover}: ${told}${left.length > 6 ? "; …" : ""}`);
    }
  }

  times(line, name, start, stop, change) {
    const { draft } = this;
    const set = (first, last) => { if (first !== null && last !== null) { change(first, last); draft.change(); } };
    const one = field(line, `start of ${name}`, start, (text) => set(number(text), stop), { class: "short", inputmode: "decimal" });
    make(line, "span", { class: "soft" }, "to");
    field(line, `end of ${name}`, stop, (text) => set(number(one.value), number(text)), { class: "short", inputmode: "decimal" });
    make(line, "span", { class: "soft" }, "s");
  }

  tellState() {
    const { draft } = this;
    this.shown.textContent = draft.text ?? "";
    const { problems } = draft;
    showProblems(draft);
    this.list.replaceChildren();
    for (const { at, text } of problems) {
      const line = make(this.list, "li", { class: "told bad" });
      if (at) button(line, at.startsWith("mark") ? text : `${at}: ${text}`, () => this.lead(at), { class: "link" });
      else line.textContent = text;
    }
    this.state.className = problems.length ? "told bad" : "told good";
    const saved = draft.version && !draft.changed;
    this.state.textContent = problems.length ? "Still to be given:" : draft.text === undefined ? "" : saved ? `${draft.file} is saved.` : "Complete; not saved yet.";
    for (const act of [this.save, this.check, this.run, this.make]) act.disabled = problems.length > 0 || draft.text === undefined;
  }

  // Show the field of a problem.
  lead(at) {
    const field = fieldOf(at);
    if (!field) return;
    this.showPanel(field.closest("[role=tabpanel]").id);
    field.focus();
    field.scrollIntoView({ block: "center" });
  }

  async attempt(act) {
    try {
      return await act();
    } catch (error) {
      this.state.className = "told bad";
      this.state.textContent = error.message;
      return null;
    }
  }

  saveFile() {
    const { draft } = this;
    return this.attempt(async () => {
      const told = await tell("save", { doc: this.doc, draft: draft.plain, file: draft.file, version: draft.version });
      sessionStorage.removeItem(draft.key);
      Object.assign(draft, { file: told.file, version: told.version, changed: false });
      // From now on this page is the trial's: another one that opens the log alone does not touch it.
      if (told.doc !== this.doc) { history.replaceState(null, "", `?doc=${told.doc}`); this.doc = draft.doc = told.doc; }
      this.tellState();
      document.dispatchEvent(new CustomEvent("saved", { detail: told.doc }));
      return told;
    });
  }

  process() {
    return this.attempt(async () => {
      const { draft, view } = this;
      await tell("process", { doc: view.tiles.doc, draft: draft.plain, file: draft.file });
      const done = await until(() => ask("processed", { doc: view.tiles.doc }), () => this.say("processing …"));
      if (done.error) throw new Error(done.error);
      const facts = await ask("document", { doc: view.tiles.doc });
      view.tiles.clear();
      view.load(facts);
      draft.show();
      document.dispatchEvent(new Event("rows"));
      this.say("processed signals are drawn below the channels");
    });
  }

  async begin(kind) {
    const { draft } = this;
    if ((draft.changed || !draft.version) && !(await this.saveFile())) return;
    const job = await this.attempt(() => tell("job", { kind, file: draft.file }));
    if (job) this.follow(job);
  }

  async follow(job) {
    const card = make(null, "div", { class: "card job" });
    this.work.prepend(card);
    const line = make(card, "div", { class: "line" });
    const told = make(line, "span", { class: "grow" }, `${job.kind}: beginning …`);
    const stop = button(line, "stop", () => this.attempt(() => tell("stop", { id: job.id })), { "aria-label": `stop the ${job.kind}` });
    const bar = make(card, "progress", { max: 1, value: 0, "aria-label": `how far the ${job.kind} is` });
    const end = await until(() => ask("job", { id: job.id }), (now) => { bar.value = now.share; told.textContent = `${now.kind}: ${now.progress || "beginning"} … ${now.seconds} s`; })
      .catch((error) => ({ state: "failed", error: error.message, warnings: [] }));
    stop.remove();
    bar.remove();
    card.dataset.state = end.state;
    told.textContent = `${job.kind} ${end.state} after ${end.seconds ?? 0} s`;
    if (end.error) make(card, "p", { class: "told bad" }, end.error);
    for (const warning of end.warnings ?? []) make(card, "p", { class: "soft told" }, warning);
    if (end.state !== "done") return;
    if (job.kind === "run") {
      verdictBox(card, end.done.folder, end.done.verdict, () => this.showPanel("results"));
      document.dispatchEvent(new CustomEvent("finished", { detail: end.done.folder }));
    } else this.checked(card, end.done);
  }

  checked(card, found) {
    make(card, "p", { class: "told" }, `Would be fitted: ${found.structure}, outputs ${found.outputs.join(", ")}.`);
    const told = Object.entries({ ...found.parameters, ...found.derived });
    const known = told.filter(([, one]) => one.ci95).map(([name, one]) => `${name} ${one.ci95.map((end) => short(end, 3)).join(" to ")} ${one.unit}`);
    make(card, "p", { class: "told" }, `Expected at a first look: ${known.join("; ") || "nothing"}.`);
    for (const [name, one] of told.filter(([, one]) => one.status === "unidentifiable")) make(card, "p", { class: "soft told" }, `${name}: ${one.reason}.`);
    for (const window of found.windows) {
      const usable = Object.entries(window.usable).map(([name, share]) => `${name} ${(100 * share).toFixed(1)} %`).join(", ");
      make(card, "p", { class: "told" }, `${window.name}: usable ${usable}; speed from ${window.speed_from}.`);
    }
    const missing = make(card, "ul");
    for (const line of found.missing) make(missing, "li", { class: "told" }, line);
    if (!found.missing.length) make(card, "p", { class: "told good" }, "Nothing is missing.");
  }
}
