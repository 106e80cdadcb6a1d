"""The graph of a system's modes: the order in which they are followed, and the errors it may have.

The modes are the nodes, and their guards the edges. Most edges point ahead in the order of
`in_order`, so that one pass follows all modes, each from where one before has led.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from walker_jax.checks import WrongUse, short
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.integrals import WithIntegrals
from walker_jax.integrators.taylor import VectorField, is_list

Modes = Mapping[str, Mode]


def in_order(modes: Modes) -> list[str]:
    """Return the names of modes in an order in which edges point ahead, where that can be.

    It is the reverse of the order in which a search in depth, from the first mode, leaves them.
    """
    left: list[str] = []
    seen: set[str] = set()

    def visit(name: str) -> None:
        seen.add(name)
        for guard in reversed(modes[name].guards):
            if guard.leads_to in modes and guard.leads_to not in seen:
                visit(guard.leads_to)
        left.append(name)

    visit(next(iter(modes)))
    return left[::-1]


def entered_again(modes: Modes) -> list[str]:
    """Return the modes to which an edge leads back, in the order of `in_order`."""
    order = in_order(modes)
    places = {name: i for i, name in enumerate(order)}
    back = {
        guard.leads_to
        for name in order
        for guard in modes[name].guards
        if guard.leads_to in places and places[guard.leads_to] <= places[name]
    }
    return [name for name in order if name in back]


def check_graph(label: str, modes: Any, failures: set[str]) -> None:
    """Raise `WrongUse` for modes that are no graph; `label` names their system.

    Every guard must lead to a mode, to the section or to one of the `failures`, and every mode must
    be reached from the first one. The section must be reached too.
    """
    if not isinstance(modes, dict) or not modes:
        raise WrongUse(f"modes of {label} must be a dictionary of modes, not {short(modes)}")
    for name, mode in modes.items():
        if not isinstance(name, str) or not isinstance(mode, Mode):
            raise WrongUse(f"modes of {label} must be modes by name, not {name!r}: {short(mode)}")
        if name in ("", SECTION) or name in failures:
            raise WrongUse(f"modes of {label} must have names that name no failure, not {name!r}")
        check_tuples(label, name, mode)
        known = {*modes, SECTION} | failures
        held = [one for guard in mode.guards for one in getattr(guard, "must_hold", ())]
        for part, ends, allowed in (
            ("guards", mode.guards, known),
            ("conditions", mode.conditions, failures),
            ("must_hold", held, failures),
        ):
            for end in ends:
                to = getattr(end, "leads_to", end)
                if not isinstance(to, str) or to not in allowed:
                    where = "a mode, to SECTION or " if part == "guards" else ""
                    raise WrongUse(
                        f"{part} of mode {name!r} of {label} must lead to {where}a failure, "
                        f"not to {short(to) if to else 'nothing'}"
                    )
    reached = in_order(modes)
    if lost := [name for name in modes if name not in reached]:
        raise WrongUse(f"modes of {label} must be reached from the first, unlike {lost[0]!r}")
    if not any(guard.leads_to == SECTION for mode in modes.values() for guard in mode.guards):
        raise WrongUse(f"modes of {label} must lead to SECTION, but no guard does")


def check_tuples(label: str, name: str, mode: Mode) -> None:
    """Raise `WrongUse` for one guard, condition or function where a tuple of them is meant."""
    parts: list[tuple[Any, str]] = [(mode, "guards"), (mode, "conditions")]
    for owner, part in parts:
        given = getattr(owner, part)
        if type(given) not in (tuple, list):
            raise WrongUse(
                f"{part} of mode {name!r} of {label} must be a tuple, not {short(given)}", of=part
            )
        if part == "guards":
            guards = [one for one in given if isinstance(one, Guard)]
            parts += [(guard, one) for guard in guards for one in ("admits", "must_hold")]


def kinds_of_states(modes: Modes, start: Any) -> dict[str, Any]:
    """Return the shapes of the states in which modes begin, and of the section's, by name.

    Raise `WrongUse` where resets into one mode return states of different kinds.
    """
    order = in_order(modes)
    kinds: dict[str, Any] = {order[0]: kind_of(start)}
    for name in order:
        for guard in modes[name].guards:
            to = guard.leads_to
            if to != SECTION and to not in modes:
                continue
            kind = kind_of(jax.eval_shape(guard.reset, kinds[name]))
            check_one_kind(to, kinds.setdefault(to, kind), kind)
    return kinds


def suit_state(name: str, mode: Mode, state: Any) -> Mode:
    """Return a mode with rates of the type of the state in which it begins.

    Raise `WrongUse` unless its equations and guards suit that state.
    """
    check_state(name, state)
    kind = kind_of(state)
    rates = kind_of(jax.eval_shape(mode.rates, state))
    if not has_shapes(rates, kind):
        raise WrongUse(
            f"equations of mode {name!r} must return rates of the shapes of its state, "
            f"{in_words(kind)}, not {in_words(rates)}"
        )
    for guard in mode.guards:
        value = kind_of(jax.eval_shape(guard.value, state))
        if not has_shapes(value, jax.ShapeDtypeStruct((), float)):
            raise WrongUse(f"guards of mode {name!r} must be one number, not {in_words(value)}")
    types = {x.dtype for x in jax.tree.leaves((kind, rates))}
    if len(types) == 1:
        return mode
    if isinstance(mode.field, WithIntegrals):
        typed = WithIntegrals(RatesOfType(mode.field.motion), mode.field.rates)
        return mode._replace(field=typed)
    return mode._replace(field=RatesOfType(mode.field))


def check_state(name: str, state: Any) -> None:
    """Raise `WrongUse` unless a mode can begin in a state: numbers, of one type."""
    if any(map(is_list, jax.tree.leaves(state, is_leaf=is_list))):
        raise WrongUse(
            f"states of mode {name!r} must be of tuples rather than lists: {short(state)}"
        )
    kind = kind_of(state)
    leaves = jax.tree.leaves(kind)
    types = {x.dtype for x in leaves}
    floating = len(types) == 1 and all(jnp.issubdtype(one, jnp.floating) for one in types)
    if not floating or not all(x.size for x in leaves):
        raise WrongUse(
            f"states of mode {name!r} must be floating-point numbers of one type, "
            f"not {in_words(kind)}"
        )


def check_states(modes: Modes, start: Any) -> None:
    """Raise `WrongUse` unless the modes suit the states in which they begin (`suit_state`)."""
    for name, kind in kinds_of_states(modes, start).items():
        if name in modes:
            state = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), kind)
            suit_state(name, modes[name], state)


class RatesOfType(eqx.Module):
    """Rates in the type of the state, such as whole numbers in floating point."""

    field: VectorField

    def __call__(self, state):
        convert = lambda rate, x: jnp.asarray(rate, x.dtype)
        return jax.tree.map(convert, self.field(state), state)


def has_shapes(kind: Any, known: Any) -> bool:
    """Return whether a tree has the structure of another, and leaves of its shapes or numbers."""
    one, other = jax.tree.structure(kind), jax.tree.structure(known)
    pairs = zip(jax.tree.leaves(kind), jax.tree.leaves(known), strict=False)
    return one == other and all(a.shape in ((), b.shape) for a, b in pairs)


def kind_of(state: Any) -> Any:
    """Return the structure of a state, with the shapes and types of its leaves."""
    made = jax.eval_shape(lambda: state)
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), made)


def in_words(kind: Any) -> str:
    """Return a kind of states on one line."""
    return " ".join(eqx.tree_pformat(kind, struct_as_array=True).split())


def check_one_kind(to: str, known: Any, other: Any) -> None:
    """Raise `WrongUse` for two kinds of states in which a mode, or the section, is entered."""
    if jax.tree.flatten(known) != jax.tree.flatten(other):
        described = f"{in_words(known)} and {in_words(other)}"
        raise WrongUse(f"resets into {to!r} must return states of one kind, not {described}")
