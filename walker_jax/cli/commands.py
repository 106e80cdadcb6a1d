"""Commands: how they are declared, how their options are read, and what is refused."""

import difflib
import inspect
import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import click
from click.core import augment_usage_errors

from walker_jax.cli import library as lib
from walker_jax.cli.answers import jsonable
from walker_jax.cli.options import (
    Option,
    is_group,
    message_of,
    name_of,
    options_of,
    shown,
    underscored,
)
from walker_jax.cli.walker_options import choose
from walker_jax.refusals import Refusal, WrongUse

COLUMN = 20
"""Width of the column of options in help; their meanings stand beside it."""
JSON = Option(
    "as_json", flags=["--json"], theme="Output", default=False, help="Print the answer as JSON."
)
QUIET = Option(
    "quiet",
    theme="Output",
    default=False,
    callback=lambda ctx, param, requested: requested and lib.be_quiet(),
    expose_value=False,
    help="Print the answer, or the error, alone.",
)
SETTINGS = {"help_option_names": ["-h", "--help"]}


class Command(click.Command):
    """A command: a function of the walker, or other system, if it takes one, and of its options.

    The parameters of `run` are its options. It yields its answer, for JSON, then the lines that say
    it in words; one that returns None has neither. With `opening`, walkers have the values with
    which the explorer opens them. A `ranged` command goes over a parameter, which is then none of
    the walker's; so does any other command for which a lowest value is given. `examples` and
    `time`, the seconds that it takes, are for its help. `defaults` replace those of its options.
    """

    allow_extra_args = True  # they are refused here

    def __init__(
        self,
        run: Callable[..., Any],
        *,
        examples: Sequence[str],
        time: str,
        opening: bool = False,
        ranged: bool = False,
        **defaults: Any,
    ):
        self.run, self.examples, self.opening, self.ranged = run, examples, opening, ranged
        self.given = inspect.get_annotations(run)
        answers = self.given.pop("return", Any) is not None
        system = self.given.pop("walker", None)
        self.walkers, self.systems = system is not None, system == "wj.System"
        own = options_of(run, defaults)
        purpose, _, more = inspect.cleandoc(run.__doc__ or "").partition("\n\n")
        super().__init__(
            run.__name__,
            SETTINGS,
            params=[*own, *[JSON] * answers, QUIET],
            help=purpose,
            short_help=" ".join(purpose.split()),
            epilog=f"{more}\n\nTime on two cores: {time}",
        )

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return all options; those of parameters are of the walker that is named."""
        own = super().get_params(ctx)
        if not self.walkers:
            return own
        chosen = ctx.obj or choose([], systems=False)
        return [*chosen.options(systems=self.systems), *own]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        with augment_usage_errors(ctx):
            if self.walkers:
                try:
                    ctx.obj = choose(args, systems=self.systems, opening=self.opening)
                except WrongUse:
                    if not ctx.resilient_parsing:  # as for completion in a shell
                        raise
                flags = flags_of(self.get_params(ctx))
                for flag in flags:
                    if flags.count(flag) > 1:
                        name = underscored(flag.removeprefix("--"))
                        must = f"rename the parameter {name}"
                        raise WrongUse(f"{flag} is an option of the command: {must}")
            super().parse_args(ctx, args)
            if ctx.args and not ctx.resilient_parsing:  # such as an option without its dashes
                raise click.NoSuchOption(ctx.args[0])
        return ctx.args

    def invoke(self, ctx: click.Context) -> None:
        lib.configure_jax()
        params = ctx.params
        given: dict[str, Any] = {
            name: kind(**{one: params[one] for one in inspect.get_annotations(kind)})
            if is_group(kind)
            else params[name]
            for name, kind in self.given.items()
        }
        try:
            if self.walkers:
                low = params.get("low")
                over = params["parameter"] if self.ranged or low is not None else ""
                given["walker"] = ctx.obj.build(params, underscored(over), low)
            said = self.run(**given) or iter(())
            answer = next(said, None)
            if ctx.params.get("as_json"):
                print(json.dumps(jsonable(answer), allow_nan=False))
                return
            for line in said:
                print(line)
        except Refusal as error:
            error.args = (message_of(error, self.get_params(ctx), ctx.meta),)
            raise

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_help_text(ctx, formatter)
        with formatter.section("Examples"):
            formatter.write("".join(f"  walker-jax {line}\n" for line in self.examples))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options theme by theme; other systems leave out those of walkers alone."""
        themes: dict[str, list[tuple[str, str]]] = {}
        for one in self.get_params(ctx):
            foreign = getattr(one, "into", "") and ctx.obj and ctx.obj.system
            record = one.get_help_record(ctx)
            if isinstance(one, click.Option) and record and not foreign:
                themes.setdefault(getattr(one, "theme", "Output"), []).append(record)
        for theme, records in themes.items():
            with formatter.section(theme):
                formatter.write_dl(records, COLUMN)


def command(**about: Any) -> Callable[[Callable[..., Any]], Command]:
    """Declare a command, with settings of `Command`."""
    return lambda run: Command(run, **about)


def complaint(error: click.UsageError) -> str:
    """Write one line for an error of click: what is wrong, and what to do instead."""
    ctx: Any = error.ctx
    params = ctx.command.get_params(ctx)
    match error:
        case click.NoSuchOption(option_name=flag):
            foreign = ctx.obj.foreign(flag) if ctx.obj else ""
            bare = {one.strip("-"): one for one in flags_of(params)}  # as dashes are all alike
            similar = difflib.get_close_matches(flag.strip("-"), bare)
            instead = meant(bare[one] for one in similar) or help_of(ctx)
            return foreign or f"{shown(flag)} is not an option: {instead}"
        case click.BadOptionUsage(option_name=flag):
            (param,) = (one for one in params if flag in flags_of([one]))
            if getattr(param, "is_flag", False):
                return f"{flag} must be given without a value"
            values = "a value" if param.nargs == 1 else f"{param.nargs} values"
            return f"{flag} must have {values}: {help_of(ctx)}"
        case click.MissingParameter(param=param):
            return f"{name_of(param)} is required: {help_of(ctx)}"
        case click.BadParameter(param=param):
            return f"{name_of(param)} {error.message}"
    return f"{shown(error.format_message())}: {help_of(ctx)}"


def flags_of(params: Iterable[click.Parameter]) -> list[str]:
    """Return all names of some options, as they are typed."""
    return [flag for one in params for flag in (*one.opts, *one.secondary_opts)]


def meant(similar: Iterable[str]) -> str:
    """Ask whether one of these names is meant; return an empty text if there are none."""
    names = " or ".join(similar)
    return f"did you mean {names}?" if names else ""


def help_of(ctx: click.Context) -> str:
    """Write where the help of a command is."""
    command = f" {ctx.command.name}" if ctx.parent is not None else ""
    return f"see walker-jax{command} --help"
