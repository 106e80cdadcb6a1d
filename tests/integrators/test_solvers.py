"""Strides by Runge-Kutta methods of diffrax, against those by series: two codes, one answer."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clocked import Clocked

import walker_jax as wj
from walker_jax import Outcome

SIMPLEST, ROUND = wj.SimplestWalker(0.004), wj.RoundFootWalker(0.02)
DOPRI, TSIT = diffrax.Dopri8(), diffrax.Tsit5()
START = jnp.array([0.15, -0.153])


@pytest.fixture(scope="module")
def starts():
    """About the basin at slope 0.004, failures of all kinds among them."""
    rng = np.random.default_rng(0)
    theta, total = rng.uniform(0.02, 0.4, 1000), rng.uniform(-0.04, 0.01, 1000)
    return np.stack([theta, total - theta], axis=1)


@pytest.mark.parametrize(
    ("solver", "tolerance", "error"),
    [
        (TSIT, 1e-11, 1e-8),  # of fewer stages, so quicker to compile
        pytest.param(TSIT, 1e-9, 1e-6, marks=pytest.mark.slow),
        pytest.param(DOPRI, 1e-11, 1e-8, marks=pytest.mark.slow),
    ],
)
def test_strides_by_other_solvers(starts, solver, tolerance, error):
    series = wj.strides(SIMPLEST, starts)
    found = wj.strides(SIMPLEST, starts, tolerance=tolerance, solver=solver)
    np.testing.assert_array_equal(found.outcome, series.outcome)
    assert {Outcome.STRIDE, Outcome.FORWARD, Outcome.BACKWARD} <= set(found.outcome.tolist())
    np.testing.assert_allclose(found.state, series.state, rtol=0, atol=error)
    np.testing.assert_allclose(found.time, series.time, rtol=0, atol=1e3 * error)
    assert np.nanmedian(np.abs(found.state - series.state)) < 10 * tolerance


@pytest.mark.slow
@pytest.mark.parametrize(("solver", "tolerance"), [(DOPRI, 1e-12), (TSIT, 1e-10)])
def test_outcomes_of_the_papers_grid(solver, tolerance):
    """The same, but within the solvers' error of a boundary."""
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    xs = np.asarray(jax.vmap(grid.centre)(np.arange(grid.size, dtype=np.int32)))
    series = wj.strides(SIMPLEST, xs)
    found = wj.strides(SIMPLEST, xs, tolerance=tolerance, solver=solver)
    differ = np.flatnonzero(found.outcome != series.outcome)
    margins = wj.margins(SIMPLEST, xs[differ])
    nearest = np.nanmin(np.abs(np.stack([*margins.by_name.values()])), axis=0, initial=np.inf)
    assert len(differ) <= 3 and np.all(nearest < 1e-6)


@pytest.mark.slow
def test_a_walker_of_several_masses_by_another_solver():
    gait = wj.find_gait(ROUND)
    rng = np.random.default_rng(1)
    xs = gait.states[0] + 0.02 * rng.normal(size=(300, 3))
    series, found = wj.strides(ROUND, xs), wj.strides(ROUND, xs, tolerance=1e-11, solver=DOPRI)
    np.testing.assert_array_equal(found.outcome, series.outcome)
    assert len(set(found.outcome.tolist())) > 1
    np.testing.assert_allclose(found.state, series.state, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_walks_and_their_derivatives_by_another_solver():
    by: Any = {"tolerance": 1e-12, "solver": DOPRI}
    one = lambda x, **by: wj.stride(SIMPLEST, x, **by).state
    np.testing.assert_allclose(one(START, **by), one(START), rtol=1e-11)
    forward = jax.jit(jax.jacfwd(lambda x: one(x, **by)))(START)
    np.testing.assert_allclose(forward, jax.jacfwd(one)(START), rtol=1e-8)
    backward = jax.jit(jax.jacrev(lambda x: one(x, **by)))(START)
    np.testing.assert_allclose(backward, forward, rtol=1e-12)
    walks = wj.walk(SIMPLEST, START, 4), wj.walk(SIMPLEST, START, 4, **by)
    np.testing.assert_allclose(walks[0].states, walks[1].states, rtol=0, atol=1e-10)
    times = np.linspace(0, 3, 5)
    motions = wj.trajectory(SIMPLEST, START, times), wj.trajectory(SIMPLEST, START, times, **by)
    np.testing.assert_allclose(*map(np.array, motions), rtol=0, atol=1e-10)
    gaits = wj.find_gait(SIMPLEST), wj.find_gait(SIMPLEST, **by)
    np.testing.assert_allclose(gaits[0].states, gaits[1].states, rtol=0, atol=1e-11)
    np.testing.assert_allclose(gaits[0].multipliers, gaits[1].multipliers, rtol=1e-7)


@pytest.mark.slow
def test_a_basin_by_another_solver_and_what_it_says_of_it():
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 24), sum=(-0.01, 0.005, 30))
    series = wj.basin(SIMPLEST, grid, "direct", strides=20)
    found = wj.basin(SIMPLEST, grid, "direct", strides=20, tolerance=1e-11, solver=DOPRI)
    np.testing.assert_array_equal(found.fate, series.fate)
    assert found.attrs["solver"] == "Dopri8()" and "solver" not in series.attrs
    with pytest.raises(ValueError, match="solver must not be given with a cluster"):
        wj.basin(SIMPLEST, grid, solver=DOPRI, cluster=2)


@pytest.mark.parametrize(
    "solver",
    [diffrax.Euler(), diffrax.KenCarp3(), diffrax.ImplicitEuler(), diffrax.EulerHeun()],
    ids=repr,
)
def test_solvers_that_cannot_follow_a_stride_are_refused(solver):
    calls = (
        lambda: wj.stride(SIMPLEST, START, solver=solver),
        lambda: wj.find_gait(SIMPLEST, START, solver=solver),
        lambda: wj.walk(SIMPLEST, START, 3, solver=solver),
    )
    for call in calls:
        with pytest.raises(ValueError, match="solver must be a Runge-Kutta method"):
            call()


class Damper(Clocked):
    """y' = -rate (y - cos(t)): a stiff damper that follows a slow motion."""

    rate: Any = 1e6

    def slope(self, y, t):
        return -self.rate * (y - jnp.cos(t))


def end_of_damper(rate):
    """The end of the damper's flow in closed form, where the start is forgotten."""
    return (rate * rate * np.cos(1) + rate * np.sin(1)) / (1 + rate * rate)


def test_stiff_equations_by_an_implicit_solver():
    by: Any = {"solver": diffrax.Kvaerno5(), "tolerance": 1e-9}
    made = wj.strides(Damper(), np.array([[2.0], [1.0], [-3.0]]), **by)
    np.testing.assert_allclose(made.state[:, 0], end_of_damper(1e6), rtol=0, atol=1e-8)
    np.testing.assert_allclose(made.time, 1, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::walker_jax.checks.NoKernelWarning")  # its Jacobians have none
def test_derivatives_of_stiff_equations_by_an_implicit_solver():
    by: Any = {"solver": diffrax.Kvaerno5(), "tolerance": 1e-9}
    next_point = lambda rate, x: wj.stride(Damper(rate), x, **by).state[0]
    by_rate, by_start = jax.jacfwd(next_point, (0, 1))(jnp.array(1e3), jnp.array([2.0]))
    expected = (end_of_damper(1e3 + 1) - end_of_damper(1e3 - 1)) / 2
    assert float(by_rate) == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(by_start, 0, atol=1e-12)
