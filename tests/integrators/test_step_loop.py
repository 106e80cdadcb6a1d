"""Steps of their own length, made by `diffrax.diffeqsolve` one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.integrators.step_loop import make_steps
from walker_jax.kernels import kernel

MOST = 7


def grow(start, limit, going=True, made=0):
    """Multiply a number by 3 until it reaches a limit; its flag and its whole number go along."""
    step = lambda carry: (3 * carry[0], carry[0] < limit, carry[2] + 2)
    last = start, jnp.asarray(True), jnp.asarray(0)
    below = lambda carry: carry[0] < limit
    return make_steps(step, last, below, jnp.asarray(going), jnp.asarray(made), MOST)


@pytest.mark.parametrize(
    ("of", "dtype"),
    [
        pytest.param(kernel, "float32", id="kernel"),
        pytest.param(jax.jit, "float64", id="XLA"),
        pytest.param(kernel, "float64", id="kernel in double", marks=pytest.mark.slow),
        pytest.param(jax.jit, "float32", id="XLA in single", marks=pytest.mark.slow),
    ],
)
def test_steps_are_made_until_one_does_not_go_on(of, dtype):
    """3^k first reaches 20, 1 and 3^9 for k = 3, 1 and 9, which is more than the most."""
    limits = np.array([20.0, 1.0, 3.0**9], dtype)
    (numbers, flags, twice), made = jax.jit(jax.vmap(of(lambda x: grow(x / x, x))))(limits)
    assert numbers.dtype == dtype and flags.dtype == bool
    np.testing.assert_array_equal(made, [3, 1, MOST])
    np.testing.assert_array_equal(numbers, [27, 3, 3**MOST])
    np.testing.assert_array_equal(flags, [True, False, True])  # one step behind
    np.testing.assert_array_equal(twice, 2 * made)


def test_earlier_steps_count():
    for going, made, total in [(False, 2, 2), (True, 5, MOST), (True, MOST, MOST)]:
        (number, *_), count = jax.jit(grow)(1.0, 1e9, going, made)
        assert count == total and number == 3 ** (total - made)


def test_steps_are_differentiated():
    """The third power of 3, times the start: d/dx = 27, d/dx of its square = 2 * 27^2 x."""
    last = lambda x: grow(x, 20.0)[0][0]
    assert jax.jvp(last, (1.5,), (1.0,)) == (1.5 * 27, 27)
    assert jax.jacfwd(jax.jacfwd(lambda x: last(x) ** 2))(1.0) == 2 * 27**2


def test_what_follows_from_constants_is_not_traced():
    """diffrax rounds the last time a hundred times."""
    traced = str(jax.make_jaxpr(grow)(1.0, 20.0))
    assert "while" in traced and "nextafter" not in traced
