// One row: its series in columns of a pixel, least to greatest sample, or sample by sample where there is room.

import { TILE, FACTOR, levelFor, tilesOf } from "./tiles.js";
import { nice, digits } from "./tools.js";

export const LEFT = 62, RIGHT = 10;
const TOP = 6, BOTTOM = 6;
const DOTS = 6; // pixels between samples from which on each has a dot

// Least and greatest of every pixel of a series, in its own unit; `missing` gathers tiles that are not here yet.
export const columns = (tiles, series, from, to, wide, missing) => {
  const level = levelFor(series, (to - from) / wide);
  const [first, last] = tilesOf(series, level, from, to);
  const low = new Float64Array(wide).fill(NaN), high = new Float64Array(wide).fill(NaN);
  const perPixel = (to - from) / wide;
  let exact = level === 0;
  const points = [];
  for (let index = first; index <= last; index++) {
    const key = `${series.index}.${level}.${index}`;
    const found = tiles.best(series, level, index);
    if (!found || found.level !== level) missing.push(key);
    if (!found) { exact = false; continue; }
    if (found.level !== level) exact = false;
    const { tile } = found;
    const block = FACTOR ** found.level / series.rate_hz, finest = FACTOR ** level / series.rate_hz;
    // Of a coarser tile only what the missing one would show.
    const begin = series.start_s + index * TILE * finest, end = begin + TILE * finest;
    const base = series.start_s + found.index * TILE * block;
    const one = Math.max(Math.floor((Math.max(begin, from) - base) / block) - 1, 0);
    const stop = Math.min(Math.ceil((Math.min(end, to) - base) / block) + 1, tile.count);
    for (let k = one; k < stop; k++) {
      const lowest = tile.values[k * tile.columns] + tile.offset, highest = tile.values[k * tile.columns + tile.columns - 1] + tile.offset;
      const at = base + k * block;
      if (found.level === 0) points.push(at, lowest);
      if (lowest !== lowest) continue;
      let left = Math.floor((at - from) / perPixel), right = found.level === 0 ? left : Math.ceil((at + block - from) / perPixel) - 1;
      if (right < 0 || left >= wide) continue;
      left = Math.max(left, 0);
      right = Math.min(Math.max(right, left), wide - 1);
      for (let x = left; x <= right; x++) {
        if (!(low[x] <= lowest)) low[x] = lowest;
        if (!(high[x] >= highest)) high[x] = highest;
      }
    }
  }
  return { low, high, points: exact ? points : null, level, sparse: exact && perPixel * series.rate_hz < 1 };
};

const line = (calibration) => (calibration ? (value) => calibration.scale * value + calibration.offset : (value) => value);

export class Row {
  constructor(key, parent) {
    this.key = key;
    this.series = [];
    this.columns = [];
    this.calibration = null;
    this.element = document.createElement("div");
    this.element.className = "row";
    this.label = document.createElement("div");
    this.label.className = "label";
    for (const part of ["name", "unit", "role", "value"]) {
      this[part] = document.createElement("span");
      this[part].className = part;
      this.label.append(this[part]);
    }
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.element.append(this.label, this.canvas);
    parent.append(this.element);
  }

  // Draw; returns nothing but fills `missing` with the tiles that would make it sharper.
  draw(view, missing) {
    const { from, to, colours } = view;
    const ratio = devicePixelRatio || 1;
    const wide = this.canvas.clientWidth, tall = this.canvas.clientHeight;
    const inner = Math.max(wide - LEFT - RIGHT, 10);
    if (this.canvas.width !== Math.round(wide * ratio) || this.canvas.height !== Math.round(tall * ratio)) {
      this.canvas.width = Math.round(wide * ratio);
      this.canvas.height = Math.round(tall * ratio);
    }
    const count = Math.round(inner * ratio);
    this.columns = this.series.map((series) => columns(view.tiles, series, from, to, count, missing));
    const value = line(this.calibration);
    let least = Infinity, most = -Infinity;
    for (const { low, high } of this.columns) {
      for (let x = 0; x < count; x++) {
        if (low[x] < least) least = low[x];
        if (high[x] > most) most = high[x];
      }
    }
    [least, most] = least <= most ? [value(least), value(most)].sort((a, b) => a - b) : [0, 1];
    const rates = this.rates();
    if (this.train) this.unit.textContent = !rates ? this.recorded : this.turns ? "rpm" : "pulses/s";
    if (rates) [least, most] = [Math.min(...rates), Math.max(...rates)];
    if (most - least < 1e-12 * Math.max(Math.abs(most), 1e-300)) [least, most] = [least - 0.5 * (Math.abs(least) || 1), most + 0.5 * (Math.abs(most) || 1)];
    const space = 0.04 * (most - least);
    this.range = [least - space, most + space];
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, wide, tall);
    const y = (number) => TOP + ((this.range[1] - number) / (this.range[1] - this.range[0])) * (tall - TOP - BOTTOM);
    this.grid(context, view, y, wide, tall);
    this.bands(context, view, inner, tall);
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, inner, tall);
    context.clip();
    if (rates) this.samples(context, this.rate.time.flatMap((time, k) => [time, rates[k]]), view, inner, y, colours.raw);
    else this.columns.forEach((drawn, index) => {
      const colour = this.series[index].layer === "raw" ? colours.raw : colours.done;
      if (drawn.sparse) this.samples(context, drawn.points, view, inner, (number) => y(value(number)), colour);
      else this.spans(context, drawn, ratio, (number) => y(value(number)), colour);
    });
    context.restore();
    const what = this.series.map((series) => series.name).join(", ");
    this.canvas.setAttribute("aria-label", `${what}: ${least.toPrecision(4)} to ${most.toPrecision(4)} ${this.unit.textContent}`);
  }

  // Speed of a train instead of a solid block: rpm where its pulses a turn are known.
  rates() {
    return this.rate?.rate.map((rate) => (this.turns ? (60 * rate) / this.turns : rate));
  }

  grid(context, view, y, wide, tall) {
    const { colours } = view, [least, most] = this.range;
    const step = nice((most - least) / Math.max(Math.floor(tall / 26), 1));
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    context.lineWidth = 1;
    for (let mark = Math.ceil(least / step) * step; mark <= most; mark += step) {
      const at = Math.round(y(mark)) + 0.5;
      context.strokeStyle = colours.line;
      context.beginPath();
      context.moveTo(LEFT, at);
      context.lineTo(wide - RIGHT, at);
      context.stroke();
      const large = Math.abs(mark) >= 1e6 || step < 1e-6;
      context.fillStyle = colours.soft;
      if (at > 7 && at < tall - 5) context.fillText(large ? mark.toExponential(2) : (Math.abs(mark) < 1e-9 * step ? 0 : mark).toFixed(digits(step)), LEFT - 6, at, LEFT - 8);
    }
  }

  // Windows, gaps and faults, each at least two pixels wide.
  bands(context, view, inner, tall) {
    const scale = inner / (view.to - view.from);
    const band = (start, stop, colour, alpha, top, high) => {
      const left = Math.max((start - view.from) * scale, 0), right = Math.min((stop - view.from) * scale, inner);
      if (right < 0 || left > inner) return;
      context.globalAlpha = alpha;
      context.fillStyle = colour;
      context.fillRect(LEFT + Math.min(left, inner - 2), top, Math.max(right - left, 2), high);
      context.globalAlpha = 1;
    };
    for (const { start_s, stop_s, colour } of view.marks) band(start_s, stop_s, colour, 0.13, 0, tall);
    for (const series of this.series) {
      if (series.layer !== "raw") continue;
      for (const [start, stop] of series.gaps) if (stop >= view.from && start <= view.to) band(start, stop, view.colours.soft, 0.35, 0, tall);
    }
    if (!view.layers.faults) return;
    let drawnTo = -Infinity; // many within one pixel are drawn once
    for (const [start, stop] of this.faultSpans ?? []) {
      if (stop < view.from || start > view.to) continue;
      const right = Math.max(stop, start + 2 / scale);
      if (right <= drawnTo) continue;
      band(start, stop, view.colours.fault, 0.28, 0, tall);
      band(start, stop, view.colours.fault, 1, tall - 4, 4);
      drawnTo = right;
    }
  }

  // A bar a pixel, from least to greatest, joined to its neighbour's.
  spans(context, { low, high }, ratio, y, colour) {
    context.fillStyle = colour;
    context.beginPath();
    let before = null;
    const thick = 1 / ratio;
    for (let x = 0; x < low.length; x++) {
      if (low[x] !== low[x]) { before = null; continue; }
      let top = y(high[x]), bottom = y(low[x]);
      if (top > bottom) [top, bottom] = [bottom, top];
      const own = [top, bottom];
      if (before) {
        if (top > before[1]) top = before[1];
        if (bottom < before[0]) bottom = before[0];
      }
      before = own;
      context.rect(LEFT + x / ratio, top - 0.5, thick, Math.max(bottom - top, 0) + 1);
    }
    context.fill();
  }

  samples(context, points, view, inner, y, colour) {
    const scale = inner / (view.to - view.from);
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 1.4;
    context.beginPath();
    let down = false;
    for (let k = 0; k < points.length; k += 2) {
      if (points[k + 1] !== points[k + 1]) { down = false; continue; }
      const x = LEFT + (points[k] - view.from) * scale, at = y(points[k + 1]);
      if (down) context.lineTo(x, at);
      else context.moveTo(x, at);
      down = true;
    }
    context.stroke();
    if (points.length > 3 && (points[2] - points[0]) * scale < DOTS) return;
    for (let k = 0; k < points.length; k += 2) {
      context.beginPath();
      context.arc(LEFT + (points[k] - view.from) * scale, y(points[k + 1]), 2.6, 0, 2 * Math.PI);
      context.fill();
    }
  }

  // Least and greatest at a time, as they are drawn; of samples the nearest one.
  at(view, seconds) {
    const value = line(this.calibration), rates = this.rates();
    if (rates) {
      const later = this.rate.time.findIndex((time) => time >= seconds);
      const rate = rates.at(later);
      return [rate, rate];
    }
    for (const drawn of this.columns) {
      let found = null;
      if (drawn.points?.length && drawn.sparse) {
        let nearest = Infinity;
        for (let k = 0; k < drawn.points.length; k += 2) {
          const away = Math.abs(drawn.points[k] - seconds);
          if (away < nearest) [nearest, found] = [away, [drawn.points[k + 1], drawn.points[k + 1]]];
        }
      } else {
        const x = Math.floor(((seconds - view.from) / (view.to - view.from)) * drawn.low.length);
        if (x >= 0 && x < drawn.low.length) found = [drawn.low[x], drawn.high[x]];
      }
      if (found && found[0] === found[0]) return found.map(value).sort((a, b) => a - b);
    }
    return null;
  }
}
