"""Strides of walkers like the simplest one by small steps of one length, in NumPy alone.

Independent of the package: Runge-Kutta steps of fourth order, events by signs at the ends of steps
and at turning points in between, bisected.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Rows = np.ndarray
"""Rows of (theta, phi, thetadot, phidot)."""
STEP = 0.008
NEAR, TINY = 1e-4, 1e-5
"""From zero, so far that no function turns back from farther in a step; of a step's duration."""


def contact(y: Rows) -> np.ndarray:
    """h."""
    return y[:, 1] - 2 * y[:, 0]


class Legs(NamedTuple):
    """The simplest walker, with a torque in its hip and rules of its own."""

    slope: float
    torque: Callable[[Rows], Any] = lambda y: 0.0
    ahead: Callable[[Rows], np.ndarray] = lambda y: y[:, 0] < 0
    falls: tuple[tuple[int, Callable[[Rows], np.ndarray]], ...] = (
        (2, lambda y: y[:, 2]),
        (1, lambda y: -np.pi / 2 - y[:, 0]),
    )
    """Outcomes, and what is not negative in such a fall, the first of them first."""
    condition: tuple[int, Callable[[Rows], np.ndarray]] | None = None
    """An outcome, and what must not be negative in a stride that reaches heel strike."""
    grip: float = 1.0
    """Weight that presses the stance foot down, in that of the hip."""
    kept: float = 1.0
    """Part of all rates that is left after an impact."""


class Ends(NamedTuple):
    outcome: np.ndarray
    state: np.ndarray
    """On the section, after heel strike; NaN unless it is a stride."""


def advance(legs: Legs, y: Rows, h: Any) -> Rows:
    h = np.reshape(h, (-1, 1))

    def rates(y: Rows) -> Rows:
        theta, phi, thetadot, phidot = y.T
        angle = theta - legs.slope
        swing = np.sin(phi) * (thetadot**2 - np.cos(angle)) + np.sin(angle) + legs.torque(y)
        return np.stack([thetadot, phidot, np.sin(angle), swing], axis=1)

    one = rates(y)
    two = rates(y + h / 2 * one)
    three = rates(y + h / 2 * two)
    return y + h / 6 * (one + 2 * two + 2 * three + rates(y + h * three))


def bisect(legs: Legs, y: Rows, high: np.ndarray, is_late: Callable[[Rows], np.ndarray]):
    """The least part of steps after which something holds that holds after `high`."""
    low = np.zeros(len(y))
    for _ in range(50):
        middle = (low + high) / 2
        late = is_late(advance(legs, y, middle))
        low, high = np.where(late, low, middle), np.where(late, middle, high)
    return high


def first_rise(legs: Legs, y: Rows, end: Rows, value: Callable[[Rows], np.ndarray]) -> np.ndarray:
    """When a function rises through zero in a step, also to fall again; infinite if it does not."""
    when, before, after = np.full(len(y), np.inf), value(y), value(end)
    limit = np.full(len(y), STEP)
    rises = (before < 0) & (after >= 0)
    near = (before < 0) & (after < 0) & (np.maximum(before, after) > -NEAR)
    if near.any():
        at = lambda z, time: value(advance(legs, z, time))
        falling = lambda z: at(z, TINY) < at(z, -TINY)
        limit[near] = bisect(legs, y[near], limit[near], falling)
        rises[near] = value(advance(legs, y[near], limit[near])) >= 0
    if rises.any():
        when[rises] = bisect(legs, y[rises], limit[rises], lambda z: value(z) >= 0)
    return when


def strides(legs: Legs, x: np.ndarray, longest: float = 40.0) -> Ends:
    """Strides from rows of (theta, thetadot) on the section, all of them feasible."""
    theta, thetadot = x.T
    y = np.stack([theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot], axis=1)
    outcome, arrival = np.full(len(x), 6), np.full((len(x), 4), np.nan)
    broken, pulled = np.zeros(len(x), bool), np.zeros(len(x), bool)
    tense = lambda z: z[:, 2] ** 2 > legs.grip * np.cos(z[:, 0] - legs.slope)
    for code, value in reversed(legs.falls):
        outcome[value(y) >= 0] = code
    outcome[tense(y)] = 3
    if legs.condition:
        broken |= legs.condition[1](y) < 0
    going = np.flatnonzero(outcome == 6)
    y = y[going]
    for _ in range(int(longest / STEP)):
        if not len(going):
            break
        end = advance(legs, y, STEP)
        strike, landing = first_rise(legs, y, end, contact), y.copy()
        known = np.isfinite(strike)
        if known.any():
            landing[known] = advance(legs, y[known], strike[known])
        strike[~legs.ahead(landing)] = np.inf
        first, codes = strike, np.where(np.isfinite(strike), 0, 6)
        for code, value in legs.falls:
            fall = first_rise(legs, y, end, value)
            codes, first = np.where(fall < first, code, codes), np.minimum(fall, first)
        last = np.where((codes == 0)[:, None], landing, end)
        if legs.condition:
            broken[going] |= (legs.condition[1](last) < 0) & np.isin(codes, [0, 6])
        pulled[going] |= tense(last) & np.isin(codes, [0, 6])
        outcome[going], arrival[going] = codes, landing
        y, going = end[codes == 6], going[codes == 6]
    struck = outcome == 0
    theta, phi, thetadot, _ = arrival.T
    c, s = np.cos(phi), np.sin(phi)
    rates = legs.kept * c * thetadot, legs.kept * (1 - c) * c * thetadot
    after = np.stack([theta - phi, -phi, *rates], axis=1)
    for code, value in reversed(legs.falls):
        outcome[struck & (value(after) >= 0)] = code
    outcome[struck & (np.cos(theta) * c * s * thetadot <= 0)] = 4
    if legs.condition:
        outcome[struck & broken] = legs.condition[0]
    outcome[struck & pulled] = 3
    state = np.where(outcome[:, None] == 0, after[:, [0, 2]], np.nan)
    return Ends(outcome, state)
