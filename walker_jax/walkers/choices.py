"""Choices of parameters: by the names of numbers, of whole leaves, or by a function of the walker.

A choice is the tuple of the names of its numbers, `slope` or `policy.layers[0].weight[1, 0]`.
"""

from collections.abc import Callable, Container, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.kernels.transposes import FEWEST_FOR_ADJOINT
from walker_jax.systems.system import System, leaves_of
from walker_jax.systems.trees import names_in_tree, own_shape
from walker_jax.walkers.parameters import check_parameter, is_number_of, parse_entry

Choice = str | Sequence[str] | Callable[[Any], Any]
"""A name, several names, or a function of a walker that returns leaves of it, as for
`eqx.tree_at`."""

MANY = FEWEST_FOR_ADJOINT
"""Numbers from which on derivatives are computed in reverse: the kernels then transpose the steps
of a stride, at the cost of three to six strides for any number."""


def numbers_chosen(walker: System, parameters: Choice) -> tuple[str, ...]:
    """Return the names of the numbers of a choice, those of an array in their C order.

    Raises `WrongUse` for names that the walker does not have, and for leaves without real numbers.
    """
    check_kind("walker", walker, System)
    if callable(parameters):
        names = leaves_returned(walker, parameters)
    else:
        names = [parameters] if isinstance(parameters, str) else parameters
        check_kind("parameters", names, Sequence)
    return tuple(dict.fromkeys(one for name in names for one in numbers_in(walker, name)))


def leaves_returned(walker: System, where: Callable[[Any], Any]) -> list[str]:
    """Return the names of the leaves that a function of the walker returns."""
    leaves, structure = jax.tree.flatten(walker)
    try:
        places = jax.tree.leaves(where(structure.unflatten(range(len(leaves)))))
        names = [names_in_tree(walker)[place] for place in places]
    except Exception as error:  # of a user's function
        raise WrongUse(
            f"parameters must return leaves of the walker, not raise {short(str(error))}"
        ) from None
    if not names:
        raise WrongUse("parameters must return one leaf of the walker or more, not none")
    return names


def numbers_in(walker: System, name: Any) -> list[str]:
    """Return the names of the numbers in a leaf, or in a tree, of a walker."""
    if is_number_of(walker, name) or not isinstance(name, str):
        check_parameter(walker, name)
        return [name]
    ranks, found = dict(walker.array_ranks), []
    for leaf, value in leaves_of(walker).items():
        if leaf != name and not leaf.startswith((f"{name}.", f"{name}[")):
            continue
        shape = own_shape(value, ranks.get(leaf, 0))
        if jnp.issubdtype(jnp.result_type(value), jnp.floating):
            found += [entry_name(leaf, place) for place in np.ndindex(shape)]
    if not found:
        check_parameter(walker, name)
    return found


def entry_name(leaf: str, place: tuple[int, ...]) -> str:
    """Return the name of a number in a leaf."""
    return f"{leaf}[{', '.join(map(str, place))}]" if place else leaf


def values_of(tree: System, names: Sequence[str]) -> Float[np.ndarray, "*many numbers"]:
    """Return the numbers of a choice: of a walker, or of derivatives by it, with their axes."""
    leaves = {name: np.asarray(leaf) for name, leaf in leaves_of(tree).items()}
    places = [place_in(leaves, name) for name in names]
    columns = [leaves[leaf][(..., *entry)] for leaf, entry in places]
    return np.stack(columns, axis=-1) if columns else np.zeros(0)


def leaves_with(names: Sequence[str], walker: System) -> tuple[str, ...]:
    """Return the names of the leaves that hold the numbers of a choice."""
    leaves = leaves_of(walker)
    return tuple(dict.fromkeys(place_in(leaves, name)[0] for name in names))


def place_in(leaves: Container[str], name: str) -> tuple[str, tuple[int, ...]]:
    """Return the leaf of a number, and the number's place in it."""
    return (name, ()) if name in leaves else parse_entry(name)
