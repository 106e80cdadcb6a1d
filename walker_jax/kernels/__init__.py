"""Functions of one cell as machine code that works on several cells at once.

`kernel` makes a kernel of a function, and `why_not` says why one has none.

XLA compiles a function that is mapped over a tile of cells into one loop over the tile for each
fusion of operations. A while loop then runs until the slowest cell of the tile has ended, and an
intermediate result that several fusions use is computed again in each. Kernels avoid both. The
jaxpr of the function is read number by number (`scalars`) and written as one LLVM program, in which
every number is a vector of as many cells as a register holds. A loop runs until all cells of the
vector have ended; a cell that has ended keeps its values. So a slow cell delays at most seven
others in float64, equal terms are computed once, and intermediate results stay in the registers and
the cache of one core.

Results equal XLA's to rounding, with two exceptions. The product with a number known to be zero is
zero, even where the other factor is not finite. Subnormal numbers are kept, where XLA on a CPU
flushes them to zero. A loop of few turns whose number is known is unrolled. Primitives of Equinox
and lineax are supported as they act on one cell, so a whole `diffrax.diffeqsolve` has a kernel,
with `adjoint=ForwardMode()` and `throw=False`.

A function has no kernel if it holds sorting, eigenvalues or singular values; floating-point types
of 16 bits or complex arithmetic; computed indices into arrays of more than `indexing.MAX_ENTRIES`
entries, such as results at many times; random numbers; callbacks, and so checks at run time that
may fail (`equinox.error_if`: `optimistix.Bisection` with the bracket's sign to be detected, a
differentiated root search, reverse mode). Programs are compiled for the processor of this machine
and kept on disk (`object_cache`), and so is what tracing led to (`program_cache`).
"""

from walker_jax.kernels.decorator import kernel, why_not

__all__ = ["kernel", "why_not"]
