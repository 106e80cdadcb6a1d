"""Fits of a system's parameters to recordings of its steps, by maximum likelihood."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from scipy.stats import norm

from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    check_precision,
    check_whole,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.fitting.bounds import Bounds, to_free
from walker_jax.fitting.recordings import Recording, as_recordings
from walker_jax.fitting.residuals import (
    LOSSES,
    Data,
    Layout,
    Problem,
    Unknowns,
    follow_steps,
    predicted,
)
from walker_jax.fitting.results import Fit, fit_of
from walker_jax.fitting.solving import Solved, polish_starts, solve
from walker_jax.fitting.starts import check_feasible, first_starts, names_of_state
from walker_jax.fitting.steps import Steps, cut_steps, tables_of_inputs
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.system import check_single
from walker_jax.systems.trees import in_dtype, with_static_functions
from walker_jax.walkers.choices import Choice, numbers_chosen
from walker_jax.walkers.parameters import parameters_of, value_of, with_values

FIRST_NOISE = 0.01
"""Noise where none is given, as a share of a column's standard deviation, in the first search."""
MOST_RESAMPLED = 1_000_000
"""Most fits to resampled steps: each is a fit, and all are kept."""
NOISE_ROUNDS = 3
"""Searches in which noise that is not given is found from the residuals of the one before."""
MARGIN = 4
"""Samples within so many standard deviations of a recorded heel strike are left out: they may
belong to the step before or to the one after."""
SHOOTING = "multiple", "single"


@refuses_tracers("differentiate a function of the fitted system by wj.propagate")
def fit(
    system: HybridSystem | tuple[HybridSystem, HybridSystem],
    recordings: Recording | Sequence[Recording],
    parameters: Choice,
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    shooting: str = "multiple",
    loss: str = "linear",
    inputs: Mapping[str, tuple[str, float]] | None = None,
    skip: float = 0.0,
    starts: Float[Any, "*steps section"] | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    tolerance: float | None = None,
) -> Fit:
    """Fit parameters of a system to recordings of its steps, by maximum likelihood.

    The sum of squares of recorded less predicted coordinates and times of heel strikes, each over
    the standard deviation of its noise, is least. Derivatives are exact, through every heel strike.

    ```python
    walker = wj.SimplestWalker(0.009)
    times, state = 0.1 * np.arange(76), wj.find_gait(walker).states[0]
    theta = wj.trajectory(walker, state, times, strides=3).theta
    recordings = wj.read_recordings({"time": times, "theta": theta}, strikes=[0.0, 3.8825, 7.7649])
    noise = {"theta": 1e-3, "time": 1e-3}
    found = wj.fit(wj.SimplestWalker(0.008), recordings, "slope", noise=noise)
    ```

    **Arguments:**

    - `system`: its other parameters, and first guesses of those fitted; two systems of a kind if
      unlike legs take turns.
    - `recordings`: of `read_recordings`; columns have the names of the system's states.
    - `parameters`: as in `measure`; two systems share them.
    - `bounds`: by name, (low, high); by default those that the system describes, such as masses
      above 0.
    - `noise`: standard deviations by column, and of heel strikes as "time". Those not given are
      found from the residuals.
    - `priors`: by name, mean and standard deviation of what else is known of a parameter.
    - `shooting`: "multiple" if the start of each step is free, so that nothing is assumed of the
      impact but when it happens; "single" if each step starts where the impact leads from the one
      before; it begins at the result of the first.
    - `loss`: "linear", or "soft_l1" or "cauchy", which are for outliers (as in
      `scipy.optimize.least_squares`).
    - `inputs`: for an array of the system, a recorded input and the time between its numbers: each
      step has the input as its own table over time, since its heel strike.
    - `skip`: samples up to this time after a heel strike are left out.
    - `starts`: first guesses on the section, one for all steps or one for each; by default from the
      samples.
    - `bootstrap`: number of fits to resampled steps, in single shooting to resampled runs.
    - `seed`: of the bootstrap.
    - `tolerance`: as in `stride`.

    **Returns** a `Fit`, which is not `converged` where the search did not end, or ended at a system
    that does not make all steps. Raises `ValueError` for recordings that are not of steps of the
    system.
    """
    check_whole("bootstrap", bootstrap, least=0, most=MOST_RESAMPLED)
    systems = check_systems(system)
    names = numbers_chosen(systems[0], parameters)
    if not names:
        raise WrongUse("parameters must name one parameter or more, not none")
    check_choice("shooting", shooting, SHOOTING)
    check_choice("loss", loss, LOSSES)
    recordings, of_state = as_recordings(recordings), names_of_state(systems[0])
    columns = tuple(recordings[0].values)
    if unknown := [name for name in columns if name not in of_state]:
        raise WrongUse(
            f"columns must be among {', '.join(of_state)}, not {unknown[0]!r}", of="columns"
        )
    strike_noise = noise_of_strikes(columns, noise or {}, recordings)
    steps, places = cut_steps(recordings, columns, skip, MARGIN * strike_noise)
    layout = Layout(names, tuple(map(of_state.index, columns)), shooting == "single", loss)
    each = systems_of_steps(systems, recordings, steps, places, inputs or {})
    given, first = noise_of(columns, noise or {}, steps)
    data = make_data(
        systems[0], each, steps, names, (first, strike_noise), bounds, priors, tolerance
    )
    begun = first_unknowns(systems[0], layout, of_state, data, starts)
    problem = Problem(systems, layout, columns, data, given, begun)
    return fit_of(problem, *search(problem), bootstrap, seed)


def check_systems(system: Any) -> tuple[HybridSystem, ...]:
    """Return one or two systems in float64, checked."""
    given = system if type(system) is tuple else (system,)
    for one in given:
        check_kind("system", one, HybridSystem)
    systems = tuple(map(with_static_functions, given))
    for one in systems:
        check_single(one)
    check_precision(jax.dtypes.canonicalize_dtype(float), "fit")
    shapes = {str(jax.tree.structure(one)) for one in systems}
    if len(systems) > 2 or len(shapes) > 1:
        kinds = " and ".join(type(one).__name__ for one in systems)
        raise WrongUse(f"system must be one, or two of one kind, not {kinds}")
    return tuple(in_dtype(one, np.float64, jnp.asarray) for one in systems)


def check_choice(name: str, value: Any, known: Sequence[str]) -> None:
    """Raise `WrongUse` for a word that is not known."""
    if value not in known:
        raise WrongUse(f"{name} must be one of {', '.join(known)}, not {short(value)}", of=name)


def systems_of_steps(
    systems: Sequence[HybridSystem],
    recordings: Sequence[Recording],
    steps: Steps,
    places: Sequence[slice],
    inputs: Mapping[str, tuple[str, float]],
) -> HybridSystem:
    """Return the system of each step: the one whose turn it is, with the inputs of that step."""
    turn = steps.stance if len(systems) > 1 else 0 * steps.stance
    each = jax.tree.map(lambda *leaves: jnp.stack(leaves)[turn], *systems)
    wanted = {}
    for name, (column, spacing) in inputs.items():
        table = value_of(systems[0], name)
        if any(column not in one.inputs for one in recordings) or np.ndim(table) != 1:
            raise WrongUse(f"inputs must be recorded, for a row of numbers, unlike {name!r}")
        wanted[name] = column, spacing, len(table)
    return with_values(each, tables_of_inputs(recordings, steps, places, wanted))


def noise_of_strikes(
    columns: Sequence[str], noise: Mapping[str, float], recordings: Sequence[Recording]
) -> float:
    """Return the noise of heel strikes: given, or that of rounding to the time between samples."""
    names = *columns, "time"
    if unknown := [name for name in noise if name not in names]:
        raise WrongUse(f"noise must be of {', '.join(names)}, not of {unknown[0]!r}", of="noise")
    for name, value in noise.items():
        check_number("noise", value)
        if not 0 < value < np.inf:
            raise WrongUse(f"noise must be finite and above 0, not {value} for {name}", of="noise")
    between = np.concatenate([np.diff(one.time) for one in recordings])
    return float(noise.get("time", np.median(between) / np.sqrt(12)))


def noise_of(
    columns: Sequence[str], noise: Mapping[str, float], steps: Steps
) -> tuple[np.ndarray, np.ndarray]:
    """Return the noise of columns, NaN where it is not given, and first guesses."""
    given = np.array([noise.get(name, np.nan) for name in columns], float)
    spread = [steps.values[..., k][steps.known[..., k]].std() for k in range(len(columns))]
    first = np.maximum(FIRST_NOISE * np.array(spread), np.finfo(float).tiny)
    return given, np.where(np.isnan(given), first, given)


def noise_left(layout: Layout, found: Solved, data: Data) -> Float[np.ndarray, " columns"]:
    """Return the standard deviation of the residuals of each column, of steps that walk.

    With the sum of squares, the unknowns take their share of the degrees of freedom; with a robust
    loss it is that of a normal distribution with the same median.
    """
    steps, (motion, values) = data.steps, predicted(layout, found.unknowns, data)
    off = np.abs(values - steps.values)
    used = steps.known & np.asarray(motion.walks)[:, None, None] & np.isfinite(off)
    each = [off[..., k][used[..., k]] for k in range(off.shape[-1])]
    if layout.loss != "linear":
        spread = [np.median(one) / norm.ppf(0.75) if one.size else np.nan for one in each]
    else:
        free = 1 - ravel_pytree(found.unknowns)[0].size / steps.count
        free = max(free, 1 / steps.count)
        spread = [np.sqrt(np.mean(one**2) / free) if one.size else np.nan for one in each]
    return np.where(np.isnan(spread), data.noise, spread)


def make_data(
    system: HybridSystem,
    each: HybridSystem,
    steps: Steps,
    names: Sequence[str],
    noise: tuple[np.ndarray, float],
    bounds: Mapping[str, tuple[float, float]] | None,
    priors: Mapping[str, tuple[float, float]] | None,
    tolerance: float | None,
) -> Data:
    """Return the constants of the search."""
    known, middle = priors or {}, [float(value_of(system, name)) for name in names]
    for name, argument in {
        **dict.fromkeys(known, "priors"),
        **dict.fromkeys(bounds or {}, "bounds"),
    }.items():
        if name not in names:
            raise WrongUse(f"{argument} must be of parameters that are fitted, not of {name!r}")
    prior = np.array([known.get(n, (m, np.inf)) for n, m in zip(names, middle, strict=True)]).T
    return Data(
        *(each, steps, *noise, prior, bounds_of(system, names, bounds or {}, middle)),
        np.ones(len(steps.run)),
        integrator_of(np.dtype(float), tolerance, None).in_dtype(np.dtype(float)),
        np.array(False),
    )


def bounds_of(
    system: HybridSystem,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    middle: Sequence[float],
) -> Bounds:
    """Return the bounds of parameters: given ones, or those that the system describes."""
    described = {one.name: (one.low, one.high) for one in parameters_of(system)}
    found = [bounds.get(name, described.get(name, (-np.inf, np.inf))) for name in names]
    low, high = numbers("bounds", found).reshape(-1, 2).T
    for name, a, b, value in zip(names, low, high, middle, strict=True):
        if not a < value < b:
            raise WrongUse(
                f"bounds must hold the first guess, {name} {value:.6g}, not {a:.6g} to {b:.6g}"
            )
    return Bounds(low, high)


def first_unknowns(
    system: HybridSystem,
    layout: Layout,
    of_state: Sequence[str],
    data: Data,
    starts: Any,
) -> Unknowns:
    """Return where the search begins; a step that fails from its own guess has a typical one."""
    size, steps = len(system.section), data.steps
    if starts is None:
        guesses = first_starts(system, of_state, layout.places, steps)
    else:
        guesses = numbers("starts", starts)
        if guesses.shape not in ((size,), (len(steps.run), size)):
            raise WrongUse(
                f"starts must have shape ({size},) or ({len(steps.run)}, {size}), "
                f"not {guesses.shape}"
            )
        guesses = np.broadcast_to(guesses, (len(steps.run), size))
    values = np.array([float(value_of(system, name)) for name in layout.names])
    free = np.asarray(to_free(jnp.asarray(values), data.bounds))
    guesses = np.asarray(polish_starts(layout, jnp.asarray(guesses), jnp.asarray(values), data))
    begins = steps.begins[steps.is_first]
    each = Unknowns(free, begins, guesses)
    walks = np.asarray(follow_jit(layout._replace(single=False), each, data).walks)
    check_feasible(system, guesses, walks)
    typical = np.median(guesses[walks], axis=0)
    guesses = np.where(walks[:, None], guesses, typical)
    return Unknowns(free, begins, guesses)


follow_jit = jax.jit(follow_steps, static_argnums=0)


def search(problem: Problem) -> tuple[Solved, Data]:
    """Search with steps apart, then one after another, in single shooting by the impact at last."""
    layout, data = problem.layout, problem.data
    free, apart = layout._replace(single=False), data._replace(apart=np.array(True))
    found, apart = search_with_noise(problem, free, problem.begun, apart)
    data = data._replace(noise=apart.noise)
    found, data = search_with_noise(problem, free, found.unknowns, data)
    if layout.single:
        begun = found.unknowns._replace(starts=found.unknowns.starts[data.steps.is_first])
        found, data = search_with_noise(problem, layout, begun, data)
    return found, data


def search_with_noise(
    problem: Problem, layout: Layout, begun: Unknowns, data: Data
) -> tuple[Solved, Data]:
    """Search until the noise that is not given agrees with the residuals."""
    found, missing = solve(layout, begun, data), np.isnan(problem.given)
    for _ in range(NOISE_ROUNDS if missing.any() else 0):
        noise = np.where(missing, noise_left(layout, found, data), problem.given)
        data = data._replace(noise=noise)
        found = solve(layout, found.unknowns, data)
    return found, data
