// The facts beside the walker: gait, multipliers, area and least disturbance, as they come in.
//
// From the picture itself come estimates at once; the server's exact values follow once the hand rests.

import { Refused, ask } from "./api.js";
import { count, multiplier, number, power, withError } from "./words.js";

const REST = 450; // ms without a change, after which the exact values are asked for

export class Facts extends EventTarget {
  constructor(root, about) {
    super();
    this.about = about;
    this.shown = Object.fromEntries(
      ["gait", "multipliers", "area", "disturbance"].map((name) => [name, root.querySelector(`#fact-${name}`)]),
    );
    this.keys = {};
    this.aborts = {};
    this.gaits = [];
  }

  write(name, text, exact = true) {
    this.shown[name].textContent = text;
    this.shown[name].classList.toggle("pending", !exact);
  }

  /** Ask for what has changed, once nothing changes any more. */
  want(state, cells) {
    const { walker, parameters } = state;
    const about = JSON.stringify([walker, parameters]);
    if (this.keys.about !== about) {
      this.keys.about = about;
      this.gaits = [];
      this.disturbance = null;
      for (const name of ["gaits", "disturbance"]) this.aborts[name]?.abort();
      this.write("multipliers", "…", false);
      this.dispatchEvent(new Event("gaits"));
    }
    this.aborts.area?.abort();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.request(structuredClone(state.subject()), cells), REST);
  }

  async request(subject, cells) {
    const body = { ...subject, section: "sheared", at: {} }; // of the walker alone
    if (!this.gaits.length) {
      this.measure("gaits", body, (gaits) => {
        this.gaits = gaits;
        this.showGaits();
        this.dispatchEvent(new Event("gaits"));
      });
    }
    this.measure("area", { ...subject, cells }, ({ area, error }) => this.write("area", withError(area, error)));
    if (!this.disturbance) {
      this.measure("disturbance", body, (found) => {
        this.disturbance = found;
        const fate = this.about.fates[found.failure]?.words ?? "walks to another gait";
        this.write("disturbance", `${number(found.size, 5)}: ${fate} after ${count(found.strides, "stride")}`);
        this.dispatchEvent(new Event("disturbance"));
      });
    }
  }

  async measure(kind, body, use) {
    this.aborts[kind]?.abort();
    const abort = (this.aborts[kind] = new AbortController());
    try {
      const found = await ask(`/api/measure/${kind}`, body, abort.signal);
      if (!abort.signal.aborted) use(found);
    } catch (error) {
      if (!(error instanceof Refused)) return; // given up, or the server is gone: said elsewhere
      if (kind === "gaits") this.write("gait", "none found");
      if (kind === "disturbance") this.write("disturbance", "no stable gait");
      if (kind === "area") this.write("area", "–");
    }
  }

  /** The attractors of the picture, before the gaits are known. */
  showAttractors(attractors) {
    if (this.gaits.length) return;
    const real = attractors.filter((one) => !one.artefact);
    if (!real.length) return this.write("gait", "no walk goes on");
    const [first] = real;
    this.write("gait", first.period ? `period ${first.period}, θ ${number(first.states[0][0], 5)}` : "walks without a period", false);
  }

  showGaits() {
    const stable = this.gaits.filter((one) => one.stable);
    const others = this.gaits.length - stable.length;
    const first = stable[0] ?? this.gaits[0];
    if (!first) return this.write("gait", "none of period 1 or 2");
    const kind = first.stable ? "stable" : "unstable";
    const more = others && first.stable ? `; ${count(others, "unstable one")}` : "";
    this.write("gait", `${kind}, period ${first.period}, θ ${number(first.states[0][0], 5)}${more}`);
    const values = first.multipliers, pairs = values.filter(([, imaginary]) => imaginary >= 0);
    const modulus = Math.hypot(...values[0]);
    this.write("multipliers", `${pairs.map(multiplier).join(", ")}; |λ| = ${number(modulus, 4)}`);
  }

  /** Area, and the nearest cell from which the gait is lost, from the picture's cells. */
  estimate(found, lattice, state, attractors) {
    if (!found) return;
    const first = this.about.labels.unmatched;
    let walking = 0;
    for (const [, , label] of found.all) if (label >= first) walking += 1;
    const area = walking * lattice.cellArea(found.level);
    this.area = area;
    this.write("area", area ? power(area, 3) : "none", false);
    if (this.disturbance) return;
    const gait = attractors.find((one) => one.period && !one.artefact)?.states[0];
    if (!gait || state.sliced) return this.write("disturbance", "…", false);
    const scale = 2 ** -found.level;
    const seen = state.shown(gait).every((v, k) => Math.abs(lattice.place(k, v) - state.view.centre[k]) < lattice.half(state.view, k));
    if (!seen) return this.write("disturbance", "…", false);
    let least = Infinity, nearest = null;
    for (const [i, j, label] of found.all) {
      if (label >= first) continue;
      const place = [(i + 0.5) * scale, (j + 0.5) * scale];
      const x = state.onSection(place.map((p, k) => lattice.value(k, p)));
      const size = Math.hypot(x[0] - gait[0], x[1] - gait[1]);
      if (size < least) [least, nearest] = [size, x];
    }
    if (!nearest) return;
    this.rough = { gait, state: nearest };
    this.write("disturbance", `about ${number(least, 2)}`, false);
    this.dispatchEvent(new Event("disturbance"));
  }
}
