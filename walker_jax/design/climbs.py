"""One climb along the gradient, within bounds and limits."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.design.measures import gait_measures
from walker_jax.design.problem import Problem
from walker_jax.design.trace import STEPS, Row, Slack, Trace

TRIES = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25)
"""Shares of a step, until one leads higher; if none does, the stage ends. Some objectives fall by
jumps: where one does just ahead, a shorter step leads higher, or one back."""
MOST = 40
"""Steps of a stage."""
RESCUES = 8
"""Long steps that are made, from where nothing walks, to where the gait is more stable."""
NEWTON = 20
"""Steps back to what constraints allow."""
MET, BINDING = 1e-9, 1e-6
"""By how much, relatively, a limit may be missed, and kept where it holds an optimum."""
SURE = 2
"""Standard errors from which on a difference of values is believed."""


class Climb(NamedTuple):
    """From where to where; or why not."""

    start: Row | None
    best: Row | None
    converged: bool
    note: str = ""


def climb(trace: Trace, run: int, stage: int, place: Float[np.ndarray, " parameters"]) -> Climb:
    """Go up from a place by the steps of one stage, until none leads higher."""
    import optax  # here alone: it takes a quarter of a second

    problem, begin = trace.problem, allowed(trace, place)
    if begin is None:
        return Climb(None, None, False, why_nowhere(trace, place))
    start = trace.measure(run, stage, begin)
    here = start if walks(problem, start) else None
    if here is None and stage == 0:
        here = rescued(trace, run, start)
    if here is None:
        return Climb(start, None, False, why_nowhere(trace, begin))
    optimiser = optax.adam(STEPS[stage], b1=0.5, b2=0.9, eps=1e-12)
    standard = lambda: jax.numpy_dtype_promotion("standard")  # as optax's own arithmetic needs
    with standard():
        state = optimiser.init(jnp.asarray(begin))
    best = here
    for _ in range(MOST):
        place = problem.place(best.parameters)
        uphill = problem.sign * best.gradient * (problem.high - problem.low)
        downhill = jnp.asarray(-along_limits(trace, place, uphill))
        with standard():
            update, state = optimiser.update(downhill, state)
        for share in TRIES:
            goal = allowed(trace, np.clip(place + share * np.asarray(update), 0, 1))
            if goal is None:
                continue
            held = share == 1 and np.abs(goal - place).max() < STEPS[stage] / 100
            if held and np.array_equal(goal, place):
                return Climb(start, best, True)
            there = trace.measure(run, stage, goal)
            if walks(problem, there) and leads_up(problem, best, there):
                best = there
                break
            if held:  # by bounds or limits
                return Climb(start, best, True)
        else:
            return Climb(start, best, True)
    return Climb(start, best, False)


def leads_up(problem: Problem, here: Row, there: Row) -> bool:
    """Whether a value is higher; where errors do not tell, whether it is uphill at both ends."""
    gain = problem.sign * (there.value - here.value)
    if np.abs(gain) > SURE * np.hypot(here.value_error, there.value_error):
        return bool(gain > 0)
    step = problem.sign * (there.parameters - here.parameters)
    return bool(here.gradient @ step > 0 and there.gradient @ step > 0)


def walks(problem: Problem, row: Row) -> bool:
    """Whether something walks, where the objective is about that, and shows which way is up."""
    sizes = [
        size
        for name, size in zip(problem.measures, row.measures, strict=True)
        if name in ("area", "least-disturbance")
    ]
    known = np.isfinite(row.value) and np.isfinite(row.gradient).all()
    return bool(known) and (not sizes or any(size > 0 for size in sizes))


def rescued(trace: Trace, run: int, row: Row) -> Row | None:
    """By long steps, from where nothing walks, to where the gait is more stable, until one does."""
    problem = trace.problem
    for _ in range(RESCUES):
        gait = trace.gait(row.parameters)
        walker, tolerance = problem.built(row.parameters), problem.tolerance
        measures = gait_measures(walker, problem.names, gait, tolerance=tolerance)
        growth = measures["spectral-radius"].gradient * (problem.high - problem.low)
        steepest = np.abs(growth).max()
        if not (np.isfinite(steepest) and steepest > 0):
            return None
        place = problem.place(row.parameters) - STEPS[0] * growth / steepest
        goal = allowed(trace, np.clip(place, 0, 1))
        if goal is None:
            return None
        row = trace.measure(run, 0, goal)
        if walks(problem, row):
            return row
    return None


def why_nowhere(trace: Trace, place: Float[np.ndarray, " parameters"]) -> str:
    """Why nothing can be climbed from a place."""
    problem, values = trace.problem, trace.problem.values(place)
    where, refusal = problem.named(values), problem.refusal(values)
    if refusal:
        return f"{where}: {refusal}"
    measures = gait_measures(problem.built(values), (), trace.gait(values))
    radius = measures["spectral-radius"].value
    if np.isnan(radius):
        return f"{where}: no gait is found"
    for name, (low, high) in problem.limits.items():
        value = measures[name].value
        if not low <= value <= high:
            limit = f"at least {low:g}" if value < low else f"at most {high:g}"
            return f"{where}: {name} is {value:.4g}, and no way was found to {limit}"
    return (
        f"{where}: nothing walks, or nothing says which way is up; "
        f"the gait of period one has a multiplier of modulus {radius:.4g}"
    )


def slacks(trace: Trace, place: Float[np.ndarray, " parameters"]) -> list[Slack]:
    """Those of all limits; NaN where there is no gait."""
    problem, values = trace.problem, trace.problem.values(place)
    if not problem.limits:
        return []
    if values.tobytes() in trace.slacks:
        return trace.slacks[values.tobytes()]
    walker, gait = problem.built(values), trace.gait(values)
    measures = gait_measures(walker, problem.names, gait, tolerance=problem.tolerance)
    found = []
    for name, ends in problem.limits.items():
        for limit, side in zip(ends, (1, -1), strict=True):
            if np.isfinite(limit):
                scale = side / (abs(limit) or 1.0)
                value, gradient = measures[name]
                gradient = gradient * (problem.high - problem.low)
                found.append(Slack(name, scale * (value - limit), scale * gradient))
    trace.slacks[values.tobytes()] = found
    return found


def allowed(
    trace: Trace, place: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, " parameters"] | None:
    """The place, or one near it that keeps all limits; none if that is not found."""
    beyond = None
    for _ in range(NEWTON):
        if trace.problem.refusal(trace.problem.values(place)):
            return None
        found = slacks(trace, place)
        broken = [one for one in found if not one.value >= -MET]
        if not broken:
            least = min((one.value for one in found), default=0.0)
            if beyond is None or least < BINDING:
                return place
            return on_limit(trace, place, beyond)  # Newton's step was too long
        beyond, worst = place, min(broken, key=lambda one: one.value)
        held = ((place == 0) & (worst.gradient < 0)) | ((place == 1) & (worst.gradient > 0))
        gradient = np.where(held, 0.0, worst.gradient)
        if not (np.isfinite(worst.value) and np.sum(gradient**2) > 0):
            return None
        place = np.clip(place - worst.value * gradient / np.sum(gradient**2), 0, 1)
    return None


def on_limit(
    trace: Trace,
    within: Float[np.ndarray, " parameters"],
    beyond: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, " parameters"]:
    """Where a limit is reached on the way from a place within it to one beyond."""

    def least(share: float) -> float:
        slack = min(one.value for one in slacks(trace, within + share * (beyond - within)))
        return slack if np.isfinite(slack) else -1.0

    from scipy.optimize import brentq

    share: Any = brentq(least, 0.0, 1.0, xtol=1e-13)
    return within + share * (beyond - within)


def along_limits(
    trace: Trace,
    place: Float[np.ndarray, " parameters"],
    uphill: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, " parameters"]:
    """A direction without what leads out of the bounds, and beyond limits that hold."""
    holding = [one.gradient for one in slacks(trace, place) if one.value < BINDING]
    for _ in range(1 + len(place)):
        free = ~(((place == 0) & (uphill < 0)) | ((place == 1) & (uphill > 0)))
        uphill = np.where(free, uphill, 0.0)
        for gradient in (np.where(free, one, 0.0) for one in holding):
            if uphill @ gradient < 0:
                uphill = uphill - (uphill @ gradient) / np.sum(gradient**2) * gradient
    return uphill
