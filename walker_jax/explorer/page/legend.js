// The legend: the colours of what the picture shows, and how they fade with the number of strides.

import { FADES, css } from "./palette.js";
import { OUTSIDE } from "./state.js";
import { count, number } from "./words.js";

export class Legend {
  constructor(list, state, palette) {
    Object.assign(this, { list, state, palette });
    this.entries = []; // words and colours: one, or several of a scale
  }

  clear() {
    this.entries = [];
    this.list.replaceChildren();
  }

  /** Show what these cells are of; of those of which nothing is known, how many. */
  show(layer, cells) {
    const { state, palette } = this, { labels } = state.about, { gait, stride, lose } = state.words;
    const counts = new Map(), rows = new Map();
    for (const [, , label] of cells) counts.set(label, (counts.get(label) ?? 0) + 1);
    const order = (label) => (label >= labels.first ? label - 1000 : label === OUTSIDE ? 1000 : label);
    const shown = [...counts.keys()].sort((a, b) => order(a) - order(b));
    for (const label of shown) {
      const key = label >= labels.first + palette.basins.length ? "other attractors" : this.name(label, layer);
      const unknown = label === labels.unmatched || state.fates[label]?.name === "UNDECIDED";
      rows.set(unknown ? `${key}: ${count(counts.get(label), "cell")}` : key, [css(palette.colour(label, layer.attractors))]);
    }
    const basin = shown.find((label) => label >= labels.first && !layer.attractors[label - labels.first]?.artefact);
    const fall = shown.find((label) => state.fates[label]?.lost);
    if (basin !== undefined) rows.set(`${FADES.walks.join(" to ")} ${stride}s to the ${gait}`, palette.scale(basin));
    if (fall !== undefined) rows.set(`${FADES.falls.join(" to ")} ${stride}s until ${lose}`, palette.scale(fall));
    this.entries = [...rows].map(([words, colours]) => ({ words, colours }));
    this.list.replaceChildren(...this.entries.map(item));
  }

  name(label, { attractors }) {
    const { state } = this, { labels } = state.about, { gait, on } = state.words;
    if (label === labels.unmatched) return `${on}, to no known ${gait}`;
    if (label < labels.first) return state.fates[label].words;
    const one = attractors[label - labels.first];
    if (one?.artefact) return "artefacts of cell mapping";
    if (!one?.period) return "basin without a period";
    const alike = attractors.filter(({ period, artefact }) => period === one.period && !artefact);
    const where = alike.length > 1 ? ` at ${state.axes[0].symbol} ${number(state.shown(one.states[0])[0], 3)}` : "";
    return `basin of the ${gait} of period ${one.period}${where}`;
  }
}

function item({ words, colours }) {
  const made = document.createElement("li");
  made.innerHTML = "<i></i><span></span>";
  made.firstChild.classList.toggle("scale", colours.length > 1);
  made.firstChild.style.background = colours.length > 1 ? `linear-gradient(to right, ${colours})` : colours[0];
  made.lastChild.textContent = words;
  return made;
}
