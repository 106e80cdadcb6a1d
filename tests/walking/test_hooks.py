"""Walkers with every hook of their own: all that follows strides agrees about each start."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fixed_steps import Legs, strides

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.walkers.model import State

NAMES = "stiffness", "limit", "slowest", "spread", "least", "bound", "grip", "kept"


class Hooked(wj.SimplestWalker):
    """The simplest walker, but for its equations, contact, falls, conditions, forces and impact."""

    stiffness: jax.Array
    """Of a hinge between the legs."""
    limit: jax.Array
    """It has fallen where theta is below that,"""
    slowest: jax.Array
    """where thetadot is above that,"""
    spread: jax.Array
    """and where phi is below that."""
    least: jax.Array
    """Of -theta at heel strike."""
    bound: jax.Array
    """Of |phidot|, in a stride that reaches heel strike."""
    grip: jax.Array
    """Weight that presses the stance foot down, in that of the hip."""
    kept: jax.Array
    """Part of all rates that is left after an impact."""

    def vector_field(self, state):
        rates = super().vector_field(state)
        return rates._replace(phidot=rates.phidot - self.stiffness * jnp.sin(state.phi))

    def contact(self, state):
        return jnp.sinh(state.phi - 2 * state.theta)

    def is_ahead(self, state):
        return -self.least - state.theta

    def falls(self, state):
        return {
            "BACKWARD": state.thetadot - self.slowest,
            "FORWARD": self.limit - state.theta,
            "SIDEWAYS": self.spread - state.phi,
        }

    def conditions(self):
        return {"BUCKLED": lambda state: self.bound**2 - state.phidot**2}

    def contact_force(self, state):
        tension = state.thetadot**2 - self.grip * jnp.cos(state.theta - self.slope)
        return jnp.sin(state.theta) * tension, -jnp.cos(state.theta) * tension

    def impact(self, state):
        foot, (theta, phi, thetadot, phidot) = super().impact(state)
        return foot, State(theta, phi, self.kept * thetadot, self.kept * phidot)


def hooked(slope: float, **values: float) -> Hooked:
    return Hooked(jnp.asarray(slope), *(jnp.asarray(values[name]) for name in NAMES))


ONE = dict(
    slope=0.01, stiffness=0.4, limit=-0.5, slowest=-0.01, spread=-0.75, least=0.03, bound=0.62,
    grip=0.9, kept=0.99,
)  # fmt: skip


def at_random(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    ranges = {
        "slope": (0.005, 0.03),
        "stiffness": (0.0, 1.5),
        "limit": (-0.7, -0.2),
        "slowest": (-0.1, 0.0),
        "spread": (-1.0, -0.4),
        "least": (-0.05, 0.2),
        "bound": (0.4, 1.2),
        "grip": (0.5, 1.1),
        "kept": (0.9, 1.1),
    }
    return {name: rng.uniform(*ends) for name, ends in ranges.items()}


def legs_of(values: dict[str, float]) -> Legs:
    """The same walker for the independent integration."""
    falls = (
        (int(Outcome.BACKWARD), lambda y: y[:, 2] - values["slowest"]),
        (int(Outcome.FORWARD), lambda y: values["limit"] - y[:, 0]),
        (int(Outcome.SIDEWAYS), lambda y: values["spread"] - y[:, 1]),
    )
    return Legs(
        values["slope"],
        lambda y: -values["stiffness"] * np.sin(y[:, 1]),
        lambda y: y[:, 0] < -values["least"],
        falls,
        (int(Outcome.BUCKLED), lambda y: values["bound"] ** 2 - y[:, 3] ** 2),
        values["grip"],
        values["kept"],
    )


def starts(n: int, seed: int) -> np.ndarray:
    """Where strides end in all ways."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.05, 0.6, n)
    return np.stack([theta, -theta * rng.uniform(0.7, 1.6, n)], axis=1)


@pytest.fixture(scope="module")
def some():
    """Walkers, 200 starts in all, and their strides by small steps of one length."""
    found = []
    for seed, count in enumerate((60, 70, 70)):
        values = at_random(seed) if seed else ONE
        xs = starts(count, seed)
        found.append((hooked(**values), xs, strides(legs_of(values), xs)))
    return found


def test_strides_are_those_of_an_independent_integration(some):
    ways = set()
    for walker, xs, expected in some:
        found = wj.strides(walker, xs)
        np.testing.assert_array_equal(found.outcome, expected.outcome)
        np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=1e-7)
        ways |= set(found.outcome.tolist())
    assert ways >= {
        Outcome.STRIDE,
        Outcome.FORWARD,
        Outcome.BACKWARD,
        Outcome.RUNNING,
        Outcome.BUCKLED,
        Outcome.SIDEWAYS,
    }


def test_margins_are_of_the_same_strides_and_have_their_signs(some):
    for walker, xs, expected in some:
        found = wj.margins(walker, xs)
        np.testing.assert_array_equal(found.stride.outcome, expected.outcome)
        values = found.failed
        fails = ~np.isin(expected.outcome, [Outcome.STRIDE, Outcome.OUTSIDE])
        assert (values[fails] <= 0).all() and np.isnan(values[~fails]).all()
        made = expected.outcome == Outcome.STRIDE
        for margin in found.by_name.values():
            assert np.all((margin[made] > 0) | np.isnan(margin[made]))


def test_walks_films_and_trajectories_are_of_the_same_strides(some):
    walker, xs, expected = some[0]
    walk = jax.jit(jax.vmap(lambda x: wj.walk(walker, x, 2)))(xs)
    np.testing.assert_array_equal(walk.outcomes[:, 0], expected.outcome)
    made = np.flatnonzero(expected.outcome == Outcome.STRIDE)
    np.testing.assert_allclose(walk.states[made, 1], expected.state[made], rtol=0, atol=1e-7)
    again = strides(legs_of(ONE), np.asarray(walk.states[made, 1]))
    np.testing.assert_array_equal(walk.outcomes[made, 1], again.outcome)
    for i in made[:4]:
        end = wj.trajectory(walker, xs[i], np.asarray(walk.times[i, :1]))
        arrival = State(*(values[0] for values in end))
        assert float(walker.contact(arrival)) == pytest.approx(0, abs=1e-9)
        after = walker.project(walker.exchange_legs(walker.impact(arrival)[1]))
        np.testing.assert_allclose(after, walk.states[i, 1], rtol=0, atol=1e-9)
    for code in (Outcome.STRIDE, Outcome.FORWARD, Outcome.SIDEWAYS):
        i = int(np.argmax(expected.outcome == code))
        film = wj.motion(walker, xs[i], 1, step=0.02)
        assert film.outcome.values.tolist() == [code]
        assert film.theta.values.min() > ONE["limit"] - 0.02
        assert film.phi.values.min() > ONE["spread"] - 0.04


def fates(walker: Any, points: np.ndarray, count: int) -> np.ndarray:
    """Outcomes of walks of some strides, one stride after the other."""
    fate, x = np.zeros(len(points), int), points.copy()
    for _ in range(count):
        going = fate == 0
        found = wj.strides(walker, x)
        fate = np.where(going, found.outcome, fate)
        x = np.where((fate == 0)[:, None], found.state, points)
    return fate


GAIT = np.array([0.2, -0.2])
"""Close to that of the first walker."""
GRID = wj.Grid.sheared(theta=(0.1, 0.4, 16), sum=(-0.08, 0.04, 16))


@pytest.fixture(scope="module")
def walking():
    return hooked(**ONE)


def test_basins_have_the_fates_of_strides(walking):
    direct = wj.basin(walking, GRID, "direct", strides=30)
    theta, total = np.meshgrid(direct["theta"], direct["sum"], indexing="ij")
    points = np.stack([theta.ravel(), (total - theta).ravel()], axis=1)
    expected = fates(walking, points, 30)
    assert len(set(expected.tolist())) > 3 and (expected == 0).sum() > 10
    np.testing.assert_array_equal(direct["fate"].values.ravel(), expected)
    # Of a random point in each cell, which only on a boundary has another fate than the centre.
    refined = wj.refine(walking, GRID, 0, strides=30, check=0)["fate"].values
    alike = np.ones(refined.shape, bool)
    for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
        alike &= np.roll(expected.reshape(refined.shape), by, axis) == direct["fate"].values
    assert alike.sum() > 100
    np.testing.assert_array_equal(refined[alike], direct["fate"].values[alike])
    first = wj.strides(walking, points).outcome
    mapped = wj.basin(walking, GRID, "cell-map")["fate"].values.ravel()
    np.testing.assert_array_equal(mapped[first != 0], first[first != 0])


@pytest.fixture(scope="module")
def nearest(walking):
    """Its gait, and the nearest start that does not return to it."""
    gait = wj.find_gait(walking, GAIT)
    return gait, wj.least_disturbance(walking, gait, directions=16, strides=60)


@pytest.mark.slow
def test_the_least_disturbance_is_where_strides_begin_to_fail(walking, nearest):
    gait, found = nearest
    x = np.asarray(gait.states[0])
    beside = x + np.array([[1 - 1e-6], [1 + 1e-6]]) * (np.asarray(found.state) - x)
    ends = fates(walking, beside, 60)
    assert ends[0] == 0 and ends[1] == found.failure


@pytest.mark.slow
def test_its_gradient_is_that_of_sizes(walking, nearest):
    gait, _ = nearest
    names = "limit", "spread", "bound", "least"
    options: Any = dict(directions=48, strides=100)
    gradient = wj.measure(walking, "least-disturbance", names, gait, **options).gradient

    def size(name: str, change: float) -> float:
        other = hooked(**ONE | {name: ONE[name] + change})
        return wj.least_disturbance(other, wj.find_gait(other, gait.states[0]), **options).size

    for name, slope in zip(names, gradient, strict=True):
        change = (size(name, 1e-5) - size(name, -1e-5)) / 2e-5
        assert slope == pytest.approx(change, abs=1e-4)


@pytest.mark.slow
def test_the_gradient_of_the_area_is_that_of_areas(walking):
    """By a parameter that moves the boundary by more than the errors."""
    finer = wj.Grid.sheared(theta=(0.1, 0.4, 48), sum=(-0.08, 0.04, 48))
    found = wj.measure(walking, "area", ("stiffness",), grid=finer, levels=2, check=3000)
    areas = [
        float(wj.refine(hooked(**ONE | {"stiffness": value}), GRID, 3, check=3000).total_area)
        for value in (ONE["stiffness"] - 0.05, ONE["stiffness"] + 0.05)
    ]
    error = 3 * float(found.gradient_error[0]) + 0.05 * abs(found.gradient[0])
    assert error < found.gradient[0] / 2
    assert found.gradient[0] == pytest.approx((areas[1] - areas[0]) / 0.1, abs=error)
