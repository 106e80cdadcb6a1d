"""Long transients: how fast walkers leave a chaotic saddle, and what that saddle is like.

Beyond a boundary crisis (`loss_of_walking`) all walkers fall, but many only after a long chaotic
transient, near a set that is not attracting, the chaotic saddle. Survivors decay by the escape rate
kappa, exp(-kappa n). The middle part of long transients lies near the saddle, as starts are
sprinkled everywhere (Kantz and Grassberger 1985, Physica D 17:75-86; Lai and Tel 2011, Transient
Chaos). Its information dimension follows from its exponents, per stride, in one and in two
dimensions:

    D = 1 - kappa / lambda_1,    D = (lambda_1 - kappa) (1 / lambda_1 + 1 / |lambda_2|)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize_scalar

from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_confidence,
    check_kind,
    check_whole,
    is_number,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.gaits.derivatives import linearise
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.stability.rough_ground import mean_life
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System, check_single
from walker_jax.walking.iteration import iterate, orbits

MOST_ORBITS = 500
"""Of the longest transients, those whose states are recorded."""
LONGEST_ORBIT = 400
"""Strides of each of them, at most."""
MOST_ESCAPES = 100
"""Of the transients that are no longer than that, those whose ends are recorded."""


class Transients(NamedTuple):
    """How fast walkers leave a chaotic saddle, and the saddle."""

    rate: float
    """The escape rate kappa, per stride; 0 where none fell."""
    low: float
    high: float
    """Its confidence interval."""
    mean_life: float
    """Strides that walkers make on average after they have settled."""
    lives: Int[np.ndarray, " n"]
    """Completed strides of each walk."""
    ended: Bool[np.ndarray, " n"]
    """Whether each walk ended in a failure, and was not left off at the limit."""
    saddle: Float[np.ndarray, "m section"]
    """States near the saddle: of the longest transients, all but those at their two ends."""
    exponents: Float[np.ndarray, " section"]
    """The Lyapunov exponents of these states, per stride, the largest first."""
    dimension: float
    """Information dimension of the saddle, from the rate and the exponents; NaN in more than two
    dimensions and where the largest exponent is not above the rate."""
    escapes: Float[np.ndarray, "k settle section"]
    """The last states before the failure, of some of the walks."""
    section: tuple[str, ...]
    """Names of the coordinates."""


@refuses_tracers()
def transients(
    system: System,
    starts: Float[ArrayLike, "n section"],
    *,
    settle: int = 20,
    strides: int = 10_000,
    confidence: float = 0.95,
    tolerance: float | None = None,
) -> Transients:
    """The escape rate of walks that fall in the end, and the chaotic saddle that they leave.

    Walks that have made `settle` strides count, with the strides that follow: then the chance p to
    fall in a stride is constant, kappa = -log(1 - p), and its interval is that of `steps_to_fall`.

    **Arguments:**

    - `system`: of one kind, with numbers for parameters.
    - `starts`: points of the section, sprinkled over the region that holds the saddle, or on what
      was the attractor before the crisis.
    - `settle`: strides in which walks come close to the saddle, or leave; as many at the end of a
      transient lead away from it.
    - `strides`: of a walk, at most. Walks that are left off count by the strides they have made:
      starts that converge to an attractor make the rate too small.
    - `confidence`: of the interval.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for arguments out of range; `ComputationFailed` where no walk lasts for
    three times `settle`.
    """
    check_kind("system", system, System)
    check_single(system)
    starts = numbers("starts", starts)
    if starts.ndim != 2 or starts.shape[1] != len(system.section) or len(starts) == 0:
        size = len(system.section)
        raise WrongUse(f"starts must have shape (n, {size}), not {starts.shape}")
    check_whole("settle", settle)
    check_whole("strides", strides)
    check_confidence(confidence)
    integrator = integrator_of(starts.dtype, tolerance)
    end = iterate(system, starts, strides, integrator)
    ended = ~np.isin(end.outcome, (Outcome.STRIDE, Outcome.UNDECIDED))
    late = end.strides >= settle
    lasting = np.flatnonzero(end.strides >= 3 * settle)
    if len(lasting) == 0:
        raise ComputationFailed(f"no walk lasts for {3 * settle} strides: give a smaller settle")
    mean, least, most = mean_life(end.strides[late] - settle, ended[late], confidence)
    rate, low, high = (
        float(np.log1p(1 / one)) if one > 0 else np.inf for one in (mean, most, least)
    )
    lasting = lasting[np.argsort(-end.strides[lasting], kind="stable")]
    longest = lasting[:MOST_ORBITS]
    lives = end.strides[longest]
    paths = middle_parts(system, starts[longest], lives, settle, integrator)
    exponents = exponents_along(system, paths, integrator)
    dimension = dimension_of(rate, exponents)
    saddle = np.concatenate(paths)
    brief = lasting[ended[lasting] & (end.strides[lasting] <= LONGEST_ORBIT)][:MOST_ESCAPES]
    escapes = last_states(system, starts[brief], end.strides[brief], settle, integrator)
    lives, section = end.strides, tuple(system.section)
    return Transients(
        rate, low, high, mean, lives, ended, saddle, exponents, dimension, escapes, section
    )


def middle_parts(
    system: System,
    starts: Float[np.ndarray, "n section"],
    lives: Int[np.ndarray, " n"],
    settle: int,
    integrator: Integrator,
) -> list[Float[np.ndarray, "_ section"]]:
    """Return the states of each walk from stride `settle` on, up to as many before its end."""
    count = int(min(lives.max(), LONGEST_ORBIT))
    states, _ = orbits(system, starts, count, integrator)
    ends = np.minimum(lives, count + settle) - settle
    return [path[settle : end + 1] for path, end in zip(states, ends, strict=True)]


def last_states(
    system: System,
    starts: Float[np.ndarray, "n section"],
    lives: Int[np.ndarray, " n"],
    count: int,
    integrator: Integrator,
) -> Float[np.ndarray, "n count section"]:
    """States of each walk, so many, up to the last one before its failure."""
    states, _ = orbits(system, starts, int(lives.max(initial=0)), integrator)
    return states[np.arange(len(starts))[:, None], lives[:, None] - np.arange(count)[::-1]]


def exponents_along(
    system: System, paths: Sequence[Float[np.ndarray, "_ section"]], integrator: Integrator
) -> Float[np.ndarray, " section"]:
    """Lyapunov exponents along pieces of walks, by QR; the first fifth of each aligns the frame."""
    points = np.concatenate(paths)
    matrices = linearise(system, points[:, None], integrator).jacobian[:, 0]
    longest, size = max(map(len, paths)), points.shape[1]
    padded = np.broadcast_to(np.eye(size), (len(paths), longest, size, size)).copy()
    counted = np.zeros((len(paths), longest), bool)
    first = 0
    for i, path in enumerate(paths):
        padded[i, : len(path)] = matrices[first : first + len(path)]
        counted[i, len(path) // 5 : len(path)] = True
        first += len(path)
    frames = np.broadcast_to(np.eye(size), (len(paths), size, size))
    total = np.zeros(size)
    for stride in range(longest):
        frames, upper = np.linalg.qr(padded[:, stride] @ frames)
        with np.errstate(divide="ignore"):
            grown = np.log(np.abs(np.diagonal(upper, axis1=1, axis2=2)))
        total += grown[counted[:, stride]].sum(axis=0)
    return -np.sort(-total / counted.sum())


def dimension_of(rate: float, exponents: Float[np.ndarray, " section"]) -> float:
    """Information dimension of a chaotic saddle in one or two dimensions."""
    first = float(exponents[0])
    if not first > rate:
        return np.nan
    if len(exponents) == 1:
        return 1 - rate / first
    if len(exponents) == 2 and exponents[1] < 0:
        return (first - rate) * (1 / first + 1 / abs(float(exponents[1])))
    return np.nan


class CrisisLaw(NamedTuple):
    """The law of mean lives beyond a crisis: life ~ |value - crisis|^-exponent."""

    crisis: float
    exponent: float
    low: float
    high: float
    """The confidence interval of the exponent, the crisis fitted too unless it was given."""
    misfit: float
    """chi^2 per degree of freedom: far above 1 where there is no such law."""


SOUGHT = -12.0, 6.0
"""Logarithms of the distances below the first value, as shares of the span of all values, at which
a crisis is sought."""
RESAMPLES = 400
"""Of the lives, for the interval of an exponent."""


@refuses_tracers()
def crisis_law(
    values: Sequence[float] | Float[ArrayLike, " k"],
    lives: Sequence[float] | Float[ArrayLike, " k"],
    errors: Sequence[float] | Float[ArrayLike, " k"],
    *,
    crisis: float | None = None,
    confidence: float = 0.95,
) -> CrisisLaw:
    """Fit mean lives beyond a crisis by a power of the distance from it.

        log(life) = constant - exponent log(value - crisis)

    By weighted least squares, the crisis by a search below the least value unless it is given. The
    interval is that of 400 fits to lives with random errors.

    **Arguments:**

    - `values`: of the parameter, 4 or more, all beyond the crisis and ascending.
    - `lives`, `errors`: mean lives there, and their standard errors.
    - `crisis`: the value of the crisis, below all values.
    - `confidence`: of the interval.

    Raises `ValueError` for arguments out of range.
    """
    values, lives, errors = (
        numbers(name, one)
        for name, one in (("values", values), ("lives", lives), ("errors", errors))
    )
    rising = values.ndim == 1 and len(values) > 3 and (np.diff(values) > 0).all()
    if not (rising and np.isfinite(values).all()):
        raise WrongUse(f"values must be 4 or more, ascending, not {short(values.tolist())}")
    for name, one in (("lives", lives), ("errors", errors)):
        if one.shape != values.shape or not ((one > 0) & np.isfinite(one)).all():
            raise WrongUse(
                f"{name} must be {len(values)} positive numbers, not {short(one.tolist())}"
            )
    check_confidence(confidence)
    if crisis is not None and not (is_number(crisis) and -np.inf < crisis < values[0]):
        raise WrongUse(f"crisis must be below {values[0]:g}, not {short(crisis)}")
    weights = (lives / errors) ** 2
    at, exponent, chi = fit_crisis(values, np.log(lives), weights, crisis)
    ends = values[0] - np.exp(SOUGHT) * (values[-1] - values[0])
    if crisis is None and not (0.99 * ends[1] + 0.01 * values[0] < at < ends[0]):
        raise ComputationFailed("no crisis fits these lives best: give crisis", of="crisis")
    rng = np.random.default_rng(0)
    scatter = rng.normal(size=(RESAMPLES, len(values))) * errors / lives
    tried = [fit_crisis(values, np.log(lives) + one, weights, crisis)[1] for one in scatter]
    low, high = np.quantile(tried, [(1 - confidence) / 2, (1 + confidence) / 2])
    freedom = len(values) - 2 - (crisis is None)
    return CrisisLaw(at, exponent, float(low), float(high), chi / freedom)


def fit_crisis(
    values: Float[np.ndarray, " k"],
    logs: Float[np.ndarray, " k"],
    weights: Float[np.ndarray, " k"],
    crisis: float | None,
) -> tuple[float, float, float]:
    """The crisis, the exponent and chi^2 of the best line."""

    def line(at: float) -> tuple[float, float]:
        x = np.log(values - at)
        x, y = (one - np.average(one, weights=weights) for one in (x, logs))
        slope = np.sum(weights * x * y) / np.sum(weights * x**2)
        return -float(slope), float(np.sum(weights * (y - slope * x) ** 2))

    if crisis is None:
        span = float(values[-1] - values[0])
        misfit = lambda log: line(values[0] - np.exp(log))[1]
        tried = np.log(span) + np.linspace(*SOUGHT, 60)
        best = int(np.argmin([misfit(one) for one in tried]))
        around = tried[max(0, best - 1)], tried[min(len(tried) - 1, best + 1)]
        distance: Any = minimize_scalar(misfit, bounds=around, method="bounded")
        crisis = float(values[0] - np.exp(distance.x))
    return float(crisis), *line(crisis)


@refuses_tracers()
def crisis_exponent(
    multipliers: Sequence[Any] | ArrayLike,
    kind: Literal["heteroclinic", "homoclinic"] = "heteroclinic",
) -> float:
    """The exponent of mean lives that the multipliers of an orbit predict, in two dimensions.

        heteroclinic:  1/2 + log|a| / |log|b||        homoclinic:  log|b| / log|a b|^2

    with a the expanding and b the contracting Floquet multiplier: in a heteroclinic crisis those of
    the orbit on the attractor whose unstable manifold touches the stable one of another orbit; in a
    homoclinic one those of the orbit whose own manifolds touch (Grebogi, Ott and Yorke 1987,
    Phys. Rev. A 36:5365-5380). Raises `ValueError` unless they are those of a saddle that
    contracts areas.
    """
    try:
        sizes = np.sort(np.abs(np.asarray(multipliers, complex)))
    except (TypeError, ValueError):
        sizes = np.zeros(0)
    if sizes.shape != (2,) or not (0 < sizes[0] < 1 < sizes[1] < 1 / sizes[0]):
        raise WrongUse(
            f"multipliers must be two of a saddle that contracts areas, not {short(multipliers)}"
        )
    if not (isinstance(kind, str) and kind in ("heteroclinic", "homoclinic")):
        raise WrongUse(f"kind must be heteroclinic or homoclinic, not {short(kind)}")
    contracting, expanding = np.log(sizes)
    if kind == "homoclinic":
        return float(contracting / (2 * (expanding + contracting)))
    return float(0.5 + expanding / abs(contracting))
