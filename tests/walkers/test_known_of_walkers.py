"""What is known of a walker, and of which others it is not."""

from dataclasses import MISSING, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_measures import all_measures
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.multibody import System
from walker_jax.walkers.model import Scalar, moves_like


class TorqueWalker(wj.SimplestWalker):
    """A hip torque that brings the swing leg to an angle."""

    stiffness: Scalar
    target: Scalar

    def vector_field(self, state):
        free = super().vector_field(state)
        torque = self.stiffness * (state.phi - self.target)
        return free._replace(phidot=free.phidot - torque)


class HastyTorqueWalker(TorqueWalker):
    """The same, that says of itself what is known of the simplest walker."""

    def past_contact(self, state):
        return wj.SimplestWalker.past_contact(self, state)


class NamedWalker(wj.SimplestWalker):
    """The simplest walker, with more to say."""

    def greet(self):
        return "walks"


class PushOff:
    """A class that is no walker, from which one takes its impact."""

    def impact(self: Any, state):
        foot, after = wj.SimplestWalker.impact(self, state)
        return foot, after._replace(thetadot=1.1 * after.thetadot, phidot=1.1 * after.phidot)


class PushedWalker(PushOff, wj.SimplestWalker):
    pass


SWINGS = {"falls last", "the foot stays down", "the force is least at ends", "past contact"}
ALL = SWINGS | {"gravity", "gait region"}


def one_of(kind):
    """A walker of some kind, with its default parameters and others of 0.01."""
    return kind(*[0.01] * sum(one.default is MISSING for one in fields(kind)))


def known_of(kind) -> set[str]:
    """What is known of walkers of some kind."""
    walker = one_of(kind)
    swing, region = walker.modes()["swing"], walker.gait_region()
    *falls, strike = swing.guards
    facts = {
        "falls last": all(one.persists for one in falls),
        "the foot stays down": strike.persists,
        "the force is least at ends": swing.conditions[0].least_at_ends,
        "past contact": swing.early_exit is not None,
        "gravity": walker.driven_by_gravity(),
        "gait region": region.shape != wj.Walker.gait_region(walker).shape,
    }
    return {name for name, holds in facts.items() if holds}


def changed(kind, *names: str):
    """A kind of walkers that redefines methods, though they do the same."""

    def again(name):
        return lambda self, *args: getattr(super(new, self), name)(*args)

    new: Any = type("Changed", (kind,), {name: again(name) for name in names})
    return new


@pytest.mark.parametrize(
    ("kind", "known"),
    [
        (wj.SimplestWalker, ALL),
        (wj.SpringWalker, ALL),
        (wj.PoweredWalker, {"falls last", "the force is least at ends", "gravity"}),
        (wj.PointFootWalker, {"past contact", "gravity", "gait region"}),
        (wj.RoundFootWalker, {"past contact", "gravity"}),
        (wj.PoweredPointFootWalker, set()),
        (NamedWalker, ALL),
        (TorqueWalker, set()),
        (HastyTorqueWalker, {"past contact"}),
        (changed(HastyTorqueWalker, "vector_field"), set()),
        (PushedWalker, SWINGS),
    ],
)
def test_what_is_known_of_walkers(kind, known):
    assert known_of(kind) == known
    assert moves_like(one_of(kind), wj.SimplestWalker) == (kind in (wj.SimplestWalker, NamedWalker))


LOST = {
    "vector_field": ALL,
    "equations": ALL - {"gravity"},
    "modes": ALL,
    "contact": SWINGS | {"gait region"},
    "is_ahead": SWINGS,
    "falls": SWINGS,
    "contact_force": SWINGS,
    "impact": {"gravity", "gait region"},
    "lift": {"gait region"},
    "project": {"gait region"},
    "phases": {"gravity"},
    "during_stride": {"gravity"},
}
"""The facts that a class loses which redefines a method, whatever that does."""


@pytest.mark.parametrize(("method", "lost"), LOST.items())
def test_what_is_known_does_not_pass_to_a_changed_walker(method, lost):
    for kind in (wj.SimplestWalker, wj.SpringWalker, wj.PoweredWalker, wj.PointFootWalker):
        once = changed(kind, method)
        assert known_of(once) == known_of(kind) - lost == known_of(changed(once, "greet"))


def in_doubt(kind):
    """The same walkers, of whose swing nothing is known."""
    return type("Doubtful", (kind,), {"modes": wj.Walker.modes})


PARAMETERS = [(-3.5, -0.5), (-2, 2.5), (-2, 1)]
"""Exponents of the least and largest slope, hip stiffness and damping."""


@pytest.mark.parametrize(
    ("kind", "launched"),
    [
        pytest.param(wj.SimplestWalker, False, marks=pytest.mark.slow),
        pytest.param(wj.SpringWalker, False, marks=pytest.mark.slow),
        (wj.SpringWalker, True),
        pytest.param(wj.PoweredWalker, True, marks=pytest.mark.slow),
    ],
)
def test_what_is_known_changes_no_stride(kind, launched):
    """At all slopes, with all springs: all strides are as if nothing were known."""
    rng, n = np.random.default_rng(3), 20_000
    values = [jnp.asarray(10 ** rng.uniform(low, high, n)) for low, high in PARAMETERS]
    values = values[: min(3, sum(one.init for one in fields(kind)))]
    if launched:
        spread = (-1, 1), (-2, 2), (-1.6, 0.1), (-4, 4)
        xs = np.stack([rng.uniform(low, high, n) for low, high in spread], axis=1)
    else:
        theta = rng.uniform(0.01, np.pi / 4, n)
        near = rng.uniform(-0.15, 0.15, n // 2) - theta[: n // 2]
        xs = np.stack([theta, np.concatenate([near, -rng.uniform(0, 1.6, n // 2)])], axis=1)
    known, searched = (wj.strides(jax.vmap(one)(*values), xs) for one in (kind, in_doubt(kind)))
    assert {0, 1, 2, 3} <= set(known.outcome.tolist())
    np.testing.assert_array_equal(known.outcome, searched.outcome)
    np.testing.assert_array_equal(known.state, searched.state)


def test_a_launched_foot_may_come_down_again():
    """Of a launch, `rises_past_contact` is not enough: a stiff spring brings the leg back."""
    x = np.array([-0.08297899, -0.10377403, -0.053272, 3.63239204])
    walker = wj.SpringWalker(0.02472303749275454, 6.526178627223347)
    assert walker.past_contact(wj.State(*x)) and walker.contact(wj.State(*x)) > 0
    made = wj.stride(walker, x)
    assert made.outcome == wj.Outcome.STRIDE

    def field(_, y):
        theta, phi, thetadot, phidot = y
        angle = theta - float(walker.slope)
        swing = np.sin(phi) * (thetadot**2 - np.cos(angle)) + np.sin(angle)
        return [thetadot, phidot, np.sin(angle), swing - float(walker.hip_stiffness) * phi]

    down = lambda t, y: y[0] + np.pi / 2
    down.terminal = True
    rises = lambda t, y: y[1] - 2 * y[0]
    rises.direction = 1
    found = solve_ivp(field, (0, 40), x, events=(down, rises), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(made.time, found.t_events[1][0], rtol=1e-8)
    np.testing.assert_allclose(made.state[0], -found.y_events[1][0][0], rtol=1e-8)


def test_a_torque_may_bring_the_foot_down_again():
    """Where the simplest walker's swing leg could only rise, this one still strikes."""
    theta, rate = np.meshgrid(np.linspace(0.01, 0.04, 30), np.linspace(-0.43, -0.3, 30))
    starts = np.stack([theta.ravel(), rate.ravel()], axis=1)
    torque = jnp.array([4.0, -0.6])
    free, hasty = (kind(0.004, *torque) for kind in (TorqueWalker, HastyTorqueWalker))
    ends, wrong = wj.strides(free, starts), wj.strides(hasty, starts)
    unlike = np.flatnonzero(ends.outcome != wrong.outcome)
    assert len(unlike) > 3 and (wrong.outcome[unlike] == wj.Outcome.FORWARD).all()

    def field(_, y):
        theta, phi, thetadot, phidot = y
        angle = theta - 0.004
        swing = np.sin(phi) * (thetadot**2 - np.cos(angle)) + np.sin(angle) - 4 * (phi + 0.6)
        return [thetadot, phidot, np.sin(angle), swing]

    down = lambda t, y: y[0] + np.pi / 2
    down.terminal = True
    for i in unlike[:2]:
        lifted = np.array(free.lift(jnp.asarray(starts[i])))
        path = solve_ivp(field, (0, 40), lifted, events=down, rtol=1e-9, max_step=0.02).y
        h = path[1] - 2 * path[0]
        rises = (h[:-1] < 0) & (h[1:] >= 0) & (path[0][1:] < 0) & (path[1][1:] < 0)
        assert rises.any()


def test_margins_of_no_inverted_pendulum_are_not_those_of_one():
    class Braked(wj.SimplestWalker):
        def vector_field(self, state):
            free = super().vector_field(state)
            return free._replace(thetadot=free.thetadot - 0.02 * state.thetadot)

    start = jnp.array([0.2, -0.22])
    energy = 0.22**2 / 2 + np.cos(0.2 - 0.004) - 1
    plain, braked = (wj.margins(kind(0.004), start) for kind in (wj.SimplestWalker, Braked))
    assert float(plain.backward) == pytest.approx(energy, rel=1e-12)

    def field(_, y):  # of the stance leg alone
        return [y[1], np.sin(y[0] - 0.004) - 0.02 * y[1]]

    times = np.linspace(0, float(braked.stride.time), 4001)
    rate = solve_ivp(field, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12).y[1]
    assert float(braked.backward) == pytest.approx(np.min(rate**2) / 2, rel=1e-5)
    assert float(braked.backward) < 0.99 * energy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "guess"), [(TorqueWalker, [0.205, -0.207]), (PushedWalker, [0.2, -0.2])]
)
def test_cost_of_transport_is_known_by_gravity_alone(kind, guess):
    walker = kind(
        *[jnp.array(value) for value in (0.01, 0.5, -0.3)[: sum(one.init for one in fields(kind))]]
    )
    found = all_measures(walker, [], wj.find_gait(walker, guess))
    assert np.isfinite(found["speed"].value) and np.isnan(found["cost-of-transport"].value)


def test_walkers_of_masses_without_motors_are_driven_by_gravity():
    class Motor(wj.PointFootWalker):
        def system(self):
            free = super().system()
            push = lambda q, qdot: jnp.zeros_like(q)
            return System(free.transfer, free.masses, free.forces, push)

    class Wind(wj.PointFootWalker):
        def system(self):
            free = super().system()
            return System(free.transfer, free.masses, free.forces.at[2].add(5e-4))

    for kind in (wj.PointFootWalker, wj.RoundFootWalker, wj.UpperBodyWalker):
        assert kind(0.01).driven_by_gravity()
    assert not Motor(0.01).driven_by_gravity() and not Wind(0.01).driven_by_gravity()


def test_an_impact_that_turns_the_leg_back_has_a_margin_of_that():
    class Turning(wj.SimplestWalker):
        def impact(self, state):
            foot, after = super().impact(state)
            c = jnp.cos(state.phi)  # 0.9 with the legs exchanged
            return foot, after._replace(thetadot=0.9 * c, phidot=0.9 * (c - 1))

    found = wj.margins(Turning(0.004), jnp.array([0.2, -0.21]))
    assert found.stride.outcome == wj.Outcome.BACKWARD
    assert float(found.backward) == pytest.approx(-(0.9**2) / 2, rel=1e-12)


@pytest.mark.slow  # by default the facts above tell that it has not the simplest walker's region
def test_gaits_of_another_motion_are_searched_where_they_may_be():
    walker = TorqueWalker(0.01, *jnp.array([0.0, 0.0]))  # no torque: the simplest walker's gaits
    assert moves_like(walker, wj.SimplestWalker) is False
    found = wj.find_gaits(walker)
    expected = [wj.find_gait(wj.SimplestWalker(0.01)).states[0]]
    assert np.abs(np.array([gait.states[0] for gait in found]) - expected).max(1).min() < 1e-9
