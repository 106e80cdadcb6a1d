"""The command and the Python program that give the same result as the page."""

import hashlib
import shlex
from pathlib import Path
from typing import Any

from walker_jax.checks import is_number
from walker_jax.explorer.lattice import Rectangle, home_of
from walker_jax.explorer.offers import flag_of
from walker_jax.explorer.pictures import plane_of
from walker_jax.explorer.subjects import Subject
from walker_jax.robots.robot_files import path_of
from walker_jax.robots.robots import Robot
from walker_jax.systems.maps import Map
from walker_jax.systems.system import System
from walker_jax.walkers.references import place_of, reference_of


def describe(subject: Subject, cells: Rectangle, method: str) -> dict[str, str]:
    """Return the command and the program."""
    return {
        "command": command(subject, cells, method),
        "python": program(subject, cells, method),
    }


def command(subject: Subject, cells: Rectangle, method: str) -> str:
    """Write the command `walker-jax basin` with the options that give the picture's data."""
    flag, reference = flag_of(subject.offer.kind)
    words = ["walker-jax basin", f"--{flag} {shlex.quote(reference)}"]
    words += [f"--{option(name)} {value!r}" for name, value in subject.parameters.items()]
    for name, ends in axes_of(subject, cells).items():
        fixed = is_number(ends)
        if subject.offer.has_film:
            given = repr(ends) if fixed else " ".join(map(repr, ends))
            words.append(f"--{'at-' * fixed}{option(name)} {given}")
        else:
            words.append(f"--axis {name}={repr(ends) if fixed else ':'.join(map(repr, ends))}")
    words.append(f"--method {method}")
    name = hashlib.sha256(" ".join(words).encode()).hexdigest()[:6]
    return " ".join([*words, f"--out basin-{name}.zarr"])  # one place for each picture


def program(subject: Subject, cells: Rectangle, method: str) -> str:
    """Write the Python program that gives the same data."""
    noun = "walker" if subject.offer.is_walker else "system"
    lines = [
        *begin(subject, noun),
        f"grid = {grid_in_python(subject, axes_of(subject, cells))}",
        f'basin = wj.basin({noun}, grid, "{method}")',
    ]
    return "\n".join([*lines, ""])


def begin(subject: Subject, noun: str) -> list[str]:
    """Write the beginning of the program, which makes the walker or the system."""
    setting = ["", 'jax.config.update("jax_enable_x64", True)']
    kind, values = subject.offer.kind, subject.parameters.items()
    if isinstance(kind, Robot) and path_of(kind) is not None:
        made = f"{noun} = wj.robot({str(path_of(kind))!r}, parameters={subject.parameters!r})"
        return ["import jax", "import walker_jax as wj", *setting, made]
    if isinstance(kind, type) and ":" not in reference_of(kind):
        given = ", ".join(f"{name}={value!r}" for name, value in values)
        begin = ["import jax", "import walker_jax as wj", *setting]
        return [*begin, f"{noun} = wj.{kind.__name__}({given})"]
    begin = begin_with_own(kind, setting)
    if not isinstance(kind, type):
        given = ", ".join(f'"{name}": jnp.array({value!r})' for name, value in values)
        made = f"eqx.tree_at(lambda one: one.parameters, {place_of(kind)[1]}, {{{given}}})"
        return [*begin, f"{noun} = {made}"]
    given = ", ".join(f"{name}=jnp.array({value!r})" for name, value in values)
    return [*begin, f"{noun} = {kind.__name__}({given})"]


def begin_with_own(kind: type[System] | Map | Robot, setting: list[str]) -> list[str]:
    """Write the beginning of a program that imports a user's own code, after the setting."""
    place, _, name = reference_of(kind).rpartition(":")
    imports = ["import jax", "import jax.numpy as jnp", "import walker_jax as wj", *setting]
    if not isinstance(kind, type):
        imports = ["import equinox as eqx", *imports]
    if not place.endswith(".py"):
        return [*imports, f"from {place} import {name}"]
    file = Path(place)
    search = f"sys.path.append({str(file.parent)!r})"
    return ["import sys", "", *imports, search, f"from {file.stem} import {name}"]


def grid_in_python(subject: Subject, axes: dict[str, Any]) -> str:
    """Write the call that makes the grid of these axes, as `grid_along` does."""
    if "sum" in axes:
        return f"wj.Grid.sheared({in_call(axes)})"
    ranges = {name: ends for name, ends in axes.items() if not is_number(ends)}
    if [*axes][: len(ranges)] == [*ranges]:
        return f"wj.Grid.plain({in_call(axes)})"
    point = {name: 0.0 if name in ranges else at for name, at in axes.items()}
    return f"wj.Grid.through({point!r}, {in_call(ranges)})"


def in_call(axes: dict[str, Any]) -> str:
    """Write axes as arguments of a function."""
    return ", ".join(f"{name}={ends!r}" for name, ends in axes.items())


def axes_of(subject: Subject, cells: Rectangle) -> dict[str, Any]:
    """Return the ends and number of cells of each axis, or the value of a fixed coordinate."""
    return home_of(subject.offer, subject.section).axes(subject, cells, plane_of(subject))


def option(name: str) -> str:
    """Return a name as users type it."""
    return name.replace("_", "-")
