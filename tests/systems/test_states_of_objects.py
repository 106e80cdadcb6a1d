"""Objects are identified by all that they hold, and not by the functions that they hold alone."""

import copyreg
import functools
import importlib
import os
import random
import subprocess
import sys
import weakref
from collections import OrderedDict, defaultdict, deque
from contextvars import ContextVar
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.fingerprints import code_fingerprint
from walker_jax.identity import Cache, FunctionByCode
from walker_jax.kernels.program_cache import ReachedCode, Unknown

INSTALLED = """
import functools


class Scaled:
    def __init__(self, func, scale):
        self.func, self.scale = func, scale
    def __call__(self, x):
        return self.scale * self.func(x)

class Slotted:
    __slots__ = ("func", "scale")
    def __init__(self, func, scale):
        self.func, self.scale = func, scale

def by_default(scale):
    return lambda x, size=scale: size * x

def shifted(down):
    return (lambda x: x - 1) if down else (lambda x: x + 1)

def doubled(f):
    @functools.wraps(f)
    def wrapper(x):
        return 2 * f(x)
    return wrapper

def halved(f):
    @functools.wraps(f)
    def wrapper(x):
        return f(x) / 2
    return wrapper
"""


def times(x, y=1.0):
    return x * y


def with_more(x):
    return 2 * x, 1.0


def custom(kind, nondiff):
    made = kind(times, nondiff_argnums=nondiff)
    if kind is jax.custom_jvp:
        made.defjvp(times)
    return made


class Tuned(property):
    scale = 1.0


def tuned(scale):
    made = Tuned(times)
    made.scale = scale
    return made


def with_attribute(scale):
    @functools.lru_cache
    def made(x):
        return x

    made.scale = scale  # pyright: ignore[reportAttributeAccessIssue] (as users may)
    return made


class Several(list):
    pass


class Named(tuple):
    scale: float


def named(scale):
    made = Named((1,))
    made.scale = scale
    return made


PAIRS = {
    "in_axes": lambda other: eqx.filter_vmap(times, in_axes=None if other else 0),
    "has_aux": lambda other: eqx.filter_value_and_grad(with_more, has_aux=other),
    "nondiff_argnums": lambda other: custom(jax.custom_jvp, (0,) if other else ()),
    "of vjp": lambda other: custom(jax.custom_vjp, (0,) if other else ()),
    "jitted": lambda other: jax.jit(times, static_argnums=0 if other else 1),
    "where jitted": lambda other: jax.jit(times, donate_argnums=0 if other else 1),
    "filter_jit": lambda other: eqx.filter_jit(times, donate="all" if other else "none"),
    "policy": lambda other: eqx.filter_checkpoint(times, policy=times if other else None),
    "partial": lambda other: functools.partial(times, y=2.0 if other else 3.0),
    "jax.vmap": lambda other: jax.vmap(times, in_axes=(0, None) if other else 0),
    "vectorize": lambda other: np.vectorize(times, excluded={0} if other else {1}),
    "forward or reverse": lambda other: (jax.jacrev if other else jax.jacfwd)(times),
    "getter": lambda other: property(with_more if other else times),
    "subclass of property": lambda other: tuned(2.0 if other else 3.0),
    "class method": lambda other: classmethod(with_more if other else times),
    "subclass of list": lambda other: Several([2.0 if other else 3.0]),
    "queue": lambda other: deque([2.0 if other else 3.0]),
    "subclass of tuple": lambda other: named(2.0 if other else 3.0),
    "cached": lambda other: with_attribute(2.0 if other else 3.0),
    "cached property": lambda other: functools.cached_property(with_more if other else times),
    "a table": lambda other: OrderedDict(least=2.0 if other else 3.0),
    "by default": lambda other: defaultdict(float, least=2.0 if other else 3.0),
    "a namespace": lambda other: SimpleNamespace(least=2.0 if other else 3.0),
    "a structure": lambda other: jax.tree.structure([0, 0] if other else (0, 0)),
    "a generator": lambda other: np.random.default_rng(1 if other else 2),
    "a key": lambda other: jax.random.wrap_key_data(jnp.array([0, other], jnp.uint32)),
    "weak": lambda other: weakref.ref(with_more if other else times),
    "compiled": lambda other: np.cos if other else np.sin,
    "a part": lambda other: {"a": other}.get,
}
IN_PROCESS_ITSELF = "a key", "jax.vmap", "forward or reverse"
"""An array without values, and functions that JAX makes anew."""


@pytest.mark.parametrize("of", PAIRS)
def test_an_object_is_all_that_it_holds(of):
    one, again, other = (PAIRS[of](which) for which in (False, False, True))
    by_code = [FunctionByCode(lambda value=value: value) for value in (one, again, other)]
    assert (by_code[0] == by_code[1]) == (of not in IN_PROCESS_ITSELF)
    assert by_code[0] != by_code[2]
    stored = [code_fingerprint(object, (value,)) for value in (one, again, other)]
    assert stored[0] == stored[1] != stored[2]


def fingerprints():
    return {of: code_fingerprint(object, (make(False),)) for of, make in PAIRS.items()}


def test_an_object_is_the_same_in_another_process():
    given = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    program = f"import {Path(__file__).stem} as here; print(here.fingerprints())"
    found = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **given, "PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
    )
    assert found.stdout.strip() == str(fingerprints()), found.stderr


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A module of an installed package."""
    (tmp_path / "scalings-1.0.dist-info").mkdir()
    (tmp_path / "scalings_of_others.py").write_text(INSTALLED)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("scalings_of_others")
    del sys.modules["scalings_of_others"]


def test_objects_of_installed_packages_are_all_that_they_hold(installed):
    of = lambda value: (FunctionByCode(value), code_fingerprint(object, (value,)))
    for kind in (installed.Scaled, installed.Slotted):
        one, again, other = (of(kind(times, scale)) for scale in (2.0, 2.0, 3.0))
        assert one == again and one[0] != other[0] and one[1] != other[1]
    pairs = [
        (installed.by_default(2.0), installed.by_default(3.0)),
        (installed.shifted(True), installed.shifted(False)),
        (installed.doubled(times), installed.halved(times)),
        (installed.doubled(times), installed.doubled(with_more)),
    ]
    for (one, stored), (other, stored_other) in (map(of, pair) for pair in pairs):
        assert one != other and stored != stored_other
    assert of(installed.by_default(2.0))[1] == of(installed.by_default(2.0))[1]


def test_functions_written_at_run_time_in_a_file_are_told_apart():
    def written(text):
        names: dict[str, Any] = {"__name__": __name__}
        exec(f"def f(x): return {text}", names)
        return code_fingerprint(object, (names["f"],))

    assert written("x + 1") == written("x + 1") != written("x + 2")


def test_a_program_is_traced_again_for_another_state():
    call = jax.jit(lambda function, x: function(x, x), static_argnums=0)
    x = jnp.arange(3.0)
    by_axes = [
        call(FunctionByCode(eqx.filter_vmap(jnp.multiply, in_axes=axes)), x)
        for axes in (0, (0, None))
    ]
    np.testing.assert_array_equal(by_axes[0], x * x)
    np.testing.assert_array_equal(by_axes[1], np.outer(x, x))
    sizes = SimpleNamespace(most=2.0), OrderedDict(most=2.0), ContextVar("most", default=2.0)
    reads = lambda a, b: a * sizes[0].most * sizes[1]["most"] * sizes[2].get()
    np.testing.assert_array_equal(call(FunctionByCode(reads), x), 8 * x)
    sizes[0].most = 3.0
    np.testing.assert_array_equal(call(FunctionByCode(reads), x), 12 * x)
    sizes[1]["most"] = 5.0
    np.testing.assert_array_equal(call(FunctionByCode(reads), x), 30 * x)
    token = sizes[2].set(7.0)
    np.testing.assert_array_equal(call(FunctionByCode(reads), x), 105 * x)
    sizes[2].reset(token)
    assert FunctionByCode(reads) == FunctionByCode(reads)


@pytest.mark.parametrize("kind", ["def f", "class A"])
def test_what_documents_code_does_not_count(kind):
    """A string that a function returns does."""
    head = f"{kind}():" if kind == "def f" else f"{kind}:"

    def made(words, then="pass"):
        names: dict = {"__name__": "made_up"}
        exec(f"{head}\n  '{words}'\n  {then}", names)
        return code_fingerprint(object, (names["f" if kind == "def f" else "A"],))

    assert made("one") == made("another")
    assert made("one", "f = lambda: 'one'") != made("one", "f = lambda: 'another'")
    if kind == "def f":
        assert made("one", "return 'one'") != made("one", "return 'another'")
        assert made("one", "return 'one'") != made("two", "return 'two'")  # one constant for both


def test_tables_of_the_package_count_and_caches_do_not():
    def reading(value):
        code = compile("def f(): return table", "<made>", "exec").co_consts[0]
        names = {"__name__": "walker_jax.made_up", "table": value}
        return ReachedCode().describe(FunctionType(code, names))

    assert reading(OrderedDict(a=1)) == reading(OrderedDict(a=1)) != reading(OrderedDict(a=2))
    assert reading(Cache(a=1)) == reading(Cache(a=2))
    assert reading(ContextVar("a")) == reading(ContextVar("b"))
    assert reading(eqx.filter_vmap(jnp.sin)) != reading(eqx.filter_vmap(jnp.sin, in_axes=None))
    assert reading(Path("here")) == reading(Path("there"))  # where files are on a machine
    with pytest.raises(Unknown):
        reading(HoldsNothing())


def test_draws_of_random_numbers_change_no_other_code():
    """As of beartype, whose functions hold `random.getrandbits`."""
    of = lambda: (FunctionByCode(random.random), code_fingerprint(object, (random.random,)))
    before = of()
    random.random()
    assert of() == before
    mine = random.Random(1).random
    drawn = FunctionByCode(mine)
    mine()
    assert FunctionByCode(mine) != drawn


class HoldsNothing:
    def __reduce_ex__(self, protocol):
        raise TypeError("not to be pickled")


def test_errors_within_a_closure_are_no_empty_cell():
    class Loud:
        def __repr__(self):
            raise ValueError("no words")

    held = {Loud(), 1}
    with pytest.raises(ValueError, match="no words"):
        FunctionByCode(lambda: held)


def test_a_class_is_the_same_after_its_objects_were_pickled():
    class Own:
        __slots__ = ("scale",)

    before = code_fingerprint(Own), FunctionByCode(Own)
    copyreg._slotnames(Own)  # pyright: ignore[reportAttributeAccessIssue] # as pickle does
    assert "__slotnames__" in vars(Own)
    assert (code_fingerprint(Own), FunctionByCode(Own)) == before
