"""Conditions within a mode: traced once, constant to derivatives, and least where they turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from walker_jax.hybrid.following import follow_mode
from walker_jax.hybrid.misses import Least, StepRecord, dip_between, find_least, with_rates
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.integrators.expansion import without_derivatives
from walker_jax.integrators.integrator import integrator_of

LENGTH = 2.0


def test_without_derivatives():
    """Neither the argument nor the closure has derivatives, and none are computed."""
    calls = []

    def value(p):
        def function(x):
            calls.append(x)
            return {"wave": jnp.sin(p * x) * p}

        constant = without_derivatives(function, 0.0, once=True)
        first = constant(2.0)["wave"]
        turn = lambda carry: (carry[0] + 1, carry[1] + constant(carry[1])["wave"])
        _, last = lax.while_loop(lambda carry: carry[0] < 3, turn, (0, first))
        return first, last

    first, last = value(jnp.float64(0.5))
    expected = [np.sin(1.0) / 2]
    for _ in range(3):
        expected.append(expected[-1] + np.sin(expected[-1] / 2) / 2)
    assert (float(first), float(last)) == pytest.approx((expected[0], expected[-1]), abs=1e-15)
    assert len(calls) == 1  # for both calls, one of them in a loop
    assert jax.jacfwd(lambda p: value(p)[0])(0.5) == 0
    assert jax.grad(lambda x: without_derivatives(lambda y: y * y, 0.0)(x))(3.0) == 0
    plain, varied = (
        str(jax.make_jaxpr(f)(0.5)).count(" mul ")
        for f in (value, lambda p: jax.jvp(value, (p,), (p,)))
    )
    assert plain == varied > 0


def seen_step(value, start: float = 0.0) -> tuple[Condition, StepRecord]:
    """Return a condition of time alone, and a step in which time goes on at the rate one."""
    mode = Mode(
        field=lambda state: (jnp.ones_like(state[0]),),
        guards=(Guard(lambda state: state[0] - 5, SECTION),),
        conditions=(Condition(lambda state: value(state[0]), "low"),),
    )
    begin, until = (jnp.float64(start),), jnp.float64(LENGTH)
    series = ([begin[0], jnp.float64(1), jnp.float64(0)],)
    step = StepRecord(begin, series, until, (begin[0] + LENGTH,), until, [], {})
    return with_rates(mode, begin).conditions[0], step


def least_of(value, **options) -> Least:
    condition, step = seen_step(value)
    if options.pop("known", False):
        options["known"] = condition.and_rate(step.start)
    return jax.jit(lambda: find_least(condition, step, **options))()


@pytest.mark.parametrize("known", [False, True])
def test_a_condition_is_least_where_it_turns(known):
    least = least_of(lambda t: jnp.exp(t) - 3 * t, known=known)
    assert float(least.time) == pytest.approx(np.log(3), abs=1e-8)
    assert float(least.value) == pytest.approx(3 - 3 * np.log(3), abs=1e-15)
    assert float(least.at_end) == pytest.approx(np.exp(2) - 6, abs=1e-14)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize(
    "value",
    [lambda t: t + 1, lambda t: -t - 1, lambda t: 1 - (t - 1) ** 2, lambda t: (t + 1) ** 2],
    ids=["rises", "falls", "has a maximum", "turned before"],
)
def test_a_condition_does_not_turn(value, known):
    least = least_of(value, known=known)
    assert float(least.value) == np.inf
    assert float(least.at_end) == float(value(LENGTH))


DIPS = {
    "rises again": lambda t, end: (t + 0.1) * (t - 1) ** 2,
    "falls again": lambda t, end: (end - t + 0.1) * (end - t - 1) ** 2,
    "begins level": lambda t, end: (t - 1) ** 2 * (2 * t + 1),
}
"""Functions that turn within a step, though their rates at its ends do not show it; least at zero,
one after its start or before its end."""


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("dip", DIPS)
def test_a_condition_turns_twice(dip, known):
    least = least_of(lambda t: DIPS[dip](t, LENGTH), known=known)
    assert float(least.time) == pytest.approx(1, abs=1e-8)  # where the step is two long
    assert abs(float(least.value)) < 1e-15


def test_cubics_that_turn_twice_are_known():
    """All cubics, against the roots of their derivatives."""
    rng, turned = np.random.default_rng(0), 0
    find = jax.jit(dip_between)
    for row in rng.normal(size=(300, 4)) * [1, 1, 3, 3]:
        value, length = np.polynomial.Polynomial(row), rng.uniform(0.1, 2)
        rate = value.deriv()
        roots = rate.roots()
        turns = np.isreal(roots).all() and ((roots.real > 0) & (roots.real < length)).all()
        dip = find((value(0.0), rate(0.0)), (value(length), rate(length)), length)
        assert bool(dip.exists) == turns
        turned += turns
        if turns:
            assert float(dip.part) * length == pytest.approx(roots.real.mean(), rel=1e-9)
    assert turned > 10


def test_a_violation_between_two_turns_is_noted():
    """A step of a mode whose only variable is time spans all of it."""
    end = 5.0
    conditions = [
        Condition(lambda s, by=by, dip=dip: DIPS[dip](s[0], end) + by, f"{dip}, {name}")
        for dip in DIPS
        for name, by in (("low", -1e-3), ("high", 1e-3))
    ]
    guard = Guard(lambda s: s[0] - end, SECTION)
    mode = Mode(lambda s: (jnp.ones_like(s[0]),), (guard,), tuple(conditions))
    start = (jnp.float64(0.0),)
    method = integrator_of(np.float64).method(mode.field, start)
    run = jax.jit(lambda: follow_mode(mode, start, jnp.asarray(True), method).violated)
    noted = {key: bool(flag) for key, flag in run().items()}
    assert noted == {f"{dip}, {name}": name == "low" for dip in DIPS for name in ("low", "high")}


def test_the_sign_alone_is_found_earlier():
    """The search for a sign ends at a negative value; where there is none, near the least one."""
    deep = least_of(lambda t: (t - 0.3) ** 2 - 0.5, sign_alone=True)
    assert -0.5 <= float(deep.value) < 0
    shallow = least_of(lambda t: (t - 0.3) ** 4 + 1e-3 * (t - 0.3) ** 2 + 1e-9, sign_alone=True)
    assert 0 < float(shallow.value) < 1.01e-9 and float(shallow.time) == pytest.approx(
        0.3, abs=1e-4
    )


def test_a_condition_that_is_not_finite():
    """Where a condition has no value, its least one is not known."""
    least = least_of(lambda t: jnp.where((t > 0.9) & (t < 1.1), jnp.nan, 1 + (t - 1) ** 2))
    assert np.isnan(float(least.value)) and float(least.at_end) == 2
    at_end = least_of(lambda t: jnp.where(t < 1, (t - 0.5) ** 2, jnp.nan))
    assert float(at_end.value) == np.inf and np.isnan(float(at_end.at_end))


@pytest.mark.parametrize("until", [0.0, -1e-18, np.nan])
def test_a_step_of_no_length(until):
    condition, step = seen_step(lambda t: t * t)
    step = step._replace(until=jnp.float64(until), arrival=step.start)
    least = jax.jit(lambda: find_least(condition, step, sign_alone=True))()
    assert float(least.value) == np.inf and float(least.at_end) == 0


def test_least_values_are_constant_to_derivatives():
    condition, step = seen_step(lambda t: jnp.exp(t) - 3 * t)

    def least(shift):
        moved = [step.series[0][0] + shift, *step.series[0][1:]]
        begin = (moved[0],)
        along = step._replace(start=begin, series=(moved,), arrival=(moved[0] + LENGTH,))
        return tuple(find_least(condition, along))

    assert jax.tree.leaves(jax.jit(jax.jacfwd(least))(0.0)) == [0, 0, 0]
    several = jax.vmap(least)(jnp.array([0.0, 0.5, -3.0]))
    expected = [3 - 3 * np.log(3)] * 2 + [np.inf]  # the last one does not turn
    np.testing.assert_allclose(several[1], expected, 1e-14)


def test_conditions_that_share_a_failure():
    """The one in the middle counts: at the start, and if all turn in the same step."""
    kept, broken = Condition(lambda s: s[1] + 10, "low"), Condition(lambda s: 0.99 - s[0], "low")
    conditions = kept, broken, kept
    mode = Mode(lambda s: (-s[0], s[0]), (Guard(lambda s: s[1] - 0.5, SECTION),), conditions)
    start = jnp.float64(1.0), jnp.float64(0.0)

    def follow(measured):
        method = integrator_of(np.float64).method(mode.field, start)
        return follow_mode(mode, start, jnp.asarray(True), method, measured=measured)

    assert bool(jax.jit(lambda: follow(False).violated["low"])())
    deep, shallow = (Condition(lambda s, c=c: (s[1] - 0.3) ** 2 + c, "low") for c in (0.25, 4.0))
    mode = mode._replace(conditions=(shallow, deep, shallow))
    least = jax.jit(lambda: follow(True).misses.least["low"])()
    assert float(least) == pytest.approx(0.25, abs=1e-12)
