"""The globals that a function reads when it runs, also as attributes of modules, or imported."""

import contextlib
import dis
import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec, module_from_spec, resolve_name
from types import CodeType, FunctionType, ModuleType
from typing import Any

from walker_jax.origins import home_of, is_own

MOST = 4096
"""Size of each cache of what code reads."""
READING = "LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"


def globals_named(
    function: FunctionType, read: list[str], left_out: Any, changes: Callable[[Any], bool]
) -> dict[str, Any]:
    """Return the globals of these names, also as attributes of modules, without some types.

    A module that does not change, such as an installed one, is left out too.
    """
    found, inside = {}, names_used(function.__code__)
    spaces = [("", function.__globals__, read)]
    spaces += [(f"{one.__name__}.", vars(one), inside) for one in imported_by(function, changes)]
    for place, space, names in spaces:
        for name, value in ((one, space[one]) for one in names if one in space):
            if isinstance(value, ModuleType):
                if changes(value) and all(vars(value) is not one for _, one, _ in spaces):
                    spaces.append((f"{place}{name}.", vars(value), inside))
            elif not isinstance(value, left_out):
                found[f"{place}{name}"] = value
    return found


@functools.lru_cache(MOST)
def names_used(code: CodeType, *how: str) -> list[str]:
    """Return the names in a code object and those within it, by some instructions or by any."""
    names = set(code.co_names)
    if how:
        names = {one.argval for one in dis.get_instructions(code) if one.opname in how}
    inner = (one for one in code.co_consts if isinstance(one, CodeType))
    return sorted(names.union(*(names_used(one, *how) for one in inner)))


def imported_by(function: FunctionType, changes: Callable[[Any], bool]) -> Iterator[ModuleType]:
    """Yield the modules that a function imports when it runs, of those that change.

    None for a function of installed code, whose imports wait until they are needed.
    """
    if not is_own(home_of(function)):
        return
    for level, name, names in imports_in(function.__code__):
        for end in ("", *(f".{one}" for one in names)):  # a name may be that of a module
            with contextlib.suppress(Exception):  # as of an optional package
                package = function.__globals__.get("__package__")
                path = resolve_name("." * level + name, package) + end
                top = path.partition(".")[0]
                if changes(sys.modules[top]) if top in sys.modules else is_own_file(top):
                    yield import_module(path)


def is_own_file(name: str) -> bool:
    """Return whether a package or module that is not loaded is the user's own."""
    spec = find_spec(name)
    return spec is not None and is_own.__wrapped__(module_from_spec(spec))


@functools.lru_cache(MOST)
def imports_in(code: CodeType) -> list[tuple[int, str, Sequence[str]]]:
    """Return the imports of a code object: the dots before a name, the name, and those from it."""
    steps = [one for one in dis.get_instructions(code) if one.opname != "EXTENDED_ARG"]
    found: list[tuple[int, str, Sequence[str]]] = [
        (level.argval, step.argval, names.argval or ())
        for level, names, step in zip(steps, steps[1:], steps[2:], strict=False)
        if step.opname == "IMPORT_NAME"
    ]
    inner = (one for one in code.co_consts if isinstance(one, CodeType))
    return sum(map(imports_in, inner), found)
