// The map: the picture with axes and marks, and what the hand does on it.

import { clampView } from "./lattice.js";
import { decimals, ticks } from "./words.js";

const MARGIN = { left: 78, right: 12, top: 12, bottom: 44 };
const FONT = "12px system-ui, sans-serif";
const MARK = 7; // CSS pixels around the mark of a gait
const CLICK = 5; // CSS pixels that a click may move
const WHEEL = 0.0022; // of zoom for each pixel of a wheel
const PATH = "#f2b632"; // as in the figures

export class BasinMap extends EventTarget {
  constructor(canvas, picture, palette) {
    super();
    this.canvas = canvas;
    this.picture = picture;
    this.palette = palette;
    this.context = canvas.getContext("2d", { alpha: false });
    this.axes = ["", ""]; // their labels
    this.gaits = [];
    this.path = [];
    this.joined = Infinity; // its last points that lines join
    this.pointers = new Map();
    this.cross = null;
    picture.addEventListener("changed", () => this.redraw());
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  setLattice(lattice, view) {
    this.lattice = lattice;
    this.view = view ?? lattice.whole();
    this.redraw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(width * this.ratio);
    this.canvas.height = Math.round(height * this.ratio);
    this.box = {
      left: MARGIN.left, top: MARGIN.top,
      width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom,
    };
    this.redraw();
    this.moved();
  }

  /** Device pixels of the picture. */
  get pixels() {
    return this.box ? [this.box.width * this.ratio, this.box.height * this.ratio] : [1, 1];
  }

  /** From a place to CSS pixels, and back. */
  toScreen(x, y) {
    const { box, view, lattice } = this;
    return [
      box.left + ((x - view.centre[0]) / (2 * lattice.half(view, 0)) + 0.5) * box.width,
      box.top + (0.5 - (y - view.centre[1]) / (2 * lattice.half(view, 1))) * box.height,
    ];
  }

  toPlace(x, y) {
    const { box, view, lattice } = this;
    return [
      view.centre[0] + ((x - box.left) / box.width - 0.5) * 2 * lattice.half(view, 0),
      view.centre[1] + (0.5 - (y - box.top) / box.height) * 2 * lattice.half(view, 1),
    ];
  }

  values(place) {
    return place.map((p, k) => this.lattice.value(k, p));
  }

  places(values) {
    return values.map((v, k) => this.lattice.place(k, v));
  }

  /** The gait whose mark is at a place. */
  gaitAt(place) {
    const at = this.toScreen(...place);
    const near = (state) => {
      const [x, y] = this.toScreen(...this.places(state));
      return Math.hypot(x - at[0], y - at[1]) < MARK;
    };
    return this.gaits.find((gait) => gait.shown.some(near));
  }

  /** Nothing is there: another system is being compiled. */
  clear() {
    Object.assign(this, { lattice: null, view: null, gaits: [], path: [], arrow: null, cross: null });
    this.redraw();
  }

  redraw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.draw();
    });
  }

  draw() {
    const { context: c, box, ratio } = this;
    if (!box) return;
    this.drawn = (this.drawn ?? 0) + 1;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = this.colour("--page");
    c.fillRect(0, 0, this.canvas.width, this.canvas.height);
    c.save();
    c.beginPath();
    c.rect(box.left * ratio, box.top * ratio, box.width * ratio, box.height * ratio);
    c.clip();
    this.drawCells(c, [0, 0]);
    c.restore();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (this.lattice) this.drawOver(c);
  }

  /** Draw all on another context, of CSS pixels: the cells as an image. */
  drawOn(c) {
    const { box } = this, cells = document.createElement("canvas");
    [cells.width, cells.height] = this.pixels.map(Math.round);
    this.drawCells(cells.getContext("2d"), [box.left, box.top]);
    c.drawImage(cells, box.left, box.top, box.width, box.height);
    this.drawOver(c);
  }

  colour(name) {
    return getComputedStyle(this.canvas).getPropertyValue(name).trim();
  }

  /** Draw the cells in device pixels, from a corner on. */
  drawCells(c, corner) {
    c.fillStyle = this.colour("--empty");
    c.fillRect(0, 0, this.canvas.width, this.canvas.height);
    const to = (x, y) => this.toScreen(x, y).map((p, k) => (p - corner[k]) * this.ratio);
    if (this.lattice) this.picture.draw(c, to, this.view);
  }

  /** Draw marks and axes. */
  drawOver(c) {
    const { box } = this, [ink, soft, ground] = ["--ink", "--soft", "--page"].map((name) => this.colour(name));
    c.save();
    c.beginPath();
    c.rect(box.left, box.top, box.width, box.height);
    c.clip();
    this.drawMarks(c, ink, ground);
    c.restore();
    this.drawAxes(c, ink, soft);
  }

  drawAxes(c, ink, soft) {
    const { box } = this;
    c.strokeStyle = soft;
    c.lineWidth = 1;
    c.strokeRect(box.left + 0.5, box.top + 0.5, box.width - 1, box.height - 1);
    c.fillStyle = ink;
    c.font = FONT;
    const [x, y] = [0, 1].map((k) => {
      const [low, high] = this.lattice.ends(this.view, k).map((end) => this.lattice.value(k, end));
      return this.labels(low, high, k === 0 ? box.width / 90 : box.height / 60);
    });
    c.textAlign = "center";
    c.textBaseline = "top";
    for (const [value, text] of x.marks) {
      const at = this.toScreen(this.lattice.place(0, value), 0)[0];
      c.fillRect(Math.round(at), box.top + box.height, 1, 4);
      c.fillText(text, at, box.top + box.height + 7);
    }
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const [value, text] of y.marks) {
      const at = this.toScreen(0, this.lattice.place(1, value))[1];
      c.fillRect(box.left - 4, Math.round(at), 4, 1);
      c.fillText(text, box.left - 7, at);
    }
    c.fillStyle = soft;
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    c.fillText(this.axes[0] + x.note, box.left + box.width / 2, box.top + box.height + 39);
    c.save();
    c.translate(13, box.top + box.height / 2);
    c.rotate(-Math.PI / 2);
    c.fillText(this.axes[1] + y.note, 0, 0);
    c.restore();
  }

  /** Ticks of an axis; far in, as differences from a base that the label names. */
  labels(low, high, most) {
    const { values, places } = ticks(low, high, Math.max(2, most));
    const span = high - low;
    if (places <= 4) return { marks: values.map((v) => [v, decimals(v, places)]), note: "" };
    const base = Number(((low + high) / 2).toFixed(Math.max(0, places - 2)));
    const unit = 10 ** Math.floor(Math.log10(span));
    const fine = ticks((low - base) / unit, (high - base) / unit, Math.max(2, most));
    const exponent = String(Math.round(Math.log10(unit))).replace("-", "");
    const raised = [...exponent].map((d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]).join("");
    const shownBase = decimals(base, Math.max(0, places - 2));
    return {
      marks: fine.values.map((v) => [base + v * unit, decimals(v, fine.places)]),
      note: ` = ${shownBase} + … × 10⁻${raised}`,
    };
  }

  drawMarks(c, ink, ground) {
    const dot = (values, radius, fill, stroke, width = 1.5) => {
      const [x, y] = this.toScreen(...this.places(values));
      c.beginPath();
      c.arc(x, y, radius, 0, 2 * Math.PI);
      c.fillStyle = fill;
      c.strokeStyle = stroke;
      c.lineWidth = width;
      c.fill();
      c.stroke();
    };
    const { layer } = this.picture;
    if (this.arrow) this.drawArrow(c, this.arrow, ink, ground);
    for (const gait of this.gaits) {
      for (const state of gait.shown) {
        if (gait.stable) dot(state, 5, "#1a1a1a", "#fff");
        else dot(state, 4, "rgba(255,255,255,0.85)", "#1a1a1a", 1.2);
      }
    }
    if (!this.gaits.length) {
      for (const one of layer?.attractors ?? []) {
        if (!one.artefact && one.period) for (const state of one.states) dot(this.shown(state), 5, "#1a1a1a", "#fff");
      }
    }
    if (this.path.length) {
      const points = this.path.slice(-this.joined).map((x) => this.toScreen(...this.places(x)));
      c.lineJoin = "round";
      for (const [colour, width] of [["rgba(26,26,26,0.55)", 3], [PATH, 1.6]]) {
        c.beginPath();
        points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
        c.strokeStyle = colour;
        c.lineWidth = width;
        c.stroke();
      }
      this.path.forEach((x, i) => dot(x, i === this.path.length - 1 ? 6 : 3, PATH, "#1a1a1a", 1));
    }
    if (this.cross) {
      const [x, y] = this.toScreen(...this.cross);
      for (const [colour, width] of [["#fff", 4], ["#1a1a1a", 1.5]]) {
        c.strokeStyle = colour;
        c.lineWidth = width;
        c.beginPath();
        for (const [a, b] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          c.moveTo(x + 4 * a, y + 4 * b);
          c.lineTo(x + 11 * a, y + 11 * b);
        }
        c.stroke();
      }
    }
  }

  /** The least disturbance: from the gait to the nearest state from which the walker falls. */
  drawArrow(c, { from, to, exact }, ink, ground) {
    const [a, b] = [from, to].map((x) => this.toScreen(...this.places(x)));
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 3) return;
    const along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    const head = Math.min(9, 0.6 * length);
    const neck = [b[0] - head * along[0], b[1] - head * along[1]];
    for (const [colour, width] of [["#fff", 5], ["#c2410c", 2.2]]) {
      c.strokeStyle = c.fillStyle = colour;
      c.lineWidth = width;
      c.setLineDash(exact ? [] : [4, 3]);
      c.beginPath();
      c.moveTo(...a);
      c.lineTo(...neck);
      c.stroke();
      c.setLineDash([]);
      const wide = (head * 0.5) + (colour === "#fff" ? 1.5 : 0);
      c.beginPath();
      c.moveTo(b[0] + (colour === "#fff" ? 2 * along[0] : 0), b[1] + (colour === "#fff" ? 2 * along[1] : 0));
      c.lineTo(neck[0] - wide * along[1], neck[1] + wide * along[0]);
      c.lineTo(neck[0] + wide * along[1], neck[1] - wide * along[0]);
      c.fill();
    }
  }

  // ------------------------------------------------------------------ the hand

  listen() {
    const canvas = this.canvas;
    const point = (event) => {
      const { left, top } = canvas.getBoundingClientRect();
      return [event.clientX - left, event.clientY - top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button || !this.lattice) return;
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, point(event));
      this.travelled = this.pointers.size > 1 ? Infinity : 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = point(event), before = this.pointers.get(event.pointerId);
      if (before) this.drag(event.pointerId, before, now);
      else this.hover(now);
    });
    const end = (event) => {
      const at = this.pointers.get(event.pointerId);
      this.pointers.delete(event.pointerId);
      canvas.classList.remove("dragging");
      if (at && this.lattice && event.type === "pointerup" && this.travelled <= CLICK && this.inside(at)) this.click(this.toPlace(...at));
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => this.hover(null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const step = event.deltaMode === 1 ? 16 * event.deltaY : event.deltaY;
      this.zoomAt(point(event), -WHEEL * Math.max(-400, Math.min(400, step)) * (event.ctrlKey ? 4 : 1));
    }, { passive: false });
    canvas.addEventListener("dblclick", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("blur", () => { this.cross = null; this.redraw(); });
  }

  inside([x, y]) {
    const { left, top, width, height } = this.box;
    return x >= left && y >= top && x <= left + width && y <= top + height;
  }

  drag(id, before, now) {
    if (!this.lattice) return;
    const others = [...this.pointers].filter(([other]) => other !== id).map(([, at]) => at);
    this.pointers.set(id, now);
    if (others.length) { // two fingers: pan by their middle, zoom by their distance
      const other = others[0];
      const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]) || 1;
      const middle = now.map((v, k) => (v + other[k]) / 2);
      this.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
      this.zoomAt(middle, Math.log2(apart(now) / apart(before)));
      return;
    }
    this.travelled += Math.hypot(now[0] - before[0], now[1] - before[1]);
    if (this.travelled <= CLICK) return;
    this.canvas.classList.add("dragging");
    this.pan(now[0] - before[0], now[1] - before[1]);
  }

  pan(dx, dy) {
    const { view, lattice, box } = this;
    const centre = [
      view.centre[0] - (dx / box.width) * 2 * lattice.half(view, 0),
      view.centre[1] + (dy / box.height) * 2 * lattice.half(view, 1),
    ];
    this.setView({ ...view, centre });
  }

  zoomAt(at, by) {
    if (!this.lattice) return;
    const { view, lattice } = this;
    const { zoom } = clampView(lattice.about, { ...view, zoom: view.zoom + by });
    const place = this.toPlace(...at), scale = 2 ** (view.zoom - zoom);
    this.setView({ zoom, centre: view.centre.map((c, k) => place[k] + (c - place[k]) * scale) });
  }

  zoomBy(by) {
    this.zoomAt([this.box.left + this.box.width / 2, this.box.top + this.box.height / 2], by);
  }

  setView(view) {
    this.view = clampView(this.lattice.about, view);
    this.picture.progress = 0; // until it is known what is missing
    this.redraw();
    if (this.pointer) this.hover(this.pointer); // another place is below it
    this.moved();
  }

  moved() {
    if (this.lattice) this.dispatchEvent(new Event("moved"));
  }

  hover(at) {
    this.pointer = at;
    const detail = at && this.lattice && this.inside(at) ? this.toPlace(...at) : null;
    this.dispatchEvent(new CustomEvent("hover", { detail }));
  }

  click(place) {
    this.dispatchEvent(new CustomEvent("start", { detail: this.values(place) }));
  }

  key(event) {
    if (!this.lattice) return;
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": 0.5, "=": 0.5, "-": -0.5 };
    const { view, lattice } = this;
    if (event.key in moves) {
      const share = event.shiftKey ? 0.1 : 0.01;
      const cross = (this.cross ?? view.centre).map((c, k) => c + moves[event.key][k] * share * 2 * lattice.half(view, k));
      this.cross = cross;
      const outside = cross.some((c, k) => Math.abs(c - view.centre[k]) > lattice.half(view, k));
      if (outside) this.setView({ ...view, centre: cross });
      this.redraw();
      this.dispatchEvent(new CustomEvent("hover", { detail: cross }));
    } else if (event.key in zooms) {
      if (this.cross) this.zoomAt(this.toScreen(...this.cross), zooms[event.key]);
      else this.zoomBy(zooms[event.key]);
    } else if (event.key === "0" || event.key === "Home") {
      this.setView(lattice.whole());
    } else if (event.key === "Enter") {
      this.click(this.cross ?? view.centre);
    } else return;
    event.preventDefault();
  }
}
