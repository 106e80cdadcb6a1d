// What the page shows, and the address bar that holds it: a link opens it again.

import { clampView } from "./lattice.js";

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
    this.parameters = {};
    for (const one of this.kind.parameters) {
      const value = Number((this.unknown ? null : given.get(one.name)) ?? NaN);
      this.parameters[one.name] = Number.isFinite(value) ? value : one.default;
    }
    this.section = this.about.sections.includes(given.get("section")) ? given.get("section") : this.about.sections[0];
    this.method = given.get("method") === "cell-map" && !this.sliced ? "cell-map" : "direct";
    this.tab = given.get("tab") === "bifurcation" ? "bifurcation" : "basin";
    this.at = {};
    for (const name of this.kind.section.slice(2)) {
      const value = Number(given.get(`at_${name}`) ?? NaN);
      if (Number.isFinite(value)) this.at[name] = value; // or that of the gait
    }
    const view = (given.get("view") ?? "").split(",").map(Number);
    const whole = view.length === 3 && view.every(Number.isFinite);
    this.view = whole ? clampView(this.about.lattice, { centre: view.slice(0, 2), zoom: view[2] }) : null;
    const start = (given.get("start") ?? "").split(",").map(Number);
    this.start = start.length === this.kind.section.length && start.every(Number.isFinite) ? start : null;
  }

  get kind() {
    return this.about.walkers[this.walker];
  }

  /** Whether the picture is a slice of a section of more coordinates. */
  get sliced() {
    return this.kind.section.length > 2;
  }

  /** The names of the picture's axes. */
  get axes() {
    return ["theta", this.section === "plain" ? "thetadot" : "sum"];
  }

  /** What a request is about. */
  subject() {
    return { walker: this.walker, parameters: this.parameters, section: this.section, at: this.at };
  }

  /** A point of the picture's axes from one of the section, and back. */
  shown(x) {
    return [x[0], this.section === "plain" ? x[1] : x[0] + x[1]];
  }

  onSection([a, b]) {
    return [a, this.section === "plain" ? b : b - a];
  }

  /** Change some of it, and tell those who draw it. */
  change(kind, values) {
    Object.assign(this, values);
    if (kind === "walker") {
      this.parameters = Object.fromEntries(this.kind.parameters.map((one) => [one.name, one.default]));
      Object.assign(this, { at: {}, view: null, start: null });
      if (this.sliced) this.method = "direct";
    }
    if (kind === "section") this.view = null;
    this.tell(kind);
  }

  tell(kind) {
    this.dispatchEvent(new CustomEvent("change", { detail: kind }));
    clearTimeout(this.writing);
    this.writing = setTimeout(() => this.write(), 200);
  }

  write() {
    const shown = new URLSearchParams({ walker: this.walker, ...this.parameters });
    if (this.section !== this.about.sections[0]) shown.set("section", this.section);
    if (this.method !== "direct") shown.set("method", this.method);
    if (this.tab !== "basin") shown.set("tab", this.tab);
    for (const [name, value] of Object.entries(this.at)) shown.set(`at_${name}`, value);
    if (this.view) shown.set("view", [...this.view.centre, this.view.zoom].map((v) => +v.toPrecision(15)).join(","));
    if (this.start) shown.set("start", this.start.join(","));
    this.written = shown.toString();
    history.replaceState(null, "", `#${this.written}`);
  }
}
