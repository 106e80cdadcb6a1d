"""Steps that derivatives need, that sharp smooth features need, and that small variables need."""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clocked import Clocked
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.integrators import own_sizes
from walker_jax.integrators.own_sizes import proportional_variables
from walker_jax.integrators.step_lengths import has_sharp_features, may_have_clocks
from walker_jax.walking.starts import prepare
from walker_jax.walking.stride import follow_stride

DOPRI8 = diffrax.Dopri8()


class Flow(NamedTuple):
    y: Any
    t: Any


def time_map(rates, size: int, span: float, **options) -> wj.HybridSystem:
    """Return the flow y' = rates(y, t) over a time span as a map."""

    class TimeMap(wj.HybridSystem):
        section = tuple(f"y{i}" for i in range(size))

        def lift(self, x):
            return Flow(tuple(x), 0 * x[0])

        def project(self, state):
            return jnp.stack(state.y)

        def modes(self):
            field = lambda s: Flow(tuple(rates(jnp.stack(s.y), s.t)), 1 + 0 * s.t)
            return {
                "flow": wj.Mode(field, (wj.Guard(lambda s: s.t - span, wj.SECTION),), **options)
            }

    return TimeMap()


def jacobian(system: wj.HybridSystem, x) -> np.ndarray:
    return np.asarray(jax.jacfwd(lambda x: wj.stride(system, x).state)(jnp.asarray(x)))


# --------------------------------------------------------------------------------- derivatives


def nagumo(y):
    return jnp.stack([10 * (y[0] - y[0] ** 3 - y[1]), -3 * y[1] + y[0]])


def battery(y):
    """Thermal runaway of two cells: fast reactions beside slow heat."""
    reaction = jnp.tanh(10 * y[0] - 4.5)
    first, second = jnp.exp(0.22 * y[1] - 9.4), jnp.exp(0.22 * y[2] - 9.4)
    charge = (first * (1 - y[0] ** 2) - 2.2 * reaction - 2.2) / 100
    heat = y[2] - y[1]
    return jnp.stack([charge, 2.2 * reaction + 2.2 - first + heat * 4.32, 3 - second - heat * 0.48])


def lorenz(y):
    return jnp.stack([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])


def rossler(y):
    return jnp.stack([-y[1] - y[2], y[0] + 0.2 * y[1], 0.2 + y[2] * (y[0] - 5.7)])


def brusselator(y):
    return jnp.stack([1 + y[0] ** 2 * y[1] - 2.7 * y[0], 1.7 * y[0] - y[0] ** 2 * y[1]])


def lotka_volterra(y):
    return jnp.stack([y[0] * (3 - y[0] - y[1]), y[1] * (y[0] - 1)])


def damped_pendulum(y):
    return jnp.stack([y[1], -jnp.sin(y[0]) - 30 * y[1] + 0.5])


def duffing(y):
    return jnp.stack([y[1], y[0] - y[0] ** 3 - 0.3 * y[1]])


def slow_manifold(y):
    return jnp.stack([-(y[0] - 1), -200 * (y[1] - y[0] ** 2)])


def steered(y):
    """A course held by a saturated rudder."""
    return jnp.stack([y[1], -40 * jnp.tanh(5 * y[0]) - 8 * y[1] + 3 * (y[0] - 0.1)])


MORE_FIXED_POINTS = [
    (lorenz, [0.0, 0.0, 0.0], 0.3),
    (damped_pendulum, [0.5, 0.0], 1.0),
    (slow_manifold, [1.0, 1.0], 0.1),
    (steered, [0.0, 0.0], 0.5),
    (battery, [0.45, 47.5, 47.6], 10.0),
    (lorenz, [8.5, 8.5, 27.0], 0.5),
    (rossler, [0.01, -0.03, 0.03], 3.0),
    (brusselator, [1.0, 1.7], 2.0),
    (lotka_volterra, [1.0, 2.0], 3.0),
    (duffing, [1.0, 0.0], 2.0),
]


class OneVariable(wj.HybridSystem):
    """A variable, beside time."""

    section = ("y",)

    def lift(self, x):
        return Flow(x[0], 0 * x[0])

    def project(self, state):
        return state.y[None]


@pytest.mark.parametrize(
    ("rates", "near", "span"),
    [
        (nagumo, [0.8, 0.27], 2.0),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in MORE_FIXED_POINTS),
    ],
)
def test_multipliers_of_fixed_points_of_flows(rates, near, span):
    """At an equilibrium the solution is constant, and its derivative is exp(T f')."""
    x = np.asarray(near)
    for _ in range(20):
        x = x - np.linalg.solve(np.asarray(jax.jacfwd(rates)(x)), np.asarray(rates(x)))
    values, vectors = np.linalg.eig(np.asarray(jax.jacfwd(rates)(x)))
    expected = ((vectors * np.exp(span * values)) @ np.linalg.inv(vectors)).real
    system = time_map(lambda y, t: rates(y), len(x), span)
    found = jacobian(system, x)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    each = [
        jax.jvp(lambda x: wj.stride(system, x).state, (jnp.asarray(x),), (jnp.asarray(one),))[1]
        for one in np.eye(len(x))
    ]
    np.testing.assert_allclose(np.transpose(each), found, rtol=0, atol=1e-9 * np.abs(found).max())


class Attracted(wj.HybridSystem):
    """y' towards 1, and z' towards y^2 at a rate of its own, over a tenth of a unit of time."""

    rate: Any = 1.0

    section = ("y", "z")

    def lift(self, x):
        return Flow((x[0], x[1]), 0 * x[0])

    def project(self, state):
        return jnp.stack(state.y)

    def modes(self):
        def field(s):
            y, z = s.y
            return Flow((1 - y, self.rate * (y**2 - z)), 1 + 0 * s.t)

        return {"flow": wj.Mode(field, (wj.Guard(lambda s: s.t - 0.1, wj.SECTION),))}


@pytest.mark.slow
def test_exponents_of_fixed_points_of_flows():
    """The eigenvalues of the field's Jacobian at (1, 1) are -1 and -rate."""
    rates = np.array([0.5, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0])
    many = Attracted(rates)
    found = wj.lyapunov(many, np.ones((len(rates), 2)), 20, walks=2, settling=0)
    expected = -0.1 * np.sort(np.stack([np.ones_like(rates), rates], axis=1), axis=1)
    np.testing.assert_allclose(found.exponents, expected, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [DOPRI8, diffrax.Tsit5()])
def test_multipliers_at_rest_by_runge_kutta_methods(solver):
    x = np.array([np.sqrt(2 / 3), np.sqrt(2 / 3) / 3])
    values = np.linalg.eigvals(np.asarray(jax.jacfwd(nagumo)(x)))
    system = time_map(lambda y, t: nagumo(y), 2, 1.0)
    end = lambda x: wj.stride(system, x, solver=solver, tolerance=1e-9).state
    found = np.linalg.eigvals(jax.jacfwd(end)(jnp.asarray(x)))
    np.testing.assert_allclose(np.sort(found), np.sort(np.exp(values)), rtol=0, atol=1e-6)


def test_a_multiplier_at_rest_by_a_runge_kutta_method():
    """y' = y^20 - 1 at y = 1: its derivative is exp(20 t)."""
    system = time_map(lambda y, t: y**20 - 1, 1, 0.5)
    end = lambda x: wj.stride(system, x, solver=DOPRI8, tolerance=1e-9).state
    np.testing.assert_allclose(jax.jacfwd(end)(jnp.ones(1)), [[np.exp(10)]], rtol=1e-6)


def test_derivatives_that_feel_what_the_solution_does_not():
    """y' = (gain - y) r with r = (1 + tanh((t - 5) / w)) / 10, which is 0 until t = 5, then 1/5.

    With y = gain = 0 the solution rests; dy/dx and dy/dgain are exp(-1) and 1 - exp(-1).
    """

    class Switched(OneVariable):
        gain: Any

        def modes(self):
            rate = lambda t: (1 + jnp.tanh((t - 5) / 1e-2)) / 10
            field = lambda s: Flow((self.gain - s.y) * rate(s.t), 1 + 0 * s.t)
            return {"flow": wj.Mode(field, (wj.Guard(lambda s: s.t - 10, wj.SECTION),))}

    end = lambda gain, x: wj.stride(Switched(gain), x[None]).state[0]
    zero, one = jnp.zeros(()), jnp.ones(())
    for direction, expected in (((zero, one), np.exp(-1)), ((one, zero), 1 - np.exp(-1))):
        _, change = jax.jvp(end, (zero, zero), direction)
        np.testing.assert_allclose(change, expected, rtol=1e-9)


def test_derivatives_by_parameters_and_of_second_order_at_rest():
    """y' = -60 (y - a^2 b) from y = a^2 b: derivatives are those of a^2 b, times 1 - e^-60."""

    class Relaxation(OneVariable):
        numbers: Any

        def modes(self):
            a, b = self.numbers
            field = lambda s: Flow(-60 * (s.y - a**2 * b), 1 + 0 * s.t)
            return {"flow": wj.Mode(field, (wj.Guard(lambda s: s.t - 1, wj.SECTION),))}

    end = lambda numbers: wj.stride(Relaxation(numbers), jnp.asarray([18.0])).state[0]
    numbers, share = jnp.array([3.0, 2.0]), 1 - np.exp(-60)
    np.testing.assert_allclose(jax.jacfwd(end)(numbers), [12 * share, 9 * share], rtol=1e-9)
    expected = np.array([[4.0, 6.0], [6.0, 0.0]]) * share
    np.testing.assert_allclose(jax.hessian(end)(numbers), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_second_derivatives_along_several_directions_at_once():
    system = time_map(lambda y, t: rossler(y), 3, 1.0)
    x, end = jnp.asarray([1.0, -0.5, 0.2]), lambda x: wj.stride(system, x).state
    slopes, width = jax.jit(jax.vmap(jax.jacfwd(end))), 1e-4
    differences = (slopes(x + width * jnp.eye(3)) - slopes(x - width * jnp.eye(3))) / (2 * width)
    found = jax.jacfwd(jax.jacfwd(end))(x)
    np.testing.assert_allclose(found, np.moveaxis(differences, 0, -1), rtol=0, atol=1e-7)


def test_directions_at_once_share_the_solution():
    """Two directions take much less than two programs of one, whichever is made first."""
    walker, x, integrator = prepare(wj.SimplestWalker(0.004), jnp.asarray([0.2, -0.2]), None)
    program, *_ = follow_stride.find_program((walker, x, integrator), {})
    by = (1,)
    assert program.operands[1].shape == (2,)
    one, two = (program.derivative(by, count).size for count in (1, 2))
    assert two < 1.5 * one
    assert one < 2.7 * program.size


def test_derivatives_in_float32():
    system = time_map(lambda y, t: nagumo(y), 2, 1.0)
    x = jnp.asarray([np.sqrt(2 / 3), np.sqrt(2 / 3) / 3], jnp.float32)
    found = jax.jacfwd(lambda x: wj.stride(system, x).state)(x)
    assert found.dtype == jnp.float32
    values = np.linalg.eigvals(np.asarray(jax.jacfwd(nagumo)(np.asarray(x, float))))
    expected = np.sort(np.exp(values))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(found)), expected, rtol=0, atol=1e-5)


# ------------------------------------------------------------------------------ sharp features


class Height(NamedTuple):
    y: Any
    v: Any


class SoftBall(wj.HybridSystem):
    """A ball that falls from rest on stiff exponential ground, from apex to apex, without loss."""

    section = ("height",)

    def lift(self, x):
        return Height(x[0], 0 * x[0])

    def project(self, state):
        return state.y[None]

    def modes(self):
        field = lambda s: Height(s.v, jnp.exp(-s.y / 0.01) - 1)
        return {
            "fall": wj.Mode(field, (wj.Guard(lambda s: s.v, "rise"),)),
            "rise": wj.Mode(field, (wj.Guard(lambda s: -s.v, wj.SECTION),)),
        }


@pytest.mark.slow
def test_a_ball_on_soft_ground_returns_to_its_height():
    heights = jnp.asarray([[0.3], [0.4], [0.6], [1.0], [3.0]])
    end = jax.vmap(lambda x: wj.stride(SoftBall(), x))(heights)
    np.testing.assert_allclose(end.state, heights, rtol=1e-9)
    slopes = jax.vmap(jax.jacfwd(lambda x: wj.stride(SoftBall(), x).state))(heights)
    np.testing.assert_allclose(slopes, 1, rtol=1e-7)


FRICTIONS = [
    (lambda y: jax.nn.sigmoid(y / 0.01) - 0.5, 0.01 * np.log(0.8 / 0.2)),
    (lambda y: 0.01 * jax.nn.softplus(y / 0.01), 0.01 * np.log(np.exp(30) - 1)),
    (lambda y: 0.5 * jax.scipy.special.erf(y / 0.01), 0.00595116081449995),  # erfinv(0.6)
    (lambda y: jnp.exp(-(((y - 1) / 0.01) ** 2)), 1 + 0.01 * np.sqrt(np.log(1 / 0.3))),
]


@pytest.mark.parametrize(
    ("friction", "rest"),
    [
        (lambda y: 0.5 * jnp.tanh(y / 0.01), 0.01 * np.arctanh(0.6)),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in FRICTIONS),
    ],
)
def test_a_slide_that_smooth_friction_stops(friction, rest):
    """y' = +-(0.3 - friction(y)) comes to rest where the friction is 0.3."""
    sign = 1 if rest < 1 else -1
    system = time_map(lambda y, t: sign * (0.3 - friction(y)), 1, 60.0)
    end = wj.stride(system, jnp.asarray([2.0])).state[0]
    np.testing.assert_allclose(end, rest, rtol=1e-9)


@pytest.mark.slow
def test_a_torque_that_is_switched_smoothly():
    """Checked against DOP853 with short steps."""

    class Gated(wj.SimplestWalker):
        width: Any = 1e-4

        def vector_field(self, state):
            rates = super().vector_field(state)
            torque = 0.025 * (1 - jnp.tanh((state.theta + 0.05) / self.width))
            return rates._replace(phidot=rates.phidot + torque)

    def rates(t, y):
        fall = np.sin(y[0] - 0.009)
        swing = fall + np.sin(y[1]) * (y[2] ** 2 - np.cos(y[0] - 0.009))
        return [y[2], y[3], fall, swing + 0.025 * (1 - np.tanh((y[0] + 0.05) / 1e-4))]

    strike: Any = lambda t, y: y[1] - 2 * y[0]
    strike.terminal, strike.direction = True, 1
    options: Any = dict(rtol=1e-12, atol=1e-13, method="DOP853", max_step=0.01)
    q, rate = 0.2003, -0.1998
    start = [q, 2 * q, rate, (1 - np.cos(2 * q)) * rate]
    first = solve_ivp(rates, [0, 1.5], start, **options).y[:, -1]
    end = solve_ivp(rates, [1.5, 8], first, events=strike, **options).y[:, -1]
    found = wj.stride(Gated(0.009), jnp.asarray([q, rate])).state
    np.testing.assert_allclose(found, [-end[0], np.cos(2 * end[0]) * end[2]], rtol=1e-9)


def test_a_guard_with_a_sharp_feature():
    """The guard tanh((t - 3) / w) + 1/2 is -1/2 from the start to just before it rises."""

    class Alarm(OneVariable):
        def modes(self):
            field = lambda s: Flow(-jnp.sin(s.y), 1 + 0 * s.t)
            guard = wj.Guard(lambda s: jnp.tanh((s.t - 3) / 1e-3) + 0.5, wj.SECTION)
            return {"flow": wj.Mode(field, (guard,))}

    found = wj.stride(Alarm(), jnp.asarray([1.0]))
    np.testing.assert_allclose(found.time, 3 - 1e-3 * np.arctanh(0.5), rtol=1e-12)


def test_the_longest_step_shows_a_short_pulse():
    """A pulse in which no step would end is seen if steps are as short."""
    pulse = lambda y, t: jnp.exp(-(((t - 5) / 1e-2) ** 2)) + 0 * y
    system = time_map(pulse, 1, 10.0, longest_step=2e-2)
    end = wj.stride(system, jnp.asarray([0.0])).state[0]
    np.testing.assert_allclose(end, 1e-2 * np.sqrt(np.pi), rtol=1e-10)


def test_the_longest_step_of_a_walker_is_that_of_its_modes():
    class Careful(wj.KneedWalker):
        longest_step = 0.05

    modes = {**Careful(0.009).modes()}
    assert len(modes) > 1 and all(one.longest_step == 0.05 for one in modes.values())


def test_which_functions_are_sharp():
    y = jnp.asarray(0.5)
    sharp = [jnp.exp, jnp.tanh, jax.nn.softplus, jax.nn.sigmoid, lambda y: y**20]
    sharp += [jax.scipy.special.erf, lambda y: jnp.exp(-(y**2))]
    assert all(has_sharp_features(one, y) for one in sharp)
    plain = [jnp.sin, lambda y: 1 / y**2, jnp.sqrt, jnp.log, lambda y: y**4, lambda y: y**1.5]
    assert not any(has_sharp_features(one, y) for one in plain)


# ---------------------------------------------------------------------------- small variables


def test_a_clock_does_not_hide_a_small_motion():
    """A pendulum forced by 1e-12 cos(t/2) is linear: 4/3 1e-12 (cos(t/2) - cos t)."""
    rates = lambda y, t: jnp.stack([y[1], -jnp.sin(y[0]) + 1e-12 * jnp.cos(t / 2)])
    found = wj.stride(time_map(rates, 2, 200.0), jnp.zeros(2)).state[0]
    np.testing.assert_allclose(found, 4e-12 / 3 * (np.cos(100) - np.cos(200)), rtol=1e-9)


def test_which_states_may_hold_clocks():
    walker = wj.SimplestWalker(0.009)
    start = walker.lift(jnp.asarray([0.2, -0.2]))
    assert not may_have_clocks(walker.vector_field, start)
    number = jnp.asarray(1.0)
    assert may_have_clocks(lambda s: Flow(jnp.sin(s.y), 1 + 0 * s.t), Flow(number, number))
    assert may_have_clocks(lambda s: Height(s.v, -1.0), Height(number, number))
    assert not may_have_clocks(lambda s: Height(s.v, -jnp.sin(s.y)), Height(number, number))


class Animals(NamedTuple):
    prey: Any
    predators: Any
    t: Any


class Grazing(wj.HybridSystem):
    """Predators and prey, whose numbers fall to 3e-16 between outbreaks."""

    scaled: bool = eqx.field(static=True, default=False)

    section = ("predators",)

    def lift(self, x):
        return Animals(5.0 + 0 * x[0], x[0], 0 * x[0])

    def project(self, state):
        return state.predators[None]

    def modes(self):
        def field(s):
            eaten = 2.5 * s.prey * s.predators / (s.prey + 1)
            growth = 0.8 * s.prey * (1 - s.prey / 15)
            return Animals(growth - eaten, 0.5 * eaten - 0.4 * s.predators, 1 + 0 * s.t)

        scales = Animals(1e-20, 1e-20, 1.0) if self.scaled else None
        return {
            "flow": wj.Mode(field, (wj.Guard(lambda s: 5 - s.prey, wj.SECTION),), scales=scales)
        }


@pytest.mark.parametrize(
    ("scaled", "solver"),
    [
        (False, None),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in ((True, None), (False, DOPRI8))),
    ],
)
def test_variables_of_very_different_size(scaled, solver):
    """The time between outbreaks, checked against DOP853 for the logarithms."""

    def rates(t, u):
        prey, predators = np.exp(u)
        eaten = 2.5 / (prey + 1)
        return [0.8 * (1 - prey / 15) - eaten * predators, 0.5 * eaten * prey - 0.4]

    event: Any = lambda t, u: np.log(5) - u[0]
    event.terminal, event.direction = True, 1
    options: Any = dict(rtol=1e-13, atol=1e-13, method="DOP853")
    x = 5.342859213670063
    away = solve_ivp(rates, [0, 1e-3], [np.log(5), np.log(x)], **options).y[:, -1]
    back = solve_ivp(rates, [1e-3, 500], away, events=event, **options)
    found = wj.stride(Grazing(scaled), jnp.asarray([x]), solver=solver)
    np.testing.assert_allclose(found.time, back.t[-1], rtol=1e-10)
    np.testing.assert_allclose(found.state[0], np.exp(back.y[1, -1]), rtol=1e-10)


def test_variables_whose_errors_are_relative_to_themselves():
    """Those whose rate is zero where they are, in scalars and arrays; constant ones are none."""
    rates = jnp.array([[0.0, 1.0, 2.0], [1.0, 0.0, -1.0], [0.5, 1.0, 0.0]])

    def field(y):
        numbers, forced, still = y
        growth = numbers * (1 - rates @ numbers) + jnp.array([0.0, 0.0, 1e-3])
        return growth, jnp.sin(forced) * numbers[1] + forced / (1 + numbers[0]) ** 2, 0 * still

    state = jnp.ones(3), jnp.ones(()), jnp.ones(())
    known: Any = proportional_variables(field, state)
    numbers, forced, _ = known
    assert numbers.tolist() == [True, True, False] and bool(forced)
    swings = lambda y: (y[1], -jnp.sin(y[0]) - 0.1 * y[1])
    assert proportional_variables(swings, (1.0, 0.5)) is None
    flies = lambda y: (y[1], 0.0 * jnp.ones_like(y[0]))
    assert proportional_variables(flies, (1.0, 0.5)) is None


class Decaying(Clocked):
    scales: Any = None

    def slope(self, y, t):
        return -y

    def modes(self):
        return {"flow": super().modes()["flow"]._replace(scales=self.scales)}


@pytest.mark.parametrize("scales", [None, jnp.array([1.0, 1e-3])])
def test_a_state_that_is_one_array_has_a_size_for_each_number(scales):
    made = wj.strides(Decaying(scales), np.array([[0.5], [1e-9]]))
    np.testing.assert_allclose(made.state[:, 0], [0.5 / np.e, 1e-9 / np.e], rtol=1e-11)


@pytest.mark.parametrize("width", [64, 128])
def test_numbers_of_large_arrays_are_not_examined_one_by_one(width, monkeypatch):
    """Numbers that grow by a network are found all the same: their own factor shows it."""
    first, second = np.ones((width, 2)), np.ones((width, width))

    def field(y):
        hidden = jnp.tanh(second @ jnp.tanh(first @ jnp.stack(y)))
        return y[0] * hidden[0], y[1] * hidden[1] + hidden[2]

    examined = []
    one = own_sizes.Zeros.term
    monkeypatch.setattr(
        own_sizes.Zeros, "term", lambda self, *of: examined.append(0) or one(self, *of)
    )
    assert proportional_variables(field, (1.0, 0.5)) == (np.array(True), np.array(False))
    assert len(examined) < 40 * width
