"""Where the package raises errors: the statements, and those that an error came through."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import walker_jax

PACKAGE = Path(walker_jax.__file__).parent
SIGNALS = {
    *("Busy", "Failure", "Interrupted", "Terminated", "TooLong", "Unknown", "UnsupportedPrimitive"),
    *("KeyboardInterrupt", "CancelledError", "ClientDisconnect", "ImportError"),
    "self.failure",
}
"""Exceptions that the package catches itself, or that end it: nobody is told their text."""
WITHOUT_TEXT = {"NotImplementedError", "TypeError", "ValueError"}
"""Python's own, which the package catches itself where it raises them without a message."""


class Site(NamedTuple):
    """A statement that raises an error with a message."""

    place: str
    """The file in the package, and the function."""
    message: str
    """The message, with {} for each value that is filled in."""


def text_of(node: ast.expr) -> str:
    """A message as it is written, or the expression that makes it."""
    match node:
        case ast.Constant():
            return str(node.value)
        case ast.JoinedStr():
            return "".join(map(text_of, node.values))
        case ast.FormattedValue():
            return "{}"
        case ast.Call(args=[ast.Constant() | ast.JoinedStr() as first, *_]):
            return text_of(first)
    return ast.unparse(node)


def raised(node: ast.AST, place: str, scope: str = "") -> Iterator[tuple[ast.Raise, Site]]:
    """The statements within a node that raise an error which users may be told."""
    for child in ast.iter_child_nodes(node):
        inner = scope
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = f"{scope}.{child.name}".removeprefix(".")
        if isinstance(child, ast.Raise) and child.exc is not None:
            name = child.exc.func if isinstance(child.exc, ast.Call) else child.exc
            if ast.unparse(name) not in SIGNALS and ast.unparse(child.exc) not in WITHOUT_TEXT:
                yield child, Site(f"{place} {scope}", text_of(child.exc))
        yield from raised(child, place, inner)


@cache
def sites_of(file: Path) -> dict[range, Site]:
    """The statements of a file, by their lines."""
    tree = ast.parse(file.read_text())
    place = file.relative_to(PACKAGE).as_posix()
    return {
        range(statement.lineno, (statement.end_lineno or 0) + 1): site
        for statement, site in raised(tree, place)
    }


def all_sites() -> set[Site]:
    """Each statement of the package that raises an error with a message."""
    return {site for file in PACKAGE.rglob("*.py") for site in sites_of(file).values()}


def sites_behind(error: BaseException | None) -> set[Site]:
    """The statements that raised an error, and those behind it which it replaced."""
    found = set()
    while error is not None:
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        if trace is not None:
            file = Path(trace.tb_frame.f_code.co_filename)
            if file.is_relative_to(PACKAGE):
                line = trace.tb_lineno
                found |= {site for lines, site in sites_of(file).items() if line in lines}
        error = error.__cause__ or error.__context__
    return found
