"""Functions of one cell as machine code that works on several cells at once.

XLA makes of a function that is mapped over a tile of cells a loop over the tile for each part that
it sees as a whole. There, all wait for the slowest cell of the tile, a loop gives one result, and
what several have in common is computed again for each. Here the jaxpr of the same function is read
number by number (`scalars`) and written as one program for LLVM, in which a number is a vector of
as many cells as one of 512 bits holds. A loop goes on until it has ended for all of these; those
for which it has keep their values. So a slow cell holds up seven others, nothing is computed
twice, and what lies between start and end of a cell never leaves the core.

What comes out is what XLA computes, to rounding; but a product with a number known to be zero is
zero, whatever the other factor. A loop of few turns, whose number is known, is unrolled. Primitives
of Equinox and lineax are those of one cell: each lane goes its own way in their loops. So a whole
`diffrax.diffeqsolve` has a kernel, with `adjoint=ForwardMode()` and `throw=False`.

No kernel has a function with sorting, eigenvalues or singular values; types of 16 bits or
arithmetic of complex numbers; computed indices of arrays of more than `indexing.LONGEST` entries,
such as results of many times; random numbers; callbacks, and so checks at run time that may fail
(`equinox.error_if`: where `optimistix.Bisection` is to detect the bracket's sign, where a root is
differentiated, in reverse mode). Programs are compiled for the processor at hand,
and kept on disk (`object_cache`).
"""

from walker_jax.kernels.kernel import Kernel
from walker_jax.kernels.primitive import by_kernel, tracing_for_kernel
from walker_jax.kernels.rules import UnsupportedPrimitive

__all__ = ["Kernel", "UnsupportedPrimitive", "by_kernel", "tracing_for_kernel"]
