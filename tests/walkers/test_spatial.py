"""The walker in space: its equations, one stride, its gait, and what follows from them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_measures import all_measures
from by_differences import differences
from kane import SIZES, Toy
from PIL import Image, ImageSequence
from reference import read_values

import walker_jax as wj
from walker_jax import figures, multibody
from walker_jax.kernels import kernel
from walker_jax.multibody import ConstrainedMotion, System, space
from walker_jax.storage.schema import KINDS, check_dataset
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.spatial import all_coordinates, on_ground

TOY = read_values("toy_in_space")
WALKER = wj.SpatialWalker()
FIELDS = ["slope", "leg_mass", "leg_length", "hip_width", "disc_radius", "com_forward"]
FIELDS += ["com_outward", "com_height"]
ENTRIES = ["inertia_xx", "inertia_yy", "inertia_zz", "inertia_xy", "inertia_xz", "inertia_yz"]
MIRROR = np.array([1, -1, 1, 1, 1, -1, 1.0])
"""From published coordinates, in which the leg's pitch grows, to those of the walker."""
OTHER = wj.SpatialWalker(0.05, 1.4, 0.9, 0.3, 0.2, 0.04, 0.5, 0.4, 0.2, 0.15, 0.1, 0.01, 0.02, 0.03)


def sizes_of(walker) -> dict[str, float]:
    sizes = (float(getattr(walker, name)) for name in FIELDS + ENTRIES)
    return dict(zip(map(str, SIZES.split()), sizes, strict=True))


def published():
    """The gait, as a point of the section."""
    gait = TOY["gait"]
    free = [gait["yaw"], gait["stance_pitch"], gait["swing_angle"] - np.pi, gait["yaw_rate"]]
    free += [gait["lean_rate"], gait["stance_pitch_rate"], gait["swing_rate"]]
    return MIRROR * free


def states(seed, count=10):
    """Full states of walkers about to step, of any yaw and lean."""
    rng = np.random.default_rng(seed)
    low = np.array([-1, -1, -2, -0.5, -0.4, -0.6, -1, -1, -1, -1.0])
    return rng.uniform(low, -low, (count, 10))


def in_kanes_order(toy, state):
    """Of a full state: angles with the leg's pitch, and their rates, the contact between."""
    x, y, yaw, lean, theta, phi, yawdot, leandot, thetadot, phidot = state
    return toy.state([yaw, lean, -theta, phi], [yawdot, leandot, -thetadot, phidot], [x, y])


class General(ConstrainedMotion):
    """The equations on the stance disc by the general method."""

    walker: wj.SpatialWalker

    @property
    def independent(self):
        return 2, 3, 4, 5

    def system(self):
        whole = self.walker.system()
        return System(lambda q: whole.transfer(on_ground(q)), whole.masses, whole.forces)

    def constraints(self, q, qdot):
        return self.walker.contact_velocity(on_ground(q), on_ground(qdot), swing=False)[:2]


def test_the_defaults_are_those_of_the_toy():
    assert sizes_of(WALKER) == TOY["sizes"]


@kernel
def look(walker, state):
    """The motion by the two methods, and the forces of the ground by the constraints on rates."""
    start = wj.SpatialState(*state)
    q, qdot = all_coordinates(walker, start)
    held = lambda q, qdot: walker.contact_velocity(q, qdot, swing=False)
    found = multibody.solve_constrained(walker.system(), held, q, qdot)
    along, normal = walker.contact_force(start)
    return (
        jnp.stack(walker.vector_field(start)),
        jnp.stack(General(walker)(start)),
        jnp.stack([along, normal]),
        found.multipliers,
        found.accelerations,
        walker.energy(start),
        walker.clearance(start),
        held(q, qdot),
    )


BOTH = pytest.mark.parametrize(
    "walker",
    [pytest.param(WALKER, id="toy"), pytest.param(OTHER, id="other", marks=pytest.mark.slow)],
)


@pytest.mark.slow
@BOTH
def test_it_moves_as_the_general_method_and_kanes_say(walker):
    """Forces of the ground are those of the general method with all three contact constraints."""
    toy = Toy(sizes_of(walker))
    for state in states(1):
        field, general, force, multipliers, accelerations, energy, clearance, slides = map(
            np.asarray, jax.jit(look)(walker, jnp.asarray(state))
        )
        np.testing.assert_allclose(field, general, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(accelerations[3:], field[6:], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(multipliers[[0, 2]], force, rtol=1e-9, atol=1e-9)
        assert np.abs(slides).max() < 1e-14
        z = in_kanes_order(toy, state)
        rates = toy.rates_of(z)
        expected = np.concatenate([rates[4:6], rates[:4], rates[6:10]]) * SIGNS
        np.testing.assert_allclose(field, expected, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(energy, toy.look("energy", z), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(clearance, toy.clearance(z), rtol=1e-12, atol=1e-14)


SIGNS = np.array([1, 1, 1, 1, -1, 1, 1, 1, -1, 1.0])


@kernel
def strike(walker, state):
    (along, up), after = walker.impact(wj.SpatialState(*state))
    return along, up, jnp.stack(after), jnp.stack(walker.exchange_legs(after))


@BOTH
def test_heel_strike_keeps_the_momenta_about_contact_and_axle(walker):
    """Of Kane's model, before and, in a mirror, after."""
    toy = Toy(sizes_of(walker))
    for state in states(2):
        angles = state.copy()
        angles[:2] = 0
        _, _, after, mirrored = map(np.asarray, jax.jit(strike)(walker, jnp.asarray(angles)))
        np.testing.assert_array_equal(after[:6], angles[:6])
        before = in_kanes_order(toy, angles)
        places, momentum = toy.look("places", before), toy.look("momentum", before)
        contact = places[3:6] - toy.radius * places[12:15]
        about = momentum[3:6] - np.cross(contact, momentum[:3])
        kept = np.array([-about[0], about[1], -about[2], momentum[6]])
        later = toy.kept_after(in_kanes_order(toy, mirrored))
        np.testing.assert_allclose(later, kept, rtol=1e-10, atol=1e-10)


def test_bodies_have_the_angular_momentum_of_kanes_model():
    @jax.jit
    def momenta(walker, state):
        q, qdot = all_coordinates(walker, wj.SpatialState(*state))
        system = walker.system()
        linear = space.momentum(system, q, qdot)
        return jnp.append(linear, space.angular_momentum(system, q, qdot, jnp.zeros(3)))

    toy = Toy(sizes_of(OTHER))
    expected = toy.look("momentum", in_kanes_order(toy, states(3)[0]))[:6]
    found = momenta(OTHER, states(3)[0])
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


def test_both_discs_touch_on_the_section():
    xs = published() * np.random.default_rng(4).uniform(0.5, 1.5, (20, 7))
    xs = jnp.asarray(np.concatenate([[published()], xs]))

    @jax.jit
    @jax.vmap
    def lifted(x):
        state = WALKER.lift(x)
        return state.lean, WALKER.clearance(state), WALKER.project(state)

    leans, clearances, back = lifted(xs)
    assert np.abs(clearances).max() < 1e-15
    np.testing.assert_array_equal(back, xs)
    assert abs(leans[0] - TOY["gait"]["lean"]) < 1e-13


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"disc_radius": 1.0}, "disc_radius must be less than leg_length 1, not 1"),
        ({"hip_width": 0.0}, "hip_width must be finite and above 0"),
        ({"inertia_yz": 0.06}, "must make a positive definite matrix"),
    ],
)
def test_wrong_parameters_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        wj.SpatialWalker(**wrong)


def test_a_leg_that_is_more_than_level_is_no_start():
    """Between the legs and the slope, of the stance leg and of the swing leg, behind it."""
    feasible = jax.jit(lambda x: WALKER.feasible(x))
    lean = lambda theta, phi: jnp.array([0.1, theta, phi, 0, 0, -1.0, -1.5])
    for theta, phi, stands in ((1.35, 2.9, True), (1.35, 2.93, False), (1.58, 3.0, False)):
        assert feasible(lean(theta, phi)) == stands


# What needs whole strides


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(WALKER)


@pytest.mark.slow
def test_its_gait_is_found_without_a_guess(gait):
    assert gait.found and gait.stable
    np.testing.assert_allclose(gait.states[0], published(), rtol=0, atol=5e-14)
    again = wj.strides(WALKER, gait.states)
    np.testing.assert_allclose(again.state, gait.states, rtol=0, atol=1e-12)
    assert abs(gait.step_times[0] - TOY["step_time"]) < 5e-12
    moduli = [0.839156, 0.839156, 0.831396, 0.831396, 0.707961, 0.707961, 0.218395]
    np.testing.assert_allclose(np.abs(gait.multipliers), moduli, rtol=0, atol=5e-7)


@pytest.mark.slow
def test_multipliers_are_those_of_an_independent_integration(gait):
    """By Kane's equations and scipy, with differences extrapolated."""
    toy = Toy(sizes_of(WALKER))
    end, time = toy.step(MIRROR * gait.states[0])
    np.testing.assert_allclose(MIRROR * end, gait.states[0], rtol=0, atol=1e-10)
    assert abs(time - gait.step_times[0]) < 1e-10
    jacobian = toy.jacobian(MIRROR * gait.states[0])
    moduli = np.sort(np.abs(np.linalg.eigvals(jacobian)))[::-1]
    np.testing.assert_allclose(moduli, np.abs(gait.multipliers), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_jacobians_agree_with_extrapolated_differences(gait):
    """Through the impact and the mirror."""
    x = published() * (1 + 0.02 * np.random.default_rng(5).uniform(-1, 1, 7))
    jacobian = jax.jit(jax.jacfwd(lambda x: wj.stride(WALKER, x).state))(jnp.asarray(x))
    expected = differences(lambda xs: wj.strides(WALKER, xs).state, x, np.full(7, 1e-3))
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_disc_does_not_scuff_where_it_strikes():
    """There its height is zero by definition, with the error of the time as a rest."""
    region = WALKER.gait_region()
    starts = region.points_at(np.random.default_rng(11).uniform(0, 1, (1500, len(region.shape))))
    rough, fine = (wj.strides(WALKER, starts, tolerance=one).outcome for one in (1e-6, 1e-12))
    differ = rough != fine
    margins = wj.margins(WALKER, starts[differ]).scuffing
    assert differ.sum() <= 2 and (np.abs(margins) < 1e-4).all()


def test_a_push_from_the_side_topples_it():
    """A stronger one lifts it off the slope; to the other side, the old foot would not lift."""
    pushes = np.array([-1.5, -2.0, 2.0])
    starts = published() + pushes[:, None] * np.eye(7)[4]
    fates = wj.strides(WALKER, starts).outcome
    assert fates.tolist() == [Outcome.SIDEWAYS, Outcome.RUNNING, Outcome.OUTSIDE]


@pytest.mark.slow
def test_one_that_cannot_lean_nor_yaw_walks_as_in_the_plane():
    """The limit of large inertia J about the axes in the plane of a leg, extrapolated from three.

    Lean and yaw are like 1 / J; rounding errors of impacts are like J.
    """
    sizes = dict(slope=0.05, leg_mass=0.7, leg_length=1.2)
    planar = wj.RoundFootWalker(
        **sizes, hip_mass=0.0, leg_inertia=0.03, com_from_hip=0.5, com_offset=0.02, foot_radius=0.25
    )
    places = dict(com_forward=0.02, com_outward=-0.5, com_height=0.7, disc_radius=0.25)
    none = dict(inertia_xy=0.0, inertia_xz=0.0, inertia_yz=0.0)

    def held(J):
        inertia = none | dict(inertia_xx=J, inertia_yy=0.03, inertia_zz=J)
        return wj.SpatialWalker(**sizes, hip_width=1.0, **places, **inertia, allow_scuffing=True)

    x = np.random.default_rng(6).uniform([0.1, -0.9, -0.8], [0.35, -0.3, -0.1], (40, 3))
    theta, thetadot, phidot = x.T
    zero = np.zeros_like(theta)
    starts = np.stack([zero, theta, 2 * theta, zero, zero, thetadot, phidot], axis=1)
    expected = wj.strides(planar, x)
    each = [wj.strides(held(J), starts) for J in (1e5, 2e5, 4e5)]
    limit = lambda one, two, four: (8 * four - 6 * two + one) / 3
    made = expected.outcome == Outcome.STRIDE
    assert made.sum() > 5
    for found in each:
        np.testing.assert_array_equal(found.outcome == Outcome.STRIDE, made)
    ends, times = limit(*(one.state for one in each)), limit(*(one.time for one in each))
    zero, (theta, thetadot, phidot) = np.zeros(made.sum()), expected.state[made].T
    plane = np.stack([zero, theta, 2 * theta, zero, zero, thetadot, phidot], axis=1)
    np.testing.assert_allclose(ends[made], plane, rtol=0, atol=1e-9)
    np.testing.assert_allclose(times[made], expected.time[made], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_its_second_gait_is_that_of_an_independent_integration():
    """It is slower to lift and quicker to land, and it is unstable."""
    stable, other = sorted(wj.find_gaits(WALKER), key=lambda gait: abs(gait.multipliers[0]))
    assert stable.stable and not other.stable
    toy = Toy(sizes_of(WALKER))
    end, time = toy.step(MIRROR * other.states[0])
    np.testing.assert_allclose(MIRROR * end, other.states[0], rtol=0, atol=1e-9)
    assert abs(time - other.step_times[0]) < 1e-9 and abs(time - 0.567296) < 1e-6
    np.testing.assert_allclose(np.abs(other.multipliers[:2]), [4.236662, 1.551392], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.0, 0.1236, 0.2])
def test_a_step_lets_the_weight_down_by_what_the_impact_loses(gait, radius):
    """Of a gait: the energy lost at heel strike is weight times sin(slope) times the step."""
    walker = eqx.tree_at(lambda one: one.disc_radius, WALKER, jnp.asarray(radius))
    found = wj.find_gait(walker, gait.states)
    x, time = found.states[0], found.step_times[0]
    end = jax.tree.map(lambda values: values[0], wj.trajectory(walker, x, time[None]))
    after = walker.exchange_legs(walker.impact(end)[1])
    before, left = (
        float(multibody.kinetic_energy(walker.system(), *all_coordinates(walker, one)))
        for one in (end, after)
    )
    step = (before - left) / (2 * float(walker.leg_mass) * np.sin(float(walker.slope)))
    measures = all_measures(walker, ["disc_radius"], found)
    assert measures["step-length"].value == pytest.approx(step, rel=1e-9)
    assert measures["speed"].value == pytest.approx(step / float(time), rel=1e-9)


@pytest.mark.slow
def test_a_motion_stands_on_the_slope_and_is_filmed(tmp_path):
    """Legs keep their sizes; the disc that lands is the one that stands in the next stride."""
    data = wj.motion(WALKER, published(), 3, step=0.2)
    check_dataset(data, "walk in space")
    assert set(data.data_vars) == set(KINDS["walk in space"].variables)
    place = {name: data[name].values for name in ("stance", "swing", "stance_hip", "swing_hip")}
    axle = data["axle"].values
    low = place["stance"][:, 2] - WALKER.disc_radius * np.sqrt(1 - axle[:, 2] ** 2)
    np.testing.assert_allclose(low, 0, atol=1e-14)
    leg = WALKER.leg_length - WALKER.disc_radius
    for foot in ("stance", "swing"):
        length = np.linalg.norm(place[f"{foot}_hip"] - place[foot], axis=1)
        np.testing.assert_allclose(length, leg, rtol=1e-13)
    across = place["stance_hip"] - place["swing_hip"]
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), WALKER.hip_width, rtol=1e-13)
    stride = data["stride"].values
    for k in range(2):
        last, first = np.flatnonzero(stride == k)[-1], np.flatnonzero(stride == k + 1)[0]
        for one, other in (("swing", "stance"), ("stance", "swing")):
            for part in ("", "_hip"):
                before, after = place[one + part][last], place[other + part][first]
                np.testing.assert_allclose(before, after, rtol=0, atol=1e-11)
    figures.film(data, tmp_path / "toy.gif")
    with Image.open(tmp_path / "toy.gif") as film:
        assert len(list(ImageSequence.Iterator(film))) == data.sizes["frame"]
    fall = wj.motion(WALKER, published() - 1.5 * np.eye(7)[4], 2, step=0.2)
    assert fall["outcome"].values.tolist() == [Outcome.SIDEWAYS]
    assert abs(fall["lean"].values[-1]) >= np.pi / 3
