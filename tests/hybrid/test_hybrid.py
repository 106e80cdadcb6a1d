"""Modes with guards: crossings of polynomials, and modes followed to their end."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polynomials import ascending
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.hybrid.crossings import HOP, Crossing, begins_below, first_rise, may_rise
from walker_jax.hybrid.following import NO_GUARD, follow_mode
from walker_jax.hybrid.modes import SECTION, Condition, EarlyExit, Guard, Mode
from walker_jax.integrators.integrator import Method
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor_steps import SERIES_ORDER, Taylor
from walker_jax.kernels import kernel

TOLERANCE = 1e-12
COEFFICIENTS, ROWS = 7, 256

# Crossings


@pytest.fixture(scope="module")
def rise():
    """The first admitted rise of each of some polynomials, whether bounds allow one, and the end's
    side. A rise is admitted where another polynomial is positive."""

    @kernel
    def one(value, admit, length):
        value, admit = list(value), list(admit)
        below = begins_below(value)
        ends_below = evaluate_polynomial(value, length) < 0
        may = may_rise(value, [admit], length, below, ends_below)
        crossing = Crossing(value, [admit], below, ends_below, jnp.asarray(True))
        number, time = first_rise([crossing], length)
        return number == 0, time, may, ends_below

    run = jax.jit(jax.vmap(one))

    def padded(values, admits, lengths):
        arrays = np.zeros((2, ROWS, COEFFICIENTS))
        times = np.ones(ROWS)
        for i, pair in enumerate(zip(values, admits, strict=True)):
            for array, p in zip(arrays, pair, strict=True):
                array[i, : len(p)] = p
        times[: len(lengths)] = lengths
        return [np.asarray(x)[: len(values)] for x in run(*arrays, times)]

    return padded


ALWAYS = [1.0]
CROSSINGS = {  # polynomial, what admits it, the first admitted rise within a step of length 1
    "rises": (ascending(0.3), ALWAYS, 0.3),
    "falls": (-ascending(0.3), ALWAYS, None),
    "falls and rises": (ascending(0.3, 0.6), ALWAYS, 0.6),
    "a dip within the step": (-ascending(0.4, 0.41), ALWAYS, 0.4),
    "a short dip": (-ascending(0.4, 0.40001), ALWAYS, 0.4),
    "a dip that is none": (-ascending(0.4, 0.4), ALWAYS, None),
    "begins at zero and rises": (ascending(0.0), ALWAYS, None),
    "begins at zero, falls, and rises": (ascending(0.0, 0.7), ALWAYS, 0.7),
    "begins at zero at rest, falls, and rises": (ascending(0.0, 0.0, 0.7), ALWAYS, 0.7),
    "beyond the step": (ascending(1.3), ALWAYS, None),
    "at its end": (ascending(1.0), ALWAYS, 1.0),
    "not admitted": (ascending(0.3), [-1.0], None),
    "admitted the second time": (ascending(0.2, 0.4, 0.8), [-0.5, 1.0], 0.8),
    "admitted within the step alone": (ascending(0.5), -ascending(0.45, 0.55), 0.5),
    "three and one graze": (ascending(0.1, 0.3, 0.5, 0.7, 0.7), [-0.2, 1.0], 0.5),
}


def test_first_rises_are_those_that_are_known(rise):
    values, admits, roots = zip(*CROSSINGS.values(), strict=True)
    exists, times, may, ends_below = rise(values, admits, np.ones(len(values)))
    for i, (name, root) in enumerate(zip(CROSSINGS, roots, strict=True)):
        assert exists[i] == (root is not None), name
        assert may[i] or root is None, name
        assert root is None or times[i] == pytest.approx(root, abs=1e-9), name
        assert ends_below[i] == (np.polyval(values[i][::-1], 1.0) < 0), name


def first_admitted(value, admit, length):
    """By the eigenvalues of the companion matrix; None where two roots or signs are too near."""
    roots = np.roots(np.trim_zeros(value[::-1], "f"))
    near = roots[(np.abs(roots.imag) < 1e-4) & (roots.real > -0.01) & (roots.real < length + 0.01)]
    real = np.sort(near.real)
    if len(real) and np.diff([0.0, *real, length]).min() < 1e-4:
        return None
    if any(abs(np.polyval(admit[::-1], root)) < 1e-6 for root in real):
        return None
    for root in real:
        rate = np.polyval(np.polyder(value[::-1]), root)
        if rate > 0 and np.polyval(admit[::-1], root) > 0:
            return root
    return np.inf


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_first_rises_of_any_polynomials_are_those_of_all_roots(rise, seed):
    """Roots are drawn in the step, so that most polynomials cross zero several times."""
    rng = np.random.default_rng(seed)
    values, admits = [], rng.normal(size=(ROWS, 3))
    for _ in range(ROWS):
        roots = rng.uniform(-0.5, 1.5, rng.integers(1, COEFFICIENTS))
        values.append(rng.choice([-1, 1]) * rng.exponential() * ascending(*roots))
    exists, times, may, _ = rise(values, admits, np.ones(ROWS))
    compared = 0
    for i in range(ROWS):
        expected = first_admitted(values[i], admits[i], 1.0)
        if expected is not None:
            compared += 1
            assert exists[i] == np.isfinite(expected)
            assert may[i] or not exists[i]
            assert not exists[i] or times[i] == pytest.approx(expected, abs=1e-9)
    assert compared > ROWS / 2


def test_bounds_exclude_steps_without_a_rise(rise):
    """And those that only move away from zero, to rounding."""
    quiet = {
        "constant": [1.0],
        "far above": [1.0, 0.3, -0.2, 0.1],
        "falls": [0.5, -1.0, 0.2],
        "leaves zero": [0.0, 0.0, -1.0, 0.5],
        "leaves zero, above by rounding": [1e-17, -1.0, -1.0, 0.5],
    }
    _, _, may, _ = rise([*quiet.values()], [ALWAYS] * len(quiet), np.ones(len(quiet)))
    assert not may.any(), dict(zip(quiet, may, strict=True))
    _, _, may, _ = rise([ascending(0.5)], [[-1.0, 0.5]], np.ones(1))
    assert not may[0]


def test_dips_wider_than_a_hop_are_found(rise):
    widths = np.geomspace(2 * HOP, 1e-2, 40)
    dips = [-ascending(0.4, 0.4 + width) for width in widths]
    exists, times, _, _ = rise(dips, [ALWAYS] * 40, np.ones(40))
    assert exists.all()
    np.testing.assert_allclose(times, 0.4, atol=1e-7)


def test_zeros_of_high_order_end_the_search(rise):
    """Rounding decides whether such a zero is a crossing, but not where it may be."""
    exists, times, _, _ = rise(
        [ascending(*[0.3] * 3), ascending(*[0.3] * 4), ascending(*[0.3] * 6)],
        [ALWAYS] * 3,
        np.ones(3),
    )
    assert exists[0]
    np.testing.assert_allclose(times[exists], 0.3, atol=2e-2)


# Modes


def oscillator(state):
    q, p = state
    return p, -q


def mode_of(*guards, conditions=(), early_exit=None):
    return Mode(oscillator, guards, conditions, early_exit=early_exit)


def taylor(field=oscillator, tolerance=TOLERANCE, dtype="float64", others=()):
    return Method(field, Taylor(SERIES_ORDER[jnp.dtype(dtype)]), tolerance, others)


PHASES = np.concatenate([np.linspace(0.05, 6.2, 40), [np.nan]])
DOWN = Guard(lambda state: -state[0], "OUTSIDE")


@pytest.fixture(scope="module")
def to_zero():
    """From q = cos(t - a), p = -sin(t - a) at t = 0, to where q falls through zero."""

    @kernel
    def one(phase):
        start = jnp.cos(phase), -jnp.sin(-phase)
        return follow_mode(mode_of(DOWN), start, jnp.asarray(True), taylor())

    return jax.jit(jax.vmap(one))


def test_a_mode_ends_where_its_guard_rises(to_zero):
    found = to_zero(PHASES)
    phases = PHASES[:40]
    expected = np.where(phases + np.pi / 2 > 2 * np.pi, phases - 3 * np.pi / 2, phases + np.pi / 2)
    np.testing.assert_array_equal(found.guard[:40], 0)
    np.testing.assert_allclose(found.time[:40], expected, atol=3e-12)
    np.testing.assert_allclose(found.state[0][:40], 0, atol=3e-12)
    np.testing.assert_allclose(found.state[1][:40], -1, atol=5e-12)
    assert found.guard[40] == NO_GUARD


def test_a_lane_does_not_depend_on_its_neighbours(to_zero):
    few = np.array([0.05, 6.2, 1.0])
    alone, together = to_zero(np.resize(few, len(PHASES))), to_zero(PHASES)
    for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
        assert (a[0], a[1]) == (b[0], b[39])


def test_derivatives_of_an_arrival_are_exact():
    """t = a + pi/2, whose derivatives by the phase are 1 and 0; the state is the same for all."""

    @kernel
    def run(phase):
        start = jnp.cos(phase), jnp.sin(phase)
        found = follow_mode(mode_of(DOWN), start, jnp.asarray(True), taylor())
        return found.time, found.state[1]

    along = lambda function: lambda phase: jax.jvp(function, (phase,), (jnp.ones(()),))
    ((time, _), (rate, speeds)), (_, (bend, _)) = jax.jit(along(along(run)))(0.4)
    assert time == pytest.approx(0.4 + np.pi / 2, abs=1e-11)
    assert rate == pytest.approx(1, abs=1e-11) and abs(speeds) < 1e-11 and abs(bend) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("solver", [diffrax.Dopri8(), diffrax.Bosh3()], ids=repr)
def test_runge_kutta_steps_land_too(solver):
    def run(phase):
        start = jnp.cos(phase), jnp.sin(phase)
        found = follow_mode(
            mode_of(DOWN), start, jnp.asarray(True), Method(oscillator, solver, 1e-8)
        )
        return found.time, found.state[0]

    (time, place), (rate, _) = jax.jit(lambda phase: jax.jvp(run, (phase,), (jnp.ones(()),)))(0.4)
    assert abs(time - (0.4 + np.pi / 2)) < 1e-6 and abs(place) < 1e-15 and abs(rate - 1) < 1e-6


@pytest.mark.parametrize("measured", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_step_that_its_method_rejects_ends_nothing(monkeypatch, measured):
    """From q = 0, p = 1 the guard -q begins at zero and falls; it rises at t = pi."""
    cautious = Method.begin

    def bold(self, state):
        memory = cautious(self, state)
        length, *others = memory.control
        return memory._replace(control=(0 * length + 3.0, *others))

    monkeypatch.setattr(Method, "begin", bold)
    method = Method(oscillator, diffrax.Bosh3(), 1e-8)
    start = jnp.array(0.0), jnp.array(1.0)
    follow = lambda s: follow_mode(mode_of(DOWN), s, jnp.asarray(True), method, measured=measured)
    found = jax.jit(follow)(start)
    assert found.guard == 0 and found.time == pytest.approx(np.pi, abs=1e-5)


def test_the_earliest_admitted_guard_counts_in_any_order():
    """q falls through levels at known times; one only counts while p > 0, that is, never here."""
    level = lambda c, *admits: Guard(lambda state: c - state[0], SECTION, admits)
    orders = [(0.5, 0.1, -0.3), (-0.3, 0.1, 0.5)]
    for levels in orders:
        mode = mode_of(level(0.8, lambda state: state[1]), *map(level, levels))
        run = kernel(lambda start, mode=mode: follow_mode(mode, start, jnp.asarray(True), taylor()))
        found = run((jnp.array(1.0), jnp.array(0.0)))
        assert found.guard == 1 + levels.index(0.5)
        assert found.time == pytest.approx(np.arccos(0.5), abs=1e-12)


def test_a_guard_that_rises_and_falls_within_one_step_is_seen():
    """q reaches 1 at t = pi / 2; the guard is above zero for 2e-4 around that."""
    mode = mode_of(Guard(lambda state: state[0] - np.cos(1e-4), SECTION))
    run = kernel(lambda start: follow_mode(mode, start, jnp.asarray(True), taylor()))
    found = run((jnp.array(0.0), jnp.array(1.0)))
    assert found.guard == 0 and found.time == pytest.approx(np.pi / 2 - 1e-4, abs=1e-9)


def test_violated_conditions_are_noted_and_do_not_end_a_mode():
    """On the way from q = 0, p = 1 to q = 0 again, q is zero at both ends and one in between."""
    conditions = [
        Condition(lambda s: 0.999 - s[0], "high"),
        Condition(lambda s: 1.001 - s[0], "higher"),
        Condition(lambda s: s[0] - 1e-9, "low"),
        Condition(lambda s: 2 - s[1] ** 2, "fast"),
    ]
    mode = mode_of(DOWN, conditions=tuple(conditions))
    run = kernel(lambda start: follow_mode(mode, start, jnp.asarray(True), taylor()))
    found = run((jnp.array(0.0), jnp.array(1.0)))
    assert found.guard == 0 and found.time == pytest.approx(np.pi, abs=1e-11)
    assert {key: bool(flag) for key, flag in found.violated.items()} == {
        "high": True,
        "higher": False,
        "low": True,
        "fast": False,
    }


def test_what_exits_early_or_is_not_going_is_not_followed():
    mode = mode_of(DOWN, early_exit=EarlyExit(lambda state: state[1] < -0.2, "BACKWARD"))

    @kernel
    def run(q, going):
        return follow_mode(mode, (q, jnp.zeros_like(q)), going, taylor())

    found = run(jnp.array(1.0), jnp.asarray(True))
    assert found.guard == 1 and 0.2 < found.time < np.pi / 2
    stayed = run(jnp.array(1.0), jnp.asarray(False))
    assert stayed.time == 0 and stayed.state[0] == 1 and stayed.guard not in (0, 1, NO_GUARD)


def test_what_never_ends_is_given_up_after_so_many_steps():
    square = lambda state: (state[0] ** 2,)
    mode = Mode(square, (Guard(lambda state: -2 - state[0], SECTION),), most_steps=30)
    run = jax.vmap(
        kernel(lambda y: follow_mode(mode, (y,), jnp.asarray(True), taylor(square, 1e-9)))
    )
    found = run(jnp.array([-1.0, 1.0, 0.0]))
    np.testing.assert_array_equal(found.guard, NO_GUARD)
    decays, grows = found.time[:2]
    np.testing.assert_allclose(found.state[0][0], -1 / (1 + decays), rtol=1e-8)
    assert grows < 1 and found.state[0][2] == 0


class Rikitake(wj.HybridSystem):
    """A dynamo, whose next crossing of a plane may take a hundred turns."""

    most_steps: int = eqx.field(static=True, default=Mode._field_defaults["most_steps"])

    section = ("x", "y")

    def lift(self, x):
        return jnp.append(x, 0 * x[0])

    def project(self, state):
        return state[:2]

    def modes(self):
        field, guard = lambda s: jnp.stack(dynamo(s)), wj.Guard(lambda s: s[2], wj.SECTION)
        return {"flow": wj.Mode(field, (guard,), most_steps=self.most_steps)}


def dynamo(s):
    return [-0.47 * s[0] + s[2] * s[1], -0.47 * s[1] + s[0] * (s[2] - 1), 1 - s[0] * s[1]]


def test_a_motion_of_many_steps_has_its_end():
    """That of an independent integration, after more than a thousand steps."""
    start = [-5.9, 0.3]
    made = wj.stride(Rikitake(), jnp.array(start))
    rises: Any = lambda t, y: y[2]
    rises.terminal, rises.direction = True, 1
    by: Any = dict(method="DOP853", rtol=1e-12, atol=1e-14)
    field = lambda _, s: dynamo(s)
    begun = solve_ivp(field, (0, 0.1), [*start, 0.0], **by).y[:, -1]  # above the plane
    found = solve_ivp(field, (0.1, 200), begun, events=rises, **by)
    assert found.t[-1] > 100 and float(made.time) == pytest.approx(found.t[-1], abs=1e-7)
    np.testing.assert_allclose(made.state, found.y[:2, -1], rtol=1e-7)
    starts = np.stack(np.meshgrid(np.linspace(-5.9, 5.9, 12), np.linspace(-5.8, 5.8, 12)), -1)
    ends = wj.strides(Rikitake(), starts.reshape(-1, 2))
    assert (ends.outcome == wj.Outcome.STRIDE).all()
    few = wj.strides(Rikitake(1000), starts.reshape(-1, 2))
    given_up = few.outcome == wj.Outcome.UNDECIDED
    assert 0 < given_up.sum() < 30
    np.testing.assert_array_equal(few.state[~given_up], ends.state[~given_up])


def test_a_motion_that_leaves_a_fixed_point_slowly_has_its_end():
    """Two orders agree on a return after 23,000 turns about a point of imaginary eigenvalues.

    The dynamo is symmetric: (x, y, z) moves as (-x, -y, z) does.
    """
    start, finest = np.array([-0.28834352, 1.80538149]), 1e-14
    made = wj.strides(Rikitake(), np.stack([start, -start]), tolerance=finest)
    other = wj.stride(Rikitake(), start, solver=Taylor(20), tolerance=finest)
    assert other.time > 80_000
    np.testing.assert_allclose(made.time, float(other.time), rtol=1e-10)
    np.testing.assert_allclose(made.state, np.stack([other.state, -other.state]), rtol=2e-5)


class Hurried(wj.SimplestWalker):
    most_steps = 5


def test_a_walker_has_a_limit_of_steps_too():
    x = jnp.array([0.2, -0.2])
    assert wj.stride(wj.SimplestWalker(0.004), x).outcome == wj.Outcome.STRIDE
    assert wj.stride(Hurried(0.004), x).outcome == wj.Outcome.UNDECIDED
    with pytest.raises(WrongUse, match="most_steps must be at least 1, not 0"):
        wj.stride(Rikitake(0), x)


def test_float32():
    mode = mode_of(DOWN)
    method = taylor(tolerance=1e-6, dtype="float32")
    start = jnp.float32(1.0), jnp.float32(0.5)
    found = kernel(lambda s: follow_mode(mode, s, jnp.asarray(True), method))(start)
    assert {leaf.dtype for leaf in (*found.state, found.time)} == {jnp.dtype("float32")}
    assert found.time == pytest.approx(np.arctan(0.5) + np.pi / 2, abs=1e-5)
