"""Long transients: how fast walkers leave a chaotic saddle, and the properties of that saddle.

Beyond a boundary crisis (`loss_of_walking`) all walkers fall, but many only after a long chaotic
transient near the chaotic saddle, a set that is not attracting. The share of survivors after n
strides decays as exp(-kappa n), with the escape rate kappa. If starts are sprinkled over the whole
region, the middle parts of long transients lie near the saddle (Kantz and Grassberger 1985, Physica
D 17:75-86; Lai and Tel 2011, Transient Chaos). The information dimension of the saddle follows from
its Lyapunov exponents, in one and in two dimensions:

    D = 1 - kappa / lambda_1,    D = (lambda_1 - kappa) (1 / lambda_1 + 1 / |lambda_2|)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize_scalar

from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_kind,
    check_whole,
    is_number,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.gaits.cycles import linearise
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.stability.rough_ground import mean_life
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System, check_single
from walker_jax.walking.iteration import iterate, orbits

MOST_ORBITS = 500
"""Most transients whose states are recorded: the longest ones."""
LONGEST_ORBIT = 400
"""Most strides that are recorded of each of them."""
MOST_ESCAPES = 100
"""Most transients whose ends are recorded: the longest ones of at most `LONGEST_ORBIT` strides."""


class Transients(NamedTuple):
    """A chaotic saddle, and the rate at which walkers leave it."""

    rate: float
    """Escape rate kappa, per stride; 0 if no walk fell."""
    low: float
    high: float
    """Confidence interval of the rate."""
    mean_life: float
    """Mean number of strides after the walkers have settled."""
    lives: Int[np.ndarray, " n"]
    """Completed strides of each walk."""
    ended: Bool[np.ndarray, " n"]
    """Whether each walk ended in a failure, rather than at the limit."""
    saddle: Float[np.ndarray, "m section"]
    """States near the saddle: the middle parts of the longest transients."""
    exponents: Float[np.ndarray, " section"]
    """Lyapunov exponents along these states, per stride, the largest first."""
    dimension: float
    """Information dimension of the saddle, from the rate and the exponents; NaN in more than two
    dimensions, and if the largest exponent is not above the rate."""
    escapes: Float[np.ndarray, "k settle section"]
    """Last states before the failure, for k of the walks."""
    section: tuple[str, ...]
    """Names of the coordinates."""


@refuses_tracers()
def transients(
    system: System,
    starts: Float[ArrayLike, "n section"] | Sequence[Any],
    *,
    settle: int = 20,
    strides: int = 10_000,
    confidence: float = 0.95,
    tolerance: float | None = None,
) -> Transients:
    """Measure how fast walks leave a chaotic saddle, and find the saddle.

    ```python
    walker = wj.SimplestWalker(slope=0.0192)
    gait = wj.find_gait(walker)  # unstable, and on the saddle
    starts = gait.states + np.linspace(0, 0.001, 500)[:, None]
    found = wj.transients(walker, starts, strides=500)
    found.mean_life, found.exponents, found.dimension
    ```

    The first `settle` strides of each walk do not count. After them the chance p to fall in a
    stride is constant, and the escape rate is kappa = -log(1 - p). Its confidence interval is
    computed as in `steps_to_fall`.

    **Arguments:**

    - `system`: one system, with numbers for parameters.
    - `starts`: states of shape (n, section), sprinkled over the region that holds the saddle, or
      on the former attractor.
    - `settle`: number of strides in which walks approach the saddle, and also the number in which
      they leave it at the end of a transient; 100 at most.
    - `strides`: most strides of a walk. Walks still going then count with the strides that they
      have made. Starts that converge to an attractor make the rate too small.
    - `confidence`: confidence level of the interval.
    - `tolerance`: tolerance of the integration, as in `stride`.

    **Returns** `Transients`.

    Raises `ValueError` for arguments out of range; `ComputationFailed` if no walk lasts for three
    times `settle`.
    """
    check_kind("system", system, System)
    check_single(system)
    starts = numbers("starts", starts)
    if starts.ndim != 2 or starts.shape[1] != len(system.section) or len(starts) == 0:
        size = len(system.section)
        raise WrongUse(f"starts must have shape (n, {size}), not {starts.shape}")
    check_whole("settle", settle, most=LONGEST_ORBIT // 4)
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
    count = int(min(end.strides[longest].max(), LONGEST_ORBIT))
    states, _ = orbits(system, starts[longest], count, integrator)
    ends = np.minimum(end.strides[longest], count + settle) - settle
    paths = [path[settle : last + 1] for path, last in zip(states, ends, strict=True)]
    exponents = exponents_along(system, paths, integrator)
    brief = lasting[ended[lasting] & (end.strides[lasting] <= LONGEST_ORBIT)][:MOST_ESCAPES]
    lives = end.strides[brief, None]
    states, _ = orbits(system, starts[brief], int(lives.max(initial=0)), integrator)
    return Transients(
        rate,
        low,
        high,
        mean,
        lives=end.strides,
        ended=ended,
        saddle=np.concatenate(paths),
        exponents=exponents,
        dimension=dimension_of(rate, exponents),
        escapes=states[np.arange(len(brief))[:, None], lives - np.arange(settle)[::-1]],
        section=tuple(system.section),
    )


def exponents_along(
    system: System, paths: Sequence[Float[np.ndarray, "_ section"]], integrator: Integrator
) -> Float[np.ndarray, " section"]:
    """Compute Lyapunov exponents along parts of walks, by QR factorisation.

    The first fifth of each part aligns the frame.
    """
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
    """Compute the information dimension of a chaotic saddle in one or two dimensions, or NaN."""
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
    """Confidence interval of the exponent, with the error of the crisis if that is fitted."""
    misfit: float
    """chi^2 per degree of freedom; far above 1 if the lives follow no such law."""
    predicted: Mapping[str, float] = MappingProxyType({})
    """Exponents that given multipliers predict, by the kind of the crisis."""


SOUGHT = -12.0, 6.0
"""Logarithms of the least and the largest distance of a crisis below the first value, in units of
the span of all values."""
RESAMPLES = 400
"""Number of fits to resampled lives, for the interval of an exponent."""


@refuses_tracers()
def crisis_law(
    values: Sequence[float] | Float[ArrayLike, " k"],
    lives: Sequence[float] | Float[ArrayLike, " k"],
    errors: Sequence[float] | Float[ArrayLike, " k"],
    *,
    crisis: float | None = None,
    confidence: float = 0.95,
    multipliers: Sequence[Any] | ArrayLike | None = None,
) -> CrisisLaw:
    """Fit mean lives beyond a crisis by a power of the distance from it.

        log(life) = constant - exponent log(value - crisis)

    ```python
    distance = np.geomspace(1e-4, 1e-2, 8)
    lives = 3 * distance**-0.5
    law = wj.crisis_law(0.019 + distance, lives, errors=0.03 * lives)
    law.crisis, law.exponent
    ```

    The fit is one of weighted least squares. Unless the crisis is given, it is sought below the
    least value. The confidence interval follows from 400 fits to lives with random errors.

    **Arguments:**

    - `values`: values of the parameter, 4 or more, all beyond the crisis and ascending.
    - `lives`, `errors`: mean lives at these values, and their standard errors.
    - `crisis`: value of the parameter at the crisis, below all `values`; by default it is fitted.
    - `confidence`: confidence level of the interval.
    - `multipliers`: the two Floquet multipliers of the orbit that the attractor meets, for the
      exponents of a heteroclinic and of a homoclinic crisis (`predicted`): 1/2 + log|a| / |log|b||
      and log|b| / log|a b|^2, with a the expanding and b the contracting one. In a heteroclinic
      crisis the orbit lies on the attractor, and its unstable manifold touches the stable manifold
      of another orbit. In a homoclinic crisis the orbit's own manifolds touch (Grebogi, Ott and
      Yorke 1987, Phys. Rev. A 36:5365-5380).

    **Returns** a `CrisisLaw`.

    Raises `ValueError` for arguments out of range, and for multipliers that are not those of a
    saddle that contracts areas; `ComputationFailed` if no crisis in the range of the search fits
    best.
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
    if crisis is not None and not (is_number(crisis) and -np.inf < crisis < values[0]):
        raise WrongUse(f"crisis must be below {values[0]:g}, not {short(crisis)}")
    predicted = {} if multipliers is None else crisis_exponents(multipliers)
    weights = (lives / errors) ** 2
    at, exponent, chi = fit_crisis(values, np.log(lives), weights, crisis)
    nearest, farthest = np.exp(SOUGHT) * (values[-1] - values[0])
    if crisis is None and not 1.01 * nearest < values[0] - at < 0.99 * farthest:
        raise ComputationFailed("no crisis fits these lives best: give crisis", of="crisis")
    rng = np.random.default_rng(0)
    scatter = rng.normal(size=(RESAMPLES, len(values))) * errors / lives
    tried = [fit_crisis(values, np.log(lives) + one, weights, crisis)[1] for one in scatter]
    low, high = np.quantile(tried, [(1 - confidence) / 2, (1 + confidence) / 2])
    freedom = len(values) - 2 - (crisis is None)
    return CrisisLaw(at, exponent, float(low), float(high), chi / freedom, predicted)


def fit_crisis(
    values: Float[np.ndarray, " k"],
    logs: Float[np.ndarray, " k"],
    weights: Float[np.ndarray, " k"],
    crisis: float | None,
) -> tuple[float, float, float]:
    """Return the crisis, the exponent and chi^2 of the best fit."""

    def line(at: float) -> tuple[float, float]:
        x = np.log(values - at)
        slope, constant = np.polyfit(x, logs, 1, w=np.sqrt(weights))
        return -float(slope), float(np.sum(weights * (logs - constant - slope * x) ** 2))

    if crisis is None:
        span = float(values[-1] - values[0])
        misfit = lambda log: line(values[0] - np.exp(log))[1]
        tried = np.log(span) + np.linspace(*SOUGHT, 60)
        best = int(np.argmin([misfit(one) for one in tried]))
        around = tried[max(0, best - 1)], tried[min(len(tried) - 1, best + 1)]
        distance: Any = minimize_scalar(misfit, bounds=around, method="bounded")
        crisis = float(values[0] - np.exp(distance.x))
    return float(crisis), *line(crisis)


def crisis_exponents(multipliers: Sequence[Any] | ArrayLike) -> dict[str, float]:
    """Return the exponents of mean lives that the multipliers of an orbit predict."""
    try:
        sizes = np.sort(np.abs(np.asarray(multipliers, complex)))
    except (TypeError, ValueError):
        sizes = np.zeros(0)
    if sizes.shape != (2,) or not (0 < sizes[0] < 1 < sizes[1] < 1 / sizes[0]):
        raise WrongUse(
            f"multipliers must be two of a saddle that contracts areas, not {short(multipliers)}"
        )
    contracting, expanding = np.log(sizes)
    return {
        "heteroclinic": float(0.5 + expanding / abs(contracting)),
        "homoclinic": float(contracting / (2 * (expanding + contracting))),
    }
