"""Programs for NVIDIA GPUs: one thread computes one cell.

The emitter writes the program of a cell with one lane. An entry is put before it, which gives each
thread its cell, and LLVM compiles both to PTX, the assembly language that NVIDIA's driver
translates for the card at hand. Sines and the like are functions of libdevice, a library that comes
with JAX's CUDA wheels; it is linked only where a program calls one of them.
"""

import functools
import hashlib
import importlib.util
import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm
from jax.extend.core import ClosedJaxpr

from walker_jax.kernels.compiled import shapes_and_types, source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import digest_of
from walker_jax.kernels.object_cache import load_or_compile

TRIPLE, CARD, PTX_VERSION = "nvptx64-nvidia-cuda", "sm_70", "+ptx60"
"""The oldest cards that are served, those of 2017, and the first PTX that has them. A driver takes
PTX of its own time and older, and translates it for any newer card; of newer PTX XLA ends the
process. A newer target needs as many registers, says `ptxas`."""
THREADS = 64
"""Threads of a block, two warps: the least with which blocks, of which 32 are at work at once on a
multiprocessor, fill it. A block ends with its slowest cell, so a larger one would wait longer."""
REGISTERS = 255
"""Most registers of a thread, of 32 bits; there are no more. 65,536 of a multiprocessor hold 256
such threads, and with 128 twice as many would hide more waiting. But numbers that find no register
go through memory: with 128, eight times as many for the simplest walker in float64, and three times
as many for one with knees, says `ptxas`. To be tried on a card (`benchmarks/gpu.py`)."""
MAX_ARRAYS = 500
"""Most operands and results: the addresses of all must fit into the 4352 bytes of arguments."""
LIBDEVICE = "nvvm/libdevice/libdevice.10.bc"


class Ptx(NamedTuple):
    """A program of threads, with the shapes and types of what one cell has."""

    operands: list[tuple]
    results: list[tuple]
    text: str
    digest: str
    """The hash of all that the text depends on, its name on disk."""


def find_ptx(
    operands: Sequence,
    results: Sequence,
    name: str | None,
    jaxpr: Callable[[], ClosedJaxpr],
    mapped: tuple[bool, ...],
    in_memory: bool,
) -> Ptx:
    """The program of a jaxpr of one cell, from disk if the trace has a name or is in memory.

    Raises `UnsupportedPrimitive` for what kernels do not support, and for functions of libdevice
    where there is none. `entry_of` has the last arguments.
    """
    source = functools.cache(lambda: source_of(jaxpr(), 0)[2])
    given, returned = shapes_and_types(operands), shapes_and_types(results)
    if len(given) + len(returned) > MAX_ARRAYS:
        raise UnsupportedPrimitive(f"more than {MAX_ARRAYS} arrays")
    entry = entry_of(given, returned, mapped, in_memory)
    linked = hashlib.sha256(libdevice() or b"").hexdigest()
    versions = llvmlite.__version__, *llvm.llvm_version_info, CARD, PTX_VERSION, linked
    digest = digest_of(repr((versions, entry, name or source())))
    text = load_or_compile(digest, lambda: ptx_of(source() + entry).encode())
    return Ptx(given, returned, text.decode(), digest)


def entry_of(operands: list, results: list, mapped: tuple[bool, ...], in_memory: bool) -> str:
    """The kernel that a card starts: (cells, addresses of operands, addresses of results).

    `mapped` says which operands have a row for each cell; all threads share the others, which a
    card then reads once for 32 of them. The number of cells is an argument, or `in_memory`.
    """
    arguments, tables = ["ptr %given" if in_memory else "i64 %cells"], []
    if in_memory:
        tables.append("  %cells = load i64, ptr %given")
    for i, (shape, _) in enumerate((*operands, *results)):
        result = i >= len(operands)
        stride = math.prod(shape) if result or mapped[i] else 0
        arguments.append(f"ptr noalias {'' if result else 'readonly '}%a{i}")
        tables.append(TABLES.format(i=i, stride=stride))
    counts = {"count": len(arguments), "threads": THREADS, "registers": REGISTERS}
    return ENTRY.format(arguments=", ".join(arguments), tables="\n".join(tables), **counts)


TABLES = """
  %address{i} = getelementptr ptr, ptr %addresses, i64 {i}
  store ptr %a{i}, ptr %address{i}
  %stride{i} = getelementptr i64, ptr %strides, i64 {i}
  store i64 {stride}, ptr %stride{i}"""
ENTRY = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
!nvvm.annotations = !{{!0}}
!0 = !{{ptr @entry, !"maxnreg", i32 {registers}}}

define ptx_kernel void @entry({arguments}) {{
  %addresses = alloca ptr, i64 {count}
  %strides = alloca i64, i64 {count}
{tables}
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
    target = llvm.Target.from_triple(TRIPLE)
    machine = target.create_target_machine(cpu=CARD, features=PTX_VERSION, opt=3)
    module = llvm.parse_assembly(source)
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    if called := list(outside(module)):
        link_libdevice(module, called)
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


def outside(module: llvm.ModuleRef) -> Iterator[llvm.ValueRef]:
    """The functions that a program calls and does not have, but for LLVM's own."""
    for function in module.functions:
        if function.is_declaration and not function.name.startswith("llvm."):
            yield function


def link_libdevice(module: llvm.ModuleRef, called: Sequence[llvm.ValueRef]) -> None:
    """Give a program the functions of the C library that it calls."""
    library = libdevice()
    if library is None:
        raise UnsupportedPrimitive(f"{called[0].name} on a GPU without libdevice")
    for function in called:
        function.name = f"__nv_{function.name}"
    functions = llvm.parse_bitcode(library)
    functions.triple, functions.data_layout = module.triple, module.data_layout
    module.link_in(functions)


@functools.cache
def libdevice() -> bytes | None:
    """The library of functions for cards, from a wheel of NVIDIA's or an installation of CUDA."""
    wheels = importlib.util.find_spec("nvidia")
    folders = wheels.submodule_search_locations if wheels else None
    parts = [part for folder in folders or () for part in sorted(Path(folder).glob("*"))]
    named = filter(None, (os.environ.get("CUDA_HOME"), os.environ.get("CUDA_PATH")))
    for root in (*parts, *map(Path, named), Path("/usr/local/cuda")):
        if (root / LIBDEVICE).is_file():
            return (root / LIBDEVICE).read_bytes()
    return None
