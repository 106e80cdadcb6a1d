"""The pictures of the gallery are drawn by the lines beside them.

Run as a program it draws the page's pictures anew, all or those that are named.
"""

import os
import re
import sys
from pathlib import Path

import pytest

from walker_jax import figures

PAGE = Path(__file__).parents[2] / "docs" / "gallery.md"
PLACES = PAGE.parent / "gallery"


def programs() -> list[str]:
    """The blocks of the page, of which the first is that of the others' names."""
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)


def test_each_picture_of_the_page_is_drawn_by_its_lines():
    """By functions that there are; a quick look, as drawing takes a minute or two."""
    page, known = PAGE.read_text(), {*dir(figures)}
    shown = re.findall(r"\(gallery/(\w+\.png)\)", page)
    assert shown == re.findall(r"savefig\(\"(\w+\.png)\"", page)
    assert {path.name for path in PLACES.glob("*")} == {*shown}
    for program in programs():
        compile(program, str(PAGE), "exec")
    assert {*re.findall(r"figures\.(\w+)", page)} <= known


@pytest.mark.slow
def test_the_lines_draw_the_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, *others = programs()
    names: dict = {}
    exec(first, names)
    for program in others[:4]:
        exec(program, names)
    assert len([*tmp_path.glob("*.png")]) == 4


if __name__ == "__main__":
    PLACES.mkdir(exist_ok=True)
    os.chdir(PLACES)
    first, *others = programs()
    names: dict = {}
    exec(first, names)
    for program in others:
        exec(program, names)
        print(program.splitlines()[-1], flush=True)
    sys.exit()
