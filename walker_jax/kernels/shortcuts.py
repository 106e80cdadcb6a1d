"""Operations on a known zero or one that need no computation."""

from typing import no_type_check

NUMBERS = bool, int, float, complex
"""Types of known numbers."""


@no_type_check
def is_known(entry) -> bool:
    """Return whether an entry is a known number."""
    return isinstance(entry, NUMBERS)


@no_type_check
def simplify_sum(a, b):
    if is_known(a) and a == 0:
        return b
    return a if is_known(b) and b == 0 else None


@no_type_check
def simplify_difference(a, b):
    return a if is_known(b) and b == 0 else None


@no_type_check
def simplify_product(a, b):
    if is_known(a) and a in (0, 1):
        return b if a == 1 else a
    if is_known(b) and b in (0, 1):
        return a if b == 1 else b
    return None


@no_type_check
def simplify_quotient(a, b):
    return a if is_known(b) and b == 1 else None


@no_type_check
def simplify_selection(which, *cases):
    return cases[int(which)] if is_known(which) else None


SHORTCUTS = {
    "add": simplify_sum,
    "add_any": simplify_sum,
    "sub": simplify_difference,
    "mul": simplify_product,
    "div": simplify_quotient,
    "select_n": simplify_selection,
}
"""By primitive: the operand that equals the result, or None."""
