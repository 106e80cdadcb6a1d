"""Programs of LLVM as machine code for the processor at hand, compiled once and kept on disk."""

import hashlib

import llvmlite
import llvmlite.binding as llvm

from walker_jax.kernels.object_cache import cached

LEVEL = 2
"""Of the effort that LLVM spends on machine code, as in `clang -O2`."""
PASSES = ()
"""Over the program before that: none. The emitter computes nothing twice; with those of `clang -O2`
programs take half as long again to compile, and run no faster."""


def load_program(source: str, *, keep: bool = True) -> llvm.ExecutionEngine:
    """What holds the machine code of a program, for this processor; `keep` it on disk too."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    triple, processor = llvm.get_process_triple(), llvm.get_host_cpu_name()
    features = llvm.get_host_cpu_features().flatten()
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu=processor, features=features, opt=LEVEL, jit=True
    )
    versions = llvmlite.__version__, *llvm.llvm_version_info
    all_it_depends_on = repr((versions, triple, processor, features, LEVEL, PASSES, source))
    name = hashlib.sha256(all_it_depends_on.encode()).hexdigest()
    compile_it = lambda: object_code(source, machine)
    code = cached(name, compile_it) if keep else compile_it()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def object_code(source: str, machine: llvm.TargetMachine) -> bytes:
    """A program, compiled, with the C library's functions still to be linked."""
    module = llvm.parse_assembly(source)
    module.verify()
    return machine.emit_object(module)
