// A walk: its strides as the server sends them, the clock, and where everything is at a time.

import { ask } from "./api.js";

const UNIT = 1 / Math.sqrt(9.81); // seconds in a unit of time, for legs of one metre
const AHEAD = 6; // units of time before the end of what is known, at which more is asked for
const STRIDES = 12; // of one answer
const ITERATE = 0.4; // units of time for which an iterate without a film is the last one shown
const KEPT = { film: 240, iterates: 2000 }; // strides that are remembered
const WALKS = 0; // the outcome of a stride that leads to the next

export class Walk extends EventTarget {
  constructor() {
    super();
    this.clear();
    this.speed = 1;
  }

  clear() {
    this.abort?.abort();
    this.abort = null; // of the one request that is under way
    this.following = null; // the promise of more strides
    this.pushing = null; // the impulse of a push under way, in which time stands still
    this.strides = [];
    this.time = 0;
    this.playing = false;
    this.over = true;
    this.pushes = 0;
    this.subject = null;
  }

  /** Strides from the server: null where they are refused, or something newer is asked for. */
  async ask(body) {
    this.abort?.abort();
    const abort = (this.abort = new AbortController());
    try {
      const answer = await ask("/api/walk", { ...body, strides: STRIDES }, abort.signal);
      return abort.signal.aborted ? null : answer;
    } catch (error) {
      if (error.name === "AbortError" || abort.signal.aborted) return null;
      this.playing = false;
      this.dispatchEvent(new CustomEvent("failed", { detail: error }));
      this.tell();
      return null;
    } finally {
      if (this.abort === abort) this.abort = null;
    }
  }

  /** Walk from a start on the section; what walked before walks on until then. */
  async begin(subject, start) {
    subject = structuredClone(subject);
    this.following = this.pushing = null;
    const answer = await this.ask({ ...subject, start });
    if (!answer) return;
    this.clear();
    Object.assign(this, { subject, start });
    this.append(answer, 0, 0);
    this.playing = this.strides[0].duration > 0;
    this.tell();
  }

  append({ strides, next, leg }, foot, begins) {
    Object.assign(this, { next, leg });
    for (const one of strides) {
      const last = this.strides.at(-1);
      const number = last ? last.number + (last.cut ? 0 : 1) : 0; // a push cuts a stride in two
      const duration = leg ? one.duration : one.outcome === WALKS ? ITERATE : 0;
      this.strides.push({ ...one, duration, foot, begins, ends: begins + duration, number });
      begins += duration;
      foot = this.nextFoot(one.frames.at(-1), foot);
    }
    this.strides.splice(0, Math.max(0, this.strides.length - KEPT[leg ? "film" : "iterates"]));
    this.over = this.strides.at(-1).outcome !== WALKS;
    this.tell();
  }

  /** Where the next stance foot is: that is, its point of contact when its leg is upright. */
  nextFoot(state, foot) {
    if (!state) return foot; // of what is not drawn
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
    if (!this.playing || this.pushing || !this.strides.length) return;
    const before = this.current;
    this.time += (seconds * this.speed) / UNIT;
    const last = this.strides.at(-1);
    if (!this.over && !this.abort && last.ends - this.time < AHEAD * Math.max(1, this.speed)) this.goOn();
    if (this.time >= last.ends) {
      this.time = last.ends;
      if (this.over) {
        this.playing = false;
        this.tell();
      }
    }
    if (this.current !== before) this.dispatchEvent(new Event("stride"));
  }

  /** Ask for the strides that follow the last one; whether they have come. */
  goOn() {
    this.following ??= this.follow().finally(() => (this.following = null));
    return this.following;
  }

  async follow() {
    const last = this.strides.at(-1);
    const answer = await this.ask({ ...this.subject, start: this.next });
    if (answer) this.append(answer, this.nextFoot(last.frames.at(-1), last.foot), last.ends);
    return Boolean(answer);
  }

  /** To the next heel strike, and stay there. */
  async stepOn() {
    const one = this.current;
    if (!one || (this.abort && !this.following)) return; // another walk is about to begin
    this.playing = false;
    if (one === this.strides.at(-1) && !this.over && !(await this.goOn())) return this.tell();
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

  /**
   * A push at the hip: an impulse along the slope and normal to it; the walk goes on from there.
   * One push after another at the same time is a push by their sum.
   */
  async push(impulse) {
    const state = this.state(), one = this.current, time = this.time;
    if (!state || (this.over && time >= this.strides.at(-1).ends)) return;
    if (this.abort && !this.following && !this.pushing) return; // another walk is about to begin
    const sum = impulse.map((part, k) => part + (this.pushing?.[k] ?? 0));
    this.pushing = sum;
    const answer = await this.ask({ ...this.subject, start: fullState(state, one, time), push: sum });
    if (this.pushing === sum) this.pushing = null;
    if (!answer) return;
    this.strides = [...this.strides.slice(0, this.strides.indexOf(one)), { ...one, ends: time, cut: true }];
    this.time = time;
    this.pushes += 1;
    this.append(answer, one.foot, time);
    this.playing = true;
    this.tell();
  }

  tell() {
    this.dispatchEvent(new Event("changed"));
  }
}

/** The state as the server takes it: of a walker with knees all angles while one bends, and those of the legs after. */
function fullState(state, { bent, locks, begins }, time) {
  if (!bent || state.length === 4) return state; // which a walker with phases of its own has
  const [theta, phi, knee, thetadot, phidot, kneedot] = state;
  if (locks !== null && time - begins >= locks) return [theta, phi, thetadot, phidot];
  return [theta, phi, Math.max(0, knee), thetadot, phidot, kneedot];
}
