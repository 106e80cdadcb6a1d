"""Kernels for GPUs, without a GPU: PTX is made, and a driver that is not there gets the launches."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_card import STREAM, a_card
from jax import lax

import walker_jax as wj
from walker_jax.kernels import gpu, kernel, launcher, machine, ptx
from walker_jax.kernels import program as of_program


@pytest.fixture(scope="module")
def the_card():
    with pytest.MonkeyPatch.context() as patch, a_card(patch) as card:
        yield card


@pytest.fixture
def card(the_card):
    the_card.launches.clear()
    yield the_card
    the_card.status = dict.fromkeys(the_card.status, 0)


@pytest.fixture
def by_handler():
    token = gpu.trying.set(gpu.ROUTES[0])
    yield
    gpu.trying.reset(token)


def function(shared, x, n):
    """A loop that ends for each cell at another turn, and results of several types."""

    def step(state):
        i, y = state
        return i + 1, y * shared["scale"] + x[1]

    turns, y = lax.while_loop(lambda state: state[0] < n, step, (jnp.zeros_like(n), x[0]))
    return {"y": y, "both": jnp.stack([x * y, shared["offset"]]), "turns": turns, "big": y > 1}


SHARED = {"scale": jnp.asarray(0.9), "offset": jnp.asarray([2.0, 3.0])}


@pytest.mark.parametrize("n", [0, 1, ptx.THREADS, ptx.THREADS + 1, 300])
def test_a_launch(card, by_handler, n):
    rng = np.random.default_rng(n)
    xs, counts = jnp.asarray(rng.normal(size=(n, 2))), jnp.asarray(rng.integers(0, 9, n))
    found = jax.jit(jax.vmap(kernel(function), (None, 0, 0)))(SHARED, xs, counts)
    expected = jax.jit(jax.vmap(function, (None, 0, 0)))(SHARED, xs, counts)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-14), found, expected)
    if n == 0:
        assert not card.launches
        return
    (launch,) = card.launches
    assert launch.grid == (-(-n // ptx.THREADS), 1, 1) and launch.block == (ptx.THREADS, 1, 1)
    assert (launch.shared_memory, launch.stream, launch.cells) == (0, STREAM, n)
    assert len(launch.addresses) == 4 + 4
