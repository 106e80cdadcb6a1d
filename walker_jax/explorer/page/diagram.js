// The bifurcation diagram: gaits and attractors over a parameter, and its value as a cursor.

import { css } from "./palette.js";
import { decimals, number, spaced, ticks, unitBeside } from "./words.js";

const MARGIN = { left: 70, right: 14, top: 12, bottom: 44 };
const STEPS = 210; // by a key, from end to end

export class Diagram extends EventTarget {
  constructor(canvas, state, palette) {
    super();
    Object.assign(this, { canvas, state, palette, data: null });
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.draw()).observe(canvas);
    const valueAt = (event) => {
      const { left } = canvas.getBoundingClientRect();
      const share = (event.clientX - left - MARGIN.left) / this.width;
      const [low, high] = this.range();
      return Math.min(high, Math.max(low, low + share * (high - low)));
    };
    const tell = (value) => {
      const [low, high] = this.range();
      const places = Math.max(0, Math.min(12, 4 - Math.floor(Math.log10(high - low))));
      this.dispatchEvent(new CustomEvent("value", { detail: Number(value.toFixed(places)) }));
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      tell(valueAt(event));
    });
    canvas.addEventListener("pointermove", (event) => event.buttons && tell(valueAt(event)));
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[event.key];
      if (!step) return;
      event.preventDefault();
      const [low, high] = this.range();
      tell(this.value + (step * (high - low)) / STEPS);
    });
  }

  /** The parameter over which it is, what there is to say of it, its value and the ends of it. */
  get over() {
    return this.state.kind.parameters.find(({ name }) => name === this.state.over);
  }

  get value() {
    return this.state.parameters[this.state.over];
  }

  range() {
    return this.data?.range ?? this.state.kind.spans[this.state.over];
  }

  /** Show the parameter's value. */
  show() {
    if (!this.over) return;
    const [low, high] = this.range();
    const told = { valuemin: low, valuemax: high, valuenow: this.value, label: `${this.name()}, on the bifurcation diagram` };
    for (const [name, value] of Object.entries(told)) this.canvas.setAttribute(`aria-${name}`, value);
    this.draw();
  }

  name() {
    const name = spaced(this.over.name);
    return name[0].toUpperCase() + name.slice(1);
  }

  setData(data) {
    this.data = data;
    this.draw();
  }

  draw() {
    const { canvas } = this, { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height || !this.over) return;
    const ratio = devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawOn(this.context);
  }

  /** Draw all on a context of CSS pixels. */
  drawOn(c) {
    const { canvas, data } = this, { clientWidth: width, clientHeight: height } = canvas;
    const style = getComputedStyle(canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    this.width = width - MARGIN.left - MARGIN.right;
    const tall = height - MARGIN.top - MARGIN.bottom;
    const [low, high] = this.range();
    const [bottom, top] = this.extent();
    const x = (value) => MARGIN.left + ((value - low) / (high - low)) * this.width;
    const y = (place) => MARGIN.top + (1 - (place - bottom) / (top - bottom)) * tall;
    c.save();
    c.beginPath();
    c.rect(MARGIN.left, MARGIN.top, this.width, tall);
    c.clip();
    if (data) this.drawData(c, x, y, colour);
    c.restore();
    this.drawAxes(c, x, y, tall, colour, [bottom, top]);
    if (this.value >= low && this.value <= high) this.drawCursor(c, x(this.value), tall);
  }

  extent() {
    const { points, branches } = this.data ?? { points: [], branches: [] };
    const places = points.length ? points.map(([, place]) => place) : branches.flatMap((one) => one.state.flat());
    if (!places.length) return [0, 0.5];
    const low = Math.min(...places), high = Math.max(...places), pad = 0.06 * (high - low || 0.1);
    return [low - pad, high + pad];
  }

  drawData(c, x, y, colour) {
    for (const branch of this.data.branches) {
      for (const places of branch.state) {
        for (const stable of [0, 1]) {
          c.beginPath();
          c.strokeStyle = stable ? colour("--ink") : colour("--soft");
          c.lineWidth = stable ? 2 : 1;
          c.setLineDash(stable ? [] : [5, 4]);
          branch.value.forEach((value, k) => {
            const drawn = branch.stable[k] === stable || branch.stable[k - 1] === stable;
            if (drawn && k > 0 && branch.stable[k - 1] === stable) c.lineTo(x(value), y(places[k]));
            else c.moveTo(x(value), y(places[k]));
          });
          c.stroke();
        }
      }
    }
    c.setLineDash([]);
    c.fillStyle = css(this.palette.basins[0], 0.75);
    for (const [value, place] of this.data.points) c.fillRect(x(value) - 0.75, y(place) - 0.75, 1.5, 1.5);
    for (const one of this.data.events) {
      c.beginPath();
      c.arc(x(one.value), y(one.state), 3.5, 0, 2 * Math.PI);
      c.fillStyle = colour("--page");
      c.strokeStyle = css(this.palette.basins[1]);
      c.lineWidth = 1.6;
      c.fill();
      c.stroke();
    }
  }

  drawAxes(c, x, y, tall, colour, [bottom, top]) {
    c.strokeStyle = colour("--soft");
    c.lineWidth = 1;
    c.strokeRect(MARGIN.left + 0.5, MARGIN.top + 0.5, this.width - 1, tall - 1);
    c.fillStyle = colour("--ink");
    c.font = "12px system-ui, sans-serif";
    c.textAlign = "center";
    c.textBaseline = "top";
    const across = ticks(...this.range(), Math.max(2, this.width / 90));
    for (const value of across.values) c.fillText(decimals(value, across.places), x(value), MARGIN.top + tall + 7);
    const up = ticks(bottom, top, tall / 60);
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const value of up.values) c.fillText(decimals(value, up.places), MARGIN.left - 7, y(value));
    c.fillStyle = colour("--soft");
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    const { name, unit } = this.over, { section, coordinates } = this.state.kind;
    c.fillText(`${spaced(name)} ${unitBeside(spaced(name), unit)}`, MARGIN.left + this.width / 2, MARGIN.top + tall + 39);
    c.save();
    c.translate(13, MARGIN.top + tall / 2);
    c.rotate(-Math.PI / 2);
    c.fillText(this.state.words.traced ?? coordinates[section[0]].label, 0, 0);
    c.restore();
  }

  drawCursor(c, at, tall) {
    c.strokeStyle = "#c2410c";
    c.lineWidth = 1.6;
    c.beginPath();
    c.moveTo(at, MARGIN.top);
    c.lineTo(at, MARGIN.top + tall);
    c.stroke();
    c.beginPath();
    c.moveTo(at - 6, MARGIN.top);
    c.lineTo(at + 6, MARGIN.top);
    c.lineTo(at, MARGIN.top + 8);
    c.fillStyle = "#c2410c";
    c.fill();
  }

  /** The diagram in words. */
  note() {
    if (!this.data) return "";
    const [below, above] = this.data.lost; // no upper one where some walk at the highest slope
    const { gait, lost } = this.state.words;
    const doublings = this.data.events.filter((one) => one.cascade && !one.fold).map((one) => one.value);
    const first = doublings.length ? `the ${gait} first doubles its period at ${number(Math.min(...doublings), 5)}` : "no period doubling";
    return `Solid: stable ${gait}s; dashed: unstable ones; dots: attractors. ${first[0].toUpperCase()}${first.slice(1)}${below && above ? `; ${lost} near ${number(below, 3)}` : ""}.`;
  }
}
