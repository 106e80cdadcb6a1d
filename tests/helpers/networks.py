"""Walkers and machines whose parameters are networks, arrays and dictionaries of arrays."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax.walkers.parameters import Parameter

GAIN = 0.02
"""Size of the torques at the hip: that of the others in a stride."""


def network(seed: int, width: int = 4) -> eqx.nn.MLP:
    return eqx.nn.MLP(2, 1, width, 1, activation=jnp.tanh, key=jax.random.key(seed))


class NetworkWalker(wj.SimplestWalker):
    """The simplest walker with a network of both angles as the torque at the hip."""

    policy: eqx.nn.MLP = network(0)

    def torque(self, state):
        return self.policy(jnp.stack([state.theta, state.phi]))[0]

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot + GAIN * self.torque(state))


class ByScalars(NetworkWalker):
    """The same, with a field for each number of the network."""

    policy: Any = None
    w00: float = 0.0
    w01: float = 0.0
    w10: float = 0.0
    w11: float = 0.0
    w20: float = 0.0
    w21: float = 0.0
    w30: float = 0.0
    w31: float = 0.0
    b0: float = 0.0
    b1: float = 0.0
    b2: float = 0.0
    b3: float = 0.0
    v0: float = 0.0
    v1: float = 0.0
    v2: float = 0.0
    v3: float = 0.0
    c: float = 0.0

    def torque(self, state):
        of = lambda name: getattr(self, name)
        hidden = [
            jnp.tanh(of(f"w{i}0") * state.theta + of(f"w{i}1") * state.phi + of(f"b{i}"))
            for i in range(4)
        ]
        total = self.v0 * hidden[0]
        for i in (1, 2, 3):
            total = total + of(f"v{i}") * hidden[i]
        return total + self.c


NAMES = [one for one in ByScalars.__annotations__ if one != "policy"]


def by_scalars(walker: NetworkWalker) -> ByScalars:
    """The walker with a field for each number of its network."""
    every = np.concatenate(list(map(np.ravel, jax.tree.leaves(walker.policy))))
    values: Any = map(jnp.asarray, every)
    return ByScalars(walker.slope, **dict(zip(NAMES, values, strict=True)))


class Point(NamedTuple):
    place: Any
    speed: Any
    time: Any


class Pushed(wj.HybridSystem):
    """A point that a force pushes for a time of 1: its speed grows like a polynomial of time.

    place'' = gain (c0 + c1 t + c2 t^2) + sum of pulls, where `order` tells which of the `powers` is
    c0, c1 and c2.
    """

    force: dict[str, Any]
    order: Any
    pulls: Any = Parameter("pulls", "of springs", "N", 0.5, shape=(2,)).field()

    section = ("place", "speed")

    def lift(self, x):
        return Point(x[0], x[1], 0 * x[0])

    def project(self, state):
        return jnp.stack([state.place, state.speed])

    def modes(self):
        def field(y):
            powers = self.force["powers"][self.order]
            force = powers[0] + powers[1] * y.time + powers[2] * y.time**2
            total = self.force["gain"] * force + jnp.sum(self.pulls)
            return Point(y.speed, total, jnp.ones_like(y.time))

        return {"push": wj.Mode(field, (wj.Guard(lambda y: y.time - 1, wj.SECTION),))}


class Limited(Pushed):
    """The same between two places, beyond which it fails forward or backward.

    It would run if a number fell below zero that is least on the way.
    """

    def modes(self):
        push = super().modes()["push"]
        ends = (
            wj.Guard(lambda y: y.place - 2, "FORWARD"),
            wj.Guard(lambda y: -y.place, "BACKWARD"),
        )
        least = lambda y: self.force["gain"] * (y.time - 0.5) ** 2 + y.speed**2 / 10 + 0.01
        conditions = (wj.Condition(least, "RUNNING"),)
        return {"push": push._replace(guards=(*push.guards, *ends), conditions=conditions)}


def pushed(gain: Any = 2.0, kind: type[Pushed] = Pushed) -> Pushed:
    powers = jnp.array([0.3, -0.2, 0.7])
    return kind({"gain": gain, "powers": powers}, np.array([2, 0, 1]), jnp.array([0.1, 0.4]))
