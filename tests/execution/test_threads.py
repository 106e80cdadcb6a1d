"""Independent computations side by side."""

from threading import Event

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.execution import threads
from walker_jax.execution.threads import side_by_side
from walker_jax.execution.tiles import map_cells


def double(x):
    return 2 * x


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)


def test_results_come_in_order_and_under_the_callers_settings():
    met = Event(), Event()

    def work(k):
        if k < 2:  # each waits for the other, so both are under way
            met[k].set()
            assert met[1 - k].wait(60)
        return k, float(jnp.int32(1) + jnp.float32(k))  # an error under the strict rules of tests

    with jax.numpy_dtype_promotion("standard"):
        found = list(side_by_side(work, range(5)))
    assert found == [(k, 1.0 + k) for k in range(5)]
    assert list(side_by_side(work, [])) == []


def test_an_error_stops_the_others_before_their_next_kernel():
    begun, made = Event(), []

    def endless(_):
        while True:
            made.append(map_cells(double, (np.arange(3.0),), (True,)))
            begun.set()

    def work(k):
        if k == 0:
            assert begun.wait(60)
            raise RuntimeError("the first")
        return list(side_by_side(endless, [0]))

    with pytest.raises(RuntimeError, match="the first"):
        list(side_by_side(work, range(2)))
    np.testing.assert_array_equal(made[0], [0, 2, 4])
    assert map_cells(double, (np.ones(2),), (True,)).tolist() == [2, 2]  # nothing stops this one
