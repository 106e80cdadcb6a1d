"""Quantities of a walker, its gait or its basin, and their derivatives by its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from walker_jax.checks import WrongUse, check_kind, refuses_tracers, short
from walker_jax.design.area_gradients import Density, area_gradient
from walker_jax.design.disturbance_gradients import disturbance_gradient
from walker_jax.design.fall_gradients import fall_gradient
from walker_jax.design.measures import (
    GaitFunction,
    Measure,
    differentiate_measures,
    measures_known,
)
from walker_jax.design.problem import SIZES
from walker_jax.design.sensitivity_gradients import sensitivity_gradient
from walker_jax.gaits.cycles import Gait, check_found
from walker_jax.gaits.derivatives import GaitPull
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.choices import Choice, numbers_chosen
from walker_jax.walking.disturbed import Disturbance

OF_GAITS = {"states": "states", "multipliers": "multipliers", "step-times": "step_times"}
"""Quantities that are arrays, and their names in `Gait`."""
OF_BASINS = "grid", "bands", "levels", "strides", "check", "seed"
OPTIONS = {
    **dict.fromkeys(SIZES, OF_BASINS),
    "basin-stability": (*OF_BASINS, "density"),
    "least-disturbance": ("gait", "bands", "along", "fall", "directions", "strides"),
    "fall-action": ("gait", "ground", "directions", "strides"),
}
"""Options of quantities other than functions of a gait, beside the tolerance."""


@refuses_tracers("it gives derivatives itself, by the parameters named")
def measure(
    walker: System,
    quantity: str | GaitFunction,
    parameters: Choice = (),
    gait: Gait | None = None,
    *,
    grid: Grid | None = None,
    density: Density | None = None,
    bands: Sequence[float] | ArrayLike | None = None,
    levels: int | None = None,
    check: int | None = None,
    seed: int | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    fall: bool | None = None,
    ground: float | Disturbance | None = None,
    directions: int | None = None,
    strides: int | None = None,
    tolerance: float | None = None,
) -> Measure:
    """Measure a quantity of a walker, its gait or its basin, with derivatives by parameters.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    speed = wj.measure(walker, "speed", "slope")
    speed.value, speed.gradient
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    area = wj.measure(walker, "area", ["slope"], grid=grid)
    ```

    Quantities of a gait, by default that of `find_gait`; all are NaN if there is none:

    - "step-length": the mean length of a step along the slope, in the unit of length;
    - "speed": the step length over the mean step time;
    - "spectral-radius": the modulus of the gait's largest Floquet multiplier, per stride: its root
      of the order of the period;
    - "cost-of-transport": the energy lost per unit of weight and of distance along the slope. It is
      sin(slope) plus the work of all motors in a step over the step's length
      (`Walker.motor_work`), hip and push-off together; NaN if that work is not known. So on level
      ground it is the motors' work alone, and uphill that work less what gravity takes;
    - the mean of an integral or largest value that the modes name (`integrals`), by its name;
    - a JAX function of a walker and its `Gait` that returns one number;
    - "states", "multipliers" and "step-times", arrays of a gait that was found. At a bifurcation
      with a multiplier of 1 their derivatives do not exist: towards a fold they grow like the
      inverse square root of the distance. They exist at a period doubling. Multipliers have no
      derivatives where two of them meet.

    Of a gait's robustness, with the options of `least_disturbance` and `most_probable_fall`:

    - "least-disturbance": the smallest from which the walker does not return or, with `fall`, from
      which it falls. At two equally near points its derivative is that on the side of the one
      found. Where the nearest point leads to another motion, or its margin jumps, derivatives are
      averages over `bands`, or NaN without bands;
    - "fall-action": half the sum of squares of the disturbances of the most probable fall, in units
      of their standard deviations. On ground whose heights have a small standard deviation s, the
      mean number of strides to a fall is about exp(action / s^2), for the default `ground`;
    - "sensitivity-norm": that of `gait_sensitivity`, of all its disturbances and indicators; NaN
      without a gait of period one, infinite if that gait is not stable.

    Of the basins of all attractors, in the cells of a `grid` that is refined at the boundary:

    - "area" and "volume": on a grid of two axes and of three. Derivatives are integrals along the
      boundary, without smoothing, over the points where lines through the cells' centres cross it.
      At a fractal boundary they are of little use, as fingers of failure are born, and the error is
      infinite. With `bands` of half widths h they are there averages (A(p + h) - A(p - h)) / 2h of
      refined areas, as where the error exceeds 1/20 of the integral;
    - "basin-stability": the probability that starts of a `density` converge to an attractor.

    **Arguments:**

    - `walker`: a single walker or system, with numbers for parameters.
    - `quantity`: its name, or a function of a gait.
    - `parameters`: names of parameters of the walker, of one number or of a whole leaf or tree, as
      `policy.layers[0].weight`; or a function of the walker that returns leaves, as for
      `eqx.tree_at`. Derivatives are by all their numbers, those of an array in C order.
    - `gait`: a gait of this walker.
    - `grid`: grid of a basin, as in `refine`; its borders are fixed.
    - `density`: a function of states of shape (n, section) that returns n numbers and does not
      depend on parameters.
    - `bands`: a half width above 0 for each parameter; it is reduced on a side where the walker
      refuses the value.
    - `levels`: number of times that cells on the boundary are halved, 2 by default.
    - `check`, `seed`: as in `refine`; 100,000 starts by default.
    - `along`, `fall`: as in `least_disturbance`.
    - `ground`: as in `most_probable_fall`; a standard deviation of 1 by default.
    - `directions`: of the search for a disturbance or a fall.
    - `strides`: number of strides for which a walker is followed: 200 by default for a basin, 500
      for the least disturbance, 4 for a fall.
    - `tolerance`: tolerance of the integration, as in `stride`.

    **Returns** a `Measure`.

    Raises `ValueError` for parameters that the walker does not have, for a gait that is not one of
    this walker, for options that the quantity does not have, and as `refine`, `least_disturbance`
    and `most_probable_fall`.
    """
    numbers = numbers_chosen(walker, parameters)
    options = {"gait": gait, "grid": grid, "density": density, "bands": bands, "levels": levels}
    options |= {"check": check, "seed": seed, "along": along, "fall": fall, "ground": ground}
    options |= {"directions": directions, "strides": strides}
    how: Any = check_options(walker, quantity, options) | {"tolerance": tolerance}
    if callable(quantity):
        function = {"quantity": quantity}
        return measure_gait(walker, "quantity", numbers, gait, tolerance, function)
    if quantity in SIZES:
        axes = len(how["grid"].names)
        if axes != SIZES[quantity] and quantity != "basin-stability":
            raise WrongUse(f"grid must have {SIZES[quantity]} axes for {quantity}, not {axes}")
        return area_gradient(walker, how.pop("grid"), numbers, **how)
    if quantity in OF_GAITS:
        return measure_arrays(walker, quantity, numbers, gait, tolerance)
    others: dict[str, Callable[..., Measure]] = {
        "least-disturbance": disturbance_gradient,
        "fall-action": fall_gradient,
        "sensitivity-norm": sensitivity_gradient,
    }
    if quantity in others:
        return others[quantity](walker, numbers, **how)
    return measure_gait(walker, quantity, numbers, gait, tolerance, {})


def check_options(walker: System, quantity: Any, options: dict[str, Any]) -> dict[str, Any]:
    """Return the given options; refuse an unknown quantity, and options that it does not have."""
    given = {name: value for name, value in options.items() if value is not None}
    known = (*OPTIONS, "sensitivity-norm", *measures_known(walker), *OF_GAITS)
    if not callable(quantity) and not (isinstance(quantity, str) and quantity in known):
        raise WrongUse(
            f"quantity must be area, speed or another that help(wj.measure) lists, not "
            f"{short(quantity)}"
        )
    taken = ("gait",) if callable(quantity) else OPTIONS.get(quantity, ("gait",))
    if further := [name for name in given if name not in taken]:
        named = "a function of a gait" if callable(quantity) else quantity
        raise WrongUse(f"{further[0]} must be left out for {named}, which takes {', '.join(taken)}")
    for name in ("grid", "density"):
        if name in taken and name not in given:
            raise WrongUse(f"{name} is required for {quantity}", of=name)
    if "grid" in given:
        check_kind("grid", given["grid"], Grid)
    if not callable(given.get("density", len)):
        raise WrongUse(f"density must be a function of states, not {short(given['density'])}")
    return given


def measure_gait(
    walker: System,
    name: str,
    numbers: Sequence[str],
    gait: Gait | None,
    tolerance: float | None,
    functions: dict[str, GaitFunction],
) -> Measure:
    """Measure a gait by a known function of it, or by one of `functions`."""
    gait = search_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    return differentiate_measures(walker, numbers, gait, [name], functions, tolerance)[name]


def measure_arrays(
    walker: System,
    quantity: str,
    numbers: Sequence[str],
    gait: Gait | None,
    tolerance: float | None,
) -> Measure:
    """Return an array of a gait, and its derivatives by the implicit function theorem."""
    gait = search_gait(walker, tolerance=tolerance) if gait is None else gait
    check_found(gait)
    field = OF_GAITS[quantity]
    value = np.asarray(getattr(gait, field))
    pull = GaitPull(walker, gait, numbers, tolerance)
    changes = pull.changes if field == "multipliers" else pull.motions
    gradient = np.zeros((*value.shape, len(numbers)), value.dtype)
    for i, change in enumerate(changes):
        gradient[..., i] = getattr(change, field)
    return Measure(value, gradient)
