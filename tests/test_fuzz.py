"""Whatever is asked for: an answer, or one line that says what is wrong, and nothing is lost."""

import contextlib
import io
import json
import shutil
import sys
from collections import Counter
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import typer
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import walker_jax as wj
from walker_jax import cli, figures, paper, poses, store
from walker_jax.basin import check_grid

NUMBERS = ["0.004", "0.2", "-0.2", "0.01", "0.3", "1", "2", "3", "10", "0", "-1", "1.5", "1e-300"]
NUMBERS += ["1e300", "1e400", "nan", "inf", "-inf", "abc", "", " ", "0x10", "1_0", "٣", "9" * 30]
WORDS = ["slope", "simplest", "spring", "mass", "direct", "cell-map", "speed", "area", "speed=1"]
WORDS += ["slope=0.001:0.02", "slope=0.02:0.001", "slope=nan:1", "slope=", "=", "", "ä\n", "--json"]
PLACES = ["a.zarr", "a.png", "b.svg", "c.xyz", "w.gif", "no/a.zarr", ".", "..", "/", "", "\0.zarr"]
PLACES += ["taken", "taken/a.zarr", "file.txt", "file.txt/a.png", "broken.zarr", "held.zarr"]
PLACES += ["held.png", "n" * 250 + ".zarr", "n" * 300, "/proc/a.zarr", "/proc/a.png", "ä b.zarr"]
AXES = [("0.05", "0.35", "6"), ("-0.03", "0.01", "6"), ("0", "0.4", "46000"), ("0.4", "0", "6")]

QUICK = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
LONG = settings(QUICK, max_examples=5000)
CALM = {"walk", "gait", "basin", "bifurcation", "robustness", "optimise", "reproduce"}
COMMANDS = {
    name: command.params for name, command in typer.main.get_command(cli.app).commands.items()
}
assert set(COMMANDS) == CALM


@st.composite
def commands(draw, walkers=("simplest",)):
    """A command line: mostly what there is, with values good and bad."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    arguments = [name] if draw(st.integers(0, 30)) else [draw(st.sampled_from(WORDS))]
    chosen = draw(st.lists(st.sampled_from(COMMANDS[name]), max_size=5))
    for option in chosen:
        arguments.append(option.opts[0])
        if option.opts[0] == "--walker":
            arguments.append(draw(st.sampled_from([*walkers, "giraffe"])))
        elif option.nargs > 1:
            several = st.lists(
                st.sampled_from(NUMBERS), min_size=option.nargs, max_size=option.nargs
            )
            axes = st.sampled_from(AXES) if option.nargs == 3 else several
            arguments += draw(axes if draw(st.integers(0, 3)) else several)
        elif not option.is_flag:
            kinds = {"out": PLACES, "figure": PLACES, "animate": PLACES, "over": WORDS}
            kinds |= {"bound": WORDS, "objective": WORDS, "method": WORDS}
            arguments.append(draw(st.sampled_from(kinds.get(option.name, NUMBERS))))
    if not draw(st.integers(0, 20)):
        arguments.append(draw(st.sampled_from(WORDS + NUMBERS)))
    return arguments


def refuse(*_, **__):
    raise RuntimeError("so much is not computed here")


def put(path: Path, request: dict) -> None:
    path.write_bytes(store.signature(request).encode())


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Run command lines in a folder with things in it; what takes long is left out."""
    folder = tmp_path_factory.mktemp("fuzz")
    there, template = folder / "there", folder / "template"
    for name in ("taken", "broken.zarr"):
        (template / name).mkdir(parents=True)
    (template / "file.txt").write_text("mine")
    (template / "held.png").write_bytes(b"beach")
    (template / "broken.zarr" / "zarr.json").write_text('{"zarr_f')
    store.save(xr.Dataset({"x": ("n", np.arange(3))}), template / "held.zarr", {"command": "other"})
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 6), sum=(-0.03, 0.01, 6))
    answer = wj.basin(wj.SimplestWalker(0.004), grid, "direct")
    gait = wj.find_gait(wj.SimplestWalker(0.004))

    def basin(walker, grid, method, *, strides=200, progress=False, out=None, request=None):
        check_grid(walker, grid, method)
        return answer if out is None else store.save(answer, out, request or {})

    with contextlib.ExitStack() as stack:
        patch = lambda *all: stack.enter_context(mock.patch.object(*all))
        patch(cli, "keep_compiled", lambda: None)
        patch(cli, "draw", lambda axes, path, request: put(path, request))
        for name in ("basin", "basin_slices", "multipliers"):
            patch(figures, name, lambda data: None)
        patch(poses, "film", lambda *all, **more: all[1].write_bytes(more["signature"].encode()))
        patch(paper, "reproduce", refuse)
        patch(wj, "basin", basin)
        patch(wj, "bifurcation_diagram", refuse)
        patch(wj, "find_gaits", lambda walker, period: [gait] if period == 1 else [])
        patch(sys.modules["walker_jax.gaits"], "find_gaits", lambda *_, **__: [])
        patch(sys.modules["walker_jax.refinement"], "framed_attractors", refuse)
        patch(sys.modules["walker_jax.design"], "climb", refuse)

        def run(arguments):
            if not there.exists() or content(there) != content(template):
                shutil.rmtree(there, ignore_errors=True)
                shutil.copytree(template, there)
            out, err = io.StringIO(), io.StringIO()
            with (
                contextlib.chdir(there),
                contextlib.redirect_stdout(out),
                contextlib.redirect_stderr(err),
                mock.patch.object(sys, "argv", ["walker-jax", *arguments]),
                pytest.raises(SystemExit) as stop,
            ):
                cli.main()
            lost = {
                path: value
                for path, value in content(template).items()
                if content(there).get(path) != value
            }
            return stop.value.code, out.getvalue(), err.getvalue(), lost, content(there)

        yield run, content(template)


def content(folder: Path) -> dict[Path, bytes]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder): path.read_bytes() for path in files}


def check(bench, arguments, tried: Counter) -> None:
    run, before = bench
    try:
        code, out, err, lost, after = run(arguments)
    except BaseException:
        tried["tracebacks"] += 1
        raise
    tried[f"exit code {code}"] += 1
    tried["wrong exit codes"] += code not in (0, 1, 2)
    assert code in (0, 1, 2)
    assert err.count("\n") == (code != 0) and err.startswith("walker-jax: ") == (code != 0), err
    assert "Traceback" not in out + err and (len(err) > len("walker-jax: \n")) == (code != 0)
    assert code != 2 or after == before
    assert "--overwrite" in arguments or not lost
    # What is no data set stays in any case, and what a command may replace it must have named.
    assert not {str(path) for path in lost} & {"file.txt", "broken.zarr/zarr.json"}
    if code == 0 and "--json" in arguments and "--help" not in arguments:
        json.loads(out, parse_constant=lambda name: pytest.fail(name))


@QUICK
@given(arguments=commands())
def test_any_command_line_ends_in_order(bench, arguments):
    check(bench, arguments, Counter())


@pytest.mark.slow
def test_thousands_of_command_lines_end_in_order(bench):
    tried = Counter()

    @LONG
    @given(arguments=commands(walkers=("simplest", "spring", "point-foot", "round-foot")))
    def run(arguments):
        check(bench, arguments, tried)

    try:
        run()
    finally:
        print(dict(tried))
    assert tried["tracebacks"] == tried["wrong exit codes"] == 0 and sum(tried.values()) >= 5000
