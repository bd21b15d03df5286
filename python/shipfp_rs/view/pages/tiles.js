// Tiles of blocks from the server, kept while there is room: a block is the least and the greatest of 4^level samples.

export const TILE = 1024;
export const FACTOR = 4;
const MOST = 1500; // tiles kept: 12 MB
const AT_ONCE = 200;

export class Tiles {
  constructor(doc, arrived) {
    this.doc = doc;
    this.arrived = arrived;
    this.held = new Map();
    this.asked = new Map(); // each with the answer that will bring it
  }

  clear() {
    this.held.clear();
    this.epoch = (this.epoch ?? 0) + 1;
  }

  get(key) {
    const tile = this.held.get(key);
    if (tile) {
      this.held.delete(key); // the last one used is the last one to go
      this.held.set(key, tile);
    }
    return tile;
  }

  // The tile itself, or the nearest coarser one that covers it.
  best(series, level, index) {
    for (let above = level; above < series.levels; above++) {
      const tile = this.get(`${series.index}.${above}.${index}`);
      if (tile) return { tile, level: above, index };
      index = Math.floor(index / FACTOR);
    }
    return null;
  }

  // Ask for tiles that are neither here nor asked for; resolves when every one has come, or did not.
  want(keys) {
    const missing = keys.filter((key) => !this.held.has(key) && !this.asked.has(key));
    for (let first = 0; first < missing.length; first += AT_ONCE) {
      const part = missing.slice(first, first + AT_ONCE), answer = this.fetch(part);
      part.forEach((key) => this.asked.set(key, answer));
    }
    return Promise.all(new Set(keys.map((key) => this.asked.get(key))));
  }

  async fetch(keys) {
    const epoch = this.epoch;
    try {
      const response = await fetch(`api/tiles?doc=${this.doc}&want=${keys.join(",")}`);
      if (!response.ok) throw new Error(await response.text());
      if (epoch !== this.epoch) return;
      this.unpack(keys, await response.arrayBuffer());
    } catch (error) {
      this.error = error;
    } finally {
      keys.forEach((key) => this.asked.delete(key));
    }
    this.arrived();
  }

  unpack(keys, buffer) {
    const view = new DataView(buffer);
    let at = 0;
    for (const key of keys) {
      const offset = view.getFloat64(at, true), count = view.getUint32(at + 8, true), columns = view.getUint32(at + 12, true);
      // Little-endian, as every machine with a browser is.
      const values = new Float32Array(buffer, at + 16, count * columns);
      at += 16 + 4 * count * columns;
      this.held.set(key, { offset, count, columns, values });
    }
    for (const key of this.held.keys()) {
      if (this.held.size <= MOST) break;
      this.held.delete(key);
    }
  }
}

// The coarsest level whose blocks are no wider than a pixel.
export const levelFor = (series, secondsPerPixel) => {
  const level = Math.floor(Math.log(Math.max(secondsPerPixel * series.rate_hz, 1)) / Math.log(FACTOR) + 1e-9);
  return Math.min(Math.max(level, 0), series.levels - 1);
};

// First and last tile of a stretch, one sample more on either side.
export const tilesOf = (series, level, from, to) => {
  const block = FACTOR ** level, blocks = Math.ceil(series.samples / block);
  if (!blocks) return [0, -1];
  const first = Math.floor(((from - series.start_s) * series.rate_hz - 1) / block / TILE);
  const last = Math.floor(((to - series.start_s) * series.rate_hz + 1) / block / TILE);
  return [Math.max(first, 0), Math.min(last, Math.floor((blocks - 1) / TILE))];
};
