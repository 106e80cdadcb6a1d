"""How nearly guards rise: their turns within one step, and what is kept from step to step.

Guards are polynomials of the only coordinate, which is the time, in a step of length 1.
"""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.hybrid.crossings import Crossing
from walker_jax.hybrid.following import Step, measured_step
from walker_jax.hybrid.misses import Misses, StepRecord, add_misses, turns_in_step
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.integrators.integrator import Memory

INF = np.inf
ALWAYS, NEVER = (lambda state: 1.0 + 0.0 * state[0]), (lambda state: -0.2 + 0.0 * state[0])
EARLY, LATE = (lambda state: 0.4 - state[0]), (lambda state: state[0] - 0.4)
FALLS_SHORT = lambda state: -((state[0] - 0.6) ** 2) - 0.1
STAYS_ABOVE = lambda state: (state[0] - 0.6) ** 2 + 0.1
SLOWS_DOWN = lambda state: (state[0] - 0.6) ** 3 + 0.05 * (state[0] - 0.6) + 0.3
RISES = lambda state: state[0] - 0.6


def seen(*guards: Guard, until: float = 1.0, violated: dict | None = None) -> StepRecord:
    """A step from the time 0, and the ends of each guard in it."""
    number = jnp.float64
    series = ([number(0), number(1), *[number(0)] * 5],)
    crossings = [
        Crossing(
            [], [], one.value((number(0),)) < 0, one.value((number(1),)) < 0, jnp.asarray(True)
        )
        for one in guards
    ]
    begin, end = (number(0),), (number(until),)
    return StepRecord(begin, series, number(1), end, number(until), crossings, violated or {})


def test_a_step_that_its_method_rejects_changes_no_side():
    """It has no length; a guard that falls from zero, as a mode begins, still counts as below."""
    guards = [Guard(value, SECTION) for value in (RISES, lambda state: state[0], ALWAYS)]
    mode = Mode(lambda state: (jnp.ones(()),), tuple(guards))
    method: Any = SimpleNamespace(
        is_series=False,
        step=lambda state, memory: ((), state, 0 * state[0], memory),
    )
    below = [jnp.asarray(True), jnp.asarray(True), jnp.asarray(False)]
    zero, yes = jnp.float64(0), jnp.asarray(True)
    step = Step((zero,), (zero,), zero, zero, below, below, [], yes, Memory((), None))
    assert measured_step(mode, method, step).ends_below == below


MISSES = [  # value, what admits it, its greatest miss
    (FALLS_SHORT, ALWAYS, -0.1),
    (FALLS_SHORT, LATE, -0.1),
    (FALLS_SHORT, EARLY, -INF),
    (STAYS_ABOVE, ALWAYS, -0.1),
    (STAYS_ABOVE, LATE, -0.1),
    (STAYS_ABOVE, EARLY, -INF),
    (SLOWS_DOWN, ALWAYS, -0.3),
    (SLOWS_DOWN, LATE, -0.3),
    (SLOWS_DOWN, EARLY, -INF),
    (RISES, NEVER, -0.2),
    (RISES, EARLY, -0.2),  # 0.4 - 0.6
    (RISES, LATE, -INF),  # it is no miss but a rise
]


def test_a_guard_misses_where_it_is_admitted():
    values, admits, expected = zip(*MISSES, strict=True)
    guards = [Guard(value, SECTION, (one,)) for value, one in zip(values, admits, strict=True)]
    step = seen(*guards)
    find = jax.jit(
        lambda: [turns_in_step(*one, step).miss for one in zip(guards, step.crossings, strict=True)]
    )
    np.testing.assert_allclose(find(), expected, rtol=1e-12)


LAST = Guard(lambda state: (state[0] - 0.3) * (state[0] - 0.8), SECTION, (NEVER,))
"""It is least at 0.55, at -1/16, and rises at 0.8, where it is not admitted."""
KNOWN = Misses(
    [jnp.float64(-0.5)],
    depth=[jnp.float64(0.01)],
    height=[jnp.float64(INF)],
    least={"low": jnp.float64(INF), "deep": jnp.float64(INF)},
    before={"low": [jnp.float64(-0.9)], "deep": [jnp.float64(-0.9)]},
)


@pytest.mark.parametrize(
    ("until", "depth"),
    [(1.0, -INF), (0.9, 1 / 16), (0.7, 1 / 16)],
    ids=["rises and goes on", "ends after the rise", "ends before it"],
)
def test_depth_is_counted_since_the_last_rise(until, depth):
    """A rise in a step that goes on begins anew; the end of the mode does not."""
    mode = Mode(lambda state: (jnp.ones(()),), (LAST,), ())
    (found,) = jax.jit(lambda: add_misses(mode, KNOWN, seen(LAST, until=until)).depth)()
    assert float(found) == pytest.approx(depth, rel=1e-12)


def test_misses_before_a_violation_are_those_up_to_its_step():
    conditions = tuple(
        Condition(lambda state: state[0], of, least_at_ends=True) for of in ("low", "deep")
    )
    mode = Mode(lambda state: (jnp.ones(()),), (LAST,), conditions)
    violated = {"low": jnp.asarray(True), "deep": jnp.asarray(False)}
    found = jax.jit(lambda: add_misses(mode, KNOWN, seen(LAST, violated=violated)))()
    assert float(found.nearest[-1]) == pytest.approx(-0.2)
    assert float(found.before["low"][0]) == -0.9
    assert float(found.before["deep"][0]) == pytest.approx(-0.2)
