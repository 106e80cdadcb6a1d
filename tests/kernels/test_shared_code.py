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
    monkeypatch.setattr(machine_code, "codes", type(machine_code.codes)())
    monkeypatch.setattr(program, "MIN_SHARED", 1)
    return tmp_path


@pytest.fixture
def sources(monkeypatch):
    """The sources that LLVM compiles."""
    found, load = [], machine_code.load_program
    counted = lambda source, *level: found.append(source) or load(source, *level)
    monkeypatch.setattr(machine_code, "load_program", counted)
    return found


def test_code_is_made_once_and_computes_the_same_bits(sources, monkeypatch):
    n = jnp.int32(4)
    inner, outer = build()
    alone = jax.vmap(inner, (0, None))(STARTS, n)
    found = jax.vmap(outer, (0, None))(STARTS, n)
    inner_code = program_in(inner, 1.0, n).compiled.code
    assert [f"slot_{inner_code.digest}" in source for source in sources] == [False, True]
    assert "fdiv" in sources[0] and "fdiv" not in sources[1]
    assert program_in(outer, 1.0, n).compiled.code.called == [inner_code]

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
    first, called = compiled.code, compiled.code.called[0]
    machine_code.codes.clear()
    recalled = MachineCode.recall(first.digest)
    assert recalled is not None
    compiled.code, (again,) = recalled, recalled.called
    assert again is not called and again.digest == called.digest
    run, results = compiled.bind([STARTS, 4], [True, False], len(STARTS))
    run(0, len(STARTS))
    assert all(map(np.array_equal, results, expected))

    machine_code.codes.clear()
    (folder / "kernels" / f"{code_name(called.digest)}.kernel").unlink()
    assert MachineCode.recall(first.digest) is None
