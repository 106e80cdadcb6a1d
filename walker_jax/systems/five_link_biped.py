"""A biped with knees and a torso, whose motors follow virtual constraints."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.grids import Grid
from walker_jax.hybrid.modes import Condition, Guard, Mode
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.multibody.single_support import (
    SingleSupport,
    accelerations_and_forces,
    coordinates_and_rates,
)
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.parameter import Parameter

LINKS = "stance_shank", "stance_thigh", "torso", "swing_thigh", "swing_shank"
LEAST_SCUFF = 1e-6
"""Depth (m) from which on the foot is below the ground: less is rounding, where it touches."""


class LinkState(NamedTuple):
    """Angles of the five links from the vertical, positive forward, and their rates; as `LINKS`."""

    angles: tuple[Scalar, ...]
    rates: tuple[Scalar, ...]


class FiveLinkBiped(HybridSystem):
    """Torso, thighs and shanks on point feet, on level ground: the robot RABBIT.

    The links are rigid bodies with absolute angles q = (q_1, ..., q_5) of stance shank, stance
    thigh, torso, swing thigh and swing shank, from the vertical, positive forward. On the stance
    foot, which is pinned,

        M(q) q'' + C(q, q') q' + G(q) = B u,

    with motors in both knees and between the torso and each thigh, but none at the foot. They
    enforce four virtual constraints by springs and dampers, u = -(k y + c y'), that depend on the
    angle of the stance leg, from foot to hip, theta = (q_1 + q_2) / 2:

        y_1 = q_1 - q_2 - bend                                          stance knee
        y_2 = q_3 - lean                                                torso
        y_3 = (q_4 + q_5) / 2 + theta                                   swing leg, the mirror image
        y_4 = q_5 - q_4 - bend - swing_bend (1 - theta^2 / reach^2)     swing knee

    u_1 and u_4 turn the knees, and u_3 the swing thigh against the torso. The motor at the stance
    hip takes up the reaction of u_3, so u_2 is the whole torque on the torso. A stride ends where
    the swing foot comes down in front of the other. That it does without bouncing or slipping, as
    the other foot comes off, and the legs change roles. Energy that the impact takes is put back by
    the motors.

    The section is just after that, with both feet on the ground: the angles of the links but for
    the swing shank, which follows from them, and all rates. Failures are `FORWARD`, where the hip
    comes down to the ground; `BACKWARD`, where the stance leg stops, so that theta is no measure of
    progress any more; `RUNNING`, where the ground would have to pull; and `SCUFFED`, where the
    swing foot is below the ground on its way, from the start on if it does not lift; and `OUTSIDE`
    too where the foot comes down while the stance shank leans back, which the section does not
    hold. Knees have no stops, and nothing slips: in the gait the ground needs a coefficient of
    friction of 0.3, and of 0.6 in the impact.

    Lengths, masses and inertias are those of RABBIT: Westervelt, Grizzle and Koditschek (2003),
    Hybrid zero dynamics of planar biped walkers, IEEE Transactions on Automatic Control 48, 42-56;
    Chevallereau et al. (2003), RABBIT: a testbed for advanced control theory, IEEE Control Systems
    Magazine 23, 57-79. There the constraints are Bezier polynomials of theta, and the control
    keeps them exactly in theory. Units are m, kg and s.
    """

    section = (*LINKS[:4], *(f"{link}_rate" for link in LINKS))

    lean: Real = Parameter("lean", "of the torso, from the vertical", "rad", 0.15, -np.inf).field()
    bend: Real = Parameter("bend", "of the stance knee", "rad", 0.2, -np.inf).field()
    swing_bend: Real = Parameter(
        "swing_bend", "more of the swing knee", "rad", 0.6, -np.inf
    ).field()
    reach: Real = Parameter("reach", "of the stance leg", "rad", 0.3).field()
    stiffness: Real = Parameter("stiffness", "of motors", "N m/rad", 400.0, closed=True).field()
    damping: Real = Parameter("damping", "of motors", "N m s/rad", 40.0, closed=True).field()
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
        """Centres of mass of the links; hip and swing foot: along the ground, and heights.

        Coordinates are the place of the stance foot and the angles.
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
        """The links, of the coordinates of `places`."""
        masses = [self.shank_mass, self.thigh_mass, self.torso_mass]
        inertias = [self.shank_inertia, self.thigh_inertia, self.torso_inertia]
        masses, inertias = (jnp.stack([*one, *one[1::-1]]) for one in (masses, inertias))
        transfer = lambda q: jnp.concatenate([*self.places(q)[0], q[2:]])
        forces = jnp.concatenate([0 * masses, -self.gravity * masses, 0 * masses])
        every = jnp.concatenate([masses, masses, inertias])
        return multibody.System(transfer, every, forces, self.motors)

    def motors(self, q: Float[Array, " 7"], qdot: Float[Array, " 7"]) -> Float[Array, " 7"]:
        """Torques on the links; none on the foot."""

        def outputs(q):
            shank, thigh, torso, swing_thigh, swing_shank = q[2:]
            theta = (shank + thigh) / 2
            swung = self.swing_bend * (1 - (theta / self.reach) ** 2)
            legs, bend = theta + (swing_thigh + swing_shank) / 2, swing_shank - swing_thigh
            return jnp.stack(
                [shank - thigh - self.bend, torso - self.lean, legs, bend - self.bend - swung]
            )

        y, rates = jax.jvp(outputs, (q,), (qdot,))
        knee, torso, leg, swing_knee = -self.stiffness * y - self.damping * rates
        torques = [knee, -knee - torso - leg, torso, leg - swing_knee, swing_knee]
        return jnp.stack([0 * knee, 0 * knee, *torques])

    def strike(self, state: LinkState) -> LinkState:
        """The state after the impact of the swing foot, which is the stance foot from then on."""
        foot = lambda q: self.places(q)[1][:, 1]
        after = multibody.impact(self.system(), foot, *coordinates_and_rates(state)).velocities
        return LinkState(state.angles[::-1], tuple(after[:1:-1]))

    def modes(self):
        hip_and_foot = lambda state: self.places(coordinates_and_rates(state)[0])[1]
        ahead = lambda state: hip_and_foot(state)[0, 1]
        sunk = lambda state: -hip_and_foot(state)[1, 1]
        guards = (
            Guard(lambda state: -hip_and_foot(state)[1, 0], Outcome.FORWARD),
            Guard(lambda state: -state.rates[0] - state.rates[1], Outcome.BACKWARD, at_once=True),
            Guard(sunk, Outcome.OUTSIDE, (ahead, lambda state: -state.angles[0])),
            Guard(sunk, admits=(ahead, lambda state: state.angles[0])),
        )
        carried = lambda state: accelerations_and_forces(self, state)[1][1]
        above = lambda state: LEAST_SCUFF - sunk(state)
        conditions = (
            Condition(carried, Outcome.RUNNING),
            Condition(above, Outcome.SCUFFED, zero_at_ends=(True, True)),
        )
        return (Mode(SingleSupport(self), guards, conditions, self.strike, as_smooth=True),)

    def feasible(self, x):
        """Where the swing foot can reach the ground, behind its knee."""
        return jnp.all(jnp.isfinite(x)) & (jnp.abs(cosine_of_swing_shank(x)) < 1)

    def lift(self, x):
        swing_shank = jnp.arccos(cosine_of_swing_shank(x))
        return LinkState((*x[:4], swing_shank), tuple(x[4:]))

    def project(self, state):
        return jnp.stack([*state.angles[:4], *state.rates])

    def gait_region(self):
        """Legs about as the constraints want them, at some speeds, to which all rates belong."""
        theta, half = -0.85 * float(self.reach), float(self.bend) / 2
        posture = theta + half, theta - half, float(self.lean), -theta - half
        axes = {link: (at - 0.4, at + 0.4, 1) for link, at in zip(LINKS[:4], posture, strict=True)}
        axes |= {f"{link}_excess": (-1.5, 1.5, 1) for link in LINKS}
        axes["stance_thigh_excess"] = 0.5, 2.9, 8
        shear = np.eye(9)
        shear[4:, 5] = 0.35, 1.0, 0.35, 0.6, 0.9
        return Grid(axes, shear)


def cosine_of_swing_shank(x: Float[Array, " 9"]) -> Scalar:
    """With both feet on the ground."""
    return jnp.cos(x[0]) + jnp.cos(x[1]) - jnp.cos(x[3])
