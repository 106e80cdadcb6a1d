"""Options of JAX that users set to find faults of their own: none of them finds one here."""

import inspect
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.jet import jet
from small_calls import CALLS

import walker_jax as wj

WALKER, START, FALL = wj.SimplestWalker(0.009), jnp.array([0.2003, -0.1998]), jnp.array([0.3, -0.1])
GRID = wj.Grid.sheared(theta=(0.1, 0.3, 6), sum=(-0.02, 0.01, 6))
SLOW = {
    "bifurcation_diagram",
    "boundary",
    "chart",
    "continue_basins",
    "explain",
    "explain a ball",
    "export_motion",
    "fit",
    "gait_sensitivity",
    "least_step_down",
    "measure fall-action",
    "measure multipliers",
    "measure sensitivity-norm",
    "most_probable_fall",
    "optimise",
    "pareto",
    "propagate",
    "prove_basin",
    "prove_doubling",
    "prove_gait",
    "robustness",
    "robustness over values",
    "steps_to_fall",
    "steps_to_fall by cells",
}
"""Functions that take seconds to compile."""
EACH = pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] if one in SLOW else []) for one in CALLS]
)


def test_every_function_is_tried():
    """But for the explorer's page, which is not computed here."""
    functions = {one for one in wj.__all__ if inspect.isfunction(getattr(wj, one))}
    functions |= {f"fractals.{one}" for one in wj.fractals.__all__}
    classes = {"Feedback", "Policy"}
    assert functions - {"explore"} | classes == {one.split()[0] for one in CALLS}


@EACH
def test_no_function_makes_nan_or_promotes_ranks(name):
    with jax.debug_nans(True), jax.numpy_rank_promotion("raise"):
        CALLS[name]()


FALLS = {
    "stride": lambda: wj.stride(WALKER, FALL).outcome,
    "strides": lambda: wj.strides(WALKER, FALL[None]).outcome[0],
    "walk": lambda: wj.walk(WALKER, FALL, 2).outcomes[-1],
    "rough ground": lambda: wj.walk(WALKER, FALL, 1, ground=jnp.array([0.001])).outcomes[-1],
    "step down": lambda: wj.stride(WALKER, FALL, step=-0.001).outcome,
    "margins": lambda: wj.margins(WALKER, FALL).stride.outcome,
    "mapped": lambda: jax.jit(jax.vmap(lambda x: wj.stride(WALKER, x).outcome))(FALL[None])[0],
    "basin": lambda: wj.basin(WALKER, GRID, "direct").fate.values.max(),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.slow] * (one == "basin")) for one in FALLS],
)
def test_a_fall_is_no_error_where_nan_is_one(name):
    with jax.debug_nans(True), jax.debug_infs(True):
        assert FALLS[name]() == wj.Outcome.BACKWARD if name != "basin" else FALLS[name]() > 0


CLASSES = """
import jax, jax.numpy as jnp, walker_jax as wj

class Sprung(wj.SimplestWalker):
    stiffness: jax.Array

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - self.stiffness * state.phi)

class Lively(wj.systems.BouncingBall):
    pass

START = jnp.array([0.2003, -0.1998])
"""
"""A walker and a ball that are traced anew in each process, as a user's own class is."""
LEAK = {
    "ball": "wj.stride(Lively(0.4, x), jnp.array([0.7, 2.3])).state[1]",
    "stride": "wj.stride(Sprung(0.009, x), START).state[0]",
    "trajectory": "wj.trajectory(Sprung(0.009, x), START, [1.0]).phi[0]",
}
DIFFERENTIATED = """
with jax.checking_leaks():
    print(jax.jacfwd(end)(jnp.array(0.2)))
print((end(jnp.array(0.2 + 1e-5)) - end(jnp.array(0.2 - 1e-5))) / 2e-5)
"""


@pytest.mark.parametrize(
    "name", ["ball", *(pytest.param(one, marks=pytest.mark.slow) for one in [*LEAK][1:])]
)
def test_no_tracer_is_left_behind_by_derivatives(name):
    """In a process of its own: JAX looks through all objects for each function that it traces."""
    program = f"{CLASSES}\nend = lambda x: {LEAK[name]}\n{DIFFERENTIATED}"
    command, settings = [sys.executable, "-c", program], os.environ | {"JAX_ENABLE_X64": "1"}
    told = subprocess.run(command, capture_output=True, text=True, env=settings)
    assert told.returncode == 0, told.stderr
    slope, by_difference = map(float, told.stdout.split())
    assert slope == pytest.approx(by_difference, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "start"),
    [
        (wj.systems.HenonMap(), jnp.array([0.7, 0.3])),
        (wj.systems.BouncingBall(0.4, 0.8), jnp.array([0.7, 2.3])),
        (WALKER, START),
    ],
)
def test_jet_of_a_stride_is_the_series_along_a_curve(system, start):
    """Its terms are derivatives along the curve, by JAX's convention; an outcome has none."""
    along, bend = jnp.array([0.3, 0.1]), jnp.array([-0.2, 0.4])
    stride = lambda x: wj.stride(system, x)
    with jax.numpy_dtype_promotion("standard"):  # JAX multiplies the outcome's zeros by a number
        found, terms = jet(stride, (start,), ((along, bend),))
    curve = lambda t: stride(start + t * along + t**2 / 2 * bend).state
    assert found.outcome == wj.Outcome.STRIDE and not np.any(terms.outcome)
    np.testing.assert_array_equal(found.state, curve(0.0))
    np.testing.assert_allclose(terms.state[0], jax.jacfwd(curve)(0.0), rtol=1e-12)
    np.testing.assert_allclose(terms.state[1], jax.jacfwd(jax.jacfwd(curve))(0.0), rtol=1e-10)


class Thrown(wj.HybridSystem):
    """A point, up to its landing: a step of any length is exact, whatever the tolerance."""

    section = ("height", "speed")

    def lift(self, x):
        return x

    def project(self, state):
        return state

    def modes(self):
        field = lambda state: jnp.stack([state[1], -jnp.ones_like(state[0])])
        return {"flight": wj.Mode(field, (wj.Guard(lambda state: -state[0], wj.SECTION),))}


def test_jet_of_a_motion_that_steps_exactly():
    """It lands with the speed of -(v^2 + 2 h)^(1/2)."""
    along, none = jnp.array([1.0, 0.0]), jnp.zeros(2)
    stride = lambda x: wj.stride(Thrown(), x).state[1]
    found, terms = jet(stride, (jnp.array([0.5, 0.3]),), ((along, none),))
    speed = np.sqrt(1.09)
    np.testing.assert_allclose([found, *terms], [-speed, -1 / speed, speed**-3], rtol=1e-13)
