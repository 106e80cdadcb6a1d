"""Strides on uneven ground, steps to a fall, metastable walking, and the gait sensitivity norm."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_lyapunov
from scipy.sparse import csr_array

import walker_jax as wj
from walker_jax import Disturbance, Outcome, SimplestWalker
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels.control import MAX_UNROLLED_TURNS
from walker_jax.stability import rough_ground, stochastic_map
from walker_jax.stability.rough_ground import (
    NormalSteps,
    draw,
    mean_life,
    start_of_walks,
    walk_disturbed,
)
from walker_jax.stability.stochastic_map import (
    FALLEN,
    FORGOTTEN,
    ROUNDS,
    UNKNOWN,
    Chart,
    Rough,
    choose_walkers,
    known_cells,
    solve_chain,
    transition_matrix,
    widening,
)
from walker_jax.walking.disturbed import follow_disturbed
from walker_jax.walking.scan import Walked

SLOPE = 0.009
WALKER = SimplestWalker(SLOPE)
FULL = np.array([0.2, 0.4, -0.2, (1 - np.cos(0.4)) * -0.2])


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(WALKER)


def field(t, y):
    theta, phi, thetadot, phidot = y
    swing = np.sin(phi) * (thetadot**2 - np.cos(theta - SLOPE)) + np.sin(theta - SLOPE)
    return [thetadot, phidot, np.sin(theta - SLOPE), swing]


def test_a_step_up_ends_where_the_foot_comes_down_to_its_height():
    """By Runge-Kutta, which sees the foot rise above the step and come down to it."""
    for step in (1e-5, 1e-3, 4e-3):
        found = wj.stride(WALKER, FULL[[0, 2]], step=step)
        assert found.outcome == Outcome.STRIDE
        height = lambda t, y, step=step: np.cos(y[0]) - np.cos(y[0] - y[1]) - step
        height.direction = -1
        way = {"rtol": 1e-13, "atol": 1e-13, "method": "DOP853"}
        solution = solve_ivp(field, (0, 6), FULL, events=height, **way)
        ahead = solution.y_events[0][:, 1] < 0
        assert ahead.any()
        time = solution.t_events[0][ahead][0]
        theta, phi, thetadot, _ = solution.y_events[0][ahead][0]
        assert float(found.time) == pytest.approx(time, abs=1e-9)
        rate = np.cos(phi) * thetadot
        expected = theta - phi, -phi, rate, rate * (1 - np.cos(phi))
        np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-9)
    too_high = wj.stride(WALKER, FULL[[0, 2]], step=0.2)
    assert too_high.outcome == Outcome.FORWARD and np.isnan(too_high.state).all()


@pytest.mark.slow
def test_a_step_of_no_height_has_the_derivative_of_both_sides():
    """The strike's place does not jump: differences agree from above, below, and across."""
    state = lambda step: wj.stride(WALKER, FULL[[0, 2]], step=step).state
    even = wj.stride(WALKER, FULL[[0, 2]])
    np.testing.assert_allclose(state(0.0)[jnp.array([0, 2])], even.state, rtol=0, atol=1e-14)
    rate, h = jax.jacfwd(state)(0.0), 1e-5
    for side in (-1, 1):
        one, two = ((state(side * k * h) - state(0.0)) / (side * k * h) for k in (1, 2))
        np.testing.assert_allclose(2 * one - two, rate, rtol=0, atol=2e-6)


def test_a_foot_down_to_lower_ground_and_up_again_strikes():
    """Within one step of integration, as the legs pass each other."""
    walker = wj.PoweredWalker(SLOPE, 3.0, 0.1, -0.2)
    start, step = [0.1969, 1.1292, -0.1877, 0.4361], -0.000227
    height = lambda t, y: np.cos(y[0]) - np.cos(y[0] - y[1]) - step
    torque = lambda y: np.array([0, 0, 0, -3.0 * (y[1] + 0.2) - 0.1 * y[3]])
    powered = lambda t, y: field(t, y) + torque(y)
    way = {"rtol": 1e-13, "atol": 1e-13, "method": "DOP853"}
    solution = solve_ivp(powered, (0, 8), start, events=height, **way)
    ahead = solution.y_events[0][:, 1] < 0
    down, up = solution.t_events[0][ahead]
    assert down < up < down + 0.05
    time = wj.stride(walker, np.array(start), step=step).time
    assert float(time) == pytest.approx(down, abs=1e-7)


@pytest.mark.parametrize("step", [np.nan, np.inf, -np.inf])
def test_a_step_that_is_none_is_refused(step):
    with pytest.raises(ValueError, match="step"):
        wj.stride(WALKER, FULL[[0, 2]], step=step)


def test_a_walk_on_rough_ground_is_strides_of_given_heights(gait):
    heights = jnp.array([1e-4, -3e-4, 0.0, 2e-4])
    made = wj.walk(WALKER, gait.states[0], 4, ground=heights)
    state = jnp.asarray(gait.states[0])
    for number, height in enumerate(heights):
        result = wj.stride(WALKER, state, step=float(height))
        np.testing.assert_allclose(made.states[number + 1], result.state, rtol=0, atol=1e-11)
        assert made.times[number] == pytest.approx(float(result.time), abs=1e-10)
        state = result.state
    even = wj.walk(WALKER, gait.states[0], 4, ground=np.zeros(4))
    expected = wj.walk(WALKER, gait.states[0], 4)
    np.testing.assert_allclose(even.states[:, [0, 2]], expected.states, rtol=0, atol=1e-11)
    assert (wj.walk(WALKER, np.array([1.0, -0.2]), 4, ground=np.zeros(4)).outcomes == 5).all()
    with pytest.raises(ValueError, match="ground"):
        wj.walk(WALKER, gait.states[0], 4, ground=np.zeros(3))


@pytest.mark.slow
def test_a_walk_changes_with_heights_as_derivatives_say(gait):
    end = jax.jit(lambda ground: wj.walk(WALKER, gait.states[0], 4, ground=ground).states[-1])
    uneven, h = jnp.array([1.3e-4, -2.7e-4, 3e-5, 2.3e-4]), 5e-6  # no step of no height is near
    for column, one in zip(jax.jit(jax.jacfwd(end))(uneven).T, h * np.eye(4), strict=True):
        change = lambda k, one=one: end(uneven + k * one) - end(uneven - k * one)
        central = (8 * change(1) - change(2)) / (12 * h)
        np.testing.assert_allclose(column, central, rtol=1e-7, atol=1e-6)


def test_disturbed_walks_are_strides_one_after_the_other(gait, monkeypatch):
    """Also those strides that are made after walks that have fallen are left out."""
    per_call = MAX_UNROLLED_TURNS + 1  # a loop, which is compiled sooner than as many strides
    monkeypatch.setattr(rough_ground, "STRIDES_PER_CALL", per_call)
    draw_one = lambda key: Disturbance(*(3e-4 * jax.random.normal(key, (3,), float)))
    keys, most = jax.random.split(jax.random.key(3), 20), 2 * per_call
    start = start_of_walks(WALKER, gait, None)
    ends = walk_disturbed(WALKER, np.tile(start, (20, 1)), draw_one, keys, most, None)
    drawn = np.asarray(draw(draw_one, keys, 0, most))
    early, late, lasting = (
        int(np.flatnonzero(one)[0])
        for one in (
            ends.strides < per_call,
            (ends.strides > per_call) & (ends.strides < most),
            ends.outcome == Outcome.STRIDE,
        )
    )
    for number in (early, late, lasting):
        state, made, outcome = start, 0, Outcome.STRIDE
        for step, slope, push in drawn[number]:
            theta, phi, thetadot, phidot = state
            pushed = [theta, phi, thetadot + push, phidot + (1 - np.cos(phi)) * push]
            result = wj.stride(SimplestWalker(SLOPE + slope), np.array(pushed), step=step)
            outcome = result.outcome
            if outcome != Outcome.STRIDE:
                break
            state, made = np.asarray(result.state), made + 1
        assert made == ends.strides[number] and outcome == ends.outcome[number]
        if number == lasting:
            assert made == most
            np.testing.assert_allclose(ends.state[number], state, rtol=0, atol=1e-9)


def test_the_mean_life_of_geometric_walks_is_in_its_interval():
    """Nineteen times of twenty, censored or not; 400 experiments of 50 walks."""
    rng = np.random.default_rng(0)
    for chance, limit in ((0.02, 10**9), (0.02, 60), (0.001, 100)):
        hits = 0
        for _ in range(400):
            lives = rng.geometric(chance, 50) - 1
            ended = lives < limit
            mean, low, high = mean_life(np.minimum(lives, limit), ended, 0.95)
            assert low <= mean <= high
            hits += low <= (1 - chance) / chance <= high
        assert 365 <= hits <= 400
    assert mean_life(np.array([100, 100]), np.zeros(2, bool), 0.95)[0] == np.inf


def test_a_chain_whose_mean_life_is_known():
    """Two cells: m = P (1 + m) has a closed form."""
    P = np.array([[0.9, 0.05], [0.3, 0.6]])
    expected = np.linalg.solve(np.eye(2) - P, P.sum(axis=1))
    survival, distribution, means = solve_chain(csr_array(P))
    np.testing.assert_allclose(means, expected, rtol=1e-10)
    assert survival == pytest.approx(np.linalg.eigvals(P).max(), rel=1e-12)
    np.testing.assert_allclose(distribution @ P, survival * distribution, rtol=0, atol=1e-12)


def test_walkers_are_chosen_by_their_chances():
    """As many from each cell, each walker as often as its share of the cell's chance says."""
    rng = np.random.default_rng(0)
    numbers = rng.integers(0, 5, 200)
    chances = rng.uniform(size=200)
    cells, chance, chosen = choose_walkers(rng, numbers, chances, 5 * 10_000)
    np.testing.assert_array_equal(cells, np.arange(5))
    np.testing.assert_allclose(chance, np.bincount(numbers, chances), rtol=1e-12)
    np.testing.assert_array_equal(numbers[chosen], np.repeat(cells, 10_000))
    often = np.bincount(chosen, minlength=200) / 10_000
    np.testing.assert_allclose(often, chances / chance[numbers], rtol=0, atol=1.01e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ground", "limit"),
    [
        (lambda key: Disturbance(push=8e-4 * jax.random.normal(key, dtype=float)), 4000),
        (lambda key: Disturbance(push=1.5e-3 * jax.random.normal(key, dtype=float)), 1000),
        (lambda key: Disturbance(slope=5e-4 * jax.random.normal(key, dtype=float)), 1000),
        (NormalSteps(3e-4), 1000),
        (NormalSteps(1.5e-4), 10_000),
    ],
    ids=["push", "strong push", "slope", "step", "small step"],
)
def test_walks_last_as_long_as_the_stochastic_cell_map_says(gait, ground, limit):
    walks = wj.steps_to_fall(WALKER, ground, 2000, jax.random.key(1), gait=gait, limit=limit)
    chain = wj.steps_to_fall(WALKER, ground, key=jax.random.key(2), method="cells", gait=gait)
    mean, error = float(chain["mean_strides"]), float(chain["mean_strides_error"])
    assert mean - 1.96 * error < walks.high and walks.low < mean + 1.96 * error
    assert error < 0.15 * mean
    assert float(chain["chance"].sum()) == pytest.approx(1, abs=1e-12)
    # Once it has forgotten where it began, a walk makes survival / (1 - survival) more.
    late = walks.strides >= 20
    falls = np.count_nonzero(walks.ended[late])
    more = (walks.strides[late] - 20).sum() / falls
    relative = 1.96 * (1 / np.sqrt(falls) + error / mean)
    survival = float(chain["survival"])
    assert survival / (1 - survival) == pytest.approx(more, rel=relative)


def test_a_walk_without_an_answer_is_no_fall(gait, monkeypatch):
    """It counts with the strides that it made, as one that is left off."""
    outcomes = np.array([Outcome.FORWARD, Outcome.UNDECIDED, Outcome.STRIDE], np.int8)
    walks = Walked(np.zeros((3, 4)), outcomes, np.array([5, 7, 10]))
    module = "walker_jax.stability.time_to_fall.walk_disturbed"
    monkeypatch.setattr(module, lambda *_: walks)
    found = wj.steps_to_fall(WALKER, 1e-3, 3, gait=gait, limit=10)
    assert found.ended.tolist() == [True, False, False] and found.mean == 22
    assert found.outcomes.tolist() == outcomes.tolist()


def test_a_stride_without_an_answer_is_no_fall_in_the_map(monkeypatch):
    """Of ten strides one falls and three have no answer: the chance to survive is 6 / 7."""

    def made(_, arguments, __):
        number = np.arange(len(arguments[1])) % 10
        outcome = np.where(number < 6, Outcome.STRIDE, Outcome.UNDECIDED)
        outcome[number == 6] = Outcome.FORWARD
        fields: Any = arguments[1], outcome, np.ones(len(number))
        return wj.Stride(*fields)

    monkeypatch.setattr("walker_jax.stability.stochastic_map.map_cells", made)
    chart = Chart(np.zeros(2), np.eye(2))
    rough = Rough(WALKER, NormalSteps(1e-3), 1000, 1.0, None)
    drawn = rough, chart, np.full((50, 4), 0.5)
    chain, cells, undecided = transition_matrix(*drawn, jax.random.key(0))
    assert len(cells) == 1 and solve_chain(chain)[0] == pytest.approx(6 / 7, rel=1e-12)
    assert undecided == (ROUNDS - FORGOTTEN) * 300


def test_a_stochastic_map_that_cannot_be_says_why(gait, monkeypatch):
    """Walks that all end, walks that reach too many cells, and walks that never end."""
    outcome = Outcome.FORWARD

    def made(_, arguments, __):
        count = len(arguments[1])
        fields: Any = arguments[1], np.full(count, outcome), np.ones(count)
        return wj.Stride(*fields)

    monkeypatch.setattr(stochastic_map, "map_cells", made)
    chart = Chart(np.zeros(2), np.eye(2))
    rough = Rough(WALKER, NormalSteps(1e-3), 1000, 1.0, None)
    drawn = rough, chart, np.full((50, 4), 0.5)
    with pytest.raises(ComputationFailed, match=r"no cell leads to another: .* more even"):
        transition_matrix(*drawn, jax.random.key(0))
    with monkeypatch.context() as patch:
        patch.setattr(stochastic_map, "MOST_CELLS", 0)
        with pytest.raises(ComputationFailed, match="walks reach more than 0 cells: side must be"):
            transition_matrix(*drawn, jax.random.key(0))
    outcome = Outcome.STRIDE
    scattered = np.random.default_rng(0).normal(size=(500, 4))
    pilot = Walked(scattered, np.full(500, Outcome.STRIDE), np.full(500, 8))
    monkeypatch.setattr(stochastic_map, "walk_disturbed", lambda *_: pilot)
    with pytest.raises(ComputationFailed, match=r"no walker fell from any of \d+ cells: ground is"):
        wj.steps_to_fall(WALKER, 1e-3, 64, method="cells", gait=gait, side=100.0)


def test_cells_of_which_nothing_is_known_are_left_out():
    """Otherwise they would have the chance 0 to survive, and so would those that lead there."""
    starts, ends = np.array([0, 0, 1, 2, 3, 4]), np.array([0, 1, 2, UNKNOWN, FALLEN, 9])
    np.testing.assert_array_equal(known_cells(starts, ends), [0, 3])
    with pytest.raises(ComputationFailed, match="no cell leads"):
        known_cells(starts[3:4], ends[3:4])


def test_steps_to_fall_refuses_bad_arguments_in_one_line(gait):
    for name, arguments in {
        "ground": (-1.0,),
        "ground must return": (lambda key: "rough",),
        "n must": (0.001, 0),
        "key must be": (0.001, 10, 7),
        "key must be one": (0.001, 10, jnp.ones(3)),
        "key must be one random": (0.001, 10, jax.random.split(jax.random.key(0))),
        "ground must be hashable": (Unhashable(),),
    }.items():
        with pytest.raises(ValueError, match=name):
            wj.steps_to_fall(WALKER, *arguments, gait=gait)
    with pytest.raises(ValueError, match="limit"):
        wj.steps_to_fall(WALKER, 0.001, gait=gait, limit=0)
    with pytest.raises(WrongUse, match="gait must be on the section"):
        wj.steps_to_fall(wj.RoundFootWalker(0.01), 0.001, gait=gait)
    with pytest.raises(WrongUse, match="slope must be one number"):
        wj.steps_to_fall(jax.vmap(SimplestWalker)(jnp.array([0.004, 0.009])), 0.001, gait=gait)


@dataclass
class Unhashable:
    """As all dataclasses that can be changed."""

    def __call__(self, key):
        return jax.random.normal(key)


def test_few_walks_have_an_interval_that_holds():
    """Of the binomial distribution: at least 95 % of intervals hold the mean life."""
    rng = np.random.default_rng(1)
    for chance, count, limit in ((0.5, 5, 10**9), (0.1, 5, 10**9), (0.5, 10, 2)):
        hits = 0
        for _ in range(400):
            lives = rng.geometric(chance, count) - 1
            mean, low, high = mean_life(np.minimum(lives, limit), lives < limit, 0.95)
            assert 0 <= low <= mean <= high
            hits += low <= (1 - chance) / chance <= high
        assert hits >= 370
    mean, low, high = mean_life(np.zeros(1, int), np.ones(1, bool), 0.95)
    assert (mean, low) == (0, 0) and high == pytest.approx(39)  # P(fall) = 0.025 or more


def test_the_scatter_of_few_repetitions_is_widened_by_student():
    """For means of four normally distributed numbers."""
    drawn = np.random.default_rng(0).normal(size=(20_000, 4))
    error = widening(4) * drawn.std(axis=1, ddof=1) / 2
    assert abs(np.mean(np.abs(drawn.mean(axis=1)) < 1.96 * error) - 0.95) < 0.005
    assert widening(4) == pytest.approx(1.6237, abs=1e-4)


def test_the_error_of_a_mean_life_is_widened_too(gait, monkeypatch):
    """Of two repetitions whose lives are 100 and 121: Student's t is then Cauchy's."""
    lives = iter([100, 121])
    rng = np.random.default_rng(0)

    def walk(walker, states, *_):
        n = len(states)
        made = np.full(n, stochastic_map.PILOT_STRIDES)
        return Walked(rng.normal(size=states.shape), np.zeros(n, np.int8), made)

    def one_cell(rough, chart, states, key):
        return csr_array(np.ones((1, 1))), chart.cell_of(states[:1], rough.side), 0

    def solve(chain):
        return 0.99, np.ones(1), np.full(1, next(lives) - stochastic_map.PILOT_STRIDES)

    monkeypatch.setattr(stochastic_map, "walk_disturbed", walk)
    monkeypatch.setattr(stochastic_map, "transition_matrix", one_cell)
    monkeypatch.setattr(stochastic_map, "solve_chain", solve)
    found = wj.steps_to_fall(WALKER, 1e-3, method="cells", gait=gait, repetitions=2)
    assert float(found["mean_strides"]) == pytest.approx(110, rel=1e-12)
    half = 110 * np.log(121 / 100) / 2 * np.tan(0.475 * np.pi)  # of a 95 % interval
    assert 1.95996398 * float(found["mean_strides_error"]) == pytest.approx(half, rel=1e-8)


@pytest.mark.slow
def test_even_ground_has_no_stochastic_map(gait):
    with pytest.raises(ComputationFailed, match="too even"):
        wj.steps_to_fall(WALKER, 0.0, method="cells", gait=gait)


# The gait sensitivity norm


@pytest.mark.slow
def test_the_norm_is_that_of_the_matrices(gait):
    found = wj.gait_sensitivity(WALKER, gait)
    A, B, C, D = (np.asarray(one) for one in found[1:5])
    x, h = jnp.stack(WALKER.lift(jnp.asarray(gait.states[0]))), 1e-5
    response = jax.jit(
        lambda e: follow_disturbed(WALKER, x, Disturbance(*e), Integrator(jnp.asarray(1e-12)))
    )
    for column, unit in zip(B.T, np.eye(3), strict=True):
        step = lambda k, unit=unit: response(k * h * unit).state - response(-k * h * unit).state
        central = (8 * step(1) - step(2)) / (12 * h)
        np.testing.assert_allclose(column, central, rtol=0, atol=1e-7)
    moduli = np.sort(np.abs(np.linalg.eigvals(A)))[::-1]
    np.testing.assert_allclose(moduli, [*np.abs(gait.multipliers), 0, 0], rtol=0, atol=1e-9)
    X = solve_discrete_lyapunov(A.T, C.T @ C)
    assert float(found.norm) == pytest.approx(np.sqrt(np.trace(D.T @ D + B.T @ X @ B)), rel=1e-12)
    series, power = np.trace(D.T @ D), np.eye(4)
    for _ in range(200):
        series, power = series + np.linalg.norm(C @ power @ B) ** 2, power @ A
    assert float(found.norm) ** 2 == pytest.approx(series, rel=1e-10)
    assert float(found.terms.sum()) == pytest.approx(series, rel=1e-10)


def own(walker, start, end, time):
    return -2 * time


def both(size):
    return Disturbance(step=size, push=3 * size)


RESPONSE = ("push", "step", both), ("time", "length", "speed", own)
"""Disturbances and indicators."""


@pytest.mark.slow
def test_indicators_and_disturbances_may_be_ones_own(gait):
    found = wj.gait_sensitivity(WALKER, gait, *RESPONSE)
    for matrix in (found.B, found.D):
        push, step, together = matrix.T
        np.testing.assert_allclose(together, step + 3 * push, rtol=0, atol=1e-11)
    time, length = float(gait.step_times[0]), 2 * np.sin(gait.states[0][0])
    rates = np.concatenate([found.C, found.D], axis=1)
    np.testing.assert_allclose(rates[3], -2 * rates[0], rtol=1e-13)
    speed = rates[1] / time - length / time**2 * rates[0]
    np.testing.assert_allclose(rates[2], speed, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_an_unstable_gait_has_no_norm_and_bad_names_are_refused(gait):
    short = min(wj.find_gaits(WALKER), key=lambda one: one.states[0][0])
    assert wj.gait_sensitivity(WALKER, short, *RESPONSE).norm == np.inf
    with pytest.raises(ValueError, match="wind"):
        wj.gait_sensitivity(WALKER, gait, ("wind",))
    with pytest.raises(ValueError, match="colour"):
        wj.gait_sensitivity(WALKER, gait, ("step",), ("colour",))
    with pytest.raises(ValueError, match="none"):
        wj.gait_sensitivity(WALKER, gait, ())


@pytest.mark.slow
def test_the_norm_has_a_gradient(gait):
    def norm(slope):
        walker = SimplestWalker(slope)
        return wj.gait_sensitivity(walker, wj.find_gait(walker, gait.states[0])).norm

    rate, h = jax.grad(norm)(SLOPE), 2e-5
    step = lambda k: (norm(SLOPE + k * h) - norm(SLOPE - k * h)) / (2 * k * h)
    assert float(rate) == pytest.approx(float((4 * step(1) - step(2)) / 3), rel=1e-5)
