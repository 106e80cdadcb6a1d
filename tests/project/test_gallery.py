"""The pictures of the gallery are drawn by the lines beside them; all stored ones are of today."""

import json
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest

from walker_jax import figures
from walker_jax.figures import style, text

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "gallery.md"
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


@pytest.fixture(scope="module")
def pictures() -> Any:
    """The program that draws stored pictures."""
    spec: Any = spec_from_file_location("pictures", ROOT / "benchmarks" / "pictures.py")
    program = module_from_spec(spec)
    spec.loader.exec_module(program)
    return program


def test_every_stored_picture_is_up_to_date(pictures):
    """`python benchmarks/pictures.py NAME` draws one anew and keeps its digests."""
    assert pictures.out_of_date() == {}
    assert {*json.loads(pictures.KEPT.read_text())} == {*pictures.every_picture()}


def test_another_palette_makes_pictures_out_of_date(pictures, monkeypatch):
    monkeypatch.setattr(style, "BASINS", ("#000000", *style.BASINS[1:]))
    monkeypatch.setitem(pictures.COMMANDS, "basin.png", "walker-jax basin --slope 0.01")
    found = pictures.out_of_date()
    assert {*found} == {*pictures.every_picture()}
    assert found["basin.png"] == ["look", "lines"] and found["walk.gif"] == ["look"]


def test_another_benchmark_makes_its_pictures_out_of_date(pictures, monkeypatch, tmp_path):
    copied = Path(copytree(pictures.BENCHMARKS, tmp_path / "benchmarks"))
    changed = copied / "transients.py"
    monkeypatch.setattr(pictures, "BENCHMARKS", copied)
    changed.write_text(changed.read_text().replace("figsize=(9,", "figsize=(8,"))
    found = pictures.out_of_date()
    assert found == {f"{name}.png": ["lines"] for name in ("crisis", "leaves", "saddle")}


def test_other_words_above_pictures_make_all_out_of_date(pictures, monkeypatch, tmp_path):
    other = tmp_path / "text.py"
    other.write_text(Path(text.__file__).read_text().replace('"stance leg angle "', '"leg angle "'))
    monkeypatch.setattr(text, "__file__", str(other))
    assert pictures.out_of_date() == {one: ["look"] for one in pictures.every_picture()}
