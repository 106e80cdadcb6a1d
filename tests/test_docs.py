"""The programs in the pages run."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import storage
from walker_jax.cli import answers, main
from walker_jax.storage.requests import canonical_json

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "walkers.md"


def program(title):
    """The Python program of the page that follows a comment."""
    (found,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", PAGE.read_text(), re.S)
    return found


def test_the_programs_of_the_readme_give_a_basin_and_a_derivative():
    sources = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    basin, derivative = sources
    assert len(basin.splitlines()) <= 6
    names: dict[str, Any] = {}
    for source in sources:
        exec(compile(source, "README.md", "exec"), names)
    assert 3000 < int((names["basin"].attractor >= 0).sum()) < 3100
    many = wj.strides(names["walker"], names["starts"])
    np.testing.assert_allclose(names["ends"].state, many.state, rtol=1e-13)
    high, low = map(names["angle_after_ten_strides"], (0.004 + 1e-8, 0.004 - 1e-8))
    assert float(names["rate"]) == pytest.approx(float(high - low) / 2e-8, rel=1e-5)
    (printed,) = re.findall(r"^rate = .*# (\S+)$", derivative, re.M)
    assert f"{names['rate']:.4f}" == printed


class Begun(BaseException):
    """A command has taken its places."""


@pytest.mark.parametrize("first", ["the first command", "the table"])
def test_the_commands_of_the_readme_run_one_after_the_other_in_one_folder(
    first, monkeypatch, tmp_path
):
    """No two of them want one place for different results, and none what is not there."""
    page = (ROOT / "README.md").read_text()
    beginning, table, rest = re.split(r"(^\| `walker-jax .*?\n\n)", page, flags=re.M | re.S)
    blocks = lambda text: re.findall(r"(?:^|&& )walker-jax ((?:[^#\n])*)", text, re.M)
    commands = blocks(beginning) if first == "the first command" else []
    commands += [*re.findall(r"^\| `(?!walker-jax)([a-z][^`]*)` \|", table, re.M), *blocks(rest)]
    assert len(commands) >= 14
    taken: dict[str, str] = {}

    def take(path, request):
        words = canonical_json(request)
        assert taken.setdefault(str(path), words) == words

    def begin(*_, **__):
        raise Begun

    def of_data(out, figure, request, *, overwrite):
        take(out, request)
        take(answers.picture_of(out, figure), request)
        raise Begun

    def of_report(out, **_):
        take(out, {"command": "reproduce"})
        raise Begun

    def of_export(data, file, **_):
        assert str(data) in taken
        take(file, {"data": str(data)})
        raise Begun

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("walker_jax.cli.main.keep_compiled", lambda: None)
    for name in ("basin", "bifurcation", "optimise", "robustness", "sweep"):
        monkeypatch.setattr(f"walker_jax.cli.{name}_command.made_before", of_data)
    monkeypatch.setattr("walker_jax.paper.reproduction.reproduce", of_report)
    monkeypatch.setattr(storage, "export", of_export)
    monkeypatch.setattr(storage, "check_picture", lambda path, request, **_: take(path, request))
    for name in ("walk", "find_gait", "find_gaits"):
        monkeypatch.setattr(wj, name, begin)
    for command in commands:
        monkeypatch.setattr(sys, "argv", ["walker-jax", *command.split()])
        with pytest.raises(Begun):
            main.main()


def test_links_within_the_pages_lead_somewhere():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.md")]
    for page in pages:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), (page.name, target)


def test_a_walker_of_your_own_takes_less_than_60_lines():
    assert len(program("a walker of your own").splitlines()) < 60


@pytest.mark.slow
def test_a_walker_of_your_own_has_a_gait_and_a_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "own"}
    exec(compile(program("a walker of your own"), PAGE.name, "exec"), names)
    assert names["gait"].stable and np.abs(names["gait"].multipliers[0]) < 1
    assert int((names["data"].fate == 0).sum()) > 500
    assert (tmp_path / "shank.png").stat().st_size > 20_000
