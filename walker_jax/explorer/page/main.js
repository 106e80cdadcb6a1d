// The page: its parts, and what makes which of them change.

import { Refused, ask, connection, lines } from "./api.js";
import { Compiling } from "./compiling.js";
import { Controls } from "./controls.js";
import { Diagram } from "./diagram.js";
import { Facts } from "./facts.js";
import { Lattice } from "./lattice.js";
import { Legend } from "./legend.js";
import { BasinMap } from "./map.js";
import { Palette } from "./palette.js";
import { Picture } from "./picture.js";
import { Stage } from "./stage.js";
import { State } from "./state.js";
import { TakeAway } from "./takeaway.js";
import { Walk } from "./walk.js";
import { count, decimals, multipliers, spaced } from "./words.js";

const $ = (selector) => document.querySelector(selector);
const PUSHES = { "[": -0.01, "]": 0.01 }; // along the slope, by keys
const PATHS = { walker: { points: 60, joined: 60 }, system: { points: 2000, joined: 8 } }; // the last ones
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
  const diagram = new Diagram($("#diagram"), state, palette);
  const facts = new Facts(document, state);
  const controls = new Controls($(".controls"), state);
  const legend = new Legend($("#legend"), state, palette);
  const compiling = new Compiling($("#view-basin .plot"));
  let lattice = null, homeKey = "", asking = 0, walking = 0; // no lattice while another is awaited
  const loading = new Set(); // the keys of the homes that are awaited
  let prepared = ""; // the walker that picture and facts belong to
  let pointed = null; // the place that the readout tells of

  // ---------------------------------------------------------------- the picture

  const chosenHome = () => `${state.walker} ${state.section}`;

  /** Whether the chosen home is there; false too where an earlier call awaits it, and goes on. */
  async function loadHome() {
    const key = chosenHome();
    if (key === homeKey) {
      if (!state.view) takeView(); // the same walker was chosen again
      return true;
    }
    homeKey = "";
    lattice = null;
    picture.stop();
    const { walker, section } = state;
    if (walker !== prepared) clearFormer();
    compiling.show(walkerName(), { walker, section });
    if (loading.has(key)) return false;
    loading.add(key);
    const home = await ask("/api/home", { walker, section }).finally(() => loading.delete(key));
    if (key !== chosenHome()) return false; // another one by now
    compiling.hide();
    homeKey = key;
    prepared = walker;
    lattice = new Lattice(about.lattice, home);
    map.axes = state.axes.map((one) => one.label);
    takeView();
    return true;
  }

  /** Show the chosen view, or all of the home if none is. */
  function takeView() {
    map.setLattice(lattice, state.view);
    state.view = map.view;
  }

  /** Nothing of the former walker stands under the name of the one that is being prepared. */
  function clearFormer() {
    prepared = "";
    pointed = null;
    map.clear();
    picture.clear();
    facts.clear("");
    legend.clear();
  }

  const showPicture = () => {
    if (!lattice || !map.box) return;
    picture.show(state, lattice, map.view, map.pixels);
  };
  const viewCells = () => lattice.rectangle(map.view, lattice.level(map.view));
  const wantFacts = () => facts.want(viewCells(), lattice.cellArea(lattice.level(map.view)));

  /** The name of the walker, or of another system, in a sentence. */
  function walkerName() {
    const name = state.walker.replaceAll("-", " ");
    return state.kind.walker ? `the ${/walker$/i.test(name) ? name : `${name} walker`}` : name;
  }

  /** That a link names a walker which this server does not have. */
  function tellUnknown() {
    if (!state.unknown) return;
    const { kind } = state.words;
    say(`This server does not know the ${kind} ${state.unknown.slice(0, 60)}: start it with --${kind}. This is ${walkerName()}.`, 12_000);
    state.unknown = "";
  }

  async function update() {
    const key = chosenHome();
    try {
      if (!(await loadHome())) return;
    } catch (error) {
      if (key !== chosenHome()) return; // another one by now
      compiling.hide();
      if (error instanceof Refused && !prepared) facts.clear("–");
      return complain(error);
    }
    tellUnknown();
    stage.ground = state.parameters.slope ?? 0;
    map.shown = (x) => state.shown(x);
    diagram.show();
    showPicture();
    if (picture.layer && !picture.layer.empty) accept(picture.layer.body.parameters);
    if (state.isAccepted() || !map.box) wantFacts(); // or when the picture comes
    showGaits();
    showArrow();
    stage.draw();
  }

  /** That the picture's parameters are such as the walker takes. */
  function accept(parameters) {
    const before = state.isAccepted();
    state.accepted = parameters;
    if (before || !state.isAccepted()) return; // or others are chosen by now
    controls.update();
    wantFacts();
  }

  /** Say once, beside its slider, which value is refused; the picture, and all else, is that of before. */
  function refuse(error) {
    if (!state.isChosen(picture.layer.body.parameters)) return; // another value by now
    clearTimeout(walking);
    if (state.restore()) {
      controls.update();
      facts.mark();
      showArrow();
      stage.draw();
      queueMicrotask(showPicture);
      if (state.tab === "bifurcation") showDiagram();
    } else if (!state.accepted) {
      facts.clear("–");
    }
    complain(error);
  }

  function complain(error) {
    if (error.name === "AbortError" || !(error instanceof Refused)) return;
    if (!controls.fail(error)) say(spaced(error.message));
  }

  picture.addEventListener("failed", ({ detail }) => (detail.parameter in state.parameters ? refuse(detail) : complain(detail)));
  picture.addEventListener("attractors", () => {
    const { attractors, at, body } = picture.layer;
    accept(body.parameters);
    if (!state.start) {
      clearTimeout(walking);
      walking = setTimeout(walkGait, walk.subject ? WALK_REST : 0, picture.layer);
    }
    controls.setPlane(at);
    facts.showAttractors(attractors);
    showLegend();
  });
  picture.addEventListener("changed", tellPlace);
  picture.addEventListener("changed", () => {
    $("#progress").setAttribute("aria-valuenow", Math.round(100 * picture.progress));
    $("#progress i").style.width = `${100 * picture.progress}%`;
    $("#progress").classList.toggle("done", picture.progress >= 1);
  });
  picture.addEventListener("finished", () => {
    if (!lattice) return;
    facts.estimate(picture.cells(map.view), lattice, picture.layer.attractors);
    showLegend();
  });
  /** Ask for what a moved view is missing; what there is has been drawn already. */
  function askForView() {
    asking = 0;
    if (!lattice) return;
    showPicture();
    wantFacts();
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
    const { labels } = about, { gait, stride, on, to } = state.words;
    const many = strides === 255 ? `255 ${stride}s or more` : count(strides, stride);
    if (label === labels.unmatched) return `${on}, ${many} at least`;
    if (label >= labels.first) {
      const one = layer.attractors[label - labels.first];
      if (one?.artefact) return `a cycle of cells, no ${gait}`;
      return `${to} ${one?.period ? `the ${gait} of period ${one.period}` : "an attractor without a period"} in ${many}`;
    }
    return label in state.fates ? state.failure(label, strides, many) : "";
  }

  /** The readout: where the hand points, and what happens from there; grey while the picture is another's. */
  function tellPlace() {
    const found = pointed && lattice && picture.at(pointed);
    let text = "\u00a0";
    if (pointed && lattice) {
      const gait = map.gaitAt(pointed), places = Math.max(4, 4 + Math.ceil(map.view.zoom / 3.3));
      const where = map.values(pointed).map((v, k) => `${state.axes[k].symbol} ${decimals(v, places)}`).join("   ");
      const words = gait ? `${gait.stable ? "stable" : "unstable"} ${state.words.gait} of period ${gait.period}, multipliers ${multipliers(gait)}` : "";
      text = `${where}   ${words || (found ? happens(found) : "")}`;
    }
    if ($("#hover").textContent !== text) $("#hover").textContent = text;
    $("#hover").classList.toggle("pending", Boolean(found) && !picture.isOf(found.layer, state));
  }
  map.addEventListener("hover", ({ detail: place }) => {
    pointed = place;
    $("#hover").setAttribute("aria-live", map.cross ? "polite" : "off"); // of keys, not of a mouse
    tellPlace();
  });

  function showLegend() {
    const found = lattice && picture.cells(map.view);
    if (picture.layer && found) legend.show(picture.layer, found.all);
  }

  /** The picture as it is saved: what draws it, its parameters and its legend. */
  function drawing() {
    const basin = state.tab === "basin";
    if (basin && !lattice) throw new Error("The picture is not there yet");
    const canvas = basin ? map.canvas : $("#diagram"), style = getComputedStyle(canvas);
    const told = (value) => String(Number((value ?? 0).toPrecision(8))).replace("-", "\u2212");
    const value = ({ name, unit }) => `${spaced(name)} ${told(state.parameters[name])} ${unit.replace("^2", "²")}`.trim();
    const fixed = basin ? state.plane.others.map((name, k) => `at ${state.kind.coordinates[name].symbol} ${told(picture.layer?.at[k])}`) : [];
    const parameters = state.kind.parameters.filter(({ name }) => basin || name !== state.over).map(value);
    const title = walkerName().replace(/^the /, ""), { gait } = state.words;
    return {
      draw: (c) => (basin ? map : diagram).drawOn(c),
      width: canvas.clientWidth, height: canvas.clientHeight,
      title: `${title[0].toUpperCase()}${title.slice(1)}: ${basin ? "basin of attraction" : `${gait}s over the ${spaced(state.over)}`}`,
      about: [...parameters, ...fixed, ...(basin && state.method === "cell-map" ? ["by cell mapping"] : []), ...(basin ? [] : diagram.note().split("; "))],
      legend: basin ? legend.entries : [],
      ground: style.getPropertyValue("--page").trim(), ink: style.getPropertyValue("--ink").trim(),
    };
  }

  // ---------------------------------------------------------------- the walk

  async function startWalk(x) {
    clearTimeout(walking);
    state.change("start", { start: x });
    map.path = [state.shown(x)];
    map.redraw();
    await beginWalk(x);
  }

  async function beginWalk(x) {
    await walk.begin(state.subject(), x);
    showPath();
    if (walk.playing) stage.run();
  }

  /**
   * Until a start is chosen the stage shows the gait, and no walker where there is none; it stands
   * still where motion is to be reduced.
   */
  async function walkGait({ attractors, body }) {
    if (state.start || !state.kind.film || !state.isChosen(body.parameters)) return;
    if (state.isChosen(walk.subject?.parameters)) return; // it is shown already
    const gait = attractors.find((one) => one.period && !one.artefact);
    if (!gait) return clearWalk();
    await beginWalk(gait.states[0]);
    if (!state.start && matchMedia("(prefers-reduced-motion: reduce)").matches) walk.toggle();
  }

  function clearWalk() {
    map.path = [];
    walk.clear();
    walk.tell();
  }

  function showPath() {
    const shown = walk.strides.filter((one) => one.begins <= walk.time && one.start.length === state.kind.section.length);
    if (shown.length) map.path = shown.slice(-PATHS[state.words.kind].points).map((one) => state.shown(one.start));
    map.joined = PATHS[state.words.kind].joined;
    map.redraw();
  }

  map.addEventListener("start", ({ detail }) => {
    if (!lattice) return;
    startWalk(state.onSection(detail, controls.gait));
  });
  walk.addEventListener("stride", showPath);
  walk.addEventListener("changed", () => {
    const none = !walk.strides.length;
    for (const id of ["#play", "#step", "#again"]) $(id).disabled = none;
    $("#play").toggleAttribute("data-playing", walk.playing);
    $("#play").setAttribute("aria-label", walk.playing ? "Pause" : "Play");
    $("#stage-hint").hidden = Boolean(state.start);
    showPath();
    if (walk.playing) stage.run();
  });
  walk.addEventListener("failed", ({ detail }) => complain(detail));
  const tellWalk = () => {
    const one = walk.current;
    if (!one) return ($("#walk-note").textContent = state.kind.film ? "\u00a0" : "Click a start on the picture");
    const ended = walk.over && walk.time >= walk.strides.at(-1).ends;
    const stride = `${state.words.stride} ${one.number + 1}`;
    const text = ended ? state.failure(one.outcome, one.number) : state.start ? stride : `the ${state.words.gait}, ${stride}`;
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
      if (!state.over) return; // the other tab is not shown
      state.change("tab", { tab: tabs[1 - k] });
      $(`#tab-${tabs[1 - k]}`).focus();
    });
  }

  let diagramKey = "", diagramAbort = null;
  async function showDiagram() {
    const { over, words } = state, { [over]: _, ...others } = state.parameters;
    const key = JSON.stringify([state.walker, over, others]);
    diagram.show();
    if (key === diagramKey) return;
    diagramAbort?.abort();
    diagramAbort = new AbortController();
    diagramKey = key;
    diagram.setData(null);
    $("#diagram-note").textContent = `${words.followed}…`;
    const body = { walker: state.walker, parameters: { ...others, [over]: diagram.over.default }, over };
    try {
      for await (const found of lines("/api/measure/bifurcation", body, diagramAbort.signal)) {
        diagram.setData(found);
        diagram.show();
        $("#diagram-note").textContent = found.whole ? diagram.note() : `${words.followed}: ${count(found.branches.length, "branch", "branches")} so far…`;
      }
    } catch (error) {
      if (error.name === "AbortError") return;
      diagramKey = "";
      $("#diagram-note").textContent = error instanceof Refused ? error.message : "";
    }
  }
  diagram.addEventListener("value", ({ detail }) => {
    state.change("parameters", { parameters: { ...state.parameters, [state.over]: detail } });
  });
  $("#over").addEventListener("change", (event) => state.change("over", { over: event.target.value }));

  /** What the page shows of walkers alone, or of other systems alone. */
  function showKind() {
    const spans = Object.keys(state.kind.spans), { stride } = state.words;
    document.body.toggleAttribute("data-film", state.kind.film);
    document.body.toggleAttribute("data-walker", state.kind.walker);
    for (const name of ["aria-label", "title"]) $("#step").setAttribute(name, `One ${stride}`);
    $("#tab-bifurcation").hidden = !spans.length;
    $("#over").replaceChildren(...spans.map((name) => new Option(spaced(name), name, false, name === state.over)));
    $("#over").parentElement.hidden = spans.length < 2;
  }

  new TakeAway(document, {
    wanted: () => {
      if (!lattice) throw new Error("The picture is not there yet");
      return { ...state.subject(), method: state.method, cells: viewCells() };
    },
    drawing,
    say,
    title: () => `${state.tab}-${state.walker}-${Number((Object.values(state.parameters)[0] ?? 0).toPrecision(6))}`,
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
    if (kind === "tab" || kind === "over") return showTab();
    if (kind === "walker" || kind === "everything") {
      clearTimeout(walking);
      controls.build();
      showKind();
      showTab();
      clearWalk();
    }
    if (kind === "everything") {
      if (lattice) map.view = state.view ??= lattice.whole();
    }
    if (kind === "section") {
      controls.buildSlices();
      map.path = [];
    }
    if (kind !== "method") {
      map.arrow = null;
      facts.rough = null;
    }
    facts.mark();
    tellPlace();
    controls.update();
    update();
    if (kind === "everything" && state.start) startWalk(state.start);
    if (kind === "parameters" && state.start && walk.subject) {
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
  showKind();
  showTab();
  tellWalk();
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
