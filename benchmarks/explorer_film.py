"""The film of the explorer in the README: `python benchmarks/explorer_film.py docs/explorer.gif`.

A hand drags the slope there and back, zooms into the fingers of the basin and out again, and clicks
a start, from which the walker walks. Every frame is a screenshot of the real page at a moment when
its picture is complete, so the film is the same on a slow machine.
"""

import io
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Page, ViewportSize, sync_playwright

SIZE: ViewportSize = {"width": 1200, "height": 720}
WIDTH = 900
"""Pixels of the film."""
COLOURS = 208
COMMON = 12
"""Of these, those that are as on the page."""
FRAME = 90
"""Milliseconds."""
SLOPES = [*np.linspace(0.004, 0.011, 12), *np.linspace(0.011, 0.004, 9)[1:]]
FINGERS = (0.232, -0.0205)
START = (0.165, -0.006)
STEP = 0.3
"""Time between frames of the walk."""


def settle(page: Page) -> None:
    """Wait until the picture is complete and drawn."""
    page.wait_for_timeout(80)
    while not page.evaluate("explorer.picture.progress === 1"):
        page.wait_for_timeout(20)
    page.wait_for_timeout(60)


def film(page: Page) -> list[Image.Image]:
    """The frames."""
    frames = []

    def grab(times: int = 1) -> None:
        image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        height = round(WIDTH * image.height / image.width)
        frames.extend([image.resize((WIDTH, height), Image.Resampling.LANCZOS)] * times)

    def zoom(by: float) -> None:
        at = page.evaluate(
            "([x, y]) => explorer.map.toScreen(...explorer.map.places([x, y]))", FINGERS
        )
        page.evaluate("([at, by]) => explorer.map.zoomAt(at, by)", [at, by])
        settle(page)
        grab()

    settle(page)
    grab(4)
    box = page.locator("#parameters [type=range]").bounding_box()
    assert box is not None
    for slope in SLOPES:
        page.evaluate(
            "(slope) => explorer.state.change('parameters', { parameters: { slope } })",
            round(float(slope), 5),
        )
        settle(page)
        grab()
    grab(3)
    for by in [0.5] * 9:
        zoom(by)
    grab(6)
    for by in [-1.5] * 3:
        zoom(by)
    at = page.evaluate("([x, y]) => explorer.map.toScreen(...explorer.map.places([x, y]))", START)
    where = page.locator("#map").bounding_box()
    assert where is not None
    while page.locator("#fact-multipliers").text_content() == "…":
        page.wait_for_timeout(100)
    page.mouse.click(where["x"] + at[0], where["y"] + at[1])
    while not page.evaluate("explorer.walk.strides.length"):
        page.wait_for_timeout(20)
    for k in range(48):
        page.evaluate(
            """(time) => {
              const {walk, stage} = explorer;
              walk.playing = false;
              walk.time = time;
              for (let k = 0; k < 8; k++) stage.draw();
              walk.dispatchEvent(new Event("stride"));
            }""",
            k * STEP,
        )
        page.wait_for_timeout(60)
        grab()
    grab(8)
    return frames


def palette_of(frames: list[Image.Image]) -> Image.Image:
    """The colours of the film: the most common ones as they are, and others spread among all.

    So large areas keep their colours, and small marks have theirs.
    """
    some = frames[:: max(1, len(frames) // 6)]
    width, height = some[0].size
    whole = Image.new("RGB", (width, height * len(some)))
    for k, one in enumerate(some):
        whole.paste(one, (0, k * height))
    counts: Any = whole.getcolors(width * height * len(some))  # pairs of a number and a colour
    common = [colour for _, colour in sorted(counts, reverse=True)[:COMMON]]
    spread = whole.quantize(COLOURS - COMMON, Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(part for colour in common for part in colour), *spread])
    return palette


def main() -> None:
    path = Path(sys.argv[1])
    command = [sys.executable, "-m", "walker_jax", "explore", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"]
            )
            page = browser.new_page(viewport=SIZE)
            page.goto(server.stdout.readline().strip())
            while not page.evaluate("Boolean(window.explorer?.picture.layer)"):
                page.wait_for_timeout(50)
            frames = film(page)
            browser.close()
    finally:
        server.terminate()
        server.wait()
    palette = palette_of(frames)
    images = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in frames]
    images[0].save(path, save_all=True, append_images=images[1:], duration=FRAME, loop=0)
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
