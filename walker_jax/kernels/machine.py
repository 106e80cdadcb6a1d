"""Machine code of LLVM programs for this machine's processor, compiled once and kept on disk."""

import functools
import hashlib
import os
import platform
import subprocess
import sys
import threading
import zlib

import llvmlite
import llvmlite.binding as llvm

from walker_jax.checks import WrongUse
from walker_jax.kernels.object_cache import load_or_compile, recall

QUICK, OPTIMISED = 0, 2
"""Two of LLVM's levels of code generation, as in `clang -O0` and `clang -O2`."""

VARIABLE = "WALKER_JAX_KERNELS"
"""The environment variable that configures kernels. `off` turns them off, and `cpu` turns off those
for GPUs only. LLVM's name of a processor compiles for that one instead of this machine's (`haswell`
has no AVX-512, `x86-64` no AVX)."""


def setting() -> str:
    """Return what the user wants of kernels: `off`, `cpu`, a processor's name, or nothing."""
    return os.environ.get(VARIABLE, "").lower()


def switched_off() -> bool:
    """Return whether XLA alone is to compute everything."""
    return setting() == "off"


def on_gpus() -> bool:
    """Return whether kernels are to run on GPUs too."""
    return setting() not in ("off", "cpu")


def processor() -> tuple[str, str]:
    """Return LLVM's name of the processor that kernels are compiled for, and its features."""
    named = os.environ.get(VARIABLE)
    if named and setting() != "cpu":
        check_processor(named)
        return named, ""
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


@functools.cache
def check_processor(name: str) -> None:
    """Refuse a processor that LLVM does not know, or cannot compile such programs for.

    Another process tries it, as LLVM only writes to standard error, or ends the process.
    """
    done = subprocess.run([sys.executable, "-c", TRIAL, name], capture_output=True, text=True)
    if done.returncode or "not a recognized processor" in done.stderr:
        raise WrongUse(
            f"{VARIABLE} must be off, cpu, or a processor that LLVM knows, such as "
            f"{llvm.get_host_cpu_name()}, not {name}: unset it for this machine's own"
        )


TRIAL = """
import sys
import llvmlite.binding as llvm
llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
triple = llvm.get_process_triple()
machine = llvm.Target.from_triple(triple).create_target_machine(cpu=sys.argv[1], jit=True)
machine.emit_object(llvm.parse_assembly("define void @f() { ret void }"))
"""
"""A program that compiles something for the processor named by its argument."""


def register_bits() -> int:
    """Return the size of the processor's vector registers: 512 with AVX-512, 256 with AVX."""
    return bits_of(*processor())


@functools.cache
def bits_of(name: str, features: str) -> int:
    """Find `register_bits` of a processor from the registers in which LLVM adds two vectors."""
    machine = target_machine(name, features)
    added = machine.emit_assembly(llvm.parse_assembly(SUM))
    return next((bits for bits, register in REGISTERS.items() if register in added), 128)


SUM = """
define <8 x double> @add(<8 x double> %a, <8 x double> %b) {
  %sum = fadd <8 x double> %a, %b
  ret <8 x double> %sum
}
"""
REGISTERS = {512: "zmm", 256: "ymm"}
"""Register names on x86. Other processors, and x86 without AVX, have vectors of 128 bits."""


def load_program(source: str, level: int = OPTIMISED, *, keep: bool = True) -> llvm.ExecutionEngine:
    """Compile a program for this processor, or load its machine code from disk.

    `keep` says whether the code is stored on disk.
    """
    machine = target_machine(*processor(), level)
    compile = lambda: object_code(source, machine)
    code = load_or_compile(code_name(hash_source(source), level), compile) if keep else compile()
    return link(code, machine)


def recall_program(digest: str) -> tuple[llvm.ExecutionEngine, bytes] | None:
    """Load the program whose source has this digest, and its optimised code, if that is on disk."""
    code = recall(code_name(digest))
    return None if code is None else (link(code, target_machine(*processor())), code)


def keep_source(source: str) -> None:
    """Store the source of a program on disk, if possible, so that it can be optimised later."""
    compress = lambda: zlib.compress(source.encode(), 1)
    load_or_compile(code_name(hash_source(source), "source"), compress)


def recall_source(digest: str) -> str | None:
    """Read the source with this digest from disk, if it is there."""
    found = recall(code_name(digest, "source"))
    return None if found is None else zlib.decompress(found).decode()


@functools.cache
def allows_quick_code() -> bool:
    """Return whether code that is not optimised may run here.

    It computes the same bits on x86. For other processors LLVM then chooses instructions by other
    rules, and so fuses other products with sums. The stack of a thread must be of the usual 8 MiB.
    """
    if not llvm.get_process_triple().startswith(("x86_64", "amd64")):
        return False
    if sys.platform != "linux" or platform.libc_ver()[0] != "glibc":
        return False
    import resource  # not on Windows

    stack, given = resource.getrlimit(resource.RLIMIT_STACK)[0], threading.stack_size()
    least = 2**23
    return (stack == resource.RLIM_INFINITY or stack >= least) and (given == 0 or given >= least)


def hash_source(source: str) -> str:
    return hashlib.sha256(source.encode()).hexdigest()


def code_name(digest: str, what: int | str = OPTIMISED) -> str:
    """Return the name on disk of a program's code of a level, or of its source.

    It is for this processor and these versions.
    """
    versions = llvmlite.__version__, *llvm.llvm_version_info
    processor_code = llvm.get_process_triple(), *processor(), what, "no passes"
    all_it_depends_on = repr((versions, *processor_code, digest))
    return hashlib.sha256(all_it_depends_on.encode()).hexdigest()


def target_machine(name: str, features: str, level: int = OPTIMISED) -> llvm.TargetMachine:
    """Return LLVM's description of a processor."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=name, features=features, opt=level, jit=True
    )


def link(code: bytes, machine: llvm.TargetMachine) -> llvm.ExecutionEngine:
    """Load object code into this process."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def object_code(source: str, machine: llvm.TargetMachine) -> bytes:
    """Compile a program to object code, without linking the C library's functions.

    LLVM's optimisation passes are omitted, as the emitter computes nothing twice: with those of
    `clang -O2`, compilation takes half as long again, and the programs run no faster.
    """
    module = llvm.parse_assembly(source)
    module.verify()
    return machine.emit_object(module)
