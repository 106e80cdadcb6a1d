"""Design over uncertain parameters: means over the same draws, and their gradients."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.design.evaluation import evaluate_objective
from walker_jax.design.posing import pose_problem
from walker_jax.design.problem import describe_problem
from walker_jax.design.tolerances import draw_tolerances, gait_with_most_starts

WALKER = wj.SimplestWalker(0.009)
VALUES = np.array([0.0095])


def problem(worst=False, seed=0):
    over = draw_tolerances(WALKER, {"slope": 2e-4}, 3, worst, seed)
    how = (None, 2, 50, 0, None, None, {}, over)
    return pose_problem(
        WALKER, {"slope": (0.005, 0.012)}, ({"spectral-radius": 1.0}, -1.0), {}, how
    )


def changes(**options):
    """Return the drawn changes of a problem."""
    over = problem(**options).over
    assert over is not None
    return over.changes


def evaluate(posed):
    gait = lambda values: gait_with_most_starts(posed, values)
    return evaluate_objective(posed, 0, VALUES, gait, lambda how, walker: how.measure(walker))


def each():
    """The measure at each drawn slope, without tolerances."""
    slopes = VALUES + changes()[:, 0]
    return [wj.measure(wj.SimplestWalker(s), "spectral-radius", "slope") for s in slopes]


def test_the_objective_is_the_mean_over_draws():
    row, singles = evaluate(problem()), each()
    assert row.value == pytest.approx(np.mean([one.value for one in singles]), rel=1e-9)
    np.testing.assert_allclose(row.gradient, np.mean([o.gradient for o in singles], 0), rtol=1e-6)
    np.testing.assert_array_equal(row.parameters, VALUES)


def test_the_worst_draw_counts_if_asked():
    """A smaller spectral radius is better, so the largest counts."""
    row, singles = evaluate(problem(worst=True)), each()
    worst = max(singles, key=lambda one: one.value)
    assert row.value == pytest.approx(worst.value, rel=1e-9)
    np.testing.assert_allclose(row.gradient, worst.gradient, rtol=1e-6)


def test_draws_are_common_and_part_of_the_problem():
    """Or an earlier result with other draws would be reused."""
    np.testing.assert_array_equal(changes(), changes())
    told = [describe_problem(one)["draws"] for one in (problem(), problem(), problem(seed=1))]
    assert told[0] == told[1] != told[2]
    assert "draws" not in describe_problem(problem()._replace(over=None))
