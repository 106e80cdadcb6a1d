"""How long does each function take for each of the systems other than walkers?

One process measures one model: its gait, the basin and four levels of its refinement in a window
around the gait, the least disturbance, the edge state towards the nearest start that fails, the
dimension of the boundary, a branch of gaits, the gradient of the area, and an optimum of the area.
It prints the seconds of the first call, which compiles, and of the second, and the result. Models
with a section of one coordinate have no refinement, gradient or optimum of an area; those with more
than two are measured in a slice through the gait.

    WALKER_JAX_CACHE_DIR= python benchmarks/models.py [MODEL ...]
"""

import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

import walker_jax as wj

jax.config.update("jax_enable_x64", True)


class Case(NamedTuple):
    """A model, a window of its section, and what is changed."""

    system: wj.System
    window: Mapping[str, tuple[float, float, int]]
    over: tuple[str, float, float]
    """A parameter and its range: of a branch, and of an optimum."""
    strides: int = 200


CASES = {
    "henon": Case(
        wj.systems.HenonMap(1.02), {"x": (-2, 2, 100), "y": (-2, 2, 100)}, ("a", 0.9, 1.1), 1000
    ),
    "duffing": Case(
        wj.systems.DuffingOscillator(),
        {"x": (-2, 2, 60), "v": (-2, 2, 60)},
        ("force", 0.24, 0.25),
        1000,
    ),
    "bouncing-ball": Case(
        wj.systems.BouncingBall(),
        {"angle": (0, 2, 60), "velocity": (1, 5, 60)},
        ("amplitude", 0.4, 0.6),
    ),
    "impact-oscillator": Case(
        wj.systems.ImpactOscillator(),
        {"angle": (0, 3.1, 60), "v": (-2, -0.1, 60)},
        ("stop", -0.1, 0.1),
    ),
    "runner": Case(
        wj.systems.SpringMassRunner(), {"apex": (0.9, 2.2, 400)}, ("stiffness", 24.0, 27.0)
    ),
    "runner-with-retraction": Case(
        wj.systems.SpringMassRunner(retraction=0.1),
        {"apex": (0.9, 2.2, 400)},
        ("retraction", 0.05, 0.15),
    ),
    "quadruped": Case(
        wj.systems.BoundingQuadruped(),
        {"height": (0.9, 1.2, 60), "pitch_rate": (0.2, 1.2, 60)},
        ("stiffness", 10.5, 11.5),
    ),
    "hopper": Case(
        wj.systems.RaibertHopper(),
        {"apex": (0.9, 3, 60), "speed": (-1.5, 2.5, 60)},
        ("thrust", 0.05, 0.07),
    ),
    "torso-wheel": Case(
        wj.systems.TorsoWheel(0.0),
        {"thetadot": (-1, 0, 60), "psi": (-0.2, 1.5, 60)},
        ("lean", 0.45, 0.55),
    ),
    "switched-compass": Case(
        wj.systems.SwitchedCompass(0.04),
        {"theta": (0.05, 0.45, 60), "thetadot": (-0.6, -0.1, 60)},
        ("torque", 0.0, 0.05),
    ),
    "five-link-biped": Case(
        wj.systems.FiveLinkBiped(),
        {"stance_thigh_rate": (0, 4, 20), "torso": (-0.6, 0.9, 20)},
        ("lean", 0.12, 0.18),
    ),
}


def timed(name: str, job: Callable[[], Any], say: Callable[[Any], str]) -> Any:
    """Time a job twice, print a line, and return its result; None if it fails."""
    seconds, found = [], None
    for _ in range(2):
        began = time.perf_counter()
        try:
            found = job()
        except (wj.ComputationFailed, ValueError) as error:
            print(f"    {name:20} {'':16} {' '.join(str(error).split())[:80]}", flush=True)
            return None
        seconds.append(time.perf_counter() - began)
    print(f"    {name:20} {seconds[0]:7.2f} {seconds[1]:7.2f}  {say(found)}", flush=True)
    return found


def nearest_failure(data, gait: np.ndarray, grid: wj.Grid) -> np.ndarray:
    """The centre nearest to a gait from which a walk fails, or ends elsewhere."""
    xs = grid.centres(np.arange(grid.size))
    here = data["attractor"].values.ravel()
    home = here[np.abs(xs - gait).max(axis=1).argmin()]
    away = xs[(here != home) & (data["fate"].values.ravel() != wj.Outcome.OUTSIDE)]
    return away[np.abs(away - gait).max(axis=1).argmin()]


def survey(name: str, case: Case) -> None:
    system, (parameter, low, high) = case.system, case.over
    print(f"{name}: {system}")
    gait = timed(
        "find_gait",
        lambda: wj.find_gait(system),
        lambda one: f"{one.states[0].round(9)}, largest multiplier {abs(one.multipliers[0]):.9g}",
    )
    if gait is None:
        return
    at = dict(zip(system.section, map(float, gait.states[0]), strict=True))
    whole = set(case.window) == set(system.section)
    axes: dict[str, Any] = dict(case.window)
    grid = wj.Grid.plain(**axes) if whole else wj.Grid.through(at, **axes)
    area = lambda one: f"area {float(one.area.sum()):.6g}, periods {one.period.values.tolist()}"
    options: dict[str, Any] = {"strides": case.strides}
    data = timed("basin", lambda: wj.basin(system, grid, "direct", **options), area)
    if data is None or not len(data.number):
        return
    if not gait.stable:
        start, period = data.states.values[0, 0], int(data.period[0])
        gait = timed(
            f"the cycle of {period}",
            lambda: wj.find_gait(system, start, period),
            lambda one: (
                f"{one.states[0].round(9)}, largest multiplier {abs(one.multipliers[0]):.9g}"
            ),
        )
    plane = grid.shape if len(grid.shape) == 2 else None
    if plane:
        check = {"check": 1000}
        timed("refine", lambda: wj.refine(system, grid, 3, **check, **options), area)
    in_plane = np.array([[float(one == axis) for one in system.section] for axis in case.window])
    timed(
        "least_disturbance",
        lambda: wj.least_disturbance(system, gait, along=in_plane, directions=256),
        lambda one: f"{one.size:.9g}, {one.failure.name}",
    )
    away = nearest_failure(data, np.asarray(gait.states[0]), grid)
    timed(
        "edge_state",
        lambda: wj.edge_state(system, np.asarray(gait.states[0]), away),
        lambda one: one.kind or "none: another label is between",
    )
    timed(
        "boundary_dimension",
        lambda: wj.boundary_dimension(system, grid, pairs=20_000, **options),
        lambda one: f"{one.value:.4f} ({one.low:.3f} to {one.high:.3f})",
    )
    timed(
        "continue_gait",
        lambda: wj.continue_gait(system, parameter, (low, high), gait),
        lambda one: f"{parameter}: {len(one.values)} gaits, {one.ends[-1]}",
    )
    if plane:
        timed(
            "area and derivative",
            lambda: wj.measure(system, "area", [parameter], grid=grid, check=0, **options),
            lambda one: f"by {parameter} {one.gradient[0]:.4g} +- {one.gradient_error[0]:.1g}",
        )
        timed(
            "optimise",
            lambda: wj.optimise(
                system, {parameter: (low, high)}, grid=grid, starts=1, levels=2, **options
            ),
            lambda one: f"area {float(one.value.max()):.6g}",
        )


if __name__ == "__main__":
    for name in sys.argv[1:] or CASES:
        survey(name, CASES[name])
