// A walk: its strides as the server sends them, the clock, and where everything is at a time.

import { ask } from "./api.js";

const UNIT = 1 / Math.sqrt(9.81); // seconds in a unit of time, for legs of one metre
const AHEAD = 6; // units of time before the end of what is known, at which more is asked for
const STRIDES = 12; // of one answer
const KEPT = 240; // strides that are remembered
const WALKS = 0; // the outcome of a stride that leads to the next

export class Walk extends EventTarget {
  constructor() {
    super();
    this.clear();
    this.speed = 1;
  }

  clear() {
    this.abort?.abort();
    this.strides = [];
    this.time = 0;
    this.playing = false;
    this.over = true;
    this.pushes = 0;
    this.subject = null;
  }

  /** Walk from a start on the section, with the leg's sizes. */
  async begin(subject, start, leg) {
    this.clear();
    Object.assign(this, { subject: structuredClone(subject), start, leg });
    await this.more({ start }, 0, 0);
    this.playing = this.strides.length > 0 && this.strides[0].frames.length > 1;
    this.tell();
  }

  /** Ask for the strides that follow, the first with its foot at a place, at a time. */
  async more(from, foot, begins) {
    const abort = (this.abort = new AbortController());
    this.asking = true;
    try {
      const body = { ...this.subject, ...from, strides: STRIDES };
      const answer = await ask("/api/walk", body, abort.signal);
      if (!abort.signal.aborted) this.append(answer, foot, begins);
    } catch (error) {
      if (error.name !== "AbortError") this.dispatchEvent(new CustomEvent("failed", { detail: error }));
    } finally {
      if (this.abort === abort) this.asking = false;
    }
  }

  append({ strides, next }, foot, begins) {
    this.next = next;
    for (const one of strides) {
      this.strides.push({ ...one, foot, begins, ends: begins + one.duration, number: (this.strides.at(-1)?.number ?? -1) + 1 });
      begins += one.duration;
      if (one.frames.length) foot = this.nextFoot(one.frames.at(-1), foot);
    }
    this.strides.splice(0, Math.max(0, this.strides.length - KEPT));
    const last = this.strides.at(-1);
    this.over = !last || last.outcome !== WALKS;
    this.tell();
  }

  /** Where the next stance foot is: that is, its point of contact when its leg is upright. */
  nextFoot(state, foot) {
    const { swing } = this.places(state, foot);
    return swing[0] + this.leg.radius * (state[0] - state[1]);
  }

  /** Hip and feet, along the slope and normal to it; of round feet the centres of their arcs. */
  places([theta, phi], foot, bent) {
    const { length, radius } = this.leg;
    const along = (angle) => [-Math.sin(angle) * length, Math.cos(angle) * length];
    const stance = [foot - radius * theta, radius];
    const up = along(theta), down = along(theta - phi);
    const hip = [stance[0] + up[0], stance[1] + up[1]];
    const swing = [hip[0] - down[0], hip[1] - down[1]], angles = [theta, theta - phi];
    if (!bent) return { stance, hip, swing, angles };
    const [kneeX, kneeY, endX, endY] = bent; // from the hip; the shank has an angle of its own
    const shank = Math.atan2(endX - kneeX, kneeY - endY);
    return { stance, hip, knee: [hip[0] + kneeX, hip[1] + kneeY], swing: [hip[0] + endX, hip[1] + endY], angles: [theta, shank] };
  }

  /** The stride at the time that is shown. */
  get current() {
    return this.strides.find((one) => this.time < one.ends) ?? this.strides.at(-1);
  }

  /** Where knee and end of the swing leg are at the time that is shown, of a walker with knees. */
  bent() {
    const { bent, frames, duration, begins } = this.current;
    if (!bent) return undefined;
    const at = Math.min(1, Math.max(0, (this.time - begins) / duration || 0)) * (frames.length - 1);
    const k = Math.min(frames.length - 2, Math.floor(at));
    return bent[k].map((value, i) => value + (at - k) * (bent[k + 1][i] - value));
  }

  /** The full state at the time that is shown: cubics through frames and their rates. */
  state() {
    const one = this.current;
    if (!one?.frames.length) return null;
    const { frames, duration, begins } = one;
    const step = duration / (frames.length - 1);
    const at = Math.min(frames.length - 1, Math.max(0, (this.time - begins) / step || 0));
    const k = Math.min(frames.length - 2, Math.floor(at)), t = at - k;
    const [a, b] = [frames[k], frames[k + 1]], n = a.length / 2; // angles, and then their rates
    const cubic = (i) => {
      const [p, q, u, v] = [a[i], b[i], a[i + n] * step, b[i + n] * step];
      return p + t * (u + t * (3 * (q - p) - 2 * u - v + t * (2 * (p - q) + u + v)));
    };
    const linear = (i) => a[i] + t * (b[i] - a[i]);
    return a.map((_, i) => (i < n ? cubic(i) : linear(i)));
  }

  /** Let time pass, in seconds of a clock. */
  advance(seconds) {
    if (!this.playing || !this.strides.length) return;
    const before = this.current;
    this.time += (seconds * this.speed) / UNIT;
    const last = this.strides.at(-1);
    if (!this.over && !this.asking && last.ends - this.time < AHEAD * Math.max(1, this.speed)) this.goOn();
    if (this.time >= last.ends) {
      this.time = last.ends;
      if (this.over) {
        this.playing = false;
        this.tell();
      }
    }
    if (this.current !== before) this.dispatchEvent(new Event("stride"));
  }

  /** Ask for the strides that follow the last one. */
  goOn() {
    const last = this.strides.at(-1);
    return this.more({ start: this.next }, this.nextFoot(last.frames.at(-1), last.foot), last.ends);
  }

  /** To the next heel strike, and stay there. */
  async stepOn() {
    const one = this.current;
    if (!one) return;
    if (one === this.strides.at(-1) && !this.over) await this.goOn();
    this.playing = false;
    this.time = one.ends;
    this.dispatchEvent(new Event("stride"));
    this.tell();
  }

  again() {
    if (!this.strides.length) return;
    this.time = this.strides[0].begins;
    this.playing = true;
    this.tell();
  }

  toggle() {
    if (!this.strides.length) return;
    if (!this.playing && this.over && this.time >= this.strides.at(-1).ends) return this.again();
    this.playing = !this.playing;
    this.tell();
  }

  /** A push at the hip: an impulse along the slope and normal to it; the walk goes on from there. */
  async push(impulse) {
    const state = this.state(), one = this.current;
    if (!state || (this.over && this.time >= this.strides.at(-1).ends)) return;
    const strides = this.strides.slice(0, this.strides.indexOf(one));
    this.abort?.abort();
    const time = this.time;
    const body = { ...this.subject, start: fullState(state, one, time), push: impulse, strides: STRIDES };
    try {
      const answer = await ask("/api/walk", body);
      this.strides = [...strides, { ...one, ends: time }]; // the stride that the push has cut short
      this.pushes += 1;
      this.append(answer, one.foot, time);
      this.playing = true;
      this.tell();
    } catch (error) {
      this.dispatchEvent(new CustomEvent("failed", { detail: error }));
    }
  }

  tell() {
    this.dispatchEvent(new Event("changed"));
  }
}

/** The state as the server takes it: of a walker with knees all angles while one bends, and those of the legs after. */
function fullState(state, { bent, locks, begins }, time) {
  if (!bent) return state;
  const [theta, phi, knee, thetadot, phidot, kneedot] = state;
  if (locks !== null && time - begins >= locks) return [theta, phi, thetadot, phidot];
  return [theta, phi, Math.max(0, knee), thetadot, phidot, kneedot];
}
