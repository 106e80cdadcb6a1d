"""The option `--list-walkers`."""

import math
from typing import Annotated

import typer

from walker_jax.cli.rewording import option_of
from walker_jax.refusals import WrongUse


def list_walkers(requested: bool) -> bool:
    """Print all walkers and systems with their parameters, also of other packages, and exit."""
    if not requested:
        return False
    from walker_jax.systems.family import SYSTEMS  # loads JAX, as do the next imports
    from walker_jax.walkers.family import WALKERS
    from walker_jax.walkers.references import installed_walkers, load_installed

    for name, kind in WALKERS.items():
        print_walker(name, kind)
    for name, point in installed_walkers().items():
        package = point.dist.name if point.dist else point.module
        try:
            print_walker(f"{name} (of {package})", load_installed(point))
        except WrongUse as error:
            print(f"{name} (of {package}): {error}")
    for name, kind in SYSTEMS.items():
        print_walker(f"--system {name}", kind)
    raise typer.Exit


def print_walker(name: str, kind: type) -> None:
    """Print a walker, its section and its parameters."""
    from walker_jax.walkers.parameters import options, parameters, trees

    lines = (kind.__doc__ or kind.__name__).strip().splitlines()
    print(f"{name}: {lines[0]}")
    print(f"  section ({', '.join(kind.section)})")
    for one in parameters(kind):
        about = ", ".join(filter(None, (one.meaning, one.bounds())))
        default = "required" if math.isnan(one.default) else f"{one.default:g}"
        print(f"  {option_of(one.name):18} {one.unit:17} {default:<8} {about}")
    for one in trees(kind):
        print(f"  {option_of(one.name):18} FILE")
    for one in options(kind):
        print(f"  {option_of(one.name):44} {one.meaning}")


ListWalkers = Annotated[
    bool,
    typer.Option(
        "--list-walkers",
        is_eager=True,
        callback=list_walkers,
        help="List all walkers and systems, with their parameters; "
        "--walker NAME --help has those of one.",
        rich_help_panel="Walker",
    ),
]
