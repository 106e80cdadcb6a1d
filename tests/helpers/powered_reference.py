"""Powered walkers by scipy alone: gaits and gait sensitivity norms, without walker_jax.

By Runge-Kutta, places of the feet and velocities in the plane. States are full ones, just after
heel strike; disturbances are the height of the next foothold, the slope and a push. Parameters are
(slope, stiffness, damping, slack angle, push-off), or a function of the start that gives them.
"""

from math import cos, sin
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import root

WAY = {"rtol": 1e-13, "atol": 1e-14, "method": "DOP853"}
LONGEST = 8.0
"""Time within which a stride is over."""


def along(angle):
    return np.array([-np.sin(angle), np.cos(angle)])


def across(angle):
    return np.array([-np.cos(angle), -np.sin(angle)])


def values_at(parameters: Any, start) -> Any:
    return parameters(start) if callable(parameters) else parameters


def follow(parameters, full, step=0.0, slope=0.0, push=0.0):
    """The next full state, the time, and the length of the step; NaN where there is no strike."""
    theta, phi, thetadot, phidot = full
    start = [theta, phi, thetadot + push, phidot + (1 - np.cos(phi)) * push]
    own, stiffness, damping, slack, push_off = values_at(parameters, start)
    own = own + slope

    def field(t, y):
        theta, phi, thetadot, phidot = y.tolist()  # numbers of Python: several times as fast
        swing = sin(phi) * (thetadot**2 - cos(theta - own)) + sin(theta - own)
        swing += -stiffness * (phi - slack) - damping * phidot
        return [thetadot, phidot, sin(theta - own), swing]

    def height(t, y):
        return cos(y[0]) - cos(y[0] - y[1]) - step

    def stands(t, y):
        return min(-y[2], y[0] + np.pi / 2)

    height.direction, vars(stands)["terminal"] = -1, True
    solution = solve_ivp(field, (0, LONGEST), start, events=(height, stands), **WAY)
    # On even ground the height is zero, too, where the legs pass each other.
    ahead = (solution.y_events[0][:, 0] < 0) & (solution.y_events[0][:, 1] < -1e-6)
    if not ahead.any():
        return np.full(4, np.nan), np.nan, np.nan
    first = int(ahead.argmax())
    theta, phi, thetadot, _ = solution.y_events[0][first]
    hip = thetadot * across(theta) + push_off * along(theta)
    rate = hip @ across(theta - phi)
    length = np.sin(theta - phi) - np.sin(theta)
    after = np.array([theta - phi, -phi, rate, (1 - np.cos(phi)) * rate])
    return after, solution.t_events[0][first], length


def outlasts(parameters, x, strides):
    """Whether a walk from the section makes so many strides, its stance foot never pulled."""
    full = lift(x)
    for _ in range(strides):
        theta, _, thetadot, _ = full
        pulled = thetadot**2 > np.cos(theta - values_at(parameters, full)[0])
        full = follow(parameters, full)[0]
        if pulled or not full[2] < 0:
            return False
    return True


def lift(x):
    theta, thetadot = x
    return np.array([theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot])


def find_gait(parameters, guess):
    mismatch = lambda x: follow(parameters, lift(x))[0][[0, 2]] - x
    return root(mismatch, guess, options={"xtol": 1e-14}).x


def sensitivity_norm(parameters, guess, h=3e-5):
    """By differences of fourth order, of the state, and of time, length and speed."""
    full = lift(find_gait(parameters, guess))

    def response(z):
        after, time, length = follow(parameters, full + z[:4], *z[4:])
        return np.array([*after, time, length, length / time])

    columns = []
    for unit in np.eye(7) * h:
        one, two = (response(k * unit) - response(-k * unit) for k in (1, 2))
        columns.append((8 * one - two) / (12 * h))
    rates = np.array(columns).T
    A, B, C, D = rates[:4, :4], rates[:4, 4:], rates[4:, :4], rates[4:, 4:]
    X = solve_discrete_lyapunov(A.T, C.T @ C)
    return np.sqrt(np.trace(D.T @ D + B.T @ X @ B))
