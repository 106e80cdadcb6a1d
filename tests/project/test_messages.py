"""The table of messages: a wrong use, and the whole line that it brings.

`data/messages.txt` holds them, calls after >>> and command lines after $. Each message names the
argument, and says what it must be or what to do instead, in one line of less than 200 characters.
The calls run without the checks of signatures of the tests, as users make them.

Every statement of the package that raises an error with a message is reached by a row, or by a test
that `data/messages_elsewhere.txt` names, as it needs more than a row has: an earlier version, a
full disk, another process, a long computation.
"""

import inspect
import operator
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import click
import pytest
from raise_sites import Site, all_sites, sites_behind
from reference import DATA
from unchecked import unchecked
from wrong_uses import MODULES, names, prepare

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli import app, main
from walker_jax.cli.walker_options import choose


def rows_of(file: str) -> list[list[str]]:
    """The rows of a file, each of two lines."""
    text = (DATA / file).read_text()
    return [row.strip().split("\n") for row in text.split("\n\n")]


TABLE = dict(rows_of("messages.txt"))
"""Wrong uses, and the message that each brings."""
ELSEWHERE = {Site(*site.split(": ", 1)): test for test, site in rows_of("messages_elsewhere.txt")}
"""Statements that raise errors, and the test that brings each."""
CALL, LINE = ">>> ", "$ walker-jax"


def error_of(use: str, known: dict[str, Any]) -> BaseException:
    """The exception that a wrong use raises."""
    with pytest.raises(Exception) as error:
        if use.startswith(CALL):
            eval(use.removeprefix(CALL), dict(known))
        else:
            app.app.main(shlex.split(use.removeprefix(LINE)), standalone_mode=False)
    return error.value


def message_of(use: str, error: BaseException) -> str:
    """The message of a wrong use, and whether it is a failed computation or wrong usage."""
    assert isinstance(error, Exception)
    code, reason = main.verdict(error)
    assert code == (1 if isinstance(error, ComputationFailed) else 2), (use, reason)
    reason = str(error) if use.startswith(CALL) else main.on_one_line(reason)
    return reason.replace(os.getcwd(), "HERE")


def files() -> set[str]:
    """The files in this folder, without those that Python makes."""
    return {str(path) for path in Path().rglob("*") if "__pycache__" not in path.parts}


def options_in(text: str) -> set[str]:
    """The options that a text names."""
    return {*re.findall(r"(?<![\w-])--[a-z][\w-]*", text)}


def known_options(use: str) -> set[str]:
    """The options of a command line's command and of its walker, and those that are typed."""
    name, *arguments = [*shlex.split(use.removeprefix(LINE)), ""]
    if name not in app.NAMES:
        return {"--help", *options_in(use)}
    command = app.load(name)
    context = click.Context(command, **command.context_settings)
    with suppress(WrongUse):  # those of the default walker, if there is none of that name
        context.obj = choose(arguments, systems=command.systems)
    flags = {
        flag for one in command.get_params(context) for flag in (*one.opts, *one.secondary_opts)
    }
    return {"--help", "--list-walkers", *flags, *options_in(use)}


class Told(NamedTuple):
    """The message of a wrong use."""

    message: str
    sites: set[Site]
    """The statements that raise it."""
    failed: bool
    """Whether the computation failed, though the use was right."""
    invented: set[str]
    """The options it names that the command does not have."""


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> Iterator[dict[str, Told]]:
    """The message of each wrong use, in a folder of its own."""
    known, answers = names(), {}
    with unchecked(), pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("told"))
        prepare(patch)
        before = files()
        for use in TABLE:
            error = error_of(use, known)
            failed = isinstance(error, ComputationFailed)
            message = message_of(use, error)
            invented = options_in(message) - known_options(use) if use.startswith(LINE) else set()
            answers[use] = Told(message, sites_behind(error), failed, invented)
        assert files() == before, "a wrong use writes nothing"
    yield answers


PUBLIC = {name: getattr(wj, name) for name in dir(wj)}
HOMES = SimpleNamespace(
    **{one.__name__.rpartition(".")[2]: one for one in MODULES} | PUBLIC, GRID=wj.Grid
)
"""Where the names that calls of the table begin with are found."""


NAMES = names()


def words_in(metavar: str | None) -> list[str]:
    """The words of an option's placeholder; an argument is named by its own."""
    return re.findall(r"\w+", metavar or "")


def names_in(use: str) -> set[str]:
    """The names that a message about a wrong use may give: those typed, and of its arguments."""
    typed = {*re.findall(r"[\w-]+", use)}
    known = typed | {"walker", "parameter", "slope", *REQUESTED}
    if use.startswith(LINE):
        command = use.removeprefix(LINE).split()[0]
        if command not in app.NAMES:
            return known
        loaded = app.load(command)
        options = loaded.get_params(click.Context(loaded, **loaded.context_settings))
        return known | {name for one in options for name in (*one.opts, *words_in(one.metavar))}
    for name in re.findall(rf"\b(?:wj\.|(?=(?:{'|'.join(vars(HOMES))})\b))([\w.]+)\(", use):
        known |= {*inspect.signature(operator.attrgetter(name)(HOMES)).parameters}
    for one in (NAMES[name] for name in typed & NAMES.keys()):
        known |= {*getattr(one, "__dataclass_fields__", ()), *getattr(one, "_fields", ())}
    return known


REQUESTED = {"request", "tile", "tiles", "cells", "level", "at", "rectangles", "start"}
"""Fields that requests of the page have."""


@pytest.mark.parametrize("use", TABLE)
def test_wrong_use_is_told_what_to_do_in_one_line(told, use):
    """One short line, which names the argument, and no option that there is not."""
    message, _, failed, invented = told[use]
    assert message == TABLE[use] and not invented
    whole = message.removesuffix("...")  # the mark of a value that was cut
    assert len(f"walker-jax: {message}") < 200 and not whole.endswith((".", " "))
    words = re.findall(r"[\w-]+", message.partition(", not ")[0])
    assert failed or names_in(use) & {*words}


def test_every_error_of_the_package_has_a_row_or_a_test(told):
    """One that is raised anew needs a row in `data/messages.txt`."""
    reached = {site for one in told.values() for site in one.sites}
    assert all_sites() - reached - ELSEWHERE.keys() == set()
    assert ELSEWHERE.keys() - all_sites() == set(), "is raised no more"
    assert ELSEWHERE.keys() & reached == set(), "has a row"
