"""Options of commands: each is declared once, with its kind of value, its default and its help.

They are parameters of the command's function:

    def gait(walker: "wj.System", period: int = option(1, "Strides in a cycle.")):

The annotation says how a value is read: a number of type `int` is at least 1, unless `least` says
otherwise. A parameter whose annotation is a `Group` stands for the options that this declares.

What types refuse is worded by `complaint`, which puts the option before it. This module loads
without JAX, as do all modules of commands.
"""

import inspect
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from types import SimpleNamespace, UnionType
from typing import Any, ClassVar, TypeGuard, get_args

import click

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
    """Return the numbers that an option is given for each name; refuse a name given twice.

    The context keeps what is typed for a name, for messages about it.
    """
    found: dict[str, Any] = {}
    for name, numbers in pairs:
        if name in found:
            raise click.BadParameter(f"is given twice for {hyphenated(name)}", ctx, param)
        found[name] = numbers
        ctx.meta[name] = f"{name_of(param)} {hyphenated(name)}"
    return found


def put_into(ctx: Any, param: Any, value: Any) -> None:
    """Put the value of an option for some names into the dictionary of all names."""
    if value is None:
        ctx.meta.update(dict.fromkeys(param.keys, name_of(param)) | ctx.meta)
        return
    several = value if len(param.keys) > 1 else [value]
    for name, one in zip(param.keys, several, strict=True):
        if name in ctx.params[param.into]:
            both = f"and {ctx.meta[name]} exclude each other: give one of them"
            raise click.BadParameter(both, ctx, param)
        ctx.params[param.into][name] = one
        ctx.meta[name] = name_of(param)


def option(default: Any, help: str, *flags: str, **settings: Any) -> Any:
    """Declare an option, with settings of `Option` and bounds of `Number`.

    Users type the name of the parameter whose default it is, or the `flags` if there are any.
    """
    return {"default": default, "help": help, "flags": flags, **settings}


def named(help: str, *forms: str, **settings: Any) -> Any:
    """Declare an option that may be given for several names; its value is a dictionary of them.

    Options of its `own`, each with its kind of value, are for some names.
    """
    # It is read before its own ones, which add to its dictionary.
    settings |= {"multiple": True, "callback": collect, "is_eager": True}
    return option((), help, type=Named(*forms), **settings)


def argument(metavar: str) -> Any:
    """Declare a required place, without an option's name; the help explains it in words."""
    return {"metavar": metavar}


class Option(click.Option):
    """An option of a theme of the help, for a value of a kind.

    It may exclude others, or need one, by their names. It `sets` arguments of the library besides
    the one of its name; messages about these have the words given here. Its value may go `into`
    the dictionary of another option, under its name, or under `keys`.
    """

    def __init__(
        self,
        name: str,
        kind: Any = str,
        *,
        theme: str = "Walker",
        flags: Sequence[str] = (),
        excludes: Sequence[str] = (),
        needs: str = "",
        sets: Mapping[str, str] | None = None,
        into: str = "",
        keys: Sequence[str] = (),
        **settings: Any,
    ):
        kind, *_ = get_args(kind) if isinstance(kind, UnionType) else (kind,)
        if kind in READ and "type" not in settings:
            bounds = {name: settings.pop(name) for name in BOUNDS if name in settings}
            read, placeholder = READ[kind]
            settings = {"metavar": placeholder, **settings, "type": read(**bounds)}
        settings.setdefault("is_flag", isinstance(settings.get("default"), bool))
        if not settings["is_flag"]:
            settings.setdefault("metavar", getattr(settings.get("type"), "name", "NAME"))
        if into:
            settings |= {"callback": put_into, "expose_value": False}
        super().__init__([name, *(flags or [option_of(name)])], show_default=True, **settings)
        self.theme, self.into = theme, into
        self.sets = {} if into else {name: name_of(self), **(sets or {})}
        self.excludes, self.needs, self.keys = excludes, needs, keys or [name]

    def handle_parse_result(self, ctx: click.Context, opts: Any, args: list[str]) -> Any:
        if self.name in opts and not ctx.resilient_parsing:
            params = {one.name: one for one in ctx.command.params}
            given = {
                getattr(one, "into", "") or one.name: one
                for one in params.values()
                if one.name in opts
            }
            for other in given.keys() & self.excludes:
                both = f"{name_of(self)} and {name_of(given[other])}"
                raise WrongUse(f"{both} exclude each other: give one of them")
            if self.needs and self.needs not in opts:
                other = name_of(params[self.needs])
                raise WrongUse(f"{name_of(self)} goes with {other}: give it too")
        return super().handle_parse_result(ctx, opts, args)


class Group(SimpleNamespace):
    """Options that several commands share, which it declares, and what is done with their values.

    Their theme is its `theme`.
    """


READ: dict[Any, tuple[Callable[..., click.ParamType], str]] = {
    int: (Whole, "N"),
    float: (Number, "X"),
    tuple[float, float]: (lambda: click.Tuple([Number(), Number()]), "X Y"),
    Axis: (lambda: click.Tuple([Number(), Number(), Whole(least=None)]), "LO HI N"),
    Path: (lambda: click.Path(path_type=Path, readable=False), "FILE"),
}
"""How values are read, and their placeholder, by annotations; others are texts."""


def is_group(kind: Any) -> TypeGuard[type[Group]]:
    """Return whether an annotation is a group of options."""
    return isinstance(kind, type) and issubclass(kind, Group)


def options_of(owner: Any, defaults: Mapping[str, Any]) -> Iterator[click.Parameter]:
    """Yield the options that a function or a group declares; their own defaults give way to these.

    An option that a function declares has the theme Options, unless it has another.
    """
    declared, theme = vars(owner), getattr(owner, "theme", "Options")
    if not is_group(owner):
        declared = {name: one.default for name, one in inspect.signature(owner).parameters.items()}
    annotated = inspect.get_annotations(owner)
    for name in sorted(annotated, key=lambda name: is_group(annotated[name])):  # groups last
        if is_group(kind := annotated[name]):
            yield from options_of(kind, defaults)
            continue
        if not isinstance(declared.get(name), dict):
            continue
        settings = {"theme": theme, **declared[name]}
        own = settings.pop("own", {})
        if "help" in settings:
            default = defaults.get(name, settings["default"])
            yield Option(name, kind, **settings | {"default": default})
        else:
            yield click.Argument([name], type=READ[kind][0](), metavar=settings["metavar"])
        for key, (of, one) in own.items():
            yield Option(key, of, theme=settings["theme"], into=name, **one)


def only_given(**options: Any) -> dict[str, Any]:
    """Return those of these options that are given."""
    return {name: value for name, value in options.items() if value is not None}


def refuse(reason: str, **options: Any) -> None:
    """Refuse the first of these options that is given, for this reason."""
    for name in only_given(**options):
        raise WrongUse(f"{option_of(name)} {reason}")


def message_of(
    error: Refusal, params: Sequence[click.Parameter], typed: Mapping[str, str] | None = None
) -> str:
    """Return a message of the library with options in the places of the arguments at fault.

    An argument that none of these options sets, and for which nothing is typed, keeps its name.
    """
    set_by = dict(typed or {})
    for one in reversed(params):  # a parameter of the walker before all that the command sets
        set_by |= getattr(one, "sets", {one.name: name_of(one)})
    *before, last = map(str, error.args)
    words = last.split(" ")
    for argument in error.arguments:
        places = [i for i, word in enumerate(words) if word.rstrip(",:;") == argument]
        for i in places[-1:] if argument in set_by else ():
            words[i] = words[i].replace(argument, set_by[argument])
    return ": ".join([*before, " ".join(words)])
