"""The options that choose the walker, or other system, of a command, and set its parameters.

The parameters of the package's walkers are known without JAX; a user's own walker, or another
system, is loaded for its parameters.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from functools import partial
from typing import Any, NamedTuple

import click

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.information import LIST_WALKERS
from walker_jax.cli.options import Option, option_of, underscored
from walker_jax.refusals import WrongUse
from walker_jax.systems.parameter import Option as Check
from walker_jax.systems.parameter import Parameter
from walker_jax.walkers.parameter_table import DESCRIBED, OPENING

DEFAULT = "simplest"
"""Default walker of all commands."""
PREFIX = "walker_"
"""Prefix of a parameter among the values of options: a command may have an option of its name."""


def walkers_that_begin(ctx: Any, param: Any, incomplete: str) -> list[str]:
    """Return the walkers whose names begin so, other packages' too, for completion in a shell."""
    return [name for name in (*DESCRIBED, *lib.installed_walkers()) if name.startswith(incomplete)]


WALKER = Option(
    "walker",
    default=None,
    help=f"The model, such as kneed, FILE.py:CLASS or ROBOT.xml (default: {DEFAULT}).",
    shell_complete=walkers_that_begin,
)
SYSTEM = Option(
    "system",
    default=None,
    help="Any other system, such as henon, or FILE.py:NAME.",
    shell_complete=lambda ctx, param, begun: [one for one in lib.SYSTEMS if one.startswith(begun)],
)
LENIENT = {"ignore_unknown_options": True, "allow_extra_args": True}
NAMES = click.Command(None, LENIENT, params=[WALKER, SYSTEM], add_help_option=False)
"""Reads the name of a walker or system from a command line, whatever else is on it."""


def check_bounds(parameter: Parameter, ctx: Any, param: Any, value: float | None) -> float | None:
    """Refuse a number outside the bounds of a parameter."""
    if value is not None and not parameter.holds(value):
        raise click.BadParameter(f"must be {parameter.bounds()}, not {value}", ctx, param)
    return value


class Chosen(NamedTuple):
    """The walker or other system that a command line names."""

    name: str
    described: Sequence[Any]
    """Each `Parameter`, `Tree` and `Check` that it has."""
    kind: Any = None
    """Its class, or the system itself; None for a walker of the package."""
    system: bool = False
    """Whether it is any other system than a walker."""

    def options(self, *, systems: bool) -> list[click.Parameter]:
        """Return the options that name and set it, for a command that takes `systems` or not."""
        names = [WALKER, SYSTEM] if systems else [WALKER]
        return [*names, *map(option_for, self.described), LIST_WALKERS]

    def foreign(self, flag: str) -> str:
        """Explain an option that only other walkers have; return an empty text for any other."""
        name = underscored(flag.removeprefix("--"))
        if name in {one.name for one in self.described}:
            return ""  # its own, misspelt
        kinds = {
            walker: type(one)
            for walker, described in DESCRIBED.items()
            for one in described
            if one.name == name
        }
        if Check in kinds.values():
            return f"{flag} is not an option of {self.name}, but of {', '.join(kinds)}"
        own = [option_of(one.name) for one in self.described if not isinstance(one, Check)]
        reason = f"{flag} is not a parameter of {self.name}, which has {', '.join(own) or 'none'}"
        return reason if kinds else ""

    def build(self, given: Mapping[str, Any], over: str = "", low: float | None = None) -> Any:
        """Build the walker, with defaults for the parameters that are not given.

        A parameter `over` which a command goes has its lowest value, and must not be given as well.
        """
        from jax import device_put

        made: dict[str, Any] = {}
        for one in self.described:
            value, option = given.get(PREFIX + one.name), option_of(one.name)
            if isinstance(one, Check):
                made |= {one.name: one.convert(value)} if value else {}
                continue
            if not isinstance(one, Parameter):
                made[one.name] = read_tree(one, value)
                continue
            if one.name == over:
                if value is not None:
                    raise WrongUse(f"{option} is not for this command: give --from and --to")
                if low is None and math.isnan(one.default):
                    raise WrongUse(f"--from is required: the range of {option[2:]}")
                value = low
            if value is None and math.isnan(one.default):
                raise WrongUse(f"{option} is required: {self.name} has no default for it")
            # `asarray` of a float would be the first program of the process that XLA compiles.
            made[one.name] = one.convert(device_put(one.default if value is None else value))
        kind = lib.WALKERS[self.name] if self.kind is None else self.kind
        return kind(**made) if isinstance(kind, type) else lib.with_values(kind, made)


def option_for(one: Any) -> Option:
    """Make the option of a parameter, of an array or tree of them, or of a check of strides."""
    flag = option_of(one.name)
    about: dict[str, Any] = {"flags": [flag], "sets": {one.name: flag}, "default": None}
    if isinstance(one, Check):
        return Option(PREFIX + one.name, is_flag=True, help=f"{one.meaning}.", **about)
    if not isinstance(one, Parameter):
        text = "File of its numbers, as eqx.tree_serialise_leaves writes them."
        return Option(PREFIX + one.name, metavar="FILE", help=text, **about)
    text = "; ".join(filter(None, (one.meaning, one.unit)))
    default = "required" if math.isnan(one.default) else f"default: {one.default:g}"
    check = partial(check_bounds, one)
    text = f"{text} ({default})".strip()
    return Option(PREFIX + one.name, float, callback=check, help=text, **about)


def choose(args: Sequence[str], *, systems: bool, opening: bool = False) -> Chosen:
    """Return the walker that command-line arguments name, or with `systems` any other system.

    With `opening`, walkers have the defaults of `OPENING`.
    """
    named = NAMES.make_context(None, [*args], resilient_parsing=True).params
    name, system = named["walker"], named["system"] if systems else None
    if name is not None and system is not None:
        raise WrongUse("--walker and --system exclude each other: give one of them")
    name = DEFAULT if name is None else name
    if system is not None or name not in DESCRIBED:
        return load(name, system)
    own = OPENING.get(name, {}) if opening else {}
    described = (
        one._replace(default=own[one.name]) if one.name in own else one for one in DESCRIBED[name]
    )
    return Chosen(name, [*described])


def load(name: str, system: str | None) -> Chosen:
    """Load the system of this name, or else the walker."""
    lib.configure_jax()
    robot = system is None and lib.is_robot_file(name)
    try:
        if robot:
            kind = wj.robot(name)
        else:
            kind = lib.find_walker(name) if system is None else lib.find_system(system)
    except WrongUse as error:
        file = f"walker {name}: " if robot else ""
        raise WrongUse(f"--{file}{error}") from error
    more = (*lib.trees(kind), *lib.options(kind)) if isinstance(kind, type) else ()
    described = [*lib.parameters_of(kind), *more]
    return Chosen(system or name, described, kind, system=robot or system is not None)


def read_tree(tree: "lib.Tree", file: str | None) -> Any:
    """Return the numbers of an array or a tree from a file, or its default."""
    option = option_of(tree.name)
    if tree.default is MISSING:
        raise WrongUse(
            f"{option} needs a default of {tree.name} in its class, to tell the shapes in a file"
        )
    like = lib.make_static(tree.default, tree.name)
    if file is None:
        return like
    try:
        return lib.tree_deserialise_leaves(file, like)
    except (Exception, SystemExit) as error:  # whatever NumPy makes of a file
        reason = " ".join(str(error).split())
        raise WrongUse(f"{option} {file} must be a file of such numbers: {reason}") from error


def check_range(walker: "wj.System", parameter: str, low: float, high: float) -> None:
    """Refuse values that a parameter cannot have, and a range that does not rise."""
    lib.check_parameter(walker, parameter, low, high)
    if not low < high:
        raise WrongUse(f"--from {low:g} must be below --to {high:g}")
