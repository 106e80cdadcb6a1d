"""Programs for NVIDIA GPUs: one thread computes one cell.

The emitter writes the program of a cell with one lane. An entry is put before it, which gives each
thread its cell, and LLVM compiles both to PTX, the assembly language that NVIDIA's driver
translates for the card at hand. Sines and the like are functions of libdevice, a library that comes
with JAX's CUDA wheels; it is linked only where a program calls one of them.
"""

import contextlib
import functools
import hashlib
import importlib.util
import math
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import llvmlite
import llvmlite.binding as llvm
from jax.extend.core import ClosedJaxpr

from walker_jax.kernels.compiled import shapes_and_types, source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import digest_of
from walker_jax.kernels.object_cache import load_or_compile, recall

TRIPLE, CARD, PTX_VERSION = "nvptx64-nvidia-cuda", "sm_70", "+ptx60"
"""The oldest cards that are served, those of 2017, and the first PTX that has them. A driver takes
PTX of its own time and older, and translates it for any newer card; of newer PTX XLA ends the
process. Newer cards would gain nothing but a shorter minimum of two float32."""
THREADS = 64
"""Threads of a block, two warps: the least with which blocks, of which 32 are at work at once on a
multiprocessor, fill it. A block ends with its slowest cell, so a larger one would wait longer."""
REGISTERS = 255
"""Most registers of a thread, of 32 bits; there are no more. 65,536 of a multiprocessor hold 256
such threads, and with 128 twice as many would hide more waiting. But numbers that find no register
go through memory: with 128, eight times as many for the simplest walker in float64, and four times
as many for one with knees, says `ptxas`. To be tried on a card (`benchmarks/gpu.py`)."""
MAX_ARRAYS = 500
"""Most operands and results: the addresses of all must fit into the 4352 bytes of arguments."""


class Ptx(NamedTuple):
    """A program of threads, and what is called with it."""

    operands: list[tuple[tuple[int, ...], Any]]
    """Shapes and types of one cell."""
    results: list[tuple[tuple[int, ...], Any]]
    text: str
    source_digest: str
    """The hash of the source of one cell."""
    digest: str
    """The hash of all that the text depends on, its name on disk."""


def compile_ptx(closed: ClosedJaxpr, mapped: tuple[bool, ...], in_memory: bool) -> Ptx:
    """The program of a jaxpr of one cell; `entry_of` has the other arguments.

    Raises `UnsupportedPrimitive` for what kernels do not support, and for functions of libdevice
    where there is none.
    """
    start = time.perf_counter()
    operands, results, source = source_of(closed, 0)
    if len(operands) + len(results) > MAX_ARRAYS:
        raise UnsupportedPrimitive(f"more than {MAX_ARRAYS} arrays")
    entry = entry_of(operands, results, mapped, in_memory)
    name = name_of(digest_of(source), entry)
    text = load_or_compile(name, lambda: ptx_of(source + entry).encode()).decode()
    seconds = time.perf_counter() - start
    jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)
    return Ptx(operands, results, text, digest_of(source), name)


def recall_ptx(
    operands: Sequence, results: Sequence, digest: str, mapped: tuple[bool, ...], in_memory: bool
) -> Ptx | None:
    """The program for these abstract values and the hash of its source, if it is on disk."""
    given, returned = shapes_and_types(operands), shapes_and_types(results)
    name = name_of(digest, entry_of(given, returned, mapped, in_memory))
    text = recall(name)
    return Ptx(given, returned, text.decode(), digest, name) if text else None


def name_of(digest: str, entry: str) -> str:
    """The name on disk of the PTX of a source, of which the hash is given, and its entry."""
    library = libdevice()
    linked = hashlib.sha256(library).hexdigest() if library else None
    versions = llvmlite.__version__, *llvm.llvm_version_info, CARD, PTX_VERSION
    return digest_of(repr((versions, linked, entry, digest)))


def entry_of(operands: list, results: list, mapped: tuple[bool, ...], in_memory: bool) -> str:
    """The kernel that the card starts: (cells, addresses of operands, addresses of results).

    `mapped` says which operands have a row for each cell; all threads share the others, which a
    card then reads once for 32 of them. The number of cells is an argument, or `in_memory`.
    """
    arrays = [*zip(operands, mapped, strict=True), *((result, True) for result in results)]
    given = [
        f"ptr noalias {'readonly' if i < len(operands) else ''} %a{i}" for i in range(len(arrays))
    ]
    arguments = ", ".join(["ptr %given" if in_memory else "i64 %cells", *given])
    stores = []
    for i, ((shape, _), each) in enumerate(arrays):
        for kind, table, value in (
            ("ptr", "addresses", f"%a{i}"),
            ("i64", "strides", math.prod(shape) if each else 0),
        ):
            place = f"%{table}{i}"
            stores.append(f"  {place} = getelementptr {kind}, ptr %{table}, i64 {i}")
            stores.append(f"  store {kind} {value}, ptr {place}")
    cells = "  %cells = load i64, ptr %given\n" if in_memory else ""
    counts = {"count": len(arrays), "threads": THREADS, "registers": REGISTERS}
    return ENTRY.format(arguments=arguments, stores=cells + "\n".join(stores), **counts)


ENTRY = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
!nvvm.annotations = !{{!0}}
!0 = !{{ptr @entry, !"maxnreg", i32 {registers}}}

define ptx_kernel void @entry({arguments}) {{
  %addresses = alloca ptr, i64 {count}
  %strides = alloca i64, i64 {count}
{stores}
  %thread32 = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %block32 = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %thread = zext i32 %thread32 to i64
  %block = zext i32 %block32 to i64
  %first = mul i64 %block, {threads}
  %cell = add i64 %first, %thread
  %some = icmp slt i64 %cell, %cells
  br i1 %some, label %compute, label %end
compute:
  %stop = add i64 %cell, 1
  call void @kernel(i64 %cell, i64 %stop, ptr %addresses, ptr %strides) alwaysinline
  br label %end
end:
  ret void
}}
"""


def ptx_of(source: str) -> str:
    """The PTX of a program and its entry, of which LLVM makes one function."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(TRIPLE).create_target_machine(
        cpu=CARD, features=PTX_VERSION, opt=3
    )
    module = llvm.parse_assembly(source)
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    link_libdevice(module)
    for function in module.functions:
        if not function.is_declaration and function.name != "entry":
            function.linkage = "internal"
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    for missing in outside(module):
        raise UnsupportedPrimitive(f"{missing.name} on a GPU")
    return machine.emit_assembly(module)


def link_libdevice(module: llvm.ModuleRef) -> None:
    """Give a program the functions of the C library that it calls, if it calls any."""
    called = list(outside(module))
    if not called:
        return
    library = libdevice()
    if library is None:
        raise UnsupportedPrimitive(f"{called[0].name} on a GPU without {LIBDEVICE}")
    for function in called:
        function.name = f"__nv_{function.name}"
    functions = llvm.parse_bitcode(library)
    functions.triple, functions.data_layout = module.triple, module.data_layout
    module.link_in(functions)


def outside(module: llvm.ModuleRef) -> Iterator[llvm.ValueRef]:
    """The functions that a program calls and does not have, but for LLVM's own."""
    for function in module.functions:
        if function.is_declaration and not function.name.startswith("llvm."):
            yield function


LIBDEVICE = "libdevice.10.bc"


@functools.cache
def libdevice() -> bytes | None:
    """The library of functions for cards, from a wheel of NVIDIA's or an installation of CUDA."""
    wheels = importlib.util.find_spec("nvidia")
    places = [Path(place) for place in (wheels and wheels.submodule_search_locations) or ()]
    found = [
        path for place in places for path in sorted(place.glob(f"*/nvvm/libdevice/{LIBDEVICE}"))
    ]
    roots = [os.environ.get("CUDA_HOME"), os.environ.get("CUDA_PATH"), "/usr/local/cuda"]
    found += [Path(root) / "nvvm/libdevice" / LIBDEVICE for root in roots if root]
    for path in found:
        with contextlib.suppress(OSError):
            return path.read_bytes()
    return None
