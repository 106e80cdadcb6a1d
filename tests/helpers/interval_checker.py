"""A slow, independent checker of proofs: plain Python and Arb's balls, no code of the package.

It follows one start of the simplest walker, given by its binary digits, in interval arithmetic of
`BITS` bits: equations, series, steps, events and impact are typed anew. So many bits outlast the
growth of intervals. A start that is proved to walk must reach the trap, and one that is proved to
fall must make a stride less: fall, or be no start of a stride.
"""

from collections import Counter
from functools import partial
from typing import Any

import numpy as np
from flint import arb, arb_series, ctx

BITS, ORDER, STEP = 320, 36, arb(1) / 4
PIECES, DEEPEST = 4, 12
"""Of a step, each halved so many times at most where it is open whether a strike is in it."""


def field(slope, y):
    theta, phi, w, v = y
    turn, balance = (theta - slope).sin(), (theta - slope).cos()
    return w, v, turn, phi.sin() * (w * w - balance) + turn


def coefficients(slope, y, order) -> list[list]:
    """Taylor coefficients of theta, phi and their rates: each integral makes one more right."""
    series = [arb_series([one], prec=1) for one in y]
    for n in range(1, order + 1):
        ctx.cap = n + 1
        longer = [arb_series(one.coeffs(), prec=n) for one in series]
        rates = field(slope, longer)
        series = [
            arb_series([first, *padded(rate.integral().coeffs(), n + 1)[1:]], prec=n + 1)
            for first, rate in zip(y, rates, strict=True)
        ]
    return [padded(one.coeffs(), order + 1) for one in series]


def padded(values: list, length: int) -> list:
    return [*values, *[arb(0)] * (length - len(values))]


def box_over(slope, y, time):
    """A box that no solution leaves within a time from 0 on, by Picard's iteration."""
    box = [a + time * f for a, f in zip(y, field(slope, y), strict=True)]
    for _ in range(60):
        wide = [one + arb(0, one.rad() / 20 + arb("1e-9")) for one in box]
        box = [a + time * f for a, f in zip(y, field(slope, wide), strict=True)]
        if all(w.contains_interior(b) for b, w in zip(box, wide, strict=True)):
            return box
    return None


def between(low, high):
    return low.union(high)


def at(series, rest, time):
    """The state at a time of a step, which may be an interval."""
    found = []
    for known, last in zip(series, rest, strict=True):
        value = last[ORDER]
        for c in known[ORDER - 1 :: -1]:
            value = value * time + c
        found.append(value)
    return found


def contact(y):
    """The value that strikes where it rises through zero, and its rate."""
    return y[1] - 2 * y[0], y[3] - 2 * y[2]


def pushes(slope, theta, w):
    """Above zero where the ground pushes, which over a stride is so if it is at both its ends."""
    return (theta - slope).cos() - w * w


def check_stride(slope, x) -> Any:
    """What a stride leads to: the next theta and thetadot, "falls", or None where that is open."""
    theta, w = x
    if theta < 0 or theta > arb.pi() / 4 or w > 0 or pushes(slope, theta, w) < 0:
        return "falls"
    if not (theta > 0 and theta < arb.pi() / 4 and w < 0 and pushes(slope, theta, w) > 0):
        return None
    y = [theta, 2 * theta, w, (1 - (2 * theta).cos()) * w]
    for step in range(400):
        length = STEP
        while (box := box_over(slope, y, between(arb(0), length))) is None:
            length /= 2
        series, rest = coefficients(slope, y, ORDER - 1), coefficients(slope, box, ORDER)
        states = partial(at, series, rest)
        low = first_rise(states, length, at_start=step == 0)
        if low is not None:
            return strike(slope, states, low, length)
        y = states(length)
        if y[2] > 0 or y[0] < -arb.pi() / 2:
            return "falls"
    return None


def first_rise(states, length, at_start):
    """The begin of the first piece that may hold a strike; None if none does.

    A stride starts at zero of the contact's value: while that rises from there, it is above zero.
    """
    parts = [(length * i / PIECES, length * (i + 1) / PIECES, 0) for i in range(PIECES)][::-1]
    while parts:
        low, high, depth = parts.pop()
        z = states(between(low, high))
        g, rate = contact(z)
        begins = at_start and low == 0 and rate > 0
        if z[0] > 0 or g < 0 or g > 0 or rate < 0 or begins or z[2] > 0:
            continue
        if depth == DEEPEST:
            return low
        middle = (low + high) / 2
        parts += [(middle, high, depth + 1), (low, middle, depth + 1)]
    return None


def strike(slope, states, low, length) -> Any:
    """Where the heel strike after a time leads, while the contact's value rises throughout."""
    value = lambda time: contact(states(time))[0]
    high, part = low, length / 2**DEEPEST
    while high < length and not value(high) > 0:
        high, part = min(length, high + part), 2 * part
    over = states(between(low, high))
    if not (value(low) < 0 and value(high) > 0 and contact(over)[1] > 0 and over[0] < 0):
        return None
    for _ in range(BITS):
        middle = ((low + high) / 2).mid()
        sign = value(middle)
        if sign > 0:
            high = middle
        elif sign < 0:
            low = middle
        else:
            break
    theta, _, w, _ = states(between(low, high))
    if not (w < 0 and pushes(slope, theta, w) > 0):
        return "falls" if w > 0 or pushes(slope, theta, w) < 0 else None
    return -theta, (2 * theta).cos() * w


def follow(slope, x, centre, factor, size, most=60):
    """What a start certainly does: "walks", into the trap, or "falls"; None where that is open."""
    ctx.prec = BITS
    slope, x = arb(slope), tuple(arb(float(one)) for one in x)
    for _ in range(most):
        x = check_stride(slope, x)
        if x is None or x == "falls":
            return x
        a, b = (one - arb(float(c)) for one, c in zip(x, centre, strict=True))
        first = arb(float(factor[0][0])) * a + arb(float(factor[1][0])) * b
        second = arb(float(factor[1][1])) * b
        if first**2 + second**2 <= arb(float(size)) ** 2:
            return "walks"
    return None


def replay(data, slope, count, seed):
    """Follow one start in each of some proved cells; returns how many walk, fall or are None, open.

    Raises `AssertionError` for a cell whose fate is not the proved one.
    """
    rng, answers = np.random.default_rng(seed), Counter()
    trap = data["trap_centre"].values, data["trap_factor"].values, float(data["trap_size"])
    width = (data["upper"] - data["lower"]).values / data["count"].values
    proved = np.flatnonzero(data["proved"] != 0)
    for cell in rng.choice(proved, min(count, len(proved)), replace=False):
        place = data["place"].values[cell] + rng.uniform(size=2)
        w = data["lower"].values + place * width / 2.0 ** int(data["level"][cell])
        answer = follow(slope, data["shear"].values @ w, *trap)
        assert answer in (None, "walks" if data["proved"][cell] == 1 else "falls"), w
        answers[answer] += 1
    return answers
