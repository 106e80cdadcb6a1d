"""The walker with knees: published gaits, motions, and what may be checked."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences, newton, stacked
from kneed_walkers import (
    HSU_CHEN,
    HUMAN_LIKE,
    PUBLISHED,
    SLOW,
    START,
    WALKER,
    changed,
    knee_strike,
    places,
    published,
    section_of,
    starts,
)
from part_of_swing import PartOfSwing

import walker_jax as wj
from walker_jax import BentState, KneedWalker, Outcome
from walker_jax.gaits.cycles import linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.walkers.kneed import FreeKnee, stance_knee_moment
from walker_jax.walkers.parameters import parameters

# Gaits


@pytest.mark.parametrize("search", ["differences", pytest.param("derivatives", marks=SLOW)])
@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(HSU_CHEN, id="Hsu Chen", marks=pytest.mark.slow),
        pytest.param(HUMAN_LIKE, id="human-like", marks=pytest.mark.slow),
    ],
)
def test_gaits_of_published_walkers(entry, search):
    walker, x, exact = published(entry), section_of(entry), entry["exact"]
    if search == "derivatives":
        (state,), multipliers, *_ = wj.find_gait(walker, np.round(x, 3))
    else:
        (state,), multipliers = newton(walker, np.round(x, 3))
    np.testing.assert_allclose(state, x, rtol=0, atol=1e-9)
    expected = np.array(exact["multipliers"]) @ [1, 1j]
    np.testing.assert_allclose(np.sort_complex(multipliers), np.sort_complex(expected), atol=1e-7)
    if search == "derivatives":
        times = np.array(wj.phase_times(walker, state))
    else:
        times = np.array([knee_strike(walker, state), wj.strides(walker, state[None]).time[0]])
    times /= np.sqrt(entry["gravity"])
    np.testing.assert_allclose(times, [exact["knee_strike"], exact["heel_strike"]], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("slope, radius", [(0.05, 0.0), (0.09, 0.3), (0.09, 0.5)])
def test_gaits_are_found_without_a_guess(slope, radius):
    """On large feet and steep slopes too, where legs turn fast beside the speed of toppling."""
    gait = wj.find_gait(KneedWalker(slope, foot_radius=radius))
    assert gait.found and gait.stable
    sizes = {0.0: 0.658, 0.3: 0.545, 0.5: 0.648}  # along a branch, in docs/results.md
    assert np.abs(gait.multipliers).max() == pytest.approx(sizes[radius], abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "radius", "state"),
    [
        (0.1115, 0.5139, [0.7026, -0.7235, -1.2362]),
        (0.1147, 0.5702, [0.8499, -0.8332, -1.4799]),
        (0.1107, 0.5976, [0.9266, -0.8979, -1.5791]),
    ],
)
def test_the_further_region_holds_the_long_steps_of_large_feet(slope, radius, state):
    """States of attractors that direct iteration finds over the whole section."""
    walker = KneedWalker(slope, foot_radius=radius)
    states, multipliers = newton(walker, state)
    assert np.abs(multipliers).max() < 1 and np.abs(states - np.array(state)).max() < 1e-4
    assert walker.further_gait_region().contains(states).all()
    assert not walker.gait_region().contains(states).any()


@pytest.mark.slow
def test_a_gait_on_round_feet_is_that_of_another_program():
    """McGeer's walker of 1990 with its masses at points."""
    entry = PUBLISHED["mcgeer_point_masses"]
    printed, unit = entry["printed"], np.sqrt(entry["gravity"])
    rates = np.array([printed["stance_rate"], printed["stance_rate"] - printed["swing_rate"]])
    x = np.array([printed["theta"], *rates / unit])
    walker = published(entry)
    states, multipliers = newton(walker, np.round(x, 2))
    np.testing.assert_allclose(states[0], x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(multipliers, np.array(printed["multipliers"]) @ [1, 1j], atol=1e-5)
    time = wj.strides(walker, states).time[0]
    assert time / unit == pytest.approx(printed["step_time"], abs=5e-5)


@jax.jit
def euler_stride(walker, x, dt):
    """A stride by Euler's method; steps are halved until they end in knee strike or heel strike."""
    (phase,) = walker.phases()
    add = lambda state, h, rates: jax.tree.map(lambda a, b: a + h * b, state, rates)

    def follow(field, struck, state):
        go = lambda state: add(state, dt, field(state))
        state = jax.lax.while_loop(lambda state: ~struck(go(state)), go, state)

        def halve(_, now):
            state, h = now
            later = add(state, h / 2, field(state))
            keep = lambda a, b: jnp.where(struck(later), a, b)
            return jax.tree.map(keep, state, later), h / 2

        return jax.lax.fori_loop(0, 60, halve, (state, dt))[0]

    bent = follow(phase.vector_field, lambda s: s.knee < 0, phase.begin(walker.lift(x)))
    heel = lambda s: (s.theta < 0) & (s.phi >= 2 * s.theta)
    swung = follow(walker.vector_field, heel, phase.end(bent))
    return walker.project(walker.exchange_legs(walker.impact(swung)[1]))


@pytest.mark.slow
@pytest.mark.parametrize("k", [0, 1])
def test_printed_fixed_points_are_those_of_eulers_method(k):
    entry = PUBLISHED["hsu_chen_by_euler"]
    unit = np.sqrt(entry["gravity"])
    walker = changed(
        published(HSU_CHEN),
        slope=np.arcsin(entry["sine_of_slope"]),
        shank_mass=entry["shank_mass"][k],
    )
    first, second = (entry[name][k] / unit for name in ("q1dot", "q2dot"))
    x = np.array([entry["q1"][k] + float(walker.slope), first, first - second])
    found = euler_stride(walker, x, jnp.asarray(entry["time_step"] * unit))
    np.testing.assert_allclose(found, x, rtol=0, atol=1e-10)
    (state,), _ = newton(walker, x)
    assert 1e-4 < np.abs(state - x).max() < 0.01  # by Euler's steps


@pytest.mark.slow
def test_the_human_like_gait_doubles_its_period_on_its_branch():
    """From 2 to 5 degrees along one branch."""
    walker = published(HUMAN_LIKE)
    gait = wj.find_gait(walker, section_of(HUMAN_LIKE))
    low, high = np.radians([2.0, 5.0]).tolist()
    branch = wj.continue_gait(walker, "slope", (low, high), gait)
    assert min(branch.values) == pytest.approx(low) and max(branch.values) == pytest.approx(high)
    assert not branch.folds
    (doubling,) = branch.doublings
    assert 4.8 < np.degrees(doubling.value) < 4.9 and doubling.residual < 1e-9
    for sign in (-1, 1):  # the multiplier passes -1 within 1e-9 of it
        there = published(HUMAN_LIKE, doubling.value + sign * 1e-9)
        near = wj.find_gait(there, doubling.states, tolerance=1e-14)
        assert np.sign(np.abs(near.multipliers[0]) - 1) == sign


@pytest.mark.slow
def test_jacobians_are_differences():
    """By the start and by every parameter, through both impacts, with the time of heel strike."""
    names = [one.name for one in parameters(KneedWalker)]
    cycle, tolerance = START[None, None], np.float64(1e-14)
    values = np.array([float(getattr(WALKER, name)) for name in names])

    def following(zs):
        walkers = stacked([KneedWalker(**dict(zip(names, z[3:], strict=True))) for z in zs])
        ends = wj.strides(walkers, zs[:, :3], tolerance=tolerance)
        assert (ends.outcome == Outcome.STRIDE).all()
        return ends.state

    steps = np.concatenate([np.full(3, 1e-4), 1e-3 * np.maximum(values, 0.05)])
    expected = differences(following, np.concatenate([START, values]), steps).T
    scale = np.abs(expected).max()
    for name, column in zip(names, expected[3:], strict=True):
        found = linearise(WALKER, cycle, Integrator(tolerance), name)
        np.testing.assert_allclose(found.jacobian[0, 0].T, expected[:3], atol=1e-7 * scale)
        np.testing.assert_allclose(found.by_parameter[0, 0], column, atol=1e-7 * scale)


# What may be checked


def test_a_freed_stance_knee_bends_by_a_negative_moment():
    """The moment that holds it straight, against the acceleration of a walker that is not held."""
    from walker_jax import multibody

    moment = jax.jit(lambda s: stance_knee_moment(WALKER, s))
    system, signs = WALKER.bent_system(), set()
    solve = jax.jit(lambda q, qdot: multibody.solve_motion(system, q, qdot, held=(0, 1)))
    for state in np.random.default_rng(5).uniform(-0.6, 0.6, (12, 6)):
        q, qdot = (np.array([0, 0, *half, 0.0]) for half in (state[:3], state[3:]))
        free = solve(q, qdot).accelerations[5]
        held = moment(BentState(*map(jnp.asarray, state)))
        assert np.sign(free) == -np.sign(held)
        signs.add(float(np.sign(held)))
    assert signs == {-1.0, 1.0}


@pytest.mark.slow
def test_what_is_checked_fails_at_heel_strike():
    """The human-like walker's foot scuffs at 4 degrees, and only its lock holds its stance knee."""
    x = np.array([0.33277583, -0.39853603, -0.29937231])
    walker = published(HUMAN_LIKE, np.radians(4))
    assert wj.stride(walker, x).outcome == Outcome.STRIDE
    for options, outcome, margin in (
        ({"check_scuffing": True}, Outcome.SCUFFED, "scuffing"),
        ({"check_lock": True}, Outcome.BUCKLED, "buckling"),
        ({"check_lock": True, "check_scuffing": True}, Outcome.BUCKLED, "buckling"),
    ):
        checked = changed(walker, **options)
        assert wj.stride(checked, x).outcome == outcome
        found = wj.margins(checked, x)
        assert found.stride.outcome == outcome and getattr(found, margin) < 0
    clean = changed(published(HSU_CHEN), check_scuffing=True)
    for dtype in (float, np.float32):  # a foot that touches is not below the ground, in rounding
        x = section_of(HSU_CHEN).astype(dtype)
        assert wj.stride(clean, x).outcome == Outcome.STRIDE
    with pytest.raises(ValueError, match="check_lock must be a bool, not 1"):
        changed(walker, check_lock=1)


def test_places_of_the_legs_have_the_knee():
    states = BentState(*np.random.default_rng(6).uniform(-0.6, 0.6, (6, 12)))
    shown = WALKER.picture().places(states, np.zeros(2))
    stance, hip, swing, knee = shown.values()
    for k, q in enumerate(np.stack(states[:3], axis=1)):
        points, (_, thigh, _, shank) = places(WALKER, q)
        up = lambda angle: np.array([-np.sin(angle), np.cos(angle)])
        np.testing.assert_allclose(hip[k], points[0], rtol=0, atol=1e-14)
        np.testing.assert_allclose(knee[k], hip[k] - 0.5 * up(thigh), rtol=0, atol=1e-14)
        np.testing.assert_allclose(swing[k], knee[k] - 0.45 * up(shank), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(hip - stance, axis=1), 0.95, rtol=1e-14)


@pytest.mark.slow
def test_a_motion_has_the_knee():
    data = wj.motion(WALKER, START, 2, step=0.2)
    assert data["knee"].max() > 0.3 and data["outcome"].values.tolist() == [0, 0]
    length = np.linalg.norm(data["swing_knee"] - data["hip"], axis=1)
    np.testing.assert_allclose(length, 0.5, rtol=1e-12)
    below = np.linalg.norm(data["swing"] - data["swing_knee"], axis=1)
    np.testing.assert_allclose(below, 0.45, rtol=1e-12)


@pytest.mark.slow
def test_a_motion_ends_where_a_foot_lands_on_a_bent_knee():
    lands = starts(400)[wj.strides(WALKER, starts(400)).outcome == Outcome.BENT_KNEE][0]
    ending = wj.motion(WALKER, lands, 1, step=0.02).isel(frame=-1)
    lowest = ending["swing"][1] - WALKER.foot_radius
    assert ending["knee"] > 0 and abs(float(lowest)) < 1e-9
    higher = jax.jit(jax.vmap(lambda x: wj.stride(WALKER, x, step=0.01).outcome))(starts(400))
    landings = starts(400)[np.asarray(higher) == Outcome.BENT_KNEE]
    assert len(landings) > 2
    for lands in landings[:20]:
        ending = wj.motion(WALKER, lands, 1, step=0.02, ground=np.array([0.01])).isel(frame=-1)
        assert (
            ending["knee"] > 0 and abs(float(ending["swing"][1]) - WALKER.foot_radius - 0.01) < 1e-9
        )


class Coast(PartOfSwing):
    """A second phase, with straight legs and nothing new, until the stance leg is past upright."""

    def event(self, state):
        return -state.theta - 0.05


class TwoPhases(KneedWalker):
    def phases(self):
        return FreeKnee(self), Coast(self)


@pytest.mark.slow
def test_a_motion_through_phases_of_several_kinds_of_state():
    """Two phases before the swing whose states differ: all are shown as those of the first."""
    times = np.linspace(0, 1.6, 9)
    parameters = {one.name: getattr(WALKER, one.name) for one in dataclasses.fields(WALKER)}
    expected = wj.trajectory(WALKER, START, times)
    found = wj.trajectory(TwoPhases(**parameters), START, times)
    np.testing.assert_allclose(np.stack(found), np.stack(expected), rtol=0, atol=1e-9)


def test_walkers_with_impossible_shanks_are_refused():
    with pytest.raises(ValueError, match="foot_radius must be less than thigh_length and shank"):
        KneedWalker(0.05, foot_radius=1.0)
    with pytest.raises(ValueError, match="shank_inertia must be above 0 where shank_com is 0"):
        KneedWalker(0.05, shank_com=0.0)


@pytest.mark.slow
def test_a_kneed_walk_on_rough_ground_is_strides_of_heights():
    heights = np.array([1e-4, 0.0])
    made = wj.walk(WALKER, START, 2, ground=heights)
    state = START
    for number, height in enumerate(heights):
        result = wj.stride(WALKER, state, step=height)
        assert result.outcome == Outcome.STRIDE
        np.testing.assert_allclose(made.states[number + 1], result.state, rtol=0, atol=1e-11)
        state = result.state
