"""The table of messages: a wrong use, and the whole line that it brings.

`data/messages.txt` holds them, calls after >>> and command lines after $. Each message names the
argument, and says what it must be or what to do instead, in one line of less than 200 characters.
The calls run in a process of their own, without the checks of signatures of the tests.
"""

import inspect
import json
import operator
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import figures
from walker_jax.checks import WrongUse
from walker_jax.cli import app, main

ROWS = Path(__file__).parent.joinpath("data", "messages.txt").read_text().split("\n\n")
TABLE = dict(row.strip().split("\n") for row in ROWS)
"""Wrong uses, and the message that each brings; of command lines, the exit code is 2 too."""
CALL, LINE = ">>> ", "$ walker-jax"


class Five(NamedTuple):
    """A full state of five variables."""

    theta: Any
    phi: Any
    thetadot: Any
    phidot: Any
    bend: Any


class FiveFromLift(wj.SimplestWalker):
    """One whose `lift` returns another state than it says."""

    def lift(self, x):
        return Five(*super().lift(x), x[0])


class FiveOfState(FiveFromLift):
    """One that says so, and has the methods for four variables."""

    state = Five


def gait(states: list, multiplier: float, *, found: bool = True) -> wj.Gait:
    """A made-up one."""
    multipliers, times = np.array([multiplier, 0j]), np.ones(len(states))
    stable = np.array(abs(multiplier) < 1)
    return wj.Gait(np.array(states), multipliers, times, stable, np.array(0.0), np.array(found))


def names() -> dict[str, Any]:
    """What the calls of the table may use."""
    axes = {"theta": (0, 0.4, 10), "sum": (-0.04, 0.01, 10)}
    return {
        **{"wj": wj, "np": np, "jax": jax, "xr": xr, "figures": figures, "Path": Path},
        **{"FiveFromLift": FiveFromLift, "FiveOfState": FiveOfState},
        "WALKER": wj.SimplestWalker(0.004),
        "MANY": jax.vmap(wj.SimplestWalker)(jnp.array([0.004, 0.005])),
        "GRID": wj.Grid.sheared(**axes),
        "SLICE": wj.Grid.sheared(**axes, phidot=-0.05),
        "GAIT": gait([[0.2, -0.2]], 0.5),
        "UNSTABLE": gait([[0.2, -0.2]], -1.25),
        "LOST": gait([[np.nan, np.nan]], np.nan, found=False),
        "OF_THREE": gait([[0.2, -0.2, -0.1]], 0.5),
        "OF_PERIOD_TWO": gait([[0.2, -0.2], [0.3, -0.3]], 0.5),
    }


def message_of(call: str, known: dict[str, Any]) -> tuple[str, BaseException]:
    """What a call is told."""
    with pytest.raises(WrongUse) as error:
        eval(call, dict(known))
    return str(error.value), error.value


def line_of(line: str) -> tuple[str, BaseException]:
    """What a command line is told; it must be wrong usage."""
    with pytest.raises(Exception) as error:
        app.app(shlex.split(line), standalone_mode=False)
    code, reason = main.verdict(error.value)
    assert code == 2, (line, reason)
    return main.on_one_line(reason), error.value


@pytest.fixture(scope="module")
def told() -> dict[str, str]:
    """What each wrong use is told, from one process for all."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("use", TABLE)
def test_wrong_use_is_told_what_to_do(told, use):
    assert told[use] == TABLE[use]


PUBLIC = {name: getattr(wj, name) for name in wj.__all__}
HOMES = SimpleNamespace(**PUBLIC, GRID=wj.Grid, figures=figures)
"""Where the names that calls of the table begin with are found."""


@pytest.mark.parametrize("use", TABLE)
def test_each_message_is_one_short_line_that_names_the_argument(use):
    message = TABLE[use]
    assert len(f"walker-jax: {message}") < 200 and not message.endswith((".", " "))
    known = {*re.findall(r"[\w.-]+", use), *vars(wj.SimplestWalker(0.004)), *dir(wj.SimplestWalker)}
    if use.startswith(LINE):
        command = use.removeprefix(LINE).split()[0]
        options = app.load(command).params if command in app.COMMANDS else []
        known |= {name for one in options for name in (*one.opts, one.opts[0].upper())}
        known |= {"Got", "No"}  # which begin lines of click's own that quote what was typed
    for name in re.findall(r"\b(?:wj\.|(?=figures|GRID))([\w.]+)\(", use):
        home = operator.attrgetter(name)(HOMES)
        known |= {*inspect.signature(home).parameters, "parameter"}
    first = re.match(r"-{0,2}\w+(?:-\w+|\.avi)*", message)
    assert first is not None and first[0] in known


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    os.chdir(tempfile.mkdtemp())
    known = names()
    answer = lambda use: (
        message_of(use.removeprefix(CALL), known)
        if use.startswith(CALL)
        else line_of(use.removeprefix(LINE))
    )
    print(json.dumps({use: answer(use) for use in TABLE}))
