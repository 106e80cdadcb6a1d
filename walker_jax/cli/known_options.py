"""The options of the package's own commands and walkers as data, which load without JAX.

`options.json` answers requests for help, misspelt options and values of a wrong kind at once. JAX
and the module of a command are loaded only after its arguments have been checked.
`tests/cli/test_known_options.py` writes the file and compares it with the commands.
"""

import functools
import inspect
import json
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from walker_jax.cli.groups import argument, with_arguments
from walker_jax.cli.help_pages import command_of
from walker_jax.cli.rewording import option_of
from walker_jax.refusals import WrongUse

PLACE = "options.json"
"""Name of the file, in the folder of this module."""
PARAMETERS = "parameters"
"""Placeholder in a list of options for the options of walkers."""
DEFAULT = "simplest"
"""Default walker of all commands."""
PREFIX = "walker_"
"""Prefix of arguments for a walker's parameters, as a command's arguments may have their names."""
PANEL: Any = {"rich_help_panel": "Walker"}
"""Theme of the help that holds a walker's options."""
KINDS: dict[str, Any] = {
    "flag": bool,
    "flag or none": bool | None,
    "number": float,
    "number or none": float | None,
    "whole": int,
    "whole or none": int | None,
    "text": str,
    "text or none": str | None,
    "texts": list[str] | None,
    "place": Path,
    "place or none": Path | None,
    "range": tuple[float, float, int] | None,
    "point": tuple[float, float] | None,
    "named number": tuple[str, float] | None,
}
"""Types of options, by their names in the file; a list in the file holds choices of a `Literal`."""
ONE_OF: Any = Literal
EXCLUSIVE = (
    *(("workers", "scheduler"), ("zoom", "levels")),
    *(("sum", "thetadot"), ("phidot", "at_phidot")),
    *(("guess", "start"), ("guess", "all"), ("start", "all")),
    *(("axis", one) for one in ("theta", "sum", "thetadot", "phidot", "at_phidot")),
    *(("start", one) for one in ("theta", "thetadot", "phidot")),
    *(("radius", one) for one in ("theta", "sum", "at_phidot", "axis")),
)
"""Pairs of options that exclude each other in every command that has both."""
SETTINGS = "help", "metavar", "rich_help_panel", "show_default", "min", "max", "is_eager", "hidden"
"""Further settings of an option in the file. Callbacks act when the command itself is loaded."""


def read(said: Mapping[str, Any]) -> inspect.Parameter:
    """Make an argument of a command from its entry in the file."""
    kind, default = said["kind"], said.get("default", inspect.Parameter.empty)
    settings = {name: said[name] for name in SETTINGS if name in said}
    flags = said.get("flags")
    info = typer.Argument(**settings) if flags is None else typer.Option(*flags, **settings)
    chosen = KINDS[kind] if isinstance(kind, str) else ONE_OF[tuple(kind)] | None
    if kind == "place" and isinstance(default, str):
        default = Path(default)
    return argument(said["name"], Annotated[chosen, info], default)


@functools.cache
def table() -> dict[str, Any]:
    """Read the file: the options of each command, and the meaning of each walker's options."""
    return json.loads(files("walker_jax.cli").joinpath(PLACE).read_text())


def check_known(name: str, args: Sequence[str], parent: Any) -> None:
    """Print the help of a command, or refuse its arguments, as far as the file knows them.

    The file has no walkers outside the package, and no systems that are not walkers.
    """
    walker, system = value_of("--walker", args), value_of("--system", args)
    if system is not None and any(said["name"] == "system" for said in own_options(name)):
        if walker is not None:
            raise WrongUse("--walker and --system exclude each other: give one of them")
        return
    walker = walker or DEFAULT
    if walker not in table()["walkers"]:
        return
    given = read_command(name, walker).make_context(name, [*args], parent=parent).params
    refuse_both(given)
    kinds, walkers = table()["parameters"], table()["walkers"]
    refuse_foreign(
        walker,
        [one for one in kinds if given.get(PREFIX + one) is not None],
        {one: [each for each in walkers if one in walkers[each]] for one in kinds},
        [one for one, kind in kinds.items() if kind == "flag or none"],
    )


def own_options(name: str) -> list[dict[str, Any]]:
    """Return a command's options in the file, without those of walkers."""
    return [said for said in table()["commands"][name]["options"] if said != PARAMETERS]


def refuse_both(given: Mapping[str, Any]) -> None:
    """Refuse two options that exclude each other."""
    chosen = [name for name, value in given.items() if value or (value == 0 and value is not False)]
    for one, other in EXCLUSIVE:
        if one in chosen and other in chosen:
            both = f"{option_of(one)} and {option_of(other)}"
            raise WrongUse(f"{both} exclude each other: give one of them")


def read_command(name: str, walker: str) -> TyperCommand:
    """Make a command that does nothing; its help lists the parameters of this walker."""
    own: list[inspect.Parameter] = []
    for said in table()["commands"][name]["options"]:
        own += parameters_of(walker) if said == PARAMETERS else [read(said)]
    takes = with_arguments(own, do_nothing, lambda **given: None)
    return command_of(name, table()["commands"][name]["help"], takes)


def do_nothing() -> None: ...


def parameters_of(walker: str) -> Iterator[inspect.Parameter]:
    """Yield options for the parameters of all walkers; the help lists those of this walker."""
    for name, kind in table()["parameters"].items():
        meaning = table()["walkers"][walker].get(name)
        said = {"name": PREFIX + name, "kind": kind, "default": None, "flags": [option_of(name)]}
        said |= PANEL | {"show_default": False, "help": meaning, "hidden": meaning is None}
        yield read(said | ({} if kind == "flag or none" else {"metavar": "X"}))


def value_of(option: str, args: Sequence[str]) -> str | None:
    """Return the last value that arguments give to an option, if any."""
    value = None
    for one, following in zip_longest(args, args[1:]):
        if one == option:
            value = following
        elif one.startswith(f"{option}="):
            value = one.partition("=")[2]
    return value


def refuse_foreign(
    walker: str,
    given: Iterable[str],
    owners: Mapping[str, Collection[str]],
    flags: Container[str],
) -> None:
    """Refuse parameters and options that belong only to other walkers."""
    has = [one for one, whose in owners.items() if walker in whose and one not in flags]
    for one in given:
        if walker in owners[one]:
            continue
        if one in flags:
            whose = ", ".join(owners[one])
            raise WrongUse(f"{option_of(one)} is not an option of {walker}, but of {whose}")
        own = ", ".join(map(option_of, has))
        raise WrongUse(f"{option_of(one)} is not a parameter of {walker}, which has {own}")
