"""Walkers and other systems by name: of the package, of other packages, of a user's own files.

A walker's name is one of `family.WALKERS`, a name that an installed package registers in the entry
points `walker_jax.walkers`, `FILE.py:CLASS` or `PACKAGE.MODULE:CLASS`. The last three run code: see
SECURITY.md. A system's name is one of `systems.family.SYSTEMS`, or of the last two kinds; it may
also denote a system that the file makes, such as a `Map`.
"""

import difflib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, TypeGuard

from walker_jax.checks import WrongPlace, WrongUse, short
from walker_jax.origins import file_of, holds_packages
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.system import System, check_single, code_of
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker

GROUP = "walker_jax.walkers"
"""The entry points by which other packages add walkers."""


FORMS = {
    "walker": ("a class", "FILE.py:CLASS"),
    "system": ("a system, or a class of systems", "FILE.py:NAME"),
}
"""For each noun, what a name denotes, and the form of the name of one in a file."""


def find_walker(name: str) -> type[Walker]:
    """Return the class of walkers of a name; raise `WrongUse` where there is none."""
    if name in WALKERS:
        return WALKERS[name]
    installed = {} if ":" in name else installed_walkers()
    if name in installed:
        return load_installed(installed[name])
    return check_walker(name, *load_named("walker", name, (*WALKERS, *installed)))


def find_system(name: str) -> type[System] | System:
    """Return the system, or class of systems, of a name; raise `WrongUse` where there is none."""
    if name in SYSTEMS:
        return SYSTEMS[name]
    value, others = load_named("system", name, (*SYSTEMS,))
    if isinstance(value, System):
        try:
            check_single(value)
        except WrongUse as error:
            raise WrongUse(f"system {name}: {error}") from error
        return value
    if not is_system(value):
        raise WrongUse(f"system {name} must be a system or a class of systems: {others}")
    check_complete("system", name, value)
    return value


def load_named(noun: str, name: str, known: Sequence[str]) -> tuple[Any, str]:
    """Return what a file or module has under a name, and the names that it could have had.

    Raises `WrongUse` for a name without a place, with names like it.
    """
    denoted, form = FORMS[noun]
    place, _, attribute = name.rpartition(":")
    if name.endswith(".py") and Path(name).is_file():
        choice = choose_from(made_in(load_file(Path(name), noun), noun), name)
        raise WrongUse(f"{noun} {name} must name {denoted}: {choice}")
    if not place:
        similar = " or ".join(difflib.get_close_matches(name, known))
        raise WrongUse(
            f"{noun} must be one that walker-jax --list-walkers shows, or {form}, not "
            f"{short(name)[1:-1]}{f': did you mean {similar}?' if similar else ''}"
        )
    module = load_file(Path(place), noun) if place.endswith(".py") else load_module(place, noun)
    return vars(module).get(attribute), choose_from(made_in(module, noun), place)


def reference_of(kind: type[System] | System) -> str:
    """Return the name by which another process finds a class, or a system that a file makes.

    `find_walker` takes the name of a walker, `find_system` that of any other system. Raises
    `WrongUse` for objects that have no name in a module with a file.
    """
    for name, one in (WALKERS | SYSTEMS).items():
        if one is kind:
            return name
    module, attribute = place_of(kind)
    path = file_of(module)
    assert path is not None
    name = module.__name__ if module.__spec__ is None else module.__spec__.name
    path = path.resolve()
    in_package = "." in name or path.name == "__init__.py" or holds_packages(path.parent)
    return f"{name if in_package else path}:{attribute}"


def place_of(kind: type[System] | System) -> tuple[ModuleType, str]:
    """Return the module, read from a file, that has a class or system, and its name there."""
    if isinstance(kind, type):
        module = sys.modules.get(kind.__module__)
        found = getattr(module, "__dict__", {}).get(kind.__qualname__) is kind
        if module is not None and found and file_of(module) is not None:
            return module, kind.__qualname__
        raise WrongUse(
            f"walker must be of a class that other processes can import: write {kind.__name__} "
            "into a file, not within a function",
            of="walker",
        )
    code = code_of(kind)
    first = sys.modules.get(getattr(code[0], "__module__", ""))  # the module of a map's function
    for module in (first, *list(sys.modules.values())):
        if module is not None and file_of(module) is not None:
            for name, value in list(vars(module).items()):
                if type(value) is type(kind) and code_of(value) == code:
                    return module, name
    raise WrongUse(
        f"walker must be made where other processes can import it: write {kind.label()}, under a "
        "name, into a file"
    )


def installed_walkers() -> dict[str, EntryPoint]:
    """Return the walkers of other packages, by name; names of this package take precedence."""
    return {one.name: one for one in entry_points(group=GROUP) if one.name not in WALKERS}


def load_installed(point: EntryPoint) -> type[Walker]:
    """Return the class that another package registers; raise `WrongUse` where it has none."""
    try:
        value = point.load()
    except (Exception, SystemExit) as error:  # whatever foreign code raises
        raise WrongUse(f"walker {point.name} ({point.value}) {cannot_be_loaded(error)}") from error
    return check_walker(f"{point.name} ({point.value})", value, choose_from((), point.module))


def load_file(path: Path, noun: str = "walker") -> ModuleType:
    """Run a Python file as a module of its name, which may import files beside it.

    Errors name the `noun` that is looked for.
    """
    if not path.is_file():
        raise WrongPlace(f"{noun} {path}: there is no such file")
    path, name = path.resolve(), path.stem
    if "." in name:
        raise WrongPlace(f"{noun} {path}: a module cannot be named {name}: rename the file")
    if is_taken(name, path):
        raise WrongPlace(f"{noun} {path}: another module is named {name}: rename the file")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    make_importable(path.parent)
    sys.modules[name] = module  # so that worker processes find the class
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever a user's code raises
        del sys.modules[name]
        raise WrongPlace(f"{noun} {path} {cannot_be_loaded(error, path)}") from error
    return module


def is_taken(name: str, path: Path) -> bool:
    """Return whether another module than this file has that name, loaded or not."""
    if name in sys.stdlib_module_names:
        return True
    try:
        spec = importlib.util.find_spec(name)
    except ValueError:  # it is loaded, and has no specification
        return True
    return spec is not None and bool(spec.origin) and Path(spec.origin).resolve() != path


def load_module(name: str, noun: str) -> ModuleType:
    """Return a module, of this folder or installed."""
    with suppress(FileNotFoundError):  # the folder may be gone
        make_importable(Path.cwd())
    try:
        return importlib.import_module(name)
    except (Exception, SystemExit) as error:  # whatever a user's code raises
        raise WrongUse(f"{noun} {name} {cannot_be_loaded(error)}") from error


def make_importable(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def cannot_be_loaded(error: BaseException, path: Path | None = None) -> str:
    """Say why code cannot be loaded, with the line of the file where it failed."""
    line, step = "", error.__traceback__
    while step is not None:
        if path is not None and step.tb_frame.f_code.co_filename == str(path):
            line = f" (line {step.tb_lineno})"
        step = step.tb_next
    return f"cannot be loaded: {type(error).__name__}: {error}{line}"


def made_in(module: ModuleType, noun: str) -> list[str]:
    """Return the names of the classes of walkers, or of systems and their classes, of a module."""
    if noun == "walker":
        made = lambda value: is_walker(value) and value.__module__ == module.__name__
    else:
        own = lambda value: is_system(value) and value.__module__ == module.__name__
        made = lambda value: isinstance(value, System) or own(value)
    return [name for name, value in vars(module).items() if made(value)]


def is_walker(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Walker)


def is_system(value: Any) -> TypeGuard[type[System]]:
    return isinstance(value, type) and issubclass(value, System)


def check_walker(name: str, value: Any, others: str) -> type[Walker]:
    """Return the class, if it is a complete one of walkers; raise `WrongUse` otherwise."""
    if not is_walker(value):
        raise WrongUse(f"walker {name} must name a class of walkers: {others}")
    check_complete("walker", name, value)
    return value


def check_complete(noun: str, name: str, kind: type[System]) -> None:
    """Raise `WrongUse` for a class that lacks methods, or names of coordinates."""
    missing = sorted(getattr(kind, "__abstractmethods__", ()))
    missing += [] if hasattr(kind, "section") else ["section"]
    if missing or inspect.isabstract(kind):
        raise WrongUse(f"{noun} {name} must define {', '.join(missing)} too")


def choose_from(names: Sequence[str], place: str) -> str:
    """Say how to name one of the walkers, or systems, of a place."""
    if not names:
        return f"{place} defines none"
    return "give " + " or ".join(f"{place}:{name}" for name in names)
