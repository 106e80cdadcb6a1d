"""Strides by SciPy along a system's own modes: its fields, guards and resets, one after the other.

A model's equations are so checked without the loop over modes, which takes far longer to compile
than they do, and has tests of its own.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp

import walker_jax as wj

DUE = 1e-9
"""A guard has risen before its mode begins if its value is larger; less is rounding."""


class ModesByScipy:
    """Strides of systems of one class; what is compiled for one serves all of them."""

    def __init__(self):
        self.compiled: dict[str, Any] = {}

    def stride(self, system, x):
        """The next point of the section and the time, or the failure and the time."""
        system = jax.tree.map(jnp.asarray, system)
        modes = system.modes()
        name, state, time = next(iter(modes)), system.lift(jnp.asarray(x, float)), 0.0
        while True:
            y, unravel = ravel_pytree(state)
            look = self.looking_at(name, unravel)
            y, guard, passed = follow(lambda y, look=look: look(system, y), np.asarray(y))
            time, risen = time + passed, modes[name].guards[guard]
            state = risen.reset(unravel(jnp.asarray(y)))
            if risen.leads_to == wj.SECTION:
                return np.asarray(system.project(state)), time
            if risen.leads_to not in modes:
                return risen.leads_to, time
            name = risen.leads_to

    def looking_at(self, name, unravel):
        """Rates, values of the guards and whether they are admitted, in a mode of that name."""

        def look(system, y):
            mode, state = system.modes()[name], unravel(y)
            values = jnp.stack([guard.value(state) for guard in mode.guards])
            admitted = jnp.stack([guard.admitted(state) for guard in mode.guards])
            return ravel_pytree(mode.rates(state))[0], values, admitted

        return self.compiled.setdefault(name, jax.jit(look))


def follow(look, y):
    """The state in which a guard rises, the guard's number, and when; at once if one has risen.

    A value that is zero as the mode begins must fall first.
    """
    _, values, admitted = map(np.asarray, look(y))
    due = np.flatnonzero((values > DUE) & admitted)
    if len(due):
        return y, due[0], 0.0

    def event(i):
        rise: Any = lambda _, y: float(look(y)[1][i])
        rise.terminal, rise.direction = True, 1
        return rise

    time, how = 0.0, dict[str, Any](rtol=1e-13, atol=1e-13, first_step=1e-3)
    events = [event(i) for i in range(len(values))]
    while True:
        rates = lambda _, y: np.asarray(look(y)[0])
        made = solve_ivp(rates, (0, 20), y, "DOP853", events=events, **how)
        first = next(i for i, one in enumerate(made.t_events) if one.size)
        y, time = made.y_events[first][0], time + made.t_events[first][0]
        _, values, admitted = map(np.asarray, look(y))
        risen = np.flatnonzero((np.abs(values) < DUE) & admitted)  # some guards share a value
        if len(risen):
            return y, risen[0], time
