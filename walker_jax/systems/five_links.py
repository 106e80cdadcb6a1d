"""A robot of five links on point feet, without its control."""

import abc
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.multibody.single_support import coordinates_and_rates
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

LINKS = "stance_shank", "stance_thigh", "torso", "swing_thigh", "swing_shank"


class LinkState(NamedTuple):
    """Angles (rad) of `LINKS`, in that order, from the vertical, positive forward; their rates."""

    angles: tuple[Scalar, ...]
    rates: tuple[Scalar, ...]


class AbstractFiveLinkRobot(HybridSystem):
    """Torso, thighs and shanks on point feet: the links of the robot RABBIT.

    The links are rigid bodies with absolute angles q = (q_1, ..., q_5) of stance shank, stance
    thigh, torso, swing thigh and swing shank, from the vertical, positive forward. On the stance
    foot, which is pinned,

        M(q) q'' + C(q, q') q' + G(q) = B u.

    Subclasses define their control by `motors`, `modes` and `gait_region`. `SingleSupport` of a
    robot is the vector field of a mode, and `strike` the reset when the swing foot comes down.

    Lengths, masses and inertias are those of Westervelt, Grizzle and Koditschek (2003), Hybrid zero
    dynamics of planar biped walkers, IEEE Transactions on Automatic Control 48, 42-56, and
    Chevallereau et al. (2003), RABBIT: a testbed for advanced control theory, IEEE Control Systems
    Magazine 23, 57-79. Units are m, kg and s.
    """

    section = (*LINKS[:4], *(f"{link}_rate" for link in LINKS))

    torso_mass: Real = Parameter("torso_mass", "of the torso", "kg", 20.0).field()
    thigh_mass: Real = Parameter("thigh_mass", "of a thigh", "kg", 6.8).field()
    shank_mass: Real = Parameter("shank_mass", "of a shank", "kg", 3.2).field()
    torso_inertia: Real = Parameter("torso_inertia", "of the torso", "kg m^2", 2.22).field()
    thigh_inertia: Real = Parameter("thigh_inertia", "of a thigh", "kg m^2", 1.08).field()
    shank_inertia: Real = Parameter("shank_inertia", "of a shank", "kg m^2", 0.93).field()
    torso_centre: Real = Parameter("torso_centre", "from the hip", "m", 0.2, -np.inf).field()
    thigh_centre: Real = Parameter("thigh_centre", "from the hip", "m", 0.163, -np.inf).field()
    shank_centre: Real = Parameter("shank_centre", "from the knee", "m", 0.128, -np.inf).field()
    segment: Real = Parameter("segment", "length of a thigh, and of a shank", "m", 0.4).field()
    gravity: Real = Parameter("gravity", "of free fall", "m/s^2", 9.81, closed=True).field()

    def places(self, q: Float[Array, " 7"]) -> tuple[Float[Array, "2 5"], Float[Array, "2 2"]]:
        """Return the centres of mass of the links, and the hip and swing foot: distances, heights.

        Coordinates are the position of the stance foot and the angles.
        """
        ways = jnp.stack([jnp.sin(q[2:]), jnp.cos(q[2:])])
        links = self.segment * ways
        knee = q[:2, None] + links[:, :1]
        hip = knee + links[:, 1:2]
        swing_foot = hip - links[:, 3:4] - links[:, 4:]
        from_joint = [-self.shank_centre, -self.thigh_centre, self.torso_centre]
        from_joint += [-self.thigh_centre, self.segment - self.shank_centre]
        joints = jnp.concatenate([knee, hip, hip, hip, swing_foot], axis=1)
        return joints + jnp.stack(from_joint) * ways, jnp.concatenate([hip, swing_foot], axis=1)

    def system(self) -> multibody.System:
        """Return the system of the links, in the coordinates of `places`."""
        masses = [self.shank_mass, self.thigh_mass, self.torso_mass]
        inertias = [self.shank_inertia, self.thigh_inertia, self.torso_inertia]
        masses, inertias = (jnp.stack([*one, *one[1::-1]]) for one in (masses, inertias))
        transfer = lambda q: jnp.concatenate([*self.places(q)[0], q[2:]])
        forces = jnp.concatenate([0 * masses, -self.gravity * masses, 0 * masses])
        every = jnp.concatenate([masses, masses, inertias])
        return multibody.System(transfer, every, forces, self.motors)

    @abc.abstractmethod
    def motors(self, q: Float[Array, " 7"], qdot: Float[Array, " 7"]) -> Float[Array, " 7"]:
        """Return the generalised forces of the motors, dual to the coordinates of `places`."""

    def strike(self, state: LinkState) -> LinkState:
        """Return the state after the impact of the swing foot, the next stance foot."""
        foot = lambda q: self.places(q)[1][:, 1]
        after = multibody.impact(self.system(), foot, *coordinates_and_rates(state)).velocities
        return LinkState(state.angles[::-1], tuple(after[:1:-1]))

    def feasible(self, x):
        """The swing foot can reach the ground, behind its knee."""
        return jnp.all(jnp.isfinite(x)) & (jnp.abs(cosine_of_swing_shank(x)) < 1)

    def lift(self, x):
        swing_shank = jnp.arccos(cosine_of_swing_shank(x))
        return LinkState((*x[:4], swing_shank), tuple(x[4:]))

    def project(self, state):
        return jnp.stack([*state.angles[:4], *state.rates])


def cosine_of_swing_shank(x: Float[Array, " 9"]) -> Scalar:
    """Return the cosine of the swing shank's angle, with both feet on the ground."""
    return jnp.cos(x[0]) + jnp.cos(x[1]) - jnp.cos(x[3])
