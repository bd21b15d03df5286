// Amplitudes by frequency of the stretch that is shown.

import { ask, button, make, menu, short } from "./tools.js";

export class SpectrumPanel {
  constructor(view, doc) {
    Object.assign(this, { view, doc, box: document.getElementById("spectrum"), series: 0 });
    const line = make(this.box, "div", { class: "line" });
    this.pick = menu(line, "channel of the spectrum", [], "", (value) => { this.series = Number(value); this.load(); });
    this.log = true;
    this.kind = button(line, "amplitude as logarithm", () => {
      this.log = !this.log;
      this.kind.setAttribute("aria-pressed", String(this.log));
      this.draw();
    }, { "aria-pressed": "true" });
    this.canvas = make(this.box, "canvas", { role: "img", "aria-label": "spectrum" });
    this.told = make(this.box, "p", { class: "told" });
    this.peaks = make(this.box, "table");
    document.addEventListener("panel", (event) => { this.shown = event.detail === "spectrum"; if (this.shown) this.load(); });
    view.addEventListener("shown", () => { clearTimeout(this.timer); if (this.shown) this.timer = setTimeout(() => this.load(), 300); });
  }

  async load() {
    const { view } = this;
    this.pick.replaceChildren(...view.series.map((series) => new Option(series.name, series.index)));
    this.pick.value = String(this.series);
    const turn = (this.turn = (this.turn ?? 0) + 1);
    try {
      const found = await ask("spectrum", { doc: this.doc, series: this.series, from: view.from, to: view.to });
      if (turn !== this.turn) return; // the view went on meanwhile
      this.found = found;
      this.told.className = "told";
      this.told.textContent = `${found.name}, ${short(found.from, 6)} to ${short(found.to, 6)} s; amplitude of a sine [${found.unit || "as recorded"}]`;
    } catch (error) {
      if (turn !== this.turn) return;
      this.found = null;
      this.told.className = "told bad";
      this.told.textContent = error.message;
    }
    this.draw();
  }

  draw() {
    const { canvas, found } = this, ratio = devicePixelRatio || 1;
    const wide = canvas.clientWidth, tall = canvas.clientHeight;
    canvas.width = wide * ratio;
    canvas.height = tall * ratio;
    this.peaks.replaceChildren();
    if (!found) return;
    const context = canvas.getContext("2d"), colours = this.view.palette();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const use = found.frequency.map((f, k) => [f, found.amplitude[k]]).filter(([f, a]) => f > 0 && a > 0);
    if (!use.length) return;
    const xs = use.map(([f]) => Math.log10(f)), ys = use.map(([, a]) => (this.log ? Math.log10(a) : a));
    const left = 46, bottom = 24;
    const [x0, x1] = [Math.min(...xs), Math.max(...xs)], [y0, y1] = [this.log ? Math.min(...ys) : 0, Math.max(...ys)];
    const x = (value) => left + ((value - x0) / (x1 - x0 || 1)) * (wide - left - 6);
    const y = (value) => 6 + ((y1 - value) / (y1 - y0 || 1)) * (tall - bottom - 6);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = colours.soft;
    context.strokeStyle = colours.line;
    context.textAlign = "center";
    for (let power = Math.ceil(x0); power <= x1; power++) {
      context.strokeRect(x(power), 6, 0, tall - bottom - 6);
      const text = power === 0 ? "1 Hz" : power > 3 || power < -2 ? `1e${power} Hz` : `${10 ** power} Hz`;
      context.fillText(text, Math.min(x(power), wide - 0.5 * context.measureText(text).width - 1), tall - 8);
    }
    context.textAlign = "right";
    for (let k = 0; k <= 4; k++) {
      const value = y0 + (k / 4) * (y1 - y0);
      context.strokeRect(left, y(value), wide - left - 6, 0);
      context.fillText(short(this.log ? 10 ** value : value, 2), left - 4, Math.min(Math.max(y(value) + 4, 12), tall - bottom), left - 6);
    }
    context.strokeStyle = colours.raw;
    context.lineWidth = 1.2;
    context.beginPath();
    use.forEach((_, k) => (k ? context.lineTo(x(xs[k]), y(ys[k])) : context.moveTo(x(xs[k]), y(ys[k]))));
    context.stroke();
    if (!found.peaks.length) return;
    const head = make(make(this.peaks, "thead"), "tr");
    make(head, "th", {}, "line [Hz]");
    make(head, "th", {}, "amplitude");
    const body = make(this.peaks, "tbody");
    for (const peak of found.peaks) {
      const line = make(body, "tr");
      make(line, "td", {}, short(peak.frequency_hz, 5));
      make(line, "td", {}, short(peak.amplitude, 4));
    }
  }
}
