"""Programs for NVIDIA GPUs: one thread computes one cell.

The emitter writes the program of a cell with one lane. An entry point gives each thread its cell.
LLVM compiles both to PTX, the assembly language that NVIDIA's driver translates for the card at
hand. Sines and the like come from libdevice, a library in JAX's CUDA wheels; it is linked only if a
program calls one of its functions.
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
from walker_jax.kernels.machine import hash_source
from walker_jax.kernels.object_cache import load_or_compile

TRIPLE, CARD, PTX_VERSION = "nvptx64-nvidia-cuda", "sm_70", "+ptx60"
"""The oldest supported cards, from 2017, and the first PTX version for them. A driver accepts PTX
no newer than itself, and translates it for any newer card; newer PTX makes XLA end the process. A
newer target needs as many registers, according to `ptxas`."""
THREADS = 64, 256
"""Threads of a block that runs a small program, and a large one.

A block ends with its slowest cell, so it has only two warps if a multiprocessor's cache holds the
program. Threads of a large program wait for instructions most of all. Then a block has as many
threads as there are registers for: they begin together, and need the same instructions at about
the same time. On an H100 such blocks make 1.2 (point feet) and 1.5 times (round feet) as many
strides as small ones, and of the simplest walker as many."""
CACHED = 5000
"""Instructions of PTX of a small program. The card has 1.4 times as many, of 16 bytes, for which
its cache has 128 KB. In float64 a stride of the simplest walker has 4,000, and one with point feet
7,000."""
REGISTERS = 255
"""Most 32-bit registers of a thread, the hardware's limit. The 65,536 registers of a multiprocessor
then hold 256 threads. With 168 registers they hold 384, which hides more waiting, but numbers
without a register go through memory. On an H100 the simplest walker in float64 makes 1.03 times as
many strides with 168, and walkers with masses make half as many or fewer."""
MAX_ARRAYS = 500
"""Most operands and results: all their addresses must fit into the 4352 bytes of arguments."""
LIBDEVICE = "nvvm/libdevice/libdevice.10.bc"


class Ptx(NamedTuple):
    """A program of threads, with the shapes and types of one cell's operands and results."""

    operands: list[tuple]
    results: list[tuple]
    text: str
    digest: str
    """The hash of all that the text depends on; its name on disk."""

    @property
    def threads(self) -> int:
        """Threads of a block."""
        small, large = THREADS
        return small if self.text.count(";\n") <= CACHED else large


def find_ptx(
    operands: Sequence,
    results: Sequence,
    name: str | None,
    jaxpr: Callable[[], ClosedJaxpr],
    mapped: tuple[bool, ...],
    in_memory: bool,
) -> Ptx:
    """Compile the jaxpr of one cell for a GPU, or load the program from disk if its name is known.

    Raises `UnsupportedPrimitive` for what kernels do not support, and for functions of libdevice
    if there is none. `entry_of` explains the last arguments.
    """
    source = functools.cache(lambda: source_of(jaxpr(), 0)[2])
    given, returned = shapes_and_types(operands), shapes_and_types(results)
    if len(given) + len(returned) > MAX_ARRAYS:
        raise UnsupportedPrimitive(f"more than {MAX_ARRAYS} arrays")
    entry = entry_of(given, returned, mapped, in_memory)
    linked = hashlib.sha256(libdevice() or b"").hexdigest()
    versions = llvmlite.__version__, *llvm.llvm_version_info, CARD, PTX_VERSION, linked
    digest = hash_source(repr((versions, entry, name or source())))
    text = load_or_compile(digest, lambda: ptx_of(source() + entry).encode())
    return Ptx(given, returned, text.decode(), digest)


def entry_of(operands: list, results: list, mapped: tuple[bool, ...], in_memory: bool) -> str:
    """Write the entry point: (cells, addresses of operands, addresses of results).

    `mapped` marks the operands with a row for each cell. All threads share the others, and a card
    reads these once for 32 threads. The number of cells is an argument, or `in_memory`.
    """
    arguments, tables = ["ptr %given" if in_memory else "i64 %cells"], []
    if in_memory:
        tables.append("  %cells = load i64, ptr %given")
    for i, (shape, _) in enumerate((*operands, *results)):
        result = i >= len(operands)
        stride = math.prod(shape) if result or mapped[i] else 0
        arguments.append(f"ptr noalias {'' if result else 'readonly '}%a{i}")
        tables.append(TABLES.format(i=i, stride=stride))
    counts = {"count": len(arguments), "registers": REGISTERS}
    return ENTRY.format(arguments=", ".join(arguments), tables="\n".join(tables), **counts)


TABLES = """
  %address{i} = getelementptr ptr, ptr %addresses, i64 {i}
  store ptr %a{i}, ptr %address{i}
  %stride{i} = getelementptr i64, ptr %strides, i64 {i}
  store i64 {stride}, ptr %stride{i}"""
ENTRY = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
!nvvm.annotations = !{{!0}}
!0 = !{{ptr @entry, !"maxnreg", i32 {registers}}}

define ptx_kernel void @entry({arguments}) {{
  %addresses = alloca ptr, i64 {count}
  %strides = alloca i64, i64 {count}
{tables}
  %thread32 = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %block32 = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %threads32 = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %thread = zext i32 %thread32 to i64
  %block = zext i32 %block32 to i64
  %threads = zext i32 %threads32 to i64
  %first = mul i64 %block, %threads
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
    """Compile a program and its entry point to PTX, as one function."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(TRIPLE)
    machine = target.create_target_machine(cpu=CARD, features=PTX_VERSION, opt=3)
    module = llvm.parse_assembly(source)
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    if called := list(external_functions(module)):
        link_libdevice(module, called)
    for function in module.functions:
        if not function.is_declaration and function.name != "entry":
            function.linkage = "internal"
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    for missing in external_functions(module):
        raise UnsupportedPrimitive(f"{missing.name} on a GPU")
    return machine.emit_assembly(module)


def external_functions(module: llvm.ModuleRef) -> Iterator[llvm.ValueRef]:
    """Yield the functions that a program calls but does not define, except LLVM's own."""
    for function in module.functions:
        if function.is_declaration and not function.name.startswith("llvm."):
            yield function


def link_libdevice(module: llvm.ModuleRef, called: Sequence[llvm.ValueRef]) -> None:
    """Link the functions of the C library that a program calls."""
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
    """Read libdevice from one of NVIDIA's wheels or an installation of CUDA; None if not found."""
    wheels = importlib.util.find_spec("nvidia")
    folders = wheels.submodule_search_locations if wheels else None
    parts = [part for folder in folders or () for part in sorted(Path(folder).glob("*"))]
    named = filter(None, (os.environ.get("CUDA_HOME"), os.environ.get("CUDA_PATH")))
    for root in (*parts, *map(Path, named), Path("/usr/local/cuda")):
        if (root / LIBDEVICE).is_file():
            return (root / LIBDEVICE).read_bytes()
    return None
