"""Kernels on a GPU as custom calls of XLA: a handler asks NVIDIA's driver to launch them.

XLA calls the handler with buffers on the card. The handler reads the number of cells from their
shapes, as on a CPU (`handler`). It asks XLA for the stream of this call, and launches the kernel on
it, after the work that is queued there. So the call returns at once, and results stay on the card.
"""

import ctypes
import functools
from typing import Any

from walker_jax.kernels import ffi
from walker_jax.kernels.handler import CALLED, HELPERS, fill_in
from walker_jax.kernels.machine import VARIABLE, load_program
from walker_jax.kernels.ptx import Ptx

LAUNCH_FAILED = (
    f"NVIDIA's driver could not launch a kernel: {VARIABLE}=cpu leaves what is on GPUs to XLA"
)


def target(ptx: Ptx) -> str:
    """Return XLA's name of a program of threads; the first call registers the program."""

    def words():
        launch = ctypes.cast(load_driver().cuLaunchKernel, ctypes.c_void_p).value
        return load(ptx.text), ptx.threads, launch

    return ffi.registered("CUDA", ptx, load_launcher, words)


@functools.cache
def load_driver() -> Any:
    """Load the driver, which JAX uses too; `OSError` if there is none."""
    driver = ctypes.CDLL("libcuda.so.1")
    check(driver.cuInit(0))
    return driver


def load(ptx: str) -> int | None:
    """Return the driver's handle of a kernel, valid on all cards."""
    driver, library, kernel = load_driver(), ctypes.c_void_p(), ctypes.c_void_p()
    options = (None, None, 0) * 2
    check(driver.cuLibraryLoadData(ctypes.byref(library), ptx.encode(), *options))
    check(driver.cuLibraryGetKernel(ctypes.byref(kernel), library, b"entry"))
    return kernel.value


def check(status: int) -> None:
    """Raise `OSError` unless a call of the driver succeeded."""
    if status:
        raise OSError(f"NVIDIA's driver fails, with CUDA's error {status}")


@functools.cache
def load_launcher() -> Any:
    """Compile the handler, once for all kernels on GPUs."""
    failure = {"failure": LAUNCH_FAILED, "failure_length": str(len(LAUNCH_FAILED) + 1)}
    text = DECLARATIONS + CALLED + LAUNCH + HELPERS
    return load_program(fill_in(text, compute=COMPUTE, **failure))


DECLARATIONS = """
declare ptr @malloc(i64)
declare void @free(ptr)
@failure = private constant [{failure_length} x i8] c"{failure}\\00"
"""
COMPUTE = """  %status = call ptr @launch(ptr %frame, ptr %description, ptr %job)
  call void @free(ptr %job)
  ret ptr %status"""
# The job and the description are those of `handler`, except for three words of the description: 0
# is the driver's handle of the kernel, 3 the threads of a block, 4 the driver's launch function.
LAUNCH = """
define ptr @launch(ptr %frame, ptr %description, ptr %job) {{
entry:
  %cells = field i64, ptr %job, i64 24
  %none = icmp eq i64 %cells, 0
  br i1 %none, label %good, label %ask
ask:
  %api = field ptr, ptr %frame, i64 16
  %context = field ptr, ptr %frame, i64 24
  %stream_args = alloca [4 x i64]
  put i64 32, ptr %stream_args, i64 0
  put ptr null, ptr %stream_args, i64 8
  put ptr %context, ptr %stream_args, i64 16
  %get_stream = field ptr, ptr %api, i64 80
  %no_stream = call ptr %get_stream(ptr %stream_args)
  %streamed = icmp eq ptr %no_stream, null
  br i1 %streamed, label %collect, label %without
without:
  ret ptr %no_stream
collect:
  ; the addresses of the arguments: of the number of cells, then of the addresses of all buffers
  %stream = field ptr, ptr %stream_args, i64 24
  %args = field i64, ptr %description, i64 8
  %rets = field i64, ptr %description, i64 16
  %all = add i64 %args, %rets
  %count = add i64 %all, 1
  %arguments = alloca ptr, i64 %count
  %cells_at = getelementptr i8, ptr %job, i64 24
  store ptr %cells_at, ptr %arguments
  %addresses = getelementptr i8, ptr %job, i64 56
  br label %each
each:
  %k = phi i64 [ 0, %collect ], [ %k_next, %note ]
  %more = icmp slt i64 %k, %all
  br i1 %more, label %note, label %start
note:
  %address_at = getelementptr ptr, ptr %addresses, i64 %k
  %k_next = add i64 %k, 1
  %argument_at = getelementptr ptr, ptr %arguments, i64 %k_next
  store ptr %address_at, ptr %argument_at
  br label %each
start:
  %kernel = load ptr, ptr %description
  %threads64 = field i64, ptr %description, i64 24
  %start_kernel = field ptr, ptr %description, i64 32
  %blocks64 = call i64 @divide_up(i64 %cells, i64 %threads64)
  %blocks = trunc i64 %blocks64 to i32
  %threads = trunc i64 %threads64 to i32
  %status = call i32 %start_kernel(ptr %kernel,
    i32 %blocks, i32 1, i32 1, i32 %threads, i32 1, i32 1,
    i32 0, ptr %stream, ptr %arguments, ptr null)
  %launched = icmp eq i32 %status, 0
  br i1 %launched, label %good, label %bad
bad:
  %error = call ptr @refuse(ptr %api, ptr @failure, i64 13)
  ret ptr %error
good:
  ret ptr null
}}
"""
