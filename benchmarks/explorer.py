"""How soon does the explorer's page follow a hand, and how smoothly does it pan?

The page runs in Chromium, on the same cores as the server. A slider is moved, and the clock runs
until the page has all 200 x 250 cells, directly iterated; the median of 20 moves is printed. Then a
hand pans over computed cells, and the frames per second are counted, of at most 60. The strides of
a picture are printed too, with the server's processor time, which does not depend on other
processes. The measures beside the picture (gaits, area, least disturbance) are switched off, since
workers of low priority would take the cores meanwhile.

The answer: a picture of 130,000 strides, including the search for attractors, takes 120 ms of
processor time, and the page follows a slider within 0.2 s on two free cores. When twice as many
processes competed for them it took 0.3 s, and panning kept 59 frames a second:

    load 1.0 on 2 cores
    slider to whole picture: median 175 ms, 152 to 198 ms, of 20 moves
    panning: 60 frames a second
    the server: 120 ms of processor time a picture,
    of 129,797 strides at slope 0.0079
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import time

import jax
import numpy as np
from playwright.sync_api import Page, sync_playwright

from walker_jax.explorer import pictures
from walker_jax.explorer.lattice import Tile
from walker_jax.explorer.subjects import read_subject

SLOPES = np.linspace(0.0041, 0.0079, 20).round(6)
MOVE = """(slope) => new Promise((done) => {
  const {state, picture, map} = explorer;
  const begin = performance.now();
  const look = () => {
    const own = JSON.parse(picture.layer.key).parameters.slope === slope;
    if (!own || !picture.cells(map.view)) return;
    picture.removeEventListener("changed", look);
    requestAnimationFrame(() => done(performance.now() - begin));
  };
  picture.addEventListener("changed", look);
  const slider = document.querySelector("#parameters [type=range]");
  slider.step = "any";
  slider.value = slope;
  slider.dispatchEvent(new Event("input", {bubbles: true}));
})"""
PAN = """(seconds) => new Promise((done) => {
  const {map} = explorer, before = map.drawn, begin = performance.now();
  const tick = (now) => {
    const time = (now - begin) / 1000;
    if (time > seconds) return done((map.drawn - before) / time);
    map.pan(3 * Math.cos(4 * time), 2 * Math.sin(5 * time));
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
})"""


def wait_for_picture(page: Page) -> None:
    """Until nothing of the picture is missing."""
    while not page.evaluate(
        "Boolean(window.explorer?.picture.layer) && explorer.picture.progress === 1"
    ):
        page.wait_for_timeout(20)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=20)
    repeats = options.parse_args().repeats
    jax.config.update("jax_enable_x64", True)
    command = [sys.executable, "-m", "walker_jax", "explore", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    link = server.stdout.readline().strip()
    print(f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        refusal = {"error": "measured elsewhere"}
        page.route(  # what else would take the cores
            re.compile("/api/measure/"), lambda route: route.fulfill(status=422, json=refusal)
        )
        page.goto(link)
        wait_for_picture(page)
        times = []
        for slope in np.resize(SLOPES, repeats).tolist():
            page.wait_for_timeout(60)
            times.append(page.evaluate(MOVE, slope))
            wait_for_picture(page)
        frames = page.evaluate(PAN, 5)
        print(f"slider to whole picture: median {statistics.median(times):.0f} ms,", end=" ")
        print(f"{min(times):.0f} to {max(times):.0f} ms, of {repeats} moves")
        print(f"panning: {frames:.0f} frames a second")
        browser.close()
    server.terminate()
    server.wait()
    spent = []
    tiles = [Tile(0, i, j) for i in range(4) for j in range(5)]
    for slope in (0.004, *SLOPES.tolist()):
        about = read_subject({"walker": "simplest", "parameters": {"slope": slope}})
        start = time.process_time()
        found = pictures.label_tiles(about, tiles)
        spent.append(time.process_time() - start)
    cells = np.array([np.frombuffer(one, np.uint8).reshape(2, -1) for one in found])
    strides = int(cells[:, 1].sum() + (cells[:, 0] < pictures.UNMATCHED).sum())
    print(f"the server: {1000 * statistics.median(spent[1:]):.0f} ms of processor time a picture,")
    print(f"of {strides:,} strides at slope {SLOPES[-1]:g}")
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
