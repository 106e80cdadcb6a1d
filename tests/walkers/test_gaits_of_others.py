"""Gaits that others found, and the rimless wheel."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import composite, newton, strides
from planar_walkers import FINITE, PUBLISHED

import walker_jax as wj
from walker_jax import Outcome, PointFootWalker, RoundFootWalker, State, multibody
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.walkers.parameters import parameters

# Gaits that others found


def test_the_reference_gait_on_round_feet():
    """There the leg's length is that to the arc's centre."""
    value = FINITE["round feet"]
    names = [parameter.name for parameter in parameters(RoundFootWalker)]
    settings = {name: value[name] for name in names}
    settings["leg_length"] += settings["foot_radius"]
    state = value["state"]
    expected = [state["theta"], state["thetadot"], state["phidot"]]
    walker = RoundFootWalker(**settings)
    (x,), multipliers = newton(walker, expected)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9)
    assert state["phi"] == pytest.approx(float(walker.lift(jnp.array(x)).phi), abs=1e-9)
    known = np.array(value["multipliers"]) @ [1, 1j]
    np.testing.assert_allclose(multipliers, known, rtol=0, atol=1e-5)
    time = strides([walker], [expected]).time[0]
    assert time == pytest.approx(value["step_time"], abs=1e-9)


@pytest.mark.slow
def test_the_reference_gait_on_point_feet():
    """With a hip of 1000 times the mass of a foot."""
    value = FINITE["point feet"]
    walker = PointFootWalker(value["slope"], value["leg_mass"] / value["hip_mass"])
    state = value["state"]
    gait = wj.find_gait(walker, [state["theta"], state["thetadot"]])
    assert gait.found and gait.stable
    full = walker.lift(jnp.asarray(gait.states[0]))
    np.testing.assert_allclose(full, [state[key] for key in State._fields], rtol=0, atol=1e-9)


def published_walker(entry, slope=None):
    if slope is None:
        slope = entry["slope"] if "slope" in entry else np.deg2rad(entry["slope_degrees"])
    return RoundFootWalker(slope=slope, **PUBLISHED["walkers"][entry["walker"]])


def on_section(entry, slope):
    """Of the published state; the leg is of length 1, so times are in 1 / sqrt(gravity)."""
    state, unit = entry["state"], np.sqrt(entry["gravity"])
    tilt = slope if entry["convention"] == "vertical" else 0.0
    theta, thetadot = state["stance"] + tilt, state["stance_rate"]
    if entry["convention"] == "relative":
        return np.array([theta, thetadot / unit, -state["relative_rate"] / unit])
    assert state["swing"] + tilt == pytest.approx(-theta, abs=entry["accuracy"])
    return np.array([theta, thetadot / unit, (thetadot - state["swing_rate"]) / unit])


@pytest.mark.parametrize("entry", PUBLISHED["gaits"], ids=lambda entry: entry["name"])
def test_published_gaits(entry):
    """States to what is printed of them, or where that is more, to what they repeat themselves."""
    walker = published_walker(entry)
    printed = on_section(entry, float(walker.slope))
    period, unit = entry["period"], np.sqrt(entry["gravity"])
    (x,), multipliers = newton(walker, printed, period, step=1e-5 if period > 1 else 1e-4)
    np.testing.assert_allclose(x, printed, rtol=0, atol=entry["accuracy"])
    assert np.abs(multipliers[0]) < 1
    for fewer in range(1, period):
        after, _ = composite([walker], x[None], fewer)
        assert np.abs(after - x).max() > 1e-4
    ends, time = composite([walker], x[None], period)
    np.testing.assert_allclose(ends[0], x, rtol=0, atol=1e-11)
    if "multipliers" in entry:
        known = np.array(entry["multipliers"]) @ [1, 1j]
        np.testing.assert_allclose(multipliers, known, rtol=0, atol=2e-4)
        assert time[0] / unit == pytest.approx(entry["step_time"], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("slope, radius, size", [(0.07, 0.25, 0.547), (0.09, 0.4, 0.534)])
def test_gaits_on_large_feet_are_found_without_a_guess(slope, radius, size):
    """Legs like those of the default walker with knees: its largest multiplier follows from a
    branch over the radius (docs/results.md)."""
    legs = {"leg_mass": 1.1, "leg_inertia": 0.09 / 11, "com_from_hip": 0.3875 / 1.1}
    walker = RoundFootWalker(slope, **legs, foot_radius=radius)
    gait = wj.find_gait(walker)
    assert gait.found and gait.stable
    first = walker.gait_region()  # where it is looked for at first
    assert not first.contains(np.asarray(gait.states)).any()
    assert np.abs(gait.multipliers).max() == pytest.approx(size, abs=5e-4)


@pytest.mark.parametrize(
    ("slope", "radius", "state"),
    [
        (0.02, 0.75, [0.8713, -0.74, -0.3896]),
        (0.09, 0.6, [0.9934, -0.8114, -0.8536]),
        (0.15, 0.6, [1.3768, -0.9814, -1.2519]),
    ],
)
def test_the_further_region_holds_the_long_steps_of_large_feet(slope, radius, state):
    """States of attractors that direct iteration finds over the whole section."""
    walker = RoundFootWalker(slope, foot_radius=radius)
    states, multipliers = newton(walker, state)
    assert np.abs(multipliers).max() < 1 and np.abs(states - np.array(state)).max() < 1e-3
    assert walker.further_gait_region().contains(states).all()


def test_mcgeers_totter_mode_is_unstable_on_point_feet_alone():
    """For steps of the same length."""
    read, leg = PUBLISHED["totter_mode"], PUBLISHED["walkers"]["McGeer"]
    cases = {0.3: (0.02785469, -0.11384), 0.12: (0.0528190, -0.16691), 0.0: (0.0778149, -0.20775)}
    sizes = []
    for radius, (slope, phidot) in cases.items():
        walker = RoundFootWalker(slope=slope, **(leg | {"foot_radius": radius}))
        (x,), multipliers = newton(walker, [0.3, -0.39 + 0.05 * (0.3 - radius), phidot])
        assert x[0] == pytest.approx(read["theta"], abs=1e-5)
        sizes.append(np.abs(multipliers))
        if radius == read["foot_radius"]:
            _, time = composite([walker], x[None], 1)
            assert (slope, time[0]) == pytest.approx((read["slope"], read["step_time"]), rel=0.1)
    assert sizes[0][0] < 0.5 < sizes[1][0] < 1 < 2.5 < sizes[2][0]  # the totter mode
    assert np.max(sizes, axis=0)[1] < 0.4  # the others


def compass_multipliers(degrees, state, period):
    entry = PUBLISHED["gaits"][1]
    walker = published_walker(entry, np.deg2rad(degrees))
    return newton(walker, state, period, step=2e-5)


def doubling(around, state, period):
    """The slope (degrees) at which a gait's multiplier passes -1, by secants."""
    low, high = around
    values = []
    for slope in (low, high):
        (state,), multipliers = compass_multipliers(slope, state, period)
        values.append(multipliers[0].real + 1)
    assert values[0] > 0 > values[1]
    for _ in range(4):
        slope = low + (high - low) * values[0] / (values[0] - values[1])
        (state,), multipliers = compass_multipliers(slope, state, period)
        value = multipliers[0].real + 1
        low, high, values = (
            (slope, high, [value, values[1]]) if value > 0 else (low, slope, [values[0], value])
        )
    return slope


def test_period_doublings_of_the_compass_gait():
    """4.391 degrees, of which Goswami, Thuilot and Espiau (1996) print 4.37; and 4.9."""
    by_name = {entry["name"]: entry for entry in PUBLISHED["gaits"]}
    known = PUBLISHED["compass_gait"]
    entry = by_name["compass gait, 4 deg"]
    first = doubling((4.3, 4.45), on_section(entry, np.deg2rad(4.0)), 1)
    assert first == pytest.approx(known["first_doubling_degrees"], abs=0.03)
    assert first == pytest.approx(4.3909, abs=1e-4)
    entry = by_name["compass gait of period two, 4.75 deg"]
    second = doubling((4.8, 4.95), on_section(entry, np.deg2rad(4.75)), 2)
    assert second == pytest.approx(known["second_doubling_degrees"], abs=0.05)


def test_multipliers_of_the_compass_gait():
    """Printed for two steps, from differences."""
    known, entry = PUBLISHED["compass_gait"], PUBLISHED["gaits"][1]
    slope = known["multipliers_slope_degrees"]
    _, multipliers = compass_multipliers(slope, on_section(entry, np.deg2rad(slope)), 2)
    sizes = known["multiplier_sizes_of_two_steps"]
    np.testing.assert_allclose(np.abs(multipliers), sizes, rtol=0, atol=5e-3)


# A walker of one's own: the rimless wheel


class RimlessWheel(wj.Walker):
    """Spokes of a wheel of mass 1, alpha on either side of the upright: phi stays -2 alpha."""

    slope: jax.Array
    alpha: jax.Array
    inertia: jax.Array
    section: ClassVar = ("thetadot",)

    def system(self):
        """The hub and the wheel's angle, of (u, v, theta, ...)."""

        def transfer(q):
            return jnp.stack([q[0] - jnp.sin(q[2]), q[1] + jnp.cos(q[2]), q[2]])

        mass = jnp.ones_like(self.inertia)
        weight = [jnp.sin(self.slope), -jnp.cos(self.slope), jnp.zeros_like(mass)]
        return System(transfer, jnp.stack([mass, mass, self.inertia]), jnp.stack(weight))

    def motion(self, state):
        """Accelerations and forces with u, v and the spokes held."""

        def solve(wheel, q, qdot):
            return multibody.solve_motion(
                wheel.system(), stance_coordinates(q), stance_coordinates(qdot), held=(0, 1, 3)
            )

        return unroll(solve)(self, list(state[:2]), list(state[2:]))

    def lift(self, x):
        return State(self.alpha, -2 * self.alpha, x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([state.thetadot])

    def feasible(self, x):
        return x[0] < 0

    def gait_region(self):
        return wj.Grid.plain(thetadot=(-1, 0, 50))

    def vector_field(self, state):
        acceleration = self.motion(state).accelerations[2]
        return State(state.thetadot, state.phidot, acceleration, jnp.zeros_like(state.phi))

    def contact_force(self, state):
        forces = self.motion(state).forces
        return forces[0], forces[1]

    def past_contact(self, state):
        return state.phi > 2 * state.theta

    def clearance(self, state):
        return jnp.cos(state.theta) - jnp.cos(state.theta - state.phi)

    def reach(self, state):
        return jnp.sin(state.theta - state.phi) - jnp.sin(state.theta)

    def impact(self, state):
        def spoke(q):
            feet = [jnp.sin(q[2] - state.phi) - jnp.sin(q[2])]
            return q[:2] + jnp.stack([*feet, jnp.cos(q[2]) - jnp.cos(q[2] - state.phi)])

        q, qdot = (stance_coordinates([a, a])[:3] for a in (state.theta, state.thetadot))
        u, v, thetadot = multibody.impact(self.system(), spoke, q, qdot).velocities
        return (u, v), State(state.theta, state.phi, thetadot, jnp.zeros_like(thetadot))


def wheel(slope, alpha, inertia):
    return RimlessWheel(*(jnp.asarray(value, float) for value in (slope, alpha, inertia)))


def test_the_rimless_wheel_has_its_closed_return_map():
    """thetadot -> -eta sqrt(thetadot^2 + 4 sin(alpha) sin(slope) / (1 + I)), from energy and (17).

    eta = (I + cos 2 alpha) / (I + 1); with eta^2 as multiplier everywhere on thetadot^2. Slower
    than the dead point it rolls back, and faster than 1 g holds it flies.
    """
    known = PUBLISHED["rimless_wheel"]
    wheels = {
        "hub": (0.2, np.pi / 8, 0.01),  # of a point alone, nothing keeps the spokes from turning
        "published": (known["slope"], np.pi / known["spokes"], known["inertia"]),
        "rim": (0.1, 0.3, 1.0),
    }
    rates = -np.linspace(0.02, 1.1, 40)
    walkers = [wheel(*values) for values in wheels.values() for _ in rates]
    found = strides(walkers, np.tile(rates, len(wheels))[:, None])
    outcomes = found.outcome.reshape(len(wheels), -1)
    states = found.state.reshape(len(wheels), -1)
    for (slope, alpha, inertia), outcome, state in zip(
        wheels.values(), outcomes, states, strict=True
    ):
        eta, gain = (inertia + np.cos(2 * alpha)) / (inertia + 1), 4 * np.sin(alpha)
        gain *= np.sin(slope) / (1 + inertia)
        expected = -eta * np.sqrt(rates**2 + gain)
        needed = 2 * (1 - np.cos(alpha - slope)) / (1 + inertia)
        np.testing.assert_array_equal(outcome == Outcome.BACKWARD, rates**2 < needed)
        walks = outcome == Outcome.STRIDE
        assert walks.sum() > 8 and set(outcome) == {0, 2, 3}
        np.testing.assert_allclose(state[walks], expected[walks], rtol=1e-11)
        start = np.array([-eta * np.sqrt(gain / (1 - eta**2))])
        (x,), multipliers = newton(wheel(slope, alpha, inertia), start * 1.02)
        np.testing.assert_allclose(x, start, rtol=0, atol=1e-11)
        np.testing.assert_allclose(multipliers, [eta**2], rtol=0, atol=1e-8)
    assert known["multiplier"] == pytest.approx(((0.5 + 0.5) / 1.5) ** 2, abs=1e-15)
    published = strides([wheel(*wheels["published"])], [[known["thetadot"]]])
    assert published.state[0, 0] == pytest.approx(known["thetadot"], abs=1e-12)
