// The picture of a basin: its tiles, which are asked for, and what is drawn of them.
//
// A layer is the picture of one subject, by one method. A new subject makes a new layer, and the old
// one stays below it until the new one covers the view: so a picture never goes blank.

import { frames } from "./api.js";

const KEPT = 2500; // tiles of a layer: 13 MB of labels
const FAST = 0.005; // ms a cell: faster, and the first picture has cells half as wide
const FINEST_PIXELS = 1.6; // device pixels: finer cells would not be seen
const COARSE = 2; // levels by which the first picture is coarser

class Layer {
  constructor(key, body) {
    this.key = key;
    this.body = body;
    this.tiles = new Map(); // by "level,i,j", in the order in which they came
    this.sheets = []; // of cell mapping: whole rectangles, coarse ones first
    this.attractors = [];
    this.at = [];
  }

  get empty() {
    return this.tiles.size === 0 && this.sheets.length === 0;
  }

  tile(level, i, j) {
    return this.tiles.get(`${level},${i},${j}`);
  }

  add([level, i, j], bytes) {
    const half = bytes.length / 2;
    this.tiles.set(`${level},${i},${j}`, { level, i, j, label: bytes.subarray(0, half), strides: bytes.subarray(half) });
    if (this.tiles.size > KEPT) this.tiles.delete(this.tiles.keys().next().value);
  }
}

export class Picture extends EventTarget {
  constructor(palette) {
    super();
    this.palette = palette;
    this.below = null;
    this.layer = null;
    this.progress = 0;
    this.cost = 1; // ms a cell, as measured
    this.stats = { pictures: 0, cells: 0 };
  }

  /** Show a subject in a view of so many device pixels; ask for what is missing. */
  show(state, lattice, view, pixels) {
    if (this.lattice !== lattice) this.layer = this.below = null; // tiles of other places
    this.lattice = lattice;
    this.view = view;
    this.pixels = pixels;
    const body = { ...structuredClone(state.subject()), method: state.method };
    const mapped = state.method === "cell-map";
    const key = JSON.stringify(mapped ? [body, lattice.rectangle(view, lattice.level(view))] : body);
    if (this.layer?.key !== key) {
      if (this.busyWithFirst) { // let the hand see this picture: the newest follows at once
        this.next = () => this.show(state, lattice, view, pixels);
        return;
      }
      if (this.layer && !this.layer.empty) this.below = this.layer;
      this.layer = new Layer(key, body);
      this.stats.pictures += 1;
      this.start = performance.now();
    }
    this.request(mapped);
  }

  /** Whether a layer is the picture of what is chosen. */
  isOf(layer, state) {
    return JSON.stringify(layer.body) === JSON.stringify({ ...state.subject(), method: state.method });
  }

  /** Give up what is asked for; what there is stays. */
  stop() {
    this.next = null;
    this.progress = 0;
    this.abort?.abort();
  }

  /** Give up what there is, too. */
  clear() {
    this.stop();
    this.layer = this.below = null;
    this.changed();
  }

  /** The levels of a view: a coarse one first, then as fine as the screen shows. */
  levels() {
    const { lattice, view } = this;
    const level = lattice.level(view);
    const coarse = level - (this.cost < FAST ? 1 : COARSE);
    const cells = Math.min(...[0, 1].map((k) => this.pixels[k] / (2 * lattice.half(view, k) * 2 ** level)));
    const finer = Math.max(0, Math.floor(Math.log2(cells / FINEST_PIXELS)));
    const all = [coarse, level];
    for (let k = 1; k <= Math.min(finer, 2); k++) all.push(level + k);
    return [...new Set(all.map((one) => lattice.clamp(one)))];
  }

  /** Ask for what is missing, `total` tiles in the beginning, as much as a request may have. */
  async request(mapped, total = 0) {
    const { layer, lattice, view } = this;
    const levels = this.levels();
    let wanted, body;
    if (mapped) {
      if (layer.sheets.length === levels.length) return this.finish();
      wanted = levels.map((level) => lattice.rectangle(view, level));
      body = { ...layer.body, rectangles: wanted };
      layer.sheets = [];
    } else {
      wanted = levels.flatMap((level) => lattice.tiles(view, level)).filter((one) => !layer.tile(...one));
      if (wanted.length === 0) return this.finish();
    }
    const missing = wanted.length;
    total = Math.max(total, missing);
    wanted = wanted.slice(0, lattice.about.most);
    if (!mapped) body = { ...layer.body, tiles: wanted };
    this.abort?.abort();
    this.progress = 1 - missing / total;
    const abort = (this.abort = new AbortController());
    const first = wanted.filter((one) => one[0] === wanted[0][0]).length;
    const empty = layer.empty;
    this.busyWithFirst = empty;
    let done = 0, began = 0;
    try {
      for await (const { words, index, bytes } of frames("/api/picture", body, abort.signal)) {
        if (abort.signal.aborted) return;
        if (words) {
          layer.attractors = words.attractors;
          layer.at = words.at;
          this.dispatchEvent(new Event("attractors"));
          began ||= performance.now();
          continue;
        }
        if (mapped) layer.sheets.push({ rectangle: wanted[index], bytes });
        else layer.add(wanted[index], bytes);
        done += 1;
        this.stats.cells += bytes.length / 2;
        this.progress = 1 - (missing - done) / total;
        if (done >= first) {
          this.busyWithFirst = false;
          this.below = null;
          if (this.next) {
            abort.abort();
            break;
          }
        }
        this.changed();
      }
      if (!this.next) this.cost = 0.5 * this.cost + (0.5 * (performance.now() - began)) / (wanted.length * lattice.tile ** 2);
    } catch (error) {
      if (error.name === "AbortError") return;
      this.progress = 1;
      this.dispatchEvent(new CustomEvent("failed", { detail: error }));
      if (empty && layer.empty && this.below) [this.layer, this.below] = [this.below, null]; // the last good one
    } finally {
      if (this.abort === abort) this.busyWithFirst = false;
      const next = this.next;
      if (next && this.abort === abort) {
        this.next = null;
        queueMicrotask(next);
      }
    }
    if (this.abort !== abort || this.next) return;
    if (missing > wanted.length) this.request(mapped, total);
    else this.finish();
  }

  finish() {
    this.progress = 1;
    this.finished = performance.now();
    this.changed();
    this.dispatchEvent(new Event("finished"));
  }

  changed() {
    this.dispatchEvent(new Event("changed"));
  }

  /** The image of a tile or of a sheet, coloured when it is first drawn. */
  image(one, layer, columns, rows) {
    const pixels = this.palette.table(layer.attractors);
    if (one.image && one.pixels === pixels) return one.image;
    one.pixels = pixels;
    one.image ??= new OffscreenCanvas(columns, rows);
    const context = one.image.getContext("2d");
    const data = context.createImageData(columns, rows);
    const colours = new Uint32Array(data.data.buffer);
    const label = one.label ?? one.bytes.subarray(0, columns * rows);
    const strides = one.strides ?? one.bytes.subarray(columns * rows);
    for (let i = 0; i < columns; i++) {
      for (let j = 0; j < rows; j++) { // the last axis is the fastest, and goes up
        const cell = i * rows + j;
        colours[(rows - 1 - j) * columns + i] = pixels[(label[cell] << 8) | strides[cell]];
      }
    }
    context.putImageData(data, 0, 0);
    return one.image;
  }

  /** Draw what there is, the finest on top. `to` takes places to pixels. */
  draw(context, to, view) {
    context.imageSmoothingEnabled = false;
    for (const layer of [this.below, this.layer]) {
      if (!layer || layer.empty) continue;
      for (const sheet of layer.sheets) {
        const [level, i, j, columns, rows] = sheet.rectangle;
        this.place(context, to, this.image(sheet, layer, columns, rows), i, j, columns, rows, level);
      }
      if (layer.tiles.size) this.drawTiles(context, to, view, layer);
    }
  }

  drawTiles(context, to, view, layer) {
    const { lattice } = this, size = lattice.tile;
    const levels = new Set();
    for (const one of layer.tiles.values()) levels.add(one.level);
    const own = lattice.level(view);
    const shown = [...levels].filter((level) => level <= own + 2 && level >= own - 6).sort((a, b) => a - b);
    const sets = shown.map((level) => lattice.tiles(view, level).map((one) => layer.tile(...one)));
    let first = sets.length - 1; // the finest level that covers the view, and what is above it
    while (first > 0 && sets[first].some((one) => !one)) first--;
    for (const set of sets.slice(Math.max(0, first))) {
      for (const one of set) {
        if (one) this.place(context, to, this.image(one, layer, size, size), one.i * size, one.j * size, size, size, one.level);
      }
    }
  }

  place(context, to, image, i, j, columns, rows, level) {
    const scale = 2 ** -level;
    const [left, low] = to(i * scale, j * scale);
    const [right, high] = to((i + columns) * scale, (j + rows) * scale);
    const x = Math.round(left), y = Math.round(high); // whole pixels: no seams
    context.drawImage(image, x, y, Math.round(right) - x, Math.round(low) - y);
  }

  /** What happens at a place: label and strides of the finest cell there. */
  at(place) {
    for (const layer of [this.layer, this.below]) {
      if (!layer) continue;
      for (const { rectangle, bytes } of [...layer.sheets].reverse()) {
        const [level, i, j, columns, rows] = rectangle;
        const [a, b] = place.map((p, k) => Math.floor(p * 2 ** level) - [i, j][k]);
        if (a >= 0 && b >= 0 && a < columns && b < rows) {
          return { label: bytes[a * rows + b], strides: bytes[columns * rows + a * rows + b], layer, level };
        }
      }
      const own = this.lattice.level(this.view);
      for (let level = own + 2; level >= own - 6 && layer.tiles.size; level--) {
        const size = this.lattice.tile;
        const cell = place.map((p) => Math.floor(p * 2 ** level));
        const [i, j] = cell.map((c) => Math.floor(c / size));
        const one = layer.tile(level, i, j);
        if (!one) continue;
        const k = (cell[0] - i * size) * size + (cell[1] - j * size);
        return { label: one.label[k], strides: one.strides[k], layer, level };
      }
    }
    return null;
  }

  /** All cells of a view on the finest level that covers it: {level, cells}, or null. */
  cells(view) {
    const { layer, lattice } = this;
    if (!layer || layer.empty) return null;
    if (layer.sheets.length) {
      const { rectangle, bytes } = layer.sheets.at(-1);
      const [level, i, j, columns, rows] = rectangle;
      const all = [];
      for (let a = 0; a < columns; a++) for (let b = 0; b < rows; b++) all.push([i + a, j + b, bytes[a * rows + b]]);
      return { level, all };
    }
    const level = lattice.level(view);
    const tiles = lattice.tiles(view, level).map((one) => layer.tile(...one));
    if (tiles.some((one) => !one)) return null;
    const [, i0, j0, columns, rows] = lattice.rectangle(view, level);
    const all = [], size = lattice.tile;
    for (const one of tiles) {
      for (let a = 0; a < size; a++) {
        const i = one.i * size + a;
        if (i < i0 || i >= i0 + columns) continue;
        for (let b = 0; b < size; b++) {
          const j = one.j * size + b;
          if (j >= j0 && j < j0 + rows) all.push([i, j, one.label[a * size + b]]);
        }
      }
    }
    return { level, all };
  }
}
