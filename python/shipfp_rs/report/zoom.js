"use strict";
// Time plots: each figure.chart carries its samples; what the zoom shows is thinned to smallest and largest a pixel.
{
  const template = document.createElement("template");
  template.innerHTML = "<svg></svg>";
  const SVG = template.content.firstChild.namespaceURI; // so that the page holds no address, not even a name
  const LEFT = 58, RIGHT = 8, TOP = 8, BOTTOM = 14, GAP = 10;
  const HIGH = 150, LOW = 80;
  const MASKED = 65535, STEPS = 65534;
  const LEAST_SAMPLES = 8;
  const PAPER = 690; // width of A4 within its margins, in the pixels of a page
  // Signs of kinds of faults about their middle: triangle, square, diamond, disc, cross, triangle upwards, hourglass.
  const SIGNS = [
    "M-5-4H5L0 5z", "M-4-4H4V4H-4z", "M0-6L5 0L0 6L-5 0z", "M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0-9 0z",
    "M-5-3L-3-5L0-2L3-5L5-3L2 0L5 3L3 5L0 2L-3 5L-5 3L-2 0z", "M-5 4H5L0-5z", "M-5-5H5L-5 5H5z",
  ];
  const NEAR = 8; // pixels within which a sign of the same kind is enough
  const kinds = new Map();
  const signOf = (kind) => {
    if (!kinds.has(kind)) kinds.set(kind, SIGNS[kinds.size % SIGNS.length]);
    return kinds.get(kind);
  };

  const make = (parent, tag, attributes = {}, text) => {
    const element = parent.namespaceURI === SVG || tag === "svg" ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    if (text !== undefined) element.textContent = text;
    parent.append(element);
    return element;
  };

  const unpack = (series) => {
    const bytes = Uint8Array.from(atob(series.data), (character) => character.charCodeAt(0));
    series.steps = new Uint16Array(bytes.buffer); // little-endian, as every machine with a browser is
    series.per = series.pairs ? 2 : 1;
    delete series.data;
  };

  // Smallest and largest step of the stretches first..last (stop excluded), as [low, high]; null where all are masked.
  const extremes = (series, first, last) => {
    const { steps, per } = series;
    let low = MASKED, high = -1;
    for (let i = first * per; i < last * per; i++) {
      const step = steps[i];
      if (step === MASKED) continue;
      if (step < low) low = step;
      if (step > high) high = step;
    }
    return high < 0 ? null : [low, high];
  };

  const nice = (least) => {
    const power = 10 ** Math.floor(Math.log10(least));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= least * 0.999999);
  };
  const niceTime = (least) => [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 36000].find((step) => step >= least) ?? nice(least);
  // Numbers that are read, not saved, have the language's decimal sign.
  const sign = (1.5).toLocaleString(document.documentElement.lang)[1];
  const said = (number) => String(number).replace(".", sign);
  const digits = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const clock = (seconds, step) => {
    const whole = Math.floor(seconds + 1e-9), pad = (value) => String(value).padStart(2, "0");
    const rest = step < 1 ? said((seconds - whole).toFixed(digits(step))).slice(1) : "";
    return `${Math.floor(whole / 3600)}:${pad(Math.floor(whole / 60) % 60)}:${pad(whole % 60)}${rest}`;
  };

  class Chart {
    constructor(figure) {
      const data = JSON.parse(figure.querySelector("script").textContent);
      this.figure = figure;
      this.say = (text) => data.words[text] ?? text;
      this.start = data.start; // of the record, on the log's clock
      this.seconds = data.seconds;
      this.step = data.step;
      this.panels = data.panels;
      this.panels.forEach((panel) => panel.series.forEach(unpack));
      this.from = 0;
      this.to = this.seconds;
      this.hidden = new Set();
      this.faults = this.panels.flatMap((panel) => panel.marks.flatMap((mark) => mark.spans.map((span) => [...span, mark.label])));
      this.faults.sort((a, b) => a[0] - b[0]);
      this.long = this.seconds > 600;
      this.build();
      new ResizeObserver(() => this.resize()).observe(this.plot);
      this.resize();
      // Drawn anew for paper: shrunk from a wide screen, its text could not be read.
      addEventListener("beforeprint", () => this.resize(PAPER));
      addEventListener("afterprint", () => this.resize());
    }

    build() {
      const caption = this.figure.querySelector("figcaption");
      const about = this.figure.dataset.about;
      const bar = document.createElement("div");
      bar.className = "toolbar";
      bar.setAttribute("role", "toolbar");
      bar.setAttribute("aria-label", `${this.say("zoom of")} ${about}`);
      const button = (text, label, act) => {
        const made = make(bar, "button", { type: "button", "aria-label": label, title: label }, text);
        made.addEventListener("click", act);
        return made;
      };
      button("+", this.say("zoom in"), () => this.zoom(0.5));
      button("−", this.say("zoom out"), () => this.zoom(2));
      button("◀", this.say("earlier"), () => this.shift(-0.5));
      button("▶", this.say("later"), () => this.shift(0.5));
      button(this.say("all"), this.say("show all"), () => this.show(0, this.seconds));
      if (this.faults.length) {
        button(`‹ ${this.say("fault")}`, this.say("previous fault"), () => this.fault(-1));
        button(`${this.say("fault")} ›`, this.say("next fault"), () => this.fault(1));
      }
      button("CSV", this.say("save as CSV"), () => this.save(about));
      button("PNG", this.say("save as PNG"), () => this.picture(about));
      this.status = make(bar, "span", { role: "status", class: "status" });
      this.plot = document.createElement("div");
      this.plot.className = "plot";
      this.plot.tabIndex = 0;
      this.plot.setAttribute("role", "group");
      this.plot.setAttribute("aria-roledescription", this.say("zoomable plot"));
      this.plot.setAttribute("aria-label", `${about}. ${this.figure.querySelector(".help").textContent}`);
      const legend = document.createElement("div");
      legend.className = "legend";
      for (const panel of this.panels) for (const series of panel.series) this.entry(legend, series);
      for (const panel of this.panels) {
        for (const mark of panel.marks) {
          const entry = make(legend, "span", { class: mark.cut ? "cut" : "mended" });
          make(make(entry, "svg", { class: "sign", viewBox: "-6 -6 12 12", "aria-hidden": "true" }), "path", { d: signOf(mark.kind) });
          entry.append(`${mark.label} (${mark.count})`);
        }
      }
      this.readout = document.createElement("p");
      this.readout.className = "readout";
      caption.before(bar, legend, this.plot, this.readout);
      this.listen();
    }

    entry(legend, series) {
      const { label, colour, kind } = series;
      const made = make(legend, "button", { type: "button", "aria-pressed": "true", title: `${this.say("show or hide")} ${label}` });
      make(made, "i", { class: kind }).style.color = colour;
      made.append(label);
      made.addEventListener("click", () => {
        if (!this.hidden.delete(series)) this.hidden.add(series);
        made.setAttribute("aria-pressed", String(!this.hidden.has(series)));
        this.draw();
      });
    }

    listen() {
      const keys = {
        ArrowLeft: () => this.shift(-0.25), ArrowRight: () => this.shift(0.25),
        "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), "−": () => this.zoom(2),
        0: () => this.show(0, this.seconds), Escape: () => this.show(0, this.seconds),
        Home: () => this.show(0, this.to - this.from), End: () => this.show(this.seconds - (this.to - this.from), this.seconds),
        n: () => this.fault(1), p: () => this.fault(-1),
      };
      this.plot.addEventListener("keydown", (event) => {
        const act = keys[event.key];
        if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
        event.preventDefault();
        act();
      });
      const at = (event) => {
        const box = this.plot.getBoundingClientRect();
        return Math.min(Math.max(event.clientX - box.left - LEFT, 0), this.wide);
      };
      let begun = null;
      this.plot.addEventListener("pointerdown", (event) => {
        if (event.button !== 0) return;
        begun = at(event);
        this.plot.setPointerCapture(event.pointerId);
      });
      this.plot.addEventListener("pointermove", (event) => {
        const now = at(event);
        this.point(now);
        if (begun !== null) this.select(Math.min(begun, now), Math.abs(now - begun));
      });
      this.plot.addEventListener("pointerup", (event) => {
        const now = at(event), from = Math.min(begun ?? now, now), width = Math.abs((begun ?? now) - now);
        begun = null;
        this.select(0, 0);
        if (width > 5) this.show(this.time(from), this.time(from + width));
      });
      this.plot.addEventListener("pointercancel", () => { begun = null; this.select(0, 0); });
      this.plot.addEventListener("pointerleave", () => this.point(null));
      this.plot.addEventListener("dblclick", () => this.show(0, this.seconds));
      this.plot.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return; // a plain wheel scrolls the page
        event.preventDefault();
        this.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.time(at(event)));
      }, { passive: false });
    }

    time(x) { return this.from + (x / this.wide) * (this.to - this.from); }

    zoom(factor, about = 0.5 * (this.from + this.to)) {
      this.show(about - (about - this.from) * factor, about + (this.to - about) * factor);
    }

    shift(part) {
      const by = part * (this.to - this.from);
      const kept = Math.min(Math.max(by, -this.from), this.seconds - this.to);
      this.show(this.from + kept, this.to + kept);
    }

    show(from, to) {
      const least = Math.min(LEAST_SAMPLES * this.step, this.seconds);
      const middle = 0.5 * (from + to), width = Math.max(to - from, least);
      this.from = Math.min(Math.max(middle - 0.5 * width, 0), this.seconds - least);
      this.to = Math.max(Math.min(middle + 0.5 * width, this.seconds), this.from + least);
      this.draw();
      this.status.textContent = this.to - this.from < this.seconds ? `${this.told(this.from)} ${this.say("to")} ${this.told(this.to)} ${this.say("of")} ${this.told(this.seconds, 0)}` : "";
    }

    told(seconds, start = this.start) { return this.long ? clock(start + seconds, 0.1) : `${said((start + seconds).toFixed(2))} s`; }

    fault(direction) {
      const whole = this.to - this.from >= this.seconds;
      const middle = whole ? (direction > 0 ? -1 : this.seconds + 1) : 0.5 * (this.from + this.to);
      const centre = ([first, last]) => 0.5 * (first + last);
      const ahead = this.faults.filter((span) => direction * (centre(span) - middle) > 1e-3 * this.step);
      const next = direction > 0 ? ahead[0] : ahead.at(-1);
      if (!next) return;
      const half = Math.max(2 * (next[1] - next[0]), 50 * this.step, 0.5);
      this.from = centre(next) - half;
      this.to = centre(next) + half;
      // Kept in the middle, even at an end, so that the next fault is found from here.
      this.draw();
      this.status.textContent = `${next[2]}, ${this.say("at")} ${this.told(next[0])}`;
    }

    resize(width = this.plot.clientWidth) {
      const wide = Math.max(Math.round(width) - LEFT - RIGHT, 80);
      if (wide === this.wide) return;
      this.wide = wide;
      this.draw();
    }

    draw() {
      if (!this.wide) return;
      const height = this.panels.reduce((sum, panel) => sum + this.height(panel) + GAP, TOP + BOTTOM);
      const svg = document.createElementNS(SVG, "svg");
      svg.setAttribute("viewBox", `0 0 ${this.wide + LEFT + RIGHT} ${height}`);
      svg.setAttribute("aria-hidden", "true");
      let top = TOP;
      this.panels.forEach((panel, index) => {
        this.drawPanel(svg, panel, top, this.height(panel), index === this.panels.length - 1);
        top += this.height(panel) + GAP;
      });
      this.selection = make(svg, "rect", { class: "selection", y: TOP, height: top - TOP - GAP, width: 0 });
      this.cursor = make(svg, "line", { class: "cursor", y1: TOP, y2: top - GAP, visibility: "hidden" });
      make(svg, "text", { x: LEFT + this.wide, y: top - GAP + 15, "text-anchor": "end" }, this.say(this.long ? "time [h:min:s]" : "time [s]"));
      this.plot.replaceChildren(svg);
    }

    height(panel) { return panel.series.length > 1 || panel.marks.length ? HIGH : LOW; }

    // First and last stretch that are at least partly in view.
    range(series) {
      const count = series.steps.length / series.per;
      return [Math.max(Math.floor(this.from / this.step) - 1, 0), Math.min(Math.ceil(this.to / this.step) + 2, count)];
    }

    drawPanel(svg, panel, top, height, last) {
      const shown = panel.series.filter((series) => !this.hidden.has(series));
      let low = Infinity, high = -Infinity;
      for (const series of shown) {
        const found = extremes(series, ...this.range(series));
        if (!found) continue;
        const scale = (series.high - series.low) / STEPS;
        low = Math.min(low, series.low + found[0] * scale);
        high = Math.max(high, series.low + found[1] * scale);
      }
      if (!(low <= high)) [low, high] = [0, 1];
      const pad = 0.06 * (high - low) || Math.abs(high) * 1e-3 || 1;
      low -= pad;
      high += pad;
      const y = (value) => top + height * (high - value) / (high - low);
      const x = (time) => LEFT + this.wide * (time - this.from) / (this.to - this.from);
      const rise = nice((high - low) / 5);
      for (let tick = Math.ceil(low / rise); tick * rise <= high; tick++) {
        const at = y(tick * rise).toFixed(1);
        make(svg, "line", { class: "grid", x1: LEFT, x2: LEFT + this.wide, y1: at, y2: at });
        make(svg, "text", { x: LEFT - 5, y: Number(at) + 4, "text-anchor": "end" }, said((tick * rise).toFixed(digits(rise))));
      }
      const least = (this.to - this.from) * 75 / this.wide;
      const run = this.long && least > 1 ? niceTime(least) : nice(least);
      for (let tick = Math.ceil((this.start + this.from) / run - 1e-9); tick * run <= this.start + this.to; tick++) {
        const place = x(tick * run - this.start), at = place.toFixed(1);
        make(svg, "line", { class: "grid", x1: at, x2: at, y1: top, y2: top + height });
        if (last && place < LEFT + this.wide - (this.long ? 110 : 70)) {
          make(svg, "text", { x: at, y: top + height + 15, "text-anchor": "middle" }, this.long ? clock(tick * run, run) : said((tick * run).toFixed(digits(run))));
        }
      }
      const signs = [];
      const group = make(svg, "svg", { x: LEFT, y: top, width: this.wide, height, viewBox: `${LEFT} ${top} ${this.wide} ${height}` });
      panel.marks.forEach((mark, row) => {
        const seen = mark.spans.filter(([first, stop]) => stop >= this.from && first <= this.to);
        const path = seen.map(([first, stop]) => {
          const begin = Math.max(x(first), LEFT - 2), width = Math.max(Math.min(x(stop), LEFT + this.wide + 2) - begin, 1);
          return `M${begin.toFixed(1)} ${top}h${width.toFixed(1)}v${height}h${(-width).toFixed(1)}z`;
        });
        if (path.length) make(make(group, "path", { class: mark.cut ? "cut" : "mended", d: path.join("") }), "title", {}, mark.label);
        let before = -Infinity;
        for (const [first, stop] of seen) {
          const at = x(0.5 * (Math.max(first, this.from) + Math.min(stop, this.to)));
          if (at < before + NEAR) continue;
          before = at;
          signs.push([mark, `translate(${at.toFixed(1)} ${top + height - 8 - 12 * row})`]);
        }
      });
      for (const series of shown) make(group, "path", { class: `series ${series.kind}`, stroke: series.colour, d: this.path(series, x, y) });
      for (const [mark, transform] of signs) {
        make(group, "path", { class: mark.cut ? "sign" : "sign kept", d: signOf(mark.kind), transform });
      }
      make(svg, "rect", { class: "frame", x: LEFT, y: top, width: this.wide, height });
      make(svg, "text", { class: "quantity", x: LEFT + 5, y: top + 13 }, panel.label);
    }

    path(series, x, y) {
      const [first, last] = this.range(series);
      const { steps, per } = series;
      const scale = (series.high - series.low) / STEPS;
      const point = (at, step) => `${at.toFixed(1)} ${y(series.low + step * scale).toFixed(1)}`;
      const group = Math.max(1, Math.floor((last - first) / this.wide));
      const path = [];
      let pen = "M", before = 0;
      // Stretches start at multiples of the group, so that a shift of the view does not make peaks flicker.
      for (let begin = first - (first % group); begin < last; begin += group) {
        const end = Math.min(begin + group, steps.length / per);
        const found = extremes(series, begin, end);
        if (!found) { pen = "M"; continue; }
        const at = x((0.5 * (begin + end) - (group * per === 1 ? 0.5 : 0)) * this.step);
        const [low, high] = found;
        const ends = Math.abs(before - low) <= Math.abs(before - high) ? [low, high] : [high, low];
        path.push(pen + point(at, ends[0]));
        if (low !== high) path.push("L" + point(at, ends[1]));
        else if (pen === "M") path.push("h.1"); // a sample between two gaps still shows
        pen = "L";
        before = ends[1];
      }
      return path.join("");
    }

    // What the zoom shows, a row a sample, or a smallest and a largest of each stretch.
    save(about) {
      const all = this.panels.flatMap((panel) => panel.series);
      const quoted = (text) => `"${text.replaceAll('"', '""')}"`;
      const head = all.flatMap(({ label, pairs }) => pairs ? [`${label} min`, `${label} max`] : [label]);
      const lines = [["time [s]", ...head].map(quoted).join(",")];
      const [first, last] = [Math.floor(this.from / this.step), Math.ceil(this.to / this.step)];
      for (let row = first; row < last; row++) {
        const cells = all.flatMap((series) => Array.from({ length: series.per }, (_, place) => {
          const step = series.steps[row * series.per + place];
          return step === undefined || step === MASKED ? "" : (series.low + step * (series.high - series.low) / STEPS).toPrecision(7);
        }));
        lines.push([(this.start + row * this.step).toPrecision(9), ...cells].join(","));
      }
      offer(`${about.split(":")[0]}.csv`, new Blob([lines.join("\n") + "\n"], { type: "text/csv" }));
    }

    // What the zoom shows as a picture, twice as fine, in the page's present light.
    picture(about) {
      const shown = this.plot.firstChild, copy = shown.cloneNode(true);
      const originals = shown.querySelectorAll("*");
      copy.querySelectorAll("*").forEach((element, place) => {
        const style = getComputedStyle(originals[place]);
        for (const name of ["fill", "stroke", "stroke-width", "stroke-dasharray", "opacity", "font", "paint-order", "visibility"]) element.style.setProperty(name, style.getPropertyValue(name));
      });
      const [, , width, height] = shown.getAttribute("viewBox").split(" ").map(Number);
      savePicture(`${about.split(":")[0]}.png`, copy, [2 * width, 2 * height], getComputedStyle(document.body).backgroundColor);
    }

    select(x, width) {
      this.selection.setAttribute("x", LEFT + x);
      this.selection.setAttribute("width", width);
    }

    // A line at the pointer and what the signals are there.
    point(x) {
      this.cursor.setAttribute("visibility", x === null ? "hidden" : "visible");
      if (x === null) { this.readout.textContent = ""; return; }
      this.cursor.setAttribute("x1", LEFT + x);
      this.cursor.setAttribute("x2", LEFT + x);
      const index = (series) => Math.min(Math.floor(this.time(x) / this.step + (series.pairs ? 0 : 0.5)), series.steps.length / series.per - 1);
      const told = this.panels.flatMap((panel) => panel.series).filter((series) => !this.hidden.has(series)).map((series) => {
        const found = extremes(series, index(series), index(series) + 1);
        const value = (step) => said(Number((series.low + step * (series.high - series.low) / STEPS).toPrecision(5)));
        const text = !found ? this.say("masked") : found[0] === found[1] ? value(found[0]) : `${value(found[0])} ${this.say("to")} ${value(found[1])}`;
        return `${series.label} ${text}`;
      });
      this.readout.textContent = `${this.told(this.time(x))}: ${told.join("; ")}`;
    }
  }

  for (const figure of document.querySelectorAll("figure.chart")) new Chart(figure);
}
