"""Walkers that are not of the package, by the names that the command line takes."""

import json
import sys
from importlib.metadata import EntryPoint

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.walker_options import walkers_that_begin
from walker_jax.walkers import references
from walker_jax.walkers.parameters import describe_in_words, describe_walker, parameters
from walker_jax.walkers.references import find_walker

TORQUE = '''
import equinox as eqx
import jax
import numpy as np

import walker_jax as wj
from walker_jax.walkers.parameters import Parameter
from {helper} import torque

DAMPING = Parameter("damping", "of the hip", "sqrt(g / l)", 1.0, closed=True)


class TorqueWalker(wj.SimplestWalker):
    """The simplest walker with a PD torque at the hip."""

    stiffness: jax.Array
    damping: jax.Array = eqx.field(converter=DAMPING.convert, default=1.0)
    target: jax.Array = -0.4

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot + torque(self, state))


class Unfinished(wj.Walker):
    slope: jax.Array


class Halved(wj.System):
    section = ("x", "y")

    def advance(self, x):
        return x / 2, 0, 1.0
'''
HELPER = """
def torque(walker, state):
    return -walker.stiffness * (state.phi - walker.target) - walker.damping * state.phidot
"""
GIVEN = ["--walker", "torque_walker.py:TorqueWalker", "--stiffness", "4", "--slope", "0.01"]


class TorqueWalker(wj.SimplestWalker):
    """The same, in this file, without descriptions."""

    stiffness: jax.Array
    damping: jax.Array
    target: jax.Array

    def vector_field(self, state):
        free = super().vector_field(state)
        torque = -self.stiffness * (state.phi - self.target) - self.damping * state.phidot
        return free._replace(phidot=free.phidot + torque)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a walker in a file, which uses another file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # its times are too coarse for a test
    (tmp_path / "torque_walker.py").write_text(TORQUE.replace("{helper}", "torque_helper"))
    (tmp_path / "torque_helper.py").write_text(HELPER)
    yield tmp_path
    for name in ("torque_walker", "torque_helper"):
        sys.modules.pop(name, None)


@pytest.fixture
def run(place, run):
    """Run a command there; returns exit code, standard output and error."""

    def run_anew(*arguments):
        for name in ("torque_walker", "torque_helper"):  # as in a process of its own
            sys.modules.pop(name, None)
        return run(*arguments)

    return run_anew


def test_a_walker_of_a_file_walks_as_the_same_class_elsewhere(run):
    start = ["--theta", "0.19", "--thetadot", "-0.22"]
    code, out, err = run("walk", *GIVEN, *start, "--strides", "4", "--json")
    assert (code, err) == (0, "")
    walker = TorqueWalker(0.01, *np.array([4.0, 1.0, -0.4]))
    walk = wj.walk(walker, np.array([0.19, -0.22]), 4)
    np.testing.assert_allclose(json.loads(out)["states"], walk.states, rtol=0, atol=1e-13)
    assert run("walk", *GIVEN, *start, "--strides", "4", "--json", "--target", "0.3")[1] != out


def test_parameters_are_options_with_meaning_unit_and_default(run):
    code, out, _ = run("basin", "--help", *GIVEN[:2])
    words = " ".join(out.replace("│", " ").split())
    assert code == 0
    assert "--damping" in words and "of the hip; sqrt(g / l) (default: 1)" in words
    assert "(required)" in words and "(default: -0.4)" in words
    assert "--foot-mass" not in words  # of another walker


def test_a_result_is_not_resumed_or_reused_by_changed_code(run, place):
    """Of any system in a file that imports another one."""
    command = ["basin", "--system", "torque_walker.py:Halved", "--axis", "x=0:1:3"]
    command += ["--axis", "y=0:1:2", "--method", "direct", "--strides", "3"]
    assert run(*command)[0] == 0
    assert "computed before" in run(*command)[1]
    for name in ("torque_helper.py", "torque_walker.py"):
        source = (place / name).read_text()
        (place / name).write_text(
            source.replace("damping", "damping * 2 / 2").replace("2 / 2: jax", ": jax")
            if name == "torque_helper.py"
            else source + "\nmore = 1\n"
        )
        code, out, err = run(*command)
        assert (code, out) == (2, "") and "basin.zarr holds another result (code: " in err
        (place / name).write_text(source)
    assert "computed before" in run(*command)[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--walker", "no.py:W"], "--walker no.py: there is no such file"),
        (["--walker", "torque_walker.py"], "torque_walker.py:TorqueWalker"),
        (["--walker", "torque_walker.py:Wrong"], "must name a class of walkers: give torque_wa"),
        (["--walker", "torque_walker.py:Unfinished"], "must define clearance, contact_force, fea"),
        (["--walker", "bad.py:W"], "bad.py cannot be loaded: ZeroDivisionError: division by ze"),
        (["--walker", "numpy.py:W"], "numpy.py: another module is named numpy: rename the file"),
        (["--walker", "tabnanny.py:W"], "tabnanny.py: another module is named tabnanny: rename"),
        (["--walker", "my.walker.py:W"], "a module cannot be named my.walker: rename the file"),
        (["--walker", "leaves.py:W"], "leaves.py cannot be loaded: SystemExit: 0 (line 1)"),
        (["--walker", "no_such_module:W"], "--walker no_such_module cannot be loaded: ModuleNot"),
        (["--walker", "giraffe"], "--walker must be one that walker-jax --list-walkers shows"),
        (GIVEN[:2], "--stiffness is required: torque_walker.py:TorqueWalker has no default"),
        ([*GIVEN, "--damping", "-1"], "--damping must be finite and not negative, not -1"),
        ([*GIVEN, "--target", "nan"], "--target must be finite, not nan"),
        (["--walker", "strides.py:W"], "--strides is an option of the command: rename the para"),
    ],
)
def test_what_is_no_walker_is_refused_in_one_line(run, place, arguments, said):
    (place / "bad.py").write_text("x = 1\ny = 1 / 0\n")
    (place / "leaves.py").write_text("raise SystemExit(0)")
    for name in ("numpy", "tabnanny", "my.walker"):
        (place / f"{name}.py").write_text("")
    clash = (
        "import jax, walker_jax as wj\nclass W(wj.SimplestWalker):\n    strides: jax.Array = 1.0\n"
    )
    (place / "strides.py").write_text(clash)
    code, out, err = run("walk", *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1) and said in err
    if "bad.py" in said:
        assert "(line 2)" in err
    sys.modules.pop("strides", None)


@pytest.mark.parametrize("name", ["quiet", "json", "sum", "help", "walker", "list_walkers", "low"])
def test_options_of_a_command_are_no_parameters_of_a_walker(run, place, name):
    source = "import jax, walker_jax as wj\nclass W(wj.SimplestWalker):\n    {}: jax.Array = 1.0\n"
    (place / "torque_walker.py").write_text(source.format(name))
    given = ["--walker", "torque_walker.py:W"]
    option = f"--{name.replace('_', '-')}"
    if name == "low":  # no option, but a name within the program
        words = " ".join(run("bifurcation", "--help", *given)[1].split())
        assert "--low" in words and "--from" in words
        return
    code, out, err = run("basin", "--help", *given)
    said = f"{option} is an option of the command: rename the parameter {name}\n"
    assert (code, out, err) == (2, "", f"walker-jax: {said}")


def test_packages_add_walkers_which_are_listed(run, monkeypatch):
    points = [
        EntryPoint("torque", "torque_walker:TorqueWalker", references.GROUP),
        EntryPoint("broken", "no_such_module:W", references.GROUP),
        EntryPoint("simplest", "torque_walker:TorqueWalker", references.GROUP),
    ]
    monkeypatch.setattr(references, "entry_points", lambda group: points)
    sys.path.insert(0, ".")
    code, out, err = run("--list-walkers")
    assert (code, err) == (0, "")
    assert "torque (of torque_walker): The simplest walker with a PD torque" in out
    assert "broken (of no_such_module): walker broken (no_such_module:W) cannot be loaded" in out
    assert walkers_that_begin(None, None, "to") == ["torque"]
    assert walkers_that_begin(None, None, "sim") == ["simplest"]
    code, out, _ = run(
        "walk",
        "--walker",
        "torque",
        "--stiffness",
        "4",
        "--theta",
        "0.19",
        "--thetadot",
        "-0.22",
        "--strides",
        "1",
        "--json",
    )
    assert code == 0 and json.loads(out)["outcomes"] == ["STRIDE"]
    assert find_walker("simplest") is wj.SimplestWalker
    with pytest.raises(WrongUse, match=r"^walker broken \(no_such_module:W\) cannot be loaded"):
        find_walker("broken")


def test_parameters_that_are_not_described_are_real_numbers():
    names = [one.name for one in parameters(TorqueWalker)]
    assert names == ["slope", "stiffness", "damping", "target"]
    slope, stiffness, *_ = parameters(TorqueWalker)
    assert slope.unit == "rad" and np.isnan(stiffness.default)
    walker = TorqueWalker(0.01, *np.array([4.0, 1.0, -0.4]))
    values = {"slope": 0.01, "stiffness": 4.0, "damping": 1.0, "target": -0.4}
    assert describe_walker(walker) == {"name": "TorqueWalker", **values}


def test_a_static_field_is_no_parameter_and_data_sets_name_it():
    class Stiff(wj.SimplestWalker):
        gain: jax.Array
        terms: int = eqx.field(static=True, default=3)
        kind: str = eqx.field(static=True, default="odd")

        def vector_field(self, state):
            free = super().vector_field(state)
            odd = [state.phi ** (2 * k + 1) for k in range(self.terms)]
            return free._replace(phidot=free.phidot - self.gain * sum(odd))

    grid = wj.Grid.sheared(theta=(0.1, 0.3, 4), sum=(-0.02, 0.01, 4))
    walker = Stiff(0.009, jnp.array(0.05), 1)
    data = wj.basin(walker, grid, "direct")
    named = {name: data.attrs[f"walker_{name}"] for name in ("slope", "gain", "terms", "kind")}
    assert named == {"slope": 0.009, "gain": 0.05, "terms": 1, "kind": "odd"}
    assert describe_in_words(walker) == "Stiff, slope 0.009, gain 0.05, terms 1, kind odd"
    gait = data["states"].values[:, 0]
    assert gait.shape == (1, 2)
    np.testing.assert_allclose(wj.strides(walker, gait).state, gait, rtol=0, atol=1e-9)
    with_more = wj.strides(Stiff(0.009, walker.gain), gait)
    assert not np.allclose(with_more.state, gait)
