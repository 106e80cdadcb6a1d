"""The state of an object is all that pickle takes of it; a few types, listed here, state their own.

Classes and functions have other descriptions, as `identity` says.
"""

import copyreg
import functools
import random
import threading
import weakref
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any

import jax

HOLDERS = property, classmethod, staticmethod, type(functools.cache(len))
"""Types of objects that hold functions."""
JITTED = "fun", "static_argnums", "static_argnames", "global_cache_key"
"""What a jitted function holds, but for its place in a file and what it has compiled."""
NEW = object().__reduce_ex__(2)[0]
"""The function by which pickle makes an object of a class."""
DERIVED = set(
    "__dict__ __weakref__ __doc__ _abc_impl __annotations__ __module__ __annotate_func__ "
    "__annotations_cache__ __static_attributes__ __firstlineno__ __dataclass_params__ "
    "__parameters__ __orig_bases__ __slotnames__ cache_parameters".split()
)
"""Attributes that Python derives from the others, or from the lines of a file."""


def functions_held(value: Any) -> tuple:
    """Return the functions that a property or a decorated method holds, and its attributes."""
    attributes = getattr(value, "__dict__", {})
    added = {name: attributes[name] for name in attributes if name not in DERIVED}
    held = "__wrapped__", "fget", "fset", "fdel"
    return *(getattr(value, name, None) for name in held), added


UNPICKLED: dict[Any, Callable[[Any], tuple]] = {
    HOLDERS: functions_held,
    type(jax.numpy.sin): lambda jitted: tuple(map(jitted.__getstate__().get, JITTED)),
    jax.tree_util.PyTreeDef: lambda tree: (tree.node_data(), tree.children()),
    ContextVar: lambda variable: (variable.name, variable.get(None)),
    weakref.ref: lambda reference: (reference(),),
    type(threading.RLock()): lambda lock: ("a lock",),  # of a cached property
}
"""Types that pickle refuses or takes by another state, with the state that counts."""


def state_of(value: Any) -> tuple | str | None:
    """Return the state of an object; if pickle takes no more, its name; None if it is unknown."""
    if value is random.getrandbits.__self__:  # anybody's draw would change it
        return "random"
    for kind, state_that_counts in UNPICKLED.items():
        if isinstance(value, kind):
            return state_that_counts(value)
    try:
        state = pickled_state(value)
    except Exception:  # a user's `__reduce_ex__` may raise
        state = name_of_compiled(value)
    if isinstance(state, str) and not all(map(str.isidentifier, state.split("."))):
        return None  # pickle finds nothing under a name such as <lambda>
    return state


def pickled_state(value: Any) -> tuple | str:
    """Return what pickle takes of an object, its class first; only a name if it takes that."""
    reduce = copyreg.dispatch_table.get(type(value))
    state = reduce(value) if reduce else value.__reduce_ex__(2)
    if isinstance(state, str):
        return state
    # Iterators over its items, whose own state would be the list and a place in it.
    return *state[:3], *(items and [*items] for items in state[3:5])


def name_of_compiled(value: Any) -> str | None:
    """Return the name of a compiled function or method; None for any other object."""
    if hasattr(value, "__dict__") or not (callable(value) or hasattr(value, "__objclass__")):
        return None
    return getattr(value, "__qualname__", None)


def has_no_state(state: tuple) -> bool:
    """Return whether pickle makes the object again from its class alone."""
    return state[0] is NEW and len(state[1]) == 1 and all(one is None for one in state[2:])
