"""Reverse mode through loops whose number of turns is known only at run time.

JAX does not transpose a `lax.while_loop`. In the adjoint of a kernel the starts of its turns are
written on a tape, which is read backwards, and one turn after the other is transposed. A tape has
`ROWS` rows. For more turns, or if they were not written as the loop was made, the loop is made
again for each part of it, the last one first, so memory is bounded and the result is exact for any
number of turns.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.kernels.stored import LONG
from walker_jax.kernels.tapes import new_tape, read_row, write_row

ROWS = 64
"""Rows of a tape. Modes of a stride take some 16 steps; few take more than these. Tapes of a vector
of cells then fit in the second cache of a core."""

NO_TRANSPOSE = (
    "Reverse-mode differentiation does not work",
    "can't apply forward-mode autodiff (jvp) to a custom_vjp",
    "Differentiation rule for 'custom_lin'",
    "Transpose rule",
    "Linearization failed to produce known values",
)
"""How JAX's errors begin for a loop of a user's own, for a loop of this module within a derivative
(twice), for a primitive without a transpose, and for steps whose lengths depend on the direction,
as those of margins do."""

reversing = jax.make_user_context(False)
"""True while the function is traced that an adjoint transposes."""


class Writer(NamedTuple):
    """A tape on which a loop writes the starts of its turns, as it is made."""

    tapes: list
    put: Callable[..., list]
    """From tapes, the number of a turn, what the loop carries at its start and what is decided
    there, to the tapes with that row."""


class Traced:
    """A traced function of some values, and the values of its surroundings as its constants."""

    def __init__(self, function: Callable, *args: PyTree, in_reverse: bool = False):
        leaves, structure = jax.tree.flatten(args)
        flat = lambda *leaves: function(*jax.tree.unflatten(structure, leaves))
        with reversing(in_reverse):
            closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*leaves)
        self.jaxpr, self.consts = closed.jaxpr, list(closed.consts)
        self.shapes = jax.tree.leaves(shapes)
        self.structure = jax.tree.structure(shapes)

    def __call__(self, consts: Sequence, leaves: Sequence) -> list:
        """Return the leaves of the results."""
        return jaxpr_as_fun(ClosedJaxpr(self.jaxpr, list(consts)))(*leaves)


def with_transposed_turns(
    find: Callable[[PyTree, Writer | None], tuple[PyTree, Int[Array, ""], PyTree, list | None]],
    decide: Callable[[PyTree], PyTree],
    turn: Callable[[PyTree, PyTree], PyTree],
    start: PyTree,
) -> tuple[PyTree, PyTree]:
    """Return what a loop leads to; reverse mode transposes its turns.

    **Arguments:**

    - `find`: makes the loop from its start, by any means. Returns the end; the number of turns;
      other results, which have no derivatives in reverse mode; and the tapes of the `Writer` with
      the starts of all turns, or None if it does not write them. The writer is None outside of
      reverse mode.
    - `turn`: from a carried tree, and what has been decided there, to the next one.
    - `decide`: from a carried tree to what is constant to derivatives of its turn.
    - `start`: the tree that the loop carries, at its start.

    **Returns** the end and the other results.
    """
    if not reversing.value:
        end, _, others, _ = find(start, None)
        return end, others
    start = jax.tree.map(jnp.asarray, start)
    deciding = Traced(decide, start)
    leaves = jax.tree.leaves(start)
    decided = jax.tree.unflatten(deciding.structure, deciding.shapes)
    tapes = Tapes([*leaves, *deciding.shapes])

    def put(written, i, carried, decided=()):
        row = [*jax.tree.leaves(carried), *jax.tree.leaves(decided)]
        return tapes.write(written, jnp.clip(i, 0, ROWS), row)

    finding = Traced(lambda start, written: find(start, Writer(written, put)), start, tapes.blank())
    turning = Traced(turn, start, decided)
    reverse = Traced(turn, start, decided, in_reverse=True)
    count, rows = len(leaves), len(tapes.parts)
    writes = len(jax.tree.unflatten(finding.structure, finding.shapes)[3] or ()) > 0

    def found(consts, leaves):
        new = tapes.blank([*leaves, *consts[0], *consts[3]])
        results = finding(consts[0], [*leaves, *new])
        return (results[:-rows], results[-rows:]) if writes else (results, new)

    @jax.custom_vjp
    def make(consts, leaves):
        return found(consts, leaves)[0]

    def forward(consts, leaves):
        results, written = found(consts, leaves)
        return results, (consts, leaves, results[count], written)

    def backward(known, cts):
        (*others, consts), leaves, turns, written = known
        _, of_deciding, of_turning = others
        loop = ReverseLoop(
            decide=lambda leaves: deciding(of_deciding, leaves),
            turn=lambda leaves, decided: turning(of_turning, [*leaves, *decided]),
            reverse=reverse,
            consts=consts,
            tapes=tapes,
            written=written,
            complete=(turns <= ROWS) & writes,
        )
        of_start, of_consts = loop.pull(leaves, turns, cts[:count])
        unused = [put_back([], one) for one in others]
        return [*unused, put_back(of_consts, consts)], put_back(of_start, leaves)

    make.defvjp(forward, backward)
    consts = [one.consts for one in (finding, deciding, turning, reverse)]
    results = make(consts, leaves)
    if writes:
        results = [*results, *[None] * rows]
    end, _, others, _ = jax.tree.unflatten(finding.structure, results)
    return end, others


class ReverseLoop(NamedTuple):
    """A loop that is transposed, and made again where its turns were not written."""

    decide: Callable[[list], list]
    turn: Callable[[list, list], list]
    reverse: Traced
    """A turn as a function of its start and of these constants, whose derivatives are taken."""
    consts: list
    tapes: "Tapes"
    written: list[Array]
    complete: Bool[Array, ""]
    """Whether the starts of all turns are written."""

    def pull(self, leaves: list, turns: Int[Array, ""], cts: list) -> tuple[list, list]:
        """Return the cotangents of the start and of the constants, given those of the end."""
        leaves = list(map(jnp.asarray, leaves))  # some may be numbers that JAX knows
        real = list(map(is_real, leaves))
        cts = [ct for ct, one in zip(cts, real, strict=True) if one]
        used = jnp.any(jnp.stack([jnp.any(ct != 0) for ct in cts]))
        zeros = [jnp.zeros_like(x) for x in self.consts if is_real(x)]
        turns = jnp.where(used, turns, 0)

        def back(now):
            """Transpose the last turn that remains; write its tape first, if that is another."""
            remaining, written, *cts = now
            last = remaining - 1
            first = last // ROWS * ROWS
            begins = (remaining == turns) | (last - first == ROWS - 1)
            written = self.record(leaves, written, first, jnp.where(begins, remaining, 0))
            row = self.tapes.read(written, last - first)
            return last, written, *self.pull_turn(row, real, *cts)

        begun = turns, self.written, cts, zeros
        _, _, cts, of_consts = lax.while_loop(lambda now: now[0] > 0, back, begun)
        return cts, of_consts

    def record(
        self, leaves: list, written: list, first: Int[Array, ""], last: Int[Array, ""]
    ) -> list:
        """Return tapes with all turns from the first to the last; make them unless known.

        A `last` of 0 asks for none.
        """
        until = jnp.where(self.complete, 0, last)

        def make(now):
            i, leaves, written = now
            decided = self.decide(leaves)
            # Lanes that wait for others have a row that is not read. Turns before the first write
            # row 0 too, which the first then overwrites.
            row = jnp.where(i < until, jnp.maximum(i - first, 0), ROWS)
            written = self.tapes.write(written, row, [*leaves, *decided])
            return i + 1, self.turn(leaves, decided), written

        begun = jnp.zeros_like(last), leaves, written
        return lax.while_loop(lambda now: now[0] < until, make, begun)[2]

    def pull_turn(self, row: list, real: list[bool], cts: list, of_consts: list):
        """Return the cotangents of a turn's start, and those of constants with its part added."""
        leaves, decided = row[: len(real)], row[len(real) :]
        varying = [is_real(x) for x in self.consts]

        def of_real(some, consts):
            all_of_them = replace(leaves, real, some), replace(self.consts, varying, consts)
            found = self.reverse(all_of_them[1], [*all_of_them[0], *decided])
            return [x for x, one in zip(found, real, strict=True) if one]

        some = [x for x, one in zip(leaves, real, strict=True) if one]
        consts = [x for x, one in zip(self.consts, varying, strict=True) if one]
        _, pull = jax.vjp(of_real, some, consts)
        cts, more = pull(cts)
        return cts, [a + b for a, b in zip(of_consts, more, strict=True)]


class Tapes:
    """Tapes for the numbers in a row: of one type, and short, as a kernel writes from registers."""

    def __init__(self, row: list):
        self.row = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in row]
        self.parts: list[list[int]] = []
        """Which arrays of the row are on each tape."""
        for i, x in enumerate(self.row):
            for part in self.parts:
                together = [self.row[k] for k in (*part, i)]
                if together[0].dtype == x.dtype and sum(one.size for one in together) < LONG:
                    part.append(i)
                    break
            else:
                self.parts.append([i])

    def blank(self, values: Sequence = ()) -> list[Array]:
        """Return tapes whose rows depend on some values.

        A tape of derivatives begins as a tape too, if rows depend on all that turns depend on.
        """
        first = lambda x: lax.slice(jnp.ravel(x), (0,), (1,))[0]
        nothing: Any = sum(0 * first(x) for x in values if is_real(x) and jnp.size(x))
        like = [jnp.zeros(x.shape, x.dtype) for x in self.row]
        like = [x + jnp.asarray(nothing, x.dtype) if is_real(x) else x for x in like]
        return [new_tape(one, ROWS + 1) for one in self.joined(like)]

    def joined(self, row: list) -> list[Array]:
        return [jnp.concatenate([jnp.ravel(row[i]) for i in part]) for part in self.parts]

    def write(self, tapes: list, i: Int[Array, ""], row: list) -> list:
        return [write_row(tape, i, x) for tape, x in zip(tapes, self.joined(row), strict=True)]

    def read(self, tapes: list, i: Int[Array, ""]) -> list[Array]:
        found = {}
        for part, tape in zip(self.parts, tapes, strict=True):
            numbers = read_row(tape, i)
            for k in part:
                found[k], numbers = jnp.split(numbers, [self.row[k].size])
        return [found[k].reshape(x.shape) for k, x in enumerate(self.row)]


def zero_where_unused(function: Callable[..., PyTree], *args: PyTree) -> PyTree:
    """Evaluate a function, whose cotangents are zero, not NaN, where no result is used.

    Forward mode drops the derivatives of a result that `jnp.where` does not choose. In reverse mode
    zero is multiplied by them instead, and they may be infinite.
    """
    if not reversing.value:
        return function(*args)
    traced, leaves = Traced(function, *args, in_reverse=True), jax.tree.leaves(args)

    def of_real(known, some):
        values = replace(known, map(is_real, known), some)
        return [x for x in compute(values) if is_real(x)]

    compute = lambda values: traced(values[: len(traced.consts)], values[len(traced.consts) :])
    evaluate = jax.custom_vjp(compute)

    def backward(values, cts):
        cts = [ct for ct, x in zip(cts, traced.shapes, strict=True) if is_real(x)]
        _, pull = jax.vjp(lambda some: of_real(values, some), list(filter(is_real, values)))
        used = jnp.any(jnp.stack([jnp.any(ct != 0) for ct in cts])) if cts else False
        found = [jnp.where(used, ct, 0) for ct in pull(cts)[0]]
        return (put_back(found, values),)

    evaluate.defvjp(lambda values: (compute(values), values), backward)
    return jax.tree.unflatten(traced.structure, evaluate([*traced.consts, *leaves]))


def says_no_transpose(error: Exception) -> bool:
    """Return whether an error says that a function cannot be transposed, rather than is wrong."""
    return any(map(str(error).lstrip().startswith, NO_TRANSPOSE))


def is_real(x: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(x), jnp.floating)


def replace(values: Sequence, places, some: Sequence) -> list:
    """Return values, with others at the places that are true."""
    new = iter(some)
    return [next(new) if here else x for x, here in zip(values, places, strict=True)]


def put_back(cotangents: Sequence, values: Sequence) -> list:
    """Return cotangents of all values, given those of real ones in order, or none: zero then."""
    new = iter(cotangents)
    none = lambda x: np.zeros(np.shape(x), jax.dtypes.float0)
    return [next(new, jnp.zeros_like(x)) if is_real(x) else none(x) for x in values]
