// What the page shows, and the address bar that holds it: a link opens it again.

import { clampView } from "./lattice.js";
import { SYSTEM, WALKER, count } from "./words.js";

export const OUTSIDE = 5; // the outcome of a start that is not feasible

export class State extends EventTarget {
  constructor(about) {
    super();
    this.about = about;
    this.read();
    addEventListener("hashchange", () => {
      if (location.hash.slice(1) === this.written) return;
      this.read();
      this.tell("everything");
    });
  }

  /** Take over what the address says, as far as there is such a thing. */
  read() {
    const given = new URLSearchParams(location.hash.slice(1));
    const names = Object.keys(this.about.walkers);
    const asked = given.get("walker") ?? names[0];
    this.unknown = names.includes(asked) ? "" : asked; // a walker of another server's
    this.walker = this.unknown ? names[0] : asked;
    this.accepted = null; // parameters of the last picture of this walker
    this.parameters = {};
    for (const one of this.kind.parameters) {
      const value = Number((this.unknown ? null : given.get(one.name)) ?? NaN);
      this.parameters[one.name] = Number.isFinite(value) ? value : one.default;
    }
    Object.assign(this, { section: given.get("section"), over: given.get("over") });
    this.choose();
    this.method = given.get("method") === "cell-map" && !this.sliced ? "cell-map" : "direct";
    this.tab = given.get("tab") === "bifurcation" && this.over ? "bifurcation" : "basin";
    this.at = {};
    for (const name of this.plane.others) {
      const value = Number(given.get(`at_${name}`) ?? NaN);
      if (Number.isFinite(value)) this.at[name] = value; // or that of the gait
    }
    const view = (given.get("view") ?? "").split(",").map(Number);
    const whole = view.length === 3 && view.every(Number.isFinite);
    this.view = whole ? clampView(this.about.lattice, { centre: view.slice(0, 2), zoom: view[2] }) : null;
    const start = (given.get("start") ?? "").split(",").map(Number);
    this.start = start.length === this.kind.section.length && start.every(Number.isFinite) ? start : null;
  }

  /** The first plane and the first parameter to follow gaits over, where what is asked for is none of its own. */
  choose() {
    const { planes, spans } = this.kind;
    if (!Object.hasOwn(planes, this.section)) [this.section] = Object.keys(planes);
    if (!Object.hasOwn(spans, this.over)) [this.over] = Object.keys(spans);
  }

  get kind() {
    return this.about.walkers[this.walker];
  }

  /** The words for it. */
  get words() {
    return this.kind.walker ? WALKER : SYSTEM;
  }

  /** How it may fail, by outcome: the failures that all share, and its own. */
  get fates() {
    return { ...this.about.fates, ...this.kind.fates };
  }

  /** How it fails, in words, after so many strides. */
  failure(outcome, strides, many = count(strides, this.words.stride)) {
    const { words } = outcome === OUTSIDE && !strides ? this.about.fates[outcome] : this.fates[outcome];
    return strides ? `${words} after ${many}` : words;
  }

  /** Whether the picture is a slice of a section of more coordinates. */
  get sliced() {
    return this.kind.section.length > 2;
  }

  /** The axes of the picture, and the coordinates that are fixed in it. */
  get plane() {
    return this.kind.planes[this.section];
  }

  /** What there is to say of these axes. */
  get axes() {
    return this.plane.axes.map((name) => this.kind.coordinates[name]);
  }

  /** What a request is about. */
  subject() {
    return { walker: this.walker, parameters: this.parameters, section: this.section, at: this.at };
  }

  /** A point of the picture's axes from one of the section, and back. */
  shown(x) {
    const { section } = this.kind;
    return this.plane.axes.map((name) => (section.includes(name) ? x[section.indexOf(name)] : x[0] + x[1])); // of a sum
  }

  onSection(pair, gait = {}) {
    const { axes, others } = this.plane;
    return this.kind.section.map((name) => {
      if (axes.includes(name)) return pair[axes.indexOf(name)];
      return others.includes(name) ? this.at[name] ?? gait[name] ?? 0 : pair[1] - pair[0];
    });
  }

  /** Change some of it, and tell those who draw it. */
  change(kind, values) {
    Object.assign(this, values);
    if (kind === "walker") {
      this.parameters = Object.fromEntries(this.kind.parameters.map((one) => [one.name, one.default]));
      Object.assign(this, { accepted: null, at: {}, view: null, start: null });
      if (this.sliced) this.method = "direct";
      this.choose();
      if (!this.over) this.tab = "basin";
    }
    if (kind === "section") {
      const kept = Object.entries(this.at).filter(([name]) => this.plane.others.includes(name));
      Object.assign(this, { view: null, at: Object.fromEntries(kept) });
    }
    this.tell(kind);
  }

  /** Whether these parameters are the ones that are chosen. */
  isChosen(parameters) {
    return JSON.stringify(parameters) === JSON.stringify(this.parameters);
  }

  /** Whether those that are chosen are known to be such as the walker takes. */
  isAccepted() {
    return this.isChosen(this.accepted);
  }

  /** Back to the parameters that were accepted last; false where none were, or they are chosen. */
  restore() {
    if (!this.accepted || this.isAccepted()) return false;
    this.parameters = this.accepted;
    this.writeSoon();
    return true;
  }

  tell(kind) {
    this.dispatchEvent(new CustomEvent("change", { detail: kind }));
    this.writeSoon();
  }

  writeSoon() {
    clearTimeout(this.writing);
    this.writing = setTimeout(() => this.write(), 200);
  }

  write() {
    const shown = new URLSearchParams({ walker: this.walker, ...this.parameters });
    if (this.section !== Object.keys(this.kind.planes)[0]) shown.set("section", this.section);
    if (this.method !== "direct") shown.set("method", this.method);
    if (this.tab !== "basin") shown.set("tab", this.tab);
    if (this.over !== Object.keys(this.kind.spans)[0]) shown.set("over", this.over);
    for (const [name, value] of Object.entries(this.at)) shown.set(`at_${name}`, value);
    if (this.view) shown.set("view", [...this.view.centre, this.view.zoom].map((v) => +v.toPrecision(15)).join(","));
    if (this.start) shown.set("start", this.start.join(","));
    this.written = shown.toString();
    history.replaceState(null, "", `#${this.written}`);
  }
}
