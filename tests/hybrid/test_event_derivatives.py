"""Derivatives by a parameter on which the time of an event depends, in closed form.

The first two systems are those of reports on other solvers (DiffEqGPU.jl 533, diffrax 729), which
leave out how the time of the event changes.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.kernels import program, transposes


class Timed(wj.HybridSystem):
    """A state u and a clock, from u = x at the time 0 to the time `until`."""

    p: Any
    until = 1.0
    section = ("u",)

    def lift(self, x):
        return x[0], 0 * x[0]

    def project(self, state):
        return state[0][None]

    def over(self):
        return wj.Guard(lambda state: state[1] - self.until, wj.SECTION)


class Reset(Timed):
    """u' = 1; where u reaches p, it starts again from 0."""

    def modes(self):
        grows = lambda state: (1 + 0 * state[0], 1 + 0 * state[1])
        again = wj.Guard(
            lambda state: state[0] - self.p, "after", reset=lambda state: (0 * state[0], state[1])
        )
        return {
            "before": wj.Mode(grows, (again, self.over())),
            "after": wj.Mode(grows, (self.over(),)),
        }


class Stopped(Timed):
    """u' = 1 until the time p, and 0 from then on."""

    until = 2.0

    def modes(self):
        to = lambda rate: lambda state: (rate + 0 * state[0], 1 + 0 * state[1])
        stops = wj.Guard(lambda state: state[1] - self.p, "rest")
        return {"motion": wj.Mode(to(1.0), (stops,)), "rest": wj.Mode(to(0.0), (self.over(),))}


class Decay(Timed):
    """u' = -u until u = p, and u' = p^2 from then on: events inside steps of any length."""

    def modes(self):
        falls = lambda state: (-state[0], 1 + 0 * state[1])
        rises = lambda state: (self.p**2 + 0 * state[0], 1 + 0 * state[1])
        turns = wj.Guard(lambda state: self.p - state[0], "rise")
        return {"fall": wj.Mode(falls, (turns,)), "rise": wj.Mode(rises, (self.over(),))}


class Halved(Timed):
    """u' = p u until u = 1, where u is halved, and u' = -p u from then on."""

    def modes(self):
        to = lambda rate: lambda state: (rate * state[0], 1 + 0 * state[1])
        halved = wj.Guard(
            lambda state: state[0] - 1, "after", reset=lambda state: (state[0] / 2, state[1])
        )
        return {
            "before": wj.Mode(to(self.p), (halved, self.over())),
            "after": wj.Mode(to(-self.p), (self.over(),)),
        }


def reset_at_the_end(p):
    return jnp.where(p < 1, 1 - p, 1.0)


def decayed_at_the_end(p):
    """From u = 1: p is reached at the time -log(p)."""
    return p + p**2 * (1 + jnp.log(p))


def halved_at_the_end(p, x):
    """From u = x: 1 is reached at the time -log(x) / p, if that is below 1."""
    return jnp.where(x * jnp.exp(p) > 1, jnp.exp(-p) / (2 * x), x * jnp.exp(p))


CASES = {
    "a reset": (Reset, 0.0, reset_at_the_end, [0.55, 0.7, 0.95, 1.2]),
    "a stop": (Stopped, 0.0, lambda p: p, [0.1, 0.98, 1.7]),
    "a decay": (Decay, 1.0, decayed_at_the_end, [0.4, 0.5, 0.625, 0.9]),
}


@pytest.mark.parametrize(
    "name", ["a reset", pytest.param("a stop", marks=pytest.mark.slow), "a decay"]
)
def test_the_time_of_an_event_is_differentiated(name):
    """In both modes, in a batch, also where no event happens."""
    system, start, exact, values = CASES[name]
    p = jnp.asarray(values)

    def derivatives(end):
        return lambda p: (end(p), jax.grad(end)(p), jax.jacfwd(end)(p))

    end = lambda p: wj.stride(system(p), jnp.asarray([start], p.dtype)).state[0]
    found, expected = (jax.jit(jax.vmap(derivatives(f)))(p) for f in (end, exact))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_the_adjoint_of_two_modes_and_a_reset(monkeypatch):
    """By the parameter of both modes and by the start, in a batch, also where no event happens."""
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)
    p, x = jnp.array([0.9, 1.5, 9.0, 0.4]), jnp.array([0.5, 0.8, 1e-3, 0.6])
    end = lambda p, x: wj.stride(Halved(p), x[None]).state[0]
    gradients = lambda end: jax.jit(jax.vmap(jax.grad(end, (0, 1))))(p, x)
    found, expected = gradients(end), gradients(halved_at_the_end)
    known = [one for one, _ in program.programs.values() if one.owner == "Halved"]
    made = [adjoint for one in known for adjoint in one.adjoints.values()]
    assert made and all(made)  # or the columns of the Jacobian were computed instead
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_the_derivatives_of_the_reports_are_minus_one_and_one():
    """To the last digit, and of the time of an event by its level (OrdinaryDiffEq.jl 4388)."""
    end = lambda p, system: wj.stride(system(p), jnp.zeros(1)).state[0]
    levels = jnp.linspace(0.51, 0.99, 97)
    by_level = jax.jit(jax.vmap(jax.grad(lambda p: end(p, Reset))))(levels)
    by_time = jax.jit(jax.vmap(jax.grad(lambda p: end(p, Stopped))))(levels)
    np.testing.assert_allclose(by_level, -1, rtol=2e-16)
    np.testing.assert_allclose(by_time, 1, rtol=2e-16)
