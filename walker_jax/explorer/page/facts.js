// The facts beside the picture: gait, multipliers, area and least disturbance, as they come in.
//
// From the picture itself come estimates at once; the server's exact values follow once the hand rests.

import { Refused, ask } from "./api.js";
import { area, count, multipliers, number, withError } from "./words.js";

const REST = 450; // ms without a change, after which the exact values are asked for
const NAMES = { gaits: ["gait", "multipliers"], area: ["area"], disturbance: ["disturbance"] };
const KINDS = Object.keys(NAMES);

export class Facts extends EventTarget {
  constructor(root, state) {
    super();
    this.state = state;
    this.shown = Object.fromEntries(
      ["gait", "multipliers", "area", "disturbance"].map((name) => [name, root.querySelector(`#fact-${name}`)]),
    );
    this.bodies = {}; // of each kind: the request for what is shown,
    this.keys = {}; // the same as one word,
    this.asked = {}; // that of the last request that was not given up,
    this.exact = {}; // whether its answer stands,
    this.aborts = {};
    this.gaits = [];
  }

  write(name, text, exact = true) {
    this.shown[name].textContent = text;
    this.shown[name].classList.toggle("pending", !exact);
  }

  /** Give up what is known and asked for, and say why. */
  clear(words) {
    clearTimeout(this.timer);
    for (const abort of Object.values(this.aborts)) abort.abort();
    Object.assign(this, { keys: {}, asked: {}, exact: {}, gaits: [], disturbance: null, rough: null });
    for (const name of Object.keys(this.shown)) this.write(name, words, false);
    for (const event of ["gaits", "disturbance"]) this.dispatchEvent(new Event(event));
  }

  /** The requests for what is chosen. */
  chosen() {
    const subject = structuredClone(this.state.subject());
    const { section: _, ...walker } = { ...subject, at: {} }; // in any plane the same
    return { gaits: walker, area: { ...subject, cells: this.cells }, disturbance: walker };
  }

  /** Grey what is not the exact value of what is chosen. */
  mark() {
    for (const [kind, body] of Object.entries(this.chosen())) {
      const stands = this.exact[kind] && this.keys[kind] === JSON.stringify(body);
      for (const name of NAMES[kind]) this.shown[name].classList.toggle("pending", !stands);
    }
  }

  /** Ask for what has changed, once nothing changes any more. */
  want(cells, cellArea) {
    this.viewArea = cells[3] * cells[4] * cellArea;
    this.cells = cells;
    this.bodies = this.chosen();
    for (const kind of KINDS) {
      const key = JSON.stringify(this.bodies[kind]);
      if (this.keys[kind] === key) continue;
      this.keys[kind] = key;
      this.exact[kind] = false;
      this.aborts[kind]?.abort();
      if (kind === "disturbance") this.disturbance = null;
      if (kind === "gaits") {
        this.gaits = [];
        this.write("multipliers", "…", false);
        this.dispatchEvent(new Event("gaits"));
      }
    }
    this.mark();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => KINDS.forEach((kind) => this.measure(kind)), REST);
  }

  async measure(kind) {
    const key = this.keys[kind];
    if (this.asked[kind] === key) return;
    this.asked[kind] = key;
    const abort = (this.aborts[kind] = new AbortController());
    const current = () => this.keys[kind] === key && !abort.signal.aborted;
    try {
      const found = await ask(`/api/measure/${kind}`, this.bodies[kind], abort.signal);
      if (!current()) return;
      this.exact[kind] = true;
      this[kind === "gaits" ? "showGaits" : kind === "area" ? "showArea" : "showDisturbance"](found);
    } catch (error) {
      if (!(error instanceof Refused)) { // given up, or the server is gone: said elsewhere
        if (this.asked[kind] === key) this.asked[kind] = "";
      } else if (current()) {
        this.exact[kind] = true;
        this.write(kind === "gaits" ? "gait" : kind, error.message);
        if (kind === "gaits") this.write("multipliers", "–");
      }
    }
  }

  /** The attractors of the picture, before the gaits are known. */
  showAttractors(attractors) {
    if (this.exact.gaits) return;
    const real = attractors.filter((one) => !one.artefact);
    const { words } = this.state;
    if (!real.length) return this.write("gait", words.none);
    const [first] = real;
    this.write("gait", first.period ? this.where(first) : words.aperiodic, false);
  }

  /** The period of a gait, and where it is: of a walker's, the angle of its leg. */
  where({ period, states }) {
    const { section, coordinates, film } = this.state.kind;
    const told = section.slice(0, film ? 1 : 3).map((name, k) => `${coordinates[name].symbol} ${number(states[0][k], 5)}`);
    return `period ${period}, ${told.join(", ")}${section.length > 3 ? ", …" : ""}`;
  }

  showGaits(gaits) {
    this.gaits = gaits;
    this.dispatchEvent(new Event("gaits"));
    const stable = gaits.filter((one) => one.stable);
    const others = gaits.length - stable.length;
    const first = stable[0] ?? gaits[0];
    if (!first) {
      this.write("multipliers", "–");
      return this.write("gait", "none of period 1 or 2");
    }
    const kind = first.stable ? "stable" : "unstable";
    const more = others && first.stable ? `; ${count(others, "unstable one")}` : "";
    this.write("gait", `${kind}, ${this.where(first)}${more}`);
    this.write("multipliers", `${multipliers(first)}; |λ| = ${number(Math.hypot(...first.multipliers[0]), 4)}`);
  }

  showArea(found) {
    this.write("area", withError(found.area, found.error) + this.share(found.area));
  }

  /** The part of the view that an area is; of a walker it is not told. */
  share(size) {
    return this.state.kind.film ? "" : `; ${number((100 * size) / this.viewArea, 3)} %`;
  }

  showDisturbance(found) {
    this.disturbance = found;
    if (found) {
      const { words, fates } = this.state;
      const fate = fates[found.failure]?.words ?? words.else;
      this.write("disturbance", `${number(found.size, 5)}: ${fate} after ${count(found.strides, words.stride)}`);
    } else {
      this.write("disturbance", `no stable ${this.state.words.gait} of period 1`);
    }
    this.rough = null;
    this.dispatchEvent(new Event("disturbance"));
  }

  /** Estimates from the picture's cells, of what is not known yet. */
  estimate(found, lattice, attractors) {
    if (!found) return;
    const { state } = this;
    if (!this.exact.area) {
      const { first } = state.about.labels;
      const walks = ([, , label]) => label >= first && !attractors[label - first]?.artefact;
      const size = found.all.filter(walks).length * lattice.cellArea(found.level);
      this.write("area", size ? area(size) + this.share(size) : "none", false);
    }
    if (this.exact.disturbance) return;
    this.rough = this.nearestLoss(found, lattice, state, attractors);
    this.write("disturbance", this.rough ? `about ${number(this.rough.size, 2)}` : "being computed…", false);
    this.dispatchEvent(new Event("disturbance"));
  }

  /** The nearest cell to the gait from which a walker is lost, where the picture shows it. */
  nearestLoss(found, lattice, state, attractors) {
    const gait = attractors.find((one) => one.period && !one.artefact)?.states[0];
    if (!gait || state.sliced || state.method !== "direct") return null;
    const seen = state.shown(gait).every((v, k) => Math.abs(lattice.place(k, v) - state.view.centre[k]) < lattice.half(state.view, k));
    if (!seen) return null;
    const scale = 2 ** -found.level, { fates } = state;
    let nearest = { size: Infinity };
    for (const [i, j, label] of found.all) {
      if (!fates[label]?.lost) continue;
      const place = [(i + 0.5) * scale, (j + 0.5) * scale];
      const x = state.onSection(place.map((p, k) => lattice.value(k, p)));
      const size = Math.hypot(...x.map((value, k) => value - gait[k]));
      if (size < nearest.size) nearest = { size, gait, state: x };
    }
    return nearest.gait ? nearest : null;
  }
}
