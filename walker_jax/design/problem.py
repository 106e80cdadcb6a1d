"""A design problem: the walker, its free parameters, the objective, and limits and their slack."""

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.basins.attractor_search import sample_indices
from walker_jax.checks import WrongUse, check_kind, is_number
from walker_jax.design.area_gradients import Density, density_at
from walker_jax.design.measures import GAIT_MEASURES, gait_measures
from walker_jax.gaits.cycles import Gait
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, describe_source, value_of, with_values

OBJECTIVES = {
    "area": 1.0,
    "volume": 1.0,
    "basin-stability": 1.0,
    "least-disturbance": 1.0,
    "speed": 1.0,
    "step-length": 1.0,
    "spectral-radius": -1.0,
    "sensitivity-norm": -1.0,
    "cost-of-transport": -1.0,
}
"""Objectives of design: 1 if more is better, -1 if less is."""
SIZES = {"area": 2, "volume": 3, "basin-stability": 2}
"""Objectives that measure the basin in a grid, and the grid's number of axes."""

DENSITY_CELLS = 10_000
"""Number of cells at which densities are compared."""
MAX_NEWTON_STEPS = 20
"""Most Newton steps to a place that keeps the limits; each roughly squares the error."""
MAX_VIOLATION = 1e-9
"""Largest relative violation of a limit: the error left by the last Newton step."""
BINDING_SLACK = 1e-6
"""Distance below which a limit or bound counts as reached, relative to the limit or to the width of
the bounds; well above `MAX_VIOLATION`."""


class Problem(NamedTuple):
    """A walker, its free parameters, an objective and limits."""

    walker: System
    names: tuple[str, ...]
    """Names of the free parameters."""
    low: Float[np.ndarray, " parameters"]
    high: Float[np.ndarray, " parameters"]
    weights: dict[str, float]
    """Weights of the measures in the objective."""
    sign: float
    """1 if the objective is maximised, -1 if it is minimised."""
    limits: dict[str, tuple[float, float]]
    """Lowest and highest allowed value of measures of the gait."""
    grid: Grid | None
    levels: int
    strides: int
    seed: int
    tolerance: float | None
    density: Density | None = None
    """Density of starts, for basin stability."""

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures in the objective, and those that have limits."""
        return tuple(dict.fromkeys([*self.weights, *self.limits]))

    @property
    def size(self) -> str:
        """The objective that measures the basin, if there is one; otherwise empty."""
        return next((name for name in SIZES if name in self.weights), "")

    def values(self, place: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Return the parameters at a place, exact at the bounds 0 and 1."""
        inner = self.low + (self.high - self.low) * place
        return np.where(place == 0, self.low, np.where(place == 1, self.high, inner))

    def place_of(
        self, values: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, " parameters"]:
        """Return the place of parameters between their bounds, from 0 to 1."""
        return (values - self.low) / (self.high - self.low)

    def walker_at(self, values: Float[np.ndarray, " parameters"]) -> System:
        """Return the walker with these values of the free parameters."""
        arrays = (jnp.asarray(float(value)) for value in values)
        return with_values(self.walker, zip(self.names, arrays, strict=True))

    def refusal(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Say why the walker's constructor refuses these parameters; empty if it accepts them."""
        try:
            check_parameter(self.walker_at(values), self.names[0], float(values[0]))
        except ValueError as error:
            return str(error)
        return ""

    def describe_values(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Describe the free parameters and their values in words."""
        pairs = zip(self.names, values, strict=True)
        return ", ".join(f"{name} {value:.6g}" for name, value in pairs)


def parse_objective(objective: str | Mapping[str, Any]) -> tuple[dict[str, float], float]:
    """Return the checked weights of an objective, and its sign as in `Problem`."""
    named = isinstance(objective, str)
    if not named:
        check_kind("objective", objective, Mapping)
    given = {objective: 1.0} if named else dict(objective)
    if not given:
        raise WrongUse("objective must name at least one measure, not none", of="objective")
    for name, weight in given.items():
        if name not in OBJECTIVES:
            raise WrongUse(
                f"objective must be one of {', '.join(OBJECTIVES)}, not {name!r}", of="objective"
            )
        if not (is_number(weight) and np.isfinite(weight) and weight != 0):
            raise WrongUse(
                f"objective must give {name} a weight other than 0, not {weight}", of="objective"
            )
    if len({*SIZES} & {*given}) > 1:
        raise WrongUse(
            "objective must have an area, a volume or basin-stability, as there is one grid, not "
            "several",
            of="objective",
        )
    weights = {name: float(weight) for name, weight in given.items()}
    return weights, OBJECTIVES[objective] if named else 1.0


def default_levels(objective: str | Mapping[str, Any]) -> int:
    """Return the levels at both ends; each takes four times as long for a volume, else twice."""
    return 2 if "volume" in objective else 4


def parse_limits(
    at_least: Mapping[str, Any] | None, at_most: Mapping[str, Any] | None
) -> dict[str, tuple[float, float]]:
    """Return the checked lowest and highest value of each measure that has limits."""
    limits: dict[str, tuple[float, float]] = {}
    for side, given in enumerate((at_least, at_most)):
        given = {} if given is None else given
        check_kind("limits", given, Mapping)
        for name, value in given.items():
            if name not in GAIT_MEASURES:
                known = ", ".join(GAIT_MEASURES)
                raise WrongUse(
                    f"at_least and at_most must be of one of {known}, not of {name!r}",
                    of="at_least at_most",
                )
            if not (is_number(value) and np.isfinite(value)):
                raise WrongUse(
                    f"at_least and at_most of {name} must be finite numbers, not {value!r}",
                    of="at_least at_most",
                )
            pair = list(limits.get(name, (-np.inf, np.inf)))
            pair[side] = float(value)
            limits[name] = pair[0], pair[1]
    for name, (low, high) in limits.items():
        if low > high:
            raise WrongUse(
                f"at_least {name} must be below at_most, not {low:g} and {high:g}",
                of="at_least at_most",
            )
    return limits


def check_bounds(walker: System, name: str, ends: Any) -> None:
    """Refuse bounds that are not two numbers allowed for the walker, the lower one first."""
    try:
        low, high = map(float, ends)
    except (TypeError, ValueError):
        raise WrongUse(f"bounds of {name} must be two numbers, not {ends!r}", of="bounds") from None
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise WrongUse(
            f"bounds of {name} must be finite, the lower first, not {low:g}:{high:g}", of="bounds"
        )
    check_parameter(walker, name, low, high)


def starting_places(problem: Problem, starts: int) -> list[Float[np.ndarray, " parameters"]]:
    """Return the walker's own place, if within the bounds, and a Latin hypercube of others."""
    own = problem.place_of(
        np.array([float(value_of(problem.walker, name)) for name in problem.names])
    )
    first = [own] if np.all((own >= 0) & (own <= 1)) else []
    return [*first, *latin_hypercube(starts - len(first), len(own), problem.seed)]


def latin_hypercube(n: int, axes: int, seed: int) -> Float[np.ndarray, "n axes"]:
    """Draw one random place in each of n layers along every axis, from 0 to 1.

    As `scipy.stats.qmc.LatinHypercube`, which takes a second to import.
    """
    (rng,) = np.random.default_rng(seed).spawn(1)
    within = rng.uniform(size=(n, axes))
    layers = np.tile(np.arange(1, n + 1), (axes, 1))
    for row in layers:
        rng.shuffle(row)
    return (layers.T - within) / max(n, 1)


def describe_problem(problem: Problem) -> dict:
    """Describe the problem as attributes of a data set."""
    bounds = zip(problem.names, problem.low.tolist(), problem.high.tolist(), strict=True)
    limits = {
        name: [end if np.isfinite(end) else None for end in ends]
        for name, ends in problem.limits.items()
    }
    return {
        **describe_source(problem.walker),
        "objective": json.dumps(problem.weights),
        "sign": problem.sign,
        "bounds": json.dumps({name: ends for name, *ends in bounds}),
        "limits": json.dumps(limits),
        "region": json.dumps(describe_region(problem.grid)),
        "levels": problem.levels,
        "strides_followed": problem.strides,
        "seed": problem.seed,
        "tolerance": problem.tolerance or 0.0,
        **describe_density(problem),
    }


def describe_region(grid: Grid | None) -> dict:
    """Describe a grid's axes, and origin and directions unless the axes' names imply them."""
    if grid is None:
        return {}
    origin, shear = np.asarray(grid.origin), np.asarray(grid.shear)
    by_names = np.eye(*shear.shape)
    if grid.names[:2] == ("theta", "sum"):
        by_names[1, 0] = -1
    if not origin.any() and np.array_equal(shear, by_names):
        return grid.box
    return grid.box | {"origin": origin.tolist(), "shear": shear.tolist()}


def describe_density(problem: Problem) -> dict:
    """Hash the values of the density, if there is one, in some cells of the grid."""
    if problem.density is None or problem.grid is None:
        return {}
    cells = sample_indices(problem.grid.size, DENSITY_CELLS)
    values = density_at(problem.density, problem.grid.centres(cells))
    return {"density": hashlib.sha256(values.tobytes()).hexdigest()[:16]}


class Slack(NamedTuple):
    """Relative slack of a limit, negative if the limit is violated, and its gradient by place."""

    name: str
    value: float
    gradient: Float[np.ndarray, " parameters"]


class Limits:
    """The limits of a problem, evaluated at places, with a cache of the results."""

    def __init__(
        self, problem: Problem, gait_of: Callable[[Float[np.ndarray, " parameters"]], Gait]
    ):
        self.problem, self.gait_of = problem, gait_of
        self.known: dict[bytes, list[Slack]] = {}

    def slacks(self, place: Float[np.ndarray, " parameters"]) -> list[Slack]:
        """Return the slacks of all limits at a place; NaN if there is no gait."""
        problem, values = self.problem, self.problem.values(place)
        if not problem.limits:
            return []
        if values.tobytes() in self.known:
            return self.known[values.tobytes()]
        walker, gait = problem.walker_at(values), self.gait_of(values)
        measures = gait_measures(walker, problem.names, gait, tolerance=problem.tolerance)
        found = []
        for name, ends in problem.limits.items():
            for limit, side in zip(ends, (1, -1), strict=True):
                if np.isfinite(limit):
                    scale = side / (abs(limit) or 1.0)
                    value, gradient = measures[name]
                    gradient = gradient * (problem.high - problem.low)
                    found.append(Slack(name, scale * (value - limit), scale * gradient))
        self.known[values.tobytes()] = found
        return found

    def nearest_allowed(
        self, place: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, " parameters"] | None:
        """Return the place, or one near it that keeps all limits; None if none is found."""
        violating = None
        for _ in range(MAX_NEWTON_STEPS):
            if self.problem.refusal(self.problem.values(place)):
                return None
            found = self.slacks(place)
            broken = [one for one in found if not one.value >= -MAX_VIOLATION]
            if not broken:
                smallest = min((one.value for one in found), default=0.0)
                if violating is None or smallest < BINDING_SLACK:
                    return place
                return self.crossing(place, violating)  # the Newton step was too long
            violating, worst = place, min(broken, key=lambda one: one.value)
            at_bound = ((place == 0) & (worst.gradient < 0)) | ((place == 1) & (worst.gradient > 0))
            gradient = np.where(at_bound, 0.0, worst.gradient)
            if not (np.isfinite(worst.value) and np.sum(gradient**2) > 0):
                return None
            place = np.clip(place - worst.value * gradient / np.sum(gradient**2), 0, 1)
        return None

    def crossing(
        self,
        within: Float[np.ndarray, " parameters"],
        violating: Float[np.ndarray, " parameters"],
    ) -> Float[np.ndarray, " parameters"]:
        """Find where a limit binds, between a place that keeps it and one that violates it."""

        def smallest_slack(share: float) -> float:
            slack = min(one.value for one in self.slacks(within + share * (violating - within)))
            return slack if np.isfinite(slack) else -1.0

        from scipy.optimize import brentq

        share: Any = brentq(smallest_slack, 0.0, 1.0, xtol=1e-13)
        return within + share * (violating - within)

    def feasible_direction(
        self,
        place: Float[np.ndarray, " parameters"],
        direction: Float[np.ndarray, " parameters"],
    ) -> Float[np.ndarray, " parameters"]:
        """Project a direction so that it crosses neither bounds nor binding limits."""
        binding = [one.gradient for one in self.slacks(place) if one.value < BINDING_SLACK]
        for _ in range(1 + len(place)):
            leaves = ((place == 0) & (direction < 0)) | ((place == 1) & (direction > 0))
            direction = np.where(leaves, 0.0, direction)
            for gradient in (np.where(leaves, 0.0, one) for one in binding):
                if direction @ gradient < 0:
                    direction = direction - (direction @ gradient) / np.sum(gradient**2) * gradient
        return direction

    def binding(self, place: Float[np.ndarray, " parameters"]) -> set[str]:
        """Return the measures whose limits bind at a place."""
        return {one.name for one in self.slacks(place) if one.value < BINDING_SLACK}
