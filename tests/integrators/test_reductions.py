"""The largest entry of many rows is NaN where one is, on a CPU too."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax
from walker_jax.gaits.cycles import has_shorter_period
from walker_jax.integrators.reductions import largest
from walker_jax.walking.iteration import Targets, distances

ROWS = 3008, 5
"""So many that XLA's own maximum over each row is -inf if all entries are NaN."""


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_rows_with_nan_have_it_for_their_largest_entry(dtype):
    rows = np.tile(np.arange(5, dtype=dtype), (ROWS[0], 1))
    rows[::3] = np.nan
    rows[1::3, 2] = np.nan
    for found in (
        jax.jit(lambda x: largest(x, 1))(rows),
        jax.jit(jax.vmap(largest))(rows),
        jax.jit(lambda x: largest(x, (1, 2)))(rows[:, :, None]),
    ):
        assert found.dtype == dtype
        np.testing.assert_array_equal(found, np.where(np.arange(ROWS[0]) % 3 < 2, np.nan, 4))


def test_a_walk_that_has_failed_is_near_no_target():
    targets = Targets(np.zeros((3, 5)), np.tile(np.eye(5), (3, 1, 1)))
    away = jax.jit(jax.vmap(lambda x: distances(x, targets)))
    assert np.isnan(away(np.full(ROWS, np.nan))).all()
    assert (away(np.full(ROWS, 0.5)) == 0.5).all()


def test_cycles_of_nan_repeat_nothing():
    found = jax.jit(jax.vmap(has_shorter_period))(jnp.full((ROWS[0], 2, 5), jnp.nan))
    assert not found.any()


def test_no_module_takes_the_maximum_of_jax_where_nan_may_be():
    """Of points explained one by one it is right."""
    folder = Path(walker_jax.__file__).parent
    allowed = {"integrators/reductions.py", "walking/consistency.py", "walking/explanation.py"}
    used = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*.py")
        if re.search(r"\bjnp\.a?(max|min)\(", path.read_text())
    }
    assert used <= allowed
