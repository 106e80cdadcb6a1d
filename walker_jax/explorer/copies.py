"""What one takes away from the page: the command, and the Python, that give the same result."""

import hashlib

from walker_jax.explorer.lattice import Rectangle
from walker_jax.explorer.measures import grid_of
from walker_jax.explorer.subjects import Subject


def describe(subject: Subject, cells: Rectangle, method: str) -> dict[str, str]:
    """Both of these."""
    return {
        "command": command(subject, cells, method),
        "python": program(subject, cells, method),
    }


def command(subject: Subject, cells: Rectangle, method: str) -> str:
    """`walker-jax basin` with the options that give the picture's data."""
    words = ["walker-jax basin", f"--walker {subject.name}"]
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
    given = ", ".join(f"{name}={value!r}" for name, value in subject.parameters.items())
    axes = ", ".join(f"{name}={ends!r}" for name, ends in axes_of(subject, cells).items())
    return (
        "import jax\n"
        "import walker_jax as wj\n"
        "\n"
        'jax.config.update("jax_enable_x64", True)\n'
        f"walker = wj.{subject.kind.__name__}({given})\n"
        f"grid = wj.Grid.{subject.section}({axes})\n"
        f'basin = wj.basin(walker, grid, "{method}")\n'
    )


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
