"""The mechanics of the walker with knees: energies, momenta, limits, and every way to fail."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kneed_walkers import (
    START,
    WALKER,
    changed,
    energy,
    knee_strike,
    masses,
    places,
    starts,
    velocities,
)
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax import BentState, Outcome, RoundFootWalker, State
from walker_jax.walkers.kneed import begin_bent, stance_knee_moment
from walker_jax.walkers.model import toppling_rate

# Mechanics


def momentum(
    walker,
    q,
    rates,
    about,
    points: Any = slice(None),
    bodies: Any = slice(None),
    foot: Any = (0, 0),
):
    """Angular momentum of some masses; the stance foot may move."""
    r, _ = places(walker, q)
    v, turn = velocities(walker, q, rates)
    v = v + np.array(foot)
    m, inertia = masses(walker)
    arm = r - about
    cross = arm[:, 0] * v[:, 1] - arm[:, 1] * v[:, 0]
    return (m * cross)[points].sum() + (inertia * turn)[bodies].sum()


def test_energy_is_constant_in_phases_and_falls_at_impacts(path):
    times, states, knee, _ = path
    every = np.array([energy(WALKER, s[:3], s[3:]) for s in np.stack(states, axis=1)])
    free, locked = every[times < knee], every[times >= knee]
    assert np.ptp(free) < 1e-11 * free[0] and np.ptp(locked) < 1e-11 * locked[0]
    assert free[0] - locked[0] > 1e-4
    following = np.asarray(wj.stride(WALKER, START).state)
    after = energy(WALKER, [following[0], 2 * following[0], 0], [*following[1:], 0])
    lower = (
        after
        - 2
        * np.sin(following[0])
        * (1 - 0.05)
        * np.sin(float(WALKER.slope))
        * masses(WALKER)[0].sum()
    )
    lower -= 2 * 0.05 * following[0] * np.sin(float(WALKER.slope)) * masses(WALKER)[0].sum()
    assert lower < locked[0] - 1e-3  # counted from where the stance foot was


def test_each_impact_keeps_the_momenta_that_it_must(path):
    """Knee strike: the whole about the stance contact, the swing leg about the hip. Heel strike:
    the whole about the new contact, the trailing leg about the hip."""
    rng = np.random.default_rng(0)
    phase = WALKER.phases()[0]
    strike, heel = jax.jit(lambda s: phase.end(s)), jax.jit(lambda s: WALKER.impact(s))
    swing_points, swing_bodies = [2, 4], [1, 3]
    for _ in range(20):
        theta, phi, *rates = rng.uniform(-1, 1, 5)
        q = [theta, phi, 0.0]
        hip = places(WALKER, q)[0][0]
        contact = np.array([-0.05 * theta, 0.0])
        after = strike(BentState(*map(jnp.asarray, [*q, *rates])))
        later = [float(after.thetadot), float(after.phidot), 0.0]
        for part in ((contact,), (hip, swing_points, swing_bodies)):
            kept = [momentum(WALKER, q, one, *part) for one in (rates, later)]
            assert abs(kept[1] - kept[0]) < 1e-12 * (1 + abs(kept[0]))
        assert energy(WALKER, q, later) <= energy(WALKER, q, rates) + 1e-14

        theta = -abs(theta)
        q, rates = [theta, 2 * theta, 0.0], [*rates[:2], 0.0]
        foot, after = heel(State(*map(jnp.asarray, [*q[:2], *rates[:2]])))
        later = [float(after.thetadot), float(after.phidot), 0.0]
        moving = np.array([float(one) for one in foot])
        hip = places(WALKER, q)[0][0]
        swing_end = hip - 0.95 * np.array([-np.sin(-theta), np.cos(-theta)])
        contact = np.array([swing_end[0], 0.0])
        for part in ((contact,), (hip, [1, 3], [0, 2])):
            before = momentum(WALKER, q, rates, *part)
            kept = momentum(WALKER, q, later, *part, foot=moving)
            assert abs(kept - before) < 1e-12 * (1 + abs(before))


def test_equations_are_those_of_lagrange():
    """By sympy, of both phases, and the moment on the stance knee, for a walker whose feet roll."""
    import sympy as sp

    names = "theta phi knee stance thetadot phidot kneedot stancedot"
    theta, phi, knee, stance, *rates = symbols = sp.symbols(names)
    q, rates = sp.Matrix([theta, phi, knee, stance]), sp.Matrix(rates)
    number = lambda name: sp.nsimplify(round(float(getattr(WALKER, name)), 12))
    up = lambda angle: sp.Matrix([-sp.sin(angle), sp.cos(angle)])
    radius, thigh, shank = map(number, ("foot_radius", "thigh_length", "shank_length"))
    below = theta - stance  # of the stance shank: that knee is held straight
    stance_knee = sp.Matrix([-radius * below, radius]) + (shank - radius) * up(below)
    hip = stance_knee + thigh * up(theta)
    swing = theta - phi
    bodies = [  # place, angle, mass, inertia
        (hip, 0, "hip_mass", None),
        (hip - number("thigh_com") * up(theta), theta, "thigh_mass", "thigh_inertia"),
        (hip - number("thigh_com") * up(swing), swing, "thigh_mass", "thigh_inertia"),
        (stance_knee - number("shank_com") * up(below), below, "shank_mass", "shank_inertia"),
        (
            hip - thigh * up(swing) - number("shank_com") * up(swing - knee),
            swing - knee,
            "shank_mass",
            "shank_inertia",
        ),
    ]
    slope, lagrangian = number("slope"), 0
    for place, angle, mass, inertia in bodies:
        speed = place.jacobian(q) * rates
        turn = (sp.Matrix([angle]).jacobian(q) * rates)[0]
        kinetic = number(mass) * speed.dot(speed) + (number(inertia) if inertia else 0) * turn**2
        height = -sp.sin(slope) * place[0] + sp.cos(slope) * place[1]
        lagrangian += kinetic / 2 - number(mass) * height
    momenta = sp.Matrix([lagrangian]).jacobian(rates)
    matrix = momenta.jacobian(rates)
    force = sp.Matrix([lagrangian]).jacobian(q).T - momenta.jacobian(q) * rates
    look = sp.lambdify(symbols, (matrix, force), "numpy")
    phase = WALKER.phases()[0]
    bent = jax.jit(lambda state: phase.vector_field(state))
    straight = jax.jit(lambda state: WALKER.vector_field(state))
    at = lambda state: map(np.asarray, look(*state[:3], 0, *state[3:], 0))
    held = lambda M, f, n: np.linalg.solve(M[:n, :n], f[:n])[:, 0]
    for state in np.random.default_rng(1).uniform(-1, 1, (10, 6)):
        (M, f), bend = at(state), BentState(*map(jnp.asarray, state))
        expected = held(M, f, 3)
        np.testing.assert_allclose(bent(bend)[3:], expected, rtol=1e-11)
        moment = M[3, :3] @ expected - f[3, 0]
        np.testing.assert_allclose(stance_knee_moment(WALKER, bend), moment, rtol=1e-11)
        state[[2, 5]] = 0
        (M, f), bend = at(state), BentState(*map(jnp.asarray, state))
        expected = held(M, f, 2)
        found = straight(State(*map(jnp.asarray, state[[0, 1, 3, 4]])))
        np.testing.assert_allclose(found[2:], expected, rtol=1e-11)
        moment = M[3, :2] @ expected - f[3, 0]  # the swing knee is locked as well
        np.testing.assert_allclose(stance_knee_moment(WALKER, bend, (4,)), moment, rtol=1e-11)


# Limits


def straight_legged(walker):
    """The walker with the same legs, without knees."""
    get = lambda name: float(getattr(walker, name))
    m, n, down = get("thigh_mass"), get("shank_mass"), get("thigh_length") + get("shank_com")
    com = (m * get("thigh_com") + n * down) / (m + n)
    inertia = get("thigh_inertia") + get("shank_inertia")
    inertia += m * (get("thigh_com") - com) ** 2 + n * (down - com) ** 2
    length = get("thigh_length") + get("shank_length")
    return RoundFootWalker(
        get("slope"), get("hip_mass"), m + n, inertia, length, com, 0.0, get("foot_radius")
    )


@pytest.mark.slow
def test_shanks_that_lock_at_once_make_a_straight_legged_walker():
    """On the section they lock at once in falls alone; launched late in a swing, in strides too."""
    straight, xs = straight_legged(WALKER), starts(400)
    late = wj.trajectory(straight, START, np.linspace(0.3, 1.6, 40))
    bends = jax.jit(lambda s: WALKER.phases()[0].vector_field(begin_bent(s)).kneedot)
    on_section = jax.vmap(lambda x: bends(WALKER.lift(x)))(xs) <= 0
    at_once = np.asarray(jax.vmap(bends)(late) <= 0)
    launches = np.stack(late, axis=1)[at_once]
    for some in (xs[np.asarray(on_section)], launches):
        found, expected = wj.strides(WALKER, some), wj.strides(straight, some)
        np.testing.assert_array_equal(found.outcome, expected.outcome)
        np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=1e-10)
        assert len(some) > 10
    assert (found.outcome == Outcome.STRIDE).sum() > 10
    times = np.asarray(wj.phase_times(WALKER, launches[0]))
    assert times[0] == 0 and times[1] == pytest.approx(expected.time[0], rel=1e-12)


def test_feet_of_vanishing_radius_are_points():
    ends = [
        np.asarray(wj.stride(changed(WALKER, foot_radius=r), START).state) for r in (1e-3, 1e-4, 0)
    ]
    first, second = (np.abs(one - ends[2]).max() for one in ends[:2])
    assert second < 1e-3 and first / second == pytest.approx(10, rel=0.05)


# Outcomes


@jax.jit
def bent_motion(walker, y):
    """Rates, contact force, and height and reach of the foot, while the knee is free."""
    (phase,), state = walker.phases(), BentState(*y)
    force, reach = phase.contact_force(state)[1], phase.reach(state)
    return jnp.stack(phase.vector_field(state)), force, phase.clearance(state), reach


@jax.jit
def straight_motion(walker, y):
    """Rates and contact force once it is locked."""
    state = State(*y)
    return jnp.stack(walker.vector_field(state)), walker.contact_force(state)[1]


@jax.jit
def strike_knee(walker, y):
    (phase,) = walker.phases()
    return jnp.stack(phase.end(BentState(*y)))


@jax.jit
def strike_heel(walker, y):
    (_, lift), after = walker.impact(State(*y))
    return lift, walker.project(walker.exchange_legs(after))


def simulate(walker, x):
    """A stride by scipy's integrator, with its own logic of events: outcome, state, times."""
    field, force, clearance, reach = (
        lambda y, i=i: np.asarray(bent_motion(walker, y)[i]) for i in range(4)
    )
    locked, locked_force = (
        lambda y, i=i: np.asarray(straight_motion(walker, y)[i]) for i in (0, 1)
    )
    event = lambda function, direction, terminal=True: mark(function, direction, terminal)

    def mark(function, direction, terminal):
        call = lambda t, y: float(function(y))
        call.direction, call.terminal = direction, terminal
        return call

    options: Any = dict(rtol=1e-10, atol=1e-12, dense_output=True, max_step=0.02)
    start = np.array([x[0], 2 * x[0], 0, x[1], x[2], 0])
    pulled = float(force(start)) < 0
    over = float(field(start)[5]) <= 0
    time = 0.0
    if over:
        state = np.delete(start, [2, 5])
        if float(locked_force(state)) < 0:
            return Outcome.RUNNING, None
    else:
        if pulled:
            return Outcome.RUNNING, None
        events = [
            event(lambda y: y[2], -1),
            event(lambda y: y[3], 1),
            event(lambda y: y[0] + np.pi / 2, -1),
            event(clearance, -1, False),
        ]
        # The knee is zero at the start, which is no event: a little later it is bent.
        first = solve_ivp(lambda t, y: field(y), (0, 1e-4), start, **options)
        run = solve_ivp(lambda t, y: field(y), (1e-4, 60), first.y[:, -1], events=events, **options)
        for y in run.y_events[3]:
            if y[0] < 0 and float(reach(y)) > 0 and y[3] < 0 and y[2] > 1e-9:
                return Outcome.BENT_KNEE, None
        if len(run.t_events[1]):
            return Outcome.BACKWARD, None
        if len(run.t_events[2]):
            return Outcome.FORWARD, None
        pulled = min(float(force(y)) for y in run.sol(np.linspace(1e-4, run.t[-1], 200)).T) < 0
        time, at = run.t[-1], run.y[:, -1]
        state = np.asarray(strike_knee(walker, np.array([*at[:2], 0.0, *at[3:]])))
        if state[2] >= 0:
            return Outcome.BACKWARD, None
    h = lambda y: y[1] - 2 * y[0]
    events = [event(h, 1, False), event(lambda y: y[2], 1), event(lambda y: y[0] + np.pi / 2, -1)]
    run = solve_ivp(lambda t, y: locked(y), (time, time + 60), state, events=events, **options)
    strikes = [
        (t, y)
        for t, y in zip(run.t_events[0], run.y_events[0], strict=True)
        if y[0] < 0 and y[1] < 0 and y[2] < 0 and t > time
    ]
    if not strikes:
        return (Outcome.BACKWARD if len(run.t_events[1]) else Outcome.FORWARD), None
    t, y = strikes[0]
    pulled |= min(float(locked_force(s)) for s in run.sol(np.linspace(time, t, 200)).T) < 0
    lift, following = map(np.asarray, strike_heel(walker, y))
    if pulled:
        return Outcome.RUNNING, None
    if lift <= 0:
        return Outcome.STOPPED, None
    if following[1] >= 0:
        return Outcome.BACKWARD, None
    return Outcome.STRIDE, (following, t)


@pytest.mark.parametrize("count", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_outcomes_and_states_are_those_of_another_integrator(count):
    near = START + np.random.default_rng(4).uniform(-0.15, 0.15, (20, 3))
    xs = np.concatenate([starts(count, seed=3), START[None], near[: count // 3]])
    for walker in (WALKER, changed(WALKER, foot_radius=0.0)):
        found, agree, ways = wj.strides(walker, xs), 0, set()
        for x, outcome, state, time in zip(xs, found.outcome, found.state, found.time, strict=True):
            if outcome == Outcome.OUTSIDE:
                continue
            expected, end = simulate(walker, x)
            agree += expected == outcome
            ways.add(int(outcome))
            if end is not None and outcome == Outcome.STRIDE:
                np.testing.assert_allclose(state, end[0], rtol=0, atol=2e-6)
                assert time == pytest.approx(end[1], abs=2e-6)
        assert agree == (found.outcome != Outcome.OUTSIDE).sum()
        assert {0, 1, 2, 8} <= ways


@pytest.mark.slow
def test_margins_have_the_sign_that_the_outcome_says():
    xs = starts(3000)
    found = wj.margins(WALKER, xs)
    ends = wj.strides(WALKER, xs)
    np.testing.assert_array_equal(found.stride.outcome, ends.outcome)
    ways = {
        "FORWARD": "forward",
        "BACKWARD": "backward",
        "STOPPED": "stopping",
        "BENT_KNEE": "landing",
    }
    for outcome, name in ways.items():
        values = getattr(found, name)[ends.outcome == Outcome[outcome]]
        assert len(values) > 20 and (values < 0).all()
        passed = getattr(found, name)[ends.outcome == Outcome.STRIDE]
        assert (passed[np.isfinite(passed)] > 0).all()
    assert np.isfinite(found.landing[ends.outcome == Outcome.STRIDE]).mean() > 0.3


def test_a_foot_that_comes_down_after_the_fall_does_not_land():
    """The stance leg is down at 2.24, the foot at 2.26: in one step of the integration."""
    walker, x = changed(WALKER, foot_radius=0.0), np.array([0.28787059, -0.75104167, 0.61825993])
    assert wj.stride(walker, x).outcome == Outcome.FORWARD
    found = wj.margins(walker, x[None])
    assert found.stride.outcome[0] == Outcome.FORWARD and found.forward[0] < 0
    assert not found.landing[0] < 0


@pytest.mark.slow
def test_the_margin_of_a_foot_that_lands_is_of_its_speed(path):
    """Or of how far in front it lands, or the stance leg leans, whichever is nearer to zero."""
    (phase,), unit = WALKER.phases(), 1 / float(toppling_rate(WALKER))
    look = lambda state: jnp.stack([phase.clearance(state), -state.theta, phase.reach(state)])
    look, times = jax.jit(jax.vmap(look)), np.linspace(0, 8, 2001)
    xs = starts(3000)
    found, kinds = wj.margins(WALKER, xs), set()
    for i in np.flatnonzero(found.stride.outcome == Outcome.BENT_KNEE)[:12]:
        height, *admits = np.asarray(look(wj.trajectory(WALKER, xs[i], times))).T
        ahead, speed = np.min(admits, axis=0), np.gradient(height, times)
        k = np.flatnonzero((height[:-1] >= 0) & (height[1:] < 0) & (ahead[1:] > 0))[0]
        there = lambda one, k=k, h=height: np.interp(0, [h[k + 1], h[k]], [one[k + 1], one[k]])
        energy = (there(speed) * unit) ** 2 / 2
        assert found.landing[i] == pytest.approx(-min(energy, there(ahead)), rel=1e-3, abs=1e-4)
        kinds.add(bool(there(ahead) < energy))
    assert kinds == {False, True}


def test_landing_margins_vanish_where_a_foot_only_just_lands():
    """Between starts that stride and starts that land on a bent knee."""
    near = START + np.random.default_rng(5).uniform(-0.15, 0.15, (400, 3))
    outcome = wj.strides(WALKER, near).outcome
    good, bad = near[outcome == 0][:20], near[outcome == Outcome.BENT_KNEE][:20]
    number = min(len(good), len(bad))
    assert number > 5
    good, bad = good[:number], bad[:number]
    for _ in range(40):
        middle = (good + bad) / 2
        strides = (wj.strides(WALKER, middle).outcome == 0)[:, None]
        good, bad = np.where(strides, middle, good), np.where(strides, bad, middle)
    found = wj.margins(WALKER, bad)
    landed = found.stride.outcome == Outcome.BENT_KNEE
    assert landed.sum() > 5
    assert np.mean(np.abs(found.landing[landed]) < 1e-9) > 0.8


def test_tension_at_the_knee_strike_does_not_end_a_fall(path):
    """The ground would have to pull, but the foot does not come down before the leg does."""
    xs = np.array(
        [[0.1045, -1.1336, 0.3335], [0.1768, -1.0133, -0.6038], [0.0309, -1.1068, 0.8472]]
    )
    force = jax.jit(lambda state: WALKER.contact_force(state)[1])
    for x in xs:
        knee = knee_strike(WALKER, x)
        motion = wj.trajectory(WALKER, x, np.linspace(knee, 2.5, 24))
        theta, phi, _, *rates, _ = map(np.asarray, motion)
        strikes = State(*(jnp.asarray(one[0]) for one in (theta, phi, *rates)))
        assert force(strikes) < 0 and theta[-1] < -np.pi / 2
        assert (phi > 2 * theta)[theta > -np.pi / 2].all()
    assert (wj.strides(WALKER, xs).outcome == Outcome.FORWARD).all()
    assert (wj.margins(WALKER, xs).stride.outcome == Outcome.FORWARD).all()


@pytest.mark.slow
def test_a_start_in_mid_stride_goes_on_with_the_same_stride(path):
    times, states, _, _ = path
    whole = wj.stride(WALKER, START)
    for k in (4, 8):
        rest = wj.stride(WALKER, np.stack(states, axis=1)[k])
        np.testing.assert_allclose(rest.state, whole.state, rtol=0, atol=1e-11)
        assert float(rest.time) == pytest.approx(float(whole.time) - times[k], abs=1e-11)
    upright = wj.stride(WALKER, np.array([START[0], 2 * START[0], *START[1:]]))
    np.testing.assert_allclose(upright.state, whole.state, rtol=0, atol=1e-14)
    backward = np.stack(states, axis=1)[4] * [1, 1, -1, 1, 1, 1]
    assert wj.stride(WALKER, backward).outcome == Outcome.OUTSIDE
    with pytest.raises(
        ValueError, match=r"\(3,\), on the section .* \(4,\) or \(6,\), a full state"
    ):
        wj.stride(WALKER, np.zeros(5))


@pytest.mark.slow  # test_phases.py has a walker that is sooner compiled
def test_a_step_down_takes_longer_through_the_same_phases():
    level, down = wj.stride(WALKER, START), wj.stride(WALKER, START, step=0.0)
    np.testing.assert_allclose(WALKER.project(State(*down.state)), level.state, rtol=0, atol=1e-12)
    lower = wj.stride(WALKER, START, step=-0.005)
    assert lower.outcome == Outcome.STRIDE and lower.time > level.time
    assert wj.stride(WALKER, lower.state).outcome == Outcome.STRIDE


@pytest.mark.slow
def test_a_foot_lands_on_a_bent_knee_where_the_ground_is():
    """Where it is above the lowest place of the foot in front, by its motion alone."""
    xs = START + np.random.default_rng(2).normal(size=(60, 3)) * [0.08, 0.08, 0.3]
    xs = xs[np.isin(wj.strides(WALKER, xs).outcome, (Outcome.STRIDE, Outcome.BENT_KNEE))]
    (phase,) = WALKER.phases()
    heights = jax.jit(jax.vmap(lambda s: jnp.stack([phase.clearance(s), phase.reach(s)])))
    times, signs = np.linspace(0, 2.5, 5001), []
    for x in xs[:24]:
        motion = wj.trajectory(WALKER, x, times)
        height, ahead = np.asarray(heights(motion)).T
        bent, falls = np.asarray(motion.knee) > 0, np.asarray(motion.thetadot) < 0
        until = 1 + np.argmin(bent[1:] & falls[1:])  # knee strike, or the stance leg stops
        front = np.flatnonzero((np.asarray(motion.theta) < 0) & (ahead > 0))
        front = front[front < until]
        if len(front) == 0 or height[front[0]] < height[front].min() + 0.01:
            continue
        lowest = height[front].min()
        higher, lower = (wj.stride(WALKER, x, step=lowest + by).outcome for by in (2e-3, -2e-3))
        assert higher == Outcome.BENT_KNEE != lower
        signs.append(np.sign(lowest))
    assert signs.count(-1) > 5 and signs.count(1) > 0
