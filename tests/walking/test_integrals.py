"""Integrals and largest values along a stride, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_measures import all_measures

import walker_jax as wj
from walker_jax.checks import WrongUse

X = jnp.array([0.7, 2.3])
BALL = wj.systems.BouncingBall(0.4, 0.8)


class Ball(wj.systems.BouncingBall):
    unit: float | jax.Array = 1.0

    def modes(self):
        rates = {
            "climb": lambda y: y.velocity,
            "effort": lambda y: self.unit * y.velocity**2,
            "time": lambda y: 1,
        }
        largest = {"height": lambda y: y.height, "speed": lambda y: y.velocity}
        (flight,) = super().modes().values()
        return {"flight": flight._replace(integrals=rates, largest=largest)}


class Stuck(wj.systems.StickSlip):
    def modes(self):
        time = lambda y: jnp.ones_like(y.x)
        slower = lambda y: self.kinetic * y.v
        power = {"slower": slower, "stick": lambda y: y.x * y.v, "faster": lambda y: -slower(y)}
        return {
            name: mode._replace(integrals={"time": time, "work": power[name]})
            for name, mode in super().modes().items()
        }


def in_closed_form(x):
    """Return the same of a ball that flies freely for as long as a stride takes."""
    time, velocity = wj.stride(BALL, x).time, x[1]
    end, start = velocity - time, BALL.amplitude * jnp.sin(x[0])
    return {
        "climb": velocity * time - time**2 / 2,
        "effort": (velocity**3 - end**3) / 3,
        "time": time,
        "height": start + velocity**2 / 2,
        "speed": velocity,
    }


@pytest.mark.parametrize("transform", [lambda f: f, jax.jacfwd, jax.jacrev])
def test_a_free_flight_has_its_integrals_and_largest_values(transform):
    found = transform(lambda x: wj.integrals(Ball(0.4, 0.8), x))(X)
    expected = transform(in_closed_form)(X)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12, err_msg=name)


class Whole(Ball):
    """Its equations have whole numbers among their rates."""

    def modes(self):
        (flight,) = super().modes().values()
        rates = lambda y: type(y)(y.velocity, -1, 1)
        return {"flight": flight._replace(field=rates)}


@pytest.mark.parametrize("kind", [Ball, Whole])
def test_the_size_of_an_integral_changes_no_other_digit(kind):
    small, large = (wj.integrals(kind(0.4, 0.8, unit), X) for unit in (1e-12, 1e12))
    for name in ("climb", "time", "height"):
        assert small[name] == large[name]
    assert large["effort"] == pytest.approx(1e24 * float(small["effort"]), rel=1e-14)


def test_parameters_have_derivatives():
    effort = lambda unit: wj.integrals(Ball(0.4, 0.8, unit), X)["effort"]
    assert jax.grad(effort)(2.0) == pytest.approx(float(effort(1.0)), rel=1e-14)


def test_a_failed_stride_has_none_and_others_keep_theirs():
    xs = jnp.stack([X, X.at[1].set(-1.0)])
    found = jax.vmap(lambda x: wj.integrals(Ball(0.4, 0.8), x))(xs)
    for name, value in wj.integrals(Ball(0.4, 0.8), X).items():
        assert found[name][0] == value
        assert np.isnan(found[name][1])


def test_modes_that_are_entered_again_add_up():
    machine = Stuck()
    drop, speed = float(machine.static) - float(machine.kinetic), float(machine.speed)
    radius = np.hypot(drop, speed)
    x = jnp.asarray(machine.kinetic + radius)[None]  # where it turns back, in closed form
    whole = lambda x: (found := wj.integrals(Stuck(), x), found)
    by, found = jax.jacfwd(whole, has_aux=True)(x)
    period = np.pi + 2 * np.arctan2(speed, drop) + 2 * drop / speed
    assert found["time"] == pytest.approx(period, abs=1e-12)
    # Friction gives the block what it has gained when it turns back: (x'^2 - x^2) / 2.
    assert found["work"] == pytest.approx(0.0, abs=1e-13)
    assert by["work"][0] == pytest.approx(
        -float(x[0]), abs=1e-12
    )  # the next turn is at the same place


def test_gravity_does_the_work_that_the_leg_gains():
    class Weighed(wj.SimplestWalker):
        def modes(self):
            gain = lambda y: jnp.sin(y.theta - self.slope) * y.thetadot
            rates = {"gain": gain}
            return {name: one._replace(integrals=rates) for name, one in super().modes().items()}

    plain, x = wj.SimplestWalker(0.004), jnp.array([0.15, -0.15])
    end = wj.trajectory(plain, x, wj.stride(plain, x).time[None])
    gained = (end.thetadot[0] ** 2 - x[1] ** 2) / 2
    assert wj.integrals(Weighed(0.004), x)["gain"] == pytest.approx(float(gained), abs=1e-14)


def test_solvers_agree():
    diffrax = pytest.importorskip("diffrax")
    found = wj.integrals(Ball(0.4, 0.8), X, solver=diffrax.Dopri8())
    for name, value in wj.integrals(Ball(0.4, 0.8), X).items():
        assert found[name] == pytest.approx(float(value), rel=1e-9)


def test_functions_must_be_named():
    with pytest.raises(WrongUse, match="as no mode of BouncingBall does"):
        wj.integrals(BALL, X)
    with pytest.raises(WrongUse, match="system must name functions"):
        wj.integrals(wj.Map(lambda x: x / 2, ("x",)), [1.0])


def test_an_integral_and_a_largest_value_need_two_names():
    class Twice(wj.systems.BouncingBall):
        def modes(self):
            (flight,) = super().modes().values()
            of = {"height": lambda y: y.height}
            return {"flight": flight._replace(integrals=of, largest=of)}

    with pytest.raises(
        WrongUse, match="must have other names than its largest values, unlike 'height'"
    ):
        wj.integrals(Twice(), X)


@pytest.mark.slow
def test_gaits_have_the_means_of_their_integrals():
    """The block turns back at the same place for any belt: the time is its period alone."""

    def period(speed):
        return np.pi + 2 * np.arctan2(speed, 0.5) + 1 / speed

    gait = wj.find_gait(Stuck())
    found = {one: wj.measure(Stuck(), one, ["speed"], gait) for one in ("time", "work")}
    np.testing.assert_allclose(found["time"].value, period(0.5), atol=1e-12)
    np.testing.assert_allclose(found["time"].gradient, 2 / (1 + 1) / 0.5 - 4, atol=1e-11)
    np.testing.assert_allclose(found["work"].value, 0, atol=1e-12)
    np.testing.assert_allclose(found["work"].gradient, 0, atol=1e-11)


def test_the_name_of_an_integral_is_no_measure_of_gaits():
    class Fast(wj.systems.BouncingBall):
        def modes(self):
            (flight,) = super().modes().values()
            return {"flight": flight._replace(integrals={"speed": lambda y: y.velocity})}

    of_ball = wj.find_gait(BALL)
    with pytest.raises(WrongUse, match="must not be named 'speed'"):
        all_measures(Fast(), ["restitution"], of_ball)
