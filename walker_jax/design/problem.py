"""A design problem: the walker, its free parameters, the objective, and limits."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from walker_jax.basins.attractor_search import sample_indices
from walker_jax.checks import WrongUse, check_kind, is_number
from walker_jax.design.area_gradients import Density, density_at
from walker_jax.design.measures import GAIT_MEASURES, GaitFunction
from walker_jax.design.tolerances import Tolerances
from walker_jax.fingerprints import code_fingerprint
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.choices import Choice, numbers_chosen, values_of
from walker_jax.walkers.parameters import check_parameter, describe_source, with_values

OBJECTIVES = {
    "area": 1.0,
    "volume": 1.0,
    "basin-stability": 1.0,
    "least-disturbance": 1.0,
    "fall-action": 1.0,
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
MOST_SHOWN = 8
"""Most parameters whose values progress bars and notes tell one by one."""
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
    functions: Mapping[str, GaitFunction] = MappingProxyType({})
    """Functions of a gait among the measures, by name."""
    over: Tolerances | None = None
    """Draws of uncertain parameters, over which the objective is a mean."""

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures in the objective, and those that have limits."""
        return tuple(dict.fromkeys([*self.weights, *self.limits]))

    @property
    def size(self) -> str:
        """The objective that measures the basin, if there is one; otherwise empty."""
        return next((name for name in SIZES if name in self.weights), "")

    @property
    def free(self) -> Bool[np.ndarray, " parameters"]:
        """Whether each parameter has no bounds; its place is then its value."""
        return np.isinf(self.low)

    @property
    def scale(self) -> Float[np.ndarray, " parameters"]:
        """The change of each parameter per unit of its place."""
        return np.where(self.free, 1.0, self.high - self.low)

    @property
    def ends(self) -> Float[np.ndarray, "2 parameters"]:
        """The lowest and the highest places, 0 and 1, or infinite."""
        return np.where(self.free, [[-np.inf], [np.inf]], [[0.0], [1.0]])

    def values(self, place: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Return the parameters at a place, exact at the bounds 0 and 1."""
        inner = np.where(self.free, 0.0, self.low) + self.scale * place
        lowest, highest = self.ends
        return np.where(place == lowest, self.low, np.where(place == highest, self.high, inner))

    def place_of(
        self, values: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, " parameters"]:
        """Return the place of parameters between their bounds, from 0 to 1."""
        return (values - np.where(self.free, 0.0, self.low)) / self.scale

    def within(self, place: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Return the nearest place between the bounds."""
        return np.clip(place, *self.ends)

    def walker_at(self, values: Float[np.ndarray, " parameters"]) -> System:
        """Return the walker with these values of the free parameters."""
        changed = with_values(self.walker, zip(self.names, values.tolist(), strict=True))
        return jax.tree.map(jnp.asarray, changed)

    def refusal(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Say why the walker's constructor refuses these parameters; empty if it accepts them."""
        try:
            check_parameter(self.walker_at(values), self.names[0], float(values[0]))
        except ValueError as error:
            return str(error)
        return ""

    def describe_values(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Describe the free parameters and their values in words."""
        pairs = [*zip(self.names, values, strict=True)]
        if len(pairs) > MOST_SHOWN:
            return f"{pairs[0][0]} {values[0]:.6g} and {len(pairs) - 1} other numbers"
        return ", ".join(f"{name} {value:.6g}" for name, value in pairs)


def name_functions(*given: Any) -> tuple[list[Any], dict[str, GaitFunction]]:
    """Return an objective and limits with names in place of functions, and these by name."""
    functions: dict[str, GaitFunction] = {}

    def named(one: Any) -> Any:
        if not callable(one):
            return one
        name = getattr(one, "__name__", type(one).__name__)
        if name in OBJECTIVES or functions.setdefault(name, one) is not one:
            raise WrongUse(
                f"objective must have functions of names of their own, not {name!r}",
                of="objective",
            )
        return name

    keys = lambda one: {named(k): v for k, v in one.items()} if isinstance(one, Mapping) else one
    return [named(keys(one)) for one in given], functions


def parse_objective(
    objective: str | Mapping[str, Any], further: Mapping[str, float] = MappingProxyType({})
) -> tuple[dict[str, float], float]:
    """Return the checked weights of an objective, and its sign as in `Problem`.

    `further` are the signs of measures of one's own.
    """
    senses = OBJECTIVES | dict(further)
    named = isinstance(objective, str)
    if not named:
        check_kind("objective", objective, Mapping)
    given = {objective: 1.0} if named else dict(objective)
    if not given:
        raise WrongUse("objective must name at least one measure, not none", of="objective")
    for name, weight in given.items():
        if name not in senses:
            raise WrongUse(
                f"objective must be one of {', '.join(senses)}, not {name!r}", of="objective"
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
    return weights, senses[objective] if named else 1.0


def default_levels(objective: str | Mapping[str, Any]) -> int:
    """Return the levels at both ends; each takes four times as long for a volume, else twice."""
    return 2 if "volume" in objective else 4


def parse_limits(
    at_least: Mapping[str, Any] | None,
    at_most: Mapping[str, Any] | None,
    further: Iterable[str] = (),
) -> dict[str, tuple[float, float]]:
    """Return the checked lowest and highest value of each measure that has limits."""
    limits: dict[str, tuple[float, float]] = {}
    measures = (*GAIT_MEASURES, *further)
    for side, given in enumerate((at_least, at_most)):
        given = {} if given is None else given
        check_kind("limits", given, Mapping)
        for name, value in given.items():
            if name not in measures:
                known = ", ".join(measures)
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


def read_bounds(
    walker: System, bounds: Mapping[str, Any] | None, parameters: Choice | None
) -> dict[str, tuple[float, float]]:
    """Return the checked bounds of all free numbers by name, infinite for those without any."""
    if bounds is not None:
        check_kind("bounds", bounds, Mapping)
    if not bounds and parameters is None:
        raise WrongUse(f"bounds must name at least one parameter, not {dict(bounds or {})}")
    names = () if parameters is None else numbers_chosen(walker, parameters)
    found = dict.fromkeys(names, (-np.inf, np.inf))
    for name, ends in (bounds or {}).items():
        numbers = numbers_chosen(walker, [name])
        found |= dict.fromkeys(numbers, check_bounds(walker, name, numbers[0], ends))
    return found


def check_bounds(walker: System, name: str, number: str, ends: Any) -> tuple[float, float]:
    """Refuse bounds that are not two numbers allowed for the walker, the lower one first."""
    try:
        low, high = map(float, ends)
    except (TypeError, ValueError):
        raise WrongUse(f"bounds of {name} must be two numbers, not {ends!r}", of="bounds") from None
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise WrongUse(
            f"bounds of {name} must be finite, the lower first, not {low:g}:{high:g}", of="bounds"
        )
    check_parameter(walker, number, low, high)
    return low, high


def starting_places(problem: Problem, starts: int) -> list[Float[np.ndarray, " parameters"]]:
    """Return the walker's own place, if within the bounds, and a Latin hypercube of others.

    Numbers without bounds keep the walker's values. If none has bounds, there are no others.
    """
    own = problem.place_of(values_of(problem.walker, problem.names))
    first = [own] if np.array_equal(own, problem.within(own)) else []
    more = 0 if problem.free.all() else starts - len(first)
    others = latin_hypercube(more, len(own), problem.seed)
    return [*first, *(np.where(problem.free, own, place) for place in others)]


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
    known = lambda ends: [end if np.isfinite(end) else None for end in ends]
    limits = {name: known(ends) for name, ends in problem.limits.items()}
    functions = tuple(problem.functions.values())
    code = {"functions": code_fingerprint(System, functions)} if functions else {}
    return {
        **describe_source(problem.walker),
        "objective": json.dumps(problem.weights),
        "sign": problem.sign,
        "bounds": json.dumps({name: known(ends) for name, *ends in bounds}),
        "limits": json.dumps(limits),
        "region": json.dumps(describe_region(problem.grid)),
        "levels": problem.levels,
        "strides_followed": problem.strides,
        "seed": problem.seed,
        "tolerance": problem.tolerance or 0.0,
        **describe_density(problem),
        **describe_tolerances(problem.over),
        **code,
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


def describe_tolerances(over: Tolerances | None) -> dict:
    """Describe the draws of uncertain parameters, if there are any, by their hash."""
    if over is None:
        return {}
    digest = hashlib.sha256(np.ascontiguousarray(over.changes).tobytes()).hexdigest()[:16]
    return {"over": json.dumps([*over.names]), "draws": digest, "worst": int(over.worst)}


def describe_density(problem: Problem) -> dict:
    """Hash the values of the density, if there is one, in some cells of the grid."""
    if problem.density is None or problem.grid is None:
        return {}
    cells = sample_indices(problem.grid.size, DENSITY_CELLS)
    values = density_at(problem.density, problem.grid.centres(cells))
    return {"density": hashlib.sha256(values.tobytes()).hexdigest()[:16]}
