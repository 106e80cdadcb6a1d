"""Strides one after another, of a map whose walks are known: x -> 2 x, from 0 up to 1."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.systems.outcomes import make_stride
from walker_jax.walking.scan import scan_strides

STARTS = jnp.array([[0.3], [0.1], [0.6], [1.2], [0.0]])
"""They make 1, 3, 0, 0 and any number of strides."""


def double(x, number):
    fate = jnp.where(x[0] > 1, wj.Outcome.OUTSIDE, wj.Outcome.FORWARD)
    outcome = jnp.where(2 * x[0] <= 1, wj.Outcome.STRIDE, fate).astype(jnp.int8)
    return make_stride(2 * x, outcome, number.astype(x.dtype))


@pytest.mark.parametrize("record", [None, lambda made: made])
def test_a_walk_ends_with_its_first_failure(record):
    follow = lambda x: scan_strides(double, x, 5, record=record)
    end, made = jax.jit(jax.vmap(follow))(STARTS)
    np.testing.assert_array_equal(end.strides, [1, 3, 0, 0, 5])
    np.testing.assert_array_equal(end.outcome, [1, 1, 1, 5, 0])
    np.testing.assert_array_equal(end.state[:, 0], [np.nan] * 4 + [0])
    if record is None:
        assert made is None
        return
    np.testing.assert_array_equal(made.state[1, :, 0], [0.2, 0.4, 0.8, np.nan, np.nan])
    np.testing.assert_array_equal(made.outcome[1], [0, 0, 0, 1, 1])
    np.testing.assert_array_equal(made.time[1], [0, 1, 2, np.nan, np.nan])


def test_a_walk_stops_where_told_or_after_the_most_strides():
    def follow(x, most):
        return scan_strides(double, x, most, stop=lambda walk: walk.state[0] > 0.35)[0]

    run = jax.jit(jax.vmap(follow, (0, None)))
    for most, strides in ((5, [1, 2, 0, 0, 5]), (1, [1, 1, 0, 0, 1]), (0, [0] * 5)):
        end = run(STARTS, jnp.int32(most))
        np.testing.assert_array_equal(end.strides, strides)
        np.testing.assert_array_equal(end.outcome, 0)
        np.testing.assert_array_equal(end.state, STARTS * 2.0 ** np.array(strides)[:, None])


def test_records_have_derivatives_in_both_modes():
    def follow(x):
        return scan_strides(double, x[None], 3, record=lambda made: made.state[0])[1]

    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(jacobian(follow)(0.1), [2, 4, 8])
        # what comes after a failure has no derivatives
        np.testing.assert_array_equal(jacobian(follow)(0.3)[1:], np.nan)
    assert jax.jacfwd(follow)(0.3)[0] == 2


class Double(wj.System):
    """The same map as a system, whose strides are kernels."""

    section = ("x",)

    def advance(self, x):
        return 2 * x, jnp.where(2 * x[0] <= 1, wj.Outcome.STRIDE, wj.Outcome.FORWARD), 1.0


def test_a_walk_has_derivatives_up_to_its_failure():
    states = lambda x: wj.walk(Double(), x[None], 3).states[:, 0]
    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(jacobian(states)(jnp.asarray(0.3)), [1, 2, np.nan, np.nan])


@pytest.mark.slow
def test_ground_after_a_fall_has_no_derivatives():
    walker, heights = wj.SimplestWalker(0.009), jnp.array([0.0, 0.2, 0.0])
    start = jnp.array([0.2003109, -0.1998325])  # its gait
    last = lambda heights: wj.walk(walker, start, 3, ground=heights).states[-1].sum()
    assert jnp.isnan(jax.jacfwd(last)(heights)).all()
    assert jnp.isnan(jax.jacrev(last)(heights)).all()
