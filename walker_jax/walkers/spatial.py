"""The walker in space: two legs on one axle, on discs that roll without slipping."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.checks import WrongUse
from walker_jax.grids import Grid
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.multibody.space import (
    body_coordinates,
    body_masses,
    body_weights,
    material_velocity,
    rotation_about,
)
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import DRIVE, STEP, Scalar, Walker, least_scuff, shown_by
from walker_jax.walkers.parameter_table import (
    ALLOW_SCUFFING,
    COM_FORWARD,
    COM_HEIGHT,
    COM_OUTWARD,
    DISC_RADIUS,
    HIP_WIDTH,
    INERTIA_XX,
    INERTIA_XY,
    INERTIA_XZ,
    INERTIA_YY,
    INERTIA_YZ,
    INERTIA_ZZ,
    LEG_LENGTH,
    SPATIAL_LEG_MASS,
    SPATIAL_SLOPE,
)
from walker_jax.walkers.pictures import DiscPicture
from walker_jax.walkers.rolling_stance import RollingStance, SpatialState, contact_forces

LEAST_STEP = 1e-3
"""Least angle between the legs, in rad, at which a disc that comes down counts as ahead. Below it
the legs are passing each other: for an upright walker both discs touch then."""
GREATEST_LEAN = np.pi / 3
"""Lean at which a walker has fallen sideways (rad)."""

SLICE_YAW, SLICE_LEAN_RATE, SLICE_CELLS = 0.2, 0.04, 100
"""Half widths of a slice in space, of yaw in rad and of the rate of lean for legs of length 1, and
its cells along an axis: they hold the toy's basin there, with a margin."""


class SpatialWalker(Walker):
    """Two rigid legs on one axle that rolls, yaws and leans: a walker in space.

    Each foot is the sharp edge of a disc, normal to the axle, that rolls on the slope without
    slipping; friction is assumed to hold it. Heel strike is the moment when the other disc touches
    the slope; the foot that stood is then free. Coordinates are those of a walker on its left leg;
    every other stride is seen in a mirror. The default is the toy that can walk but cannot stand.
    Feet that are tori are not provided.

    Coleman, Garcia, Mombaur and Ruina (2001).

    **Arguments:** masses in any unit, lengths in any unit L, times then in sqrt(L / gravity).

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `leg_mass`: of each leg, above 0.
    - `leg_length`: from the axle to the sole, above 0.
    - `hip_width`: between the planes of the discs, above 0.
    - `disc_radius`: not negative, and less than the length of the leg.
    - `com_forward`, `com_outward`, `com_height`: a leg's centre of mass, forward of the leg's line,
      out of the plane of its own disc, and above its sole.
    - `inertia_xx` to `inertia_yz`: entries of the left leg's matrix of inertia about its centre of
      mass, in axes forward, to the left and up the leg; xy and yz change sign on the right leg.
    - `allow_scuffing`: whether a disc may pass below the slope before heel strike, as in the plane.
      By default such a stride fails (`SCUFFED`).

    Raises `ValueError` otherwise, and for a matrix of inertia that is not positive definite.
    """

    slope: Scalar = eqx.field(converter=SPATIAL_SLOPE.convert, default=SPATIAL_SLOPE.default)
    leg_mass: Scalar = eqx.field(
        converter=SPATIAL_LEG_MASS.convert, default=SPATIAL_LEG_MASS.default
    )
    leg_length: Scalar = eqx.field(converter=LEG_LENGTH.convert, default=LEG_LENGTH.default)
    hip_width: Scalar = eqx.field(converter=HIP_WIDTH.convert, default=HIP_WIDTH.default)
    disc_radius: Scalar = eqx.field(converter=DISC_RADIUS.convert, default=DISC_RADIUS.default)
    com_forward: Scalar = eqx.field(converter=COM_FORWARD.convert, default=COM_FORWARD.default)
    com_outward: Scalar = eqx.field(converter=COM_OUTWARD.convert, default=COM_OUTWARD.default)
    com_height: Scalar = eqx.field(converter=COM_HEIGHT.convert, default=COM_HEIGHT.default)
    inertia_xx: Scalar = eqx.field(converter=INERTIA_XX.convert, default=INERTIA_XX.default)
    inertia_yy: Scalar = eqx.field(converter=INERTIA_YY.convert, default=INERTIA_YY.default)
    inertia_zz: Scalar = eqx.field(converter=INERTIA_ZZ.convert, default=INERTIA_ZZ.default)
    inertia_xy: Scalar = eqx.field(converter=INERTIA_XY.convert, default=INERTIA_XY.default)
    inertia_xz: Scalar = eqx.field(converter=INERTIA_XZ.convert, default=INERTIA_XZ.default)
    inertia_yz: Scalar = eqx.field(converter=INERTIA_YZ.convert, default=INERTIA_YZ.default)
    allow_scuffing: bool = eqx.field(static=True, converter=ALLOW_SCUFFING.convert, default=False)

    section: ClassVar = ("yaw", "theta", "phi", "yawdot", "leandot", "thetadot", "phidot")
    state: ClassVar = SpatialState

    def __check_init__(self):
        values = self.disc_radius, self.leg_length, *self.inertia_entries()
        if any(isinstance(value, Tracer) or np.shape(value) for value in values):
            return
        radius, length = float(self.disc_radius), float(self.leg_length)
        if radius >= length:
            raise WrongUse(
                f"disc_radius must be less than leg_length {length:g}, not {radius:g}",
                of="disc_radius leg_length",
            )
        inertia = np.asarray(self.inertia(1.0))
        if not (np.linalg.eigvalsh(inertia) > 0).all():
            raise WrongUse(
                "inertia_xx to inertia_yz must make a positive definite matrix, not "
                f"{inertia.tolist()}",
                of="inertia_xx inertia_yz",
            )

    def inertia_entries(self) -> tuple[Scalar, ...]:
        """xx, yy, zz, xy, xz, yz."""
        diagonal = self.inertia_xx, self.inertia_yy, self.inertia_zz
        return *diagonal, self.inertia_xy, self.inertia_xz, self.inertia_yz

    def inertia(self, side: float) -> Float[Array, "3 3"]:
        """Return the matrix of inertia of the left leg, side 1, or of the right, side -1."""
        xx, yy, zz, xy, xz, yz = self.inertia_entries()
        xy, yz = side * xy, side * yz
        rows = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
        return jnp.stack([jnp.stack(row) for row in rows])

    # Places of the legs for q = (x, y, z, yaw, lean, theta, phi): (x, y, z) is below the stance
    # disc's centre, at its lowest point.

    def axle(self, q: Float[Array, " 7"]) -> Float[Array, "3 3"]:
        """Return the frame of the axle: directions forward, along the axle to the left, and up."""
        return rotation_about(2, q[3]) @ rotation_about(0, q[4])

    def rotation(self, q: Float[Array, " 7"], swing: bool) -> Float[Array, "3 3"]:
        """Return the frame of a leg, the stance leg's or the swing leg's."""
        return self.axle(q) @ rotation_about(1, q[6] - q[5] if swing else -q[5])

    def disc(self, q: Float[Array, " 7"], swing: bool) -> Float[Array, " 3"]:
        """Return the centre of a disc."""
        axle, shank = self.axle(q), self.leg_length - self.disc_radius
        stance = q[:3] + self.disc_radius * axle[:, 2]
        if not swing:
            return stance
        hip = stance + shank * self.rotation(q, False)[:, 2] - self.hip_width * axle[:, 1]
        return hip - shank * self.rotation(q, True)[:, 2]

    def sole(self, q: Float[Array, " 7"], swing: bool) -> Float[Array, " 3"]:
        """Return the lowest point of a disc, where it touches the slope."""
        return self.disc(q, swing) - self.disc_radius * self.axle(q)[:, 2]

    def centre_of_mass(self, q: Float[Array, " 7"], swing: bool) -> Float[Array, " 3"]:
        """Return the centre of mass of a leg."""
        outward = -self.com_outward if swing else self.com_outward
        place = jnp.stack([self.com_forward, outward, self.com_height - self.disc_radius])
        return self.disc(q, swing) + self.rotation(q, swing) @ place

    def system(self) -> System:
        """Return the system of both legs, for all seven coordinates."""

        def transfer(q):
            legs = [(self.centre_of_mass(q, one), self.rotation(q, one)) for one in (False, True)]
            return jnp.concatenate([body_coordinates(*leg) for leg in legs])

        masses = [self.leg_mass] * 2
        zero = jnp.zeros_like(self.slope)
        down = jnp.stack([jnp.sin(self.slope), zero, -jnp.cos(self.slope)])
        inertias = [self.inertia(1.0), self.inertia(-1.0)]
        return System(transfer, body_masses(masses, inertias), body_weights(masses, down))

    def contact_velocity(
        self, q: Float[Array, " 7"], qdot: Float[Array, " 7"], swing: bool
    ) -> Float[Array, " 3"]:
        """Return the velocity of a disc's point at its sole: zero if it rolls without slipping."""
        place = lambda function: lambda q: function(q, swing)
        places = place(self.disc), place(self.rotation), place(self.sole)
        return material_velocity(*places, q, qdot)

    # A stride

    def lift(self, x):
        """Lean so that both discs touch the slope, with the stance disc at the origin."""
        yaw, theta, phi, yawdot, leandot, thetadot, phidot = x
        zero, shank = jnp.zeros_like(yaw), self.leg_length - self.disc_radius
        higher = 2 * shank * jnp.sin(phi / 2 - theta) * jnp.sin(phi / 2)
        lean = jnp.arctan(higher / self.hip_width)
        return SpatialState(zero, zero, yaw, lean, theta, phi, yawdot, leandot, thetadot, phidot)

    def project(self, state: Any):
        return jnp.stack([getattr(state, name) for name in self.section])

    def feasible(self, x):
        """Legs apart and above the slope, the swing disc behind and lifting."""
        _, theta, phi, *_ = x
        start = self.lift(x)
        q, qdot = all_coordinates(self, start)
        upright = (jnp.abs(theta) < np.pi / 2) & (jnp.abs(theta - phi) < np.pi / 2)
        _, rising = jax.jvp(lambda q: self.sole(q, True)[2], (q,), (qdot,))
        finite = jnp.isfinite(x).all()
        return finite & upright & (phi > LEAST_STEP) & (rising > 0)

    @shown_by(*STEP)
    def gait_region(self):
        """Steps like those of the toy: legs about as far ahead as behind, the swing leg ahead of
        the axle's turn. Rates are in units of a pendulum of the leg's length."""
        rate = 1 / float(np.sqrt(self.leg_length))
        axes = {
            "yaw": (0.0, 0.24, 3),
            "theta": (0.08, 0.32, 3),
            "split": (-0.04, 0.04, 1),
            "yawdot": (-0.6, 0.0, 3),
            "leandot": (-0.1, 0.1, 1),
            "thetadot": (-0.95, -0.15, 4),
            "phidot": (-1.2, 0.0, 4),
        }
        shear = np.diag([1.0, 1.0, 1.0, rate, rate, rate, rate])
        shear[2, 1] = 2.0
        return Grid(axes, shear)

    def vector_field(self, state: Any):
        return RollingStance(self)(state)

    def equations(self):
        own = type(self).vector_field is not SpatialWalker.vector_field
        return self.vector_field if own else RollingStance(self)

    def modes(self):
        """One mode, the swing; the disc touches the slope as it begins and ends."""
        modes = super().modes()
        if type(self).conditions is not SpatialWalker.conditions:
            return modes
        scuffs = Outcome.SCUFFED.name
        swing = modes["swing"]
        *falls, strike = swing.guards
        guards = *falls, strike._replace(makes_zero=(scuffs,))
        touches = lambda one: one._replace(zero_at_start=one.leads_to == scuffs)
        conditions = tuple(map(touches, swing.conditions))
        return {"swing": swing._replace(guards=guards, conditions=conditions)}

    def unit_of_time(self):
        return jnp.sqrt(self.leg_length)

    def contact_force(self, state: Any):
        """Forces of the general method, dual to x and z, that hold the stance foot."""
        along, normal = contact_forces(self, state)
        return along, normal

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        return True

    def energy(self, state: Any) -> Scalar:
        """Kinetic energy, and potential energy of gravity."""
        q, qdot = all_coordinates(self, state)
        system = self.system()
        return multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)

    def impact(self, state: Any):
        """(17): the new foot's disc sticks to the slope, and the old one is free."""
        rates = rates_after_impact(self, state)
        forward, up, *angles = rates
        after = state._replace(**dict(zip(SpatialState._fields[6:], angles, strict=True)))
        return (forward, up), after

    def contact(self, state: Any):
        """Minus the height of the swing disc."""
        return -self.clearance(state)

    def clearance(self, state: Any):
        return sole_of(self, state)[2]

    def reach(self, state: Any):
        """Distance down the slope, from the stance disc's first place to the swing disc's sole."""
        return state.x + sole_of(self, state)[0]

    def conditions(self):
        if self.allow_scuffing:
            return {}
        least = least_scuff(self.leg_length)
        return {"SCUFFED": lambda state: self.clearance(state) + least}

    def picture(self):
        return DiscPicture(self)

    def step_length(self, x, end):
        """How far a disc rolls depends on the whole stride."""
        return self.reach(end())

    def basin_region(self, gait):
        """A slice around a gait over yaw and rate of lean: walkers turned, and pushed sideways."""
        if (state := gait()) is None:
            return None
        point = dict(zip(self.section, map(float, np.asarray(state)), strict=True))
        around = lambda name, half: (point[name] - half, point[name] + half, SLICE_CELLS)
        rate = float(np.sqrt(self.leg_length))
        yaw, leandot = around("yaw", SLICE_YAW), around("leandot", SLICE_LEAN_RATE / rate)
        return Grid.through(point, yaw=yaw, leandot=leandot)

    def is_ahead(self, state: Any):
        return -LEAST_STEP - state.phi

    def falls(self, state: Any):
        """Guards of falls of the axle and of the stance leg; near zero their values are angles."""
        return {
            "SIDEWAYS": (state.lean**2 - GREATEST_LEAN**2) / (2 * GREATEST_LEAN),
            "BACKWARD": state.theta - np.pi / 2,
            "FORWARD": -np.pi / 2 - state.theta,
        }

    def exchange_legs(self, state: Any):
        """Seen in a mirror, so that the new stance leg is the left one."""
        _, _, yaw, lean, theta, phi, yawdot, leandot, thetadot, phidot = state
        zero = jnp.zeros_like(yaw)
        angles = -yaw, -lean, theta - phi, -phi
        return SpatialState(zero, zero, *angles, -yawdot, -leandot, thetadot - phidot, -phidot)


def on_ground(q: Float[Array, " 6"]) -> Float[Array, " 7"]:
    """Add z to the coordinates of a walker on its stance disc; or to their rates."""
    return jnp.concatenate([q[:2], jnp.zeros_like(q[:1]), q[2:]])


def all_coordinates(
    walker: SpatialWalker, state: Any
) -> tuple[Float[Array, " 7"], Float[Array, " 7"]]:
    """Return q and its rates, for a state."""
    q, u = list(state[:6]), list(state[6:])
    return on_ground(jnp.stack(q)), on_ground(jnp.stack(RollingStance(walker).rates(q, u)))


@jax.jit
def sole_of(walker: SpatialWalker, state: Any) -> list[Scalar]:
    """Return the swing disc's sole, relative to the stance disc's."""

    def flat(walker, angles):
        zero = jnp.zeros_like(angles[0])
        return list(walker.sole(jnp.stack([zero, zero, zero, *angles]), True))

    return unroll(flat)(walker, list(state[2:6]))


@jax.jit
def rates_after_impact(walker: SpatialWalker, state: Any) -> list[Scalar]:
    """Return rates after the swing disc sticks: of the old sole forward and up, and u."""

    def flat(walker, state):
        q, qdot = all_coordinates(walker, state)
        made = lambda q, qdot: walker.contact_velocity(q, qdot, swing=True)
        after = multibody.impact(walker.system(), None, q, qdot, constraints=made).velocities
        slides = walker.contact_velocity(q, after, swing=False)
        return [slides[0], after[2], *after[3:]]

    return unroll(flat)(walker, state)
