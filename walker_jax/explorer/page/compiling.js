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
    const text = `Compiling ${name}`, { seconds } = found, began = performance.now();
    this.note.textContent = seconds === null ? text : `${text}, about ${Math.ceil(seconds)} s the first time`;
    this.note.style.setProperty("--seconds", `${seconds ?? 30}s`);
    clearInterval(this.timer);
    this.timer = setInterval(() => { // a machine may be slower, or busy
      const taken = (performance.now() - began) / 1000;
      if (taken > seconds) this.note.textContent = `${text}: ${Math.floor(taken)} s, longer than usual`;
    }, 1000);
  }

  hide() {
    this.shown = null;
    clearInterval(this.timer);
    this.plot.classList.remove("covered");
    this.note.textContent = "";
  }
}
