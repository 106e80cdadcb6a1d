"""Walkers: bipeds of two straight legs that go down a slope with no motor.

Conventions, those of Schwab and Wisse (2001). Everything is nondimensional: lengths are counted
in leg lengths, masses in hip masses, times in sqrt(leg length / gravity). Angles are in rad:

- `slope`: of the ground, downwards in the direction of walking;
- `theta`: of the stance leg, from the normal of the slope, positive before mid-stance;
- `phi`: between the legs, from the stance leg to the swing leg.

A stride begins just after heel strike, on the Poincaré section, with both feet on the slope
(phi = 2 theta), and ends at the next heel strike.
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.cells import Grid

Scalar = Float[Array, ""]


class State(NamedTuple):
    """Angles (rad) and rates (rad per unit of time) of the two legs, or their time derivatives."""

    theta: Scalar
    phi: Scalar
    thetadot: Scalar
    phidot: Scalar


class Walker(eqx.Module):
    """What a stride needs to know of a walker. Its fields are its parameters, scalars all."""

    section: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the coordinates of the Poincaré section."""

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> State:
        """The full state of a point of the section."""

    @abc.abstractmethod
    def project(self, state: State) -> Float[Array, " section"]:
        """The point of the section of a state just after heel strike."""

    @abc.abstractmethod
    def feasible(self, x: Float[Array, " section"]) -> Bool[Array, ""]:
        """Whether a stride can begin at x."""

    @abc.abstractmethod
    def gait_region(self) -> Grid:
        """The part of the section where the states of gaits lie, in cells to search from."""

    @abc.abstractmethod
    def vector_field(self, state: State) -> State:
        """Time derivative of the state during a stride."""

    @abc.abstractmethod
    def contact_force(self, state: State) -> tuple[Scalar, Scalar]:
        """Force (Q_u, Q_v) of the ground on the stance foot, along and normal to the slope.

        `stride` looks at Q_v at the start and at heel strike alone.
        """

    @abc.abstractmethod
    def contact(self, state: State) -> Scalar:
        """Contact coordinate h: zero when both feet are on the slope, rising at heel strike.

        Ahead of the stance foot the swing foot is above the ground where h < 0. A stride looks at
        it at the ends of integration steps, and takes it to turn once at most within one.
        """

    @abc.abstractmethod
    def past_contact(self, state: State) -> Bool[Array, ""]:
        """Whether h > 0 can only grow from here, so that no heel strike follows.

        It spares a falling walker the rest of its fall: an outcome may not depend on it.
        """

    @abc.abstractmethod
    def impact(self, state: State) -> tuple[tuple[Scalar, Scalar], State]:
        """Velocity (u, v) of the trailing foot and the state, legs not yet exchanged, after impact.

        The state is that at heel strike, before the impact.
        """

    @abc.abstractmethod
    def exchange_legs(self, state: State) -> State:
        """The state with the swing leg as the new stance leg."""


def parameter(name: str, value: ArrayLike, *, low: float, high: float) -> Scalar:
    """A walker's parameter as an array, refused where it does not lie between low and high."""
    refusal = f"{name} must be one real number, not {' '.join(repr(value).split())[:60]}"
    try:
        value = jnp.asarray(value)
    except (TypeError, ValueError):
        raise ValueError(refusal) from None
    real = jnp.issubdtype(value.dtype, jnp.number) and jnp.isrealobj(value)
    if value.shape != () or not real:
        raise ValueError(refusal)
    if not jnp.issubdtype(value.dtype, jnp.floating):
        value = value.astype(float)
    if not isinstance(value, Tracer) and not low < value < high:
        raise ValueError(f"{name} must lie between {low:g} and {high:g}, not be {value}")
    return value


class SimplestWalker(Walker):
    """The simplest walking model: a mass at the hip, and feet of vanishing mass.

    Garcia, Chatterjee, Ruina and Coleman (1998); Schwab and Wisse (2001), whose equation numbers
    stand below.

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2. `ValueError` otherwise.
    """

    slope: Scalar

    section: ClassVar = ("theta", "thetadot")

    def __init__(self, slope: ArrayLike):
        self.slope = parameter("slope", slope, low=0.0, high=np.pi / 2)

    def lift(self, x):
        """phi = 2 theta, phidot = (1 - cos 2theta) thetadot, from (22)."""
        theta, thetadot = x[0], x[1]
        return State(theta, 2 * theta, thetadot, (1 - jnp.cos(2 * theta)) * thetadot)

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot])

    def feasible(self, x):
        """0 < theta < pi/4 and thetadot < 0: beyond pi/4 no impact leaves the walker going on."""
        theta, thetadot = x[0], x[1]
        finite = jnp.isfinite(theta) & jnp.isfinite(thetadot)
        return finite & (theta > 0) & (theta < np.pi / 4) & (thetadot < 0)

    def gait_region(self):
        """A strip that shrinks like slope^{1/3}, as gaits do (Garcia and others 1998).

        Its upper edge is where walkers begin to fall backward, thetadot = -2 sin((theta -
        slope) / 2), at its widest.
        """
        slope = float(self.slope)
        widest = min(2 * slope ** (1 / 3), np.pi / 4)
        edge = widest - 2 * np.sin((widest - slope) / 2)
        return Grid.sheared(theta=(0, widest, 100), sum=(-0.15 * widest, edge, 1000))

    def vector_field(self, state):
        """(7): thetaddot = sin(theta - slope), an inverted pendulum that the swing leg follows."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) + thetaddot
        return State(thetadot, phidot, thetaddot, phiddot)

    def contact_force(self, state):
        """(8). Over a stride Q_v > 0 if it is at both its ends.

        For thetadot^2 / 2 + cos(theta - slope) is some constant E, and Q_v has the sign of
        3 cos(theta - slope) - 2 E, which is least at one end of any interval of theta.
        """
        tension = state.thetadot**2 - jnp.cos(state.theta - self.slope)
        return jnp.sin(state.theta) * tension, -jnp.cos(state.theta) * tension

    def contact(self, state):
        """h = phi - 2 theta: the legs are of one length."""
        return state.phi - 2 * state.theta

    def past_contact(self, state):
        """h > 0 and rising, the swing leg ahead, the stance leg in compression.

        Then h'' = sin(phi) (thetadot^2 - cos(theta - slope)) - sin(theta - slope) > 0: both terms
        are, and h goes on rising. It is too late to come down again once this has ended, by
        tension or with phi > 0: an experience (tests), not a theorem.
        """
        theta, phi, thetadot, phidot = state
        rising = (phi > 2 * theta) & (phidot > 2 * thetadot)
        return rising & (phi < 0) & (thetadot**2 < jnp.cos(theta - self.slope))

    def impact(self, state):
        """(18), at phi = 2 theta."""
        theta, phi, thetadot, _ = state
        c, s = jnp.cos(2 * theta), jnp.sin(2 * theta)
        foot = -jnp.sin(theta) * c * s * thetadot, jnp.cos(theta) * c * s * thetadot
        return foot, State(theta, phi, c**2 * thetadot, c * (c - 1) * thetadot)

    def impulse(self, state):
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (19).

        It is along the swing leg, as the paper says below (19), and changes the momentum of the
        hip to that after the impact: so rho_x has the sign of sin(theta) thetadot sin(2 theta),
        not the opposite one that is printed there.
        """
        s = jnp.sin(2 * state.theta) * state.thetadot
        return jnp.sin(state.theta) * s, jnp.cos(state.theta) * s

    def exchange_legs(self, state):
        """(21), and its time derivative: (22) follows."""
        theta, phi, thetadot, phidot = state
        return State(theta - phi, -phi, thetadot - phidot, -phidot)
