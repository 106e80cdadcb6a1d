"""Sine and cosine of enclosures, with remainders."""

import math

import numpy as np

from walker_jax.proofs.enclosures import (
    BALLS,
    ROUNDING,
    Enclosure,
    ball,
    choose,
    exactly,
    library,
    outward,
    rounded_once,
)

HALF_PI = 1.5707963267341256, 6.077100506303966e-11
"""The first two parts of pi / 2, of 33 bits each, so that their multiples are exact."""
REST_OF_HALF_PI = 2.03e-21
"""Above what is left of pi / 2."""
MOST_TURNS = 2.0**19
TERMS = 9
"""Of the series of sine and cosine on [-0.79, 0.79]: the next is below 1e-16 of the sum's last."""
REDUCED = 0.79
"""Above pi / 4, and the rounding of an angle that is reduced to it."""


def sine_and_cosine_of_number(x) -> tuple[Enclosure, Enclosure]:
    """Sine and cosine of a float, as intervals.

    x - k pi/2 is exact after the first part: k times it is exact, and the difference too, by
    Sterbenz's lemma. Beyond `MOST_TURNS` quarters of a turn nothing is known of either.
    """
    turns = library(x).round(x * (2 / math.pi))
    turned = choose(turns == 0, 0.0, 1.0)
    y = (x - turns * HALF_PI[0]) - turns * HALF_PI[1]
    error = outward(turned * ROUNDING * abs(y) + abs(turns) * REST_OF_HALF_PI)
    y = ball(y, choose(turns == 0, 0.0, error))
    z = y * y
    sine = y * power_series(z, 1)
    cosine = power_series(z, 0)
    small = (abs(turns) <= MOST_TURNS) & (y.magnitude <= REDUCED)
    odd = abs(turns - 2 * library(x).floor(turns / 2)) == 1
    half = turns - 4 * library(x).floor(turns / 4)
    values = [
        ball(choose(small, a.middle, 0.0), choose(small, a.radius, 2.0)) for a in (sine, cosine)
    ]
    first, second = (
        ball(choose(odd, b.middle, a.middle), choose(odd, b.radius, a.radius))
        for a, b in (values, values[::-1])
    )
    flip_sine, flip_cosine = half >= 2, (half == 1) | (half == 2)
    return (
        ball(choose(flip_sine, -first.middle, first.middle), first.radius),
        ball(choose(flip_cosine, -second.middle, second.middle), second.radius),
    )


def power_series(z: Enclosure, odd: int) -> Enclosure:
    """sum_k (-z)^k / (2k + odd)!, with the first term that is left out, for 0 <= z <= 0.79^2."""
    last = TERMS - 1
    value = rounded_once((-1) ** last / math.factorial(2 * last + odd), BALLS)
    for k in reversed(range(last)):
        value = value * z + rounded_once((-1) ** k / math.factorial(2 * k + odd), BALLS)
    return value.widened(remainder_of_series(odd))


def remainder_of_series(odd: int) -> float:
    """Above the first term that is left out."""
    return 1.001 * REDUCED ** (2 * TERMS) / math.factorial(2 * TERMS + odd)


def sine_and_cosine(x: Enclosure) -> tuple[Enclosure, Enclosure]:
    """sin(m + e) = sin(m) cos(e) + cos(m) sin(e), by the series of cos(e) and sin(e).

    Powers of e end at the degree of the polynomials, at least at the first one; the next derivative
    is at most 1, so the term with it bounds what is left out.
    """
    space, degree = x.space, max(x.space.degree, 1)
    number = x.middle
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
