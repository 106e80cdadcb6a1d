"""Kernels on NVIDIA GPUs, by one of two routes.

Both routes give XLA a custom call in which the card runs a program of threads (`ptx`). The first is
a handler of XLA's public interface, which asks the driver to launch the program (`launcher`). The
second is XLA's internal call for PTX. A tiny kernel tries the routes before the first real one. The
first route on which it works is taken; if there is none, XLA computes everything.
"""

import functools
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from typing import NamedTuple

import jax
import numpy as np
from jax.core import ShapedArray
from jax.interpreters import mlir

from walker_jax.kernels import ffi, launcher, machine
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.primitive import cells_shape, is_long, kernel_p, lower_to_xla
from walker_jax.kernels.program import Program, program_of
from walker_jax.kernels.ptx import THREADS, Ptx, libdevice
from walker_jax.kernels.sharding import is_divided, lower_divided

PTX_CALL = "__gpu$xla.gpu.ptx"
"""XLA's internal custom call of PTX, in the CUDA plugins of jax 0.10 to 0.12."""


class Route(NamedTuple):
    """A way to make XLA run a program of threads."""

    name: str
    lower: Callable[..., Sequence]
    """(context, operands, program of threads, `mapped`) -> results."""
    fixed: bool
    """Whether a call has a fixed number of cells; XLA then cannot divide it among devices."""


def lower_to_handler(ctx, operands: Sequence, ptx: Ptx, mapped: Sequence[int]) -> Sequence:
    """Lower to a call of the handler; each device computes the cells that it has."""
    if not ffi.available():
        raise OSError("XLA's foreign function interface is of an unknown version")
    target = launcher.target(ptx)
    if any(mapped) and is_divided(ctx):
        return lower_divided(ctx, operands, target, mapped, cells_shape(ctx.avals_in, mapped))
    return jax.ffi.ffi_lowering(target)(ctx, *operands)


def lower_to_ptx_call(ctx, operands: Sequence, ptx: Ptx, mapped: Sequence[int]) -> Sequence:
    """Lower to XLA's own call of PTX; its first operand is the number of cells."""
    cells = int(np.prod(cells_shape(ctx.avals_in, mapped), dtype=np.int64))
    config = {f"{what}_{axis}": np.int32(1) for what in ("grid", "block") for axis in "xyz"}
    config |= {"grid_x": np.int32(max(1, -(-cells // ptx.threads)))}
    config |= {"block_x": np.int32(ptx.threads)}
    config |= {"name": "entry", "kernel_type": "ptx", "kernel_data": ptx.text}
    config = {name: mlir.ir_attribute(value) for name, value in config.items()}
    config["shared_mem_bytes"] = mlir.ir_attribute(np.int32(0))
    # Without these, some versions of XLA pass two operands at one address only once.
    places = (np.int32(1 + len(operands) + i) for i in range(len(ctx.avals_out)))
    config["output_indices"] = mlir.ir.ArrayAttr.get([*map(mlir.ir_attribute, places)])
    given = [ShapedArray((), np.dtype(np.int64)), *ctx.avals_in]
    call = jax.ffi.ffi_lowering(PTX_CALL, backend_config=config)
    return call(ctx.replace(avals_in=given), mlir.ir_constant(np.int64(cells)), *operands)


ROUTES = (
    Route("XLA's foreign function interface", lower_to_handler, False),
    Route("XLA's own call of PTX", lower_to_ptx_call, True),
)
trying: ContextVar[Route | None] = ContextVar("trying", default=None)
"""The route that is being tried."""


def route_in_use() -> Route | None:
    """Return the first route on which a tiny kernel works; None if none does or none is wanted."""
    if not machine.on_gpus():
        return None
    machine.processor()  # refuses a setting that is none
    return next((route for route in ROUTES if failure_of(route) is None), None)


@functools.cache
def failure_of(route: Route) -> str | None:
    """Say why a tiny kernel does not work on a route; None if it does."""
    with ThreadPoolExecutor(1) as thread:  # in which no mesh or other setting of JAX is active
        return thread.submit(try_route, route).result()


def try_route(route: Route) -> str | None:
    """Try a route in this thread, as `failure_of` does in another."""
    trying.set(route)
    cells = np.arange(THREADS[0] + 1, dtype=np.float32)  # of two blocks
    try:
        there = jax.device_put((np.float32(2), cells), jax.local_devices(backend="cuda")[0])
        like = jax.ShapeDtypeStruct((), np.float32)
        program, _ = program_of(tiny, jax.tree.structure((0, 0)), [like, like])
        run = jax.jit(lambda *x: kernel_p.bind(*x, program=program, mapped=(0, 1)))
        (found,) = run(*there)
        right = np.array_equal(found, 2 * cells + 1)
    except Exception as error:  # drivers and versions of XLA raise errors of any type
        return f"{type(error).__name__}: {error}".partition("\n")[0]
    return None if right else "its results are wrong"


def tiny(shared, x):
    return shared * x + 1


def in_words() -> str:
    """Say whether kernels run on a GPU, by which route, and why not by the others."""
    if not machine.on_gpus():
        return f"not in use: {machine.VARIABLE} is {machine.setting()}"
    route = route_in_use()
    reasons = [f"not by {one.name}: {why}" for one in ROUTES if (why := failure_of(one))]
    if route and libdevice() is None:
        reasons.append("not of sines and the like: there is no libdevice")
    return "; ".join([f"in use, by {route.name}" if route else "not in use", *reasons])


def ptx_for(program: Program, mapped: Sequence, route: Route | None) -> Ptx | None:
    """Return the program of threads for a route; None if XLA is to compute."""
    return program.ptx(tuple(map(bool, mapped)), route.fixed) if route else None


def lower_on_gpu(ctx, *operands, program: Program, mapped: tuple[int, ...]):
    """Lower a kernel on a GPU to its call, or to XLA's own primitives."""
    if is_long(program):  # by shorter programs, which are lowered here again
        return lower_to_xla(ctx, *operands, program=program, mapped=mapped)
    exported = ctx.module_context.lowering_parameters.for_export
    tried = None if exported else trying.get()
    route = None if exported else tried or route_in_use()
    divided = any(mapped) and is_divided(ctx)
    if route and route.fixed and divided:
        route = None
    ptx = ptx_for(program, [True] * len(mapped) if divided else mapped, route)
    if route and ptx:
        try:
            return route.lower(ctx, operands, ptx, mapped)
        except OSError as error:  # of the driver, for this program alone
            if tried:
                raise
            warnings.warn(f"{error}: XLA computes instead", RuntimeWarning, stacklevel=2)
    if tried:
        raise UnsupportedPrimitive(program.why_not)
    return lower_to_xla(ctx, *operands, program=program, mapped=mapped)


mlir.register_lowering(kernel_p, lower_on_gpu, platform="cuda")
