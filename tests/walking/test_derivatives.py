"""Strides, walks, gaits and margins under JAX's transformations, of all walkers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences

import walker_jax as wj
from walker_jax import (
    KneedWalker,
    Outcome,
    PointFootWalker,
    RoundFootWalker,
    SimplestWalker,
    SpringWalker,
    UpperBodyWalker,
)
from walker_jax.identity import Cache
from walker_jax.kernels import primitive, program
from walker_jax.walkers.parameters import parameters

SLOW = pytest.mark.slow
STARTS = {
    SimplestWalker: (SimplestWalker(0.009), [0.2003109, -0.1998325]),
    SpringWalker: (SpringWalker(0.009, 2.0), [0.1718, -0.2192]),
    PointFootWalker: (PointFootWalker(0.009, 1e-3), [0.200161, -0.199906]),
    RoundFootWalker: (RoundFootWalker(0.01, leg_length=1.2), [0.18944, -0.23901, -0.0514]),
    UpperBodyWalker: (UpperBodyWalker(0.01), [0.196, -0.2434, -0.033]),
    KneedWalker: (
        # With a shank_inertia 5 % below 0.001 the foot's least height is no more in front, and the
        # landing margin jumps: differences would step over that.
        KneedWalker(0.05, thigh_inertia=0.01, shank_inertia=0.002, foot_radius=0.05),
        [0.2482, -0.3581, -0.2933],
    ),
}
"""A walker of each kind and a start close to a gait of it."""
TIMES = np.array([0.4, 1.1])
GROUND = np.array([1e-4])


def found(gait):
    multipliers = gait.multipliers
    return gait.states, multipliers.real, multipliers.imag, gait.step_times


QUANTITIES = {
    "stride": lambda walker, x: (wj.stride(walker, x).state, wj.stride(walker, x).time),
    "rough": lambda walker, x: wj.stride(walker, x, step=1e-4)[::2],
    "rough walk": lambda walker, x: wj.walk(walker, x, 1, ground=GROUND).states[-1],
    "walk": lambda walker, x: (wj.walk(walker, x, 3).states[1:], wj.walk(walker, x, 3).times),
    "trajectory": lambda walker, x: tuple(wj.trajectory(walker, x, TIMES)),
    "margins": lambda walker, x: tuple(wj.margins(walker, x).by_name.values()),
    "gait": lambda walker, x: found(wj.find_gait(walker, x)),
}


def of_numbers(cls, quantity):
    """A quantity as a function of one vector, of the start and all parameters."""
    size = len(cls.section)

    def function(z):
        leaves = jax.tree.leaves(QUANTITIES[quantity](cls(*z[size:]), z[:size]))
        return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])

    return function


def point(cls):
    walker, x = STARTS[cls]
    names = [parameter.name for parameter in parameters(cls)]
    values = np.array([float(getattr(walker, name)) for name in names])
    steps = 4e-4 * np.concatenate([np.ones(len(x)), np.maximum(values, 0.25)])
    steps[len(x) + np.flatnonzero(np.isin(names, ["slope", "foot_mass"]))] = 1e-4
    return jnp.asarray([*x, *values]), steps


def assert_close(found, expected, tolerance):
    """Relative to the largest of a row."""
    assert np.isfinite(found).all()
    scale = np.maximum(np.abs(expected).max(axis=-1, keepdims=True), 1e-3)
    assert np.max(np.abs(found - expected) / scale) < tolerance, (found, expected)


QUICK = {(SimplestWalker, quantity) for quantity in ("stride", "trajectory")}
CASES = [
    pytest.param(
        cls,
        quantity,
        marks=() if (cls, quantity) in QUICK else SLOW,
        id=f"{cls.__name__}-{quantity}",
    )
    for cls in STARTS
    for quantity in QUANTITIES
    if quantity != "rough walk"  # of one stride, "rough"
]


@pytest.mark.parametrize(("cls", "quantity"), CASES)
def test_derivatives_in_either_mode_are_those_of_differences(cls, quantity, monkeypatch):
    """By the start and all parameters."""
    if (cls, quantity) in QUICK:  # directions are cells, so that there is one program
        monkeypatch.setattr(primitive, "MAX_OPERATIONS", (0, 0))
    function = of_numbers(cls, quantity)
    z, steps = point(cls)
    v = jnp.cos(jnp.arange(1.0, len(z) + 1))
    weights = lambda value: jnp.sin(jnp.arange(1.0, len(value) + 1))

    @jax.jit
    def look(z):
        along = jax.jvp(function, (z,), (v,))[1]
        gradient = jax.grad(lambda z: weights(along) @ function(z))(z)
        return jax.jacfwd(function)(z), jax.jacrev(function)(z), along, gradient

    forward, reverse, along, gradient = map(np.asarray, look(z))
    # Of several strides it is a product, in which large numbers cancel.
    tolerance = 1e-10 if quantity in ("walk", "gait") else 1e-11
    assert_close(reverse, forward, tolerance)
    close = {"rtol": tolerance, "atol": tolerance * abs(forward).max()}
    np.testing.assert_allclose(along, forward @ v, **close)
    np.testing.assert_allclose(gradient, weights(along) @ forward, **close)
    assert_close(forward, differences(jax.jit(jax.vmap(function)), z, steps), 1e-7)


FAILING = {
    Outcome.FORWARD: [0.2, -0.25],
    Outcome.BACKWARD: [0.2, -0.1],
    Outcome.RUNNING: [0.2, -1.1],
    Outcome.OUTSIDE: [0.9, -0.1],
}
"""Starts from which the first stride fails, at slope 0.009."""


@pytest.mark.parametrize(
    "quantity",
    ["stride", *(pytest.param(name, marks=SLOW) for name in ("rough", "rough walk", "walk"))],
)
def test_derivatives_of_what_fails_are_nan(quantity, monkeypatch):
    """In either mode, by the start and all parameters; those of what succeeds are not."""
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (0, 0))
    function = of_numbers(SimplestWalker, quantity)
    starts = [STARTS[SimplestWalker][1], *FAILING.values()]
    zs = jnp.asarray([[*x, 0.009] for x in starts])
    both = jax.jit(jax.vmap(lambda z: (jax.jacfwd(function)(z), jax.jacrev(function)(z))))
    for jacobian in both(zs):
        assert np.isfinite(jacobian[0]).all() and np.isnan(jacobian[1:]).all()
    if quantity == "stride":
        first = lambda zs: jnp.where(jnp.arange(len(zs)) == 0, jax.vmap(function)(zs)[:, 0], 0.0)
        gradient = jax.jit(jax.grad(lambda zs: first(zs).sum()))(zs)
        np.testing.assert_allclose(gradient[0], both(zs)[1][0, 0], rtol=1e-12)
        assert (gradient[1:] == 0).all()  # what is left out has no part


@pytest.mark.slow
def test_second_derivatives_of_what_fails_are_nan():
    function = of_numbers(SimplestWalker, "stride")
    zs = jnp.asarray([[*x, 0.009] for x in [STARTS[SimplestWalker][1], *FAILING.values()]])
    twice = jax.jit(jax.vmap(jax.hessian(lambda z: function(z)[0])))(zs)
    assert np.isfinite(twice[0]).all() and np.isnan(twice[1:]).all()


@pytest.mark.slow
def test_derivatives_of_what_fails_are_nan_without_kernels(monkeypatch):
    monkeypatch.setattr(program, "programs", Cache())
    monkeypatch.setenv("WALKER_JAX_KERNELS", "off")
    gradient = jax.grad(lambda z: of_numbers(SimplestWalker, "stride")(z)[0])
    starts = [STARTS[SimplestWalker][1], *FAILING.values()]
    found = jax.jit(jax.vmap(gradient))(jnp.asarray([[*x, 0.009] for x in starts]))
    assert np.isfinite(found[0]).all() and np.isnan(found[1:]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "modes"),
    [("stride", "forward"), ("stride", "reverse"), ("gait", "forward"), ("gait", "reverse")],
)
def test_hessians_are_differences_of_gradients(quantity, modes, monkeypatch):
    """Of the simplest walker, in three of the four modes: forward of reverse, and two alike."""
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (0, 0))
    function = of_numbers(SimplestWalker, quantity)
    z, steps = point(SimplestWalker)
    weights = jnp.cos(jnp.arange(len(function(z))))
    single = lambda z: weights @ function(z)
    gradient = jax.grad(single)
    hessian = np.asarray(jax.jit(jax.hessian(single))(z))
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9, atol=1e-9 * abs(hessian).max())
    other = jax.jacrev(gradient) if modes == "reverse" else jax.jacfwd(jax.jacfwd(single))
    assert_close(np.asarray(jax.jit(other)(z)), hessian, 1e-10)
    assert_close(hessian, differences(jax.jit(jax.vmap(gradient)), z, steps), 1e-6)


SLOPES = np.array([0.0085, 0.009, 0.0093])


def starts(cls, count=5):
    rng = np.random.default_rng(3)
    return STARTS[cls][1] * rng.uniform(0.995, 1.005, (count, len(cls.section)))


@pytest.mark.parametrize(
    "cls", [cls if cls is SimplestWalker else pytest.param(cls, marks=SLOW) for cls in STARTS]
)
def test_strides_of_many_walkers_and_starts_are_those_of_each(cls):
    """To the bit, whichever is mapped first."""
    _, rest = STARTS[cls][0], jax.tree.leaves(STARTS[cls][0])[1:]
    walkers = jax.vmap(lambda slope: cls(slope, *rest))(SLOPES)
    xs = starts(cls)
    each = jax.jit(wj.stride)
    one = lambda i: jax.tree.map(lambda leaf: leaf[i], walkers)
    expected = [[each(one(i), x) for x in xs] for i in range(len(SLOPES))]
    expected = jax.tree.map(
        lambda *rows: np.stack(rows),
        *(jax.tree.map(lambda *c: np.stack(c), *row) for row in expected),
    )
    by_starts = jax.vmap(wj.stride, (None, 0))
    by_walkers = jax.vmap(wj.stride, (0, None))
    for transform in (lambda f: f, jax.jit):
        found = transform(jax.vmap(by_starts, (0, None)))(walkers, xs)
        jax.tree.map(np.testing.assert_array_equal, found, expected)
        found = transform(jax.vmap(by_walkers, (None, 0), out_axes=1))(walkers, xs)
        jax.tree.map(np.testing.assert_array_equal, found, expected)
        pairs = transform(jax.vmap(wj.stride))(walkers, xs[:3])
        own = jax.tree.map(lambda leaf: leaf[np.arange(3), np.arange(3)], expected)
        jax.tree.map(np.testing.assert_array_equal, pairs, own)


@pytest.mark.parametrize(
    "quantity", ["walk", "margins", "trajectory", pytest.param("gait", marks=SLOW)]
)
def test_quantities_of_many_walkers_are_those_of_each(quantity):
    """Of the simplest walker, to the bit where XLA's part does not depend on how many there are."""
    function = QUANTITIES[quantity]
    walkers, xs = jax.vmap(SimplestWalker)(SLOPES[1:]), starts(SimplestWalker, 3)
    both = jax.vmap(jax.vmap(function, (None, 0)), (0, None))
    found = jax.jit(both)(walkers, xs)
    turned = jax.jit(jax.vmap(jax.vmap(function, (0, None)), (None, 0), out_axes=1))(walkers, xs)
    each = jax.jit(function)
    expected = [each(SimplestWalker(slope), x) for slope in SLOPES[1:] for x in xs]
    assert np.isfinite(jax.tree.leaves(found)[0]).all()
    tolerance = 1e-12 if quantity == "gait" else 0
    for one, other, *single in zip(*map(jax.tree.leaves, (found, turned, *expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)
        single = np.reshape(single, one.shape)
        np.testing.assert_allclose(one, single, rtol=tolerance, atol=tolerance)
