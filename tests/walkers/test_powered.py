"""Walkers with motors, and feedback from stride to stride."""

import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import powered_reference
import pytest
from all_measures import all_measures
from part_of_swing import PartOfSwing

import walker_jax as wj
from walker_jax import State, multibody
from walker_jax.checks import WrongUse
from walker_jax.design.measures import cost_is_known
from walker_jax.gaits.cycles import linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameters import Parameter
from walker_jax.walkers.powered_masses import AbstractPoweredWalker

GRID = wj.Grid.sheared(theta=(0, 0.6, 40), sum=(-0.1, 0.05, 40))
STARTS = GRID.centres(np.arange(GRID.size))
LEVEL = wj.PoweredWalker(0.0, push_off=0.05)


@pytest.fixture(scope="module")
def level_gait():
    return wj.find_gait(LEVEL, [0.217, -0.2265])


@pytest.mark.parametrize(
    ("plain", "powered"),
    [
        (wj.SimplestWalker(0.009), wj.PoweredWalker(0.009)),
        (wj.SpringWalker(0.009, 1.5), wj.PoweredWalker(0.009, 1.5)),
    ],
)
def test_without_motors_it_is_the_plain_walker_to_the_bit(plain, powered):
    for one, other in zip(wj.strides(plain, STARTS), wj.strides(powered, STARTS), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "push_off", [0.05, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.01, 0.1))]
)
def test_on_level_ground_push_off_makes_up_for_heel_strike(push_off):
    gaits = wj.find_gaits(wj.PoweredWalker(0.0, push_off=push_off))
    assert len(gaits) == 2 and sum(gait.stable for gait in gaits) == 1
    for gait in gaits:
        theta, thetadot = gait.states[0]
        assert abs(thetadot) * np.tan(theta) == pytest.approx(push_off, abs=1e-11)


@pytest.mark.parametrize(
    ("slope", "names"),
    [
        (-0.02, []),
        *(
            pytest.param(one, ["slope", "push_off"], marks=pytest.mark.slow)
            for one in (-0.02, 0.0, 0.004)
        ),
    ],
)
def test_cost_of_transport_is_the_energy_lost_at_heel_strike(slope, names):
    """Kinetic energy of the hip before push-off and after the strike, over the step's length."""
    values = {"slope": slope, "push_off": 0.15 if slope < 0 else 0.05}
    walker = wj.PoweredWalker(**values)
    gait = wj.find_gait(walker)
    theta, thetadot = gait.states[0]
    before = thetadot**2 / 2 + np.cos(theta - slope) - np.cos(theta + slope)
    gained = values["push_off"] ** 2 / 2 + before - thetadot**2 / 2  # and lost again at heel strike
    found = wj.measure(walker, "cost-of-transport", names, gait)
    assert found.value == pytest.approx(gained / (2 * np.sin(theta)), rel=1e-11)
    h = 1e-5
    for number, name in enumerate(names):
        cost = lambda k, name=name: (
            wj.measure(
                other := wj.PoweredWalker(**values | {name: values[name] + k * h}),
                "cost-of-transport",
                (),
                wj.find_gait(other, gait.states[0]),
            ).value
        )
        assert found.gradient[number] == pytest.approx((cost(1) - cost(-1)) / (2 * h), rel=1e-5)


@pytest.mark.slow
def test_cost_of_transport_has_the_work_of_hip_and_push_off():
    """By a quadrature of the hip's power, and the way of the pushed foot during the impulse."""
    spring, damper, slack, push_off = 0.05, 0.005, -0.3, 0.06
    walker = wj.PoweredPointFootWalker(0.002, 0.05, spring, damper, slack, push_off)
    gait = wj.find_gait(walker, [0.22, -0.24])
    state, time = gait.states[0], gait.step_times[0]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    _, phi, _, phidot = wj.trajectory(walker, state, (nodes + 1) * time / 2)
    torque = -spring * (phi - slack) - damper * phidot
    hip = np.sum(weights * np.asarray(torque * phidot)) * time / 2
    (theta, phi, *rates) = np.stack(wj.trajectory(walker, state, gait.step_times))[:, 0]
    q, qdot = jnp.array([0, 0, theta, phi]), jnp.array([0, 0, *rates])
    leg = np.array([-np.sin(theta), np.cos(theta)])
    impulse = push_off * jnp.array([*leg, 0, 0])
    pushed = multibody.push(walker.system(), q, qdot, impulse)[:2]
    work = (float(hip) + push_off * float(leg @ pushed) / 2) / 1.1
    found = all_measures(walker, ["hip_spring"], gait)
    cost, length = found["cost-of-transport"], found["step-length"].value
    assert abs(hip) > 1e-4 and cost.value == pytest.approx(np.sin(0.002) + work / length, rel=1e-9)
    values = []
    for change in (-1e-4, 1e-4):
        other = wj.PoweredPointFootWalker(0.002, 0.05, spring + change, damper, slack, push_off)
        there = wj.find_gait(other, state)
        values.append(wj.measure(other, "cost-of-transport", (), there).value)
    assert cost.gradient[0] == pytest.approx((values[1] - values[0]) / 2e-4, rel=1e-5)


def test_the_work_of_motors_is_what_energy_gains():
    """Of a hip of mass 1 and feet of 0.05, from a stride's start to its end, and in push-off."""
    slope, mass, push_off = 0.1, 0.05, 0.06
    ends = (0.2, 0.4, -0.25, -0.1), (-0.21, -0.42, -0.22, 0.05)
    start, end = (State(*map(jnp.asarray, one)) for one in ends)
    up = lambda angle: np.array([-np.sin(angle), np.cos(angle)])
    along = lambda angle: np.array([np.cos(angle), np.sin(angle)])

    def energy(state):
        theta, phi, thetadot, phidot = map(float, state)
        hip = -thetadot * along(theta)
        foot = hip + (thetadot - phidot) * along(theta - phi)
        weighed = up(theta) + mass * (up(theta) - up(theta - phi))
        return (hip @ hip + mass * foot @ foot) / 2 + weighed @ up(slope)

    walker = lambda push: wj.PoweredPointFootWalker(slope, mass, push_off=push)
    work = jax.jit(lambda push: walker(push).motor_work(start, end))
    gained = (energy(end) - energy(start)) / 1.1
    assert float(work(0.0)) == pytest.approx(gained, rel=1e-12)
    q, qdot = (
        jnp.stack([0 * end.theta] * 2 + [*end[:2]]),
        jnp.stack([0 * end.theta] * 2 + [*end[2:]]),
    )
    leg = up(float(end.theta))
    impulse = jnp.asarray(push_off * np.array([*leg, 0, 0]))
    foot = multibody.push(walker(0.0).system(), q, qdot, impulse)[:2]  # at rest before
    pushed = push_off * float(leg @ np.asarray(foot)) / 2 / 1.1
    assert float(work(push_off)) - gained == pytest.approx(pushed, rel=1e-12) and pushed > 1e-4


def test_the_work_of_motors_is_not_known_with_phases():
    """What a phase's impact loses would be taken for work that is done on the motors."""

    class Halves(wj.PoweredPointFootWalker):
        def phases(self):
            return (Half(self),)

    class PoweredKnees(AbstractPoweredWalker, wj.KneedWalker):
        pass

    for walker in (Halves(slope=0.009, foot_mass=0.05), PoweredKnees(slope=0.05)):
        assert not cost_is_known(walker)
    assert cost_is_known(wj.PoweredPointFootWalker(slope=0.009, foot_mass=0.05))
    assert cost_is_known(wj.KneedWalker(0.05))


class Half(PartOfSwing):
    """Of the swing, until the legs pass each other: then the swing leg is slowed down."""

    def event(self, state):
        return -state.phi

    def end(self, state):
        return state._replace(phidot=0.995 * state.phidot)


def test_a_walker_climbs():
    gait = wj.find_gait(wj.PoweredWalker(-0.02, push_off=0.15))
    assert gait.found and gait.stable


@pytest.mark.parametrize(
    "walker",
    [
        wj.PoweredWalker(0.0, 2.0, 0.2, -0.3, 0.08),
        pytest.param(wj.PoweredWalker(0.009, 0.5, 0.1, -0.2, 0.01), marks=pytest.mark.slow),
        pytest.param(wj.PoweredWalker(-0.01, 4.0, 1.0, -0.5, 0.1), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_gaits_of_powered_walkers_by_an_independent_integration(walker):
    found, values = wj.find_gaits(walker), tuple(map(float, vars(walker).values()))
    assert found
    for gait in found[:2]:
        other = powered_reference.find_gait(values, gait.states[0])
        np.testing.assert_allclose(other, gait.states[0], rtol=0, atol=1e-9)
        _, time, _ = powered_reference.follow(values, powered_reference.lift(other))
        assert gait.step_times[0] == pytest.approx(time, abs=1e-8)


@pytest.mark.parametrize(
    "values",
    [
        (0.009, 0.0, 0.0, 0.0, 0.0),  # of a walker whose strides other tests have compiled
        pytest.param((-0.01, 4.0, 1.0, -0.5, 0.1), marks=pytest.mark.slow),
        pytest.param((0.009, 0.5, 0.1, -0.2, 0.01), marks=pytest.mark.slow),
        pytest.param((0.0, 0.0, 0.0, 0.0, 0.05), marks=pytest.mark.slow),
    ],
)
def test_gaits_and_sensitivity_norms_by_scipy_alone(values):
    walker = wj.PoweredWalker(*values) if any(values[1:]) else wj.SimplestWalker(values[0])
    gait = wj.find_gait(walker)
    expected = powered_reference.find_gait(values, gait.states[0])
    np.testing.assert_allclose(gait.states[0], expected, rtol=0, atol=1e-11)
    norm = powered_reference.sensitivity_norm(values, gait.states[0])
    assert wj.gait_sensitivity(walker, gait).norm == pytest.approx(norm, rel=1e-8)


@pytest.mark.slow
def test_the_sensitivity_norm_changes_as_its_gradient_says():
    values = np.array([0.009, 0.5, 0.1, -0.2, 0.01])
    names = ("slope", "hip_stiffness", "hip_damping", "hip_angle", "push_off")
    at = lambda values: wj.measure(wj.PoweredWalker(*values), "sensitivity-norm", ()).value
    found = wj.measure(wj.PoweredWalker(*values), "sensitivity-norm", names)
    assert found.value == pytest.approx(at(values), rel=1e-12)
    for k, width in ((0, 1e-5), (2, 1e-4), (4, 1e-4)):
        step = np.eye(5)[k] * width
        change = lambda n, step=step: (at(values + n * step) - at(values - n * step)) / (2 * n)
        expected = (4 * change(1) - change(2)) / 3 / width
        assert found.gradient[k] == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
def test_trained_feedback_is_what_scipy_says_it_is():
    """Its sensitivity norm, and from where it walks on; the untrained spring falls from there."""
    spring = wj.PoweredWalker(0.009, 1.0)
    gait = wj.find_gait(spring)
    fed = wj.Feedback(spring, gait, {"hip_angle": [0.0, 0.0]})
    names = "hip_angle_per_theta", "hip_angle_per_thetadot"
    data = wj.optimise(fed, dict.fromkeys(names, (-4.0, 4.0)), "sensitivity-norm", starts=1)
    gains = data["optimum"].values
    trained = wj.Feedback(spring, gait, {"hip_angle": gains})

    def parameters(full):
        away = np.array([full[0], full[2]]) - gait.states[0]
        return 0.009, 1.0, 0.0, gains @ away, 0.0

    norm = float(wj.gait_sensitivity(trained).norm)
    assert norm < 0.8 * float(wj.gait_sensitivity(spring, gait).norm)
    expected = powered_reference.sensitivity_norm(parameters, gait.states[0])
    assert norm == pytest.approx(expected, rel=1e-6)
    rng = np.random.default_rng(0)
    starts = gait.states[0] + rng.normal(size=(25, 2)) * 0.03
    lasts = lambda walker, x: bool((wj.walk(walker, x, 20).outcomes == wj.Outcome.STRIDE).all())
    fates = [lasts(trained, x) for x in starts]
    assert fates == [powered_reference.outlasts(parameters, x, 20) for x in starts]
    without = [lasts(spring, x) for x in starts]
    values = 0.009, 1.0, 0.0, 0.0, 0.0
    assert without == [powered_reference.outlasts(values, x, 20) for x in starts]
    assert sum(fates) > sum(without) + 3 and sum(fates) < 25


def test_motors_with_masses_have_the_limit_of_massless_feet():
    x = np.array([0.25, -0.27])
    limit = wj.stride(wj.PoweredWalker(0.004, 1.5, 0.2, -0.3, 0.03), x)
    assert limit.outcome == wj.Outcome.STRIDE
    errors = []
    for mass in (1e-3, 1e-4, 1e-5):
        motors = {"hip_spring": 1.5 * mass, "hip_damper": 0.2 * mass, "hip_angle": -0.3}
        walker = wj.PoweredPointFootWalker(0.004, mass, push_off=0.03, **motors)
        errors.append(np.abs(wj.stride(walker, x).state - limit.state).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 10, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plain", "powered"),
    [
        (wj.RoundFootWalker, wj.PoweredRoundFootWalker),
        (wj.UpperBodyWalker, wj.PoweredUpperBodyWalker),
    ],
)
def test_masses_with_idle_motors_move_as_without(plain, powered):
    rng = np.random.default_rng(0)
    starts = rng.uniform([0.15, -0.3, -0.1], [0.25, -0.2, 0.0], (8, 3))
    idle = powered(0.01)
    one, other = wj.strides(plain(0.01), starts), wj.strides(idle, starts)
    np.testing.assert_array_equal(one.outcome, other.outcome)
    np.testing.assert_allclose(one.state, other.state, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_strides_and_margins_change_as_their_derivatives_say():
    """With the slope, each motor, and the height of the next foothold; differences of order 4."""
    values, x = jnp.array([0.009, 0.5, 0.1, -0.2, 0.01, 5e-4]), jnp.array([0.21, -0.22])

    def made(values):
        walker = wj.PoweredWalker(*values[:5])
        even, _, misses = wj.margins(walker, x)
        up = wj.stride(walker, x, step=values[5])
        return jnp.stack([*even.state, even.time, *misses.values(), *up.state, up.time])

    many, h = jax.jit(jax.vmap(made)), 1e-4
    moved = lambda k: many(values + k * h * jnp.eye(6)) - many(values - k * h * jnp.eye(6))
    central = (8 * moved(1) - moved(2)) / (12 * h)
    rates = jax.jit(jax.jacfwd(made))(values)
    assert np.isfinite(rates).all() and rates.shape == (12, 6)
    np.testing.assert_allclose(rates, central.T, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("bad", [{"slope": -1.6}, {"push_off": -0.1}, {"hip_damping": np.nan}])
def test_bad_motors_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        wj.PoweredWalker(**{"slope": 0.01, **bad})


# Feedback


def test_feedback_changes_the_jacobian_by_the_gains(level_gait):
    """dS/dx = S_x + S_p K, and the gait stays."""
    gains = np.array([0.5, 0.2])
    fed = wj.Feedback(LEVEL, level_gait, {"push_off": gains})
    gait = wj.find_gait(fed, level_gait.states[0])
    np.testing.assert_allclose(gait.states, level_gait.states, rtol=0, atol=1e-14)
    cycle = np.asarray(level_gait.states)[None]
    arrays = lambda walker: jax.tree.map(np.asarray, walker)
    plain = linearise(arrays(LEVEL), cycle, Integrator(1e-12), "push_off")
    expected = plain.jacobian[0, 0] + np.outer(plain.by_parameter[0, 0], gains)
    found = linearise(arrays(fed), cycle, Integrator(1e-12)).jacobian[0, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_parameters_stay_within_their_bounds(level_gait):
    """Below the least push-off, which is 0 by itself, it is the least one; above, the largest."""
    strong, given = {"push_off": [-20.0, 0.0]}, {"push_off": (0.03, 0.06)}
    for side, bounds, end in ((1, {}, 0.0), (1, given, 0.03), (-1, given, 0.06)):
        x = np.add(level_gait.states[0], [side * 0.005, side * -0.005])
        fed = wj.Feedback(LEVEL, level_gait, strong, bounds)
        expected = wj.stride(wj.PoweredWalker(0.0, push_off=end), x)
        assert expected.outcome == wj.Outcome.STRIDE
        np.testing.assert_array_equal(wj.stride(fed, x).state, expected.state)


def test_feedback_is_a_walker_like_any_other(level_gait):
    gains = {"push_off": [0.4, 0.2], "hip_angle": [0.0, 0.1]}
    fed = wj.Feedback(LEVEL, level_gait, gains, {"push_off": (0.0, 0.2)})
    assert repr(pickle.loads(pickle.dumps(fed))) == repr(fed)
    assert not fed.driven_by_gravity()


@pytest.mark.slow
def test_strides_change_with_the_gains_as_derivatives_say(level_gait):
    state = lambda gain: (
        wj.stride(
            wj.Feedback(LEVEL, level_gait, {"push_off": jnp.stack([gain, gain])}),
            np.array([0.22, -0.24]),
        ).state
    )
    rate, h = jax.jacfwd(state)(0.3), 1e-4
    central = (state(0.3 + h) - state(0.3 - h)) / (2 * h)
    np.testing.assert_allclose(rate, central, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("gait", "gains", "bounds", "named"),
    [
        (None, {}, None, "gains"),
        (None, {"colour": [0, 0]}, None, "colour"),
        (None, {"push_off": [0.0]}, None, "push_off"),
        (None, {"push_off": [0, 0]}, {"slope": (0, 1)}, "bounds"),
        (None, {"push_off": [0, 0]}, {"push_off": (1, 0)}, "bounds"),
        (None, {"slope": [0, 0]}, None, "bounds must have slope, which must be above"),
        (None, {"slope": [0, 0]}, {"slope": (-2, 1)}, "least_slope must be"),
        ([np.nan, 0.0], {"push_off": [0, 0]}, None, "gait"),
        (np.zeros((2, 2)), {"push_off": [0, 0]}, None, "gait"),
    ],
)
def test_bad_feedback_is_refused(level_gait, gait, gains, bounds, named):
    with pytest.raises(ValueError, match=named):
        wj.Feedback(LEVEL, level_gait if gait is None else gait, gains, bounds)


SLACK = Parameter("slack", "phi at which the spring is slack", "rad", 0.0, low=-np.inf, high=0.5)


class SlackWalker(wj.PoweredWalker):
    """One more parameter, which is bounded above alone."""

    slack: Scalar = eqx.field(converter=SLACK.convert, default=0.0)


def test_feedback_on_what_is_below_its_bound_needs_bounds(level_gait):
    walker, gains = SlackWalker(0.0, push_off=0.05), {"slack": [0.1, 0.0]}
    with pytest.raises(WrongUse, match=r"slack must be finite and below 0\.5, not 0\.5"):
        SlackWalker(0.0, slack=0.5)
    with pytest.raises(WrongUse, match="bounds must have slack, which must be finite and below"):
        wj.Feedback(walker, level_gait, gains)
    fed = wj.Feedback(walker, level_gait, gains, {"slack": (-1.0, 0.4)})
    assert float(vars(fed)["largest_slack"]) == 0.4


@pytest.mark.slow
def test_feedback_acts_once_and_from_full_states_too(level_gait):
    fed = wj.Feedback(LEVEL, level_gait, {"push_off": [0.5, 0.2]})
    x = np.add(level_gait.states[0], [0.003, -0.004])
    made = wj.stride(fed, x)
    np.testing.assert_array_equal(wj.phase_times(fed, x), [made.time])
    full = np.stack(fed.lift(jnp.asarray(x)))
    np.testing.assert_allclose(wj.stride(fed, full).state, made.state, rtol=0, atol=1e-13)
    stepped = wj.stride(fed, full, step=0.0).state
    np.testing.assert_allclose(stepped[jnp.array([0, 2])], made.state, rtol=0, atol=1e-13)


def test_feedback_refuses_what_it_cannot_be_of(level_gait):
    fed = wj.Feedback(LEVEL, level_gait, {"push_off": [0.5, 0.2]})
    with pytest.raises(WrongUse, match="walker must be one without feedback"):
        wj.Feedback(fed, level_gait, {"slope": [0.1, 0.0]})
    for gait, gains, bounds, named in (
        (level_gait, {"push_off": "ab"}, None, "gains of push_off"),
        ("gait", {"push_off": [0, 0]}, None, "gait must be"),
        (None, {"push_off": [0, 0]}, None, "gait must be"),
        (level_gait, {"push_off": [0, 0]}, {"push_off": (-1, 1)}, "least_push_off must be"),
    ):
        with pytest.raises(WrongUse, match=named):
            wj.Feedback(LEVEL, gait, gains, bounds)
