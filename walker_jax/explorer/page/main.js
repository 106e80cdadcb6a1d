// The page: its parts, and what makes which of them change.

import { Refused, ask, connection } from "./api.js";
import { Controls } from "./controls.js";
import { Diagram } from "./diagram.js";
import { Facts } from "./facts.js";
import { Lattice } from "./lattice.js";
import { BasinMap } from "./map.js";
import { Palette, css } from "./palette.js";
import { Picture } from "./picture.js";
import { Stage } from "./stage.js";
import { State } from "./state.js";
import { TakeAway } from "./takeaway.js";
import { Walk } from "./walk.js";
import { SYMBOLS, count, decimals, multipliers, spaced } from "./words.js";

const $ = (selector) => document.querySelector(selector);
const OUTSIDE = 5; // the outcome of a start that is not feasible
const PUSHES = { "[": -0.01, "]": 0.01 }; // along the slope, by keys
const WALK_REST = 300; // ms without a change of parameters, after which the walk begins anew
const MOVED_REST = 50; // ms between two requests while the view moves
const MAPPED_REST = 160; // ms without a change of view, after which cells are mapped anew

async function begin() {
  const about = await ask("/api/about");
  const state = new State(about);
  const palette = new Palette(about);
  const picture = new Picture(palette);
  const map = new BasinMap($("#map"), picture, palette);
  const walk = new Walk();
  const stage = new Stage($("#stage"), walk, palette);
  const diagram = new Diagram($("#diagram"), palette);
  const facts = new Facts(document, about);
  const controls = new Controls($(".controls"), state);
  let lattice = null, homeKey = "", asking = 0, walking = 0; // no lattice while another is awaited
  let prepared = ""; // the walker that picture and facts belong to

  // ---------------------------------------------------------------- the picture

  async function loadHome() {
    const key = `${state.walker} ${state.section}`;
    if (key === homeKey) return true;
    homeKey = "";
    lattice = null;
    picture.stop();
    say(`Preparing the ${walkerName()}`, Infinity);
    const { walker, section } = state;
    if (walker !== prepared) clearFormer();
    const home = await ask("/api/home", { walker, section });
    if (key !== `${state.walker} ${state.section}`) return false; // another one by now
    say("");
    homeKey = key;
    prepared = walker;
    lattice = new Lattice(about.lattice, home);
    map.axes = state.axes;
    map.setLattice(lattice, state.view);
    state.view = map.view;
    return true;
  }

  /** Nothing of the former walker stands under the name of the one that is being prepared. */
  function clearFormer() {
    prepared = "";
    picture.clear();
    facts.clear("preparing…");
    $("#legend").replaceChildren();
    $("#hover").textContent = "\u00a0";
  }

  const showPicture = () => {
    if (!lattice || !map.box) return;
    picture.show(state, lattice, map.view, map.pixels);
  };
  const viewCells = () => lattice.rectangle(map.view, lattice.level(map.view));

  /** The walker's name in a sentence. */
  function walkerName() {
    const name = state.walker.replaceAll("-", " ");
    return /walker$/i.test(name) ? name : `${name} walker`;
  }

  /** That a link names a walker which this server does not have. */
  function tellUnknown() {
    if (!state.unknown) return;
    say(`This server does not know the walker ${state.unknown.slice(0, 60)}: start it with --walker. This is the ${walkerName()}.`, 12_000);
    state.unknown = "";
  }

  async function update() {
    try {
      if (!(await loadHome())) return;
    } catch (error) {
      if (error instanceof Refused && !prepared) facts.clear("–");
      return complain(error);
    }
    tellUnknown();
    stage.ground = state.parameters.slope ?? 0;
    map.shown = (x) => state.shown(x);
    diagram.setSlope(state.parameters.slope ?? 0);
    showPicture();
    facts.want(state, viewCells());
    showGaits();
    showArrow();
    stage.draw();
  }

  function complain(error) {
    if (error.name === "AbortError" || !(error instanceof Refused)) return;
    if (!controls.fail(error)) say(spaced(error.message));
  }

  picture.addEventListener("failed", ({ detail }) => complain(detail));
  picture.addEventListener("attractors", () => {
    const { attractors, at } = picture.layer;
    controls.setPlane(at);
    facts.showAttractors(attractors);
    showLegend();
  });
  picture.addEventListener("changed", () => {
    $("#progress").setAttribute("aria-valuenow", Math.round(100 * picture.progress));
    $("#progress i").style.width = `${100 * picture.progress}%`;
    $("#progress").classList.toggle("done", picture.progress >= 1);
  });
  picture.addEventListener("finished", () => {
    if (!lattice) return;
    facts.estimate(picture.cells(map.view), lattice, state, picture.layer.attractors);
    showLegend();
  });
  /** Ask for what a moved view is missing; what there is has been drawn already. */
  function askForView() {
    asking = 0;
    if (!lattice) return;
    showPicture();
    facts.want(state, viewCells());
  }
  map.addEventListener("moved", () => {
    if (!lattice) return;
    state.change("view", { view: map.view });
    if (state.method === "cell-map") {
      clearTimeout(asking);
      asking = setTimeout(askForView, MAPPED_REST);
    } else {
      asking ||= setTimeout(askForView, MOVED_REST);
    }
  });

  // ---------------------------------------------------------------- marks and words

  function showGaits() {
    map.gaits = facts.gaits.map((one) => ({ ...one, shown: one.states.map((x) => state.shown(x)) }));
    map.redraw();
  }
  function showArrow() {
    const found = facts.disturbance ?? facts.rough;
    map.arrow = found && { from: state.shown(found.gait), to: state.shown(found.state), exact: Boolean(facts.disturbance) };
    map.redraw();
  }
  facts.addEventListener("gaits", showGaits);
  facts.addEventListener("disturbance", showArrow);

  /** What happens from a place, in words. */
  function happens({ label, strides, layer }) {
    const { labels, fates } = about;
    const many = strides === 255 ? "255 strides or more" : count(strides, "stride");
    if (label === labels.unmatched) return `walks on, ${many} at least`;
    if (label >= labels.first) {
      const one = layer.attractors[label - labels.first];
      if (one?.artefact) return "a cycle of cells, no gait";
      return `walks: at ${one?.period ? `the gait of period ${one.period}` : "an attractor without a period"} in ${many}`;
    }
    const words = fates[label]?.words ?? "";
    return strides && label !== OUTSIDE ? `${words} after ${many}` : words;
  }

  map.addEventListener("hover", ({ detail: place }) => {
    if (!place || !lattice) return ($("#hover").textContent = "\u00a0");
    $("#hover").setAttribute("aria-live", map.cross ? "polite" : "off"); // of keys, not of a mouse
    const gait = map.gaitAt(place);
    const found = picture.at(place), places = Math.max(4, 4 + Math.ceil(map.view.zoom / 3.3));
    const where = map.values(place).map((v, k) => `${SYMBOLS[state.axes[k]]} ${decimals(v, places)}`).join("   ");
    const words = gait ? `${gait.stable ? "stable" : "unstable"} gait of period ${gait.period}, multipliers ${multipliers(gait)}` : "";
    $("#hover").textContent = `${where}   ${words || (found ? happens(found) : "")}`;
  });

  function showLegend() {
    const layer = picture.layer, found = lattice && picture.cells(map.view);
    if (!layer || !found) return;
    const counts = new Map();
    for (const [, , label] of found.all) counts.set(label, (counts.get(label) ?? 0) + 1);
    const name = (label) => {
      if (label === about.labels.unmatched) return "walks on, to no known gait";
      if (label < about.labels.first) return about.fates[label].words;
      const one = layer.attractors[label - about.labels.first];
      return one?.artefact ? "artefacts of cell mapping" : one?.period ? `basin of the gait of period ${one.period}` : "basin without a period";
    };
    const rows = new Map();
    const order = (label) => (label >= about.labels.first ? label - 1000 : label === OUTSIDE ? 1000 : label);
    for (const label of [...counts.keys()].sort((a, b) => order(a) - order(b))) {
      const colour = css(palette.colour(label, layer.attractors));
      const key = label >= about.labels.first + palette.basins.length ? "other attractors" : name(label);
      const unknown = label === about.labels.unmatched || about.fates[label]?.name === "UNDECIDED";
      rows.set(unknown ? `${key}: ${count(counts.get(label), "cell")}` : key, colour);
    }
    $("#legend").replaceChildren(...[...rows].map(([words, colour]) => {
      const item = document.createElement("li");
      item.innerHTML = "<i></i><span></span>";
      item.firstChild.style.background = colour;
      item.lastChild.textContent = words;
      return item;
    }));
  }

  // ---------------------------------------------------------------- the walk

  async function startWalk(x) {
    clearTimeout(walking);
    state.change("start", { start: x });
    map.path = [state.shown(x)];
    map.redraw();
    await walk.begin(state.subject(), x);
    showPath();
    if (walk.playing) stage.run();
  }

  function showPath() {
    const shown = walk.strides.filter((one) => one.begins <= walk.time && one.start.length === state.kind.section.length);
    if (shown.length) map.path = shown.slice(-60).map((one) => state.shown(one.start));
    map.redraw();
  }

  map.addEventListener("start", ({ detail }) => {
    if (!lattice) return;
    const x = state.onSection(detail);
    startWalk([...x, ...state.kind.section.slice(2).map((name) => state.at[name] ?? controls.gait?.[name] ?? 0)]);
  });
  walk.addEventListener("stride", showPath);
  walk.addEventListener("changed", () => {
    const none = !walk.strides.length;
    for (const id of ["#play", "#step", "#again"]) $(id).disabled = none;
    $("#play").toggleAttribute("data-playing", walk.playing);
    $("#play").setAttribute("aria-label", walk.playing ? "Pause" : "Play");
    $("#stage-hint").hidden = !none;
    showPath();
    if (walk.playing) stage.run();
  });
  walk.addEventListener("failed", ({ detail }) => complain(detail));
  const tellWalk = () => {
    const one = walk.current;
    if (!one) return ($("#walk-note").textContent = "\u00a0");
    const ended = walk.over && walk.time >= walk.strides.at(-1).ends;
    const fate = about.fates[one.outcome]?.words;
    const text = ended ? (one.number ? `${fate} after ${count(one.number, "stride")}` : fate) : `stride ${one.number + 1}`;
    if ($("#walk-note").textContent !== text) $("#walk-note").textContent = text;
  };
  for (const event of ["changed", "stride"]) walk.addEventListener(event, tellWalk);

  $("#play").addEventListener("click", () => walk.toggle());
  $("#step").addEventListener("click", () => walk.stepOn());
  $("#again").addEventListener("click", () => walk.again());
  $("#speed").addEventListener("change", (event) => (walk.speed = Number(event.target.value)));
  addEventListener("keydown", (event) => {
    const command = event.metaKey || (event.ctrlKey && !event.altKey); // brackets are typed by Alt or AltGr on many keyboards
    if (event.target.matches("input, select, button, summary") || command) return;
    if (event.key in PUSHES) walk.push([PUSHES[event.key], 0]);
    else if (event.altKey) return;
    else if (event.key === " ") walk.toggle();
    else if (event.key === ".") walk.stepOn();
    else return;
    event.preventDefault();
  });

  // ---------------------------------------------------------------- zoom, tabs, theme, take away

  $("#zoom-in").addEventListener("click", () => lattice && map.zoomBy(1));
  $("#zoom-out").addEventListener("click", () => lattice && map.zoomBy(-1));
  $("#zoom-home").addEventListener("click", () => lattice && map.setView(lattice.whole()));

  const tabs = ["basin", "bifurcation"];
  function showTab() {
    for (const name of tabs) {
      const chosen = state.tab === name;
      $(`#tab-${name}`).setAttribute("aria-selected", String(chosen));
      $(`#tab-${name}`).tabIndex = chosen ? 0 : -1;
      $(`#view-${name}`).hidden = !chosen;
    }
    if (state.tab === "bifurcation") showDiagram();
  }
  for (const [k, name] of tabs.entries()) {
    $(`#tab-${name}`).addEventListener("click", () => state.change("tab", { tab: name }));
    $(`#tab-${name}`).addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      state.change("tab", { tab: tabs[1 - k] });
      $(`#tab-${tabs[1 - k]}`).focus();
    });
  }

  let diagramKey = "", diagramAbort = null;
  async function showDiagram() {
    const { slope: _, ...others } = state.parameters;
    const key = JSON.stringify([state.walker, others]);
    if (key === diagramKey) return diagram.draw();
    diagramAbort?.abort();
    diagramAbort = new AbortController();
    diagramKey = key;
    diagram.setData(null);
    $("#diagram-note").textContent = "The gaits are followed over the slope: some ten seconds…";
    const slope = about.walkers[state.walker].parameters.find((one) => one.name === "slope")?.default;
    const body = { walker: state.walker, parameters: { ...others, slope } };
    try {
      diagram.setData(await ask("/api/measure/bifurcation", body, diagramAbort.signal));
      $("#diagram-note").textContent = diagram.note();
    } catch (error) {
      if (error.name === "AbortError") return;
      diagramKey = "";
      $("#diagram-note").textContent = error instanceof Refused ? error.message : "";
    }
  }
  diagram.addEventListener("slope", ({ detail }) => {
    state.change("parameters", { parameters: { ...state.parameters, slope: detail } });
  });

  new TakeAway(document, {
    wanted: () => {
      if (!lattice) throw new Error("The picture is not there yet");
      return { ...state.subject(), method: state.method, cells: viewCells() };
    },
    canvas: () => {
      if (state.tab !== "basin") return $("#diagram");
      if (!lattice) throw new Error("The picture is not there yet");
      return $("#map");
    },
    say,
    title: () => `${state.tab}-${state.walker}-${Number((state.parameters.slope ?? 0).toPrecision(6))}`,
  });

  const prefers = matchMedia("(prefers-color-scheme: dark)");
  let theme = remembered("theme");
  const chosen = () => theme ?? (prefers.matches ? "dark" : "light");
  function showTheme() {
    document.documentElement.dataset.theme = chosen();
    $("#theme").setAttribute("aria-pressed", String(chosen() === "dark"));
    palette.use(chosen() === "dark");
    picture.changed();
    diagram.draw();
    stage.draw();
    showLegend();
  }
  prefers.addEventListener("change", showTheme);
  $("#theme").addEventListener("click", () => {
    theme = chosen() === "dark" ? "light" : "dark";
    remember("theme", theme);
    showTheme();
  });

  // ---------------------------------------------------------------- changes of state

  state.addEventListener("change", ({ detail: kind }) => {
    if (kind === "view" || kind === "start") return;
    if (kind === "tab") return showTab();
    if (kind === "walker" || kind === "everything") {
      clearTimeout(walking);
      controls.build();
      walk.clear();
      walk.tell();
      map.path = [];
    }
    if (kind === "everything") {
      showTab();
      if (lattice) map.view = state.view ??= lattice.whole();
    }
    if (kind === "section") map.path = [];
    if (kind !== "method") {
      map.arrow = null;
      facts.rough = null;
    }
    controls.update();
    update();
    if (kind === "everything" && state.start) startWalk(state.start);
    if (kind === "parameters" && walk.subject) {
      clearTimeout(walking);
      walking = setTimeout(() => startWalk(state.start), WALK_REST);
    }
    if (state.tab === "bifurcation") showDiagram();
  });
  connection.addEventListener("back", () => {
    $("#gone").hidden = true;
    homeKey = "";
    update();
    showTab();
  });

  // for the curious, and for tests
  window.explorer = { state, picture, map, walk, stage, facts, palette, get lattice() { return lattice; } };

  showTheme();
  showTab();
  await update();
  if (state.start) await startWalk(state.start);
}

/** What the browser remembers of an earlier visit: nothing in a frame in which it may not. */
function remembered(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

function remember(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {} // for this visit, then
}

let saying = 0;
/** A short message, which goes by itself after so many ms. */
function say(text, rest = 3500) {
  $("#toast").textContent = text;
  $("#toast").classList.toggle("shown", Boolean(text));
  clearTimeout(saying);
  if (rest < Infinity) saying = setTimeout(() => $("#toast").classList.remove("shown"), rest);
}

function sayGone(text) {
  $("#gone").textContent = text;
  $("#gone").hidden = false;
}

connection.addEventListener("gone", () => sayGone("The server does not answer. This page waits for it, and goes on by itself."));
connection.addEventListener("other", () => sayGone("The server was started anew: open the link that it printed."));

begin().catch((error) => {
  if (error instanceof Refused) return sayGone(error.message);
  connection.addEventListener("back", () => location.reload());
  if (!(error instanceof TypeError)) throw error;
});
