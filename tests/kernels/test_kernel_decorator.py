"""Functions of a user's own as kernels: their arguments, and why they have no kernel."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import lineax
import numpy as np
import optimistix
import pytest
from jax import lax

import walker_jax as wj
from walker_jax.checks import NoKernelWarning, WrongUse, warn_once
from walker_jax.identity import Cache
from walker_jax.kernels import kernel, machine, machine_code, program, why_not


def powers(x, terms, *, scale=1.0, start=0):
    """A sum of powers, of which one argument is static and two have defaults."""
    return {"sum": sum(scale * x**k for k in range(start, terms)), "given": (x, scale)}


of_terms = partial(kernel, static_argnames=("terms", "start"))(powers)
CALLS = {
    "by position": lambda f: f(2.0, 3),
    "by name": lambda f: f(terms=3, x=2.0),
    "another default": lambda f: f(2.0, 3, scale=0.5),
    "two static": lambda f: f(2.0, 4, start=2),
    "no terms": lambda f: f(2.0, 0),
    "vmap": lambda f: jax.vmap(lambda x, s: f(x, 3, scale=s))(jnp.arange(5.0), jnp.ones(5)),
    "jit": lambda f: jax.jit(lambda x: f(x, 3, scale=x))(2.0),
    "jvp": lambda f: jax.jvp(lambda x, s: f(x, 3, scale=s), (2.0, 3.0), (1.0, 0.5)),
    "grad": lambda f: jax.grad(lambda s: f(2.0, 3, scale=s)["sum"])(3.0),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_kernel_is_called_as_its_function_is(name):
    found, expected = CALLS[name](of_terms), CALLS[name](powers)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15)


def test_a_static_value_of_another_type_is_another_value():
    typed = kernel(lambda x, like: x * (2 if isinstance(like, bool) else 3), static_argnames="like")
    assert [float(typed(1.0, like)) for like in (1, True, 1.0)] == [3, 2, 3]


def test_a_function_keeps_its_name_and_its_words():
    assert of_terms.__name__ == "powers" and of_terms.__doc__ == powers.__doc__


def test_methods_are_kernels_too():
    class Line(eqx.Module):
        slope: float
        shift: int = eqx.field(static=True, default=1)

        @kernel
        def at(self, x, *, power=1):
            return self.slope * x**power + self.shift

    assert Line(2.0).at(3.0) == 7 and Line(2.0, 5).at(3.0, power=2) == 23
    assert jax.grad(lambda line: line.at(3.0))(Line(2.0)).slope == 3


FACTOR = 2.0


def test_names_that_a_function_reads_are_looked_at_at_a_call(monkeypatch):
    scaled = kernel(lambda x, *, power=1: FACTOR * x**power)
    assert scaled(3.0) == 6 and scaled(3.0, power=2) == 18
    monkeypatch.setitem(globals(), "FACTOR", 5.0)
    assert scaled(3.0) == 15 and scaled(3.0, power=2) == 45


WRONG = {
    "traced": (
        lambda: jax.jit(of_terms)(2.0, 3),
        "terms is static and must be hashable, not JitTracer",
    ),
    "by name": (
        lambda: kernel(powers)(2.0, 3, scale={"a": "much"}),
        "scale must hold arrays and numbers alone, not 'much': name it in static_argnames",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_use_names_the_argument(name):
    call, message = WRONG[name]
    with pytest.raises(WrongUse) as error:
        call()
    assert str(error.value).startswith(message)


def test_missing_or_too_many_arguments_are_told_as_usual():
    for wrong in (lambda f: f(2.0, terms=3, twice=4), lambda f: f(x=2.0)):
        with pytest.raises(TypeError, match="argument"):
            wrong(of_terms)


def middle(x):
    return jnp.sort(x)[1]


REASONS = {
    "sorting": (middle, (jnp.ones(3),), "sort, in line {} of test_kernel_decorator.py"),
    "an array that is indexed": (
        lambda x, i: x[i],
        (jnp.ones(500), 3),
        "computed indices of an array of 500, in line {} of test_kernel_decorator.py",
    ),
    "many numbers": (lambda x: x, (jnp.ones(501),), "more than 1000 numbers"),
    "types": (lambda x: x, (jnp.ones(2, jnp.float16),), "float16"),
    "types within": (
        lambda x: x.astype(jnp.bfloat16).astype(float),
        (1.0,),
        "bfloat16, in line {} of test_kernel_decorator.py",
    ),
    "complex arguments": (lambda x: abs(x), (1j,), "complex numbers"),
    "complex results": (lambda x: x * 1j, (1.0,), "complex numbers"),
    "keys": (jax.random.normal, (jax.random.key(0),), "a key to random numbers"),
}


@pytest.mark.parametrize("name", REASONS)
def test_why_a_function_has_no_kernel(name):
    function, args, reason = REASONS[name]
    line = getattr(function, "__code__", middle.__code__).co_firstlineno + (function is middle)
    expected = f"kernels do not support {reason.format(line)}"
    assert why_not(function, *args) == why_not(kernel(function), *args) == expected


def test_why_not_of_a_kernel_and_its_derivative():
    assert why_not(of_terms, 2.0, 3) is why_not(of_terms, 2.0, terms=3, scale=0.5) is None
    assert why_not(jax.grad(jnp.sin), 2.0) is None
    assert why_not(lambda x: middle(x) + of_terms(x[0], 3)["sum"], jnp.ones(3)) is not None


def test_why_not_of_functions_that_cannot_be_traced():
    """Wrong arguments alone raise."""
    loop = lambda x: lax.while_loop(lambda y: y < 3, lambda y: 1.5 * y, x)
    assert why_not(loop, 1.0) is why_not(jax.grad(kernel(loop)), 1.0) is None
    fly = lambda x: wj.stride(wj.systems.BouncingBall(0.4, 0.8), x).state
    x = jnp.array([0.7, 2.3])
    outside = ": a derivative of kernel(f) has a kernel of its own, outside any other kernel"
    for function, given, error, ends in (
        (jax.grad(loop), 1.0, "ValueError: Reverse-mode differentiation does not work", outside),
        (jax.jacfwd(fly), x, "ValueError: ", outside),
        (jax.jacrev(fly), x, "ValueError: ", outside),
        (lambda x: x / len(x), 1.0, "TypeError: ", "object"),
        (lambda x: x if x > 0 else -x, 1.0, "TracerBoolConversionError: ", ""),
    ):
        said = str(why_not(function, given))
        assert said.startswith(f"a kernel cannot trace the function, {error}")
        assert said.endswith(ends) and "\n" not in said
    np.testing.assert_allclose(jax.jacfwd(fly)(x), jax.jacrev(fly)(x), rtol=1e-9)
    with pytest.raises(WrongUse, match="name it in static_argnames"):
        why_not(lambda x, word: x, 1.0, "word")


class SortingWalker(wj.SimplestWalker):
    """A walker of a user's own, with an impact that has no kernel."""

    def impact(self, state):
        nothing = 0 * jnp.sort(jnp.stack(state))[0]
        return super().impact(jax.tree.map(lambda value: value + nothing, state))


class SortingEquations(wj.SimplestWalker):
    """Another, whose equations of motion have none: lines are known of their series too."""

    def vector_field(self, state):
        first = jnp.sort(jnp.stack([self.slope, 2 * self.slope]))[0]
        return jax.tree.map(lambda rate: rate + 0 * first, super().vector_field(state))


class SortingBall(wj.systems.BouncingBall):
    """A system of modes that is no walker."""

    def table(self, phase):
        return tuple(jnp.sort(jnp.stack([self.amplitude, 2.0]))[0] * one for one in (phase, 1.0))


def sorting_map(x, a):
    return a * jnp.sort(x)


SORTING = {
    "SortingWalker": (SortingWalker(0.009), [0.2, -0.2]),
    "SortingEquations": (SortingEquations(0.009), [0.2, -0.2]),
    "SortingBall": (SortingBall(), [0.1, 2.0]),
    "sorting_map": (wj.Map(sorting_map, ("x", "y"), parameters={"a": 0.5}), [0.2, -0.2]),
}


@pytest.mark.parametrize(
    "names",
    [
        ["SortingEquations", "SortingBall", "sorting_map"],
        pytest.param(["SortingWalker"], marks=pytest.mark.slow),
    ],
)
def test_a_users_own_system_without_a_kernel_says_so_once(names, monkeypatch):
    warn_once.cache_clear()
    lines = Path(__file__).read_text().split("\n")
    for name in names:
        system, x = SORTING[name]
        begin = next(
            i for i, one in enumerate(lines) if one.startswith((f"class {name}(", f"def {name}("))
        )
        line = 1 + next(i for i in range(begin, len(lines)) if "jnp.sort" in lines[i])
        said = (
            f"^{name} has no kernel, so XLA computes it, .*: kernels do not support sort, "
            f"in line {line} of test_kernel_decorator.py$"
        )
        walks = isinstance(system, wj.SimplestWalker)
        with pytest.warns(NoKernelWarning, match=said) as warned:
            if walks:  # lowered alone: XLA takes ten seconds to compile each of them
                jax.jit(lambda x, one=system: wj.stride(one, x)).lower(jnp.array(x))
            else:
                assert int(wj.stride(system, x).outcome) == wj.strides(system, [x]).outcome
        assert len(warned) == 1 and warned[0].filename == __file__
    with monkeypatch.context() as patch:
        patch.setenv(machine.VARIABLE, "off")
        warn_once.cache_clear()
        wj.stride(SortingBall(), [0.1, 2.0], tolerance=1e-11)
    assert why_not(lambda x: jnp.sort(x), jnp.ones(2)) is not None  # no system: nothing is said


def test_why_not_where_kernels_are_off_or_arrays_are_elsewhere(monkeypatch):
    monkeypatch.setenv(machine.VARIABLE, "off")
    assert why_not(lambda x: 2 * x, 1.0) == "WALKER_JAX_KERNELS is off"
    elsewhere = SimpleNamespace(devices=lambda: [SimpleNamespace(platform="gpu")])
    monkeypatch.setattr(jnp, "zeros", lambda _: elsewhere)
    assert why_not(lambda x: 2 * x, 1.0) == (
        "arrays are on a gpu, where kernels are not in use: WALKER_JAX_KERNELS is off"
    )


def residuals(found, given):
    """A decay, of which amplitude and rate are fitted to values at some times."""
    times, values = given
    return found[0] * jnp.exp(-found[1] * times) - values


def crossing(found, given):
    return jnp.stack([found[0] ** 2 + found[1] ** 2 - given, found[0] - jnp.sin(found[1]) - 1])


@kernel
def fit(values):
    times = jnp.linspace(0.0, 2.0, 6)
    solver = optimistix.LevenbergMarquardt(1e-12, 1e-12)
    given = times, values
    return optimistix.least_squares(
        residuals, solver, jnp.ones(2), given, throw=False, max_steps=200
    ).value


@kernel
def root(radius):
    solver = optimistix.Newton(1e-13, 1e-13)
    return optimistix.root_find(crossing, solver, jnp.ones(2), radius, throw=False).value


def test_a_fit_and_a_root_of_each_cell():
    """By Levenberg and Marquardt's method with a QR factorisation, and Newton's with an LU one."""
    exact = jnp.stack([jnp.linspace(0.5, 3.0, 20), jnp.linspace(0.2, 1.5, 20)], 1)
    times = jnp.linspace(0.0, 2.0, 6)
    values = exact[:, :1] * jnp.exp(-exact[:, 1:] * times)
    assert why_not(fit, values[0]) is None
    np.testing.assert_allclose(jax.jit(jax.vmap(fit))(values), exact, rtol=1e-8)
    assert why_not(root, 2.0) is None
    radii = jnp.linspace(2.0, 9.0, 20)
    found = jax.jit(jax.vmap(root))(radii)
    np.testing.assert_allclose(jax.vmap(crossing)(found, radii), 0, atol=1e-12)


@pytest.mark.slow
def test_implicit_steps_of_each_cell():
    """A stiff equation whose solution is cos(t)."""

    @kernel
    def solve(stiffness):
        rate = lambda t, y, stiffness: -stiffness * (y - jnp.cos(t)) - jnp.sin(t)
        return diffrax.diffeqsolve(
            *(diffrax.ODETerm(rate), diffrax.Kvaerno3(), 0.0, 3.0, 0.01, jnp.ones(1), stiffness),
            stepsize_controller=diffrax.PIDController(1e-7, 1e-7),
            adjoint=diffrax.ForwardMode(),
            throw=False,
        ).ys

    assert why_not(solve, 10.0) is None
    ends = jax.jit(jax.vmap(solve))(jnp.logspace(0, 6, 9))
    np.testing.assert_allclose(ends[:, 0, 0], np.cos(3.0), atol=1e-6)


def test_linear_equations_by_a_method_that_is_chosen():
    def solve(matrix, vector, method):
        operator = lineax.MatrixLinearOperator(matrix, lineax.positive_semidefinite_tag)
        return lineax.linear_solve(operator, vector, method, throw=False).value

    by_method = kernel(solve, static_argnames="method")
    half = np.random.default_rng(0).normal(size=(3, 3))
    matrix, vector = jnp.asarray(half @ half.T + np.eye(3)), jnp.arange(3.0)
    for method in (lineax.LU(), lineax.QR(), lineax.Cholesky()):
        assert why_not(by_method, matrix, vector, method) is None
        found = by_method(matrix, vector, method)
        np.testing.assert_allclose(found, np.linalg.solve(matrix, vector), rtol=1e-12)


@jax.custom_jvp
def tripled(x):
    return x**2


tripled.defjvp(lambda xs, ts: (tripled(*xs), 3 * ts[0]))


def test_derivatives_of_ones_own_are_used():
    cell = kernel(lambda x: lax.fori_loop(0, 2, lambda _, y: tripled(y), x))
    assert cell(2.0) == 16 and jax.grad(cell)(2.0) == 9 == jax.jvp(cell, (2.0,), (1.0,))[1]


def test_a_kernel_is_compiled_once_for_all_calls(monkeypatch):
    count = 0

    def counted(source):
        nonlocal count
        count += 1
        return load(source)

    load = machine_code.load_program
    monkeypatch.setattr(machine_code, "load_program", counted)
    monkeypatch.setattr(program, "programs", Cache())
    cell = kernel(lambda x, n: x * n + 0.25, static_argnames="n")
    for x in (1.0, 2.0):
        assert cell(x, 3) == cell(x, n=3) == 3 * x + 0.25
    assert count == 1 == len(program.programs)
    cell(1.0, 4)
    assert count == 2
