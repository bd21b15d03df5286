// The layer of faults: what `shipfp inspect` lists, on the rows of its channels.

import { ask, clock, until } from "./tools.js";

export class Faults {
  constructor(view, doc, say, trial) {
    Object.assign(this, { view, doc, say, trial, list: [], spans: [], at: -1 });
    document.addEventListener("saved", (event) => {
      if (this.doc === event.detail) return;
      Object.assign(this, { doc: event.detail, trial: true });
      this.load();
    });
  }

  async load() {
    const told = await until(() => ask("faults", { doc: this.doc })).catch((error) => ({ error: error.message }));
    if (told.error !== undefined) {
      this.say(`faults: ${told.error}`, "bad");
      return;
    }
    this.list = told.faults;
    const every = [];
    for (const row of this.view.rows) Object.assign(row, { faultSpans: [], faultsTold: [] });
    const rows = new Map(this.view.rows.map((row) => [row.key, row]));
    for (const fault of this.list) {
      const row = rows.get(`raw ${fault.channel}`);
      row?.faultsTold.push(`${fault.label} (${fault.times.length})`);
      for (const span of fault.times) {
        // What is wrong with the clock is wrong with every channel.
        for (const one of row ? [row] : this.view.rows) one.faultSpans.push(span);
        every.push({ span, fault });
      }
    }
    for (const row of this.view.rows) row.faultSpans.sort((a, b) => a[0] - b[0]);
    this.spans = every.sort((a, b) => a.span[0] - b.span[0]);
    // Of a log alone nobody knows which channel is a set point or a torque.
    const alone = this.trial ? "" : `; looked for with a saved trial only: ${told.left_out.join(", ")}`;
    // A difference that is being read stays.
    if (this.view.pinned === null) this.say(this.spans.length ? `${this.spans.length} ${this.spans.length === 1 ? "fault" : "faults"} found: n and p go from one to the next${alone}` : `no faults found${alone}`);
    document.body.dataset.faults = String(this.spans.length);
    this.view.later();
    document.dispatchEvent(new Event("rows")); // the cards of the channels tell them, too
  }

  next(way) {
    if (!this.spans.length) return;
    const { view } = this;
    this.at = (this.at + way + this.spans.length) % this.spans.length;
    const { span, fault } = this.spans[this.at];
    const wide = Math.max(view.to - view.from, 4 * (span[1] - span[0]));
    const middle = 0.5 * (span[0] + span[1]);
    view.show(middle - 0.5 * wide, middle + 0.5 * wide);
    this.say(`fault ${this.at + 1} of ${this.spans.length}: ${fault.label} (${fault.kind}) in ${fault.channel} at ${clock(span[0], 0.01)}`);
  }
}
