"""Checks of arguments that many functions take: one line names the argument and the value.

The errors themselves are in `refusals.py`, which loads without JAX.
"""

import functools
import inspect
import operator
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeGuard, TypeVar

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Float, Shaped

from walker_jax.refusals import ComputationFailed as ComputationFailed
from walker_jax.refusals import NotWritten as NotWritten
from walker_jax.refusals import Refusal as Refusal
from walker_jax.refusals import TooLarge as TooLarge
from walker_jax.refusals import WrongPlace as WrongPlace
from walker_jax.refusals import WrongUse as WrongUse

P = ParamSpec("P")
T = TypeVar("T")
MAX_COUNT = 2**31 - 1
"""Largest count of strides, starts or cells: counts have 32 bits."""


def check_whole(name: str, value: Any, least: int = 1, most: int = MAX_COUNT) -> int:
    """Return the value as an `int`; raise `WrongUse` unless it is a whole number in the range."""
    try:
        number = operator.index(value)
    except TypeError:
        raise WrongUse(f"{name} must be a whole number, not {short(value)}", of=name) from None
    if number < least:
        raise WrongUse(f"{name} must be at least {least}, not {short(value)}", of=name)
    if number > most:
        raise WrongUse(f"{name} must be at most {most}, not {short(value)}", of=name)
    return number


EXAMPLES: dict[str, str] = dict.fromkeys(
    ("System", "Walker"), ", such as wj.SimplestWalker(slope=0.009)"
)
"""Examples in messages about kinds for which users may give names, as on the command line."""


def check_kind(name: str, value: Any, kind: type) -> None:
    """Raise `WrongUse` for a value of another kind; NumPy's booleans count as `bool`."""
    if not isinstance(value, (bool, np.bool_) if kind is bool else kind):
        example = EXAMPLES.get(kind.__name__, "")
        raise WrongUse(f"{name} must be a {kind.__name__}{example}, not {short(value)}", of=name)


def check_memory(needed: int, subject: str, instead: str, of: str = "") -> None:
    """Raise `TooLarge` if a subject needs more bytes than there are, and say what to do instead.

    `of` names the argument that `instead` is about.
    """
    memory = memory_of_machine()
    if needed > memory:
        raise TooLarge(
            f"{subject} {needed / 2**30:.1f} GiB of memory, and this machine has "
            f"{memory / 2**30:.1f} GiB: {instead}",
            of=of,
        )


def memory_of_machine() -> float:
    """Return the bytes of memory; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError):  # not a POSIX system
        return float("inf")


def check_number(name: str, value: Any) -> None:
    """Raise `WrongUse` unless the value is a real number, NaN and infinity included."""
    try:
        float(value)
        single = np.shape(value) == () and not isinstance(value, str | bytes)
    except (TypeError, ValueError, OverflowError):
        single = False
    if not single:
        raise WrongUse(f"{name} must be a real number, not {short(value)}", of=name)


def check_confidence(value: Any) -> None:
    """Raise `WrongUse` unless the value can be the confidence of an interval."""
    check_number("confidence", value)
    if not 0 < value < 1:
        raise WrongUse(f"confidence must be between 0 and 1, not {value}", of="confidence")


def is_number(value: Any) -> TypeGuard[float]:
    """Return whether a value is one number, booleans excluded."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool)


def numbers(name: str, values: Any) -> Float[np.ndarray, "..."]:
    """Return the values as an array of float64; raise `WrongUse` unless they are real numbers."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(f"{name} must be real numbers, not {short(values)}", of=name) from None


def array(name: str, values: Any) -> Shaped[np.ndarray, "..."]:
    """Return the values as an array; raise `WrongUse` for rows of different lengths."""
    try:
        return np.asarray(values)
    except ValueError:
        raise WrongUse(f"{name} must be an array, not {short(values)}", of=name) from None


def is_traced(tree: Any) -> bool:
    """Return whether JAX traces any leaf."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def refuses_tracers(
    instead: str = "call it outside of them", *, called: str | None = None
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Make a function that JAX cannot trace refuse tracers, and say what to do `instead`.

    The message names the function that users have `called`. Arguments of the names of `COUNTS`, and
    `confidence`, are checked too.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        names = inspect.signature(function).parameters
        shown = called or function.__name__

        @functools.wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> T:
            for name, value in (dict(zip(names, args, strict=False)) | kwargs).items():
                if is_traced([*value.values()] if isinstance(value, Mapping) else value):
                    raise WrongUse(
                        f"{name} must not be traced: {shown} runs outside of jax.jit, "
                        f"jax.vmap and jax.grad; {instead}"
                    )
                if value is not None or name not in names or names[name].default is not None:
                    check_by_name(name, value)
            return function(*args, **kwargs)

        return checked

    return decorate


COUNTS = {"strides": 1, "samples": 1, "directions": 1, "seed": 0}
"""Arguments that are whole numbers in all functions that refuse tracers, and the least of each."""


def check_by_name(name: str, value: Any) -> None:
    """Check an argument whose name means the same in all functions."""
    if name in COUNTS:
        check_whole(name, value, COUNTS[name])
    elif name == "confidence":
        check_confidence(value)


def short(value: Any) -> str:
    """Return a value on one line, the beginning of one of more than 60 characters."""
    line = " ".join(repr(value).split())
    return line if len(line) <= 60 else f"{line[:57]}..."


class PrecisionWarning(UserWarning):
    """Numbers are in float32, where the answer needs more digits."""


FLOAT64_HINT = (
    'turn on float64, by jax.config.update("jax_enable_x64", True), before the system is made'
)


def check_precision(dtype: Any, needed_by: str | None = None) -> None:
    """Warn of float32 once in a process; raise `WrongUse` where `needed_by` is given."""
    if np.dtype(dtype) == np.float64:
        return
    if needed_by is not None:
        raise WrongUse(f"{needed_by} needs float64, not {np.dtype(dtype)}: {FLOAT64_HINT}")
    warn_once(
        "this rests on many strides, each in float32, which holds seven digits: starts near the "
        f"boundary of a basin may have another fate. For results, {FLOAT64_HINT}"
    )


class NoKernelWarning(UserWarning):
    """XLA computes a user's own system, as there is no machine code of this package for it."""


CALLERS = "walker_jax", "jax", "equinox", "jaxtyping", "contextlib", "functools"
"""Packages between the user's line and a warning."""


@functools.cache
def warn_once(text: str, category: type[Warning] = PrecisionWarning) -> None:
    """Give a warning at the user's line, once in a process."""
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in CALLERS:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, category, stacklevel=level)
