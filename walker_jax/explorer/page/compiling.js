// The note over the map while the programs of another walker are compiled.

import { ask } from "./api.js";

export class Compiling {
  constructor(plot) {
    this.plot = plot;
    this.note = plot.querySelector("#compiling");
    this.shown = null; // what is compiled
  }

  /** Grey the map, and say what is compiled, and for about how long. */
  async show(name, subject) {
    const shown = JSON.stringify(subject);
    if (this.shown === shown) return; // it is said already
    this.shown = shown;
    this.plot.classList.add("covered");
    this.note.textContent = "";
    const found = await ask("/api/compiling", subject).catch(() => null); // home fails too, and says why
    if (this.shown !== shown || !found || found.seconds === 0) return;
    const text = `Compiling ${name}`;
    this.note.textContent = found.seconds === null ? text : `${text}, about ${Math.ceil(found.seconds)} s the first time`;
    this.note.style.setProperty("--seconds", `${found.seconds ?? 30}s`);
  }

  hide() {
    this.shown = null;
    this.plot.classList.remove("covered");
    this.note.textContent = "";
  }
}
