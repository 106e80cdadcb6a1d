"""Each public function that computes, on a problem so small that it takes about a second."""

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from reference import ROOT

import walker_jax as wj
from walker_jax.checks import PrecisionWarning
from walker_jax.systems.system import System

WALKER = wj.SimplestWalker(0.009)
X, FALL = jnp.array([0.2003, -0.1998]), jnp.array([0.3, -0.1])
MAP, CUBE = wj.systems.HenonMap(0.2, 0.3), wj.Map(lambda x: x**3, ("x", "y"))
AREA = wj.Grid.sheared(theta=(0.1, 0.3, 6), sum=(-0.02, 0.01, 6))
PLANE = wj.Grid.plain(x=(-8, 8, 8), y=(-8, 8, 8))
LABELS = np.arange(4096).reshape(64, 64) % 3


class Shrinking(System):
    """One contraction of all three coordinates: x' = m x + 1/10."""

    m: Any

    section = ("x", "y", "z")

    def advance(self, x):
        return self.m * x + 0.1, wj.Outcome.STRIDE, 1.0

    def feasible(self, x):
        return jnp.max(jnp.abs(x)) < 1

    def gait_region(self):
        return wj.Grid.plain(x=(-1, 1, 2), y=(-1, 1, 2), z=(-1, 1, 2))


class Measured(wj.SimplestWalker):
    """The simplest walker, which measures how far its legs turn."""

    def modes(self):
        turn = {"turn": lambda state: state.phidot}
        return {name: one._replace(integrals=turn) for name, one in super().modes().items()}


def place_of(machine, gait):
    return gait.states[0, 0]


@cache
def gait() -> wj.Gait:
    return wj.find_gait(WALKER)


@cache
def fixed_point() -> wj.Gait:
    return wj.find_gait(MAP, [0.6, 0.2])


@cache
def doubling() -> wj.Bifurcation:
    branch = wj.continue_gait(MAP, "a", (0.2, 0.6), fixed_point(), progress=False)
    return branch.events[0]


def noise(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.normal(size=(n, 2))


def recordings() -> Any:
    """Return three steps of the simplest walker, as encoders see them."""
    times, walker = 0.1 * np.arange(76), wj.SimplestWalker(0.009)
    theta = wj.trajectory(walker, wj.find_gait(walker).states[0], times, strides=3).theta
    return wj.read_recordings({"time": times, "theta": theta}, strikes=[0.0, 3.8825, 7.7649])


@cache
def fitted() -> Any:
    noise = {"theta": 1e-3, "time": 1e-3}
    return wj.fit(wj.SimplestWalker(0.008), recordings(), "slope", noise=noise)


def export() -> Any:
    path = ROOT / "docs" / "robots" / "compass.xml"
    robot = wj.robot(path)
    return wj.export_motion(robot, wj.find_gait(robot).states[0], path, strides=1)


def black_box() -> wj.BlackBox:
    """Return a contraction that JAX does not see; it falls from beyond 0.2."""
    halve = lambda x: (x / 2, np.abs(x).max(axis=1) < 0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        return wj.BlackBox(halve, ("x", "y"))


QUIET: dict[str, Any] = {"progress": False}
CALLS: dict[str, Callable[[], Any]] = {
    "stride": lambda: (wj.stride(WALKER, X), wj.stride(WALKER, X, step=-0.001)),
    "strides": lambda: wj.strides(WALKER, np.array([X, FALL])),
    "walk": lambda: wj.walk(WALKER, X, 2),
    "trajectory": lambda: wj.trajectory(WALKER, X, jnp.array([0.0, 1.0])),
    "integrals": lambda: wj.integrals(Measured(0.004), X),
    "phase_times": lambda: wj.phase_times(WALKER, X),
    "motion": lambda: wj.motion(WALKER, X, 2, step=0.5),
    "margins": lambda: (wj.margins(WALKER, X), wj.margins(WALKER, np.array([X, FALL]))),
    "explain": lambda: wj.explain(WALKER, FALL),
    "explain a ball": lambda: wj.explain(wj.systems.BouncingBall(0.4, 0.8), [0.7, 2.3]),
    "find_gait": lambda: wj.find_gait(WALKER),
    "find_gaits": lambda: wj.find_gaits(MAP, 1, PLANE, **QUIET),
    "descend": lambda: wj.descend(MAP, np.array([[[0.6, 0.2]]]), 2),
    "measure multipliers": lambda: wj.measure(WALKER, "multipliers", ("slope",), gait()),
    "measure speed": lambda: wj.measure(WALKER, "speed", ("slope",), gait()),
    "gait_sensitivity": lambda: wj.gait_sensitivity(WALKER, gait()),
    "measure sensitivity-norm": lambda: wj.measure(WALKER, "sensitivity-norm", ("slope",), gait()),
    "continue_gait": doubling.__wrapped__,
    "continue_event": lambda: wj.continue_event(
        MAP, doubling(), ("a", "b"), {"a": (0.2, 0.6), "b": (0.2, 0.4)}
    ),
    "bifurcation_diagram": lambda: wj.bifurcation_diagram(
        MAP, "a", (0.2, 0.5), period_max=2, strides=50, scan=4, exponents=2, **QUIET
    ),
    "chart": lambda: wj.chart(
        *(MAP, {"a": (0.1, 0.5), "b": (0.2, 0.4)}, fixed_point()),
        **{"period_max": 1, "cells": (3, 2), "strides": 5, **QUIET},
    ),
    "find_attractors": lambda: wj.find_attractors(CUBE, [X]),
    "label": lambda: wj.label(CUBE, wj.find_attractors(CUBE, [X]), X),
    "basin_volume": lambda: wj.basin_volume(
        CUBE, wj.find_attractors(CUBE, [X])[0], PLANE, samples=64, moves=4, **QUIET
    ),
    "attractors": lambda: wj.attractors(MAP, "a", [0.2], [[[0.6, 0.2]]], strides=5),
    "loss_of_walking": lambda: wj.loss_of_walking(
        MAP, "a", (0.2, 0.3), [], strides=5, resolution=1e-2
    ),
    "lyapunov": lambda: wj.lyapunov(wj.systems.HenonMap(), [0.1, 0.1], 20, walks=2, settling=5),
    "transients": lambda: wj.transients(wj.systems.HenonMap(1.6), np.zeros((9, 2)), settle=1),
    "crisis_law": lambda: wj.crisis_law(np.arange(1.0, 6.0), np.arange(1.0, 6.0) ** -2, np.ones(5)),
    "basin": lambda: wj.basin(MAP, PLANE, **QUIET),
    "compare_methods": lambda: wj.compare_methods(MAP, PLANE, strides=20),
    "refine": lambda: wj.refine(MAP, PLANE, 1, strides=20, check=9, **QUIET),
    "robustness": lambda: wj.robustness(
        MAP, PLANE, levels=1, strides=20, check=9, ground=None, **QUIET
    ),
    "robustness over values": lambda: wj.robustness(
        MAP, PLANE, values=[0.2, 0.3], parameter="a", levels=0, strides=20, check=9, **QUIET
    ),
    "sweep": lambda: wj.sweep(MAP, {"a": [0.2]}, PLANE, levels=0, check=9, strides=20, **QUIET),
    "slice_basin": lambda: wj.slice_basin(
        wj.refine(Shrinking(0.5), Shrinking(0.5).gait_region(), 1, check=0, **QUIET), "z", 0.1
    ),
    "zoom": lambda: wj.zoom(MAP, PLANE, 10.0, [0.6, 0.2], frames=2, **QUIET),
    "boundary": lambda: wj.boundary(MAP, PLANE, side=2, radius=1.0, strides=20, **QUIET),
    "boundary_point": lambda: wj.boundary_point(MAP, PLANE, [0.6, 0.2], strides=20),
    "boundary_dimension": lambda: wj.boundary_dimension(
        MAP, PLANE, distances=[0.9, 0.3, 0.1], pairs=200, strides=20, **QUIET
    ),
    "edge_state": lambda: wj.edge_state(MAP, [0.6, 0.2], [7.0, 0.2], rounds=20, strides=50),
    "stable_manifold": lambda: wj.stable_manifold(
        MAP, wj.find_gait(MAP, [-4.0, -1.2]), spacing=0.01, points=3
    ),
    "continue_basins": lambda: wj.continue_basins(
        MAP, "a", [0.2, 0.3], PLANE, samples=10, strides=20, **QUIET
    ),
    "basin_stability": lambda: wj.basin_stability(
        MAP, 0.01, fixed_point(), within=1e-3, samples=5, horizon=3
    ),
    "tipping_probability": lambda: wj.tipping_probability(
        MAP, "a", 0.3, PLANE, samples=5, strides=50
    ),
    "least_disturbance": lambda: wj.least_disturbance(
        MAP, fixed_point(), directions=90, strides=50, **QUIET
    ),
    "measure least-disturbance": lambda: wj.measure(
        MAP, "least-disturbance", ("a",), fixed_point(), directions=90, strides=50
    ),
    "measure area": lambda: wj.measure(
        MAP, "area", ("a",), grid=PLANE, levels=0, check=9, strides=20
    ),
    "measure fall-action": lambda: wj.measure(
        WALKER, "fall-action", (), gait(), strides=1, directions=2
    ),
    "pareto": lambda: wj.pareto(
        MAP, {"a": (0.1, 0.3)}, ("spectral-radius", place_of), starts=1, points=3, **QUIET
    ),
    "optimise": lambda: wj.optimise(MAP, {"a": (0.1, 0.3)}, "spectral-radius", starts=1, **QUIET),
    "viable": lambda: wj.viable(MAP, PLANE, {"a": [0.1, 0.3]}, **QUIET),
    "Policy": lambda: wj.stride(
        wj.Policy(MAP, wj.viable(MAP, PLANE, {"a": [0.1, 0.3]}, **QUIET)), [0.6, 0.2]
    ),
    "Feedback": lambda: wj.stride(
        wj.Feedback(WALKER, gait(), {"slope": [0.01, 0.0]}, {"slope": (0.005, 0.02)}), X
    ),
    "read_recordings": recordings,
    "fit": fitted.__wrapped__,
    "propagate": lambda: wj.propagate(lambda walker: walker.slope**2, fitted()),
    "robot": lambda: wj.robot(ROOT / "docs" / "robots" / "compass.xml"),
    "export_motion": export,
    "audit": lambda: wj.audit(black_box(), [0.0, 0.0], 0.1, samples=20),
    "least_step_down": lambda: wj.least_step_down(WALKER, gait(), strides=50),
    "steps_to_fall": lambda: wj.steps_to_fall(WALKER, 0.01, 8, gait=gait(), limit=9),
    "steps_to_fall by cells": lambda: wj.steps_to_fall(
        WALKER, 0.001, 2000, method="cells", gait=gait(), side=0.9, repetitions=2
    ),
    "most_probable_fall": lambda: wj.most_probable_fall(
        WALKER, 1.0, gait(), strides=1, directions=2
    ),
    "prove_gait": lambda: wj.prove_gait(WALKER),
    "prove_doubling": lambda: wj.prove_doubling(WALKER, 0.0145, 0.0155),
    "prove_basin": lambda: wj.prove_basin(WALKER, AREA, levels=1, strides=2, **QUIET),
    "fractals.basin_entropy": lambda: wj.fractals.basin_entropy(LABELS),
    "fractals.merge_regions": lambda: wj.fractals.merge_regions(LABELS, 1.0, halvings=1),
    "fractals.box_counting": lambda: wj.fractals.box_counting(np.eye(64, dtype=int)),
    "fractals.uncertainty_exponent": lambda: wj.fractals.uncertainty_exponent(
        lambda x: (x[:, 0] > 0).astype(int), noise, np.array([0.1, 0.2, 0.4]), pairs=500
    ),
    "fractals.information_dimension": lambda: wj.fractals.information_dimension(
        noise(np.random.default_rng(0), 999)
    ),
}
"""By the name of the function, and a word or two for one that has several."""
