"""Recordings that are made up, of systems whose motion is known."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import walker_jax as wj


class Flight(NamedTuple):
    """Height, velocity and time since the last bounce."""

    height: Any
    velocity: Any
    clock: Any


class Ball(wj.HybridSystem):
    """A ball on the ground, whose gravity has two parts, with a push that is a table over time."""

    gravity: float = 9.0
    more_gravity: float = 0.81
    restitution: float = 0.9
    push: Any = (0.0, 0.0)
    spacing: float = 1.0

    section = ("velocity",)

    def lift(self, x):
        return Flight(jnp.zeros_like(x[0]), x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([state.velocity])

    def feasible(self, x):
        return x[0] > 0

    def modes(self):
        def field(y):
            rate = (self.push[1] - self.push[0]) / self.spacing
            fall = self.gravity + self.more_gravity
            push = self.push[0] + rate * y.clock
            return Flight(y.velocity, push - fall, jnp.ones_like(y.clock))

        bounce = lambda y: y._replace(velocity=-self.restitution * y.velocity)
        return {
            "flight": wj.Mode(field, (wj.Guard(lambda y: -y.height, wj.SECTION, reset=bounce),))
        }


GRAVITY, SPEED = 9.81, 5.0


def bounces(count: int, restitution: float | np.ndarray = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Times of bounces, the first at 0, and speeds after all but the last; in closed form."""
    factors = np.broadcast_to(restitution, count)
    speeds = SPEED * np.append(1, np.cumprod(factors[:-1]))
    return np.append(0, np.cumsum(2 * speeds / GRAVITY)), speeds


def record_ball(
    count: int = 6, noise: float = 0.0, seed: int = 0, restitution: Any = 0.9, **changes
):
    """Record heights of a ball over bounces, in closed form, at 40 samples a second."""
    random = np.random.default_rng(seed)
    strikes, speeds = bounces(count, restitution)
    times = np.arange(0.0125, strikes[-1], 0.025)
    number = np.searchsorted(strikes, times) - 1
    after = times - strikes[number]
    heights = (
        speeds[number] * after - GRAVITY * after**2 / 2 + noise * random.normal(size=len(times))
    )
    samples = {"time": times, "height": heights} | changes
    return wj.read_recordings(
        samples, ["height"], strikes=strikes + noise * random.normal(size=count + 1)
    )


def record_walk(walker, steps=6, spacing=0.2, noise=0.0, seed=0, disturbed=1.002):
    """Record angles of a walk from near the gait."""
    random, gait = np.random.default_rng(seed), wj.find_gait(walker)
    made = wj.walk(walker, gait.states[0] * disturbed, steps)
    strikes = np.append(0, np.cumsum(made.times))
    times = np.arange(spacing / 2, strikes[-1], spacing)
    state = wj.trajectory(walker, made.states[0], times, strides=steps)
    draw = lambda values: np.asarray(values) + noise * random.normal(size=len(values))
    samples = {"time": times, "theta": draw(state.theta), "phi": draw(state.phi)}
    return wj.read_recordings(samples, strikes=draw(strikes))
