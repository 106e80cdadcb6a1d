"""The options that are known without JAX, against those of the commands.

Run as a program it writes the file anew.
"""

import functools
import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
import typer

import walker_jax
from walker_jax.cli import app, known_options
from walker_jax.cli.groups import arguments_of, ungrouped
from walker_jax.cli.walker_options import offered_options, option_for, with_walker_options
from walker_jax.refusals import WrongUse
from walker_jax.walkers.family import WALKERS

PLACE = Path(walker_jax.__file__).parent / "cli" / known_options.PLACE


def recorded() -> dict[str, Any]:
    """What the file must hold."""
    offered = offered_options(WALKERS)
    kinds = {
        name: get_args(option_for(name, owners, 1, None).annotation)[0]
        for name, owners in offered.items()
    }
    return {
        "commands": {name: recorded_command(name) for name in app.COMMANDS},
        "parameters": {name: name_of_kind(kind) for name, kind in kinds.items()},
        "walkers": {
            walker: {
                name: get_args(option_for(name, owners, len(WALKERS), walker).annotation)[1].help
                for name, owners in offered.items()
                if walker in owners
            }
            for walker in WALKERS
        },
    }


@functools.cache
def function_of(name: str) -> Callable[..., None]:
    function = ungrouped(getattr(import_module(f"walker_jax.cli.{name}_command"), name))
    if "ranges_over" in vars(function):
        function = with_walker_options(function, ())
    return app.with_quiet(function)


def recorded_command(name: str) -> dict[str, Any]:
    own: list[Any] = []
    for one in arguments_of(function_of(name)):
        if not one.name.startswith(known_options.PREFIX):
            own.append(record(one))
        elif known_options.PARAMETERS not in own:
            own.append(known_options.PARAMETERS)
    text = app.flowing(inspect.cleandoc(function_of(name).__doc__ or ""))
    return {"help": text, "options": own}


def record(own: inspect.Parameter) -> dict[str, Any]:
    """An argument of a command as the file has it."""
    kind, info = get_args(own.annotation)
    usual = vars(typer.Option() if isinstance(info, typer.models.OptionInfo) else typer.Argument())
    said = {name: vars(info).get(name) for name in known_options.SETTINGS}
    said = {name: value for name, value in said.items() if value != usual.get(name)}
    if own.default is not inspect.Parameter.empty:
        said["default"] = str(own.default) if isinstance(own.default, Path) else own.default
    if isinstance(info, typer.models.OptionInfo):
        said["flags"] = [flag for flag in (info.default, *(info.param_decls or ())) if flag != ...]
    return {"name": own.name, "kind": name_of_kind(kind)} | said


def name_of_kind(kind: Any) -> str | list[str]:
    """The name of a type; the choices of a `Literal`, or of one that may be `None`."""
    inner = next(iter(get_args(kind)), None)
    if get_origin(inner) is Literal:
        return [*get_args(inner)]
    return next(name for name, known in known_options.KINDS.items() if known == kind)


def in_lines(found: Any, depth: int = 0) -> str:
    """The file, with a line for each option."""
    if depth == 4 or not isinstance(found, dict | list) or not found:
        return json.dumps(found)
    inner = " " * (depth + 1)
    if isinstance(found, list):
        return "[\n" + ",\n".join(inner + in_lines(one, 4) for one in found) + f"\n{inner[1:]}]"
    rows = (f"{inner}{json.dumps(name)}: {in_lines(one, depth + 1)}" for name, one in found.items())
    return "{\n" + ",\n".join(rows) + f"\n{inner[1:]}}}"


def test_the_file_has_the_options_of_all_commands():
    written = f"{in_lines(recorded())}\n"
    assert PLACE.read_text() == written, "run python tests/cli/test_known_options.py"


@pytest.mark.parametrize("walker", WALKERS)
def test_help_is_the_same_with_the_command_loaded(walker):
    for name in app.COMMANDS if walker in ("simplest", "kneed") else ("basin", "sweep"):
        args = () if name in ("export", "reproduce") else ("--walker", walker)
        known, loaded = known_options.read_command(name, walker), app.load(name, args)
        assert known.get_help(typer.Context(known)) == loaded.get_help(typer.Context(loaded))


@pytest.mark.parametrize(
    "line, code",
    [
        ("--help", 0),
        ("basin --help", 0),
        ("gait --walker kneed -h", 0),
        ("basin --slpe 3", 2),
        ("basin --method guess", 2),
        ("walk --theta x", 2),
        ("walk --foot-radius 0.3", 2),
        ("optimise --strides", 2),
        ("basin --zoom 4 --levels 2", 2),
        ("gait --walker simplest --system henon", 2),
    ],
)
def test_help_and_typos_load_no_jax_and_no_command(line, code):
    program = (
        "import sys\n"
        f"sys.argv = {['walker-jax', *line.split()]}\n"
        "from walker_jax.cli.main import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    loaded = {name.split('.')[0] for name in sys.modules}\n"
        "    assert not loaded & {'jax', 'numpy', 'equinox', 'matplotlib', 'xarray', 'zarr'}\n"
        "    mine = {name for name in sys.modules if name.startswith('walker_jax')}\n"
        "    assert not any('walkers' in name.split('.') or '_command' in name for name in mine)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == code
    assert "Traceback" not in done.stderr and bool(done.stderr) == (code == 2)


def test_a_parameter_of_another_walker_is_refused_alike():
    """Before JAX is loaded, and by the command."""
    for line in (["--foot-radius", "0.3"], ["--walker", "kneed", "--hip-stiffness", "1"]):
        with pytest.raises(WrongUse, match="is not a parameter of") as known:
            known_options.check_known("basin", line, typer.Context(app.load("basin")))
        command = app.load("basin", line)
        with pytest.raises(WrongUse) as loaded:
            command.main(line, standalone_mode=False)
        assert str(known.value) == str(loaded.value)


if __name__ == "__main__":
    PLACE.write_text(f"{in_lines(recorded())}\n")
