"""Reverse mode by many parameters: the adjoint of a stride, against forward mode."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.kernels import program, transposes
from walker_jax.kernels.reverse import reversing
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import make_stride
from walker_jax.walking.stride import Course, Entry, with_full_state

POWERS = [(1, 0), (0, 1), (1, 1)]
"""Powers of height and velocity in the force, each with a weight."""


class Flight(NamedTuple):
    """Height and velocity of a ball, and the time since it was last on the section."""

    height: Any
    velocity: Any
    clock: Any


class Ball(HybridSystem):
    """A ball in a field with several weights, seen at times 2 apart, some bounces later.

    A flight is entered again and again. A ball above 2 has escaped.
    """

    weights: dict
    restitution: Any

    section, failures = ("height", "velocity"), ("ESCAPED",)

    def modes(self):
        def field(y: Flight) -> Flight:
            force = -jnp.ones_like(y.clock)
            for (i, j), weight in zip(POWERS, self.weights.values(), strict=True):
                force += weight * y.height**i * y.velocity**j
            return Flight(y.velocity, force, jnp.ones_like(force))

        bounce = lambda y: y._replace(velocity=-self.restitution * y.velocity)
        floor = Guard(lambda y: -y.height, "flight", reset=bounce)
        seen = Guard(lambda y: y.clock - 2, SECTION, reset=lambda y: y._replace(clock=0 * y.clock))
        escapes = Guard(lambda y: y.height - 2, "ESCAPED")
        return {"flight": Mode(field, (floor, escapes, seen))}

    def lift(self, x):
        return Flight(x[0], x[1], 0 * x[0])

    def project(self, state):
        return jnp.stack([state.height, state.velocity])

    def feasible(self, x):
        return x[0] > 0


WEIGHTS = 0.05 * np.random.default_rng(5).normal(size=len(POWERS))
BALL = Ball(
    {f"w{i}{j}": jnp.asarray(w) for (i, j), w in zip(POWERS, WEIGHTS, strict=True)},
    jnp.asarray(0.8),
)
STARTS = jnp.array([[0.5, 0.1], [0.3, 0.9], [0.2, 2.5], [0.7, -0.4], [-0.1, 0.0]])
"""Starts of balls that bounce several times, but the third, which is fast, and the last, which is
below the floor."""


def total(ball, x):
    end = wj.stride(ball, x)
    return end.state @ jnp.array([1.0, 0.3]) + 0.7 * end.time


def after_three(ball, x):
    """A number after three strides."""
    step = lambda x, _: (wj.stride(ball, x).state, None)
    return jax.lax.scan(step, x, length=3)[0].sum()


def agree(found, expected):
    """Check gradients of the same numbers, to 1e-11 of the largest of each start."""
    rows = lambda tree: np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves(tree)], 1)
    found, expected = rows(found), rows(expected)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-11)


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def by_start(derivative, function):
    return jax.jit(jax.vmap(derivative(function, (0, 1)), (None, 0)))


def adjoints():
    """The adjoints that have been made of strides of the ball."""
    known = [one for one, _ in program.programs.values() if one.owner == "Ball"]
    return [one for found in known for one in found.adjoints.values()]


@pytest.fixture(autouse=True)
def by_adjoint(monkeypatch):
    """Reverse mode by the adjoint, however few weights there are."""
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)


@pytest.mark.parametrize("function", [total, pytest.param(after_three, marks=pytest.mark.slow)])
def test_reverse_mode_agrees_with_forward_mode(function):
    """Bounces, falls that have no derivatives, and several strides, all by machine code."""
    found = by_start(jax.grad, function)(BALL, STARTS)
    assert adjoints() and all(one and one.compiled for one in adjoints())
    agree(found, by_start(jax.jacfwd, function)(BALL, STARTS))
    lost = np.isnan(leaves(found)[0])
    assert lost.tolist() == [wj.stride(BALL, x).outcome != 0 for x in STARTS]


def test_failure_without_a_cotangent_has_no_part():
    """A failure that the result does not depend on leaves its gradient zero, not NaN."""

    def kept(ball, x):
        end = wj.stride(ball, x)
        return jnp.where(end.outcome == 0, end.state, 0).sum()

    found = jax.jit(jax.grad(lambda ball: jax.vmap(kept, (None, 0))(ball, STARTS).sum()))(BALL)
    alone = jax.jit(jax.vmap(jax.grad(kept), (None, 0)))(BALL, STARTS)
    assert np.isfinite(leaves(found)).all()
    assert (np.array(leaves(alone))[:, -1] == 0).all()
    np.testing.assert_allclose(leaves(found), np.sum(leaves(alone), axis=1), rtol=1e-12)


def test_a_full_state_after_a_failure_has_no_part():
    """Its cotangent of zero leaves the walk before it zero, although the state itself is NaN."""

    def full(state, outcome):
        none = jnp.asarray(0.0)
        stride = make_stride(state[:2], outcome, none)
        entry = Entry(jnp.asarray(True), Flight(*state))
        course = Course({SECTION: entry}, none, outcome, outcome, {})
        with reversing(True):
            return with_full_state(stride, course).state

    state = jnp.array([0.5, -0.2, 0.1])
    for outcome, expected in ((0, [1, 2, 3]), (2, [0, 0, 0])):
        made, pull = jax.vjp(lambda state, now=outcome: full(state, jnp.int8(now)), state)
        assert np.isnan(made).all() == (outcome != 0)
        np.testing.assert_array_equal(pull(jnp.array(expected, float))[0], expected)


@pytest.mark.slow
def test_second_derivatives_are_forward_over_reverse():
    """Against differences of gradients."""
    gradient = lambda x: jax.grad(total)(BALL, x)
    x, v = STARTS[0], jnp.array([0.6, -0.8])
    changes = jax.jit(lambda x: jax.jvp(gradient, (x,), (v,))[1])(x)
    ahead, behind = (jax.jit(gradient)(x + h * v) for h in (1e-5, -1e-5))
    expected = [(a - b) / 2e-5 for a, b in zip(leaves(ahead), leaves(behind), strict=True)]
    np.testing.assert_allclose(leaves(changes), expected, rtol=1e-7, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("system", [wj.KneedWalker(0.05), wj.systems.SpringMassBiped()])
def test_walkers_agree_with_forward_mode(system):
    """Phases with a balance of power; fractional powers, and modes that begin and end anywhere."""
    x = wj.find_gait(system).states[0]
    starts = jnp.stack([x, 1.002 * x])
    system = jax.tree.map(jnp.asarray, system)
    expected = by_start(jax.jacfwd, lambda s, x: wj.stride(s, x).state.sum())(system, starts)
    agree(by_start(jax.grad, lambda s, x: wj.stride(s, x).state.sum())(system, starts), expected)
