"""All walkers: wrong parameters, derivatives, and one walker among many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences, stacked, strides
from planar_walkers import CLASSES, GAIT, GAITS, SLOW, name

import walker_jax as wj
from walker_jax import (
    Outcome,
    PointFootWalker,
    RoundFootWalker,
    SimplestWalker,
    SpringWalker,
    State,
    UpperBodyWalker,
)
from walker_jax.gaits.cycles import linearise
from walker_jax.identity import Cache
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import program
from walker_jax.walkers.parameters import parameters

# Ways to fail


class Uneven(wj.HeavyLegWalker):
    """A walker whose swing leg is longer than its stance leg."""

    slope: jax.Array
    longer: jax.Array

    def system(self):
        return RoundFootWalker(self.slope).system()

    def swing_foot(self, q):
        hip = q[:2] + jnp.stack([-jnp.sin(q[2]), jnp.cos(q[2])])
        swing = q[2] - q[3]
        return hip - (1 + self.longer) * jnp.stack([-jnp.sin(swing), jnp.cos(swing)])


def test_legs_that_are_not_alike_are_refused():
    assert Uneven(jnp.asarray(0.01), jnp.asarray(0.0)).longer == 0
    with pytest.raises(ValueError, match="swing_foot of Uneven must be on the slope"):
        Uneven(jnp.asarray(0.01), jnp.asarray(0.01))
    slope, longer = jnp.asarray(0.01), jnp.asarray(0.0)
    assert jax.jit(lambda a: a * Uneven(slope, longer).slope)(2.0) == 0.02
    assert jax.jit(lambda a: a * RoundFootWalker(slope).slope)(2.0) == 0.02


@pytest.mark.parametrize(
    ("walker", "named"),
    [
        (RoundFootWalker(0.01), None),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, 0.02, 0.03])), None),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, 0.02])), r"slope .*3, not of shape \(2,\)"),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, -0.02, 0.03])), r"slope .*-0.02"),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, jnp.nan, 0.03])), r"slope .*nan"),
    ],
)
def test_parameters_that_are_arrays_are_checked(walker, named):
    xs = np.tile(GAITS[RoundFootWalker][1], (3, 1))
    if named is None:
        assert wj.strides(walker, xs).outcome.shape == (3,)
        return
    with pytest.raises(ValueError, match=named):
        wj.strides(walker, xs)


# Derivatives

TOLERANCE = jnp.asarray(np.float64(1e-12))  # of a type as in gaits, which compiles it once


def derivative_cases():
    points = {
        SpringWalker: (SpringWalker(0.009, 0.5), [0.19, -0.19]),
        PointFootWalker: (PointFootWalker(0.009, 0.01), [0.2, -0.2]),
        RoundFootWalker: (RoundFootWalker(0.01, leg_length=1.2), [0.189, -0.239, -0.0514]),
        UpperBodyWalker: (UpperBodyWalker(0.01, body_inertia=0.01), [0.196, -0.2434, -0.033]),
    }
    fast = {PointFootWalker}
    return [
        pytest.param(*point, marks=() if cls in fast else SLOW, id=cls.__name__)
        for cls, point in points.items()
    ]


@pytest.mark.parametrize(("walker", "x"), derivative_cases())
def test_derivatives_equal_extrapolated_differences(walker, x):
    """Of the next state, by the start and by every parameter, to the largest of a row."""
    names = [parameter.name for parameter in parameters(walker)]
    values = np.array([float(getattr(walker, name)) for name in names])
    cycle = np.array([[x]])
    found = [linearise(walker, cycle, Integrator(TOLERANCE), name) for name in names]
    jacobian = np.concatenate(
        [found[0].jacobian[0, 0], np.stack([each.by_parameter[0, 0] for each in found], axis=1)],
        axis=1,
    )

    def following(zs):
        many = [type(walker)(*z[len(x) :]) for z in zs]
        return linearise(stacked(many), zs[:, None, : len(x)], Integrator(TOLERANCE)).state[:, 0]

    steps = 4e-4 * np.concatenate([np.ones(len(x)), np.maximum(values, 0.25)])
    steps[len(x) + np.flatnonzero(np.isin(names, ["slope", "foot_mass"]))] = 1e-4
    expected = differences(following, np.concatenate([x, values]), steps)
    assert np.isfinite(jacobian).all()
    errors = np.abs(jacobian - expected) / np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(errors) < 1e-7, (jacobian, expected)


# One by one, many, and many walkers


@pytest.mark.slow
@pytest.mark.parametrize("cls", [SpringWalker, RoundFootWalker, UpperBodyWalker], ids=name)
def test_a_stride_is_the_same_alone_and_among_other_walkers(cls):
    """Parameters are numbers, or arrays with one for each start."""
    walker, x, _ = GAITS[cls]
    scales = np.array([1.0, 1.02, 0.6, 1.6, -1.0])
    xs = np.array(x) * np.stack([np.ones(5), *[scales] * (len(x) - 1)], axis=1)
    walkers = [walker, cls(0.02), walker, cls(0.015), walker]
    among = strides(walkers, xs)
    assert {Outcome.STRIDE, Outcome.OUTSIDE} < set(among.outcome.tolist())
    for i, (walker, x) in enumerate(zip(walkers, xs, strict=True)):
        alone = wj.stride(walker, x)
        assert alone.outcome == among.outcome[i]
        np.testing.assert_allclose(alone.state, among.state[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(alone.time, among.time[i], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_one_walker_is_as_many_that_are_equal():
    walker, x, _ = GAITS[SpringWalker]
    xs = np.array(x) * np.stack([np.ones(50), np.linspace(0.3, 2, 50)], axis=1)
    one, many = wj.strides(walker, xs), strides([walker] * len(xs), xs)
    np.testing.assert_array_equal(one.outcome, many.outcome)
    assert len(set(one.outcome.tolist())) > 1
    np.testing.assert_allclose(one.state, many.state, rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.time, many.time, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_strides_are_compiled_once_for_all_kinds_of_numbers(monkeypatch):
    monkeypatch.setattr(program, "programs", Cache())
    xs = np.array([GAIT["state"]])
    wj.strides(SimplestWalker(0.009), xs)
    count = len(program.programs)
    for slope in (0.008, np.float64(0.008), jnp.asarray(0.007, float), np.float32(0.006)):
        for tolerance in (None, 1e-12, np.float64(1e-12), jnp.asarray(1e-12, float)):
            found = wj.strides(SimplestWalker(slope), xs, tolerance=tolerance)
            assert found.outcome[0] == Outcome.STRIDE
    assert len(program.programs) == count > 0


# Parameters

EVERY = [(cls, parameter) for cls in CLASSES for parameter in parameters(cls)]


def refused(parameter):
    bad = [np.nan, np.inf, -np.inf]
    if parameter.low == 0:
        bad += [-0.1, -1e-300] + [0.0] * (not parameter.closed)
    return bad + ([2.0] if parameter.high < 2 else [])


def call(cls, **values):
    return cls(**{"slope": 0.01, **values})


@pytest.mark.parametrize(
    ("cls", "parameter"), EVERY, ids=lambda value: getattr(value, "name", None) or value.__name__
)
def test_bad_parameters_are_refused_in_one_line(cls, parameter):
    for value in refused(parameter):
        with pytest.raises(ValueError) as error:
            call(cls, **{parameter.name: value})
        message = str(error.value)
        assert message.startswith(f"{parameter.name} must be ") and "\n" not in message
        assert message.endswith(f"not {jnp.asarray(value)}") and len(message) < 100
    if parameter.closed:
        assert getattr(call(cls, **{parameter.name: 0}), parameter.name) == 0


def test_the_bounds_of_masses_and_lengths():
    """What may be zero, and what may be negative."""
    closed = {parameter.name for _, parameter in EVERY if parameter.closed}
    of_knees = {"thigh_mass", "thigh_inertia", "shank_inertia"}
    others = {"hip_stiffness", "hip_mass", "leg_inertia", "foot_radius", "body_inertia"}
    assert closed == others | of_knees
    signed = {parameter.name for _, parameter in EVERY if parameter.low < 0}
    assert signed == {"com_from_hip", "com_offset", "body_com", "thigh_com", "shank_com"}


@pytest.mark.parametrize("cls", [RoundFootWalker, UpperBodyWalker], ids=name)
def test_legs_that_cannot_be_are_refused(cls):
    for radius in (1.0, 1.5):
        with pytest.raises(ValueError, match=f"foot_radius must .*leg_length 1, not {radius:g}$"):
            cls(0.01, foot_radius=radius)
    with pytest.raises(ValueError, match=r"foot_radius must .*leg_length 0.1, not 0.2$"):
        cls(0.01, leg_length=0.1)
    with pytest.raises(ValueError, match=r"leg_inertia must be above 0 .*com_from_hip.*, not 0$"):
        cls(0.01, leg_inertia=0, com_from_hip=0)
    for turns in (dict(com_offset=0.1), dict(leg_inertia=1e-6), dict(com_from_hip=-0.1)):
        cls(0.01, **{"leg_inertia": 0.0, "com_from_hip": 0.0, **turns})


@pytest.mark.parametrize("cls", CLASSES, ids=name)
def test_parameters_are_leaves_and_other_values_compile_nothing(cls):
    traces = []

    @jax.jit
    def look(walker, state):
        traces.append(walker)
        return walker.vector_field(state)

    names = [parameter.name for parameter in parameters(cls)]
    plain = call(cls)
    assert jax.tree.leaves(plain) == [getattr(plain, name) for name in names]
    state = State(*map(jnp.asarray, (0.2, 0.3, -0.2, 0.1)))
    fields = [look(plain, state)]
    for parameter in parameters(cls):
        value = 1.1 * parameter.default + (0.01 if parameter.default == 0 else 0)
        fields.append(look(call(cls, **{parameter.name: value}), state))
    assert len(traces) == 1
    assert all(np.isfinite(field).all() for field in fields)
    assert len({float(field.phidot) for field in fields}) > 1


@pytest.mark.parametrize("cls", CLASSES, ids=name)
def test_float32_is_kept(cls):
    values = {p.name: np.float32(p.default) for p in parameters(cls)}
    walker = cls(**values)
    state = State(*map(jnp.float32, (-0.2, -0.4, -0.2, 0.1)))
    assert {leaf.dtype for leaf in jax.tree.leaves(walker)} == {jnp.dtype("float32")}
    section = jnp.array(GAITS[cls][1], jnp.float32)
    results = [walker.lift(section), walker.project(state), walker.contact(state)]
    for method in ("vector_field", "contact_force", "impact", "impulse", "energy"):
        if hasattr(walker, method):
            results.append(jax.eval_shape(getattr(walker, method), state))
    assert {leaf.dtype for leaf in jax.tree.leaves(results)} == {jnp.dtype("float32")}


@pytest.mark.slow
def test_float32_strides_are_those_of_float64():
    walker, x, _ = GAITS[RoundFootWalker]
    xs = np.array(x) * np.linspace(0.98, 1.02, 9)[:, None]
    double = strides([walker] * len(xs), xs)
    single = wj.strides(stacked([walker] * len(xs)), xs.astype(np.float32))
    assert single.state.dtype == single.time.dtype == np.float32
    np.testing.assert_array_equal(single.outcome, double.outcome)
    assert (double.outcome == Outcome.STRIDE).sum() >= 5
    np.testing.assert_allclose(single.state, double.state, rtol=0, atol=5e-5)


@pytest.mark.slow
def test_a_step_down_has_the_limit_of_the_simplest_walker():
    x, drop = np.array([0.2, -0.2]), 2e-3
    limit = np.asarray(wj.stride(wj.SimplestWalker(0.009), x, step=-drop).state)
    errors = [
        np.abs(wj.stride(wj.PointFootWalker(0.009, mass), x, step=-drop).state - limit).max()
        for mass in (1e-3, 1e-4)
    ]
    assert 9.5 < errors[0] / errors[1] < 10.5
    spring = wj.stride(wj.SpringWalker(0.009, 0.0), x, step=-drop)
    np.testing.assert_allclose(spring.state, limit, rtol=0, atol=1e-12)
