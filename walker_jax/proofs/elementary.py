"""Sine and cosine of enclosures, with bounds on the remainders of their series."""

import math
from typing import Any

import numpy as np

from walker_jax.proofs.enclosures import (
    BALLS,
    ROUNDING,
    Enclosure,
    array_module,
    ball,
    choose,
    exactly,
    outward,
    rounded_once,
)

HALF_PI = 1.5707963267341256, 6.077100506303966e-11
"""The first two parts of pi / 2, of 33 bits each: their products with the number of quarter turns
are exact."""
REST_OF_HALF_PI = 2.03e-21
"""Upper bound on pi / 2 less these two parts."""
MOST_TURNS = 2.0**19
"""Most quarter turns for which the reduction is proved."""
TERMS = 9
"""Number of terms of the series of sine and cosine. On [-0.79, 0.79] the first omitted term is
below 1e-16 of the sum."""
REDUCED = 0.79
"""Upper bound on a reduced angle: pi / 4 and the rounding of the reduction."""


def reduce_angle(x) -> tuple[Any, Enclosure]:
    """Return the number k of quarter turns next to an angle, and an interval about x - k pi/2.

    The product of k and the first part of pi/2 is exact, and so is its difference from x, by
    Sterbenz's lemma. The error is the rounding of the second difference, and k times what both
    parts leave of pi/2; there is none if k = 0.
    """
    turns = array_module(x).round(x * (2 / math.pi))
    y = (x - turns * HALF_PI[0]) - turns * HALF_PI[1]
    error = outward(ROUNDING * abs(y) + abs(turns) * REST_OF_HALF_PI)
    return turns, ball(y, choose(turns == 0, 0.0, error))


def sine_and_cosine_of_number(x) -> tuple[Enclosure, Enclosure]:
    """Enclose the sine and cosine of a float in intervals.

    Beyond `MOST_TURNS` quarter turns both are [-2, 2], which says nothing.
    """
    turns, y = reduce_angle(x)
    z = y * y
    sine = y * power_series(z, 1)
    cosine = power_series(z, 0)
    small = (abs(turns) <= MOST_TURNS) & (y.magnitude <= REDUCED)
    odd = abs(turns - 2 * array_module(x).floor(turns / 2)) == 1
    half = turns - 4 * array_module(x).floor(turns / 4)
    values = [
        ball(choose(small, a.midpoint, 0.0), choose(small, a.radius, 2.0)) for a in (sine, cosine)
    ]
    first, second = (
        ball(choose(odd, b.midpoint, a.midpoint), choose(odd, b.radius, a.radius))
        for a, b in (values, values[::-1])
    )
    flip_sine, flip_cosine = half >= 2, (half == 1) | (half == 2)
    return (
        ball(choose(flip_sine, -first.midpoint, first.midpoint), first.radius),
        ball(choose(flip_cosine, -second.midpoint, second.midpoint), second.radius),
    )


def power_series(z: Enclosure, odd: int) -> Enclosure:
    """Enclose the sum over all k >= 0 of (-z)^k / (2k + odd)!, for 0 <= z <= 0.79^2.

    The terms alternate and shrink, so the first omitted one bounds the remainder.
    """
    last = TERMS - 1
    value = rounded_once((-1) ** last / math.factorial(2 * last + odd), BALLS)
    for k in reversed(range(last)):
        value = value * z + rounded_once((-1) ** k / math.factorial(2 * k + odd), BALLS)
    return value.widened(remainder_of_series(odd))


def remainder_of_series(odd: int) -> float:
    """Return an upper bound on the first omitted term."""
    return 1.001 * REDUCED ** (2 * TERMS) / math.factorial(2 * TERMS + odd)


def enclose_sine_and_cosine(x: Enclosure) -> tuple[Enclosure, Enclosure]:
    """Enclose sin(m + e) and cos(m + e), where m is the midpoint and e the rest of an enclosure.

    By the addition theorems, such as sin(m + e) = sin(m) cos(e) + cos(m) sin(e), and the series of
    cos(e) and sin(e), these are Taylor polynomials in e. Their degree d is that of the enclosure,
    and at least 1. The next derivative is at most 1, so |e|^(d+1) / (d+1)! bounds the remainder.
    """
    space, degree = x.space, max(x.space.degree, 1)
    number = x.midpoint
    known = np.float64(number) if isinstance(number, float) else number
    sine, cosine = sine_and_cosine_of_number(known)
    e = Enclosure([None, *x.terms[1:]], x.radius, space)
    even, odd = exactly(1.0, space), exactly(0.0, space)
    power = e
    for k in range(1, degree + 1):
        factor = rounded_once((-1) ** (k // 2) / math.factorial(k), space)
        even, odd = (even, odd + power * factor) if k % 2 else (even + power * factor, odd)
        power = power * e if k < degree else power
    bound = rest = e.magnitude
    for k in range(2, degree + 2):
        rest = outward(rest * bound / k)
    return (
        (even * sine + odd * cosine).widened(rest),
        (even * cosine - odd * sine).widened(rest),
    )
