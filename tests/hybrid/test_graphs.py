"""Modes that are no graph are refused, and those that are have their order."""

import re
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from part_of_swing import PartOfSwing

import walker_jax as wj
from walker_jax.hybrid.graphs import entered_again, in_order, kinds_of_states
from walker_jax.integrators.integrator import Integrator
from walker_jax.walking.stride import begin_course, follow_graph


class Moving(NamedTuple):
    place: Any
    time: Any


class Waiting(NamedTuple):
    place: Any
    left: Any


FIELD = lambda y: jnp.ones_like(y)
RISES = lambda y: y[0] - 1


def mode(*names, **fields):
    """A mode whose guards lead to places of these names."""
    return wj.Mode(FIELD, tuple(wj.Guard(RISES, name) for name in names), **fields)


class Made(wj.HybridSystem):
    """A system of the modes that it is made of."""

    section = ("x",)
    failures = ("stuck",)

    def lift(self, x):
        return x

    def project(self, state):
        return state[:1]


def system_of(modes, **more):
    return type("Made", (Made,), {"modes": lambda self: modes, **more})()


NO_END = "guards of mode 'a' of Made must lead to a mode, to SECTION or a failure, not to "
HELD = wj.Guard(RISES, wj.SECTION, must_hold=(wj.Condition(RISES, "b"),))


@pytest.mark.parametrize(
    ("modes", "said"),
    [
        ((mode(wj.SECTION),), "modes of Made must be a dictionary of modes, not (Mode("),
        ({}, "modes of Made must be a dictionary of modes, not {}"),
        ({0: mode(wj.SECTION)}, "modes of Made must be modes by name, not 0: Mode("),
        ({"a": RISES}, "modes of Made must be modes by name, not 'a': <function"),
        ({"stuck": mode(wj.SECTION)}, "must have names that name no failure, not 'stuck'"),
        ({"FORWARD": mode(wj.SECTION)}, "must have names that name no failure, not 'FORWARD'"),
        ({wj.SECTION: mode(wj.SECTION)}, "must have names that name no failure, not 'section'"),
        ({"": mode(wj.SECTION)}, "must have names that name no failure, not ''"),
        ({"a": mode("b", wj.SECTION)}, NO_END + "'b'"),
        ({"a": mode(wj.SECTION, "STRIDE")}, NO_END + "'STRIDE'"),
        ({"a": mode(wj.SECTION, wj.Outcome.FORWARD)}, NO_END + "<Outcome.FORWARD: 1>"),
        ({"a": mode(wj.SECTION, "")}, NO_END + "nothing"),
        ({"a": wj.Mode(FIELD, (wj.Guard(RISES),))}, NO_END + "nothing"),
        ({"a": mode(wj.SECTION)._replace(guards=(RISES,))}, NO_END + "<function"),
        (
            {"a": mode(wj.SECTION)._replace(guards=wj.Guard(RISES, wj.SECTION))},
            "guards of mode 'a' of Made must be a tuple, not Guard(",
        ),
        (
            {"a": mode(wj.SECTION)._replace(guards=(HELD._replace(admits=RISES),))},
            "admits of mode 'a' of Made must be a tuple, not <function",
        ),
        (
            {"a": mode("b", conditions=(wj.Condition(RISES, "b"),)), "b": mode(wj.SECTION)},
            "conditions of mode 'a' of Made must lead to a failure, not to 'b'",
        ),
        (
            {"a": mode("b"), "b": wj.Mode(FIELD, (HELD,))},
            "must_hold of mode 'b' of Made must lead to a failure, not to 'b'",
        ),
        (
            {"a": mode(wj.SECTION), "b": mode("c"), "c": mode("a")},
            "modes of Made must be reached from the first, unlike 'b'",
        ),
        (
            {"a": mode("b", "stuck"), "b": mode("a", "FORWARD")},
            "modes of Made must lead to SECTION, but no guard does",
        ),
    ],
)
def test_modes_that_are_no_graph_are_refused(modes, said):
    for follow in (wj.stride, wj.margins, wj.trajectory, wj.explain):
        more = ([0.5],) if follow is wj.trajectory else ()
        with pytest.raises(ValueError, match=re.escape(said)) as told:
            follow(system_of(modes), jnp.array([0.2]), *more)
        assert "\n" not in str(told.value)


def test_modes_are_in_an_order_in_which_edges_point_ahead():
    """However they are listed; edges that lead back are those to modes that are entered again."""
    ahead = {"a": mode("c", "b"), "c": mode("d"), "b": mode("c", "d"), "d": mode(wj.SECTION)}
    assert in_order(ahead) == ["a", "b", "c", "d"] and entered_again(ahead) == []
    back = ahead | {"d": mode("b", "stuck", wj.SECTION)}
    assert in_order(back) == ["a", "b", "c", "d"] and entered_again(back) == ["b"]
    assert entered_again({"a": mode("a", wj.SECTION)}) == ["a"]
    rng = np.random.default_rng(5)
    for _ in range(50):  # graphs whose edges all point ahead in a hidden order
        names = [f"mode {i}" for i in range(8)]
        to = {
            one: [names[i + 1], *rng.choice(names[i + 1 :], 2)] if i < 7 else [wj.SECTION]
            for i, one in enumerate(names)
        }
        listed = [names[0], *rng.permutation(names[1:])]
        modes = {one: mode(*rng.permutation(to[one])) for one in listed}
        assert in_order(modes) == names and entered_again(modes) == []


def test_modes_have_one_order_whatever_hashes_names_have():
    """Sets of names have another order in each process, and traces are kept for the next one."""

    def trace(prefix):
        name = lambda one: wj.SECTION if one == wj.SECTION else f"{prefix}_{one}"
        lost = tuple(name(one) for one in ("late", "lost", "low", "slow"))
        held = tuple(wj.Condition(lambda y: 2 + jnp.sum(y), one) for one in lost)
        to = {"a": "b", "b": "a", "d": "b"}
        modes = {
            name(one): mode(name("d"), name(other), wj.SECTION, conditions=held)
            for one, other in to.items()
        }
        system = system_of(modes, failures=lost)

        def follow(x):
            begun = begin_course(name("a"), x, jnp.asarray(True))
            return follow_graph(system, modes, begun, Integrator(1e-12))[0]

        return re.sub("0x[0-9a-f]+", "", str(jax.make_jaxpr(follow)(jnp.array([0.2]))))

    one, *others = map(trace, "apr")  # before "section" in the alphabet, as trees sort names
    assert len(one) > 1000 and all(other == one for other in others)


def fork(by_place, by_time, *ends, **more):
    """A motion that rests from the place 1 or the time 5 on, each with a reset, and moves on."""
    ones = lambda y: jax.tree.map(jnp.ones_like, y)
    at_place = wj.Guard(lambda y: y.place - 1, "rest", reset=by_place)
    at_time = wj.Guard(lambda y: y.time - 5, "rest", reset=by_time)
    rests = [wj.Guard(lambda y: y[1] - 2, name) for name in ends]
    modes = {"move": wj.Mode(ones, (at_place, at_time)), "rest": wj.Mode(ones, tuple(rests))}
    lift = lambda self, x: Moving(x[0], 0 * x[0])
    return system_of(modes, lift=lift, project=lambda self, y: y[0][None], **more)


def waits(y):
    return Waiting(y.place, 0 * y.time)


@pytest.mark.parametrize("ends", [(wj.SECTION,), (wj.SECTION, "move")], ids=["once", "again"])
def test_resets_to_different_states_of_one_mode_are_refused(ends):
    others = (
        lambda y: y,
        lambda y: Moving(y.place[None], y.time),
        lambda y: Waiting(y.place, jnp.zeros(2)),
        lambda y: {"place": y.place, "left": y.time},
    )
    for follow in (wj.stride, wj.margins):
        for one, other in [(waits, reset) for reset in others] + [(others[0], waits)]:
            said = "resets into 'rest' must return states of one kind, not .* and "
            with pytest.raises(ValueError, match=said) as told:
                follow(fork(one, other, *ends), jnp.array([0.2]))
            assert "\n" not in str(told.value)
    if len(ends) > 1:  # the first mode begins in the state of `lift`, too
        with pytest.raises(ValueError, match="resets into 'move' must return states of one kind"):
            wj.stride(fork(waits, waits, *ends), jnp.array([0.2]))


def test_a_mode_may_have_states_of_its_own():
    system = fork(waits, waits, wj.SECTION)
    made = wj.strides(system, np.array([[0.2], [-9.0]]))
    np.testing.assert_allclose(made.state[:, 0], [3.0, -2.0], rtol=1e-14)
    np.testing.assert_allclose(made.time, [2.8, 7.0], rtol=1e-14)
    kinds = kinds_of_states(system.modes(), Moving(1.0, 0.0))
    assert {name: type(one) for name, one in kinds.items()} == {
        "move": Moving,
        "rest": Waiting,
        wj.SECTION: Waiting,
    }
    said = "mode 'rest' has a state of another kind than the first one, unless shown makes it one"
    with pytest.raises(ValueError, match=said):
        wj.trajectory(system, jnp.array([0.2]), [1.0])
    shown = lambda self, state: Moving(*state)
    states = wj.trajectory(
        fork(waits, waits, wj.SECTION, shown=shown), jnp.array([0.2]), [0.5, 1.8]
    )
    np.testing.assert_allclose(states.place, [0.7, 2.0], rtol=1e-14)


def test_phases_of_one_name_are_refused():
    class Part(PartOfSwing):
        def event(self, state):
            return -state.theta

    class Twice(wj.SimplestWalker):
        def phases(self):
            return Part(self), Part(self)

    said = r"phases of Twice must have different names, not \['Part', 'Part', 'swing'\]"
    with pytest.raises(ValueError, match=said):
        wj.stride(Twice(0.01), jnp.array([0.2, -0.2]))


def turning(
    first, time, rates=lambda y: jnp.stack([y[1], -y[0]]), rate=1.0, value=lambda y: y[1] - 1
):
    """A system whose state is a pair: x turns by an angle of 1, in that time."""
    field = lambda y: (rates(y[0]), rate)
    end = wj.Guard(value, wj.SECTION)
    return system_of(
        {"turn": wj.Mode(field, (end,))},
        section=("p", "q"),
        lift=lambda self, x: first(x, time),
        project=lambda self, state: state[0],
    )


PAIR = lambda *parts: parts
X = np.array([0.3, 0.5])
TURNED = [X[0] * np.cos(1) + X[1] * np.sin(1), X[1] * np.cos(1) - X[0] * np.sin(1)]


@pytest.mark.parametrize(
    ("time", "rate"),
    [
        (np.float32(0), 1),
        pytest.param(0, np.int32(1), marks=pytest.mark.slow),
        pytest.param(0.0, np.float32(1), marks=pytest.mark.slow),
        pytest.param(np.int8(0), 1.0, marks=pytest.mark.slow),
    ],
)
def test_numbers_of_any_type_may_stand_in_a_state(time, rate):
    system = turning(PAIR, time, rate=rate)
    np.testing.assert_allclose(wj.stride(system, X).state, TURNED, rtol=1e-13)
    np.testing.assert_allclose(wj.trajectory(system, X, [1.0])[0][0], TURNED, rtol=1e-12)
    assert "STRIDE" in str(wj.explain(system, X))
    single = wj.stride(system, X.astype(np.float32)).state
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, TURNED, rtol=1e-5)


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (
            turning(lambda *y: [*y], 0.0),
            "states of mode 'turn' must be of tuples rather than lists",
        ),
        (turning(PAIR, True), "must be floating-point numbers of one type, not (f64[2], bool[])"),
        (turning(lambda *y: (), 0.0), "must be floating-point numbers of one type, not ()"),
        (turning(PAIR, np.zeros(0)), "floating-point numbers of one type, not (f64[2], f64[0])"),
        (
            turning(PAIR, 0.0, lambda y: [y[1], -y[0]]),
            "equations of mode 'turn' must return rates of the shapes of its state, "
            "(f64[2], f64[]), not ([f64[], f64[]], f64[])",
        ),
        (
            turning(PAIR, 0.0, lambda y: jnp.stack([y[1], -y[0]])[:, None]),
            "the shapes of its state, (f64[2], f64[]), not (f64[2,1], f64[])",
        ),
        (
            turning(PAIR, 0.0, value=lambda y: jnp.stack([y[1] - 1])),
            "guards of mode 'turn' must be one number, not f64[1]",
        ),
    ],
)
def test_states_that_cannot_be_integrated_are_refused(system, said):
    class Summed(type(system)):
        def modes(self):
            unit = {"unit": lambda y: 1.0}
            return {name: one._replace(integrals=unit) for name, one in super().modes().items()}

    for follow in (wj.stride, wj.margins, wj.trajectory, wj.explain, wj.integrals):
        more = ([0.5],) if follow is wj.trajectory else ()
        system = Summed() if follow is wj.integrals else system
        with pytest.raises(ValueError, match=re.escape(said)) as told:
            follow(system, X, *more)
        assert "\n" not in str(told.value)


def test_a_reset_returns_a_state_of_one_type():
    counts = wj.Guard(lambda y: y[1] - 1, "b", reset=lambda y: (y[0], jnp.zeros((), jnp.float32)))
    field, end = (lambda y: (0 * y[0], 1.0)), wj.Guard(lambda y: y[1] - 1, wj.SECTION)
    modes = {"a": wj.Mode(field, (counts,)), "b": wj.Mode(field, (end,))}
    ends = {"lift": lambda self, x: (x, 0.0), "project": lambda self, state: state[0]}
    said = "states of mode 'b' must be floating-point numbers of one type, not (f64[1], f32[])"
    with pytest.raises(ValueError, match=re.escape(said)):
        wj.stride(system_of(modes, **ends), np.array([0.2]))
