"""Kernels as custom calls of XLA, through its foreign function interface (FFI).

One handler, an LLVM program (`handler`), serves every kernel on a CPU, and another (`launcher`)
those on GPUs. They need no compiler, and do not take Python's global lock. Each kernel has a stub:
XLA calls it, and it calls the handler with a description of the kernel. No custom calls are made if
XLA's interface is older, of another major version, or of an unknown one.
"""

import ctypes
import functools
import hashlib
import itertools
import math
import re
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from walker_jax.kernels.compiled import Compiled
from walker_jax.kernels.handler import VERSION, load_handler
from walker_jax.kernels.machine import load_program

CELLS_PER_PIECE = 64, 2**15
"""Fewest and most cells that one thread computes without a break.

64 cells are at least eight vectors of float64. `execution.tiles` has the same upper bound.
"""

# xla::PrimitiveType
XLA_TYPE_CODES = {"bool": 1, "int8": 2, "int16": 3, "int32": 4, "int64": 5}
XLA_TYPE_CODES |= {"uint8": 6, "uint16": 7, "uint32": 8, "uint64": 9, "float32": 11, "float64": 12}

VERSION_PARTS = "MAJOR", "MINOR"
"""Suffixes of the macros with the version."""


@functools.cache
def available() -> bool:
    """Return whether the handler fits XLA's interface; warn if it does not."""
    found: tuple[int, ...] | None = None
    header = Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h"
    if header.exists():
        text = header.read_text()
        parts = (re.search(rf"#define XLA_FFI_API_{part} (\d+)", text) for part in VERSION_PARTS)
        found = tuple(int(part[1]) for part in parts if part)
    known = found is not None and found[:1] == VERSION[:1] and found >= VERSION
    if known and sys.maxsize > 2**32:
        return True
    warnings.warn(
        f"XLA's foreign function interface is of version {found}, and kernels know {VERSION}: "
        "functions under jax.jit are computed by XLA alone, more slowly",
        RuntimeWarning,
        stacklevel=2,
    )
    return False


registration_lock = threading.Lock()
registrations: dict[str, Any] = {}
"""Targets by name, with all the memory that they use; XLA may call them at any time.

Equal kernels share one target. None is ever removed: a program of XLA may still call it.
"""


def target(compiled: Compiled) -> str:
    """Return XLA's name of a kernel; the first call registers the kernel."""
    words = lambda: (compiled.code.address(), *CELLS_PER_PIECE)
    return registered("cpu", compiled, load_handler, words)


def registered(
    platform: str, code: Any, load_handler: Callable, words: Callable[[], tuple[Any, Any, Any]]
) -> str:
    """Register code for a platform with its handler, and return the name that XLA knows it by.

    `words` returns words 0, 3 and 4 of the description of the code.
    """
    buffers = [
        (XLA_TYPE_CODES[dtype.name], len(shape), math.prod(shape))
        for shape, dtype in (*code.operands, *code.results)
    ]
    # Programs that XLA keeps on disk refer to the name, so it is the same in every process.
    facts = code.digest, getattr(code, "threads", None), buffers
    digest = hashlib.sha256(repr(facts).encode()).hexdigest()
    name = f"walker_jax_{digest[:32]}"
    with registration_lock:
        if name not in registrations:
            first, *others = words()
            head = [first, len(code.operands), len(code.results), *others]
            description = np.array([*head, *itertools.chain(*buffers)], np.int64)
            program = register(name, platform, load_handler(), description)
            registrations[name] = code, description, program
    return name


def register(name: str, platform: str, handler: Any, description: np.ndarray) -> Any:
    """Give XLA the stub of a kernel, and return the stub's program."""
    stub = STUB_PROGRAM.format(
        handler=handler.get_function_address("handle"), description=description.ctypes.data
    )
    program = load_program(stub, keep=False)
    call = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(program.get_function_address("stub"))
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(call), platform=platform)
    jax.ffi.register_ffi_target_as_batch_partitionable(name)
    return program


STUB_PROGRAM = """
define ptr @stub(ptr %frame) {{
  %handler = inttoptr i64 {handler} to ptr
  %description = inttoptr i64 {description} to ptr
  %error = call ptr %handler(ptr %frame, ptr %description)
  ret ptr %error
}}
"""
