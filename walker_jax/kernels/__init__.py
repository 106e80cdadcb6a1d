"""Functions of one cell as machine code that works on several cells at once.

`kernel` compiles a function, and `why_not` says why a function cannot be compiled.

XLA turns a function mapped over a tile of cells into several loops over the tile, one for each
fusion of operations. A while loop then runs until the slowest cell of the tile has ended, and an
intermediate result used by several fusions is computed again in each. Kernels avoid both. They read
the jaxpr of the function number by number (`entries`) and write it as one LLVM program, in which
every number is a vector of as many cells as a register holds. A loop runs until all cells of the
vector have ended; a cell that has ended keeps its values. So a slow cell delays at most seven
others in float64, equal terms are computed once, and intermediate results stay in the registers and
the cache of one core.

In a program that multiplies matrices with an axis of `stored.LONG` entries or more, as networks do,
long arrays are in memory instead, and loops run over their entries. So it has as many instructions
for a wide network as for a narrow one.

Results equal XLA's to rounding, with two exceptions. A product with a number known to be zero is
zero, even if the other factor is not finite. Subnormal numbers are kept, whereas XLA on a CPU
flushes them to zero. A loop is unrolled if its number of turns is small and known. Primitives of
Equinox and lineax are supported as they act on one cell, so a whole `diffrax.diffeqsolve` has a
kernel, with `adjoint=ForwardMode()` and `throw=False`.

A function has no kernel if it uses sorting, eigenvalues or singular values; floating-point types of
16 bits or complex arithmetic; computed indices into arrays of more than `indexing.MAX_ENTRIES`
entries, such as results at many times; random numbers; or callbacks. Checks that may fail at run
time are callbacks (`equinox.error_if`). So a function has no kernel either if it calls an
`optimistix.Bisection` that must detect the sign of its bracket, differentiates a root search, or
goes through a solver in reverse mode. Programs are compiled for the processor of this machine and
kept on disk (`object_cache`), and so are the results of tracing (`program_cache`).
"""

from walker_jax.kernels import transposes  # noqa: F401  # reverse mode of all that follows
from walker_jax.kernels.decorator import kernel, why_not

__all__ = ["kernel", "why_not"]
