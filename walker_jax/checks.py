"""Arguments that many functions take, checked: one line that names the argument and the value."""

import operator
from typing import Any

import numpy as np
from jaxtyping import Float

MOST = 2**31 - 1
"""Strides, starts and cells are counted in 32 bits."""


def check_whole(name: str, value: Any, least: int = 1, most: int = MOST) -> int:
    """A whole number, as Python has it; what is none, or out of range, is refused."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be a whole number, not {short(value)}") from None
    if number < least:
        raise ValueError(f"{name} must be at least {least}, not {short(value)}")
    if number > most:
        raise ValueError(f"{name} must be at most {most}, not {short(value)}")
    return number


def check_kind(name: str, value: Any, kind: type) -> None:
    """Refuse a value of another kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, not {short(value)}")


def check_number(name: str, value: Any) -> None:
    """Refuse what is no real number; it may be NaN or infinite."""
    try:
        float(value)
        single = np.shape(value) == () and not isinstance(value, str | bytes)
    except (TypeError, ValueError, OverflowError):
        single = False
    if not single:
        raise TypeError(f"{name} must be a real number, not {short(value)}")


def is_number(value: Any) -> bool:
    """Whether a value is one number, and no truth value."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool)


def numbers(name: str, values: Any) -> Float[np.ndarray, "..."]:
    """An array of numbers; what is none is refused."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{name} must be real numbers, not {short(values)}") from None


def short(value: Any) -> str:
    """A value on one line, the beginning of a long one."""
    return " ".join(repr(value).split())[:60]
