"""The command line as a whole: help, messages, wrong usage, and the walkers that it knows."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import jax
import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli import app, startup
from walker_jax.cli.answers import Stopwatch
from walker_jax.cli.main import on_one_line
from walker_jax.cli.options import Option, message_of, option_of
from walker_jax.kernels import private_files
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.parameter_table import DESCRIBED
from walker_jax.walkers.parameters import describe_walker, options, parameters


def test_no_command_is_wrong_usage_in_one_line(run):
    code, out, err = run()
    assert code == 2 and "basin" in out
    assert err == "walker-jax: name a command, one of those above\n"


def test_a_failed_computation_ends_with_1_and_a_reason(run, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("no more memory\non the device")

    monkeypatch.setattr("walker_jax.walk", fail)
    said = "walker-jax: RuntimeError: no more memory on the device\n"
    assert run("walk") == (1, "", said)


def test_the_installed_command_starts(tmp_path):
    command = Path(sys.executable).with_name("walker-jax")
    done = subprocess.run([command, "--help"], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0 and "basin" in done.stdout and "walk" in done.stdout
    assert list(tmp_path.iterdir()) == []


def python(*arguments, **settings):
    """Run Python; returns exit code, standard output and error."""
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=os.environ | settings
    )
    return done.returncode, done.stdout, done.stderr


def test_the_help_lists_all_commands(run):
    for option in ("--help", "-h"):
        code, out, err = run(option)
        assert (code, err) == (0, "")
        words = " ".join(out.split())
        for name in app.NAMES:
            assert f"{name} {first_line(name)}" in words


def first_line(command):
    return str(app.load(command).short_help)


def test_the_help_of_a_command_begins_as_the_list_of_commands(run):
    for name in app.NAMES:
        long, short = run(name, "--help"), run(name, "-h")
        assert long == short and long[0] == 0
        assert first_line(name) in " ".join(long[1].split())


@pytest.mark.parametrize("name", app.NAMES)
def test_examples_of_a_command_are_read_as_its_options(name):
    command = app.load(name)
    assert command.examples and re.search(r"Time on two cores: .*\.$", str(command.epilog), re.S)
    for line in command.examples:
        own, *arguments = shlex.split(line)
        assert own == name
        command.make_context(name, arguments)  # refuses misspelt options and wrong values


def test_the_page_opens_walkers_in_space_and_a_real_spring(run, monkeypatch):
    opened = []
    monkeypatch.setattr(
        "walker_jax.explorer.server.run_server", lambda *given, **_: opened.append(given)
    )
    for walker, *given in (("spatial",), ("spring",), ("spring", "--hip-stiffness", "0")):
        assert run("explore", "--no-browser", "--walker", walker, *given) == (0, "", "")
    names, values = zip(*((offered.name, values) for _, _, offered, values in opened), strict=True)
    assert names == ("spatial", "spring", "spring")
    assert [one.get("hip_stiffness") for one in values] == [None, 1.0, 0.0]
    code, out, err = run("explore", "--walker", "simplest", "--axis", "theta=0:1:9")
    assert (code, out) == (2, "")
    shown = "the page shows a walker in the plane about its gait"
    assert err == f"walker-jax: --axis is for systems: {shown}\n"


def test_a_host_that_cannot_be_one_is_refused(run):
    for host, shown in (("a..b", "a..b"), ("", "''"), (" ", "''")):
        must = f"--host must be a name or an address, such as 127.0.0.1, not {shown}"
        assert run("explore", "--no-browser", "--host", host) == (2, "", f"walker-jax: {must}\n")


def test_options_exclude_others_that_there_are():
    """Some command has both, the option and the one that it excludes."""
    declared, met = set(), set()
    for name in app.NAMES:
        params = app.load(name).params
        declared |= {(one.name, other) for one in params for other in getattr(one, "excludes", ())}
        met |= {(one.name, other.name) for one in params for other in params}
    assert declared and declared <= met


@pytest.mark.parametrize(
    ("shell", "file", "own"),
    [
        ("bash", ".bashrc", b"# caf\xe9, in Latin-1\r\nalias l=ls"),
        ("zsh", ".zshrc", b""),
        ("fish", ".config/fish/config.fish", None),  # nor is there a folder
    ],
)
def test_completion_is_a_line_in_the_file_of_a_shell(run, tmp_path, monkeypatch, shell, file, own):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", f"/bin/{shell}")
    if own is not None:
        (tmp_path / file).write_bytes(own)
    assert run("--install-completion") == run("--install-completion")
    text = (tmp_path / file).read_bytes()
    assert text.startswith(own or b"") and text.count(b"\n") == (own or b"").count(b"\n") + 2
    assert text.count(f"_WALKER_JAX_COMPLETE={shell}_source".encode()) == 1
    monkeypatch.setenv("SHELL", "/bin/csh")
    code, out, err = run("--install-completion")
    assert (code, out) == (2, "") and err.endswith("one of bash, zsh, fish, not in csh\n")


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("walker-jax ba", {"basin"}),
        ("walker-jax gait --walker ro", {"round-foot"}),
        ("walker-jax gait --walker kneed --thigh-m", {"--thigh-mass"}),
        ("walker-jax basin --method ", {"cell-map", "direct"}),
        ("walker-jax gait --walker no.py:Walker --pe", {"--period"}),
    ],
)
def test_shells_complete_commands_options_and_values(words, completed):
    count = len(words.split(" ")) - 1
    settings = {"COMP_WORDS": words, "COMP_CWORD": str(count)}
    code, out, err = python("-m", "walker_jax", _WALKER_JAX_COMPLETE="bash_complete", **settings)
    assert (code, err) == (0, "")
    assert {line.partition(",")[2] for line in out.splitlines()} == completed


INTERRUPTED = """
import asyncio, os, signal, sys, threading
import walker_jax as wj
from walker_jax.cli.main import main
from zarr.core.sync import sync

async def write_pieces():
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    await asyncio.gather(*(asyncio.sleep(600) for _ in range(9)))

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
wj.walk = lambda *_, **__: sync(write_pieces())
sys.argv = ["walker-jax", "walk"]
main()
"""


def test_an_interruption_of_writes_is_one_line():
    """Not one for each piece that zarr was writing."""
    assert python("-c", INTERRUPTED) == (130, "", "walker-jax: interrupted\n")


def test_the_package_is_run_as_the_command():
    code, out, err = python("-m", "walker_jax", "--help")
    assert (code, err) == (0, "") and "basin" in out
    code, out, err = python("-m", "walker_jax", "bassin")
    said = "walker-jax: bassin is not a command: did you mean basin?\n"
    assert (code, out, err) == (2, "", said)


@pytest.mark.parametrize(
    "line, code",
    [
        ("--help", 0),
        ("basin --help", 0),
        ("gait --walker kneed -h", 0),
        ("basin --slpe 3", 2),
        ("basin --method guess", 2),
        ("walk --theta x", 2),
        ("walk --slope -1", 2),
        ("walk --foot-radius 0.3", 2),
        ("optimise --strides", 2),
        ("basin --zoom 4 --levels 2", 2),
        ("gait --walker simplest --system henon", 2),
    ],
)
def test_help_and_typos_load_no_jax(line, code):
    program = (
        "import sys\n"
        f"sys.argv = {['walker-jax', *line.split()]}\n"
        "from walker_jax.cli.main import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    loaded = {name.split('.')[0] for name in sys.modules}\n"
        "    assert not loaded & {'jax', 'numpy', 'equinox', 'matplotlib', 'xarray', 'zarr'}\n"
    )
    done, _, err = python("-c", program)
    assert done == code and "Traceback" not in err and bool(err) == (code == 2)


def test_the_table_has_the_parameters_of_all_walkers():
    assert DESCRIBED.keys() == WALKERS.keys()
    for name, kind in WALKERS.items():
        assert (*parameters(kind), *options(kind)) == DESCRIBED[name]


def test_messages_name_options():
    known = [
        Option(name) for name in "objective at_least at_most out overwrite leg theta slope".split()
    ]
    for said, arguments, named in (
        (["objective must be one of area"], "objective", "--objective must be one of area"),
        (
            ["at_least and at_most of speed must be finite"],
            "at_least at_most",
            "--at-least and --at-most of speed must be finite",
        ),
        (
            ["out is taken", "give another out, or overwrite"],
            "out overwrite",
            "out is taken: give another --out, or --overwrite",
        ),
        (["leg must be below leg_mass, not 1"], "leg", "--leg must be below leg_mass, not 1"),
        (["slope 1: no gait; give theta, or another slope"], "theta slope", None),
        (["a grid island"], "", "a grid island"),
        (["grid must not be a slice"], "grid", "grid must not be a slice"),  # without --axis
    ):
        error = WrongUse(*said, of=arguments)
        assert str(error) == ": ".join(said)
        told = named or "slope 1: no gait; give --theta, or another --slope"
        assert message_of(error, known) == told


def test_compiled_programs_are_kept_where_the_user_says(tmp_path, monkeypatch):
    settings = {}
    monkeypatch.setattr(jax.config, "update", settings.__setitem__)
    for variable, place, kept in [
        ("WALKER_JAX_CACHE_DIR", tmp_path / "here", tmp_path / "here" / "xla-programs"),
        ("WALKER_JAX_CACHE_DIR", "", None),
        ("JAX_COMPILATION_CACHE_DIR", tmp_path / "of JAX", None),  # which takes care of it itself
    ]:
        monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
        monkeypatch.setenv(variable, str(place))
        settings.clear()
        startup.keep_compiled()
        assert settings.get("jax_compilation_cache_dir") == (str(kept) if kept else None)
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


def test_what_xla_compiles_is_kept_from_others(tmp_path, monkeypatch):
    settings, folder = {}, tmp_path / "here" / "xla-programs"
    monkeypatch.setattr(jax.config, "update", settings.__setitem__)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", str(tmp_path / "here"))
    before = os.umask(0)
    try:
        startup.keep_compiled()
    finally:
        os.umask(before)
    assert settings["jax_compilation_cache_dir"] == str(folder)
    assert [place.stat().st_mode & 0o777 for place in (folder.parent, folder)] == [0o700] * 2
    for name in ("a-cache", "a-atime", "mine"):
        (folder / name).write_bytes(b"program")
    startup.keep_compiled()
    assert len([*folder.iterdir()]) == 3
    folder.chmod(0o755)  # others may enter, and JAX's files have the mode of the umask
    startup.keep_compiled()
    assert [*folder.iterdir()] == [folder / "mine"]
    assert folder.stat().st_mode & 0o777 == 0o700
    for place in (folder, folder.parent):
        place.chmod(0o777)
        settings.clear()
        private_files.warn_once.cache_clear()
        with pytest.warns(RuntimeWarning, match=f"compiled programs in {place} are not used"):
            startup.keep_compiled()
        assert settings == {}


def test_importing_sets_no_flag_and_loads_no_drawing():
    program = (
        "import jax, sys\n"
        "before = dict(jax.config.values)\n"
        "import walker_jax\n"
        "assert before == dict(jax.config.values)\n"
        "walker_jax.find_gait, walker_jax.SimplestWalker, walker_jax.strides\n"
        "late = {'matplotlib', 'dask', 'zarr', 'click', 'xarray', 'scipy.stats', 'diffrax'}\n"
        "assert not late & set(sys.modules)\n"
        "from walker_jax.cli.walker_options import choose\n"
        "choose([], systems=False).build({})\n"
        "loaded = 'jaxlib.mlir.dialects.mhlo' in sys.modules\n"
        "assert not loaded, 'a walker of the command line compiles a program of XLA'\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_public_names_are_the_same_whatever_is_loaded_first():
    """A module of that name would take its place."""
    program = (
        "import types, walker_jax.design.sweeps, walker_jax\n"  # which loads most of the others
        "from walker_jax import basin, stride, storage\n"
        "from walker_jax import *\n"
        "values = [getattr(walker_jax, name) for name in walker_jax.__all__]\n"
        "assert not any(isinstance(value, types.ModuleType) for value in values)\n"
        "assert basin.__name__ == walker_jax.basin.__name__ == 'basin' and callable(stride)\n"
        "assert isinstance(storage, types.ModuleType)\n"
        "assert set(walker_jax.__all__) < set(globals())\n"
        "modules = ['figures', 'fractals', 'kernels', 'multibody', 'systems']\n"
        "assert dir(walker_jax) == sorted([*walker_jax.__all__, *modules, '__version__'])\n"
        "assert all(isinstance(getattr(walker_jax, name), types.ModuleType) for name in modules)\n"
        "assert not hasattr(walker_jax, 'no_such_name')\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_long_reason_keeps_its_beginning_and_its_end():
    line = on_one_line(f"slope must be\n1, not {'x' * 100} {'and so on ' * 30}: give another")
    assert len(line) == 187 and line.startswith(f"slope must be 1, not {'x' * 29}...{'x' * 29} and")
    assert "..." in line[90:] and line.endswith(": give another")
    assert on_one_line("all  is\nsaid") == "all is said"


def test_compile_time_counts_once():
    clock = Stopwatch()
    start = clock.start
    clock.compiling = [(start + 1, start + 3), (start + 2, start + 4), (start + 6, start + 7)]
    assert clock.seconds()["compile"] == pytest.approx(4)


def test_walkers_are_listed_with_parameters_units_and_defaults(run):
    for arguments in (["--list-walkers"], ["basin", "--list-walkers"]):
        code, out, err = run(*arguments)
        assert (code, err) == (0, "")
        for name, kind in WALKERS.items():
            assert f"{name}:" in out and ", ".join(kind.section) in out
            own = out[out.index(f"{name}:") :].splitlines()
            for one in parameters(kind):
                row = next(line for line in own if f"{option_of(one.name)} " in line)
                assert f"{one.default:g}" in row and one.unit in row and one.meaning in row


def test_help_has_the_slopes_that_a_walker_has_by_default(run):
    words = lambda *arguments: " ".join(run(*arguments)[1].replace("│", " ").split())
    assert "--slope X of the ground; rad (default: 0.004)" in words("walk", "--help")
    kneed = words("walk", "--walker", "kneed", "--help")
    assert "--slope X of the ground; rad (default: 0.05)" in kneed
    said = words("bifurcation", "--help")
    assert "Lowest value (default, of the slope: 0.001, kneed: 0.03)" in said
    assert "Highest value (default, of the slope: 0.022, kneed: 0.12)" in said


def test_help_has_the_parameters_of_the_walker_that_is_named(run):
    for named in ([], ["--walker", "round-foot"], ["--walker=upper-body"], ["--system", "henon"]):
        code, out, _ = run("basin", *named, "--help")
        kind = WALKERS.get(
            named[-1].rpartition("=")[2] if named else "simplest", wj.systems.HenonMap
        )
        own = {option_of(one.name) for one in parameters(kind)}
        others = {option_of(one.name) for kind in WALKERS.values() for one in parameters(kind)}
        found = set(re.findall(r"^  (--[\w-]+) ", out, re.M))
        assert code == 0 and own <= found and not (others - own) & found


@pytest.mark.parametrize("name", app.NAMES)
def test_help_begins_with_examples_and_is_short(run, name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = run(name, "--help")[1].splitlines()
    assert lines[0].startswith(f"Usage: walker-jax {name} ") and "Examples:" in lines[:6]
    assert len(lines) <= 66 and not any(
        len(line) > 80 for line in lines if "walker-jax" not in line
    )
    assert not any("None" in line for line in lines)
    command = app.load(name)
    described = [one.opts[0] for one in command.params if isinstance(one, click.Option)]
    page = "\n".join(lines)
    assert [one for one in described if not re.search(rf"^  (-\w, )?{one}\b", page, re.M)] == []


def test_another_walker_walks_and_is_named(run):
    start = ["--theta", "0.16", "--thetadot", "-0.17"]
    walker = ["--walker", "spring", "--hip-stiffness", "0.5", "--slope", "0.005"]
    code, out, err = run("walk", *walker, *start, "--strides", "3", "--json")
    assert (code, err) == (0, "")
    walk = wj.walk(wj.SpringWalker(0.005, 0.5), np.array([0.16, -0.17]), 3)
    np.testing.assert_allclose(json.loads(out)["states"], walk.states, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_three_dimensions_have_a_gait_a_slice_and_a_basin(run, tmp_path):
    walker = ["--walker", "round-foot", "--slope", "0.01"]
    code, out, err = run("gait", *walker, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    gait = answer["gaits"][0]
    assert answer["walker"] == {
        "name": "RoundFootWalker",
        **describe_walker(wj.RoundFootWalker(0.01)),
    }
    assert gait["stable"] and len(gait["multipliers"]) == 3
    guess = ["--guess", *gait["states"][0][:2], "--phidot", gait["states"][0][2]]
    code, out, _ = run("gait", *walker, *guess)
    assert code == 0 and "phidot" in out

    window = ["--theta", "0.05", "0.45", "20", "--sum", "-0.15", "-0.02", "16"]
    code, out, err = run("basin", *walker, *window, "--out", "s.zarr", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["method"] == "direct" and answer["attractors"][0]["period"] == 1
    data = xr.open_zarr(tmp_path / "s.zarr", consolidated=False).load()
    assert data.fate.dims == ("theta", "sum")
    assert float(data.phidot) == pytest.approx(gait["states"][0][2], abs=1e-12)
    assert (tmp_path / "s.png").stat().st_size > 10_000

    depth = ["--phidot", "-0.1", "0.0", "7"]
    code, out, err = run("basin", *walker, *window, *depth, "--out", "w.zarr", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["method"] == "cell-map" and answer["cells"] == 20 * 16 * 7
    assert (tmp_path / "w.png").stat().st_size > 10_000
