"""Small data sets made by hand, in the form of those that the package returns."""

import numpy as np
import xarray as xr

from walker_jax import Grid, Outcome
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.escapes import CrisisLaw, Transients
from walker_jax.storage.schema import KINDS

SHEARED = Grid.sheared(theta=(0, 0.4, 80), sum=(-0.04, 0.01, 60))
PLAIN = Grid.plain(theta=(0, 0.8, 80), thetadot=(-1.2, 0, 60))


def completed(data, kind, *parameters):
    """With zeros for what else a data set of a kind holds, which pictures do not read."""
    placeholders = {"*parameters": parameters, "?parameter": parameters, "*grid": ("theta", "sum")}
    types = {"integer": int, "real": float, "boolean": bool, "text": object}
    for name, one in KINDS[kind].variables.items():
        if name not in data and not one.when:
            dims = [own for dim in one.dims.split() for own in placeholders.get(dim, (dim,))]
            shape = [data.sizes.get(dim, 2) for dim in dims]
            data = data.assign({name: (dims, np.zeros(shape, types[one.type]))})
    return data.assign_attrs(dict.fromkeys(KINDS[kind].attributes, "") | data.attrs)


def deep(data):
    """A basin over three dimensions, the same at each phidot."""
    over = {name: data[name].expand_dims(phidot=3) for name in ("fate", "attractor", "strides")}
    return data.assign(over)


def data_set(grid, fate, attractor=None, cycles=()):
    """A data set of the form that `walker_jax.basin` returns."""
    attractor = np.where(fate == Outcome.STRIDE, 0, -1) if attractor is None else attractor
    states = np.full((len(cycles), max(map(len, cycles), default=0), 2), np.nan)
    for row, cycle in zip(states, cycles, strict=True):
        row[: len(cycle)] = cycle
    cells = np.array([np.sum(attractor == i) for i in range(len(cycles))], int)
    return xr.Dataset(
        {
            "fate": (grid.names, fate.astype(np.int8)),
            "attractor": (grid.names, attractor.astype(np.int32)),
            "strides": (grid.names, np.zeros(grid.shape, np.int32)),
            "period": ("number", np.array([len(cycle) for cycle in cycles], np.int32)),
            "states": (("number", "phase", "coordinate"), states),
            "cells": ("number", cells),
            "area": ("number", cells * grid.cell_area),
            "at_border": 0,
        },
        coords={**grid.axes, "number": np.arange(len(cycles))},
        attrs={
            "walker": "SimplestWalker",
            "walker_slope": 0.0165,
            "method": "direct",
            "section": ["theta", "thetadot"],
        },
    )


def every_fate(grid=SHEARED, cycle=((0.17, -0.18), (0.19, -0.21)), fates=(7, 0, 1, 2, 3, 4, 5, 6)):
    """Bands across the picture, one of each fate; eight are wide enough for their labels."""
    width = grid.shape[1]
    bands = np.array(fates)[np.arange(width) * len(fates) // width]
    return data_set(grid, np.tile(bands, (grid.shape[0], 1)), cycles=[cycle])


BRANCHES: dict[str, list[tuple[float, list[float], float, bool]]] = {
    "long": [
        (0.010, [0.20], 0.5, True),
        (0.014, [0.24], 0.9, True),
        (0.016, [0.26], -1.1, False),
        (0.020, [0.28], -1.5, False),
    ],
    "short": [(0.010, [0.19], 3.0, False), (0.020, [0.27], 4.0, False)],
    "doubled": [
        (0.015, [0.25, 0.25], 1.0, True),
        (0.018, [0.22, 0.29], -0.6, True),
        (0.020, [0.21, 0.31], -3.0, False),
    ],
    "folded": [
        (0.020, [0.10, 0.12, 0.14], 3.0, False),
        (0.012, [0.11, 0.13, 0.15], 2.0, False),
        (0.012, [0.112, 0.132, 0.152], 0.5, True),
        (0.013, [0.115, 0.135, 0.155], 0.1, True),
    ],
}
"""Value, states, largest multiplier and stability of the points of each branch."""
EVENTS: list[tuple[bool, int, float, list[float], float, bool]] = [
    (False, 0, 0.015, [0.25], -1.0, True),
    (False, 2, 0.019, [0.215, 0.30], -1.0, True),
    (True, 3, 0.0115, [0.111, 0.131, 0.151], 1.0, False),
]
"""Whether it is a fold, branch, value, states, largest multiplier, whether of the cascade."""


def diagram(branches=BRANCHES, events=EVENTS, walks=True, lost=(0.0180, 0.0182)):
    """A data set of the form that `walker_jax.bifurcation_diagram` returns."""
    numbers = [i for i, branch in enumerate(branches.values()) for _ in branch]
    points = [point for branch in branches.values() for point in branch]

    def states(cycles):
        found = np.full((len(cycles), 3, 2), np.nan)
        for row, cycle in zip(found, cycles, strict=True):
            row[: len(cycle)] = np.column_stack([cycle, np.negative(cycle)])
        return found

    def parts(largest):
        found = np.zeros((len(largest), 2, 2))
        found[:, 0, 0] = largest
        return found

    sample = np.linspace(0.01, 0.02, 5)
    orbit = np.full((5, 2, 4, 2), np.nan)
    fate = np.full((5, 2), Outcome.FORWARD, np.int8)
    if walks:
        fate[:3, 0] = Outcome.STRIDE
        orbit[:3, 0] = 0.2 + np.arange(8).reshape(4, 2) / 100
        orbit[1, 1, :2] = 0.4  # of one that falls later
    cycle = ("phase", "coordinate")
    part = ("order", "part")
    return xr.Dataset(
        {
            "branch": ("gait", np.array(numbers, int)),
            "period": ("gait", np.array([len(point[1]) for point in points], int)),
            "value": ("gait", np.array([point[0] for point in points], float)),
            "states": (("gait", *cycle), states([point[1] for point in points])),
            "step_times": (("gait", "phase"), 3.5 + 2 * states([p[1] for p in points])[..., 0]),
            "multipliers": (("gait", *part), parts([point[2] for point in points])),
            "stable": ("gait", np.array([point[3] for point in points], bool)),
            "on_cascade": ("gait", np.isin(numbers, (0, 2))),
            "event_fold": ("event", np.array([event[0] for event in events], bool)),
            "event_branch": ("event", np.array([event[1] for event in events], int)),
            "event_period": ("event", np.array([len(event[3]) for event in events], int)),
            "event_value": ("event", np.array([event[2] for event in events], float)),
            "event_states": (("event", *cycle), states([event[3] for event in events])),
            "event_multipliers": (("event", *part), parts([event[4] for event in events])),
            "cascade": ("event", np.array([event[5] for event in events], bool)),
            "torus_branch": ("torus", np.zeros(0, int)),
            "torus_period": ("torus", np.zeros(0, int)),
            "torus_value": ("torus", np.zeros(0)),
            "torus_states": (("torus", *cycle), states([])),
            "torus_multipliers": (("torus", *part), parts([])),
            "sample_value": ("sample", sample),
            "fate": (("sample", "start"), fate),
            "strides": (("sample", "start"), np.full((5, 2), 2000)),
            "attractor_period": (("sample", "start"), np.ones((5, 2), int)),
            "orbit": (("sample", "start", "recent", "coordinate"), orbit),
            "lost": ("side", np.array(lost, float)),
        },
        attrs={"walker": "SimplestWalker", "parameter": "slope", "section": ["theta", "thetadot"]},
    )


NOTHING = diagram({}, [], walks=False, lost=(np.nan, np.nan))


def gait(period, *multipliers, stable=False, found=True):
    """A gait with these multipliers."""
    return Gait(
        states=np.full((period, 2), 0.2),
        multipliers=np.array(multipliers, complex),
        step_times=np.full(period, 3.8),
        stable=np.array(stable),
        residual=np.array(0.0),
        found=np.array(found),
    )


def robust(grid=SHEARED, **changes):
    """What `walker_jax.robustness` returns: a basin to the right of theta = 0.15, its gait at 0.2.

    The nearest start that falls is at a distance of 0.05.
    """
    theta = grid.axes["theta"][:, None]
    fate = np.where(theta > 0.15, Outcome.STRIDE, Outcome.FORWARD) + np.zeros(grid.shape, int)
    values = {
        "gait_period": 1,
        "gait_state": ("coordinate", np.array([0.2, -0.215])),
        "least_disturbance": 0.05,
        "failing_state": ("coordinate", np.array([0.15, -0.215])),
        "failure": int(Outcome.FORWARD),
        "failing_strides": 7,
    }
    data = data_set(grid, fate, cycles=[((0.2, -0.215),)]).assign(values | changes)
    return completed(data, "robustness")


def table(slopes=(0.004, 0.008, 0.012), **changes):
    """Robustness over slopes, with no gait on the last one."""
    over = {
        "total_area": [2e-3, 1e-3, 0.0],
        "total_area_error": [1e-6] * 3,
        "least_disturbance": [1e-3, 2e-3, np.nan],
        "multiplier": [0.6, 0.9, np.nan],
        "dimension_low": [1.0, 1.3, np.nan],
        "dimension": [1.05, 1.4, np.nan],
        "dimension_high": [1.1, 1.5, np.nan],
    }
    over = {name: ("slope", np.array(values)) for name, values in (over | changes).items()}
    about = {"walker": "SimplestWalker", "section": ["theta", "thetadot"]}
    data = xr.Dataset(over, {"slope": np.array(slopes)}, about)
    return completed(data, "robustness table", "slope")


FATES = np.array([-1, 0, 1, 2, 3, 4, 5, 6], np.int8)


def optimum(basins=True, **changes):
    """What `walker_jax.optimise` returns, of two parameters: one held by a limit, one at a bound.

    Run 1 leads to the optimum, by a long step and a short one.
    """
    run, stage = np.array([0, 0, 1, 1, 1, 1, 1, 1]), np.array([0, 0, 0, 0, 1, 3, -2, -2])
    slope = [0.018, 0.012, 0.010, 0.006, 0.0035, 0.003, 0.010, 0.003]
    stiffness = [0.2, 0.5, 1.0, 1.6, 2.0, 2.0, 1.0, 2.0]
    found = {
        "run": ("evaluation", run),
        "stage": ("evaluation", stage),
        "parameters": (("evaluation", "parameter"), np.stack([slope, stiffness], axis=1)),
        "value": ("evaluation", np.array([1.0, 1.5, 2.0, 3.0, 3.8, 4.0, 2.02, 4.04])),
        "start": ("parameter", np.array([0.010, 1.0])),
        "optimum": ("parameter", np.array([0.003, 2.0])),
        "objective_optimum": 4.0,
        "exact_start": 2.02,
        "exact_optimum": 4.04,
        "at_bound": ("parameter", np.array([0, 1], np.int8)),
        "binding": ("measure", np.array([False, True])),
        "converged": True,
        "out_of_time": False,
        "found": True,
        "scan_parameters": (
            ("parameter", "point"),
            np.stack([np.linspace(0.0, 0.02, 6), np.linspace(0, 2, 6)]),
        ),
        "scan_value": (
            ("parameter", "point"),
            np.array([[5.0, 3.7, 2.5, 1.5, 1.0, 0.5], [1.0, 1.5, 2.2, 2.9, 3.4, 4.0]]),
        ),
        "scan_allowed": (
            ("parameter", "point"),
            np.array([[False, True, True, False, False, True], [True] * 6]),
        ),
    }
    if basins:
        start = np.repeat(FATES, 10)[:, None] * np.ones(60, np.int8)
        fates = {"fate_start": start, "fate_optimum": start[::-1]}
        found |= {name: (("theta", "sum"), fate) for name, fate in fates.items()}
        found |= {name: (name, np.asarray(values)) for name, values in SHEARED.axes.items()}
    attrs = {
        "walker": "SpringWalker",
        "walker_slope": 0.01,
        "walker_hip_stiffness": 1.0,
        "walker_foot_radius": 0.3,
        "section": ["theta", "thetadot"],
        "objective": '{"area": 1.0}',
        "sign": 1.0,
        "bounds": '{"slope": [0.0, 0.02], "hip_stiffness": [0.0, 2.0]}',
        "limits": '{"speed": [0.06, null]}',
        "region": '{"theta": [0.0, 0.4, 80], "sum": [-0.04, 0.01, 60]}',
    }
    coords = {"parameter": ["slope", "hip_stiffness"], "measure": ["area", "speed"]}
    return completed(xr.Dataset(found, coords, attrs | changes), "optimum")


def swept(*shape):
    """A data set of the form that `walker_jax.sweep` returns, over so many values of each."""
    values = {"slope": [0.002, 0.004, 0.006], "hip_stiffness": [0.0, 2.0], "foot_mass": [0.1, 0.3]}
    over = {name: values[name][:size] for name, size in zip(values, shape, strict=False)}
    area = 0.001 * (1 + np.arange(np.prod(shape))).reshape(shape)
    failed = np.zeros(shape, int)
    failed.flat[0] = 1
    data = xr.Dataset(
        {
            "total_area": ((*over,), np.where(failed, np.nan, area)),
            "total_area_error": ((*over,), area / 10),
            "failed": ((*over,), failed),
        },
        over,
        {"walker": "PointFootWalker", "walker_leg_length": 1.0, "section": ["theta", "thetadot"]},
    )
    return completed(data, "sweep", *over)


def metastable():
    """Two cells beside each other; the third edge is along the gap, which is not drawn."""
    found = {
        "survival": 0.99,
        "mean_strides": 100.0,
        "mean_strides_error": 1.0,
        "chance": ("cell", [0.75, 0.25]),
        "centre": (("cell", "direction"), [[0.20, -0.20, 0.0], [0.22, -0.21, 0.0]]),
        "edges": (("edge", "direction"), [[0.02, -0.01, 0], [0.0, 0.01, 0], [0, 0, 0.001]]),
    }
    directions = {"direction": np.array(["theta", "thetadot", "gap"], object)}
    attributes = {"walker": "SimplestWalker", "slope": 0.009, "section": ["theta", "thetadot"]}
    return completed(xr.Dataset(found, directions, attributes), "metastable walking")


def with_exponents():
    """A diagram with Lyapunov exponents, the first of which becomes positive."""
    data = diagram()
    rates = np.stack([np.linspace(-0.5, 0.2, 5), np.linspace(-1, -1.2, 5)], axis=1)
    return data.assign(
        exponents=(("sample", "order"), rates),
        exponent_errors=(("sample", "order"), 0 * rates + 0.01),
    )


def charted(points=5):
    """A data set of the form that `walker_jax.chart` returns: a fold and a subcritical doubling."""
    line = np.linspace(0, 1, points)
    values = np.concatenate([np.stack([line, line], axis=1), np.stack([line, 1 - line], axis=1)])
    fate = np.zeros((6, 4), int)
    fate[0], fate[1] = -1, Outcome.FORWARD
    period = np.arange(24).reshape(6, 4) % 11
    return xr.Dataset(
        {
            "curve": ("point", np.repeat([0, 1], points)),
            "curve_value": (("point", "parameter"), values),
            "curve_states": (("point", "phase", "coordinate"), np.zeros((2 * points, 1, 2))),
            "curve_multipliers": (("point", "order", "part"), np.ones((2 * points, 2, 2))),
            "curve_coefficient": ("point", np.full(2 * points, -1.0)),
            "line_kind": ("line", [0, 1]),
            "line_period": ("line", [1, 2]),
            "line_end": (("line", "end"), [[0, 1], [0, 0]]),
            "special_kind": ("special", [0]),
            "special_curve": ("special", [0]),
            "special_value": (("special", "parameter"), [[0.5, 0.5]]),
            "special_states": (("special", "phase", "coordinate"), np.zeros((1, 1, 2))),
            "special_multipliers": (("special", "order", "part"), np.ones((1, 2, 2))),
            "cell_fate": (("first", "second"), fate),
            "cell_period": (("first", "second"), period),
        },
        coords={
            "parameter": np.array(["slope", "hip_stiffness"], object),
            "first": np.linspace(0, 1, 6),
            "second": np.linspace(0, 1, 4),
        },
        attrs={
            "walker": "SpringWalker",
            "section": ["theta", "thetadot"],
            "line_kinds": ["fold", "doubling", "neimark-sacker", "branch point"],
            "line_ends": ["the end of the range", "the curve closes"],
            "special_kinds": ["cusp"],
        },
    )


def transients():
    """A saddle along a line, of which two walks leave."""
    theta = np.linspace(0.2, 0.3, 50)
    saddle = np.column_stack([theta, 0.01 - 0.9 * theta])
    ways = np.stack([saddle[:8] - [0.01 * n, 0.0] for n in (1, 2)])
    lives, section = np.array([30, 40]), ("theta", "thetadot")
    how = 0.01, 0.005, 0.02, 100.0, lives, np.ones(2, bool), saddle, np.array([0.4, -1.7]), 1.24
    return Transients(*how, ways, section)


def lives():
    """Mean lives beyond a crisis at 0.019, and their law."""
    values = 0.019 + np.geomspace(1e-6, 1e-4, 6)
    years = 100 * ((values - 0.019) / 1e-5) ** -0.8
    return values, years, 0.02 * years, CrisisLaw(0.019, 0.8, 0.7, 0.9, 1.2)


def fitted(steps):
    """A fit of two columns to steps of sines, with residuals of one noise, and two parameters."""
    rng, time = np.random.default_rng(0), np.linspace(0.1, 3, 30)
    angles = np.stack([0.2 * np.cos(time), 0.4 * np.cos(time)], axis=-1) + np.zeros((steps, 1, 1))
    noise = rng.normal(size=angles.shape)
    begin = 3.2 * np.arange(steps)
    data = xr.Dataset(
        {
            "time": (("step", "sample"), begin[:, None] + time),
            "begin": ("step", begin),
            "recorded": (("step", "sample", "column"), angles + 1e-3 * noise),
            "fitted": (("step", "sample", "column"), angles),
            "residual": (("step", "sample", "column"), noise),
            "covariance": (("parameter", "other"), np.array([[4.0, -1.0], [-1.0, 1.0]])),
        },
        {"column": ["theta", "phi"], "parameter": ["slope", "foot_mass"]},
        {"walker": "PointFootWalker", "walker_slope": 0.009, "walker_foot_mass": 0.05}
        | {"sum_of_squares": float(np.sum(noise**2)), "degrees_of_freedom": noise.size - 20},
    )
    return completed(data, "fit")
