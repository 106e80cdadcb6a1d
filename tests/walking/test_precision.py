"""Strides in float32, JAX's default, against those in float64; and what is said of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import PrecisionWarning, warn_once
from walker_jax.hybrid.crossings import Crossing, rise_of
from walker_jax.systems.outcomes import Outcome

SLOPE = 0.004
AT_A_STEPS_END = 0.14289452135562897, -0.14757704734802246
"""A start whose heel strike falls on the end of an integration step in float32."""
GRID = wj.Grid.sheared(theta=(0.05, 0.3, 4), sum=(-0.01, 0.002, 4))


def walker(dtype):
    return wj.SimplestWalker(jnp.asarray(SLOPE, dtype))


def test_a_strike_at_the_end_of_a_step_is_not_lost_to_rounding():
    single, double = (np.array([AT_A_STEPS_END], dtype) for dtype in (np.float32, np.float64))
    expected = wj.strides(walker(np.float64), double)
    for found in (
        wj.strides(walker(np.float32), single),
        wj.margins(walker(np.float32), single).stride,
        jax.jit(jax.vmap(lambda x: wj.stride(walker(np.float32), x)))(jnp.asarray(single)),
    ):
        assert found.outcome[0] == expected.outcome[0] == Outcome.STRIDE
        np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=1e-5)


@jax.jit
def upcrossing(start, sides):
    """The zero of a line of slope 1 from a height, in a step of length 1."""
    value, yes = [start, jnp.array(1.0), jnp.array(0.0)], jnp.asarray(True)
    below, ends_below = sides
    return rise_of(Crossing(value, [], below, ends_below, yes), jnp.array(1.0))


@pytest.mark.parametrize("end", [-1e-17, 0.0, 1e-17])
def test_the_side_that_was_seen_decides_about_a_rise(end):
    """The end of a step is above zero, or below: once said, rounding has no say in it."""
    for ends_below in (True, False):
        found, time = upcrossing(-1.0 + end, (True, ends_below))
        assert found != ends_below and time == pytest.approx(1.0, abs=1e-15)
    found, _ = upcrossing(end, (False, False))
    assert not found


def starts_of(rng, n):
    """Starts about the gait's basin, on float32's own grid."""
    theta, total = rng.uniform(0.05, 0.35, n), rng.uniform(-0.01, 0.005, n)
    return np.stack([theta, total - theta], axis=1).astype(np.float32)


def assert_alike(starts):
    """Outcomes are the same but where a failure is as near as rounding.

    A stance leg that hardly passes its top amplifies rounding by one over the margin by which it
    does. Elsewhere margins are of the order of 0.01, also where a strike ends a step.
    """
    single = wj.strides(walker(np.float32), starts)
    double = wj.strides(walker(np.float64), starts.astype(float))
    unlike = np.flatnonzero(single.outcome != double.outcome)
    margins = wj.margins(walker(np.float64), starts[unlike].astype(float))
    backward = np.abs(margins.backward)
    ways = np.abs([margins.forward, margins.running, margins.stopping])
    nearest = np.fmin.reduce(ways)  # NaN where none came up
    amplified = backward * nearest < np.finfo(np.float32).eps
    assert ((np.fmin(backward, nearest) < 1e-6) | amplified).all()
    return len(unlike), int((double.outcome == Outcome.STRIDE).sum())


def test_strides_of_both_types_are_alike():
    rng = np.random.default_rng(0)
    near = np.array(AT_A_STEPS_END) + rng.uniform(-1e-6, 1e-6, (20_000, 2))
    assert assert_alike(near.astype(np.float32)) == (0, len(near))
    unlike, strode = assert_alike(starts_of(rng, 50_000))
    assert strode > 20_000 and unlike < 50


@pytest.mark.slow
def test_a_hundred_million_strides_of_both_types_are_alike():
    rng, made = np.random.default_rng(1), 0
    while made < 1e8:
        made += 2_000_000
        assert_alike(starts_of(rng, 2_000_000))


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.004, 0.0041, 0.0043])
def test_the_least_disturbance_in_float32(slope):
    expected = wj.least_disturbance(wj.SimplestWalker(slope)).size
    with jax.enable_x64(False), pytest.warns(PrecisionWarning):
        warn_once.cache_clear()
        found = wj.least_disturbance(wj.SimplestWalker(slope)).size
    assert found == pytest.approx(expected, rel=2e-3)


def test_many_strides_say_once_that_float64_is_off():
    system, grid = wj.systems.HenonMap(0.2), wj.Grid.plain(x=(-2, 2, 4), y=(-2, 2, 4))
    warn_once.cache_clear()
    with jax.enable_x64(False):
        with pytest.warns(PrecisionWarning, match="jax_enable_x64") as said:
            wj.basin(system, grid)
            wj.basin(system, grid)
        assert len(said) == 1
    wj.basin(system, grid)  # in float64 nothing is said


def test_what_needs_float64_refuses_float32():
    with jax.enable_x64(False):
        simplest = wj.SimplestWalker(SLOPE)
        for call in (
            lambda: wj.boundary_dimension(simplest, GRID),
            lambda: wj.robustness(simplest, GRID),
            lambda: wj.robustness(simplest, values=[0.004]),
            lambda: wj.continue_gait(simplest, "slope", (0.001, 0.02)),
            lambda: wj.most_probable_fall(simplest),
        ):
            with pytest.raises(ValueError, match="needs float64, not float32: turn on"):
                call()


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(wj.find_gait, id="find_gait"),
        pytest.param(lambda walker: wj.basin(walker, GRID), id="basin", marks=pytest.mark.slow),
    ],
)
def test_parameters_that_were_rounded_are_named_once(call):
    with jax.enable_x64(False):
        rounded = wj.SimplestWalker(SLOPE)
    warn_once.cache_clear()
    with pytest.warns(PrecisionWarning, match="slope 0.004000000189989805 has the") as said:
        call(rounded)
        call(rounded)
    assert len(said) == 1
    call(wj.SimplestWalker(SLOPE))  # nothing is said


def test_a_probable_fall_of_a_rounded_walker_is_refused():
    with jax.enable_x64(False):
        rounded = wj.SimplestWalker(SLOPE)
    gait = wj.find_gait(rounded, np.array([0.15, -0.15], np.float32))
    warn_once.cache_clear()
    refused = pytest.raises(ValueError, match="1e-09 beyond a boundary, needs float64")
    with pytest.warns(PrecisionWarning), refused:
        wj.most_probable_fall(rounded, gait=gait)
