"""JAX functions that replace primitives for which LLVM has no instruction."""

import math

import jax.numpy as jnp
import numpy as np
from jax import lax


def log_float32(x):
    """log(x), with an error of about 1e-7 max(|log(x)|, 1)."""
    subnormal = x < jnp.float32(np.finfo(np.float32).tiny)
    scaled = jnp.where(subnormal, x * jnp.float32(2**24), x)
    bits = lax.bitcast_convert_type(scaled, jnp.int32)
    # x = 2^e m, with m between sqrt(1/2) and sqrt(2)
    e = lax.shift_right_arithmetic(bits - 0x3F3504F3, jnp.int32(23))
    m = lax.bitcast_convert_type(bits - lax.shift_left(e, jnp.int32(23)), jnp.float32)
    # log(m) = 2 artanh(s)
    s = (m - 1) / (m + 1)
    z = s * s
    series = 2 * s * (1 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z / 9))))
    e = e - jnp.where(subnormal, 24, 0).astype(jnp.int32)
    value = e.astype(jnp.float32) * jnp.float32(np.log(2)) + series
    value = jnp.where(x == jnp.inf, x, value)
    return jnp.where(x > 0, value, jnp.where(x == 0, -jnp.inf, jnp.nan)).astype(jnp.float32)


def exp_float32(x):
    """exp(x), with a relative error of about 1e-7."""
    x = jnp.minimum(jnp.maximum(x, jnp.float32(-104)), jnp.float32(89))
    n = lax.round(x * jnp.float32(1 / np.log(2)), lax.RoundingMethod.TO_NEAREST_EVEN)
    r = x - n * jnp.float32(0.693359375) + n * jnp.float32(2.12194440e-4)
    value = jnp.float32(1 / 5040)
    for k in (720, 120, 24, 6, 2, 1, 1):
        value = value * r + jnp.float32(1 / k)
    half = lax.shift_right_arithmetic(n.astype(jnp.int32), jnp.int32(1))

    def two_to(k):
        return lax.bitcast_convert_type(lax.shift_left(k + 127, jnp.int32(23)), jnp.float32)

    return value * two_to(half) * two_to(n.astype(jnp.int32) - half)


def next_after(x, y):
    """Return the floating-point number next to x towards y; as an integer, its bits are 1 away."""
    dtype = np.dtype(x.dtype)
    integer = np.dtype(f"int{8 * dtype.itemsize}")
    bits = lax.bitcast_convert_type(x, integer)
    outwards = (y > x) == (x > 0)
    moved = lax.bitcast_convert_type(bits + jnp.where(outwards, 1, -1).astype(integer), dtype)
    least = jnp.asarray(np.finfo(dtype).smallest_subnormal, dtype)
    moved = jnp.where(x == 0, jnp.where(y > x, least, -least), moved)
    return jnp.where((x != x) | (y != y), x + y, jnp.where(x == y, y, moved))


def tanh_float64(x):
    """tanh(x) = e / (e + 2), with e = exp(2 |x|) - 1; errors are below 3 units of the last digit.

    The C library takes one lane after the other, and three times as long.
    """
    y = 2 * jnp.minimum(jnp.abs(x), 22.0)  # beyond, the result is 1
    n = lax.round(y * (1 / np.log(2)), lax.RoundingMethod.TO_NEAREST_EVEN)
    r = (y - n * 0.6931471803691238) - n * 1.9082149292705877e-10
    # exp(r) - 1 = r + r^2 (1/2 + r/6 + ...), with |r| < 0.35
    tail = jnp.float64(1 / math.factorial(14))
    for k in range(13, 1, -1):
        tail = tail * r + 1 / math.factorial(k)
    small = r + r * r * tail
    bits = lax.shift_left(n.astype(jnp.int64) + 1023, jnp.int64(52))
    two_to_n = lax.bitcast_convert_type(bits, jnp.float64)
    e = two_to_n * small + (two_to_n - 1)
    value = e / (e + 2)
    return jnp.where(x != x, x, jnp.where(x < 0, -value, value))
