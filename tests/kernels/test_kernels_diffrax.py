"""The whole of diffrax.diffeqsolve in a kernel gives what XLA makes of it.

Step lengths follow from error estimates, which are small differences of large numbers. So two
programs that round differently agree to some digits more than the tolerance, not to the last.
"""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from test_kernels import run

from walker_jax.kernels.jaxprs import UnsupportedPrimitive

TIMES = jnp.linspace(0.0, 6.0, 7)
CELLS = np.random.default_rng(0).uniform(-1.5, 1.5, (101, 2))
# a rest position, one that is never left, and no number
CELLS[20], CELLS[21], CELLS[30] = 0, [1e-9, 0], np.nan


def pid(tolerance=1e-9, **options):
    return diffrax.PIDController(rtol=tolerance, atol=tolerance, **options)


def angle(t, y, args, **_):
    return y["angle"] - 0.1 * args


def rate(t, y, args, **_):
    return y["rate"]


def low(t, y, args, **_):
    return (y["angle"] < -0.3) & (t > 1)


def solve(x, **options):
    """A pendulum's swing, with more or less of diffrax's options."""

    def field(t, y, args):
        return {"angle": y["rate"], "rate": -args * jnp.sin(y["angle"])}

    chosen: dict[str, Any] = dict(
        solver=diffrax.Tsit5(),
        t0=0.0,
        t1=6.0,
        dt0=0.1,
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=pid(),
        max_steps=500,
    )
    chosen |= options
    start = {"angle": x[0], "rate": x[1]}
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        y0=start,
        args=jnp.asarray(1.5, x.dtype),
        adjoint=diffrax.ForwardMode(),
        throw=False,
        **chosen,
    )


def results(x, **options):
    """Counts and flags, and the rest."""
    solution = solve(x, **options)
    numbers = solution.ts, solution.ys
    return (solution.stats, solution.result._value, solution.event_mask), numbers


def compared(function, cells: np.ndarray = CELLS, rtol: float = 1e-6):
    found, expected = run(function, cells), jax.jit(jax.vmap(function))(cells)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(*map(jax.tree.leaves, (found[0], expected[0])), strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(*map(jax.tree.leaves, (found[1], expected[1])), strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        number = np.isfinite(cells).all(1)
        np.testing.assert_allclose(one[number], other[number], rtol=rtol, atol=rtol)
        # The product with a known zero is zero in a kernel, also that of NaN.
        beyond = np.isnan(one[~number]), np.isnan(other[~number])
        assert np.all((beyond[0] == beyond[1]) | (one[~number] == 0))
    return found


def check(rtol: float = 1e-6, cells: np.ndarray = CELLS, **options: Any):
    return compared(lambda x: results(x, **options), cells, rtol)


SOLVERS = {
    name: getattr(diffrax, name)()
    for name in "Euler Heun Midpoint Ralston Bosh3 Tsit5 Dopri5 Dopri8".split()
}
CONTROLLERS = {
    "steps given": dict(stepsize_controller=diffrax.StepTo(ts=TIMES), dt0=None),
    "all coefficients": dict(stepsize_controller=pid(pcoeff=0.3, icoeff=0.4, dcoeff=0.1)),
    "bounds": dict(stepsize_controller=pid(dtmin=0.05, dtmax=0.3, force_dtmin=True)),
    "least step": dict(stepsize_controller=pid(dtmin=0.05)),
    "first step": dict(dt0=None),
    "times of steps and jumps": dict(
        stepsize_controller=diffrax.ClipStepSizeController(pid(), step_ts=[1.0, 2.0], jump_ts=[3.0])
    ),
    "rejected steps": dict(
        stepsize_controller=diffrax.ClipStepSizeController(pid(), store_rejected_steps=5)
    ),
}
NEWTON = optimistix.Newton(1e-12, 1e-12)
EVENTS = {
    "flag": diffrax.Event(low),
    "sign": diffrax.Event(angle),
    "root": diffrax.Event(angle, NEWTON),
    "upwards": diffrax.Event(angle, NEWTON, direction=True),
    "bisection": diffrax.Event(angle, optimistix.Bisection(1e-12, 1e-12, flip=True)),
    "several": diffrax.Event([rate, low], NEWTON, direction=[False, None]),
}
SAVED = {
    "both ends": diffrax.SaveAt(t0=True, t1=True),
    "times": diffrax.SaveAt(ts=TIMES),
    "a function": diffrax.SaveAt(t1=True, fn=lambda t, y, args: y["angle"] ** 2 + args * t),
    "several": diffrax.SaveAt(
        subs=[diffrax.SubSaveAt(t1=True), diffrax.SubSaveAt(ts=TIMES, fn=angle)]
    ),
}


@pytest.mark.slow
def test_the_steps_of_a_method():
    """To rounding, where their lengths are given; in the time that all cells have."""
    given: dict[str, Any] = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.25)
    check(rtol=1e-13, **given, saveat=diffrax.SaveAt(ts=TIMES))


@pytest.mark.slow
def test_steps_that_adapt_until_an_event():
    (stats, _, happened), (times, _) = check(event=EVENTS["root"])
    steps = stats["num_steps"]
    assert 0 < happened.sum() < len(CELLS) and len(set(steps.tolist())) > 10
    number = np.isfinite(CELLS[:, 0])
    np.testing.assert_array_equal(happened[number], times[number, 0] < 6)


def test_checks_at_run_time_have_no_kernel():
    """Of a bracket that Bisection is to find by itself."""
    event = diffrax.Event(angle, optimistix.Bisection(1e-9, 1e-9))
    with pytest.raises(UnsupportedPrimitive, match="callback"):
        run(lambda x: results(x, event=event), CELLS)


def test_long_results_have_no_kernel():
    with pytest.raises(UnsupportedPrimitive, match="indices"):
        run(lambda x: results(x, saveat=diffrax.SaveAt(steps=True), max_steps=200), CELLS)


@pytest.mark.slow
def test_float32():
    """Whose error estimates hold three digits: a step more or less is no error."""
    options: dict[str, Any] = dict(
        t0=jnp.float32(0),
        t1=jnp.float32(6),
        dt0=jnp.float32(0.1),
        stepsize_controller=pid(1e-4),
        saveat=diffrax.SaveAt(ts=TIMES.astype(jnp.float32)),
    )
    cells = (CELLS / 2).astype(np.float32)  # far from the rest position that amplifies rounding
    compared(lambda x: ((), results(x, **options)[1]), cells, rtol=1e-3)
    given: dict[str, Any] = dict(stepsize_controller=diffrax.ConstantStepSize())
    check(rtol=1e-4, cells=cells, **(options | given))


@pytest.mark.slow
@pytest.mark.parametrize("adapts", [False, True])
@pytest.mark.parametrize("name", SOLVERS)
def test_solvers(name, adapts):
    if not adapts:
        given: dict[str, Any] = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.25)
        check(rtol=1e-12, solver=SOLVERS[name], **given)
    elif name != "Euler":
        check(solver=SOLVERS[name], stepsize_controller=pid(1e-5))


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
def test_controllers(name):
    check(**CONTROLLERS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", EVENTS)
def test_events(name):
    check(rtol=1e-5, event=EVENTS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", SAVED)
def test_what_is_saved(name):
    check(saveat=SAVED[name])


@pytest.mark.slow
def test_every_step_saved():
    """And the solver's and the controller's state, and what interpolates between them."""
    given: dict[str, Any] = dict(
        solver=diffrax.Heun(),
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=0.25,
        max_steps=25,
    )
    check(rtol=1e-12, saveat=diffrax.SaveAt(steps=True), **given)

    def function(x):
        solution = solve(x, saveat=diffrax.SaveAt(dense=True, controller_state=True), **given)
        assert solution.interpolation is not None and solution.controller_state is not None
        halfway = jax.vmap(solution.evaluate)(jnp.array([0.1, 2.9]))
        return solution.result._value, halfway

    compared(function, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flag", "sign"])
def test_derivatives_of_events(name):
    """Of a root they need a linear solve that is checked at run time."""

    def function(x):
        value = lambda x: results(x, event=EVENTS[name])[1]
        numbers, change = jax.jvp(value, (x,), (jnp.ones(2),))
        return (), (numbers, change)

    compared(function, rtol=1e-3)
