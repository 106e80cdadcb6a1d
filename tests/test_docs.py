"""The programs in the pages run."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PAGE = Path(__file__).parent.parent / "docs" / "walkers.md"


def program(title):
    """The Python program of the page that follows a comment."""
    (found,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", PAGE.read_text(), re.S)
    return found


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
