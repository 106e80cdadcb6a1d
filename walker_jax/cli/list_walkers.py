"""The option `--list-walkers`."""

from typing import Annotated

import typer

from walker_jax.cli.rewording import option_of


def list_walkers(requested: bool) -> bool:
    """Print all walkers with their parameters, and end."""
    if not requested:
        return False
    from walker_jax.walkers.family import WALKERS  # which loads JAX
    from walker_jax.walkers.parameters import options, parameters

    for name, kind in WALKERS.items():
        print(f"{name}: {(kind.__doc__ or '').splitlines()[0]}")
        print(f"  section ({', '.join(kind.section)})")
        for one in parameters(kind):
            meaning = f"{one.meaning}, {one.bounds()}"
            print(f"  {option_of(one.name):18} {one.unit:17} {one.default:<8g} {meaning}")
        for one in options(kind):
            print(f"  {option_of(one.name):44} {one.meaning}")
    raise typer.Exit


ListWalkers = Annotated[
    bool,
    typer.Option(
        "--list-walkers",
        is_eager=True,
        callback=list_walkers,
        help="List the walkers, their parameters, units and defaults.",
    ),
]
