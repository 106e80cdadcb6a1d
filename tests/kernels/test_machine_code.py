"""Code that is made quickly at first: its bits, when it is optimised, and what is kept on disk."""

import math
import threading
from collections import Counter

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel, machine, machine_code, object_cache
from walker_jax.kernels.compiled import Compiled, source_of
from walker_jax.kernels.machine_code import MANY_CELLS, MachineCode
from walker_jax.walking.stride import follow_stride

TRIPLE = llvm.get_process_triple()
needs_x86 = pytest.mark.skipif(
    not machine.allows_quick_code(), reason="code is optimised from the start here"
)


@pytest.fixture
def all_are_long(monkeypatch):
    """Every program counts as long, and none has worked long enough to be optimised."""
    monkeypatch.setattr(machine_code, "LONG_SOURCE", (0, 10**9))
    monkeypatch.setattr(machine_code, "TRIAL_SECONDS", math.inf)


@pytest.fixture
def compilations(monkeypatch):
    """The levels at which programs are compiled."""
    levels, compile = [], machine.object_code

    def recorded(source, target):
        levels.append(machine.QUICK if target in quick else machine.OPTIMISED)
        return compile(source, target)

    quick, make = [], machine.target_machine

    def made(name, features, level=machine.OPTIMISED):
        found = make(name, features, level)
        quick.extend([found] if level == machine.QUICK else [])
        return found

    monkeypatch.setattr(machine, "object_code", recorded)
    monkeypatch.setattr(machine, "target_machine", made)
    return levels


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path))
    return tmp_path / "kernels"


def polynomial(x):
    return sum((x - 0.1 * k) * jnp.sqrt(x + k) for k in range(1, 9))


def compile_polynomial():
    return Compiled(jax.make_jaxpr(polynomial)(1.0))


def evaluate(compiled, n=100):
    run, results = compiled.bind([np.linspace(0, 1, n)], [True], n)
    run(0, n)
    return results[0].tobytes()


@needs_x86
def test_few_cells_take_quick_code_and_many_take_optimised(folder, all_are_long, compilations):
    code = compile_polynomial()
    few = evaluate(code)
    assert compilations == [machine.QUICK] and code.code.source is not None
    assert evaluate(code, MANY_CELLS + 1)[:8] == few[:8]
    assert compilations == [machine.QUICK, machine.OPTIMISED] and code.code.source is None
    assert evaluate(code) == few and len(compilations) == 2


@needs_x86
def test_quick_code_is_optimised_after_a_trial(folder, all_are_long, compilations, monkeypatch):
    """Within one call, too, whose cells may take long."""
    monkeypatch.setattr(machine_code, "TRIAL_SECONDS", -1.0)
    code, n = compile_polynomial(), 1000
    found = evaluate(code, n)
    assert compilations == [machine.QUICK, machine.OPTIMISED] and code.code.source is None
    assert evaluate(code, n) == found


@needs_x86
def test_many_threads_optimise_once(folder, all_are_long, compilations, monkeypatch):
    monkeypatch.setattr(machine_code, "TRIAL_SECONDS", -1.0)
    code, n = compile_polynomial(), 10_000
    run, results = code.bind([np.linspace(0, 1, n)], [True], n)
    pieces = [(i * n // 8, (i + 1) * n // 8) for i in range(8)]
    threads = [threading.Thread(target=run, args=piece) for piece in pieces]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert compilations == [machine.QUICK, machine.OPTIMISED]
    assert results[0].tobytes() == evaluate(code, n)


@needs_x86
def test_another_process_goes_on_with_what_is_on_disk(folder, all_are_long, compilations):
    """With the quick code and the source, then with the optimised code."""
    first = compile_polynomial()
    found = evaluate(first)
    second = MachineCode.recall(first.digest)
    assert second is not None and compilations == [machine.QUICK]
    assert len(list(folder.iterdir())) == 2
    first.code = second
    assert evaluate(first) == found and compilations == [machine.QUICK]
    second.optimise()
    assert compilations == [machine.QUICK, machine.OPTIMISED]
    third = MachineCode.recall(first.digest)
    assert third is not None and third.source is None
    first.code = third
    assert evaluate(first) == found and len(compilations) == 2


@needs_x86
def test_code_that_nobody_counts_is_optimised(folder, all_are_long):
    """Calls by XLA, after a call of few cells too."""
    cell, x = kernel(polynomial), jnp.float64(0.25)
    few = cell(x)
    code = cell.find_program((x,), {})[0].compiled.code
    assert code.source is not None
    assert jax.jit(cell)(x) == few == pytest.approx(float(polynomial(0.25)), rel=1e-14)
    assert code.source is None and len(code.engines) == 2


def test_what_is_optimised_at_once(folder, compilations, monkeypatch):
    evaluate(compile_polynomial())
    assert compilations == [machine.OPTIMISED]
    source = "; {}\ndefine void @kernel() {{ ret void }}"
    for number, bounds, allowed in ((1, (0, 10), True), (2, (0, 10**9), False)):
        monkeypatch.setattr(machine_code, "LONG_SOURCE", bounds)
        monkeypatch.setattr(machine_code, "allows_quick_code", lambda allowed=allowed: allowed)
        text = source.format(number)
        code = MachineCode(text, machine.hash_source(text))
        code.expect(1)
        assert code.source is None
    assert compilations == 3 * [machine.OPTIMISED]


@pytest.mark.parametrize(
    "module, name, value, allowed",
    [
        (machine.llvm, "get_process_triple", "aarch64-unknown-linux-gnu", False),
        (machine.sys, "platform", "win32", False),
        (machine.platform, "libc_ver", ("musl", "1"), False),
        (machine.threading, "stack_size", 2**19, False),
        (machine.threading, "stack_size", 2**24, None),
    ],
)
def test_where_quick_code_may_run(monkeypatch, module, name, value, allowed):
    """Where both levels compute the same bits, and threads have room for it."""
    here = machine.allows_quick_code.__wrapped__()
    monkeypatch.setattr(module, name, value if name == "platform" else lambda: value)
    assert machine.allows_quick_code.__wrapped__() is (here if allowed is None else allowed)


WALKERS = {
    "simplest": wj.SimplestWalker(0.009),
    "spring": wj.SpringWalker(0.009, 0.3),
    "point feet": wj.PointFootWalker(0.009),
}


def change_of_stride(walker, x, direction):
    stride = lambda x: follow_stride(walker, x, Integrator(1e-12)).state
    return jax.jvp(stride, (x,), (direction,))


@needs_x86
@pytest.mark.parametrize(
    "name", ["simplest", *(pytest.param(one, marks=pytest.mark.slow) for one in [*WALKERS][1:])]
)
def test_both_levels_compute_the_same_bits(folder, all_are_long, name):
    """Strides with their derivatives, from starts that walk and from starts that fall."""
    walker, n = WALKERS[name], 300
    rng, size = np.random.default_rng(0), len(walker.section)
    cells = rng.uniform(-0.5, 0.5, (n, size)), rng.standard_normal((n, size))
    cell = lambda x, direction: change_of_stride(walker, x, direction)
    code = Compiled(jax.make_jaxpr(cell)(*(x[0] for x in cells)))
    found = []
    for _ in range(2):
        run, results = code.bind(cells, [True, True], n)
        run(0, n)
        found.append([x.tobytes() for x in results])
        assert np.isfinite(results[0]).any() and len(code.code.engines) == len(found)
        code.code.optimise()
    assert found[0] == found[1]


@needs_x86
@pytest.mark.parametrize(
    "name",
    ["haswell", *(pytest.param(n, marks=pytest.mark.slow) for n in ("x86-64", "skylake-avx512"))],
)
def test_both_levels_fuse_the_same_products_with_sums(name):
    """On processors without fused operations, with them, and with long vectors.

    The stride is the function itself: once a kernel's unused equations are dropped, the optimiser
    finds whole blocks that compute alike.
    """
    integrator = Integrator(1e-12)
    stride = lambda x: follow_stride.__wrapped__(WALKERS["simplest"], x, integrator).state
    closed = jax.make_jaxpr(lambda x: jax.jvp(stride, (x,), (x,)))(np.zeros(2))
    *_, source, _ = source_of(closed, machine.bits_of(name, ""))
    counts = []
    for level in (machine.QUICK, machine.OPTIMISED):
        target = machine.target_machine(name, "", level)
        names = [
            line.split()[0]
            for line in target.emit_assembly(llvm.parse_assembly(source)).splitlines()
            if line.strip()
        ]
        fused = sum(one.startswith(("vfm", "vfnm")) for one in names)
        counts.append((fused, Counter(one for one in names if one in ARITHMETIC)))
    assert counts[0][0] == counts[1][0]
    # The optimiser drops the few that two blocks compute alike, and sums that nothing needs.
    for name_of_one, quick in counts[0][1].items():
        least = 0.6 if name_of_one.endswith("addpd") else 0.99
        assert least * quick <= counts[1][1][name_of_one] <= quick
    assert sum(counts[0][1].values()) > 1000 and (counts[0][0] > 1000) == (name != "x86-64")


ARITHMETIC = "mulpd", "vmulpd", "addpd", "vaddpd", "divpd", "vdivpd", "sqrtpd", "vsqrtpd"
