"""Dynamics with kinks, such as torques with limits: integrated and differentiated right."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from scipy.integrate import solve_ivp
from switching import switching_series

import walker_jax as wj
from walker_jax.gaits.cycles import linearise
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import cut_at_switches, first_zero
from walker_jax.integrators.taylor import function_series, solution_series
from walker_jax.kernels import kernel
from walker_jax.multibody import System
from walker_jax.multibody.single_support import SingleSupport
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.model import Scalar, State
from walker_jax.walkers.parameters import with_parameter

SLOPE, LIMIT = 0.004, 0.1
STARTS = np.array([[0.2, -0.21], [0.2, -0.2158], [0.25, -0.26], [0.1, -0.12], [0.3, -0.31]])


class LimitedSpringWalker(wj.SimplestWalker):
    """A spring between the legs whose torque has a limit."""

    stiffness: Scalar

    def vector_field(self, state):
        free = super().vector_field(state)
        torque = jnp.clip(self.stiffness * state.phi, -LIMIT, LIMIT)
        return free._replace(phidot=free.phidot - torque)


def limited(stiffness):
    return LimitedSpringWalker(SLOPE, jnp.asarray(stiffness))


def motion_by_dop853(stiffness, start, times):
    """States at `times`, by steps so small that a kink does no harm."""

    def field(_, y):
        theta, phi, thetadot, phidot = y.tolist()  # numbers of Python: several times as fast
        angle = theta - SLOPE
        swing = math.sin(phi) * (thetadot**2 - math.cos(angle)) + math.sin(angle)
        torque = min(max(stiffness * phi, -LIMIT), LIMIT)
        return [thetadot, phidot, math.sin(angle), swing - torque]

    theta, thetadot = start
    y = [theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot]
    options: Any = dict(method="DOP853", rtol=1e-13, atol=1e-15, max_step=0.01)
    return solve_ivp(field, (0, times[-1]), y, t_eval=times, **options).y


def richardson(function, h):
    """The derivative of a function at 0, by extrapolated differences."""
    half, full = ((function(d) - function(-d)) / (2 * d) for d in (h, 2 * h))
    return (4 * half - full) / 3


@pytest.mark.parametrize("stiffness", [1.0, 5.0, 50.0])
def test_strides_through_kinks_are_those_of_small_steps(stiffness):
    """At heel strike the legs are where small steps take them, and the impact is the paper's."""
    walker = limited(stiffness)
    ends = wj.strides(walker, STARTS)
    assert (ends.outcome == Outcome.STRIDE).all()
    for start, state, time in zip(STARTS, ends.state, ends.time, strict=True):
        theta, phi, thetadot, _ = motion_by_dop853(stiffness, start, [0.0, time])[:, -1]
        np.testing.assert_allclose(phi, 2 * theta, rtol=0, atol=1e-9)
        expected = [-theta, np.cos(phi) * thetadot]
        np.testing.assert_allclose(state, expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_trajectory_through_kinks():
    times = np.linspace(0, 3, 7)
    found = np.array(wj.trajectory(limited(5.0), STARTS[0], times))
    expected = motion_by_dop853(5.0, STARTS[0], times)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_a_traced_trajectory_through_kinks():
    walker, times = limited(5.0), np.linspace(0, 3, 7)
    expected = motion_by_dop853(5.0, STARTS[0], times)
    traced = jax.jit(lambda x: wj.trajectory(walker, x, times))(jnp.asarray(STARTS[0]))
    np.testing.assert_allclose(np.array(traced), expected, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_under_jit_a_stride_through_kinks_is_the_same():
    walker = limited(5.0)
    one_by_one = wj.strides(walker, STARTS)
    traced = jax.jit(jax.vmap(lambda x: wj.stride(walker, x)))(jnp.asarray(STARTS))
    np.testing.assert_allclose(traced.state, one_by_one.state, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(traced.outcome, one_by_one.outcome)


@pytest.mark.parametrize("parameter", ["stiffness", "slope"])
def test_derivatives_of_strides_through_kinks(parameter):
    walker, h = limited(5.0), {"stiffness": 1e-3, "slope": 1e-5}[parameter]
    found = linearise(walker, STARTS[:, None], Integrator(1e-12), parameter)

    def ends(starts, walker: Any = walker):
        return wj.strides(walker, starts).state

    for i in range(2):
        expected = richardson(lambda d, i=i: ends(STARTS + d * np.eye(2)[i]), 1e-5)
        np.testing.assert_allclose(found.jacobian[:, 0, :, i], expected, rtol=2e-6, atol=2e-6)
    value = getattr(walker, parameter)
    at = lambda d: ends(STARTS, with_parameter(walker, parameter, value + d))
    expected = richardson(at, h)
    np.testing.assert_allclose(found.by_parameter[:, 0], expected, rtol=2e-6, atol=1e-8)


@pytest.mark.slow
def test_derivatives_of_a_gait_through_kinks():
    """First derivatives, in states and times; second ones, in multipliers."""
    walker = limited(5.0)
    gait = wj.find_gait(walker, [0.148, -0.159])
    assert gait.found and gait.stable
    for parameter, h in {"stiffness": 1e-4, "slope": 1e-6}.items():
        change = gait_derivatives(walker, gait, parameter)
        value = getattr(walker, parameter)

        def at(d, parameter=parameter, value=value):
            there = wj.find_gait(with_parameter(walker, parameter, value + d), gait.states)
            numbers = (there.states, there.multipliers, there.step_times)
            return np.concatenate([np.ravel(one) for one in numbers])

        expected = richardson(at, h)
        found = np.concatenate([np.ravel(one) for one in change])
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-6, atol=2e-7)


@pytest.mark.slow
def test_margins_through_kinks_are_of_the_same_stride():
    walker = limited(5.0)
    plain, found = wj.strides(walker, STARTS), wj.margins(walker, STARTS)
    np.testing.assert_allclose(found.stride.state, plain.state, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.stride.outcome, plain.outcome)


class ShortPushWalker(wj.SimplestWalker):
    """A torque while the legs are farther apart than an angle, which may be a very short time."""

    angle: Scalar

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - 100 * jax.nn.relu(state.phi - self.angle))


def test_a_torque_for_a_moment_within_a_step_is_not_missed():
    """The legs swing apart at first, and pass the angle for some 0.01."""
    times = np.linspace(0, 0.5, 2001)
    start = jnp.array([0.2, 0.4, -0.22, 0.05])  # a full state, the swing leg still going back
    motion = lambda angle: wj.trajectory(ShortPushWalker(*jnp.array([SLOPE, angle])), start, times)
    free = motion(np.pi)  # never so far apart
    widest = float(np.max(free.phi))
    height = 1e-5
    above = times[np.asarray(free.phi) > widest - height]
    assert 0.001 < above[-1] - above[0] < 0.02
    change = motion(widest - height).phidot[-1] - free.phidot[-1]
    # 100 times the integral of what phi is beyond the angle: 2/3 of the height of a parabola
    curvature = -np.gradient(np.asarray(free.phidot), times)[np.argmax(free.phi)]
    width = 2 * np.sqrt(2 * height / curvature)
    assert float(change) == pytest.approx(-100 * 2 / 3 * height * width, rel=0.1)


class JumpingWalker(wj.SimplestWalker):
    """A torque that is switched on behind an angle."""

    angle: Scalar

    def vector_field(self, state):
        free = super().vector_field(state)
        torque = jnp.where(state.theta < self.angle, 0.05, 0.0)
        return free._replace(phidot=free.phidot + torque)


def test_where_a_field_jumps_the_outcome_is_undecided():
    walkers = jax.vmap(JumpingWalker)(jnp.full(2, SLOPE), jnp.array([0.0, -1.5]))
    ends = wj.strides(walkers, STARTS[[0, 0]])
    plain = wj.stride(wj.SimplestWalker(SLOPE), STARTS[0])
    assert ends.outcome.tolist() == [Outcome.UNDECIDED, Outcome.STRIDE]  # the second never jumps
    np.testing.assert_allclose(ends.state[1], plain.state, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_where_a_field_jumps_a_trajectory_ends():
    motion = wj.trajectory(JumpingWalker(SLOPE, jnp.array(0.0)), STARTS[0], np.array([0.5, 3.0]))
    assert np.isfinite(motion.theta).tolist() == [True, False]


class LimitedTorqueWalker(wj.PointFootWalker):
    """A limited torque between legs with mass, of which the general method is told."""

    def system(self):
        free = super().system()

        def torque(q, qdot):
            limited = jnp.clip(0.05 * q[3], -0.001, 0.001)
            return jnp.stack([0 * limited, 0 * limited, 0 * limited, -limited])

        return System(free.transfer, free.masses, free.forces, torque)


class AcceleratedWalker(wj.PointFootWalker):
    """Legs with mass, and an angular acceleration of the swing leg that comes on top."""

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - jnp.clip(state.phi, -0.05, 0.05))


def test_the_equations_of_several_masses_are_those_of_the_class():
    """A field of its own, where there is one; otherwise the balance of virtual power."""
    own, state = AcceleratedWalker(0.01), State(*jnp.array([0.2, 0.4, -0.2, 0.1]))
    free = wj.PointFootWalker(0.01)
    difference = own.equations()(state).phidot - free.equations()(state).phidot
    assert float(difference) == pytest.approx(-0.05, abs=1e-12)
    assert isinstance(free.equations(), SingleSupport)
    assert isinstance(LimitedTorqueWalker(0.01).equations(), SingleSupport)
    series = jax.tree.map(lambda value: [value] * 5, state)
    for walker in (own, LimitedTorqueWalker(0.01)):
        assert len(switching_series(walker.equations(), series)) >= 2  # both limits


@pytest.mark.slow
@pytest.mark.parametrize("kind", [AcceleratedWalker, LimitedTorqueWalker])
def test_walkers_of_masses_may_have_kinks_and_own_fields(kind):
    walker, start = kind(0.01), np.array([0.2, -0.21])
    end = wj.stride(walker, start)
    assert end.outcome == Outcome.STRIDE
    rates = jax.jit(lambda state: walker.vector_field(state))
    time = float(end.time)
    found = solve_ivp(
        lambda _, y: np.array(rates(State(*map(jnp.asarray, y)))),
        (0, time),
        np.array(walker.lift(jnp.asarray(start))),
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        max_step=0.05,
    ).y[:, -1]
    arrival = State(*map(jnp.asarray, found))
    assert float(walker.contact(arrival)) == pytest.approx(0, abs=1e-9)
    _, after = walker.impact(arrival)
    np.testing.assert_allclose(
        end.state, walker.project(walker.exchange_legs(after)), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("kind", PLANAR_WALKERS.values())
def test_the_family_is_smooth_and_pays_nothing(kind):
    walker = kind(0.01)
    state = walker.lift(jnp.full(len(walker.section), 0.1))
    series = jax.tree.map(lambda value: [value] * 5, state)
    for function in (walker.equations(), walker.contact):
        assert switching_series(function, series) == []


TABLE = jnp.array([0.0, 1.0, 4.0])


def loop_by_hand(t):
    return t * (t + 1) * (t + 2)


PIECEWISE = {
    "abs": (lambda t: jnp.abs(t - 0.3), lambda t: 0.3 - t),
    "max": (lambda t: jnp.maximum(jnp.sin(t), 0.2 + 0 * t), lambda t: 0.2 + 0 * t),
    "min": (lambda t: jnp.minimum(t**2, 3 * t), lambda t: t**2),
    "clip": (lambda t: jnp.clip(jnp.exp(t), 0.5, 1.2), jnp.exp),
    "clip above": (lambda t: jnp.clip(3 + t, 0.5, 2.0), lambda t: 2 + 0 * t),
    "clamp": (lambda t: lax.clamp(0.5, jnp.exp(t), 1.2), jnp.exp),
    "clamp below": (lambda t: lax.clamp(0.5, 1 - t**2, 2.0), lambda t: 1 - t**2),
    "clamp above": (lambda t: lax.clamp(0.5, 3 + t, 2.0), lambda t: 2 + 0 * t),
    "where": (lambda t: jnp.where(t < 0.7, t**3, t), lambda t: t**3),
    "floor": (lambda t: t * jnp.floor(3.2 + t), lambda t: 3 * t),
    "ceil": (lambda t: t * jnp.ceil(3.2 + t), lambda t: 4 * t),
    "round": (lambda t: t * jnp.round(3.2 + t), lambda t: 3 * t),
    "sign": (lambda t: t * jnp.sign(t - 0.1), lambda t: -t),
    "cast": (lambda t: t * (3.2 + t).astype(int).astype(float), lambda t: 3 * t),
    "arctan2": (lambda t: jnp.arctan2(jnp.sin(3 + t), jnp.cos(3 + t)), lambda t: 3 + t),
    "cond": (lambda t: lax.cond(t < 0.7, jnp.sin, jnp.exp, t), jnp.sin),
    "switch": (
        lambda t: lax.switch((3.2 + t).astype(int) - 2, [jnp.sin, jnp.exp, jnp.cos], t),
        jnp.exp,
    ),
    "loop": (
        lambda t: lax.fori_loop(0, 3, lambda i, x: x * (t + i.astype(float)), 1.0 + 0 * t),
        loop_by_hand,
    ),
    "loop with a kink": (
        lambda t: lax.fori_loop(0, 2, lambda i, x: x + jnp.abs(t - i.astype(float) - 0.6), t),
        lambda t: t + (0.6 - t) + (1.6 - t),
    ),
    "scan": (
        lambda t: jnp.sum(lax.scan(lambda c, x: (c * t + x, c), t, TABLE, reverse=True)[1] ** 2),
        lambda t: t**2 + (t**2 + 4) ** 2 + (t**3 + 4 * t + 1) ** 2,
    ),
    "interp": (lambda t: jnp.interp(t + 0.4, TABLE, TABLE**2), lambda t: (t + 0.4) * 1.0),
    "interp beyond": (lambda t: jnp.interp(-1 - t, TABLE, TABLE**2), lambda t: 0 * t),
    "searchsorted": (lambda t: t * jnp.searchsorted(TABLE, t + 0.4).astype(float), lambda t: 1 * t),
    "remainder": (lambda t: jnp.mod(3 * t - 4.5, 2.0), lambda t: 3 * t + 1.5),
    "C's remainder": (lambda t: jnp.fmod(3 * t - 0.5, 1.0), lambda t: 3 * t - 0.5),
    "of a negative": (lambda t: jnp.fmod(-2.5 - t, 1.0), lambda t: -0.5 - t),
    "growing divisor": (lambda t: jnp.mod(5.0, 2 + t), lambda t: 1 - 2 * t),
    "floor division": (lambda t: t * jnp.floor_divide(t + 5.2, 2.0), lambda t: 2 * t),
}
ZEROS = {"abs": 0.3, "max": np.arcsin(0.2), "min": 3.0, "clip": np.log(1.2), "where": 0.7}
ZEROS |= {"floor": 0.8, "ceil": 0.8, "round": 0.3, "sign": 0.1, "cast": 0.8}
ZEROS |= {"cond": 0.7, "switch": 0.8, "loop with a kink": 0.6, "interp": 0.6}
ZEROS |= {"searchsorted": 0.6, "remainder": 0.5 / 3, "C's remainder": 0.5, "of a negative": 0.5}
ZEROS |= {"growing divisor": 0.5, "floor division": 0.8}
ZEROS |= {"arctan2": np.pi - 3, "clamp": np.log(1.2), "clamp below": np.sqrt(0.5)}


@pytest.fixture(scope="module")
def expanded():
    """The series of each function, the series of its branch, and where the function switches."""
    start = jnp.array(1e-3)
    line = [start, jnp.ones_like(start), *[jnp.zeros_like(start)] * 5]

    def look(line, whole, branch):
        both = function_series(whole, line), function_series(branch, line)
        return *both, switching_series(whole, line)

    @kernel  # which takes less to compile
    def all_of_them(line):
        return {name: look(line, *PIECEWISE[name]) for name in PIECEWISE}

    return all_of_them(line), jax.jit(lambda *args: first_zero(*args)[0])


@pytest.mark.parametrize("name", PIECEWISE)
def test_series_are_those_of_the_branch_and_say_where_it_ends(name, expanded):
    series, zero = expanded
    found, of_branch, switches = series[name]
    np.testing.assert_allclose(found, of_branch, rtol=1e-13, atol=1e-13)
    length = 0.9 if ZEROS.get(name) == 0.8 else 4.0 if name == "min" else 0.75
    ends = [float(zero(switch, length, 1e-12)) for switch in switches]
    first = min((end for end in ends if end < length), default=None)
    expected = ZEROS[name] - 1e-3 if name in ZEROS else None
    assert first == (None if expected is None else pytest.approx(expected, abs=1e-8))


@pytest.mark.parametrize(("extreme", "which"), [(jnp.max, 1), (jnp.min, 0)])
def test_the_largest_of_several_is_one_of_them_until_another_is(extreme, which):
    state, field = jnp.array([0.1, 0.2]), jnp.array([2.0, 1.0])
    series = solution_series(lambda y: field + 0 * y, state, 4)
    found = function_series(extreme, series)
    np.testing.assert_allclose(found[:2], [state[which], field[which]])
    (switch,) = switching_series(extreme, series)
    assert abs(float(switch[0])) == pytest.approx(0.1) and abs(float(switch[1])) == 1


def test_kinks_of_which_nothing_is_known_are_refused():
    state = jnp.array([0.1, 0.2])
    with pytest.raises(NotImplementedError, match="sort"):
        solution_series(lambda y: jnp.sort(y) - y, state, 4)
    with pytest.raises(NotImplementedError, match="argmax"):
        solution_series(lambda y: y[jnp.argmax(y)] - y, state, 4)
    with pytest.raises(NotImplementedError, match="bitcast"):
        solution_series(lambda y: jnp.copysign(1.0, y), state, 4)
    fixed = jnp.array([1.0, 3.0])  # what does not change with time may have any
    series = solution_series(lambda y: jnp.max(fixed) + 0 * y, state, 4)
    np.testing.assert_allclose(series[1], 3.0)


@pytest.fixture(scope="module")
def zero():
    """The first zero of polynomials, (n, 7), in 0 <= t <= 1."""
    found = jax.jit(jax.vmap(lambda p: first_zero(list(p), jnp.array(1.0), jnp.array(1e-9))[0]))
    return lambda polynomials: np.asarray(found(jnp.asarray(polynomials)))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_first_zero_is_that_of_all_roots(zero, seed):
    rng = np.random.default_rng(seed)
    polynomials = rng.normal(size=(64, 7)) * 10.0 ** rng.uniform(-3, 0, (64, 7))
    found = zero(polynomials)
    for polynomial, time in zip(polynomials, found, strict=True):
        roots = np.roots(polynomial[::-1])
        real = roots[(np.abs(roots.imag) < 1e-12) & (roots.real >= 0) & (roots.real < 1)].real
        near = roots[(np.abs(roots.imag) < 1e-5)].real  # which may touch zero to rounding
        if real.size and np.abs(near - real.min()).size == near.size:
            assert time <= real.min() + 1e-9
            assert np.abs(near - time).min() < 1e-4
        elif near.size == 0 or ((near < -1e-4) | (near > 1 + 1e-4)).all():
            assert time >= 1


def test_first_zeros_that_hardly_are_or_lie_at_the_start(zero):
    polynomials = np.zeros((5, 7))
    polynomials[0, :3] = 0.25 - 1e-9, -1, 1  # just below (t - 1/2)^2
    polynomials[1, :3] = 0.25 + 1e-9, -1, 1  # just above
    polynomials[2, :2] = 0, 1  # zero at the start
    polynomials[4, :4] = -0.016, 0.28, -1.4, 2  # 2 (t - 0.1) (t - 0.2) (t - 0.4), falling twice
    found = zero(polynomials)
    assert found[0] == pytest.approx(0.5, abs=1e-4) and found[1] >= 1
    assert found[2] == 0 and found[3] >= 1  # one that vanishes has no zero
    assert found[4] == pytest.approx(0.1, abs=1e-9)


class Marked(wj.HybridSystem):
    """a' = a sawtooth and a table of the time: piecewise smooth, for three units of time."""

    slope: jax.Array
    section = ("a",)

    def lift(self, x):
        return {"a": x, "time": 0 * x[0]}

    def project(self, state):
        return state["a"]

    def modes(self):
        def field(state):
            time = state["time"]
            tent = lax.cond(jnp.mod(time, 1.0) < 0.5, lambda t: t, lambda t: 1 - t, time % 1.0)
            table = jnp.interp(time, jnp.array([0.0, 0.7, 3.0]), jnp.array([1.0, 0.0, 2.3]))
            sum = lax.fori_loop(0, 2, lambda _, s: s + self.slope * tent, table)
            return {"a": jnp.stack([sum]), "time": jnp.ones_like(time)}

        return {"flow": wj.Mode(field, (wj.Guard(lambda state: state["time"] - 3.0, wj.SECTION),))}


@pytest.mark.slow
def test_a_motion_by_branches_loops_tables_and_remainders():
    """Areas of triangles: each tent 1/4, twice three of them; a table 0.35 + 2.3^2 / 2."""
    end = lambda slope: wj.stride(Marked(slope), jnp.array([0.2])).state[0]
    value, by_slope = jax.jvp(end, (2.0,), (1.0,))
    assert value == pytest.approx(0.2 + 2 * 2.0 * 3 / 4 + 0.35 + 2.3**2 / 2, abs=1e-11)
    assert by_slope == pytest.approx(2 * 3 / 4, abs=1e-11)


@pytest.mark.parametrize("count", [17, pytest.param(40, marks=pytest.mark.slow)])
def test_a_step_is_cut_at_the_first_kink_of_a_layer(count):
    """The switching functions of a long array are one list of arrays, with the same zeros."""
    rng = np.random.default_rng(7)
    series = [jnp.asarray(c) for c in rng.normal(size=(6, 40)) / 3.0 ** np.arange(6)[:, None]]
    units = lambda series: [[c[i] for c in series] for i in range(count)]
    cut = lambda switches: cut_at_switches(switches, jnp.asarray(2.0), jnp.asarray(1e-12))
    of_all = jax.jit(jax.value_and_grad(lambda s: cut([s])))
    of_each = jax.jit(jax.value_and_grad(lambda s: cut(units(s))))
    for start in (1.0, 30.0):  # many zeros, and none
        some = [c[:count] + (start if k == 0 else 0) for k, c in enumerate(series)]
        (found, slopes), (expected, others) = of_all(some), of_each(some)
        np.testing.assert_allclose(found, expected, rtol=1e-11)
        np.testing.assert_allclose(slopes, others, rtol=1e-7, atol=1e-9)
        assert (found == 2) == (start == 30)


def test_a_layer_has_its_kinks_together_and_softplus_none():
    weights = np.random.default_rng(8).normal(size=(20, 2))
    state = [jnp.asarray([0.3, -0.2]), jnp.asarray([1.0, 0.5])]
    layer = lambda f: lambda x: f(jnp.asarray(weights) @ x)
    (switch,) = switching_series(layer(jax.nn.relu), state)
    np.testing.assert_allclose(jnp.stack(switch), jnp.stack(state) @ weights.T, rtol=1e-14)
    assert switching_series(layer(jax.nn.softplus), state) == []
