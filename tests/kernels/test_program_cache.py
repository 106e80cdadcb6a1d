"""What tracing led to is found on disk by all that it depends on, and by nothing less."""

import functools
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.identity import Cache, Description
from walker_jax.integrators import integrator, roots, taylor
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.taylor_steps import Taylor
from walker_jax.kernels import object_cache, program, program_cache
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking import stride, trajectories

START, BOUNCE = np.array([0.2, -0.2]), np.array([0.7, 2.3])


@pytest.fixture(autouse=True)
def programs(monkeypatch):
    """None in memory, and those of other tests afterwards."""
    monkeypatch.setattr(program, "programs", Cache())


@pytest.fixture
def traces(monkeypatch):
    """What is traced."""
    made, trace = [], jax.make_jaxpr
    counted = lambda function, **options: made.append(function) or trace(function, **options)
    monkeypatch.setattr(jax, "make_jaxpr", counted)  # the package's own code would have other names
    return made


def end_of_stride(x):
    return wj.stride(SimplestWalker(0.004), x).state


def end_of_flight(x):
    return wj.stride(wj.systems.BouncingBall(0.4, 0.8), x).state


def as_of_another_process(function=end_of_flight, x=BOUNCE):
    """The result in another process, which has no program in memory."""
    program.programs.clear()
    return np.asarray(function(jnp.asarray(x)))


def name_of(walker=None, dtype=float, function=stride.follow_stride, solver=None):
    arguments = (
        walker or SimplestWalker(0.004),
        jnp.asarray(START, dtype),
        Integrator(1e-12, solver),
    )
    leaves, structure = jax.tree.flatten(arguments)
    avals = [jax.typeof(jnp.asarray(leaf, dtype)) for leaf in leaves]
    function = getattr(function, "of_one_cell", function)
    return program_cache.trace_name(function, structure, avals, program.current_settings())


def test_another_process_need_not_trace(folder, traces):
    jacobian, count = jax.jacfwd(end_of_flight), 0
    for function in (end_of_flight, jacobian):
        # A derivative that is not on disk takes the trace of the stride, which is made then.
        first = as_of_another_process(function)
        assert np.isfinite(first).all() and len(traces) > count
        count = len(traces)
        assert as_of_another_process(function).tobytes() == first.tobytes()
        assert len(traces) == count


def test_names_are_the_same_in_every_process():
    """Whatever has been loaded, and whatever order its sets have."""
    program = """
import jax
jax.config.update("jax_enable_x64", True)
{}
from test_program_cache import name_of
print(name_of())
"""
    given = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", program.format(first)],
            env=given | {"PYTHONHASHSEED": seed},
            stdout=subprocess.PIPE,
        )
        for seed, first in (("1", ""), ("2", "import walker_jax.cli.app"))
    ]
    one, other = (run.communicate()[0].split() for run in runs)
    assert one == other and len(one) == 1


@pytest.mark.parametrize(
    "damage", [b"", b"{}", b"[]", b'{"tree": ["os:system", 0]}', b'{"tree": 1}', b"\xff"]
)
def test_a_broken_or_foreign_entry_is_traced_anew(folder, traces, damage):
    name = "a" * 64
    object_cache.store(name, damage)
    assert program_cache.recall_trace(name) is None


def test_code_that_is_gone_is_traced_and_compiled_anew(folder, traces):
    expected = as_of_another_process()
    for path in folder.iterdir():
        content = path.read_bytes()[object_cache.CHECKSUM_BYTES :]
        if not content.startswith(b"{"):
            path.unlink()
    count = len(traces)
    found = as_of_another_process()
    assert len(traces) > count and found.tobytes() == expected.tobytes()


def test_what_is_replaced_at_run_time_is_traced(folder, traces, monkeypatch):
    by_walker = end_of_stride, START
    first = as_of_another_process(*by_walker)
    impact = SimplestWalker.impact
    heavier = lambda self, state: jax.tree.map(lambda value: 0.9 * value, impact(self, state))
    with monkeypatch.context() as patch:
        patch.setattr(SimplestWalker, "impact", heavier)
        changed = as_of_another_process(*by_walker)
    assert abs(changed - first).max() > 1e-3
    again = as_of_another_process(*by_walker)
    assert again.tobytes() == first.tobytes()


def test_a_name_stands_for_all_that_a_trace_depends_on(monkeypatch):
    names = [
        name_of(),
        name_of(dtype=jnp.float32),
        name_of(wj.SpringWalker(0.004, 1.0)),
        name_of(wj.KneedWalker(0.05)),
        name_of(wj.KneedWalker(0.05, check_lock=True)),
        name_of(function=trajectories.follow_phase_times),
        name_of(solver=diffrax.Bosh3()),
        name_of(solver=diffrax.Tsit5()),
        name_of(solver=diffrax.Tsit5(scan_kind="lax")),
        name_of(solver=Taylor(10)),
    ]
    with jax.numpy_dtype_promotion("standard"):
        names.append(name_of())
    plain: Any = roots.differentiable_zero
    replaced = functools.wraps(plain)(lambda *args: plain(*args))
    changes = [
        (integrator, "MOST_EXPANDED_AGAIN", 1),
        (program_cache, "register_bits", lambda: 64),
        (roots, "differentiable_zero", replaced),
        (roots, "differentiable_zero", roots.first_zero),
        (taylor, "expand_solution", eqx.filter_custom_jvp(lambda *args: args)),
        (taylor, "grow_series", lambda *args: args),
        (wj.Walker, "contact_force", lambda self, state: (0.0, 0.0)),
        (SimplestWalker, "vector_field", lambda self, state: state),
        (program_cache, "environment", lambda: ("another version",)),
    ]
    for place, attribute, value in changes:
        with monkeypatch.context() as patch:
            patch.setattr(place, attribute, value)
            names.append(name_of())
    assert len({*names}) == len(names) and None not in names
    assert name_of() == names[0]


def test_what_is_defined_elsewhere_has_no_name():
    class SimplestWalker(wj.SimplestWalker):
        pass

    class Mine(diffrax.Dopri8):
        pass

    assert name_of(SimplestWalker(0.004)) is None
    # The package makes classes with feedback as they are asked for, and several have one name.
    fed = wj.Feedback(wj.SpringWalker(0.004, 1.0), START, {"hip_stiffness": [0.1, 0.2]})
    assert name_of(fed) is None
    alike = type(
        "SimplestWalker", (wj.SimplestWalker,), {"__module__": wj.SimplestWalker.__module__}
    )
    assert name_of(alike(0.004)) is None
    assert name_of(function=lambda walker, x, tolerance: x) is None
    assert name_of(solver=Mine()) is None


@pytest.mark.slow
def test_each_solver_has_a_program_of_its_own():
    one, other = diffrax.Bosh3(), diffrax.Tsit5()
    by = [wj.stride(SimplestWalker(0.004), START, solver=solver) for solver in (None, one, other)]
    count = len(program.programs)
    again = wj.stride(SimplestWalker(0.004), START, solver=diffrax.Bosh3())
    assert len(program.programs) == count
    states = {np.asarray(found.state).tobytes() for found in by}
    assert len(states) == 3 and np.asarray(again.state).tobytes() in states


def test_results_of_other_classes_are_not_kept(folder):
    avals = [jax.typeof(jnp.zeros(2))]
    traced = program_cache.Traced(avals, avals, jax.tree.structure({1: 0}), 1, "digest")
    for results in ({1: 0}, SimplestWalker(0.004)):
        program_cache.keep_trace("b" * 64, traced._replace(tree=jax.tree.structure(results)))
        assert not folder.exists()
    like: Any = (0, ({"b": [1, None], "a": 2}, 2), ())
    kept = traced._replace(tree=jax.tree.structure(wj.Stride(*like)))
    program_cache.keep_trace("b" * 64, kept)
    assert program_cache.recall_trace("b" * 64) == kept
    content = json.loads(object_cache.recall("b" * 64) or b"")
    inner = ["builtins:list", [], 0, ["builtins:NoneType", []]]
    pair = ["builtins:tuple", [], ["builtins:dict", ["a", "b"], 0, inner], 0]
    stride = ["walker_jax.systems.outcomes:Stride", [], 0, pair, ["builtins:tuple", []]]
    assert content["tree"] == stride


def test_wrong_use_is_still_refused(folder):
    as_of_another_process()
    with pytest.raises(WrongUse, match="x must have shape"):
        as_of_another_process(x=np.zeros(7))


def test_descriptions_of_user_code_are_hashed_once_and_shared():
    """JAX hashes the context of a trace, and compares it, at each operation."""
    asked = []

    class Part(str):
        def __hash__(self):
            asked.append(self)
            return super().__hash__()

    described = Description((Part("code"),))
    assert hash(described) == hash(described) == hash(("code",)) and len(asked) == 1
    kept = Description(("code",))
    assert hash(kept) and not vars(pickle.loads(pickle.dumps(kept)))
    make = lambda: lambda x: 2 * x
    one, other = (program_cache.user_code_states(make(), jax.tree.structure(1.0)) for _ in range(2))
    assert one is other and len(one) > 1
