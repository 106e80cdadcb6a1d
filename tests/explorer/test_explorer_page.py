"""The explorer's page in a browser, Debian's Chromium, by Playwright.

Without a browser these tests are skipped, with the reason; where `WALKER_JAX_REQUIRE_BROWSER` is
set, as `.ci/run` does, they fail.
"""

from functools import partial
from itertools import combinations

import explorer_server
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from explorer_page import (
    AREA,
    CELLS,
    GAIT,
    NARROW,
    NO_STORAGE,
    SECONDS,
    WIDE,
    Held,
    area_of,
    fulfil,
    fulfil_as,
)
from parts_of_pictures import lightness
from PIL import Image
from zarr.storage import ZipStore

import walker_jax as wj
from walker_jax.explorer import pictures
from walker_jax.systems.outcomes import OWN

LEAST_CONTRAST = 6.0
"""In lightness between the colours of two fates, as in the figures."""


@pytest.mark.slow
def test_the_basin_follows_the_slope(opened):
    page = opened("walker=simplest&slope=0.004")
    area, cells = area_of(page)
    assert cells == 50_000
    basin = lambda slope: wj.basin(
        wj.SimplestWalker(slope),
        wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250)),
        "direct",
    )
    assert area == pytest.approx(float(basin(0.004)["area"].sum()), rel=1e-12)
    assert area == pytest.approx(AREA, rel=0.01)
    # drag the slider, and let go: the picture is that of the value it has then
    box = page.box("#parameters [type=range]")
    middle = box["y"] + box["height"] / 2
    page.page.mouse.move(box["x"] + 0.21 * box["width"], middle)
    page.page.mouse.down()
    for share in np.linspace(0.22, 0.5, 12):
        page.page.mouse.move(box["x"] + share * box["width"], middle)
    page.page.mouse.up()
    slope = page.value("explorer.state.parameters.slope")
    assert slope > 0.008
    page.wait(f"JSON.parse(explorer.picture.layer.key).parameters.slope === {slope}")
    page.finished()
    assert area_of(page)[0] == pytest.approx(float(basin(slope)["area"].sum()), rel=1e-12)
    page.wait("location.hash.includes('slope=' + explorer.state.parameters.slope)")
    # what it says, and a wrong value: a sentence, and the last good picture
    page.page.fill("#parameters .typed", "-1")
    page.wait("document.querySelector('.error').textContent !== ''")
    assert page.shown(".error") == "slope must be above 0 and below 1.5708, not -1.0"
    assert area_of(page)[0] == pytest.approx(float(basin(slope)["area"].sum()), rel=1e-12)
    page.said.clear()  # Chromium's own words on the status 400


@pytest.mark.slow
def test_a_refused_value_is_said_once_and_the_slider_stays(opened):
    page = opened("walker=simplest&slope=0.004")
    page.page.route("**/api/measure/bifurcation", partial(fulfil, explorer_server.DIAGRAM))
    shown = "document.querySelector('main').innerText + document.querySelector('#toast').innerText"
    slider = (
        "[...['min', 'max', 'value']].map((k) => Number(document.querySelector('#p-slope')[k]))"
    )
    before = page.value(slider)
    for key in ("basin", "bifurcation"):
        page.page.click(f"#tab-{key}")
        page.page.fill("#parameters .typed", "-1")
        page.wait("document.querySelector('.error').textContent !== ''")
        page.page.wait_for_timeout(600)  # in which all else would be asked for
        assert page.value(shown).count("slope must be above 0") == 1
        assert (
            page.value(slider) == before and page.value("explorer.state.parameters.slope") == 0.004
        )
        assert page.page.input_value("#parameters .typed") == "-1"
        page.page.focus("#walker")
        assert page.page.input_value("#parameters .typed") == "0.004"
        page.set_slope(0.005)
        assert page.shown(".error") == ""
        page.set_slope(0.004)
    page.said.clear()  # Chromium's own words on the status 400


def test_the_stage_shows_the_gait_until_a_start_is_chosen(opened):
    page = opened("walker=simplest&slope=0.004")
    page.wait("explorer.walk.playing && explorer.walk.time > 0")
    np.testing.assert_allclose(page.value("explorer.walk.start"), GAIT["states"][0], atol=1e-6)
    # read at one moment, as the walk goes on
    stride, note = page.value(
        "[explorer.walk.current.number + 1, document.querySelector('#walk-note').innerText]"
    )
    assert note == f"The gait, stride {stride}"
    assert page.page.locator("#stage-hint").is_visible()
    page.set_slope(0.005)
    page.wait("explorer.walk.subject.parameters.slope === 0.005")
    gait = wj.find_gait(wj.SimplestWalker(0.005)).states[0]
    np.testing.assert_allclose(page.value("explorer.walk.start"), gait, atol=1e-6)
    assert "start=" not in page.value("location.hash")
    page.set_slope(0.03)  # where there is no gait
    page.wait("!explorer.walk.strides.length && explorer.stage.slope === 0.03")
    assert page.shown("#walk-note").strip() == "" and page.value("explorer.map.path") == []
    page.set_slope(0.005)
    page.wait("explorer.walk.subject?.parameters.slope === 0.005")
    # a fall, of which nothing is drawn below the ground
    page.page.mouse.click(*page.screen(0.3, -0.035))
    page.walks_from_start()
    assert not page.page.locator("#stage-hint").is_visible()
    made, drawn = page.value(LOWEST)
    assert made < -0.5 and drawn > -1e-9


def test_a_start_walks_or_falls_as_it_must(opened):
    page = opened("walker=simplest&slope=0.004")
    gait = wj.find_gait(wj.SimplestWalker(0.004)).states[0]
    page.page.mouse.move(*page.screen(0.16, -0.004))
    page.wait(
        "document.querySelector('#hover').textContent.includes('walks: at the gait of period 1')"
    )
    page.page.select_option("#speed", "5")
    page.page.mouse.click(*page.screen(0.16, -0.004))
    page.walks_from_start()
    page.wait("explorer.walk.current?.number >= 6")  # it walks on, and more strides are asked for
    start = page.value("explorer.walk.start")
    page.wait("explorer.walk.strides.length > 12")
    strides = page.value("explorer.walk.strides.map((one) => one.start)")
    made = wj.walk(wj.SimplestWalker(0.004), jnp.array(start), 12)
    np.testing.assert_allclose(strides[:12], made.states[:12], rtol=1e-9)
    assert np.abs(np.array(strides[12]) - gait).max() < 0.01
    # pause, and push it over by its hip
    page.page.click("#play")
    page.wait("!explorer.walk.playing")
    hip = page.value("explorer.stage.hip")
    box = page.box("#stage")
    x, y = box["x"] + hip[0], box["y"] + hip[1]
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x - 150, y, steps=4)
    page.page.mouse.up()
    page.wait("explorer.walk.pushes === 1")
    page.wait("explorer.walk.over && !explorer.walk.playing")
    assert page.shown("#walk-note").lower().startswith("falls backward")
    # a start from which it falls forward, after as many strides as the hover says
    page.page.mouse.move(*page.screen(0.3, -0.035))
    page.wait("document.querySelector('#hover').textContent.includes('falls forward')")
    page.page.mouse.click(*page.screen(0.3, -0.035))
    page.wait("explorer.walk.start[0] > 0.29")
    page.wait("explorer.walk.over && explorer.walk.time >= explorer.walk.strides.at(-1)?.ends")
    page.wait("!explorer.walk.playing")
    assert page.shown("#walk-note").lower().startswith("falls forward")
    start = page.value("explorer.walk.start")
    assert int(wj.stride(wj.SimplestWalker(0.004), jnp.array(start)).outcome) == wj.Outcome.FORWARD
    page.page.keyboard.press("Tab")


LOWEST = """(() => {
  const {walk, stage} = explorer, made = [], drawn = [], draw = stage.drawPose;
  walk.playing = false;
  stage.drawPose = function (c, places, ...others) {
    drawn.push(places.hip[1] - 0.02, places.stance[1], places.swing[1]);
    draw.call(this, c, places, ...others);
  };
  for (let k = 0; k <= 300; k++) {
    walk.time = (k / 300) * walk.strides.at(-1).ends;
    stage.draw();
    made.push(walk.places(walk.state(), walk.current.foot).swing[1]);
  }
  stage.drawPose = draw;
  return [Math.min(...made), Math.min(...drawn)];
})()"""
"""The lowest height above the ground in a walk: of its swing foot, and of what is drawn."""


@pytest.mark.slow
def test_zooming_in_ten_thousand_times_and_panning(opened):
    page = opened("walker=simplest&slope=0.004")
    at = page.screen(0.193, -0.0138)
    page.page.mouse.move(*at)
    while page.value("explorer.map.view.zoom") < np.log2(1e4):
        page.page.mouse.wheel(0, -400)
        page.page.wait_for_timeout(15)
    page.finished()
    shown = "explorer.picture.cells(explorer.map.view)"
    level, count = page.value(f"[{shown}.level, {shown}.all.length]")
    assert level >= 13
    lattice = page.value("({lower: explorer.lattice.lower, upper: explorer.lattice.upper})")
    low, high = np.array(lattice["lower"]), np.array(lattice["upper"])
    chosen = np.random.default_rng(0).choice(count, 400, replace=False).tolist()
    cells = np.array(
        page.value(f"{{const {{all}} = {shown}; {chosen}.map((k) => all[k]);}}"), float
    )
    places = low + (cells[:, :2] + 0.5) * (high - low) / (200, 250) / 2.0**level
    assert np.abs(places - (0.193, -0.0138)).max() < 1e-3
    states = np.stack([places[:, 0], places[:, 1] - places[:, 0]], axis=1)
    labels, _ = explorer_server.follow(wj.SimplestWalker(0.004), states, 60)
    shown = np.where(cells[:, 2] >= pictures.UNMATCHED, 0, cells[:, 2])
    assert (shown == labels).mean() > 0.99
    # pan by a drag: a place follows the hand
    before = page.value("explorer.map.view.centre")
    page.page.mouse.down()
    page.page.mouse.move(at[0] + 80, at[1] + 30, steps=5)
    page.page.mouse.up()
    after = page.value("explorer.map.view.centre")
    width = page.value("2 * explorer.lattice.half(explorer.map.view, 0) / explorer.map.box.width")
    assert before[0] - after[0] == pytest.approx(80 * width, rel=1e-6)
    assert page.value("explorer.state.start") is None  # a drag is no click
    page.finished()
    page.page.click("#zoom-home")
    page.finished()
    assert page.value("explorer.map.view.zoom") == 0


@pytest.mark.slow
def test_facts_come_in(opened):
    page = opened("walker=simplest&slope=0.004", measured={})
    page.wait(
        "document.querySelector('#fact-disturbance').textContent.startsWith('0.0022562')", 300
    )
    assert page.shown("#fact-disturbance").endswith("falls forward after 18 strides")
    page.wait("document.querySelector('#fact-area').textContent.includes('±')")
    assert page.shown("#fact-area").startswith("(1.206")
    page.wait("document.querySelector('#fact-multipliers').textContent.includes('0.6339')")


@pytest.mark.slow
def test_the_link_and_what_is_taken_away(opened, tmp_path):
    page = opened("walker=simplest&slope=0.006&method=cell-map&view=120,130,1")
    page.page.click("#copy-python")
    page.wait("document.querySelector('#toast').textContent === 'Python copied'")
    names = {}
    exec(compile(page.value("navigator.clipboard.readText()"), "copied", "exec"), names)
    basin = names["basin"]
    assert basin.attrs["walker_slope"] == 0.006 and basin.attrs["method"] == "cell-map"
    found = page.value(CELLS)
    shown = np.array([label for _, _, label in found["all"]])
    columns, rows = (len({cell[k] for cell in found["all"]}) for k in (0, 1))
    assert basin["fate"].shape == (columns, rows)
    walks = basin["attractor"].values.ravel() >= 0
    np.testing.assert_array_equal(shown >= pictures.FIRST_ATTRACTOR, walks)
    page.page.click("#copy-command")
    page.wait("document.querySelector('#toast').textContent === 'Command copied'")
    command = page.value("navigator.clipboard.readText()")
    assert command.startswith("walker-jax basin --walker simplest --slope 0.006 --theta ")
    for button, name in (("#save-png", ".png"), ("#save-data", ".zarr.zip")):
        with page.page.expect_download(timeout=1000 * SECONDS) as download:
            page.page.click(button)
        assert download.value.suggested_filename.endswith(name)
        download.value.save_as(tmp_path / f"taken{name}")
    assert (tmp_path / "taken.png").read_bytes().startswith(b"\x89PNG")
    with ZipStore(tmp_path / "taken.zarr.zip", mode="r") as place:
        data = xr.open_zarr(place, consolidated=False).load()
    np.testing.assert_array_equal(data["fate"], basin["fate"])
    page.wait("location.hash.includes('view=')")
    other = opened(page.value("location.hash.slice(1)"))
    assert other.value("explorer.map.view") == page.value("explorer.map.view")
    assert other.value(CELLS) == found


@pytest.mark.slow
def test_an_own_walker_walks_and_one_of_another_server_is_told(opened):
    page = opened("walker=Own&slope=0.0045")
    assert page.shown("#about-walker") == "The simplest walker, of a user's own."
    assert page.value("explorer.state.parameters") == {"slope": 0.0045}
    page.page.mouse.click(*page.screen(0.1534, -0.0027))
    page.walks_from_start()
    page.wait("explorer.walk.current?.number >= 1")
    pose = page.value("explorer.walk.places(explorer.walk.state(), 0)")
    assert np.hypot(*np.subtract(pose["hip"], pose["stance"])) == pytest.approx(1)
    page.value("location.hash = 'walker=Nobody&slope=0.01'")
    page.wait("document.querySelector('#toast').textContent.includes('not know the walker Nobody')")
    assert page.value("explorer.state.parameters") == {"slope": 0.004}
    Held(page, "**/api/home")  # or that of a spring would be computed
    page.value("location.hash = 'walker=spring&slope=0.005&hip_stiffness=0.7'")
    page.wait("explorer.state.walker === 'spring'")
    assert page.value("explorer.state.parameters") == {"slope": 0.005, "hip_stiffness": 0.7}


def test_hands_on_keys_alone(opened):
    page = opened("walker=simplest&slope=0.004")
    page.page.focus("#map")
    for key in ("ArrowLeft", "ArrowLeft", "ArrowUp", "+"):
        page.page.keyboard.press(key)
    assert page.value("explorer.map.view.zoom") == 0.5
    assert "θ" in page.shown("#hover")
    page.page.keyboard.press("Enter")
    page.walks_from_start()
    page.page.keyboard.press("0")
    assert page.value("explorer.map.view.zoom") == 0
    playing = page.value("explorer.walk.playing")
    page.page.keyboard.press(" ")
    page.wait(f"explorer.walk.playing !== {str(playing).lower()}")
    controls = "button, input, select, canvas"
    unnamed = page.value(f"""[...document.querySelectorAll("{controls}")].filter((one) =>
      !one.getAttribute("aria-label") && !one.textContent.trim() && !one.labels?.length).length""")
    assert unnamed == 0


@pytest.mark.parametrize("theme", [pytest.param("light", marks=pytest.mark.slow), "dark"])
def test_every_width_and_theme(opened, theme, tmp_path):
    # also where nothing may be stored, as in a frame of another site
    page = opened("walker=simplest&slope=0.004", color_scheme=theme, before=NO_STORAGE)
    other = {"light": "dark", "dark": "light"}
    for chosen in (theme, other[theme], theme):
        ground = page.value("getComputedStyle(document.body).backgroundColor")
        light = sum(map(int, ground[4:-1].split(","))) / 3
        assert (light > 128) == (chosen == "light")
        pressed = page.page.get_attribute("#theme", "aria-pressed")
        assert pressed == str(chosen == "dark").lower()
        page.page.click("#theme")
    for viewport in (WIDE, NARROW):  # each in the other theme
        page.page.click("#theme")
        page.page.set_viewport_size(viewport)
        page.page.wait_for_timeout(100)
        page.finished()
        assert page.value("document.documentElement.scrollWidth") <= viewport["width"]
        for one in page.page.locator("button:visible, select:visible").all():
            box = one.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= viewport["width"] + 0.5
        # the screen has the colours of the cells, and these differ even in grey
        page.page.screenshot(path=tmp_path / "page.png")
        screen = np.asarray(Image.open(tmp_path / "page.png").convert("RGB"))
        for at in ((0.3, -0.035), (0.17, -0.005), (0.3, 0.005)):
            x, y = page.screen(*at)
            colour = page.value(
                f"""(() => {{
                  const {{picture, palette, map}} = explorer;
                  const found = picture.at(map.places([{at[0]}, {at[1]}]));
                  const colour = palette.colour(found.label, picture.layer.attractors);
                  return palette.shaded(colour, found.label, found.strides);
                }})()"""
            )
            around = screen[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4].reshape(-1, 3)
            assert np.abs(around.astype(int) - colour).max(axis=1).min() <= 2, at
        fates = "[explorer.palette.basins[0], ...Object.values(explorer.palette.fates)]"
        shades = [lightness(colour) for colour in page.value(fates)]
        assert len(shades) == OWN
        for one, other in combinations(shades, 2):
            assert abs(one - other) > LEAST_CONTRAST


@pytest.mark.slow
def test_nothing_of_a_walker_stands_under_the_name_of_the_next(opened):
    page = opened("walker=simplest&slope=0.004")
    facts = "[...document.querySelectorAll('.facts dd')].map((one) => one.textContent)"
    page.wait(f"{facts}.join().includes('0.6339')")
    held = Held(page, "**/api/home")
    page.page.route("**/api/compiling", partial(fulfil, {"seconds": 7.2}))
    page.page.select_option("#walker", "Own")
    held.wait(1)
    assert page.value(facts) == [""] * 4
    page.wait("document.querySelector('#compiling').textContent !== ''")
    assert page.shown("#compiling") == "Compiling the Own walker, about 8 s the first time"
    assert page.value("document.querySelector('#legend').childElementCount") == 0
    page.page.wait_for_timeout(100)
    seen = "explorer.map.context.getImageData(100, 40, 300, 200).data.buffer"
    assert page.value(f"new Set(new Uint32Array({seen})).size") == 1  # empty ground
    # no marks either; a picture to take away is not there, and says so
    assert page.value("explorer.map.gaits.length === 0 && !explorer.map.arrow")
    page.page.click("#save-png")
    page.wait("document.querySelector('#toast').textContent === 'The picture is not there yet'")
    held.let_go()
    page.wait("explorer.lattice !== null")
    assert page.shown("#compiling") == ""
    page.finished()
    page.wait(f"{facts}.join().includes('0.6339')")
    assert page.value("explorer.picture.layer.body.walker") == "Own"


@pytest.mark.slow
def test_walks_never_mix(opened):
    """Keys and clicks while answers are awaited."""
    page = opened("walker=simplest&slope=0.004")
    walker = wj.SimplestWalker(0.004)
    page.value("explorer.walk.speed = 0.1")
    held = Held(page, "**/api/walk")
    page.page.mouse.click(*page.screen(0.16, -0.004))
    held.wait(1)
    held.let_go()
    page.walks_from_start()
    page.wait("explorer.walk.strides.length === 12")
    first = page.value("explorer.walk.start")

    # three strides by keys at the end of what is known: asked for once
    page.value(
        "explorer.walk.playing = false; explorer.walk.time = explorer.walk.strides[11].begins"
    )
    for _ in range(3):
        page.page.keyboard.press(".")
    held.wait(1)
    held.let_go()
    page.wait("explorer.walk.strides.length === 24")
    starts = page.value("explorer.walk.strides.map((one) => one.start)")
    made = wj.walk(walker, jnp.array(first), 24).states
    np.testing.assert_allclose(starts, made[:24], rtol=1e-6)
    assert page.value("explorer.walk.time === explorer.walk.strides[11].ends")

    # two pushes by keys, the second while the first is under way: one push by their sum, mid-stride
    page.value("explorer.walk.time += 0.5; explorer.walk.playing = true")
    page.page.focus("#map")
    for count in (1, 2):
        page.page.keyboard.press("]")
        held.wait(count)
    assert [one.request.post_data_json["push"] for one in held.routes] == [[0.01, 0], [0.02, 0]]
    time_then = page.value("explorer.walk.time")
    held.let_go()
    page.wait("explorer.walk.pushes === 1")
    numbers = page.value("explorer.walk.strides.map((one) => one.number)")
    assert numbers[:14] == [*range(13), 12]  # the stride that the push cuts is one
    assert page.value("explorer.walk.strides[13].begins") == pytest.approx(time_then, abs=1e-12)

    # a push under way, and a new start: the new walk alone
    page.value("explorer.walk.playing = false; explorer.walk.time = 1")
    page.page.keyboard.press("]")
    held.wait(1)
    page.page.mouse.click(*page.screen(0.15, -0.003))
    held.wait(2)
    held.let_go()
    page.wait("explorer.walk.start[0] < 0.155")
    page.page.wait_for_timeout(200)
    assert page.value("[explorer.walk.pushes, explorer.walk.strides.length]") == [0, 12]
    assert page.value("explorer.walk.strides[0].start") == page.value("explorer.walk.start")

    # other parameters: the walk begins anew once the slider rests, with all of its sizes
    start = page.value("explorer.walk.start")
    page.page.fill("#parameters .typed", "0.0045")
    assert page.value("explorer.stage.slope") == 0.004
    held.wait(1)
    held.let_go()
    page.wait("explorer.stage.slope === 0.0045")
    assert page.value("explorer.walk.start") == start
    made = wj.walk(wj.SimplestWalker(0.0045), jnp.array(start), 3).states
    starts = page.value("explorer.walk.strides.map((one) => one.start)")
    np.testing.assert_allclose(starts[:3], made[:3], rtol=1e-9)
    assert page.value("explorer.walk.leg") == {"length": 1, "radius": 0}

    # a walk that the server refuses stops, and asks no more
    page.page.unroute("**/api/walk")
    page.page.route(
        "**/api/walk", partial(fulfil_as, {"status": 422, "json": {"error": "no walk"}})
    )
    page.value(
        "explorer.walk.playing = true; explorer.walk.time = explorer.walk.strides[11].begins"
    )
    page.wait("document.querySelector('#toast').textContent === 'no walk'")
    assert page.value("!explorer.walk.playing && explorer.walk.strides.length === 12")
    page.said.clear()  # Chromium's own words on the status 422


@pytest.mark.slow
def test_facts_stand_once_they_are_exact(opened):
    page = opened("walker=simplest&slope=0.004")
    page.wait("document.querySelector('#fact-area').textContent.includes('±')")
    page.wait("document.querySelector('#fact-disturbance').textContent.startsWith('0.002256')")
    exact = page.shown("#fact-area")
    asked = len(page.addresses)
    page.value("explorer.picture.finish()")  # a picture that ends later estimates nothing
    assert page.shown("#fact-area") == exact
    page.value("explorer.map.pan(0, 0)")  # the same view: nothing is asked again
    page.page.wait_for_timeout(700)
    assert not any("measure" in address for address in page.addresses[asked:])
    # a mark has its multipliers
    page.page.mouse.move(*page.screen(GAIT["states"][0][0], sum(GAIT["states"][0])))
    page.wait("document.querySelector('#hover').textContent.includes('multipliers 0.634')")
    # the nearest loss is a failure: no infeasible start, no undecided cell, none that leaves a grid
    nearest = page.value(
        f"""(() => {{
      const {{facts, lattice, state, map}} = explorer;
      state.view = map.view;
      const gait = lattice.place(0, 0.153), sum = lattice.place(1, -0.003);
      const codes = [{int(wj.Outcome.OUTSIDE)}, {int(wj.Outcome.UNDECIDED)},
        {int(wj.Outcome.LEFT_GRID)}, {pictures.UNMATCHED}, {int(wj.Outcome.BENT_KNEE)}];
      const all = codes.map((code, k) => [Math.round(gait), Math.round(sum) + 2 * k, code]);
      const attractors = [{{period: 1, artefact: false, states: [[0.153, -0.156]]}}];
      const found = facts.nearestLoss({{level: 0, all}}, lattice, state, attractors);
      const mapped = {{...state, shown: state.shown, method: "cell-map"}};
      const none = facts.nearestLoss({{level: 0, all}}, lattice, mapped, attractors);
      return [found.state, all[4], none];
    }})()"""
    )
    place = page.value(f"explorer.lattice.place(1, {sum(nearest[0])}) - 0.5")
    assert place == pytest.approx(nearest[1][1], abs=1e-6) and nearest[2] is None
    # cells of which nothing is known are counted
    page.value(
        """(() => {
      for (const one of explorer.picture.layer.tiles.values()) one.label[1300] = 6;
      explorer.picture.finish();
    })()"""
    )
    assert "undecided: 20 cells" in page.shown("#legend")
    # a box without a number says so; a view that cannot be shown is the nearest that can
    page.page.fill("#parameters .typed", "")
    assert page.shown(".error") == "A number is needed here"
    page.page.focus("#map")
    assert page.shown(".error") == ""
    page.value("location.hash = 'walker=simplest&slope=0.004&view=1e99,-3e9,-12'")
    page.wait("explorer.map.view.zoom === -2")
    page.wait("explorer.picture.progress === 1")
    assert page.value("explorer.map.view.centre[0]") == 2**20 * 100
    # a refusal is told in its own words; only where there is no such gait it says so
    for kind, answer in (
        ("gaits", {"status": 422, "json": {"error": "the search failed"}}),
        ("disturbance", {"body": "null", "content_type": "application/json"}),
        ("area", {"status": 422, "json": {"error": "too many cells"}}),
    ):
        page.page.unroute(f"**/api/measure/{kind}")
        page.page.route(f"**/api/measure/{kind}", partial(fulfil_as, answer))
    page.page.click("#zoom-home")
    page.page.fill("#parameters .typed", "0.0041")
    page.wait("document.querySelector('#fact-gait').textContent === 'the search failed'")
    page.wait(
        "document.querySelector('#fact-disturbance').textContent === 'no stable gait of period 1'"
    )
    page.wait("document.querySelector('#fact-area').textContent === 'too many cells'")
    page.finished()
    page.said.clear()  # Chromium's own words on the status 422


@pytest.mark.slow  # a walker with round feet takes long to compile
def test_a_walker_with_round_feet_and_a_slice(opened):
    page = opened("walker=simplest&slope=0.004")
    page.page.select_option("#walker", "round-foot")
    assert page.value("explorer.lattice === null")  # nothing of the old window is asked for
    page.page.click("#zoom-in")
    page.wait("JSON.parse(explorer.picture.layer?.key ?? '{}').walker === 'round-foot'", 600)
    page.finished()
    assert page.value("explorer.map.view.zoom") == 0
    at = page.value("explorer.picture.layer.at")
    gait = wj.find_gait(wj.RoundFootWalker(0.004)).states[0]
    assert at == pytest.approx([float(gait[2])], rel=1e-9)
    page.page.click("#copy-command")
    page.wait("document.querySelector('#toast').textContent === 'Command copied'")
    assert f"--at-phidot {at[0]!r} " in page.value("navigator.clipboard.readText()")
    # its leg is drawn in its own sizes
    index = page.value(
        "explorer.state.kind.parameters.findIndex((one) => one.name === 'foot_radius')"
    )
    box = page.page.locator("#parameters .typed").nth(index)
    box.fill("0.2")
    page.wait("JSON.parse(explorer.picture.layer.key).parameters.foot_radius === 0.2")
    page.finished()
    page.page.mouse.click(*page.screen(float(gait[0]), float(gait[0] + gait[1])))
    page.walks_from_start()
    assert page.value("explorer.walk.leg.radius") == pytest.approx(0.2)
    # a slice off the gait, by its slider, and back
    page.page.locator("#slice .typed").fill("-0.02")
    page.wait("explorer.picture.layer.at[0] === -0.02")
    assert page.page.locator(".at-gait").get_attribute("aria-pressed") == "false"
    page.finished()
    page.page.click(".at-gait")
    page.wait("explorer.picture.layer.at[0] !== -0.02 && explorer.picture.progress === 1")
    # and to the other section while the picture still comes
    page.page.check("#section input[value=plain]")
    page.wait("JSON.parse(explorer.picture.layer.key).section === 'plain'")
    page.finished()


@pytest.mark.slow
def test_fingers_zoom_and_pan(opened):
    page = opened("walker=simplest&slope=0.004", viewport=NARROW, has_touch=True, is_mobile=True)
    session = page.context.new_cdp_session(page.page)
    box = page.box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def touch(kind, *points):
        fingers = [{"x": a, "y": b, "id": i} for i, (a, b) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    touch("touchStart", (x - 30, y), (x + 30, y))
    for d in range(35, 65, 5):
        touch("touchMove", (x - d, y), (x + d, y))
    touch("touchEnd")
    assert page.value("explorer.map.view.zoom") == pytest.approx(1, abs=0.1)
    assert page.value("explorer.state.start") is None
    page.finished()
    page.page.touchscreen.tap(x, y)
    page.walks_from_start()
