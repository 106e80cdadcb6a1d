"""Kernels within kernels, which call the machine code of one another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.experimental.jet import jet

from walker_jax.kernels import machine_code, program, shared_code
from walker_jax.kernels.decorator import kernel
from walker_jax.kernels.machine import code_name
from walker_jax.kernels.machine_code import MachineCode

STARTS = np.linspace(0.1, 3.0, 21)


def root(x, n):
    """Return the square root by Newton's iteration, and whether it took more than n turns."""
    going = lambda known: jnp.abs(known[0] ** 2 - x) > 1e-12 * x
    turn = lambda known: ((known[0] + x / known[0]) / 2, known[1] + 1)
    found, turns = lax.while_loop(going, turn, (x, jnp.zeros_like(n)))
    return found, turns > n


def build():
    """Return a new kernel, and one that calls it as often as each cell needs."""
    inner = kernel(lambda x, n: root(x, n))

    def repeat(x, n):
        def turn(known):
            root, long = inner(known[0], n)
            return root, known[1] + long.astype(n.dtype)

        return lax.while_loop(lambda known: jnp.abs(known[0] - 1) > 1e-3, turn, (x, 0 * n))

    return inner, kernel(repeat)


def program_in(function, *args):
    return function.find_program(args, {})[0]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", str(tmp_path))
    machine_code.recall_callee.cache_clear()
    monkeypatch.setattr(program, "MIN_SHARED", 1)
    return tmp_path


@pytest.fixture
def sources(monkeypatch):
    """The sources that LLVM compiles."""
    found, load = [], machine_code.load_program
    counted = lambda source, *level: found.append(source) or load(source, *level)
    monkeypatch.setattr(machine_code, "load_program", counted)
    return found


def power(x):
    """A loop that changes what active lanes alone compute."""
    return lax.scan(lambda y, _: (0.99 * y + 0.01, None), x, None, length=100)[0]


@pytest.mark.parametrize("inner", [kernel(power), jax.jit(power)], ids=["kernel", "function"])
def test_what_some_lanes_compute_is_not_used_by_others(inner):
    """In a branch so short that no jump skips it; the same call follows for all lanes."""
    both = kernel(lambda x: (lax.cond(x > 1, inner, lambda x: 0 * x, x), inner(x)))
    some, every = jax.vmap(both)(STARTS)
    expected = 1 + 0.99**100 * (STARTS - 1)
    np.testing.assert_allclose(every, expected, rtol=1e-12)
    np.testing.assert_allclose(some, np.where(STARTS > 1, expected, 0), rtol=1e-12)


def test_only_active_lanes_compute(sources):
    """A loop that would not end in the others."""
    n = jnp.int32(4)
    inner, _ = build()
    ahead = kernel(lambda x, n: lax.cond(x > 1, lambda x: inner(x, n)[0], lambda x: 0 * x, x))
    found = jax.vmap(ahead, (0, None))(STARTS, n)
    np.testing.assert_allclose(found, np.where(STARTS > 1, STARTS**0.5, 0), rtol=1e-12)
    lines = sources[0].splitlines()
    of_own, of_other = (line for line in lines if "call {" in line)
    assert '@"cell"' in of_own and "<i1 1, i1 1" in of_own
    assert '@"cell"' not in of_other and "<i1 1, i1 1" not in of_other


def test_code_is_made_once_and_computes_the_same_bits(sources, monkeypatch):
    n = jnp.int32(4)
    inner, outer = build()
    alone = jax.vmap(inner, (0, None))(STARTS, n)
    found = jax.vmap(outer, (0, None))(STARTS, n)
    inner_code = program_in(inner, 1.0, n).compiled.code
    assert [f"slot_{inner_code.digest}" in source for source in sources] == [False, True]
    assert "fdiv" in sources[0] and "fdiv" not in sources[1]
    assert program_in(outer, 1.0, n).compiled.code.callees == [inner_code]

    monkeypatch.setattr(program, "MIN_SHARED", 10**6)
    inner, outer = build()
    assert all(map(np.array_equal, jax.vmap(inner, (0, None))(STARTS, n), alone))
    expected = jax.vmap(outer, (0, None))(STARTS, n)
    assert "slot" not in sources[3] and "fdiv" in sources[3]
    assert all(map(np.array_equal, found, expected))
    roots = STARTS ** (0.5 ** np.arange(14))[:, None]
    ends = [column[abs(column - 1) < 1e-3][0] for column in roots.T]
    np.testing.assert_allclose(found[0], ends, rtol=1e-12)
    assert len(set(found[1].tolist())) > 1


def test_known_numbers_are_put_into_the_code(sources):
    """A square root in two turns, which are not a loop any more."""
    power = kernel(lambda x, n: lax.fori_loop(0, n, lambda _, y: y * x, x))
    cube = kernel(lambda x: power(x, jnp.int32(2)))
    assert cube(jnp.float64(3)) == 27
    assert "slot" not in sources[0] and "phi double" not in sources[0]


def test_transformations_take_the_function():
    n, x = jnp.int32(4), jnp.float64(0.3)
    inner, _ = build()
    twice = kernel(lambda x: inner(inner(x, n)[0], n)[0])
    assert float(jax.grad(twice)(x)) == pytest.approx(0.25 * 0.3**-0.75, rel=1e-9)
    each = kernel(lambda x: jnp.sum(jax.vmap(lambda x: inner(x, n)[0])(x)))
    np.testing.assert_allclose(each(STARTS[:5]), np.sum(STARTS[:5] ** 0.5), rtol=1e-12)
    rate = kernel(lambda x: jax.jvp(lambda x: inner(x, n)[0], (x,), (jnp.ones_like(x),)))
    np.testing.assert_allclose(rate(x), (0.3**0.5, 0.5 * 0.3**-0.5), rtol=1e-9)
    by_xla = jax.jit(program_in(twice, x).function)
    assert shared_code.SHARED_CALL in str(jax.make_jaxpr(program_in(twice, x).function)(x))
    np.testing.assert_allclose(by_xla(x), [0.3**0.25], rtol=1e-12)
    curve = kernel(lambda x: jet(lambda x: inner(x, n)[0], (x,), ([jnp.ones_like(x), 0 * x],)))
    value, terms = curve(x)
    slopes = 0.5 * 0.3**-0.5, -0.25 * 0.3**-1.5
    np.testing.assert_allclose([value, *terms], [0.3**0.5, *slopes], rtol=1e-9)


def test_another_process_finds_the_code_that_it_calls(folder):
    n = jnp.int32(4)
    _, outer = build()
    expected = jax.vmap(outer, (0, None))(STARTS, n)
    compiled = program_in(outer, 1.0, n).compiled
    first, called = compiled.code, compiled.code.callees[0]
    machine_code.recall_callee.cache_clear()
    recalled = MachineCode.recall(first.digest)
    assert recalled is not None
    compiled.code, (again,) = recalled, recalled.callees
    assert again is not called and again.digest == called.digest
    run, results = compiled.bind([STARTS, 4], [True, False], len(STARTS))
    run(0, len(STARTS))
    assert all(map(np.array_equal, results, expected))

    machine_code.recall_callee.cache_clear()
    (folder / "kernels" / f"{code_name(called.digest)}.kernel").unlink()
    assert MachineCode.recall(first.digest) is None


def test_code_is_made_quickly_at_first(sources, monkeypatch):
    """Of both kernels; then the work that is left counts that of both, and both are optimised."""
    if not machine_code.allows_quick_code():
        pytest.skip("code that is not optimised computes other bits here")
    monkeypatch.setattr(machine_code, "LONG_SOURCE", (0, 10**9))
    n = jnp.int32(4)
    _, outer = build()
    few = jax.vmap(outer, (0, None))(STARTS[:2], n)
    code = program_in(outer, 1.0, n).compiled.code
    (callee,) = code.callees
    assert len(sources) == 2 and code.source in sources and callee.source in sources
    assert code.work == len(code.source) + len(callee.source)
    code.optimise()
    assert len(sources) == 4 and code.source is None and callee.source is None
    assert all(map(np.array_equal, jax.vmap(outer, (0, None))(STARTS[:2], n), few))


def test_what_cannot_be_called_is_included(sources):
    """Of other lanes, of many numbers, and derivatives."""
    single = kernel(lambda x: power(x))
    mixed = kernel(lambda x: x + single(x.astype(np.float32)).astype(x.dtype))
    assert mixed(jnp.float64(3)) == pytest.approx(3 + 1 + 2 * 0.99**100, rel=1e-6)
    wide = kernel(lambda x: power(x))
    many = kernel(lambda x: wide(x * jnp.ones(60)))
    np.testing.assert_allclose(many(jnp.float64(3)), np.full(60, 1 + 2 * 0.99**100), rtol=1e-12)
    assert not any("slot" in source for source in sources)


def test_equal_code_of_one_that_is_gone_is_in_use(monkeypatch):
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", "")
    inner, other = (kernel(lambda x: power(x)) for _ in range(2))
    for one in (inner, other):
        assert program_in(one, 1.0).compiled is not None
    program.programs.clear()
    del other
    outer = kernel(lambda x: inner(x * x) + 1)
    assert outer(jnp.float64(2)) == pytest.approx(2 + 3 * 0.99**100, rel=1e-12)
