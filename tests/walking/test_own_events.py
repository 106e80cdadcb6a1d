"""Heel strikes, falls and conditions that no step may hide, of walkers with rules of their own."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fixed_steps import Legs
from fixed_steps import strides as strides_by_fixed_steps
from part_of_swing import PartOfSwing

import walker_jax as wj
from walker_jax.hybrid.modes import Guard
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.step_lengths import NO_LIMITS, step_size
from walker_jax.integrators.taylor_steps import end_at_kink, smooth_step
from walker_jax.kernels import kernel
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import State
from walker_jax.walking.failure_margins import margins
from walker_jax.walking.iteration import iterate


def starts(n: int, slope: float = 0.01, seed: int = 0) -> np.ndarray:
    """Where strides end in all ways: rows of (theta, thetadot)."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.05, 0.6, n)
    return np.stack([theta, -theta + rng.uniform(-0.06, 0.02, n)], axis=1)


def assert_same(found: Any, expected: Any, atol: float = 1e-7) -> None:
    np.testing.assert_array_equal(found.outcome, expected.outcome)
    np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=atol)


# Heel strikes

SKIPPED = [0.5316570008066235, -0.5212790625538077]
"""From here the foot is down for a moment at t = 2.964."""
TORQUES = {
    (0.01, 4.0, 1.0, -0.4): (0.05676093, -0.0121357, 0.00085034),
    (0.009, 3.0, 0.8, -0.5): (0.05254409, -0.00912428, 0.00172977),
}
"""Slope, stiffness, damping and target of a hip; along which curve of theta + thetadot over theta
the foot comes down and up again within a step of the integration."""


SLOW = pytest.mark.slow
FIRST, SECOND = TORQUES


@pytest.fixture(scope="module", params=[FIRST, pytest.param(SECOND, marks=SLOW)])
def torqued(request):
    """A walker, starts about that curve and elsewhere, and their strides."""
    slope, stiffness, damping, target = request.param
    rng = np.random.default_rng(1)
    theta = rng.uniform(0.26, 0.55, 60)
    middle = np.polyval(TORQUES[request.param], theta) + rng.uniform(-1e-4, 1e-4, 60)
    near = np.stack([theta, middle - theta], axis=1)
    xs = np.concatenate([[SKIPPED], near, starts(60)])
    torque = lambda y: -stiffness * (y[:, 1] - target) - damping * y[:, 3]
    walker = wj.PoweredWalker(slope, stiffness, damping, target)
    return walker, xs, strides_by_fixed_steps(Legs(slope, torque), xs)


@pytest.mark.parametrize("tolerance", [None, 1e-15])
def test_a_foot_down_and_up_again_within_a_step_has_struck(torqued, tolerance):
    walker, xs, expected = torqued
    assert_same(wj.strides(walker, xs, tolerance=tolerance), expected)
    found = margins(walker, xs, tolerance=tolerance)
    assert_same(found.stride, expected)
    fails = ~np.isin(expected.outcome, [Outcome.STRIDE, Outcome.OUTSIDE])
    assert fails.sum() > 10
    assert (found.failed[fails] < 0).all()


def test_the_named_strike_is_that_of_a_fine_integration():
    """By Dopri8 at a tolerance of 1e-12."""
    found = wj.stride(wj.PoweredWalker(0.01, 4.0, 1.0, -0.4), jnp.array(SKIPPED))
    np.testing.assert_allclose(found.state, (0.015382, -0.079746), atol=5e-7)
    assert found.time == pytest.approx(2.9640260, abs=5e-7)


# Fields that are polynomials of time


class DriftingWalker(wj.SimplestWalker):
    """theta at a constant rate, and phi'' linear in theta: cubic in time."""

    def vector_field(self, state):
        zero = jnp.zeros_like(state.theta)
        return State(state.thetadot, state.phidot, zero, 20 * (0.02 - state.theta))


def test_a_motion_that_is_a_polynomial_of_time_ends_at_its_root():
    """With theta = a + v t, h is b t + c t^2 / 2 - 10 v t^3 / 3, where c is phi'' at the start."""
    theta, thetadot = 0.2, -0.3
    c, cubic = 20 * (0.02 - theta), -20 * thetadot
    b = (1 - np.cos(2 * theta)) * thetadot - 2 * thetadot
    roots = np.sort(np.roots([cubic / 6, c / 2, b]))
    assert 0 < roots[0] < roots[1] and theta + thetadot * roots[1] < 0
    found = wj.stride(DriftingWalker(0.01), jnp.array([theta, thetadot]))
    assert found.outcome == Outcome.STRIDE
    assert found.time == pytest.approx(roots[1], rel=1e-12)
    assert found.state[0] == pytest.approx(-theta - thetadot * roots[1], rel=1e-12)


def length_of_step(field, state, tolerance):
    made = smooth_step(field, state, 12, tolerance, (), NO_LIMITS)
    return end_at_kink(field, *made, tolerance)[1]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_steps_of_flights_clocks_and_rest_are_finite(dtype):
    fields = {
        "flight": lambda s: (s[1], -jnp.ones_like(s[0])),
        "clock": lambda s: (jnp.ones_like(s[0]), 0 * s[1]),
        "rest": lambda s: (0 * s[0], 0 * s[1]),
    }
    for name, field in fields.items():
        for state in ((1.0, 0.3), (0.0, 0.0)):
            start = tuple(jnp.asarray(value, dtype) for value in state)
            tolerance = 1e-12 if dtype == np.float64 else 1e-6
            length = length_of_step(field, start, tolerance)
            assert np.isfinite(length) and length > 0, (name, state)
    broken = [jnp.asarray(np.nan, dtype)] * 13
    assert np.isnan(step_size(broken, 1e-6))


# Falls and heel strikes of one's own


class LimitedWalker(wj.SimplestWalker):
    """It has fallen where the stance leg leans beyond a limit, or is slower than a least speed."""

    limit: jax.Array
    slowest: jax.Array

    def falls(self, state):
        return {"BACKWARD": state.thetadot - self.slowest, "FORWARD": self.limit - state.theta}


class FarWalker(wj.SimplestWalker):
    """A foot that comes down before the stance leg leans by so much scuffs."""

    least: jax.Array

    def is_ahead(self, state):
        return self.least - state.theta


class RenamedWalker(wj.SimplestWalker):
    """It falls as any other does, and calls it something else."""

    def falls(self, state):
        return {"BACKWARD": state.thetadot, "SIDEWAYS": -np.pi / 2 - state.theta}


class LoweredWalker(wj.SimplestWalker):
    """It has fallen while its legs are apart by more than a limit, the swing leg ahead."""

    limit: jax.Array

    def falls(self, state):
        return super().falls(state) | {"SIDEWAYS": self.limit - state.phi}


class BandWalker(wj.SimplestWalker):
    """Its foot makes a step where the stance leg leans by so much and no more."""

    def is_ahead(self, state):
        return jnp.minimum(-0.2 - state.theta, state.theta + 0.23)


FALLS = Legs(0).falls
RULES = {
    "limit": (
        LimitedWalker(*jnp.array([0.01, -0.25, 0.0])),
        Legs(0.01, falls=((2, lambda y: y[:, 2]), (1, lambda y: -0.25 - y[:, 0]))),
    ),
    "least speed": (
        LimitedWalker(*jnp.array([0.01, -1.0, -0.05])),
        Legs(0.01, falls=((2, lambda y: y[:, 2] + 0.05), (1, lambda y: -1.0 - y[:, 0]))),
    ),
    "far": (FarWalker(*jnp.array([0.01, -0.2])), Legs(0.01, ahead=lambda y: y[:, 0] < -0.2)),
    "band": (BandWalker(0.01), Legs(0.01, ahead=lambda y: (y[:, 0] < -0.2) & (y[:, 0] > -0.23))),
    "renamed": (
        RenamedWalker(0.01),
        Legs(0.01, falls=(FALLS[0], (int(Outcome.SIDEWAYS), FALLS[1][1]))),
    ),
    "within a step": (
        LoweredWalker(*jnp.array([0.01, -0.6])),
        Legs(0.01, falls=(*FALLS, (int(Outcome.SIDEWAYS), lambda y: -0.6 - y[:, 1]))),
    ),
}


LIKE_OTHERS = "band", "renamed"  # "far" limits landings too, "within a step" has an outcome too


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[SLOW] * (name in LIKE_OTHERS)) for name in RULES],
)
def ruled(request):
    walker, legs = RULES[request.param]
    xs = starts(100)
    return walker, xs, strides_by_fixed_steps(legs, xs)


def test_strides_and_margins_keep_to_the_rules_of_a_walker(ruled):
    walker, xs, expected = ruled
    assert_same(wj.strides(walker, xs), expected)
    found = margins(walker, xs)
    assert_same(found.stride, expected)
    assert len(np.unique(expected.outcome)) > 2
    values = found.failed
    fails = ~np.isin(expected.outcome, [Outcome.STRIDE, Outcome.OUTSIDE])
    assert (values[fails] <= 0).all()


@pytest.mark.parametrize("name", ["limit", "least speed", "far"])
def test_margins_of_own_rules_vanish_where_failing_begins(name):
    """Between a start that strides and one that fails; there also the derivatives are right."""
    walker, _ = RULES[name]
    xs = starts(200)
    outcome = wj.strides(walker, xs).outcome
    good, bad = xs[outcome == 0][:30], xs[np.isin(outcome, [1, 2])][:30]
    number = min(len(good), len(bad))
    good, bad = good[:number].copy(), bad[:number].copy()
    for _ in range(38):
        middle = (good + bad) / 2
        strides = (wj.strides(walker, middle).outcome == 0)[:, None]
        good, bad = np.where(strides, middle, good), np.where(strides, bad, middle)
    values = np.abs(margins(walker, bad).failed)
    assert np.median(values) < 1e-9 and np.mean(values < 1e-6) > 0.9


@kernel
def length_for(walker, state):
    return length_of_step(walker.equations(), state, 1e-12)


@pytest.mark.parametrize("length", [1e2, 1e4])
def test_steps_have_the_same_length_in_any_unit(length):
    """In units of the time that a leg of this length takes; of walkers with masses."""
    values = dict(slope=0.01, hip_mass=1.0, leg_mass=0.2, com_offset=0.0)
    walker = lambda size: wj.RoundFootWalker(
        **values,
        leg_inertia=0.01 * size**2,
        leg_length=size,
        com_from_hip=0.5 * size,
        foot_radius=0.2 * size,
    )

    def first_step(size):
        state = State(*jnp.array([0.2, 0.4, -0.22 / size**0.5, -0.02 / size**0.5]))
        return float(length_for(walker(size), state)) / size**0.5

    assert first_step(length) == pytest.approx(first_step(1.0), rel=0.3)


@pytest.mark.parametrize("step", [-1e-9, 1e-9])
def test_own_rules_hold_on_rough_ground(step):
    walker, xs = RULES["far"][0], jnp.asarray(starts(200))
    onto = jax.jit(jax.vmap(lambda x: wj.stride(walker, x, step=step)))(xs).outcome
    assert np.mean(np.asarray(onto) != wj.strides(walker, np.asarray(xs)).outcome) < 0.01


def test_falls_that_no_stride_can_report_are_refused():
    class Misnamed(wj.SimplestWalker):
        def falls(self, state):
            return {"UNDECIDED": -1 - state.theta}

    class Broad(wj.SimplestWalker):
        def falls(self, state):
            return {"FORWARD": jnp.stack([state.theta])}

    class Flag(wj.SimplestWalker):
        def falls(self, state):
            return {"FORWARD": state.theta < -1}

    class Ahead(wj.SimplestWalker):
        def is_ahead(self, state):
            return state.theta < 0

    words = "named by a failure", "of shape", "not bool", "is_ahead of Ahead must be one real"
    for kind, said in zip((Misnamed, Broad, Flag, Ahead), words, strict=True):
        with pytest.raises(ValueError, match=said):
            wj.stride(kind(0.01), jnp.array([0.2, -0.2]))


@pytest.mark.slow
def test_falls_may_compare_the_largest_of_several():
    class Largest(wj.SimplestWalker):
        def falls(self, state):
            angles = jnp.stack([-4 * state.theta, jnp.abs(state.phi)])
            return super().falls(state) | {"SIDEWAYS": jnp.max(angles) - 1.0}

    rules = int(Outcome.SIDEWAYS), lambda y: np.maximum(-4 * y[:, 0], np.abs(y[:, 1])) - 1.0
    xs = starts(60)
    expected = strides_by_fixed_steps(Legs(0.01, falls=(*FALLS, rules)), xs)
    assert_same(wj.strides(Largest(0.01), xs), expected)


class SpreadByMode(wj.SimplestWalker):
    """It has fallen where its legs are far apart, by a guard of the swing."""

    def modes(self):
        swing = super().modes()["swing"]
        *falls, strike = swing.guards
        spread = Guard(lambda state: -0.6 - state.phi, "SIDEWAYS", at_once=True)
        return {"swing": swing._replace(guards=(*falls, spread, strike))}


def test_modes_of_ones_own_are_what_every_function_follows():
    """A guard that is added to the swing does what the same fall does."""
    one, other, xs = RULES["within a step"][0], SpreadByMode(0.01), starts(200)
    expected, found = (margins(walker, xs) for walker in (one, other))
    outcome = expected.stride.outcome
    assert (outcome == Outcome.SIDEWAYS).sum() > 20
    for value, known in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(value, known, rtol=1e-11, atol=1e-12)


@pytest.mark.slow  # test_hooks.py has films, and the rough ground below has steps
def test_films_and_steps_follow_modes_of_ones_own():
    other, xs = SpreadByMode(0.01), starts(200)
    outcome = margins(RULES["within a step"][0], xs).stride.outcome
    first = lambda code: xs[np.flatnonzero(outcome == code)[0]]
    film = wj.motion(other, first(Outcome.SIDEWAYS), 3, step=0.2)
    assert film.outcome.values.tolist() == [Outcome.SIDEWAYS]
    assert film.phi.values[-1] == pytest.approx(-0.6, abs=1e-12)
    usual = wj.SimplestWalker(0.01)
    films = [wj.motion(walker, first(Outcome.BACKWARD), 1, step=0.05) for walker in (other, usual)]
    assert films[0].sizes["frame"] == films[1].sizes["frame"]
    on_steps = jax.jit(jax.vmap(lambda x: wj.stride(other, x, step=-0.02).outcome))(xs)
    assert (np.asarray(on_steps) == Outcome.SIDEWAYS).sum() > 20


@pytest.mark.slow  # test_hooks.py has films of a walker with falls of its own
def test_a_film_ends_where_a_walker_has_fallen_by_its_own_rule():
    walker, xs = RULES["within a step"][0], starts(200)
    outcome = wj.strides(walker, xs).outcome
    fallen = xs[np.flatnonzero(outcome == Outcome.SIDEWAYS)[0]]
    phi = wj.motion(walker, fallen, 3, step=0.02).phi.values
    assert phi.min() > -0.63 and phi.min() < -0.58


class HalfWay(PartOfSwing):
    """Over where the stance leg is upright."""

    def event(self, state):
        return -state.theta


class PhasedWalker(LimitedWalker):
    """It has the same falls in a phase before the swing."""

    def phases(self):
        return (HalfWay(self),)


@pytest.mark.parametrize("by_margins", [pytest.param(False, marks=SLOW), True])
def test_falls_of_ones_own_end_phases_too(by_margins):
    """In strides the falls of a walker with knees do, by default."""
    walker, _ = RULES["least speed"]
    xs = starts(200)
    whole = wj.strides(walker, xs)
    phased = PhasedWalker(walker.slope, walker.limit, walker.slowest)
    assert (whole.outcome == Outcome.BACKWARD).sum() > 20
    assert_same(margins(phased, xs).stride if by_margins else wj.strides(phased, xs), whole, 1e-9)


@pytest.mark.slow
def test_boundaries_move_with_limits_of_falls_as_margins_say():
    """Points of the basin's boundary, by bisection at two limits, and by derivatives of margins."""
    at = lambda limit: LimitedWalker(*jnp.array([0.004, limit, 0.0]))
    walks = lambda limit, x: iterate(at(limit), x, 60, Integrator(1e-12))
    total = np.linspace(-0.03, 0.0, 60)
    line = lambda theta: np.stack([theta, total - theta], axis=1)
    across = np.linspace(0.4, 0.0, 41)
    survives = [walks(-0.22, line(np.full(60, theta))).outcome == 0 for theta in across]
    first = np.argmax(survives, axis=0)
    total, first = total[first > 0], first[first > 0]
    assert len(total) > 20

    def bisect(limit: float, good: np.ndarray, bad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for _ in range(28):  # to less than 1e-10
            middle = (good + bad) / 2
            inside = walks(limit, line(middle)).outcome == 0
            good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
        return good, bad

    good, bad = bisect(-0.22, across[first], across[first - 1])
    made = walks(-0.22, line(bad)).strides
    along = np.array([[1.0, -1.0]])
    change = differentiate_margins(at(-0.22), line(bad), made, along, ("limit",), 1e-12)
    near = np.sign(good - bad) * 2e-5
    above, below = (bisect(-0.22 + e, good + near, good - near)[0] for e in (1e-6, -1e-6))
    moved = -change[:, 1] / change[:, 0]
    np.testing.assert_allclose(moved, (above - below) / 2e-6, rtol=2e-2, atol=1e-4)
    assert np.abs(moved).max() > 0.05

    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.04, 0.01, 40))
    area = wj.measure(at(-0.22), "area", ("limit",), grid=grid, levels=2, check=10_000)
    assert area.gradient[0] < -3 * area.gradient_error[0] and area.lost < 0.02 * area.crossings


# Conditions


class RestrainedWalker(wj.SimplestWalker):
    """Its stance leg must not lean back by more than a limit."""

    limit: jax.Array

    def conditions(self):
        return {"BUCKLED": lambda state: self.limit - state.theta}


def test_conditions_are_looked_at_from_the_start_on():
    """Broken at the start alone: the stance leg is up within the first step."""
    limit, xs = 0.3, starts(100)
    walker = RestrainedWalker(*jnp.array([0.01, limit]))
    condition = int(Outcome.BUCKLED), lambda y: limit - y[:, 0]
    expected = strides_by_fixed_steps(Legs(0.01, condition=condition), xs)
    assert (expected.outcome == Outcome.BUCKLED).sum() > 20
    assert_same(wj.strides(walker, xs), expected)
    found = margins(walker, xs)
    assert_same(found.stride, expected)
    failed = expected.outcome == Outcome.BUCKLED
    np.testing.assert_allclose(found.buckling[failed], limit - xs[failed, 0], atol=1e-12)
