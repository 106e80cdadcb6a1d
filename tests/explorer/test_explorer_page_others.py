"""The explorer's page in a browser: maps, links, frames, saved pictures and words of others."""

import json
import re
import time
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread
from xml.etree import ElementTree

import explorer_server
import jax.numpy as jnp
import numpy as np
import pytest
from explorer_page import SECONDS, WIDE, Held, Page, area_of, fulfil, fulfil_as
from explorer_subjects import few, parts_and_result
from PIL import Image
from playwright.sync_api import Error

import walker_jax as wj
from walker_jax.explorer import measures
from walker_jax.explorer.subjects import read_subject
from walker_jax.walkers.family import WALKERS


@pytest.mark.slow
def test_a_server_that_goes_and_comes_back(browser):
    with explorer_server.running() as first:
        page = Page(browser, first.port, "walker=simplest&slope=0.004")
    page.page.fill("#parameters .typed", "0.005")
    page.page.click("#tab-bifurcation")
    page.wait("!document.querySelector('#gone').hidden")
    assert page.shown("#gone").startswith("The server does not answer.")
    assert page.shown("#diagram-note").strip() in (
        "",
        "The gaits are followed over the slope…",
    )
    page.page.route("**/api/measure/bifurcation", partial(fulfil, explorer_server.DIAGRAM))
    with explorer_server.running(first.port):
        page.wait("document.querySelector('#gone').hidden")
        page.wait("JSON.parse(explorer.picture.layer.key).parameters.slope === 0.005")
        page.finished()
        page.wait("document.querySelector('#diagram-note').textContent.includes('doubles')")
        page.said.clear()  # Chromium's own words on refused connections
        page.close()


SHOWN = """[...document.querySelectorAll(
  "label, legend, dt, dd, button, .stage, select"
)].filter((one) => one.checkVisibility()).map((one) => one.innerText + one.title).join()"""


def test_a_map_has_iterates_cycles_and_axes_of_its_own(opened_system):
    page = opened_system("walker=henon&a=0.7")
    assert page.value("explorer.map.axes") == ["x", "y"]
    shown = page.value(SHOWN)
    assert "System" in shown and "Cycle" in shown and "One iterate" in shown
    for of_walkers in ("Walker", "Gait", "stride", "push", "real time", "rad", "Section"):
        assert of_walkers not in shown
    assert not page.page.locator("#stage").is_visible()
    assert page.page.locator("#parameters .name").all_inner_texts() == ["a", "b"]
    grid = wj.Grid.plain(x=(-2, 2, 200), y=(-2, 2, 250))
    basin = wj.basin(wj.systems.HenonMap(0.7), grid, "direct")
    assert area_of(page)[0] == pytest.approx(float(basin["area"].sum()), rel=1e-12)
    page.page.mouse.move(*page.screen(0.1, 0.1))
    page.wait("document.querySelector('#hover').textContent.includes('the cycle of period 2')")
    assert page.shown("#hover").startswith("x 0.1")
    # iterates come in their order, by keys too
    page.page.mouse.click(*page.screen(0.1, 0.1))
    page.wait("explorer.walk.playing && explorer.map.path.length > 3")
    page.page.keyboard.press(" ")
    page.wait("!explorer.walk.playing")
    count = page.value("explorer.map.path.length")
    page.page.keyboard.press(".")
    page.wait(f"explorer.map.path.length === {count + 1}")
    path = page.value("explorer.map.path")
    made = wj.walk(wj.systems.HenonMap(0.7), jnp.array(path[0]), len(path) - 1)
    np.testing.assert_allclose(path, made.states, rtol=1e-9)
    assert page.shown("#walk-note").lower() == f"iterate {len(path)}"
    # one that escapes says so, and a parameter that changes begins anew
    page.page.mouse.click(*page.screen(-1.9, -1.9))
    page.wait("explorer.walk.over && !explorer.walk.playing && explorer.walk.start[0] < -1")
    assert page.shown("#walk-note").lower().startswith("infeasible after ")
    assert "infeasible" in page.shown("#legend")
    page.page.locator("#parameters .typed").first.fill("0.3")
    page.wait("JSON.parse(explorer.picture.layer.key).parameters.a === 0.3")
    page.finished()
    assert "basin of the cycle of period 1" in page.shown("#legend")
    # the bifurcation diagram grows
    whole, note = explorer_server.DIAGRAM, "document.querySelector('#diagram-note').textContent"
    grown = [whole | {"whole": False, "points": [], "events": [], "lost": []}, whole]
    for lines, said in ((grown[:1], "1 branch so far"), (grown, "cycle first doubles")):
        body = "\n".join(map(json.dumps, lines))
        answer = partial(fulfil_as, {"body": body, "content_type": "application/x-ndjson"})
        page.page.route("**/api/measure/bifurcation", answer)
        page.page.locator("#parameters .typed").last.fill(f"0.{30 + len(lines)}")
        page.page.click("#tab-bifurcation")
        page.wait(f"{note}.includes('{said}')")
        page.page.click("#tab-basin")
    # it is over a parameter of one's choice
    page.page.route("**/api/measure/bifurcation", partial(fulfil, explorer_server.DIAGRAM))
    page.page.click("#tab-bifurcation")
    page.wait("document.querySelector('#diagram-note').textContent.includes('cycle first doubles')")
    with page.page.expect_request("**/api/measure/bifurcation") as asked:
        page.page.select_option("#over", "b")
    assert asked.value.post_data_json["over"] == "b"
    page.wait("location.hash.includes('over=b')")


@pytest.mark.slow
def test_a_walker_that_compiles_is_asked_for_once(opened):
    page = opened("walker=simplest&slope=0.004")
    held, note = Held(page, "**/api/home"), "Compiling the Own walker, about 8 s the first time"
    page.page.route("**/api/compiling", partial(fulfil, {"seconds": 7.2}))
    page.page.select_option("#walker", "Own")
    held.wait(1)
    page.wait("document.querySelector('#compiling').textContent !== ''")
    asked = len(page.addresses)
    for slope in ("0.005", "0.006", "0.004"):
        page.page.fill("#parameters .typed", slope)
    held.wait(1)
    assert len(page.addresses) == asked and page.shown("#compiling") == note
    # a failure of another walker says nothing of this one
    page.page.select_option("#walker", "spring")
    held.wait(2)
    page.page.select_option("#walker", "Own")
    held.wait(2)
    held.routes.pop().fulfill(status=422, json={"error": "no gait"})
    page.page.wait_for_timeout(200)
    assert page.shown("#compiling") == note and page.shown("#toast") != "no gait"
    page.said.clear()  # Chromium's own words on the status 422
    held.let_go()
    page.finished()
    assert page.shown("#compiling") == ""
    assert page.value("explorer.picture.layer.body.walker") == "Own"
    assert page.value("explorer.picture.layer.body.parameters.slope") == 0.004


def test_a_label_says_nothing_twice(opened):
    page = opened("walker=simplest&slope=0.004")
    Held(page, "**/api/home")  # or all walkers would be compiled
    shown = {}
    for name in WALKERS:
        page.page.select_option("#walker", name)
        shown[name] = page.page.locator("#parameters label").all_inner_texts()
        assert shown[name][0] == "slope (rad)"
        assert not any(re.search(r"\b(\w+) \(?\1\b", one) for one in shown[name])
    assert "foot mass (hip mass)" in shown["point-foot"]
    assert {"hip mass", "leg length", "com offset (length)"} < {*shown["round-foot"]}


@pytest.mark.slow
def test_a_system_of_three_coordinates_is_shown_along_any_two(opened_system):
    page = opened_system("walker=Spiral&section=east-up&at_north=0.5")
    assert page.value("explorer.map.axes") == ["east", "up"]
    assert page.page.locator("#section option").all_inner_texts() == [
        *("east, north", "east, up", "north, up")
    ]
    assert page.page.locator("#slice .typed").input_value() == "0.5"
    page.page.mouse.click(*page.screen(0.5, 0.7))
    page.wait("explorer.walk.over && explorer.walk.strides.length === 2")
    start = page.value("explorer.walk.start")
    assert start[1] == 0.5 and start == pytest.approx([0.5, 0.5, 0.7], abs=0.02)
    page.wait("!explorer.walk.playing")
    assert page.shown("#walk-note").lower() == "flies off after 1 iterate"
    page.page.mouse.click(*page.screen(-1.8, 0.7))
    page.wait("document.querySelector('#walk-note').textContent === 'not a feasible start'")
    page.page.select_option("#section select", "north-up")
    page.wait("JSON.parse(explorer.picture.layer?.key ?? '{}').section === 'north-up'")
    page.finished()
    assert page.value("explorer.state.at") == {}
    assert page.shown("#slice .name") == "slice at east"
    assert page.shown(".at-gait") == "at the cycle"
    legend = page.shown("#legend")
    assert "flies off" in legend and "basin of the cycle of period 1" in legend
    page.wait("location.hash.includes('section=north-up')")


def test_a_link_of_another_server_is_told_apart(browser, page_server):
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{page_server.port}/?token=another")
    page.wait_for_selector("#gone:not([hidden])")
    assert "the token is not that of this server" in page.locator("#gone").inner_text()
    context.close()


class Empty(BaseHTTPRequestHandler):
    """An empty page."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("content-type", "text/html")
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


FRAMED = """(frame) => new Promise((loaded) => {
  document.body.innerHTML = frame;
  document.body.firstChild.addEventListener("load", () => loaded(null));
})"""


def test_a_notebook_frames_the_page_and_others_do_not(browser, page_server):
    """A frame in a page of another site on this machine, with the token and without."""
    context = browser.new_context(viewport=WIDE)
    page = context.new_page()
    notebook = HTTPServer(("127.0.0.1", 0), Empty)
    thread = Thread(target=notebook.serve_forever, daemon=True)
    thread.start()
    page.goto(f"http://localhost:{notebook.server_port}/")
    for token, shown in ((explorer_server.TOKEN, True), ("another", False)):
        link = f"http://127.0.0.1:{page_server.port}/?token={token}#walker=simplest&slope=0.004"
        frame = f'<iframe src="{link}"></iframe>'
        page.evaluate(FRAMED, frame)  # until it has loaded, or is refused
        stop, there = time.monotonic() + (SECONDS if shown else 0.3), False
        while time.monotonic() < stop and not there:
            page.wait_for_timeout(50)
            with suppress(Error):  # of a frame that goes on to its page
                there = any(one.evaluate("Boolean(window.explorer)") for one in page.frames[1:])
        assert there == shown
    assert not any(one.evaluate("document.querySelector('#map') !== null") for one in page.frames)
    context.close()
    notebook.shutdown()
    thread.join()
    notebook.server_close()


@pytest.mark.slow
@pytest.mark.parametrize("computed", [False, True])
def test_the_bifurcation_tab_has_the_slope_in_it(opened, monkeypatch, computed):
    """A diagram of the form of the server's, or its own of few slopes; those a hand chooses."""
    page = opened("walker=simplest&slope=0.004")
    for name, value in few(8, strides=60, period_max=1).items():
        monkeypatch.setattr(measures, name, value)
    found = (
        parts_and_result(measures.bifurcation(read_subject({"walker": "simplest"}), "slope"))[1]
        if computed
        else explorer_server.DIAGRAM
    )
    page.page.route("**/api/measure/bifurcation", partial(fulfil, found))
    page.page.click("#tab-bifurcation")
    page.wait("document.querySelector('#diagram-note').textContent.includes('lost near 0.019')")
    assert "doubles its period at 0.015088;" in page.shown("#diagram-note")
    assert page.value("document.querySelector('#diagram').getAttribute('aria-valuemax')") == "0.022"
    box = page.box("#diagram")
    page.page.mouse.click(box["x"] + 70 + 0.5 * (box["width"] - 84), box["y"] + 100)
    slope = page.value("explorer.state.parameters.slope")
    assert slope == pytest.approx(0.0115, abs=1e-4)
    page.wait("location.hash.includes('tab=bifurcation')")
    # where some walk at the highest slope, walking is not lost
    never = explorer_server.DIAGRAM | {"lost": [0.022, None]}
    page.page.unroute("**/api/measure/bifurcation")
    page.page.route("**/api/measure/bifurcation", partial(fulfil, never))
    page.value("location.hash = 'walker=Own&tab=bifurcation'")
    page.wait("document.querySelector('#diagram-note').textContent.includes('doubles')")
    assert "lost" not in page.shown("#diagram-note")
    page.value(f"location.hash = 'walker=simplest&slope={slope}&tab=bifurcation'")
    page.wait("explorer.state.walker === 'simplest'")
    page.page.click("#tab-basin")
    key = "JSON.parse(explorer.picture.layer?.key ?? '{}')"
    page.wait(f"{key}.parameters?.slope === {slope}")
    page.finished()


GREY = """[...document.querySelectorAll('.facts dd, #hover')]
  .map((one) => one.classList.contains('pending'))"""


def test_words_of_another_picture_are_grey(opened):
    page = opened("walker=simplest&slope=0.004")
    page.page.mouse.move(*page.screen(0.16, -0.004))
    page.wait("document.querySelector('#fact-area').textContent.includes('±')")
    page.wait("document.querySelector('#hover').textContent.includes('walks')")
    page.wait(f"!{GREY}.includes(true)")
    held = Held(page, "**/api/picture")
    page.page.fill("#parameters .typed", "0.03")
    assert page.value(GREY) == [True] * 5
    page.page.fill("#parameters .typed", "0.004")  # back before anything came
    assert page.value(GREY) == [False] * 5
    page.page.fill("#parameters .typed", "0.03")
    held.let_go()
    page.page.unroute("**/api/picture")
    page.finished()
    page.wait(f"!{GREY}.includes(true)")
    assert "falls" in page.shown("#hover") and "walks" not in page.shown("#hover")


@pytest.mark.slow
def test_axes_of_another_picture_go(opened):
    """No numbers stay beside them, and a time says when it is over."""
    page = opened("walker=simplest&slope=0.004")
    page.finished()
    colours = """(() => {
      const {canvas} = explorer.map, copy = new OffscreenCanvas(70, canvas.height).getContext("2d");
      copy.drawImage(canvas, 0, 0);
      return new Set(new Uint32Array(copy.getImageData(0, 0, 70, canvas.height).data.buffer)).size;
    })()"""
    assert page.value(colours) > 1
    held = Held(page, "**/api/home")
    page.page.route("**/api/compiling", partial(fulfil, {"seconds": 0.5}))
    page.page.select_option("#walker", "Own")
    held.wait(1)
    page.wait(f"{colours} === 1")
    page.page.mouse.wheel(0, -400)  # and no view of it to change
    page.page.focus("#map")
    page.page.keyboard.press("+")
    note = "document.querySelector('#compiling').textContent"
    page.wait(f"{note}.endsWith('s, longer than usual')")
    held.let_go()
    page.finished()
    assert page.value(f"{colours} > 1 && {note} === ''")


@pytest.mark.parametrize(
    ("tab", "words"),
    [
        ("basin", "basin of attraction"),
        pytest.param("bifurcation", "gaits over the slope", marks=pytest.mark.slow),
    ],
)
def test_saved_pictures_have_parameters_and_legend(opened, tmp_path, tab, words):
    """Once as pixels, once as vectors, which look alike."""
    page = opened("walker=simplest&slope=0.006")
    page.page.route("**/api/measure/bifurcation", partial(fulfil, explorer_server.DIAGRAM))
    legend = "[...document.querySelectorAll('#legend li')].map((one) => one.textContent)"
    page.page.click(f"#tab-{tab}")
    if tab == "bifurcation":
        page.wait("document.querySelector('#diagram-note').textContent.includes('doubles')")
    pictures = []
    for kind in ("png", "svg"):
        with page.page.expect_download() as download:
            page.page.click(f"#save-{kind}")
        assert download.value.suggested_filename == f"{tab}-simplest-0.006.{kind}"
        download.value.save_as(tmp_path / f"{tab}.{kind}")
    svg = (tmp_path / f"{tab}.svg").read_text()
    root = ElementTree.fromstring(svg)
    told = [one.text for one in root.iter("{http://www.w3.org/2000/svg}text")]
    assert told[0] == f"Simplest walker: {words}"
    if tab == "basin":
        assert told[1] == "slope 0.006 rad" and "0.2" in told
        assert told[-len(page.value(legend)) :] == page.value(legend)
        assert "8 to 160 strides to the gait" in told and "falls forward" in told
    viewer = page.context.new_page()
    width, height = (int(root.attrib[name]) for name in ("width", "height"))
    viewer.set_viewport_size({"width": width, "height": height})
    viewer.set_content(f"<style>body {{ margin: 0 }} svg {{ display: block }}</style>{svg}")
    viewer.screenshot(path=tmp_path / "vectors.png")
    viewer.close()
    pixels = Image.open(tmp_path / f"{tab}.png").convert("RGB")
    vectors = Image.open(tmp_path / "vectors.png").convert("RGB")
    assert pixels.size == (2 * vectors.width, 2 * vectors.height)
    pictures = [np.asarray(one.resize((200, 150), 4), float) for one in (pixels, vectors)]
    assert np.abs(pictures[0] - pictures[1]).mean() < 2 and pictures[0].std() > 10
