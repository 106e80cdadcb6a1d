// The bifurcation diagram: gaits and attractors over the slope, and the slope itself as a cursor.

import { css } from "./palette.js";
import { decimals, number, ticks } from "./words.js";

const MARGIN = { left: 70, right: 14, top: 12, bottom: 44 };
const STEP = 0.0001; // of the slope, by a key

export class Diagram extends EventTarget {
  constructor(canvas, palette) {
    super();
    Object.assign(this, { canvas, palette, data: null, slope: 0 });
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.draw()).observe(canvas);
    const slopeAt = (event) => {
      const { left } = canvas.getBoundingClientRect();
      const share = (event.clientX - left - MARGIN.left) / this.width;
      const [low, high] = this.range();
      return Math.min(high, Math.max(low, low + share * (high - low)));
    };
    const tell = (slope) => this.dispatchEvent(new CustomEvent("slope", { detail: Number(slope.toFixed(6)) }));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      tell(slopeAt(event));
    });
    canvas.addEventListener("pointermove", (event) => event.buttons && tell(slopeAt(event)));
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -10, PageUp: 10 }[event.key];
      if (!step) return;
      event.preventDefault();
      tell(this.slope + step * STEP);
    });
  }

  range() {
    return this.data?.range ?? [0.001, 0.022];
  }

  setSlope(slope) {
    this.slope = slope;
    const [low, high] = this.range();
    for (const [name, value] of Object.entries({ valuemin: low, valuemax: high, valuenow: slope })) {
      this.canvas.setAttribute(`aria-${name}`, value);
    }
    this.draw();
  }

  setData(data) {
    this.data = data;
    this.draw();
  }

  draw() {
    const { canvas, context: c, data } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    const ratio = devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    this.width = width - MARGIN.left - MARGIN.right;
    const tall = height - MARGIN.top - MARGIN.bottom;
    const [low, high] = this.range();
    const [bottom, top] = this.extent();
    const x = (slope) => MARGIN.left + ((slope - low) / (high - low)) * this.width;
    const y = (theta) => MARGIN.top + (1 - (theta - bottom) / (top - bottom)) * tall;
    c.save();
    c.beginPath();
    c.rect(MARGIN.left, MARGIN.top, this.width, tall);
    c.clip();
    if (data) this.drawData(c, x, y, colour);
    c.restore();
    this.drawAxes(c, x, y, tall, colour, [bottom, top]);
    if (this.slope >= low && this.slope <= high) this.drawCursor(c, x(this.slope), tall);
  }

  extent() {
    const thetas = this.data?.points.map(([, theta]) => theta) ?? [0.1, 0.3];
    if (!thetas.length) return [0, 0.5];
    const low = Math.min(...thetas), high = Math.max(...thetas), pad = 0.06 * (high - low || 0.1);
    return [low - pad, high + pad];
  }

  drawData(c, x, y, colour) {
    for (const branch of this.data.branches) {
      for (const thetas of branch.theta) {
        for (const stable of [0, 1]) {
          c.beginPath();
          c.strokeStyle = stable ? colour("--ink") : colour("--soft");
          c.lineWidth = stable ? 2 : 1;
          c.setLineDash(stable ? [] : [5, 4]);
          branch.slope.forEach((slope, k) => {
            const drawn = branch.stable[k] === stable || branch.stable[k - 1] === stable;
            if (drawn && k > 0 && branch.stable[k - 1] === stable) c.lineTo(x(slope), y(thetas[k]));
            else c.moveTo(x(slope), y(thetas[k]));
          });
          c.stroke();
        }
      }
    }
    c.setLineDash([]);
    c.fillStyle = css(this.palette.basins[0], 0.75);
    for (const [slope, theta] of this.data.points) c.fillRect(x(slope) - 0.75, y(theta) - 0.75, 1.5, 1.5);
    for (const one of this.data.events) {
      c.beginPath();
      c.arc(x(one.slope), y(one.theta), 3.5, 0, 2 * Math.PI);
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
    const slopes = ticks(...this.range(), Math.max(2, this.width / 90));
    for (const value of slopes.values) c.fillText(decimals(value, slopes.places), x(value), MARGIN.top + tall + 7);
    const thetas = ticks(bottom, top, tall / 60);
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const value of thetas.values) c.fillText(decimals(value, thetas.places), MARGIN.left - 7, y(value));
    c.fillStyle = colour("--soft");
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    c.fillText("slope (rad)", MARGIN.left + this.width / 2, MARGIN.top + tall + 39);
    c.save();
    c.translate(13, MARGIN.top + tall / 2);
    c.rotate(-Math.PI / 2);
    c.fillText("stance leg angle θ at heel strike (rad)", 0, 0);
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
    const doublings = this.data.events.filter((one) => one.cascade && !one.fold).map((one) => one.slope);
    const first = doublings.length ? `the gait first doubles its period at ${number(Math.min(...doublings), 5)}` : "no period doubling";
    return `Solid: stable gaits; dashed: unstable ones; dots: attractors. ${first[0].toUpperCase()}${first.slice(1)}${below && above ? `; walking is lost near ${number(below, 3)}` : ""}.`;
  }
}
