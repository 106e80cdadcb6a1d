"""What is known of a walker, and of which others it is not."""

import inspect
from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
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

    force_least_at_ends = True

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


class FallingWalker(wj.SimplestWalker):
    def falls(self, state):
        return super().falls(state)


class ModesWalker(wj.SimplestWalker):
    def modes(self):
        return super().modes()


class AheadWalker(wj.SimplestWalker):
    def is_ahead(self, state):
        return super().is_ahead(state)


KNOWN = (
    "force_least_at_ends",
    "foot_stays_down",
    "inverted_pendulum",
    "driven_by_gravity",
    "past_contact",
)
FALLING = tuple(name for name in KNOWN if name != "past_contact")
AHEAD = tuple(name for name in KNOWN if name != "foot_stays_down")


@pytest.mark.parametrize(
    ("kind", "kept"),
    [
        (wj.SimplestWalker, (*KNOWN, "gait_region")),
        (NamedWalker, (*KNOWN, "gait_region")),
        (TorqueWalker, ()),
        (HastyTorqueWalker, ("force_least_at_ends", "past_contact")),
        (PushedWalker, tuple(name for name in KNOWN if name != "driven_by_gravity")),
        (FallingWalker, (*FALLING, "gait_region")),
        (AheadWalker, (*AHEAD, "gait_region")),
        (ModesWalker, ()),
    ],
)
def test_what_is_known_does_not_pass_to_a_changed_walker(kind, kept):
    for name in (*KNOWN, "gait_region"):
        is_default = inspect.getattr_static(kind, name) is inspect.getattr_static(wj.Walker, name)
        assert is_default == (name not in kept), name
    assert moves_like(kind(*[0.01] * len(fields(kind))), wj.SimplestWalker) == (len(kept) == 6)


@pytest.mark.parametrize("kind", [wj.SimplestWalker, wj.SpringWalker])
def test_a_foot_that_is_known_to_stay_down_does(kind):
    """At all slopes, with all springs: strides that look whether it came up again are the same."""
    doubtful = type("Doubtful", (kind,), {"foot_stays_down": False})
    rng = np.random.default_rng(3)
    theta = rng.uniform(0.01, np.pi / 4, 20_000)
    rate = np.concatenate(
        [-theta[:10_000] + rng.uniform(-0.1, 0.1, 10_000), -rng.uniform(0, 1.4, 10_000)]
    )
    values = 10 ** rng.uniform(-3.5, -0.5, 20_000), 10 ** rng.uniform(-2, 2, 20_000)
    many = lambda kind: jax.vmap(kind)(*map(jnp.asarray, values[: len(fields(kind))]))
    xs = np.stack([theta, rate], axis=1)
    known, searched = wj.strides(many(kind), xs), wj.strides(many(doubtful), xs)
    np.testing.assert_array_equal(known.outcome, searched.outcome)
    np.testing.assert_array_equal(known.state, searched.state)


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
    walker = kind(*[jnp.array(value) for value in (0.01, 0.5, -0.3)[: len(fields(kind))]])
    found = wj.gait_measures(walker, [], wj.find_gait(walker, guess))
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


def test_gaits_of_another_motion_are_searched_where_they_may_be():
    walker = TorqueWalker(0.01, *jnp.array([0.0, 0.0]))  # no torque: the simplest walker's gaits
    assert moves_like(walker, wj.SimplestWalker) is False
    found = wj.find_gaits(walker)
    expected = [wj.find_gait(wj.SimplestWalker(0.01)).states[0]]
    assert np.abs(np.array([gait.states[0] for gait in found]) - expected).max(1).min() < 1e-9
