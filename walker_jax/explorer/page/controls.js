// The controls of a walker, or another system, from what the server says of its parameters.

import { spaced, unitBeside } from "./words.js";

export class Controls {
  constructor(form, state) {
    this.form = form;
    this.state = state;
    this.select = form.querySelector("#walker");
    for (const name of Object.keys(state.about.walkers)) {
      this.select.add(new Option(spaced(name.replaceAll("-", " ")), name));
    }
    this.select.addEventListener("change", () => state.change("walker", { walker: this.select.value }));
    for (const kind of ["section", "method"]) {
      form.querySelector(`#${kind}`).addEventListener("change", (event) => state.change(kind, { [kind]: event.target.value }));
    }
    form.addEventListener("submit", (event) => event.preventDefault());
    this.build();
  }

  /** All controls anew, for another walker. */
  build() {
    const { state, form } = this;
    this.select.value = state.walker;
    form.querySelector("#about-walker").textContent = state.kind.about;
    this.sliders = new Map();
    form.querySelector("#parameters").replaceChildren(...state.kind.parameters.map((one) => this.slider(one, {
      title: spaced(one.name),
      value: () => state.parameters[one.name],
      placed: () => state.accepted?.[one.name],
      set: (value) => state.change("parameters", { parameters: { ...state.parameters, [one.name]: value } }),
    })));
    form.querySelector("#section").replaceChildren(...this.planeChoice());
    this.buildSlices();
    const mapped = form.querySelector("#method input[value=cell-map]");
    mapped.disabled = state.sliced;
    mapped.parentElement.title = state.sliced ? "Not for a slice, which walkers leave" : "";
    this.update();
  }

  /** A slider with a number beside it, and room for a sentence about a wrong value.
   *
   * While a number is typed the slider is where the last one was that was accepted, if `placed` tells it.
   */
  slider(one, { title, value, placed, set, digits = 8 }) {
    const row = document.createElement("div");
    row.className = "field";
    const id = `p-${one.name}`;
    row.innerHTML = `<label for="${id}"><span class="name"></span> <span class="unit"></span></label>
      <input type="number" class="typed" step="any" aria-describedby="${id}-error">
      <input type="range" id="${id}" aria-describedby="${id}-error">
      <p class="error" id="${id}-error" role="alert"></p>`;
    const [name, unit, error] = [".name", ".unit", ".error"].map((which) => row.querySelector(which));
    const range = row.querySelector("[type=range]"), typed = row.querySelector("[type=number]");
    name.textContent = title;
    unit.textContent = unitBeside(title, one.unit);
    row.title = [one.meaning, one.bounds].filter(Boolean).join("; ");
    typed.setAttribute("aria-label", [title, unit.textContent].filter(Boolean).join(" "));
    Object.assign(range, { min: one.low, max: one.high, step: one.step });
    range.addEventListener("input", () => set(Number(range.value)));
    typed.addEventListener("input", () => {
      if (Number.isFinite(typed.valueAsNumber)) set(typed.valueAsNumber);
      else fail("A number is needed here");
    });
    const showTyped = () => (typed.value = Number(value().toPrecision(digits)));
    typed.addEventListener("blur", () => (typed.value === "" ? show() : showTyped()));
    const show = () => {
      const typing = document.activeElement === typed;
      const now = (typing ? placed?.() : null) ?? value();
      range.min = Math.min(one.low, now);
      range.max = Math.max(one.high, now);
      range.value = now;
      range.setAttribute("aria-valuetext", `${now} ${one.unit}`.trim());
      if (!typing) showTyped();
      error.textContent = "";
      row.classList.remove("wrong");
    };
    const fail = (reason) => {
      error.textContent = reason;
      row.classList.add("wrong");
    };
    this.sliders.set(one.name, { show, fail });
    return row;
  }

  /** What chooses the plane: a button for each of a walker's, a list of the axes of any other system. */
  planeChoice() {
    const { planes, film, coordinates } = this.state.kind, names = Object.keys(planes);
    if (names.length < 2) return [];
    const make = (tag, properties, ...inside) => {
      const made = Object.assign(document.createElement(tag), properties);
      made.append(...inside);
      return made;
    };
    if (film) {
      const button = (value) => make("label", {}, make("input", { type: "radio", name: "section", value }), ` ${value}`);
      return [make("legend", { textContent: "Section" }), ...names.map(button)];
    }
    const axes = (name) => planes[name].axes.map((axis) => coordinates[axis].symbol).join(", ");
    const list = make("select", { ariaLabel: "Axes" }, ...names.map((name) => new Option(axes(name), name)));
    return [make("legend", { textContent: "Axes" }), list];
  }

  /** The sliders of the coordinates that are fixed in the plane. */
  buildSlices() {
    for (const name of this.sliders.keys()) if (name.startsWith("at_")) this.sliders.delete(name);
    const rows = this.state.plane.others.map((name) => this.sliceSlider(name));
    this.form.querySelector("#slice").replaceChildren(...rows);
  }

  /** The slider of a coordinate of the slice; at the gait unless it is moved. */
  sliceSlider(name) {
    const { state } = this;
    const one = { ...state.kind.coordinates[name], name: `at_${name}`, meaning: "where the slice is" };
    const row = this.slider(one, {
      title: `slice at ${one.symbol}`,
      digits: 5, // of a gait's coordinate, which has them all
      value: () => state.at[name] ?? this.gait?.[name] ?? 0,
      set: (value) => state.change("slice", { at: { ...state.at, [name]: value } }),
    });
    const button = document.createElement("button");
    button.type = "button";
    button.className = "quiet at-gait";
    button.textContent = `at the ${state.words.gait}`;
    button.dataset.name = name;
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      const { [name]: _, ...rest } = state.at;
      state.change("slice", { at: rest });
    });
    row.append(button);
    return row;
  }

  /** Where the gait is, for slices that follow it. */
  setPlane(values) {
    const names = this.state.plane.others;
    this.gait = Object.fromEntries(names.map((name, k) => [name, values[k] ?? 0]));
    for (const name of names) this.sliders.get(`at_${name}`)?.show();
  }

  update() {
    const { state, form } = this;
    for (const { show } of this.sliders.values()) show();
    for (const kind of ["section", "method"]) {
      const chosen = form.querySelector(`#${kind} [value="${state[kind]}"]`);
      if (chosen) chosen.checked = chosen.selected = true; // a button, or a line of a list
    }
    for (const button of form.querySelectorAll(".at-gait")) {
      button.setAttribute("aria-pressed", String(!(button.dataset.name in state.at)));
    }
  }

  /** A sentence beside the slider that is wrong; false if it is none of these. */
  fail(error) {
    const one = this.sliders.get(error.parameter);
    one?.fail(spaced(error.message));
    return Boolean(one);
  }
}
