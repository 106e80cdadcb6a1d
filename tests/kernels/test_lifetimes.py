"""Arrays of a program in memory: those that are needed at the same time lie apart."""

import itertools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from test_kernels import of_both

from walker_jax.kernels.compiled import source_of
from walker_jax.kernels.lifetimes import ALIGNMENT, Lifetimes

RNG = np.random.default_rng(5)
WIDTH, CELLS = 20, 11
W = RNG.normal(size=(WIDTH, WIDTH)) / 4
POINTS = RNG.normal(size=(CELLS, WIDTH))


def together(one, other) -> bool:
    return one.begin <= other.last and other.begin <= one.last


@pytest.mark.parametrize("seed", range(4))
def test_arrays_needed_together_lie_apart(seed):
    rng, lifetimes = np.random.default_rng(seed), Lifetimes()
    for _ in range(150):
        lifetimes.begin(int(rng.integers(1, 1000)))
        for i in rng.integers(0, len(lifetimes.spans), 2):
            if rng.random() < 0.3:
                lifetimes.use(lifetimes.spans[i])
    size = lifetimes.place()
    spans: Any = lifetimes.spans
    ends = [one.first + one.size for one in spans]
    assert max(ends) == size < sum(one.size for one in spans)
    assert all(one.first % ALIGNMENT == 0 for one in spans)
    for (one, end), (other, stop) in itertools.combinations(zip(spans, ends, strict=True), 2):
        assert not together(one, other) or end <= other.first or stop <= one.first


def test_loops_keep_what_they_read():
    """An array from before the loop is kept to its end, if a turn reads it, and no other is."""
    lifetimes = Lifetimes()
    read, unread = lifetimes.begin(64), lifetimes.begin(64)
    begun = lifetimes.begin_loop()
    lifetimes.use(read)
    own, last = lifetimes.begin(64), lifetimes.begin(64)
    lifetimes.end_loop(begun)
    assert together(read, last)
    assert not together(unread, own) and not together(own, last)


def layers(count: int, x):
    for k in range(count):
        x = jnp.tanh(jnp.asarray(W) @ x + k)
    return x


def bytes_of(function) -> int:
    source = source_of(jax.make_jaxpr(function)(POINTS[0]), 256)[2]
    (found,) = re.findall(r'@"size" = internal constant i64 (\d+)', source)
    return int(found)


def test_deep_networks_need_no_more_memory():
    assert bytes_of(lambda x: layers(12, x)) == bytes_of(lambda x: layers(4, x))


def test_values_that_turns_read_remain():
    """A loop reads long arrays from before it, after others that each turn makes."""

    def function(x):
        h, most = layers(2, x), jnp.abs(x[0]) * 5
        deep = lambda i, y: layers(3, y) + h * x + i
        turn = lambda now: (now[0] + 1, deep(now[0], now[1]))
        return lax.while_loop(lambda now: now[0] < most, turn, (0.0, h))[1], layers(3, h)

    found, expected = of_both(function, POINTS)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-14)


def test_constants_to_derivatives_are_no_copies():
    shared = lambda weights, x: weights @ x
    stopped = lambda weights, x: lax.stop_gradient(weights) @ x
    sources = [source_of(jax.make_jaxpr(one)(W, POINTS[0]), 256)[2] for one in (shared, stopped)]
    assert sources[0] == sources[1]
