"""The options that choose the walker, or other system, of a command, and set its parameters."""

import dataclasses
import inspect
import math
from collections.abc import Callable, Container, Mapping, Sequence
from typing import Annotated, Any, get_args

import equinox as eqx
import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.groups import Command, argument, arguments_of, with_arguments
from walker_jax.cli.known_options import DEFAULT, PANEL, PREFIX, refuse_foreign, value_of
from walker_jax.cli.list_walkers import ListWalkers
from walker_jax.cli.rewording import option_of
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.system import System
from walker_jax.systems.trees import make_static
from walker_jax.walkers.family import OPENING, WALKERS
from walker_jax.walkers.parameters import (
    Option,
    Parameter,
    Tree,
    options,
    parameters_of,
    trees,
    with_values,
)
from walker_jax.walkers.references import find_system, find_walker, installed_walkers

OF_WALKERS = {"theta", "thetadot", "sum", "phidot", "at_phidot", "guess"}
"""Options of commands for coordinates that only walkers have."""
Kinds = Mapping[str, type[System] | System]
"""The walkers, or the one system, that a command offers, by their names."""
Offered = dict[str, dict[str, Any]]
"""For each name of an option, the `Parameter` or `Option` of each walker that has it."""


def takes_walker(
    *,
    systems: bool = False,
    ranges_over: str | None = None,
    or_one_value: bool = False,
    opening: bool = False,
) -> Callable:
    """Decorate a command whose first argument is a walker: `with_walker_options` replaces it.

    With `systems` the command takes any other system too. The argument `ranges_over` names a
    parameter that goes from --from to --to, so its own option is refused; with `or_one_value` that
    option is allowed if there is no range. With `opening`, walkers have the defaults of `OPENING`.
    """

    def decorate(command: Command) -> Command:
        vars(command).update(systems=systems, ranges_over=ranges_over, or_one_value=or_one_value)
        vars(command).update(opening=OPENING if opening else {})
        return command

    return decorate


def offered_kinds(command: Command, args: Sequence[str]) -> Kinds:
    """Return the package's walkers, or the one walker or system that the arguments name."""
    name = value_of("--walker", args)
    system = value_of("--system", args) if vars(command)["systems"] else None
    name = DEFAULT if name is None else name
    try:
        if system is not None:
            return {system: find_system(system)}
        return WALKERS if name in WALKERS else {name: find_walker(name)}
    except WrongUse as error:
        raise WrongUse(f"--{error}") from error


def with_walker_options(command: Command, args: Sequence[str] | None) -> Command:
    """Replace the walker of a command by options for the walkers that it offers.

    The help lists the options of the walker that `args` name. If `args` is None it lists those of
    all walkers.
    """
    kinds = offered_kinds(command, args or ())
    named = value_of("--system", args or ()) or value_of("--walker", args or ()) or DEFAULT
    offered = offered_options(kinds, vars(command)["opening"])
    told = named if args is not None else None
    ranges_over: str | None = vars(command)["ranges_over"]

    def takes(walker, list_walkers, system=None, **given):
        values = {one: given.pop(PREFIX + one) for one in offered}
        values = {one: value for one, value in values.items() if value is not None}
        if ranges_over is not None:
            over, low = given[ranges_over].replace("-", "_"), given["low"]
            ranged = over in offered and isinstance(first(offered[over]), Parameter)
            if ranged and (low is not None or not vars(command)["or_one_value"]):
                values |= lowest_value(first(offered[over]), low, values)
        name = system or walker
        return command(walker=build_walker(kinds[name], name, offered, values), **given)

    own = [argument("walker", WALKER, DEFAULT)]
    own += [argument("system", SYSTEM, None)] if vars(command)["systems"] else []
    own += [option_for(name, owners, len(kinds), told) for name, owners in offered.items()]
    own += [argument("list_walkers", ListWalkers, False)]
    own += [
        hidden(one) if told is not None and told not in WALKERS and one.name in OF_WALKERS else one
        for one in arguments_of(command)[1:]
    ]
    return with_arguments(own, command, takes)


def hidden(one: inspect.Parameter) -> inspect.Parameter:
    """Hide an option from the help."""
    _, flag = get_args(one.annotation)
    flag.hidden = True
    return one


def lowest_value(over: Parameter, low: float | None, given: Container[str]) -> dict[str, float]:
    """Return the lowest value of a varied parameter, if it is given; refuse its own option."""
    if over.name in given:
        raise WrongUse(f"{option_of(over.name)} is not for this command: give --from and --to")
    if low is None and math.isnan(over.default):
        raise WrongUse(f"--from is required: the range of {option_of(over.name)[2:]}")
    return {} if low is None else {over.name: low}


def offered_options(
    kinds: Kinds, opening: Mapping[str, Mapping[str, float]] | None = None
) -> Offered:
    """Return the parameters of all walkers, then arrays and trees, then options of their strides.

    `opening` has defaults of some walkers that replace their own.
    """
    offered: Offered = {}
    trees_of = lambda kind: trees(kind) if isinstance(kind, type) else ()
    checks_of = lambda kind: options(kind) if isinstance(kind, type) else ()
    for described in (parameters_of, trees_of, checks_of):
        for name, kind in kinds.items():
            for one in described(kind):
                default = (opening or {}).get(name, {}).get(one.name)
                other = one if default is None else one._replace(default=default)
                offered.setdefault(one.name, {})[name] = other
    return offered


def first(owners: Mapping[str, Any]) -> Any:
    """Return the parameter or option of the first walker that has it."""
    return next(iter(owners.values()))


def option_for(
    name: str, owners: Mapping[str, Any], count: int, told: str | None
) -> inspect.Parameter:
    """Make the option for a parameter of the `owners` among `count` walkers.

    The help is that of the walker `told`; if this is None, it covers all owners.
    """
    if told is None:
        panel = PANEL
    elif told in owners:
        owners, count, panel = {told: owners[told]}, 1, PANEL
    else:
        panel = PANEL | {"hidden": True}
    one = first(owners)
    whose = "" if len(owners) == count else f"{', '.join(owners)}: "
    if isinstance(one, Option):
        flag = typer.Option(option_of(name), help=f"{whose}{one.meaning}.", **panel)
        return argument(PREFIX + name, Annotated[bool | None, flag], None)
    if isinstance(one, Tree):
        text = f"{whose}File of its numbers, as eqx.tree_serialise_leaves writes them."
        file = typer.Option(option_of(name), help=text, metavar="FILE", **panel)
        return argument(PREFIX + name, Annotated[str | None, file], None)
    about = "; ".join(filter(None, (one.meaning, one.unit)))
    defaults = "required" if math.isnan(one.default) else f"default: {one.default:g}"
    for owner, other in owners.items():
        if other.default != one.default and not math.isnan(other.default):
            defaults += f", {owner}: {other.default:g}"
    text = f"{whose}{about} ({defaults})".strip()
    number = typer.Option(option_of(name), help=text, show_default=False, metavar="X", **panel)
    return argument(PREFIX + name, Annotated[float | None, number], None)


def names_that_begin(incomplete: str) -> list[str]:
    """Return the walkers whose names begin so, other packages' too, for completion in a shell."""
    return [name for name in (*WALKERS, *installed_walkers()) if name.startswith(incomplete)]


NAME: Any = PANEL | {"metavar": "NAME"}
WALKER = Annotated[
    str,
    typer.Option(
        help="The model, such as kneed, or FILE.py:CLASS.",
        autocompletion=names_that_begin,
        **NAME,
    ),
]
SYSTEM = Annotated[
    str | None,
    typer.Option(
        help="Any other system, such as henon, or FILE.py:NAME.",
        autocompletion=lambda incomplete: [one for one in SYSTEMS if one.startswith(incomplete)],
        **NAME,
    ),
]


def build_walker(
    kind: type[System] | System, name: str, offered: Offered, values: dict[str, Any]
) -> System:
    """Build the walker of that name, with defaults for the parameters that are not given."""
    own = {one: owners[name] for one, owners in offered.items() if name in owners}
    numbers = {one: each.default for one, each in own.items() if isinstance(each, Parameter)}
    flags = [one for one, whose in offered.items() if isinstance(first(whose), Option)]
    refuse_foreign(name, values, offered, flags)
    for one, value in numbers.items():
        if one not in values and math.isnan(value):
            raise WrongUse(f"{option_of(one)} is required: {name} has no default for it")
    read = {
        one: read_tree(each, values.get(one)) for one, each in own.items() if isinstance(each, Tree)
    }
    given = (numbers | values).items()
    made = {one: own[one].convert(value) for one, value in given if one not in read} | read
    return kind(**made) if isinstance(kind, type) else with_values(kind, made)


def read_tree(tree: Tree, file: str | None) -> Any:
    """Return the numbers of an array or a tree from a file, or its default."""
    option = option_of(tree.name)
    if tree.default is dataclasses.MISSING:
        raise WrongUse(
            f"{option} needs a default of {tree.name} in its class, to tell the shapes in a file"
        )
    like = make_static(tree.default, tree.name)
    if file is None:
        return like
    try:
        return eqx.tree_deserialise_leaves(file, like)
    except (Exception, SystemExit) as error:  # whatever NumPy makes of a file
        reason = " ".join(str(error).split())
        raise WrongUse(f"{option} {file} must be a file of such numbers: {reason}") from error
