"""The programs in the pages run."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "walkers.md"


def program(title):
    """The Python program of the page that follows a comment."""
    (found,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", PAGE.read_text(), re.S)
    return found


def test_the_program_of_the_readme_gives_a_basin():
    (source,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert len(source.splitlines()) <= 6
    names: dict[str, Any] = {}
    exec(compile(source, "README.md", "exec"), names)
    assert 3000 < int((names["basin"].attractor >= 0).sum()) < 3100


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
