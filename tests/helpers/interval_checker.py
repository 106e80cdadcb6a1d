# mpmath has no types: its intervals are numbers to nobody but itself.
# pyright: basic, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportIndexIssue=false, reportCallIssue=false
"""A slow, independent checker of proofs: plain Python and `mpmath.iv`, no code of the package.

It follows one start of the simplest walker, given in decimal or binary digits, in interval
arithmetic of 40 digits: equations, series, steps, events and impact are typed anew. A start that is
proved to walk must reach the trap, and one that is proved to fall must fall.
"""

from collections import Counter

import numpy as np
from mpmath import iv, mp, mpf

DIGITS, ORDER, STEP = 40, 30, mpf("0.25")


def coefficients(slope, y, order):
    """Taylor coefficients of theta, phi and their rates, from those of sines and cosines."""
    theta, phi, w, v = ([one] for one in y)
    sa, ca = [iv.sin(y[0] - slope)], [iv.cos(y[0] - slope)]
    sp, cp = [iv.sin(y[1])], [iv.cos(y[1])]

    def convolve(a, b, n):
        return sum((a[i] * b[n - i] for i in range(n + 1)), iv.mpf(0))

    def chain(rate, other, k):
        return sum((rate[i] * other[k - 1 - i] for i in range(k)), iv.mpf(0)) / k

    pull = []
    for k in range(order):
        pull.append(convolve(w, w, k) - ca[k])
        rates = w[k], v[k], sa[k], convolve(sp, pull, k) + sa[k]
        for series, rate in zip((theta, phi, w, v), rates, strict=True):
            series.append(rate / (k + 1))
        # sin' = cos y', with the rates of the angles, theta' = w and phi' = v
        next_sa, next_ca = chain(w, ca, k + 1), -chain(w, sa, k + 1)
        next_sp, next_cp = chain(v, cp, k + 1), -chain(v, sp, k + 1)
        for series, value in zip(
            (sa, ca, sp, cp), (next_sa, next_ca, next_sp, next_cp), strict=True
        ):
            series.append(value)
    return theta, phi, w, v


def field(slope, y):
    sa, ca = iv.sin(y[0] - slope), iv.cos(y[0] - slope)
    return y[2], y[3], sa, iv.sin(y[1]) * (y[2] ** 2 - ca) + sa


def box_over(slope, y, length):
    """A box that no solution leaves within a step, by Picard's iteration."""
    time = iv.mpf([0, length])
    box = [a + time * f for a, f in zip(y, field(slope, y), strict=True)]
    for _ in range(60):
        wide = [widened(one) for one in box]
        box = [a + time * f for a, f in zip(y, field(slope, wide), strict=True)]
        if all(b.a > w.a and b.b < w.b for b, w in zip(box, wide, strict=True)):
            return box
    return None


def widened(one):
    room = one.delta.b / 20 + mpf(10) ** -9
    return one + iv.mpf([-room, room])


def at(series, rest, time):
    """The state at a time of a step, which may be an interval."""
    found = []
    for known, last in zip(series, rest, strict=True):
        value = last[ORDER]
        for c in known[ORDER - 1 :: -1]:
            value = value * time + c
        found.append(value)
    return found


def check_stride(slope, x):
    """What a stride leads to: the next theta and thetadot, "falls", or None where that is open."""
    theta, w = x
    if not (theta.a > 0 and w.b < 0 and (iv.cos(theta - slope) - w**2).a > 0):
        return None
    y = [theta, 2 * theta, w, (1 - iv.cos(2 * theta)) * w]
    for _ in range(400):
        length = STEP
        while (box := box_over(slope, y, length)) is None:
            length /= 2
        series, rest = coefficients(slope, y, ORDER), coefficients(slope, box, ORDER)
        pieces = 8
        for i in range(pieces):
            part = iv.mpf([length * i / pieces, length * (i + 1) / pieces])
            z = at(series, rest, part)
            g, rate = z[1] - 2 * z[0], z[3] - 2 * z[2]
            safe = z[0].a > 0 or g.b < 0 or g.a > 0 or rate.b < 0
            if not safe:
                return strike(slope, series, rest, part, length) if z[2].b < 0 else None
        y = at(series, rest, iv.mpf(length))
        if y[2].a > 0 or y[0].b < -mp.pi / 2:
            return "falls"
    return None


def strike(slope, series, rest, part, length):
    """Heel strike from the first piece in which it may be, while the value rises throughout."""
    value = lambda t: (lambda z: z[1] - 2 * z[0])(at(series, rest, iv.mpf(t)))
    low, high = part.a, part.b
    while high < length and not value(high).a > 0:
        high = min(mpf(length), high + (part.b - part.a))
    over = at(series, rest, iv.mpf([low, high]))
    if not (value(low).b < 0 < value(high).a and (over[3] - 2 * over[2]).a > 0 and over[0].b < 0):
        return None
    for _ in range(200):
        middle = (low + high) / 2
        sign = value(middle)
        if sign.a > 0:
            high = middle
        elif sign.b < 0:
            low = middle
        else:
            break
    theta, _, w, _ = at(series, rest, iv.mpf([low, high]))
    if not (w.b < 0 and (iv.cos(theta - slope) - w**2).a > 0 and theta.a > -mp.pi / 4):
        return None
    return -theta, iv.cos(2 * theta) * w


def follow(slope, x, centre, factor, size, most=60):
    """What a start certainly does: "walks", into the trap, or "falls"; None where that is open."""
    iv.dps = mp.dps = DIGITS
    slope, x = iv.mpf(slope), tuple(iv.mpf(float(one)) for one in x)
    for _ in range(most):
        x = check_stride(slope, x)
        if x is None or x == "falls":
            return x
        a, b = (one - iv.mpf(float(c)) for one, c in zip(x, centre, strict=True))
        first = iv.mpf(float(factor[0][0])) * a + iv.mpf(float(factor[1][0])) * b
        second = iv.mpf(float(factor[1][1])) * b
        if (first**2 + second**2).b <= mpf(float(size)) ** 2:
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
