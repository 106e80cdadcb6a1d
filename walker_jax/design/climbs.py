"""One ascent along the gradient of an objective, within bounds and limits."""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import closing
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.design.evaluation import STEP_SIZES, Evaluation
from walker_jax.design.measures import differentiate_measures
from walker_jax.design.problem import SIZES, Problem
from walker_jax.design.trace import Trace
from walker_jax.execution.threads import stopped_when

OTHER_STEPS = (-1.0, 0.5, -0.5, 0.25, -0.25)
"""Multiples of the optimiser's step, tried in turn after the step until one improves the objective;
if none does, the stage ends. Some objectives are discontinuous: just before a jump, a shorter step
or a step in the opposite direction may improve them."""
MAX_STAGE_STEPS = 40
"""Most steps of a stage."""
MAX_STEPS_TO_WALKING = 8
"""Most long steps towards a more stable gait, from a start where nothing walks."""
SIGNIFICANT_ERRORS = 2
"""Number of standard errors above which a difference of values is significant."""


class Climb(NamedTuple):
    """The start and the best evaluation of a climb, or the reason why it failed."""

    start: Evaluation | None
    best: Evaluation | None
    converged: bool
    note: str = ""


def climb(trace: Trace, run: int, stage: int, place: Float[np.ndarray, " parameters"]) -> Climb:
    """Climb from a place by the steps of one stage, until none improves the objective.

    It ends earlier if the time is over, with the best so far; a measurement in progress is then
    given up. But the first start is always measured.
    """
    problem, budget = trace.problem, trace.budget
    where = problem.describe_values(problem.values(place))
    found = Climb(None, None, False, f"{where}: no time")
    first = (run, stage) == (0, 0)
    try:
        if not first:
            budget.wait_for_first()
        with stopped_when(budget.is_over):
            for further in climb_by_steps(trace, run, stage, place):
                found = further
    except CancelledError:
        if not budget.ran_out:  # another climb has failed
            raise
        found = with_highest(trace, run, stage, found)
    finally:
        if first:
            budget.begin()  # without a measurement, if the walker refuses the start
    return found


def with_highest(trace: Trace, run: int, stage: int, found: Climb) -> Climb:
    """Return a climb that was cut within a step with the highest place measured in that step."""
    best = found.best
    if best is not None:
        for row in trace.rows_of(run, stage):
            best = row if is_higher(trace.problem, best, row) else best
    return found._replace(best=best)


def climb_by_steps(
    trace: Trace, run: int, stage: int, place: Float[np.ndarray, " parameters"]
) -> Iterator[Climb]:
    """Do the work of `climb`, and yield the climb as far as it has come, after each step."""
    import optax  # only here, as it takes a quarter of a second

    problem = trace.problem
    if trace.budget.is_over():
        return
    begin = trace.limits.nearest_allowed(place)
    if begin is None:
        yield Climb(None, None, False, explain_failure(trace, place))
        return
    if trace.budget.first is None and trace.budget.seconds < math.inf:
        value = trace.measure(run, stage, begin, value_only=True)
        trace.budget.begin()  # also if it was known
        yield Climb(value, value if walks(problem, value) else None, False)
    start = trace.measure(run, stage, begin)
    trace.budget.begin()
    here = start if can_be_climbed(problem, start) else None
    if here is None and stage == 0:
        here = climb_to_walking(trace, run, start)
    if here is None:
        yield Climb(start, None, False, explain_failure(trace, begin))
        return
    yield Climb(start, here, False)
    optimiser = optax.adam(STEP_SIZES[stage], b1=0.5, b2=0.9, eps=1e-12)
    standard = lambda: jax.numpy_dtype_promotion("standard")  # as optax's own arithmetic needs
    with standard():
        state = optimiser.init(jnp.asarray(begin))
    best = here
    for _ in range(MAX_STAGE_STEPS):
        if trace.budget.is_over():
            return
        place = problem.place_of(best.parameters)
        uphill = problem.sign * best.gradient * problem.scale
        downhill = jnp.asarray(-trace.limits.feasible_direction(place, uphill))
        with standard():
            update, state = optimiser.update(downhill, state)
        higher = step_up(trace, run, stage, best, np.asarray(update))
        if higher is None:
            yield Climb(start, best, True)
            return
        resolved = stage < len(STEP_SIZES) - 1 and sure_gain(problem, best, higher) == 0
        best = higher
        yield Climb(start, best, False)
        if resolved:  # finer grids tell more than further steps
            return


def step_up(
    trace: Trace,
    run: int,
    stage: int,
    best: Evaluation,
    update: Float[np.ndarray, " parameters"],
) -> Evaluation | None:
    """Try multiples of a step in turn; return the first that improves the objective, or None.

    A whole step that surely improves it is doubled as long as it improves more: values alone take a
    fraction of the time of gradients. The other multiples are measured side by side; those after
    the first promising one do not count.
    """
    problem, begin = trace.problem, trace.problem.place_of(best.parameters)

    def goal_of(share: float) -> Float[np.ndarray, " parameters"] | None:
        return trace.limits.nearest_allowed(problem.within(begin + share * update))

    def reach(goal: Float[np.ndarray, " parameters"]) -> Evaluation | None:
        there = trace.measure(run, stage, goal)
        return there if can_be_climbed(problem, there) and is_better(problem, best, there) else None

    goal = goal_of(1.0)
    if goal is not None:
        blocked = np.abs(goal - begin).max() < STEP_SIZES[stage] / 100  # by bounds or limits
        if blocked and np.array_equal(goal, begin):
            return None
        there = trace.measure(run, stage, goal, value_only=True)
        if is_higher(problem, best, there):
            goal = lengthen(trace, run, stage, goal_of, goal, there)
        if may_be_better(problem, best, there) and (higher := reach(goal)) is not None:
            return higher
        if blocked:
            return None
    goals = [goal for share in OTHER_STEPS if (goal := goal_of(share)) is not None]
    while goals:
        with closing(trace.measure_each(run, stage, goals, value_only=True)) as rows:
            promising = (i for i, there in enumerate(rows) if may_be_better(problem, best, there))
            first = next(promising, None)
        if first is None:
            return None
        if (higher := reach(goals[first])) is not None:
            return higher
        goals = goals[first + 1 :]
    return None


def lengthen(
    trace: Trace,
    run: int,
    stage: int,
    goal_of: Callable[[float], Float[np.ndarray, " parameters"] | None],
    goal: Float[np.ndarray, " parameters"],
    there: Evaluation,
) -> Float[np.ndarray, " parameters"]:
    """Double a whole step as long as the objective surely improves; return the last goal."""
    share = 2.0
    while not trace.budget.is_over():
        farther = goal_of(share)
        if farther is None or np.array_equal(farther, goal):
            break
        beyond = trace.measure(run, stage, farther, value_only=True)
        if not is_higher(trace.problem, there, beyond):
            break
        goal, there, share = farther, beyond, 2 * share
    return goal


def sure_gain(problem: Problem, here: Evaluation, there: Evaluation) -> float:
    """Return by how much the value there is better; 0 if errors hide that."""
    gain = problem.sign * (there.value - here.value)
    error = np.hypot(here.value_error, there.value_error)
    return float(gain) if np.abs(gain) > SIGNIFICANT_ERRORS * error else 0.0


def is_higher(problem: Problem, here: Evaluation, there: Evaluation) -> bool:
    """Return whether the walker there walks, and its value is surely better."""
    return walks(problem, there) and sure_gain(problem, here, there) > 0


def may_be_better(problem: Problem, here: Evaluation, there: Evaluation) -> bool:
    """Return whether a place may be better, as far as that is known without its gradient.

    If errors hide the gain, the gradient here must promise more than the error. If the way goes
    uphill at both ends, the gain is about half of that promise at least.
    """
    gain = sure_gain(problem, here, there)
    if gain != 0 or not walks(problem, there):
        return gain > 0 and walks(problem, there)
    promise = problem.sign * float(here.gradient @ (there.parameters - here.parameters))
    error = float(np.hypot(here.value_error, there.value_error))
    most = problem.sign * (there.value - here.value) + SIGNIFICANT_ERRORS * error
    return promise > error and most >= promise / 2


def is_better(problem: Problem, here: Evaluation, there: Evaluation) -> bool:
    """Return whether the value there is higher.

    If errors hide that, return whether the way there goes uphill at both ends.
    """
    gain = sure_gain(problem, here, there)
    step = problem.sign * (there.parameters - here.parameters)
    return gain > 0 or (
        gain == 0 and bool(here.gradient @ step > 0) and bool(there.gradient @ step > 0)
    )


def walks(problem: Problem, row: Evaluation) -> bool:
    """Return whether an objective is known, and a basin or disturbance, if any, is positive."""
    sizes = [
        size
        for name, size in zip(problem.measures, row.measures, strict=True)
        if name in (*SIZES, "least-disturbance")
    ]
    return bool(np.isfinite(row.value)) and (not sizes or any(size > 0 for size in sizes))


def can_be_climbed(problem: Problem, row: Evaluation) -> bool:
    """Return whether an objective has a gradient, and something walks."""
    return walks(problem, row) and bool(np.isfinite(row.gradient).all())


def climb_to_walking(trace: Trace, run: int, row: Evaluation) -> Evaluation | None:
    """Take long steps to more stable gaits, until an objective that was zero can be climbed."""
    problem = trace.problem
    for _ in range(MAX_STEPS_TO_WALKING):
        gait = trace.gait(row.parameters)
        walker = problem.walker_at(row.parameters)
        wanted = ("spectral-radius",)
        measures = differentiate_measures(
            walker, problem.names, gait, wanted, {}, problem.tolerance
        )
        growth = measures["spectral-radius"].gradient * problem.scale
        steepest = np.abs(growth).max()
        if not (np.isfinite(steepest) and steepest > 0):
            return None
        place = problem.place_of(row.parameters) - STEP_SIZES[0] * growth / steepest
        goal = trace.limits.nearest_allowed(problem.within(place))
        if goal is None:
            return None
        row = trace.measure(run, 0, goal)
        if can_be_climbed(problem, row):
            return row
    return None


def explain_failure(trace: Trace, place: Float[np.ndarray, " parameters"]) -> str:
    """Say why a climb from a place fails."""
    problem, values = trace.problem, trace.problem.values(place)
    where, refusal = problem.describe_values(values), problem.refusal(values)
    if refusal:
        return f"{where}: {refusal}"
    gait = trace.gait(values)
    how = ("spectral-radius", *problem.limits), problem.functions, problem.tolerance
    measures = differentiate_measures(problem.walker_at(values), (), gait, *how)
    radius = measures["spectral-radius"].value
    if np.isnan(radius):
        return f"{where}: no gait is found"
    for name, (low, high) in problem.limits.items():
        value = measures[name].value
        if not low <= value <= high:
            limit = f"at least {low:g}" if value < low else f"at most {high:g}"
            return f"{where}: {name} is {value:.4g}, and the search found no place with {limit}"
    return (
        f"{where}: nothing walks, or the objective has no gradient; "
        f"the gait of period {len(gait.states)} has a multiplier of modulus {radius:.4g} a stride"
    )
