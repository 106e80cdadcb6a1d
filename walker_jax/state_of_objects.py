"""The state of an object: all that it holds, as pickle takes it."""

import copyreg
import functools
import random
import threading
import weakref
from contextvars import ContextVar
from typing import Any

import jax

HOLDERS = property, classmethod, staticmethod, type(functools.cache(len))
"""Types of objects that hold functions, and that pickle does not take."""
HELD = "__wrapped__", "fget", "fset", "fdel"
NEW = object().__reduce_ex__(2)[0]
"""The function by which pickle makes an object of a class."""
LOCK = type(threading.RLock())
"""Type of the lock of a cached property."""
JIT = type(jax.numpy.sin)
"""Type of a jitted function."""
JITTED = "fun", "static_argnums", "static_argnames", "global_cache_key"
"""What a jitted function holds, but for its place in a file and what it has compiled."""
DERIVED = set(
    "__dict__ __weakref__ __doc__ _abc_impl __annotations__ __module__ __annotate_func__ "
    "__annotations_cache__ __static_attributes__ __firstlineno__ __dataclass_params__ "
    "__parameters__ __orig_bases__ __slotnames__ cache_parameters".split()
)
"""Attributes that Python derives from the others, or from the lines of a file."""


def state_of(value: Any) -> tuple | str | None:
    """Return the state of an object; if pickle takes no more, its name; None if it is unknown."""
    if isinstance(value, HOLDERS):
        attributes = getattr(value, "__dict__", {})
        added = {name: attributes[name] for name in attributes if name not in DERIVED}
        return *(getattr(value, name, None) for name in HELD), added
    if isinstance(value, jax.tree_util.PyTreeDef):
        return value.node_data(), value.children()
    if isinstance(value, ContextVar):
        return value.name, value.get(None)
    if isinstance(value, weakref.ref):
        return (value(),)
    if isinstance(value, JIT):
        return tuple(map(value.__getstate__().get, JITTED))
    if value is random.getrandbits.__self__:  # anybody's draw would change it
        return "random"
    if isinstance(value, LOCK):
        return ("a lock",)
    try:
        reduce = copyreg.dispatch_table.get(type(value))
        state: Any = reduce(value) if reduce else value.__reduce_ex__(2)
        if isinstance(state, tuple):  # an iterator over a list holds that list alone
            return *state[:3], *(items and [*items] for items in state[3:5])
    except Exception:  # a user's `__reduce_ex__` may raise
        compiled = callable(value) or hasattr(value, "__objclass__")
        named = compiled and not hasattr(value, "__dict__")
        state = getattr(value, "__qualname__", None) if named else None
    if isinstance(state, str):  # pickle finds nothing under a name such as <lambda>
        return state if all(map(str.isidentifier, state.split("."))) else None
    return state


def has_no_state(state: tuple) -> bool:
    """Return whether pickle makes the object again from its class alone."""
    return state[0] is NEW and len(state[1]) == 1 and all(one is None for one in state[2:])
