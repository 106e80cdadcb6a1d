"""Fingerprints of user code, by which stores know it again in other processes.

Code is the same while all that it reaches is the same, by the rule of `identity`: functions,
classes and values, as they are in this process, in whatever file they stand.
"""

import functools
import secrets
from collections.abc import Hashable
from typing import Any

from walker_jax.identity import Describer, sha256_of
from walker_jax.origins import home_of, is_known_module, top_of

token_of_process = functools.cache(secrets.token_hex)
"""Identifies this process, for objects that cannot be described in another one."""


def code_fingerprint(kind: type, parts: tuple = ()) -> str:
    """Hash the code of a system's class, and other parts, such as the function of a map.

    The hash is empty for a class of the package without other parts. It does not cover data in
    files that are read when the code runs.
    """
    own = [one for one in kind.__mro__ if not is_known_module(home_of(one))]
    if not own and not parts:
        return ""
    return sha256_of(StoreDescriber(own).describe(*own, *parts))[:16]  # alike once in 2^64


class StoreDescriber(Describer):
    """Describes code for other processes.

    Installed code in the package of one of the `bases` counts as the user's own does.
    """

    here = False

    def __init__(self, bases: list[type] | tuple = ()):
        super().__init__()
        self.packages = {top_of(home_of(one)) for one in bases}

    def looks_into(self, definition: Any) -> bool:
        return super().looks_into(definition) or top_of(home_of(definition)) in self.packages

    def name_definition(self, definition: Any) -> Hashable:
        name = getattr(definition, "__qualname__", None)
        return name, getattr(home_of(definition), "__name__", None)

    def identify(self, value: Any) -> Hashable:
        return token_of_process(), id(value)
