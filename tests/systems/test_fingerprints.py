"""Fingerprints of the code of walkers that are not of the package."""

import dis
import functools
import importlib
import inspect
import math
import os
import subprocess
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.fingerprints import StoreDescriber, code_fingerprint, imports_in
from walker_jax.identity import FunctionByCode, hash_of_code, values_in
from walker_jax.kernels import kernel
from walker_jax.multibody import System
from walker_jax.origins import FOLDER, holds_packages, root_of
from walker_jax.stability.metric import metric_of
from walker_jax.stability.rough_ground import NormalSteps
from walker_jax.walkers.model import State
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walkers.references import find_walker

OWN = {
    "own/walker.py": """
import walker_jax as wj
from constants import MASS
from tools.helper import push
import deep.inner.far
from deep.inner import near


class W(wj.SimplestWalker):
    def impact(self, state):
        from lazy import late
        return super().impact(state)
""",
    "own/constants.py": "MASS = 1.0",
    "own/tools/helper.py": "def push(): return 1",
    "own/deep/__init__.py": "",
    "own/deep/inner/far.py": "TABLE = [1, 2]",
    "own/deep/inner/near.py": "",
    "own/lazy.py": "import constants\ndef late(): return 1",
    "own/beside.py": "",
    "pack/__init__.py": "",
    "pack/inner/__init__.py": "from .. import numbers",
    "pack/inner/walker.py": """
import beside_the_package
from pack.mixins import Mixin
import walker_jax as wj


class W(Mixin, wj.SimplestWalker):
    pass
""",
    "pack/mixins.py": "class Mixin: pass",
    "pack/numbers.py": "ONE = 1",
    "pack/unused.py": "",
    "beside_the_package.py": "",
}


@pytest.fixture
def fingerprint(tmp_path, monkeypatch):
    """Fingerprints of the walkers of these files, each as of a process of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    for name, text in OWN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    def forget():
        holds_packages.cache_clear()
        tops = {Path(name.removeprefix("own/")).parts[0].removesuffix(".py") for name in OWN}
        for name in [one for one in sys.modules if one.partition(".")[0] in tops]:
            del sys.modules[name]
        importlib.invalidate_caches()

    def fingerprint(name):
        forget()
        return code_fingerprint(find_walker(name))

    yield fingerprint
    forget()


@pytest.mark.parametrize(
    ("name", "without"),
    [
        ("own/walker.py:W", {"own/beside.py", *(one for one in OWN if not one.startswith("own"))}),
        ("pack.inner.walker:W", {"pack/unused.py", *(one for one in OWN if one.startswith("own"))}),
    ],
)
def test_a_fingerprint_covers_every_file_of_the_folder_imported(
    fingerprint, name, without, tmp_path
):
    found = fingerprint(name)
    assert len(found) == 16 and fingerprint(name) == found
    same = set()
    for one, before in OWN.items():
        (tmp_path / one).write_text(before + "\nmore = 1\n")
        same |= {one} if fingerprint(name) == found else set()
        (tmp_path / one).write_text(before)
    assert same == without


def test_a_fingerprint_is_of_the_code_that_was_loaded(fingerprint, tmp_path):
    name = "own/walker.py:W"
    before = fingerprint(name)
    kind = find_walker(name)
    path = tmp_path / "own" / "constants.py"
    path.write_text("MASS = 2.0")
    assert code_fingerprint(kind) == before
    importlib.reload(sys.modules["constants"])
    assert code_fingerprint(kind) not in ("", before)


def test_an_installed_package_is_covered_without_its_neighbours(fingerprint, tmp_path):
    (tmp_path / "pack-1.0.dist-info").mkdir()
    found = fingerprint("pack.inner.walker:W")
    for name, changes in (("beside_the_package.py", False), ("pack/mixins.py", True)):
        (tmp_path / name).write_text(OWN[name] + "\nmore = 1\n")
        assert (fingerprint("pack.inner.walker:W") != found) == changes


def test_a_file_that_another_one_hides_is_refused(fingerprint, tmp_path):
    sys.path.insert(0, str(tmp_path / "own"))
    (tmp_path / "walker.py").write_text(OWN["own/walker.py"])
    with pytest.raises(WrongUse, match="another module is named walker: rename the file"):
        fingerprint("walker.py:W")


SESSION = """
import jax, jax.numpy as jnp, equinox as eqx, numpy as np, threading
from typing import NamedTuple

MASS = 1.0
TABLE = jnp.array([1.0, 2.0])


class Inner(NamedTuple):
    x: float
    y: float = 0.0


@jax.jit
def helper(x, more=3.0):
    return x * more * MASS


def made(factor):
    def times(x):
        return x * factor
    return times


double = made(2.0)


class W(wj.SimplestWalker):
    size: jax.Array = eqx.field(converter=lambda x: x + 0, default=1.0)
    {attribute}

    @eqx.filter_jit
    def impact(self, state):  # a comment
        from beside_the_package import late
        return helper(double(TABLE)), Inner(1.0), state[:1]
"""


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("# a comment", "# another", True),
        ("MASS = 1.0", "MASS = 1.0\nsomething = 2", True),
        ("MASS = 1.0", "MASS = 2.0", False),
        ("[1.0, 2.0]", "[1.0, 3.0]", False),
        ("x * more", "x + more", False),
        ("more=3.0", "more=4.0", False),
        ("made(2.0)", "made(3.0)", False),
        ("y: float = 0.0", "y: float = 1.0", False),
        ("x + 0", "x - 0", False),
        ("default=1.0", "default=2.0", False),
        ("{attribute}", "kind = 'other'", False),
        ("state[:1]", "state[:2]", False),
        ("TABLE = jnp.array([1.0, 2.0])", "TABLE = threading.Lock()", False),
    ],
)
def test_fingerprints_tell_code_apart_where_there_is_no_file(fingerprint, old, new, same):
    def defined(source):
        names: dict[str, Any] = {
            "__name__": "tabnanny",
            "wj": wj,
        }  # of the standard library, and not loaded
        exec(compile(source, "<cell>", "exec"), names)
        return code_fingerprint(names["W"])

    source = SESSION.replace(old, new).replace("{attribute}", "kind = 'one'")
    found = defined(SESSION.replace("{attribute}", "kind = 'one'"))
    assert len(found) == 16
    assert (defined(source) == found) == same
    if "Lock" in new:  # nobody can tell one from another
        assert defined(source) != defined(source)


class Decorated:
    """Has the names of a function that it is made of, and more."""

    def __init__(self, function, factor):
        wrapper: Any = self
        functools.update_wrapper(wrapper, function)
        self.factor = factor


def made_by(kind, factor):
    return kind(math.sin, factor)


def test_files_and_closures_of_classes_in_sessions_are_covered(fingerprint, tmp_path):
    names: dict[str, Any] = {"__name__": "console", "wj": wj}
    exec(SESSION.replace("{attribute}", ""), names)
    found = code_fingerprint(names["W"])
    (tmp_path / "beside_the_package.py").write_text("def late(): return 2")
    assert code_fingerprint(names["W"]) != found

    def made(factor):
        class W(wj.SimplestWalker):
            def impact(self, state):
                return super().impact(state * factor)

        return code_fingerprint(W)

    assert made(1.0) == made(1.0) != made(2.0)
    by_default = lambda factor: lambda x, *, size=factor: x * size
    of_function = lambda *parts: code_fingerprint(wj.Map, parts)
    assert of_function(by_default(1.0)) == of_function(by_default(1.0))
    assert of_function(by_default(1.0)) != of_function(by_default(2.0))
    assert of_function({"a": 1.0}.get) != of_function({"a": 2.0}.get)
    assert of_function(made_by(Decorated, 1.0)) != of_function(made_by(Decorated, 2.0))
    assert code_fingerprint(wj.SpringWalker) == ""


def test_a_session_is_described_alike_in_another_process(fingerprint):
    source = SESSION.replace("{attribute}", "").replace(
        "MASS = 1.0", "MASS = {'one', 'two', 'three'}"
    )
    program = f"""
import walker_jax as wj
from walker_jax.fingerprints import StoreDescriber
names = {{"__name__": "console", "wj": wj}}
exec({source!r}, names)
found = StoreDescriber().describe(names["helper"], names["Inner"], names["W"].impact)
"""
    names: dict[str, Any] = {}
    given = {"PYTHONPATH": os.pathsep.join(sys.path), "JAX_ENABLE_X64": "1", "PYTHONHASHSEED": "1"}
    said = subprocess.run(
        [sys.executable, "-c", f"{program}print(found)"],
        env={**os.environ, **given},
        capture_output=True,
        text=True,
    )
    assert said.returncode == 0, said.stderr
    exec(program, names)
    assert said.stdout.strip() == str(names["found"]) and "three" in said.stdout


IN_A_NOTEBOOK = """
EXTRA = 0.0
bounds = {"least": 0.0}


def extra():
    return EXTRA + bounds["least"]


class Shifted(wj.SimplestWalker):
    def during_stride(self, x):
        return with_parameter(self, "slope", self.slope + extra())
"""

HALVED = """

class Halved(wj.System):
    section = ("x",)

    def advance(self, x):
        return x / 2 + extra(), wj.Outcome.STRIDE, 1.0
"""


def test_a_function_reads_modules_as_they_are_at_that_moment():
    module: Any = ModuleType("constants_of_a_notebook")
    inner: Any = ModuleType("inner_of_a_notebook")
    module.SIZE, module.other, module.inner = 1.0, 0.0, inner
    inner.SIZE, inner.back = 1.0, module
    names: dict[str, Any] = {"constants": module}
    exec("def size(): return constants.SIZE + constants.inner.SIZE", names)
    before = FunctionByCode(names["size"])
    module.other = 1.0
    assert FunctionByCode(names["size"]) == before
    for one in (module, inner):
        one.SIZE = 2.0
        assert FunctionByCode(names["size"]) != before
        one.SIZE = 1.0
    assert FunctionByCode(names["size"]) == before


def test_a_function_is_the_same_wherever_it_stands():
    def made(source):
        names: dict[str, Any] = {}
        exec(source, names)
        return FunctionByCode(names["read"])

    source = "def read(x):\n    return one(x)"
    assert made(source) == made(f"# moved\n{source}") != made(source.replace("one", "other"))


def test_values_of_unusual_kinds_are_told_apart():
    def of(value):
        return FunctionByCode(lambda: value)

    empty = [FunctionType(of(1).value.__code__, {}, "f", None, (CellType(),)) for _ in range(2)]
    assert FunctionByCode(empty[0]) == FunctionByCode(empty[1]) != of(1)
    wrapped = lambda size: functools.wraps(math.sin)(lambda x, by=size: by * x)
    assert (
        FunctionByCode(wrapped(2)) == FunctionByCode(wrapped(2)) != FunctionByCode(wrapped(3))
    )  # it is no code of Python
    # The order of a set is that of its words, wherever its functions are in memory.
    a, b, c, d = sorted((new_half() for _ in range(4)), key=id)
    assert of({(a, 0), (b, 1)}) == of({(c, 1), (d, 0)}) != of({(a, 0), (b, 2)})
    assert values_in(np.array([None]), 100) is None  # its bytes would be addresses
    thing, alike = object(), wj.Outcome.STRIDE
    assert of(thing) == of(thing) != of(object()) and of(alike) == of(wj.Outcome(0))


def new_half():
    def half(x):
        return x / 2

    return half


def test_functions_of_one_name_in_a_file_are_told_apart():
    """Lambdas, also in one line, and functions of either branch; twice the same is the same."""
    one, other = (lambda x: x, lambda x: 2 * x)
    chosen = []
    for first in (True, False, True):
        if first:

            def turned(x):
                return x

        else:

            def turned(x):
                return -x

        chosen.append(turned)
    found = [code_fingerprint(object, (each,)) for each in (one, other, *chosen)]
    assert len(set(found)) == 4 and found[2] == found[4]


def test_files_that_are_covered_are_those_of_a_project(tmp_path):
    def covered(root, name):
        found = StoreDescriber()
        found.add_file(root / name, root)
        return sorted(found.sources)

    (tmp_path / "inner").mkdir()
    (tmp_path / "outside.py").write_text("")
    (tmp_path / "inner" / "one.py").write_text("try:\n    from .. import outside\nfinally: pass")
    assert covered(tmp_path / "inner", "one.py") == ["one.py"]  # nothing above its folder
    assert covered(tmp_path, "inner/one.py") == ["inner/one.py", "outside.py"]
    assert covered(FOLDER.parent, "walker_jax/identity.py") == []
    (tmp_path / "two.py").write_text("import inner.one, walker_jax")
    assert covered(tmp_path, "two.py") == ["inner/one.py", "outside.py", "two.py"]
    assert imports_in(b"import a\0") == imports_in(b"import (") == []
    program = ModuleType("__main__")  # by python -m inner.one
    program.__spec__ = ModuleSpec("inner.one", None)
    assert root_of(program, tmp_path / "inner" / "one.py") == tmp_path
    program.__spec__ = None
    assert root_of(program, tmp_path / "inner" / "one.py") == tmp_path / "inner"


def of_every_kind(a, /, b, *, c):
    values = [a, b]
    try:
        values.append(c.size)
    except AttributeError:
        values.append(1.0)
    return lambda: values


def test_code_is_what_it_does_and_not_where_it_stands():
    code = of_every_kind.__code__
    hashed = lambda **changed: hash_of_code(code.replace(**changed))
    for name in ("co_name", "co_qualname", "co_filename"):
        assert hashed(**{name: "other"}) == hash_of_code(code)
    assert hashed(co_firstlineno=1) == hashed(co_linetable=b"") == hash_of_code(code)
    assert len(code.co_exceptiontable) and len(code.co_cellvars)
    renamed = {
        name: tuple(f"other_{one}" for one in getattr(code, name))
        for name in ("co_names", "co_varnames", "co_cellvars")
    }
    others = {
        **renamed,
        "co_freevars": ("free",),
        "co_code": code.co_code + bytes([dis.opmap["NOP"], 0]),
        "co_exceptiontable": b"",
        "co_consts": (*code.co_consts, 1.0),
        "co_argcount": 1,
        "co_posonlyargcount": 0,
        "co_kwonlyargcount": 0,
        "co_flags": code.co_flags ^ inspect.CO_GENERATOR,
    }
    found = [hash_of_code(code), *(hashed(**{name: one}) for name, one in others.items())]
    assert len({*found}) == len(found)


def test_a_system_reads_what_is_there_at_that_moment():
    """As in a notebook, where a cell is run again, and the class is not."""
    names: dict[str, Any] = {"__name__": "cells_of_a_notebook", "wj": wj}
    exec(IN_A_NOTEBOOK + HALVED, names)
    end = lambda: float(wj.strides(names["Halved"](), np.array([[1.0]])).state[0, 0])
    assert end() == 0.5
    names["EXTRA"] = 0.25
    assert end() == 0.75
    names["bounds"]["least"] = 0.125
    assert end() == 0.875
    names.update(EXTRA=0.0, bounds={"least": 0.0})
    assert end() == 0.5


@pytest.mark.slow
@pytest.mark.parametrize("kernels", [True, False])
def test_a_walker_reads_what_is_there_at_that_moment(kernels, monkeypatch):
    if not kernels:
        monkeypatch.setattr("walker_jax.kernels.program.Program.compiled", None)
    cells = {"__name__": "cells_of_a_notebook", "wj": wj, "with_parameter": with_parameter}
    exec(IN_A_NOTEBOOK, cells)
    walker = cells["Shifted"](slope=jnp.array(0.004))
    x = np.array([[0.2, -0.21], [0.2, -0.2]])
    ends = lambda: np.asarray(wj.strides(walker, x).state)
    expected = lambda slope: np.asarray(wj.strides(wj.SimplestWalker(slope), x).state)
    assert ends() == pytest.approx(expected(0.004), abs=1e-14)
    cells["EXTRA"] = 0.006
    assert ends() == pytest.approx(expected(0.01), abs=1e-14)
    cells["bounds"]["least"] = 0.001
    assert ends() == pytest.approx(expected(0.004 + (0.006 + 0.001)), abs=1e-14)
    cells.update(EXTRA=0.0, bounds={"least": 0.0})
    assert ends() == pytest.approx(expected(0.004), abs=1e-14)


WITH_MASSES = """
HEAVIER = 1.0


class Laden(wj.RoundFootWalker):
    def system(self):
        system = super().system()
        masses = system.masses * jnp.where(jnp.arange(len(system.masses)) < 2, HEAVIER, 1.0)
        return System(system.transfer, masses, system.forces)
"""


def test_equations_of_motion_read_what_is_there_at_that_moment():
    """They are traced once for all programs, but not where the code of a user's own has changed."""
    names = {"__name__": "cells_of_a_notebook", "wj": wj, "jnp": jnp, "System": System}
    exec(WITH_MASSES, names)
    walker, state = names["Laden"](slope=0.01), State(*jnp.array([0.2, 0.4, -0.2, -0.25]))

    @kernel
    def force(walker, state):  # by the equations of motion, and soon compiled
        return walker.contact_force(state)[1]

    found = []
    for names["HEAVIER"] in (1.0, 3.0, 1.0):
        found.append(float(force(walker, state)))
    assert found[0] == found[2] and abs(found[1] - found[0]) > 0.01


class Steps:
    def __init__(self, size):
        self.size = size

    def draw(self, key):
        return self.size * key


def test_functions_that_do_the_same_with_the_same_are_alike():
    make = lambda size, values: lambda key: size * np.sum(values) + key
    ones = np.ones(3)
    assert FunctionByCode(make(1.0, ones)) == FunctionByCode(make(1.0, np.ones(3)))
    assert hash(FunctionByCode(make(1.0, ones))) == hash(FunctionByCode(make(1.0, np.ones(3))))
    others = make(2.0, ones), make(1, ones), make(1.0, np.ones(4)), make(1.0, [1.0])
    others += tuple(make(1.0, one) for one in (ones[None], ones[:, None], ones.view(int)))
    for other in (*others, lambda key: key):
        assert FunctionByCode(make(1.0, ones)) != FunctionByCode(other)
    unhashable = wj.SimplestWalker(0.004)  # it says that it is equal to others
    assert FunctionByCode(make(1.0, unhashable)) == FunctionByCode(make(1.0, unhashable))
    drawing = jax.random.key(0)  # an array without values, which is itself alone
    assert FunctionByCode(make(1.0, drawing)) == FunctionByCode(make(1.0, drawing))
    assert FunctionByCode(make(1.0, drawing)) != FunctionByCode(make(1.0, jax.random.key(0)))
    bound = functools.partial(make(1.0, ones), key=2)
    assert FunctionByCode(bound) == FunctionByCode(functools.partial(make(1.0, ones), key=2))
    assert FunctionByCode(bound) != FunctionByCode(functools.partial(make(1.0, ones), key=3))
    by_name = lambda size: lambda key, *, by=size: by * key
    assert FunctionByCode(by_name(2)) == FunctionByCode(by_name(2)) != FunctionByCode(by_name(3))
    bound = lambda size: Steps(size).draw
    one = Steps(1.0)
    assert FunctionByCode(one.draw) == FunctionByCode(one.draw) != FunctionByCode(bound(2.0))
    assert FunctionByCode(jax.vmap(make(1.0, ones))) != FunctionByCode(jax.vmap(make(2.0, ones)))
    assert FunctionByCode(make(1.0, ones))(2.0) == 5
    assert (
        FunctionByCode(NormalSteps(1e-3))
        == FunctionByCode(NormalSteps(1e-3))
        != FunctionByCode(NormalSteps(2e-3))
    )


@pytest.mark.parametrize(
    "of",
    ["metric", *(pytest.param(one, marks=pytest.mark.slow) for one in ("ground", "indicator"))],
)
def test_functions_passed_in_are_what_they_are_at_that_moment(of):
    walker, gait, size = wj.SimplestWalker(0.009), wj.find_gait(wj.SimplestWalker(0.009)), 4e-4
    state = np.asarray(gait.states[0])

    def ground(key):
        return size * jax.random.normal(key, dtype=float)

    def metric(x, d):
        return size * jnp.sqrt(jnp.sum(d**2))

    def indicator(walker, start, end, time):
        return size * time

    def found():
        if of == "ground":
            key = jax.random.key(0)
            return wj.steps_to_fall(walker, ground, 50, key, gait=gait, limit=20).strides.sum()
        if of == "metric":
            of_size_one = metric_of(walker, None, None, metric).disturbance(state, np.eye(2))
            return (of_size_one**2).sum(axis=1) ** -0.5 / size
        return wj.gait_sensitivity(walker, gait, ["push"], [indicator]).norm / size

    first = found()
    size = 8e-4
    second = found()
    if of == "ground":
        assert second < first
    else:
        np.testing.assert_allclose(second, first, rtol=1e-12)
