"""Programs: traced functions of one cell, with their machine code and derivatives.

A program is traced for the shapes and types of its arguments, and for the current settings of JAX.
It is kept: the same function of the same arguments is the same program. Its machine code is made
when first needed, and so is each derivative, which is a program too.
"""

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import jaxpr_as_fun, jaxprs_in_params

from walker_jax.checks import NoKernelWarning, WrongUse, is_traced, warn_once
from walker_jax.identity import Cache, sha256_of
from walker_jax.kernels import machine
from walker_jax.kernels.compiled import Compiled, without_garbage_collection
from walker_jax.kernels.directions import mapping_directions
from walker_jax.kernels.gathered_sums import with_gathered_sums
from walker_jax.kernels.jaxprs import UnsupportedPrimitive, shape_dtype
from walker_jax.kernels.products import sum_of_products_p
from walker_jax.kernels.program_cache import (
    Traced,
    code_of_program,
    keep_trace,
    recall_trace,
    trace_name,
    user_code_states,
    user_system_in,
)
from walker_jax.kernels.ptx import Ptx, find_ptx
from walker_jax.kernels.reverse import reversing, says_no_transpose
from walker_jax.kernels.stored import is_long, multiplies_long_matrices
from walker_jax.kernels.unused import without_unused

MAX_PROGRAMS = 256
"""Most functions kept compiled; the least recently used are dropped."""
MIN_SHARED, MAX_SHARED_NUMBERS = 1000, 100
"""Fewest operations, and most numbers in operands and results, of a program that other kernels
call; others become part of them. LLVM's library writes the types of all results at each result."""
tracing_for_kernel = jax.make_user_context(False)
"""True while a function is traced for a kernel, which calls or includes the kernels within it."""


class Program:
    """A pure function of one cell's arrays; machine code and derivatives are made when needed."""

    def __init__(
        self,
        function: Callable[..., list],
        operands: Sequence,
        settings: tuple,
        origin: "tuple[Program, tuple[int, ...], int] | None" = None,
        name: str | None = None,
        avals: tuple[list[ShapedArray], list[ShapedArray]] | None = None,
    ):
        self.settings = settings
        """Contexts and their values, under which the function and its derivatives are traced."""
        self.trace = lambda: jax.make_jaxpr(function)(*operands)
        self.adjoint_of: tuple[Program, tuple[int, ...], tuple[int, ...]] | None = None
        """For an adjoint: the program, and the operands and results that `adjoint` was given."""
        self.name = name
        """Name of its trace on disk; None if it cannot be kept there."""
        self.traced = recall_trace(name)
        """Facts about the function that are known without tracing."""
        if avals is None and self.traced is not None:
            avals = self.traced.operands, self.traced.results
        elif avals is None:
            avals = self.closed.in_avals, self.closed.out_avals
        self.operands, self.results = avals
        """Abstract values; derivatives get theirs, as many are only the origin of another."""
        self.origin = origin
        """For a derivative: the program, the operands of differentiation, how many directions."""
        first = len(self.operands) if origin is None else len(origin[0].operands)
        self.linear = frozenset(range(first, len(self.operands)))
        """Operands in which the function is jointly linear: a derivative's directions."""
        self.derivatives: dict[tuple, Program] = {}
        self.adjoints: dict[tuple, Program | None] = {}
        self.on_gpu: dict[tuple, Ptx | None] = {}
        """Programs of threads by the arguments of `ptx`; None if there is none."""
        self.tree: Any = self.traced.tree if self.traced else None
        """The tree of the results; None of a derivative."""
        self.owner: str | None = None if origin is None else origin[0].owner
        """Name of the user's own system that it computes; None for any other function."""
        self.why_not: str | None = None
        """Why it has no machine code; known once the code has been asked for."""

    @functools.cached_property
    def closed(self):
        """The jaxpr."""
        settings = apply_settings(self.settings)
        with settings, tracing_for_kernel(True), without_garbage_collection():
            closed = without_unused(self.trace())
            if self.adjoint_of is not None:
                closed = with_gathered_sums(closed)
        if is_traced(closed.consts):
            raise WrongUse(
                "a kernel must depend on its arguments alone: make the traced value that its "
                "function reads another argument"
            )
        return closed

    @functools.cached_property
    def compiled(self) -> Compiled | None:
        """The machine code; None if there is none, and `why_not` then says why."""
        if machine.switched_off():
            self.why_not = f"{machine.VARIABLE} is off"
            return None
        if self.traced is not None:
            compiled = Compiled.recall(self.operands, self.results, self.traced.digest)
            if compiled is not None:
                return compiled
        try:
            with nan_allowed():  # of known numbers, in branches that are not taken
                compiled = Compiled(self.closed, self.shared)
        except UnsupportedPrimitive as error:
            self.why_not = f"kernels do not support {error}"
            if self.owner is not None:
                warn_once(
                    f"{self.owner} has no kernel, so XLA computes it, which may take many times as "
                    f"long: {self.why_not}",
                    NoKernelWarning,
                )
            return None
        found = Traced(self.operands, self.results, self.tree, self.size, compiled.digest)
        keep_trace(self.name, found)
        return compiled

    def ptx(self, mapped: tuple[bool, ...], in_memory: bool) -> Ptx | None:
        """Return the program for GPUs (`ptx.entry_of`); set `why_not` if there is none."""
        key = mapped, in_memory
        if key not in self.on_gpu:
            given = self.operands, self.results, self.name, lambda: self.closed
            try:
                self.on_gpu[key] = find_ptx(*given, *key)
            except UnsupportedPrimitive as error:
                self.on_gpu[key], self.why_not = None, f"kernels do not support {error}"
            if self.traced is None and "closed" in vars(self):  # with no machine code
                found = Traced(self.operands, self.results, self.tree, self.size, "")
                keep_trace(self.name, found)
        return self.on_gpu[key]

    @property
    def function(self) -> Callable[..., list]:
        """The function in JAX's own primitives, evaluated from its jaxpr."""
        return jaxpr_as_fun(self.closed)

    @functools.cached_property
    def function_in_reverse(self) -> Callable[..., list]:
        """The function with loops that reverse mode can transpose."""
        settings = apply_settings(self.settings)
        with settings, tracing_for_kernel(True), reversing(True), without_garbage_collection():
            return jaxpr_as_fun(self.trace())

    @functools.cached_property
    def size(self) -> int:
        """The number of operations of one cell."""
        return self.traced.size if self.traced else count_operations(self.closed.jaxpr)

    @property
    def shared(self) -> bool:
        """Whether other kernels call its machine code (`shared_code`)."""
        numbers = sum(math.prod(aval.shape) for aval in (*self.operands, *self.results))
        derived = self.origin is not None or self.adjoint_of is not None
        return self.size >= MIN_SHARED and numbers <= MAX_SHARED_NUMBERS and not derived

    def derivative(self, by: tuple[int, ...], directions: int = 1) -> "Program":
        """Return the derivative of all real results along directions of the operands `by`.

        Its operands are those of this program, followed by the tangents of each of `by`. Tangents
        and results have a leading axis of directions.
        """
        if (by, directions) not in self.derivatives:
            real = list(map(is_real, self.results))

            def along(*values):
                function = self.function  # traced before directions are mapped
                point, tangents = list(values[: len(self.operands)]), values[len(self.operands) :]

                def of_some(*some):
                    for i, value in zip(by, some, strict=True):
                        point[i] = value
                    return list(itertools.compress(function(*point), real))

                some = tuple(point[i] for i in by)
                one = lambda *tangents: jax.jvp(of_some, some, tangents)[1]
                with mapping_directions(True):
                    if directions != 1:
                        return jax.vmap(one)(*tangents)
                    # Equal to the line above with one direction, and traced in half the time.
                    return [change[None] for change in one(*(tangent[0] for tangent in tangents))]

            many = lambda aval: aval.update(shape=(directions, *aval.shape))
            operands = [*self.operands, *(many(self.operands[i]) for i in by)]
            avals = operands, [many(aval) for aval in itertools.compress(self.results, real)]
            name = sha256_of((self.name, by, directions)) if self.name else None
            like, origin = list(map(shape_dtype, operands)), (self, by, directions)
            program = Program(along, like, self.settings, origin, name, avals)
            self.derivatives[by, directions] = program
        return self.derivatives[by, directions]

    def adjoint(self, by: tuple[int, ...], of: tuple[int, ...]) -> "Program | None":
        """Return the program of the cotangents of the operands `by`; None if there is none.

        Its operands are those of this program, followed by the cotangents of the results `of`.
        Loops of a user's own, and those within derivatives, have no transpose.
        """
        if (by, of) not in self.adjoints:
            self.adjoints[by, of] = self.make_adjoint(by, of)
        return self.adjoints[by, of]

    def make_adjoint(self, by: tuple[int, ...], of: tuple[int, ...]) -> "Program | None":
        count = len(self.operands)
        # By all real operands, so that nothing of the program is left untransposed, which could not
        # be differentiated again. Only what `by` needs is kept.
        real = [i for i, aval in enumerate(self.operands) if is_real(aval)]

        def pull(*values):
            point, cotangents = list(values[:count]), list(values[count:])

            def of_some(*some):
                for i, value in zip(real, some, strict=True):
                    point[i] = value
                results = self.function_in_reverse(*point)
                return [results[i] for i in of]

            results, transposed = jax.vjp(of_some, *(point[i] for i in real))
            # A result without a cotangent has no part, even if its derivative is NaN. Any other
            # that is NaN has no derivatives.
            some = lambda flags: jnp.any(jnp.stack([*map(jnp.any, flags)]))
            used = some(ct != 0 for ct in cotangents)
            lost = some((ct != 0) & jnp.isnan(x) for ct, x in zip(cotangents, results, strict=True))
            known = lambda ct: jnp.where(used & ~lost, ct, jnp.where(lost, jnp.nan, 0))
            found = dict(zip(real, transposed(cotangents), strict=True))
            return [known(found[i]) for i in by]

        operands = [*self.operands, *(self.results[i] for i in of)]
        avals = operands, [self.operands[i] for i in by]
        name = sha256_of((self.name, "adjoint", by, of)) if self.name else None
        program = Program(pull, list(map(shape_dtype, operands)), self.settings, None, name, avals)
        program.linear = frozenset(range(count, len(operands)))
        program.adjoint_of = self, by, of
        try:
            usable = program.compiled is not None or self.compiled is None
            _ = usable and program.size  # traced, so that it is known to exist
        except (NotImplementedError, TypeError, ValueError) as error:
            if not says_no_transpose(error):
                raise
            return None
        return program if usable else None


def count_operations(
    jaxpr, known: dict[int, int] | None = None, in_memory: bool | None = None
) -> int:
    """Count the scalars that a jaxpr computes; each loop counts for one turn.

    A sum of products counts for its products and additions, and a long array that a kernel has
    `in_memory` for one scalar, as a loop computes it. `known` holds the counts of inner jaxprs by
    identity.
    """
    known = {} if known is None else known
    in_memory = multiplies_long_matrices(jaxpr) if in_memory is None else in_memory
    if id(jaxpr) in known:
        return known[id(jaxpr)]
    total = 0
    for equation in jaxpr.eqns:
        inner = list(jaxprs_in_params(equation.params))
        total += sum(count_operations(one, known, in_memory) for one in inner)
        each = len(equation.invars) - 1 if equation.primitive is sum_of_products_p else 1
        sizes = [
            1 if in_memory and is_long(v.aval) else math.prod(v.aval.shape)
            for v in equation.outvars
        ]
        total += 0 if inner else each * sum(sizes)
    known[id(jaxpr)] = total
    return total


def is_real(aval) -> bool:
    return jnp.issubdtype(aval.dtype, jnp.floating)


programs: Cache = Cache()
"""Program and tree of the results, by function, shapes, types, settings and state of user code."""
MODES = {
    "jax_enable_x64": jax.enable_x64,
    "jax_numpy_dtype_promotion": jax.numpy_dtype_promotion,
}
"""Settings of JAX that affect the results of a function, and the contexts that set them."""


def current_settings() -> tuple[tuple[Any, Any], ...]:
    """Return the contexts and their values in this thread."""
    return tuple((context, getattr(jax.config, mode)) for mode, context in MODES.items())


@contextlib.contextmanager
def nan_allowed():
    """Return NaN and infinity as results, such as the state after a failure, not as errors.

    JAX's options `jax_debug_nans` and `jax_debug_infs` check all else, such as a user's own `jit`.
    """
    with jax.debug_nans(False), jax.debug_infs(False):
        yield


@contextlib.contextmanager
def apply_settings(settings: tuple[tuple[Any, Any], ...]):
    """Enter the contexts with values that were recorded earlier, or in another thread."""
    with contextlib.ExitStack() as now:
        for context, value in settings:
            now.enter_context(context(value))
        now.enter_context(nan_allowed())
        yield


def program_of(function: Callable, structure, avals: Sequence) -> tuple[Program, Any]:
    """Return the program of a function for these shapes and types, and the tree of its results."""
    function = getattr(function, "of_one_cell", function)  # undoes `kernel`
    settings, states = current_settings(), user_code_states(function, structure)
    kinds = ((x.shape, x.dtype, x.weak_type) for x in avals)
    key = function, structure, settings, states, *kinds
    if key in programs:
        programs.move_to_end(key)
        return programs[key]
    results: Any = None

    def flat(*leaves):
        nonlocal results
        with code_of_program(states):
            found, results = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        return found

    name = None if machine.switched_off() else trace_name(function, structure, avals, settings)
    program = Program(flat, list(map(shape_dtype, avals)), settings, name=name)
    program.owner = user_system_in(structure)
    if program.tree is None:
        program.tree = results
    programs[key] = program, program.tree
    while len(programs) > MAX_PROGRAMS:
        programs.popitem(last=False)
    return programs[key]
