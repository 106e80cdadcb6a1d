"""Pareto fronts and objectives that are functions, against fronts known in closed form."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.design.fronts import pareto


def settle(x, p, q):
    """Leads to the point (p, q), from everywhere."""
    return jnp.stack([p + 0.5 * (x[0] - p), q - 0.3 * (x[1] - q)])


REGION = {"x": (-3.0, 3.0, 4), "y": (-3.0, 3.0, 4)}
POINT = wj.Map(settle, ("x", "y"), parameters={"p": 0.4, "q": -0.3}, region=REGION)
BOUNDS = {"p": (-2.0, 2.0), "q": (-2.0, 2.0)}


def near_one(machine, gait):
    """Largest at (1, 1)."""
    return -jnp.sum((gait.states[0] - 1) ** 2)


def near_minus_one(machine, gait):
    return -jnp.sum((gait.states[0] + 1) ** 2)


def bell_one(machine, gait):
    """Of Fonseca and Fleming (1995), whose front is concave."""
    return jnp.exp(-jnp.sum((gait.states[0] - 1 / jnp.sqrt(2)) ** 2))


def bell_minus_one(machine, gait):
    return jnp.exp(-jnp.sum((gait.states[0] + 1 / jnp.sqrt(2)) ** 2))


@pytest.mark.slow
def test_a_convex_front():
    """On it p = q, so the roots of both distances add up to that of their ends."""
    front = pareto(POINT, BOUNDS, (near_one, near_minus_one), points=5, starts=1, progress=False)
    assert front.converged.all() and front.sizes["point"] == 5
    np.testing.assert_allclose(front.parameters[:, 0], front.parameters[:, 1], atol=1e-5)
    roots = np.sqrt(-front.objectives)
    np.testing.assert_allclose(roots.sum("objective"), np.sqrt(8), rtol=1e-8)
    np.testing.assert_allclose(front.parameters[[0, -1]], [[1, 1], [-1, -1]], atol=1e-5)
    assert np.diff(front.objectives[:, 0]).max() < 0 < np.diff(front.objectives[:, 1]).min()
    assert list(front.objective.values) == ["near_one", "near_minus_one"]


def test_a_concave_front():
    """Its inside is reached, where weighted sums have their optima at the ends alone."""
    system = wj.Map(lambda x, p: settle(x, p, p), ("x", "y"), parameters={"p": 0.4}, region=REGION)
    bounds = {"p": BOUNDS["p"]}
    front = pareto(system, bounds, (bell_one, bell_minus_one), points=3, starts=1, progress=False)
    (p,) = front.parameters.values.T
    assert front.sizes["point"] == 3
    high = np.exp(-2 * (p - 1 / np.sqrt(2)) ** 2)
    np.testing.assert_allclose(front.objectives[:, 0], high, rtol=1e-6)
    u, v = 1 - front.objectives.values.T  # the front in closed form
    s = np.sqrt(-np.log(1 - u) / 2)
    np.testing.assert_allclose(v, 1 - np.exp(-2 * (np.sqrt(2) - s) ** 2), atol=1e-6)
    ends = front.objectives.values[[0, -1]]
    share = (front.objectives.values[1:-1] - ends[1]) / (ends[0] - ends[1])
    assert (np.diff(p) < -0.05).all()
    assert (share[:, 0] < share[:, 1]).all()  # below the line between both ends


def test_limits_hold_on_a_front():
    front = pareto(
        POINT, BOUNDS, (near_one, near_minus_one), points=3, starts=1, at_most={first: 0.2},
        progress=False,
    )  # fmt: skip
    assert (front.parameters[:, 0] < 0.2 + 1e-6).all()
    np.testing.assert_allclose(front.parameters[0], [0.2, 1.0], atol=1e-4)


def first(machine, gait):
    return gait.states[0, 0]


def test_a_front_of_one_point_and_wrong_fronts():
    twice = lambda machine, gait: 2 * near_one(machine, gait)
    front = pareto(POINT, BOUNDS, (near_one, twice), starts=1, progress=False)
    assert front.sizes["point"] == 1
    np.testing.assert_allclose(front.parameters[0], [1, 1], atol=1e-5)
    with pytest.raises(ComputationFailed, match="no start has a gait and both objectives"):
        pareto(POINT, BOUNDS, ("speed", near_one), starts=1, progress=False)


@pytest.mark.parametrize("free", ["bounds", pytest.param("parameters", marks=pytest.mark.slow)])
def test_functions_are_maximised_with_bounds_and_without(no_basins, free):
    """Of two, it is their weighted mean that is largest."""
    alone: Any = {"parameters": lambda one: (one.p, one.q), "objective": near_one}
    both: Any = {"bounds": BOUNDS, "objective": {near_one: 3.0, near_minus_one: 1.0}}
    given, best = (both, 0.5) if free == "bounds" else (alone, 1.0)
    found = wj.optimise(POINT, starts=1, progress=False, **given)
    assert bool(found.converged)
    np.testing.assert_allclose(found.optimum, [best, best], atol=0.004)
    assert found.at_bound.values.tolist() == [0, 0]


@pytest.mark.slow
def test_a_function_has_a_limit(no_basins):
    """Nearest to (1, 1) on p <= 0.2; on a front such a limit holds by default."""
    found = wj.optimise(POINT, BOUNDS, near_one, at_most={first: 0.2}, starts=1, progress=False)
    np.testing.assert_allclose(found.optimum, [0.2, 1], atol=0.004)
    assert found.measure.values[found.binding.values].tolist() == ["first"]


class Timed(wj.systems.BouncingBall):
    """With the mean of an effort along each flight."""

    def modes(self):
        (flight,) = super().modes().values()
        rates = {"effort": lambda y: y.velocity**2}
        largest = {"height": lambda y: y.height}
        return {"flight": flight._replace(integrals=rates, largest=largest)}


def test_integrals_are_objectives_and_limits(no_basins):
    """The ball lands at the table's speed of one flight, 2 pi, and its flights take that long."""
    ball = Timed(0.4, 0.8)
    gait = wj.find_gait(ball)
    parameters = "restitution", "amplitude"
    found = {one: wj.measure(ball, one, parameters, gait) for one in ("effort", "height")}
    step = 1e-5
    for name in ("effort", "height"):
        for i, of in enumerate(parameters):
            ends = []
            for side in (-step, step):
                other = Timed(
                    **{"amplitude": 0.4, "restitution": 0.8} | {of: vars(ball)[of] + side}
                )
                there = wj.find_gait(other, gait.states[0])
                ends.append(wj.measure(other, name, (), there).value)
            by = (ends[1] - ends[0]) / (2 * step)
            assert found[name].gradient[i] == pytest.approx(by, rel=1e-6, abs=1e-8)
    best = wj.optimise(ball, {"amplitude": (0.35, 0.45)}, "height", starts=1, progress=False)
    values = {one: wj.measure(Timed(one, 0.8), "height", ()).value for one in (0.35, 0.45)}
    assert float(best.exact_optimum) == pytest.approx(min(values.values()), rel=1e-6)  # minimised
    with pytest.raises(WrongUse, match=r"objective must be one of .*, effort, height, not 'work'"):
        wj.optimise(ball, {"amplitude": (0.35, 0.45)}, "work")
    effort = lambda machine, gait: gait.states[0, 0]
    effort.__name__ = "effort"
    with pytest.raises(WrongUse, match="objective must have functions of names of their own"):
        wj.optimise(ball, {"amplitude": (0.35, 0.45)}, effort)
