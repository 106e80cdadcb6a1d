// The stage: the walker on its slope, ghosts of its last steps, and the hand that pushes its hip.

import { aboveGround } from "./ground.js";
import { css } from "./palette.js";

const GHOSTS = 4; // poses at the last heel strikes
const HIP = 9; // CSS pixels of its disc's radius
const REACH = 26; // CSS pixels around the hip in which a hand takes hold of it
const IMPULSE = 0.25; // of a push, for each leg's length that the hand pulls

export class Stage extends EventTarget {
  constructor(canvas, walk, palette) {
    super();
    Object.assign(this, { canvas, walk, palette, ground: 0 });
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.resize()).observe(canvas);
    for (const event of ["changed", "stride"]) walk.addEventListener(event, () => this.run());
    this.listen();
  }

  /** The slope of the walk that is shown; of the ground where there is none. */
  get slope() {
    return this.walk.subject?.parameters.slope ?? this.ground;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(width * this.ratio);
    this.canvas.height = Math.round(height * this.ratio);
    this.size = [width, height];
    this.draw();
  }

  /** Draw as long as the walker moves. */
  run() {
    if (this.frame) return;
    const tick = (now) => {
      const seconds = Math.min(0.05, (now - (this.last ?? now)) / 1000);
      this.last = now;
      this.walk.advance(seconds);
      this.draw();
      const moving = this.walk.playing || this.settling;
      this.frame = moving ? requestAnimationFrame(tick) : null;
      if (!moving) this.last = null;
    };
    this.frame = requestAnimationFrame(tick);
  }

  draw() {
    const { context: c, walk, size } = this;
    if (!size) return;
    const style = getComputedStyle(this.canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    c.clearRect(0, 0, ...size);
    const state = walk.state();
    const tall = walk.leg ? walk.leg.length + walk.leg.radius : 1;
    this.scale = Math.min(size[1] / (1.38 * tall), size[0] / (1.7 * tall));
    const shown = (places) => aboveGround(places, walk.leg, HIP / this.scale);
    const places = state ? shown(walk.places(state, walk.current.foot, walk.bent())) : null;
    const target = places ? places.hip[0] : 0;
    this.camera = this.smooth(this.camera, target, tall);
    const [cos, sin] = [Math.cos(this.slope), Math.sin(this.slope)];
    const floor = size[1] * 0.88;
    this.toScreen = ([u, v]) => {
      const x = u - this.camera;
      return [size[0] / 2 + (x * cos + v * sin) * this.scale, floor + (x * sin - v * cos) * this.scale];
    };
    this.drawGround(c, colour, tall);
    if (!places) return;
    const at = walk.strides.indexOf(walk.current);
    const strikes = walk.strides.slice(Math.max(0, at - GHOSTS), at);
    strikes.forEach((one, k) => {
      if (one.cut || !one.frames.length) return;
      c.globalAlpha = 0.1 + 0.07 * (k + GHOSTS - strikes.length);
      this.drawPose(c, shown(walk.places(one.frames.at(-1), one.foot)), colour("--ink"), colour("--ink"), 1.5);
    });
    c.globalAlpha = 1;
    const swing = css(this.palette.basins[1]);
    this.drawPose(c, places, colour("--ink"), swing, 4.5, colour("--panel"));
    this.hip = this.toScreen(places.hip);
    if (this.pull) this.drawPull(c, colour);
  }

  /** The camera follows the hip; it jumps only where a new walk begins. */
  smooth(camera, target, tall) {
    this.settling = false;
    if (camera === undefined || Math.abs(target - camera) > 3 * tall) return target;
    const next = camera + 0.12 * (target - camera);
    this.settling = Math.abs(target - next) > 0.002 * tall;
    return next;
  }

  drawGround(c, colour, tall) {
    const [width, height] = this.size;
    const far = width / this.scale + tall;
    const [left, right] = [this.camera - far, this.camera + far].map((u) => this.toScreen([u, 0]));
    c.fillStyle = colour("--soil");
    c.beginPath();
    c.moveTo(...left);
    c.lineTo(...right);
    c.lineTo(right[0], height + 300);
    c.lineTo(left[0], height + 300);
    c.fill();
    c.strokeStyle = colour("--soft");
    c.lineWidth = 1.2;
    c.beginPath();
    c.moveTo(...left);
    c.lineTo(...right);
    const step = tall / 2;
    for (let u = Math.ceil((this.camera - far) / step) * step; u < this.camera + far; u += step) {
      c.moveTo(...this.toScreen([u, 0]));
      c.lineTo(...this.toScreen([u, -0.05 * tall]));
    }
    c.stroke();
  }

  drawPose(c, { hip, stance, swing, knee, angles }, ink, other, width, edge) {
    const { radius } = this.walk.leg;
    c.lineCap = "round";
    for (const [end, angle, colour, joint] of [[stance, angles[0], ink], [swing, angles[1], other, knee]]) {
      c.strokeStyle = colour;
      c.lineWidth = width;
      c.beginPath();
      c.moveTo(...this.toScreen(hip));
      if (joint) c.lineTo(...this.toScreen(joint));
      const sole = [end[0] + radius * Math.sin(angle), end[1] - radius * Math.cos(angle)];
      c.lineTo(...this.toScreen(radius ? sole : end));
      c.stroke();
      if (radius) {
        c.beginPath();
        for (let k = -12; k <= 12; k++) {
          const turn = angle + (k / 12) * 0.6;
          c.lineTo(...this.toScreen([end[0] + radius * Math.sin(turn), end[1] - radius * Math.cos(turn)]));
        }
        c.stroke();
      } else {
        this.disc(c, end, width * 0.8, colour, edge);
      }
    }
    this.disc(c, hip, edge ? HIP : width * 2, ink, edge);
  }

  disc(c, at, radius, fill, edge) {
    c.beginPath();
    c.arc(...this.toScreen(at), radius, 0, 2 * Math.PI);
    c.fillStyle = fill;
    c.fill();
    if (edge) {
      c.strokeStyle = edge;
      c.lineWidth = 1.5;
      c.stroke();
    }
  }

  /** The pull of the hand, and the impulse that it will give. */
  drawPull(c, colour) {
    const [x, y] = this.hip;
    const to = [x + this.pull[0], y + this.pull[1]];
    c.strokeStyle = "#c2410c";
    c.lineWidth = 2.2;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(...to);
    c.stroke();
    c.beginPath();
    c.arc(...to, 5, 0, 2 * Math.PI);
    c.fillStyle = "#c2410c";
    c.fill();
    c.fillStyle = colour("--ink");
    c.font = "12px system-ui, sans-serif";
    c.textAlign = to[0] > this.size[0] / 2 ? "right" : "left";
    const size = Math.hypot(...this.impulse());
    c.fillText(`push ${size.toFixed(4)} m√(gl)`, to[0] + (c.textAlign === "right" ? -10 : 10), to[1] - 8);
  }

  /** The impulse of the pull, along the slope and normal to it. */
  impulse() {
    const [dx, dy] = this.pull.map((d) => (IMPULSE * d) / this.scale);
    const [cos, sin] = [Math.cos(this.slope), Math.sin(this.slope)];
    return [dx * cos + dy * sin, dx * sin - dy * cos];
  }

  listen() {
    const { canvas } = this;
    const point = (event) => {
      const { left, top } = canvas.getBoundingClientRect();
      return [event.clientX - left, event.clientY - top];
    };
    const near = (at) => this.hip && Math.hypot(at[0] - this.hip[0], at[1] - this.hip[1]) < REACH;
    canvas.addEventListener("pointerdown", (event) => {
      if (!near(point(event)) || !this.walk.strides.length) return;
      event.preventDefault();
      canvas.setPointerCapture(event.pointerId);
      this.wasPlaying = this.walk.playing;
      this.walk.playing = false;
      this.pull = [0, 0];
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = point(event);
      canvas.style.cursor = this.pull ? "grabbing" : near(at) ? "grab" : "";
      if (!this.pull) return;
      this.pull = [at[0] - this.hip[0], at[1] - this.hip[1]];
      this.run();
    });
    const end = (event) => {
      if (!this.pull) return;
      const impulse = this.impulse(), pushed = Math.hypot(...this.pull) > 4 && event.type === "pointerup";
      this.pull = null;
      if (pushed) this.walk.push(impulse);
      else this.walk.playing = this.wasPlaying;
      this.run();
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }
}
