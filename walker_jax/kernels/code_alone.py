"""Functions that are nothing but their code, so that equal code has an equal trace."""

import types
from collections.abc import Callable

import jax

code_of_program = jax.make_user_context(None)
"""While a program is traced, what the code of a user's own in it is (`outside_code.states_of`)."""


class CodeAlone:
    """A function that is equal to every other one of the same code, as it has nothing else."""

    def __init__(self, function: Callable):
        self.function = function

    @staticmethod
    def is_all_of(function: Callable) -> bool:
        """Whether a function is its code and the globals that this reads."""
        plain = isinstance(function, types.FunctionType)
        if not plain or function.__closure__:
            return False
        return not (function.__defaults__ or function.__kwdefaults__)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CodeAlone):
            return False
        mine, others = self.function, other.function
        return mine.__code__ == others.__code__ and mine.__globals__ is others.__globals__

    def __hash__(self) -> int:
        return hash(self.function.__code__)
