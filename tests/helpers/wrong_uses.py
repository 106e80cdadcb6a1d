"""Made-up walkers, gaits, data sets and requests, for the calls of the table of messages.

And `prepare`, which writes the files that they and the command lines name.
"""

import asyncio
import inspect
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import xarray as xr
from part_of_swing import PartOfSwing
from starlette.requests import Request

import walker_jax as wj
from walker_jax import cellmaps, checks, figures, kernels, multibody, storage
from walker_jax.basins import windows
from walker_jax.execution import tiles
from walker_jax.explorer import lattice, offers, service, subjects, walks
from walker_jax.fitting.bounds import Bounds
from walker_jax.fitting.results import Fit
from walker_jax.integrators import integrator
from walker_jax.stability import gait_robustness, stochastic_map
from walker_jax.storage.schema import KINDS, TYPES, check_dataset
from walker_jax.walkers import references
from walker_jax.walking.scan import Walked

MODULES: tuple[ModuleType, ...] = (
    *(cellmaps, figures, integrator, kernels, lattice, multibody, references, stochastic_map),
    *(offers, storage, subjects, tiles, walks),
)


# ----------------------------------------------------------------------------------------- walkers


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


class Motored(wj.SimplestWalker):
    """One that something else than gravity drives, of unknown work."""

    def vector_field(self, state):
        return super().vector_field(state)


class NoRates(wj.SimplestWalker):
    """One whose vector field returns no state."""

    def vector_field(self, state):
        return jnp.stack([state.theta, state.phi])


class Stumbling(wj.SimplestWalker):
    """One that falls in a way that no failure is called."""

    def falls(self, state):
        return {"STUMBLE": state.theta - 1}


class Scattered(wj.SimplestWalker):
    """One whose fall is two numbers."""

    def falls(self, state):
        return {"FORWARD": jnp.stack([state.theta, state.phi])}


class Sunk(wj.RoundFootWalker):
    """One whose swing foot is below the slope where both feet are as high."""

    def swing_foot(self, state):
        return super().swing_foot(state) - jnp.array([0, 0.1])


class Sliding(wj.RoundFootWalker):
    """One with a joint that moves its swing foot along the slope."""

    joints = ("slide",)

    def swing_foot(self, q):
        return super().swing_foot(q) + jnp.stack([q[4], 0 * q[4]])


class Kicking(wj.SimplestWalker):
    """One whose impact leaves its section."""

    def impact(self, state):
        lifted, after = super().impact(state)
        return lifted, after._replace(phidot=after.phidot + 0.1)


class Opening(PartOfSwing):
    """A phase up to mid-stance."""

    def event(self, state):
        return -state.theta


class Phased(wj.SimplestWalker):
    """One whose strides have phases."""

    def phases(self):
        return (Opening(self),)


class Painted(wj.SimplestWalker):
    """One with a static field that is no option."""

    colour: str = eqx.field(static=True, default="red")


class Viewed(wj.SimplestWalker):
    """One with a parameter that the page's address has."""

    view: Any = 1.0


class Flat(wj.SimplestWalker):
    """One with legs of no length."""

    def clearance(self, state):
        return state.theta

    def reach(self, state):
        return 0 * state.theta


@dataclass
class Unhashable:
    """A random height, by an object that is no key of a dictionary."""

    def __call__(self, key):
        return jax.random.normal(key)


def class_in_a_function() -> type[wj.Walker]:
    class Hidden(wj.SimplestWalker):
        pass

    return Hidden


# -------------------------------------------------------------------------------------- other data


def gait(states: list, multiplier: float, *, found: bool = True) -> wj.Gait:
    """A made-up one."""
    multipliers, times = np.array([multiplier, 0j]), np.ones(len(states))
    stable = np.array(abs(multiplier) < 1)
    return wj.Gait(np.array(states), multipliers, times, stable, np.array(0.0), np.array(found))


LOST = gait([[np.nan, np.nan]], np.nan, found=False)


def where_none_is_found(call: Callable[[], object]) -> object:
    """Make a call as if a search had found no gait, which spares the search."""
    found = lambda *_, **__: LOST
    with (
        mock.patch.object(gait_robustness, "search_gait", found),
        mock.patch.object(windows, "search_gait", found),
    ):
        return call()


def zeros(kind: str, grid: str = "theta sum", size: int = 3) -> xr.Dataset:
    """A data set of a kind, over a grid of as many cells along each axis."""
    dims = {
        name: one.dims.replace("*grid", grid).replace("*parameters", "slope").split()
        for name, one in KINDS[kind].variables.items()
        if not one.when
    }
    types = {name: TYPES[KINDS[kind].variables[name].type][0] for name in dims}
    arrays = {
        name: (each, np.zeros((size,) * len(each), types[name] if types[name] != "U" else "U9"))
        for name, each in dims.items()
    }
    data = xr.Dataset(arrays, attrs=dict.fromkeys(KINDS[kind].attributes, ""))
    check_dataset(data, kind)
    return data


def viability() -> xr.Dataset:
    """One of the simplest walker with push-off, over 2 x 2 cells."""
    frame = {"axis": ("axis", ["theta", "sum"]), "upper": ("axis", [1.0, 1.0])}
    frame |= {"shear": (("coordinate", "axis"), [[1.0, 0.0], [-1.0, 1.0]])}
    about = {"section": ["theta", "thetadot"], "actions": ["push_off"], "tolerance": 1e-12}
    data = zeros("viability", size=2).assign(push_off=("action_number", [0.0]))
    centres = {name: [0.25, 0.75] for name in ("theta", "sum")}
    return data.assign(frame).assign_coords(centres).assign_attrs(about)


def walks_to(state: list, outcome: int = 0) -> Walked:
    """As many walks as the stochastic map begins with, which all end in one state."""
    count = stochastic_map.PILOT_WALKS
    return Walked(np.tile(state, (count, 1)), np.full(count, outcome), np.full(count, 8))


def without(module: str, call: Callable[[], object]) -> object:
    """Make a call as if a module were not installed."""
    with mock.patch.dict(sys.modules, {module: None}):
        return call()


def ask(what: str, body: Any, kind: str = "application/json") -> object:
    """The answer of the page's service to a request, given as JSON or as raw bytes."""
    sent = body if isinstance(body, bytes) else json.dumps(body).encode()
    headers = [(b"content-type", kind.encode())]

    async def receive():
        return {"type": "http.request", "body": sent}

    request = Request({"type": "http", "headers": headers}, receive)
    return asyncio.run(getattr(service.Service(), what)(request))


POINT = multibody.System(lambda q: q, jnp.ones(2), jnp.zeros(2))
"""A mass of two coordinates."""
TWICE = multibody.System(lambda q: jnp.stack([q[0] + q[1]] * 2), jnp.ones(2), jnp.zeros(2))
"""One of which two coordinates move the same."""


def henon(x, a=1.4, b=0.3):
    return jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])


class Unfinished(wj.System):
    section = ("x",)


class Unnamed(wj.HybridSystem):
    """One whose states are arrays, which have no names."""

    slope: float = 0.1
    section = ("x",)

    def lift(self, x):
        return x

    def project(self, state):
        return state

    def modes(self):
        ends = wj.Guard(lambda x: x[0] - 1, wj.SECTION, reset=lambda x: x - 1)
        return {"only": wj.Mode(jnp.ones_like, (ends,))}


def fit_of_nothing() -> Fit:
    """A fit of no parameter."""
    none, bounds = np.zeros((0, 0)), Bounds(np.zeros(0), np.zeros(0))
    return Fit({}, {}, none, wj.SimplestWalker(0.004), (), none, True, xr.Dataset(), bounds)


def steps_of(count: int, **changes: Any) -> dict[str, Any]:
    """Columns of steps whose angles fall evenly, with heel strikes at 0, 1, 2 and so on."""
    time = np.arange(0.05, count, 0.1)
    theta = 0.2 - 0.4 * (time % 1)
    return {"time": time, "theta": theta, "phi": 2 * theta} | changes


def names() -> dict[str, Any]:
    """Names that the calls of the table may use."""
    axes = {"theta": (0, 0.4, 10), "sum": (-0.04, 0.01, 10)}
    own = {name: one for name, one in globals().items() if inspect.isclass(one)}
    modules = {one.__name__.rpartition(".")[2]: one for one in MODULES}
    return {
        **own,
        **modules,
        **{"wj": wj, "np": np, "jnp": jnp, "jax": jax, "xr": xr, "Path": Path, "diffrax": diffrax},
        **{"sparse": scipy.sparse, "POINT": POINT, "TWICE": TWICE},
        **{"zeros": zeros, "walks_to": walks_to, "without": without, "ask": ask},
        "class_in_a_function": class_in_a_function,
        "WALKER": wj.SimplestWalker(0.004),
        "STEEP": wj.SimplestWalker(0.5),
        "STEEP_ROUND": wj.RoundFootWalker(0.5),
        "where_none_is_found": where_none_is_found,
        "MANY": jax.vmap(wj.SimplestWalker)(jnp.array([0.004, 0.005])),
        "NONE": jax.vmap(wj.SimplestWalker)(jnp.zeros(0)),
        "GRID": wj.Grid.sheared(**axes),
        "ACTED": viability(),
        "SLICE": wj.Grid.sheared(**axes, phidot=-0.05),
        "STEPS": wj.read_recordings(steps_of(2), strikes=[0, 1, 2]),
        "steps_of": steps_of,
        "FIT": fit_of_nothing(),
        "GAIT": gait([[0.2, -0.2]], 0.5),
        "UNSTABLE": gait([[0.2, -0.2]], -1.25),
        "LOST": LOST,
        "henon": henon,
        "OF_THREE": gait([[0.2, -0.2, -0.1]], 0.5),
        "OF_PERIOD_TWO": gait([[0.2, -0.2], [0.3, -0.3]], 0.5),
    }


MINE = """
import jax
import walker_jax as wj


class Mine(wj.SimplestWalker):
    stiffness: jax.Array


class Half(wj.Walker):
    pass


class Clash(wj.SimplestWalker):
    strides: jax.Array = 1.0
"""
BLOCK = ".blocked.zarr.walker-jax"
OWN_MAPS = """
import walker_jax as wj

bare = wj.Map(lambda x: x / 2, ("x", "y"))

class Line(wj.System):
    section = ("x",)

class Half(wj.HybridSystem):
    section = ("x", "y")
"""

OWN_MANY = """
import numpy as np
import walker_jax as wj

class Scaled(wj.System):
    factor: float = 0.5
    section = ("x", "y")

many = Scaled(np.ones(3))
"""
RECORDED = """time-ms,a:b,hip
0,0.2,0.1
100,0.1,0.3
200,0,0.2
"""
OWN = {"mine.py": MINE, "own_maps.py": OWN_MAPS, "own_many.py": OWN_MANY}
FILES = {**OWN, "broken.py": "x = 1 / 0", "walk.csv": RECORDED} | dict.fromkeys(
    ("empty.py", "my.walker.py", "numpy.py", "taken", "taken.nc", "taken.png", BLOCK), ""
)


def prepare(patch: pytest.MonkeyPatch) -> None:
    """Write the files that wrong uses name, in this folder; the machine has 8 GiB of memory.

    A file that is loaded has its folder searched for modules: here one is called numpy.
    """
    patch.setattr(sys, "path", sys.path.copy())
    for name, text in FILES.items():
        Path(name).write_text(text)
    Path("folder").mkdir()
    patch.setattr(checks, "memory_of_machine", lambda: 8.0 * 2**30)
