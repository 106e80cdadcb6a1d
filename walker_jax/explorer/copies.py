"""What one takes away from the page: the command, and the Python, that give the same result."""

import hashlib
import shlex
from pathlib import Path

from walker_jax.explorer.lattice import Rectangle
from walker_jax.explorer.measures import grid_of
from walker_jax.explorer.subjects import FAMILY, Subject
from walker_jax.walkers.model import Walker
from walker_jax.walkers.references import reference_of


def describe(subject: Subject, cells: Rectangle, method: str) -> dict[str, str]:
    """Both of these."""
    return {
        "command": command(subject, cells, method),
        "python": program(subject, cells, method),
    }


def command(subject: Subject, cells: Rectangle, method: str) -> str:
    """`walker-jax basin` with the options that give the picture's data."""
    words = ["walker-jax basin", f"--walker {shlex.quote(reference_of(subject.kind))}"]
    words += [f"--{option(name)} {value!r}" for name, value in subject.parameters.items()]
    for name, ends in axes_of(subject, cells).items():
        if isinstance(ends, tuple):
            words.append(f"--{option(name)} {' '.join(map(repr, ends))}")
        else:
            words.append(f"--at-{option(name)} {ends!r}")
    words.append(f"--method {method}")
    name = hashlib.sha256(" ".join(words).encode()).hexdigest()[:6]
    return " ".join([*words, f"--out basin-{name}.zarr"])  # no two pictures at one place


def program(subject: Subject, cells: Rectangle, method: str) -> str:
    """The same in Python."""
    setting = ["", 'jax.config.update("jax_enable_x64", True)']
    begin = ["import jax", "import walker_jax as wj", *setting]
    kind = f"wj.{subject.kind.__name__}"
    given = [f"{name}={value!r}" for name, value in subject.parameters.items()]
    if subject.offer not in FAMILY.values():
        begin, kind = begin_with_own(subject.kind, setting), subject.kind.__name__
        given = [f"{name}=jnp.array({value!r})" for name, value in subject.parameters.items()]
    axes = ", ".join(f"{name}={ends!r}" for name, ends in axes_of(subject, cells).items())
    lines = [
        *begin,
        f"walker = {kind}({', '.join(given)})",
        f"grid = wj.Grid.{subject.section}({axes})",
        f'basin = wj.basin(walker, grid, "{method}")',
    ]
    return "\n".join([*lines, ""])


def begin_with_own(kind: type[Walker], setting: list[str]) -> list[str]:
    """The beginning of a program that uses a class of a user's own, loaded after the setting."""
    place, _, name = reference_of(kind).rpartition(":")
    imports = ["import jax", "import jax.numpy as jnp", "import walker_jax as wj", *setting]
    if not place.endswith(".py"):
        return [*imports, f"from {place} import {name}"]
    file = Path(place)
    search = f"sys.path.append({str(file.parent)!r})"
    return ["import sys", "", *imports, search, f"from {file.stem} import {name}"]


def axes_of(subject: Subject, cells: Rectangle) -> dict[str, tuple[float, float, int] | float]:
    """The ends and the number of cells of each axis; the value of each that is fixed."""
    box = grid_of(subject, cells).box
    return {
        name: (ends[0], ends[1], int(ends[2])) if isinstance(ends, list) else ends
        for name, ends in box.items()
    }


def option(name: str) -> str:
    """A name as users type it."""
    return name.replace("_", "-")
