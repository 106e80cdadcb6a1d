"""Options of commands: each is declared once, with its kind of value, its default and its help.

They stand in groups, the themes of the help. A command is given one object for each of its groups:

    class Search(Group):
        period: int = option(1, "Strides in a cycle.")

The annotation says how a value is read: a number of type `int` is at least 1, unless `least` says
otherwise.

What types refuse is worded by `complaint`, which puts the option before it. This module loads
without JAX, as do all modules of commands.
"""

import dataclasses
import operator
from collections.abc import Callable, Container, Iterable, Mapping
from math import inf, isfinite
from pathlib import Path
from types import UnionType
from typing import Any, ClassVar, dataclass_transform, get_args

import click

from walker_jax.cli import library as lib
from walker_jax.refusals import Refusal, WrongUse

LONGEST = 60
"""Most characters of a value that are shown."""
BOUNDS = "least", "most", "above"
HOLDS = {"at least": operator.ge, "at most": operator.le, "above": operator.gt}


def option_of(argument: str) -> str:
    """Return the option that sets an argument of this name."""
    return f"--{hyphenated(argument)}"


def hyphenated(name: str) -> str:
    """Return a name of the library as users type it."""
    return name.replace("_", "-")


def underscored(name: str) -> str:
    """Return a typed name as it is in the library."""
    return name.replace("-", "_")


def shown(value: str) -> str:
    """Return the beginning of a value, on one line; quotes stand for an empty value."""
    return " ".join(value.split())[:LONGEST] or "''"


def name_of(param: Any) -> str:
    """Return an option as it is typed, or an argument as the help names it."""
    return param.opts[0] if isinstance(param, click.Option) else param.metavar


class Number(click.ParamType):
    """A finite number, between bounds."""

    name, noun, read = "X", "a number", float

    def __init__(self, least: float | None = None, most: float | None = None, above: Any = None):
        bounds = {"at least": least, "at most": most, "above": above}
        self.bounds = {word: bound for word, bound in bounds.items() if bound is not None}

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        try:
            number = self.read(value)
        except ValueError:
            self.fail(f"must be {self.noun}, not {shown(value)}", param, ctx)
        if not all(HOLDS[word](number, bound) for word, bound in self.bounds.items()):
            bounds = " and ".join(f"{word} {bound}" for word, bound in self.bounds.items())
            self.fail(f"must be {bounds}, not {shown(str(value))}", param, ctx)
        if not -inf < number < inf:  # isfinite overflows for an integer of many digits
            self.fail(f"must be finite, not {number}", param, ctx)
        return number


class Whole(Number):
    """A whole number, between bounds."""

    name, noun, read = "N", "a whole number", int

    def __init__(self, least: float | None = 1, most: float | None = None):
        super().__init__(least, most)


RANGE = "LO:HI:N"
"""Ends of a range, and its number of values."""
Axis = tuple[float, float, int]
"""Ends of an axis, and its number of cells."""


class Choice(click.Choice):
    """One of some words."""

    def __init__(self, *choices: str):
        super().__init__(choices)
        self.name = "|".join(choices)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value not in self.choices:
            self.fail(f"must be one of {', '.join(self.choices)}, not {shown(value)}", param, ctx)
        return value


def unit(value: str) -> str | float:
    """Return the name of a unit, or its size."""
    try:
        return float(value)
    except ValueError:
        return value


class Named(click.ParamType):
    """The name of a parameter or coordinate, and numbers in one of some forms, or a text."""

    kinds: ClassVar = {"LO": float, "HI": float, "VALUE": float, "N": int}
    kinds |= {"COLUMN": str, "UNIT": unit}

    def __init__(self, *forms: str):
        self.forms = {form.count(":") + 1: form.split(":") for form in forms}
        self.worded = forms[0] in ("COLUMN", "UNIT")
        self.name = " or ".join(f"NAME={form}" for form in forms)

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, Any]:
        name, _, text = value.partition("=")
        parts = [text] if self.worded else text.split(":")  # a word may have colons of its own
        form = self.forms.get(len(parts), ()) if text else ()
        try:
            pairs = zip(form, parts, strict=True)
            numbers: Any = tuple(self.kinds[word](number) for word, number in pairs)
        except ValueError:
            self.fail(f"must be {self.name}, not {value}", param, ctx)
        match numbers:
            case (number,):
                if isinstance(number, float) and not isfinite(number):
                    self.fail(f"must be finite, not {number}", param, ctx)
                return underscored(name), number
            case (low, high, count) if not (low < high and isfinite(high - low) and count >= 2):
                must = "must have LO below HI, both finite, and N of 2 or more"
                self.fail(f"{value} {must}", param, ctx)
        return underscored(name), numbers


def collect(ctx: Any, param: Any, pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return the numbers that an option is given for each name; refuse a name given twice."""
    found: dict[str, Any] = {}
    for name, numbers in pairs:
        if name in found:
            raise click.BadParameter(f"is given twice for {hyphenated(name)}", ctx, param)
        found[name] = numbers
    return found


def option(default: Any, help: str, *flags: str, **settings: Any) -> Any:
    """Make an option of a group, with settings of `Option` and bounds of `Number`.

    The annotation of its field says how a value is read; without `flags`, the field names it.
    """
    return dataclasses.field(default=default, metadata={"flags": flags, "help": help, **settings})


def named(help: str, *forms: str, **settings: Any) -> Any:
    """Make an option that may be given for several names; its value is a dictionary of them."""
    return option((), help, type=Named(*forms), multiple=True, callback=collect, **settings)


def argument(metavar: str, help: str) -> Any:
    """Make a required place, given without an option's name."""
    return dataclasses.field(metadata={"metavar": metavar, "help": help})


class Option(click.Option):
    """An option of a theme of the help, which may exclude others, by their fields."""

    def __init__(self, names: Iterable[str], *, theme: str, excludes: Any = (), **settings: Any):
        flag = isinstance(settings["default"], bool)
        settings.setdefault("is_flag", flag)
        if not flag:
            settings.setdefault("metavar", getattr(settings.get("type"), "name", "NAME"))
        super().__init__([*names], **settings)
        self.theme, self.excludes = theme, excludes

    def handle_parse_result(self, ctx: click.Context, opts: Any, args: list[str]) -> Any:
        for other in self.excludes:
            if {self.name, other} <= opts.keys() and not ctx.resilient_parsing:
                both = f"{name_of(self)} and {option_of(other)}"
                raise WrongUse(f"{both} exclude each other: give one of them")
        return super().handle_parse_result(ctx, opts, args)


@dataclass_transform(frozen_default=True)
class Group:
    """Options of one theme; subclasses are frozen dataclasses, and each field is an option.

    The theme is the name of the first class, unless another is given.
    """

    theme: ClassVar[str] = ""

    def __init_subclass__(cls, theme: str = ""):
        cls.theme = theme or cls.theme or cls.__name__
        dataclasses.dataclass(frozen=True)(cls)


class Ranged(Group):
    """Options by which a parameter goes over a range, from --from to --to."""

    over: str
    low: float | None
    high: float | None

    @property
    def ranged(self) -> tuple[()] | tuple[str, float | None]:
        """The parameter and its lowest value, if it has a range."""
        return underscored(self.over), self.low

    def check(self, walker: Any, low: float, high: float) -> None:
        """Refuse values that the parameter cannot have, and a range that does not rise."""
        lib.check_parameter(walker, underscored(self.over), low, high)
        if not low < high:
            raise WrongUse(f"--from {low:g} must be below --to {high:g}")


READ: dict[Any, tuple[Callable[..., click.ParamType], str]] = {
    int: (Whole, "N"),
    float: (Number, "X"),
    tuple[float, float]: (lambda: click.Tuple([Number(), Number()]), "X Y"),
    Axis: (lambda: click.Tuple([Number(), Number(), Whole(least=None)]), "LO HI N"),
    Path: (lambda: click.Path(path_type=Path, readable=False), "FILE"),
}
"""How values are read, and their placeholder, by the annotations of fields; others are texts."""


def options_of(group: Any, defaults: Mapping[str, Any]) -> list[click.Parameter]:
    """Return the options of a group, with these defaults in place of its own."""
    found: list[click.Parameter] = []
    for field in dataclasses.fields(group):
        settings = {"theme": group.theme, **field.metadata}
        if "flags" not in settings:
            read, _ = READ[Path]
            one = click.Argument([field.name], type=read(), metavar=settings["metavar"])
            vars(one).update(theme=group.theme, help=settings["help"])
            found.append(one)
            continue
        flags = settings.pop("flags") or [option_of(field.name)]
        settings["default"] = defaults.get(field.name, field.default)
        kind, *_ = get_args(field.type) if isinstance(field.type, UnionType) else (field.type,)
        if kind in READ and "type" not in settings:
            bounds = {name: settings.pop(name) for name in BOUNDS if name in settings}
            read, placeholder = READ[kind]
            settings = {"metavar": placeholder, **settings, "type": read(**bounds)}
        found.append(Option([field.name, *flags], **settings))
    return found


def only_given(**options: Any) -> dict[str, Any]:
    """Return those of these options that are given."""
    return {name: value for name, value in options.items() if value is not None}


def refuse(reason: str, **options: Any) -> None:
    """Refuse the first of these options that is given, for this reason."""
    for name in only_given(**options):
        raise WrongUse(f"{option_of(name)} {reason}")


SET_BY = {
    "parameter": "--over",
    "bounds": "--bound",
    "grid": "--axis",
    "region": "--radius",
    "cells": "the N of --over",
    "phidot": "--at-phidot",
    "columns": "--column",
    "units": "--unit",
    **dict.fromkeys(("file", "source", "recordings"), "FILE"),
}
"""What sets an argument of the library, where the option has another name."""


def message_of(error: Refusal, known: Container[str]) -> str:
    """Return a message of the library with options in the places of the arguments at fault.

    An argument that none of the `known` options sets keeps its name.
    """
    *before, last = map(str, error.args)
    words = last.split(" ")
    for argument in error.arguments:
        option = SET_BY.get(argument) or option_of(argument)
        places = [i for i, word in enumerate(words) if word.rstrip(",:;") == argument]
        for i in places[-1:] if option.split()[-1] in known else ():
            words[i] = words[i].replace(argument, option)
    return ": ".join([*before, " ".join(words)])
