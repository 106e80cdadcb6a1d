"""The loop around steps of their own length: `diffrax.diffeqsolve`, in which time counts the steps.

A method that knows the length of its next step cannot tell diffrax, whose step size controllers
choose a length before the step is made. So the variable of integration is the number of steps made:
each step of diffrax has length 1, and makes one step of the method. Time is one of the results.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.integrators.closures import compute_known_now, convert_closure
from walker_jax.integrators.roots import Scalar

MOST_AT_ONCE = 2**24
"""Most steps of one call, after which its caller goes on: single precision counts no further."""


def make_steps(
    step: Callable[[PyTree], PyTree],
    last: PyTree,
    goes_on: Callable[[PyTree], Bool[Array, ""]],
    going: Bool[Array, ""],
    made: Int[Array, ""],
    most: int,
) -> tuple[PyTree, Int[Array, ""]]:
    """Make step after step until one does not go on; return the last and how many were made.

    `step` maps each step to the next one, and `going` says whether to make any. There are at most
    `most`, together with those that were `made` before, and at most `MOST_AT_ONCE`.
    """
    # diffrax asks for the types of a step's results several times; so it is traced once, and is
    # called as a function of all that it closes over.
    make = eqx.filter_jit(convert_closure(step, last))

    def solve(last, going, made):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: jnp.zeros_like(y)),
            OneByOne(make, goes_on, (most - made).astype(float)),
            0.0,
            float(min(most, MOST_AT_ONCE)),
            None,
            (going & (made < most)).astype(float),
            stepsize_controller=EachOfLengthOne(),
            event=diffrax.Event(lambda t, y, args, **_: y == 0),
            saveat=diffrax.SaveAt(solver_state=True),
            adjoint=diffrax.ForwardMode(),
            solver_state=last,
            max_steps=None,  # time ends it
            throw=False,
        )
        return solution.solver_state, made + solution.stats["num_steps"]

    # diffrax goes back from its last time by a hundred numbers, one after the other: a fifth of all
    # that is traced of a small system, if it stays.
    return compute_known_now(solve, last, going, made)


class NoInterpolation(diffrax.AbstractLocalInterpolation):
    """Nothing is between two numbers of steps."""

    t0: Scalar
    t1: Scalar

    def evaluate(self, t0, t1=None, left=True):
        raise NotImplementedError


class OneByOne(diffrax.AbstractSolver):
    """Makes one step of a method for each unit of time.

    The state of the solver is the step. What it integrates, 1 while steps go on and else 0, is
    there for the event.
    """

    make: Callable[[PyTree], PyTree]
    goes_on: Callable[[PyTree], Bool[Array, ""]]
    most: Scalar
    """Number of steps after which none goes on."""

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar = NoInterpolation

    def order(self, terms):
        return None

    def init(self, terms, t0, t1, y0, args):
        raise NotImplementedError  # it is given the step before

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        step = jax.tree.map(jnp.asarray, self.make(solver_state))
        going = self.goes_on(step) & (t1 < self.most)
        return going.astype(y0.dtype), None, {}, step, diffrax.RESULTS.successful


class EachOfLengthOne(diffrax.AbstractStepSizeController):
    """Lets time count the steps."""

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return t0 + 1, None

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, state: Any):
        return True, t0 + 1, t0 + 2, False, None, diffrax.RESULTS.successful
