"""Reverse mode through loops whose number of turns is known only at run time.

JAX does not transpose a `lax.while_loop`. In the adjoint of a kernel such a loop is made once more:
the starts of its turns are written on a tape, which is read backwards, and one turn after the other
is transposed. A tape has `ROWS` rows. For more turns the loop is made again for each part of it,
the last one first, so memory is bounded and the result is exact for any number of turns.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array, Int, PyTree

from walker_jax.kernels.tapes import new_tape, read_row, write_row

ROWS = 64
"""Rows of a tape. Modes of a stride take some 16 steps; few take more than these. Tapes of a vector
of cells then fit in the second cache of a core."""

NO_TRANSPOSE = (
    "Reverse-mode differentiation does not work",
    "can't apply forward-mode autodiff (jvp) to a custom_vjp",
    "Differentiation rule for 'custom_lin'",
    "Transpose rule",
)
"""How JAX's errors begin for a loop of a user's own, for a loop of this module within a derivative
(twice), and for a primitive without a transpose."""

reversing = jax.make_user_context(False)
"""True while the function is traced that an adjoint transposes."""


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
    find: Callable[[PyTree], tuple[PyTree, Int[Array, ""], PyTree]],
    decide: Callable[[PyTree], PyTree],
    turn: Callable[[PyTree, PyTree], PyTree],
    start: PyTree,
) -> tuple[PyTree, PyTree]:
    """Return what a loop leads to; reverse mode transposes its turns.

    **Arguments:**

    - `find`: makes the loop from its start, by any means. Returns the end; the number of turns; and
      other results, which have no derivatives in reverse mode.
    - `turn`: from a carried tree, and what has been decided there, to the next one.
    - `decide`: from a carried tree to what is constant to derivatives of its turn.
    - `start`: the tree that the loop carries, at its start.

    **Returns** the end and the other results.
    """
    if not reversing.value:
        end, _, others = find(start)
        return end, others
    start = jax.tree.map(jnp.asarray, start)
    finding, deciding = Traced(find, start), Traced(decide, start)
    decided = jax.tree.unflatten(deciding.structure, deciding.shapes)
    turning = Traced(turn, start, decided)
    reverse = Traced(turn, start, decided, in_reverse=True)
    leaves = jax.tree.leaves(start)
    count = len(leaves)

    @jax.custom_vjp
    def make(consts, leaves):
        return finding(consts[0], leaves)

    def forward(consts, leaves):
        results = finding(consts[0], leaves)
        return results, (consts, leaves, results[count])

    def backward(known, cts):
        (*others, consts), leaves, turns = known
        _, of_deciding, of_turning = others
        loop = ReverseLoop(deciding, turning, reverse, of_deciding, of_turning, consts)
        of_start, of_consts = loop.pull(leaves, turns, cts[:count])
        unused = [put_back([], one) for one in others]
        return [*unused, put_back(of_consts, consts)], put_back(of_start, leaves)

    make.defvjp(forward, backward)
    consts = [one.consts for one in (finding, deciding, turning, reverse)]
    end, _, others = jax.tree.unflatten(finding.structure, make(consts, leaves))
    return end, others


class ReverseLoop:
    """A loop that is made again and transposed."""

    def __init__(self, deciding, turning, reverse, of_deciding, of_turning, of_reverse):
        self.decide = lambda leaves: deciding(of_deciding, leaves)
        self.turn = lambda leaves, decided: turning(of_turning, [*leaves, *decided])
        self.decided = deciding.shapes
        self.reverse, self.consts = reverse, of_reverse

    def pull(self, leaves: list, turns: Int[Array, ""], cts: list) -> tuple[list, list]:
        """Return the cotangents of the start and of the constants, given those of the end."""
        leaves = list(map(jnp.asarray, leaves))  # some may be numbers that JAX knows
        real = list(map(is_real, leaves))
        cts = [ct for ct, one in zip(cts, real, strict=True) if one]
        used = jnp.any(jnp.stack([jnp.any(ct != 0) for ct in cts]))
        zeros = [jnp.zeros_like(x) for x in self.consts if is_real(x)]
        begun = jnp.where(used, turns, 0), cts, zeros

        def part(now):
            """Transpose the last turns that remain, as many as a tape holds."""
            remaining, *cts = now
            first = (remaining - 1) // ROWS * ROWS
            tapes = self.record(leaves, first, remaining)

            def back(now):
                i, *cts = now
                return i - 1, *self.pull_turn(tapes.read(i - 1 - first), real, *cts)

            _, *cts = lax.while_loop(lambda now: now[0] > first, back, (remaining, *cts))
            return first, *cts

        _, cts, of_consts = lax.while_loop(lambda now: now[0] > 0, part, begun)
        return cts, of_consts

    def record(self, leaves: list, first: Int[Array, ""], last: Int[Array, ""]) -> "Tapes":
        """Make turns up to the last, and write down all from the first on."""
        # A tape of derivatives begins as a tape too, if rows depend on all that turns depend on.
        nothing: Any = sum(0 * jnp.sum(x) for x in (*leaves, *self.consts) if is_real(x))
        like = [jnp.zeros(x.shape, x.dtype) for x in (*leaves, *self.decided)]
        tapes = Tapes([x + nothing.astype(x.dtype) if is_real(x) else x for x in like])

        def make(now):
            i, leaves, written = now
            decided = self.decide(leaves)
            # Earlier turns, and lanes that wait for others, have rows that are not read.
            row = jnp.clip(i - first, 0, ROWS)
            written = tapes.write(written, row, [*leaves, *decided])
            return i + 1, self.turn(leaves, decided), written

        begun = jnp.zeros_like(last), leaves, tapes.written
        tapes.written = lax.while_loop(lambda now: now[0] < last, make, begun)[2]
        return tapes

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
    """One tape for the numbers of each type in a row."""

    def __init__(self, row: list):
        self.row = row
        self.kinds = list(dict.fromkeys(x.dtype for x in row))
        self.written = [new_tape(one, ROWS + 1) for one in self.joined(row)]

    def joined(self, row: list) -> list[Array]:
        each = lambda kind: [jnp.ravel(x) for x in row if x.dtype == kind]
        return [jnp.concatenate(each(kind)) for kind in self.kinds]

    def write(self, tapes: list, i: Int[Array, ""], row: list) -> list:
        return [write_row(tape, i, x) for tape, x in zip(tapes, self.joined(row), strict=True)]

    def read(self, i: Int[Array, ""]) -> list[Array]:
        found, rows = [], {k: read_row(x, i) for k, x in zip(self.kinds, self.written, strict=True)}
        for x in self.row:
            found.append(rows[x.dtype][: x.size].reshape(x.shape))
            rows[x.dtype] = rows[x.dtype][x.size :]
        return found


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
