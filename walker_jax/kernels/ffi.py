"""Kernels as custom calls of XLA, through its foreign function interface (FFI).

XLA calls a handler with a frame that holds the buffers of operands and results. The handler here is
written in LLVM's language: it needs no compiler, and does not take Python's global lock. It serves
every kernel. It checks the type, rank and size of each buffer against the kernel's description; any
number of axes of cells come first. Then all threads of XLA's own pool compute the cells, piece by
piece. The calling thread takes pieces too, so the call completes even if the pool is busy; a task
of the pool that starts late finds no piece left and returns.

Offsets are those of the structures in `xla/ffi/api/c_api.h`, version 0.3, on 64-bit machines. Minor
versions only add to these. No custom calls are made if XLA has an older or unknown version, or
another major one.
"""

import ctypes
import functools
import hashlib
import itertools
import math
import platform
import re
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np

from walker_jax.kernels.compiled import Compiled
from walker_jax.kernels.machine import load_program

VERSION = 0, 3
"""Major version of the interface, and the smallest minor version, that the offsets hold for."""
CELLS_PER_PIECE = 64, 2**15
"""Fewest and most cells of a piece, which one thread computes without a break.

64 cells are eight vectors of float64 or more. `execution.tiles` has the same upper bound for its
calls.
"""

# xla::PrimitiveType
XLA_TYPE_CODES = {"bool": 1, "int8": 2, "int16": 3, "int32": 4, "int64": 5}
XLA_TYPE_CODES |= {"uint8": 6, "uint16": 7, "uint32": 8, "uint64": 9, "float32": 11, "float64": 12}


@functools.cache
def available() -> bool:
    """Whether the handler fits XLA's interface; warns if it does not."""
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


VERSION_PARTS = "MAJOR", "MINOR"
"""Suffixes of the macros that hold the version."""
registration_lock = threading.Lock()
registrations: dict[str, Any] = {}
"""By name, the targets that XLA may call at any time, with all memory that these use.

Equal kernels share one. None is ever removed, as it is unknown whether a program of XLA calls it.
"""


def target(compiled: Compiled) -> str:
    """The name under which XLA knows a kernel; registers the kernel on the first call."""
    buffers = [
        (XLA_TYPE_CODES[dtype.name], len(shape), math.prod(shape))
        for shape, dtype in (*compiled.operands, *compiled.results)
    ]
    # The name is the same in every process: programs that XLA keeps on disk refer to it.
    digest = hashlib.sha256(repr((compiled.digest, buffers)).encode()).hexdigest()
    name = f"walker_jax_{digest[:32]}"
    with registration_lock:
        if name not in registrations:
            registrations[name] = register(name, compiled, buffers)
    return name


def register(name: str, compiled: Compiled, buffers: list[tuple[int, int, int]]) -> Any:
    address = ctypes.cast(compiled.run, ctypes.c_void_p).value
    head = [address, len(compiled.operands), len(compiled.results), *CELLS_PER_PIECE]
    description = np.array([*head, *itertools.chain(*buffers)], np.int64)
    handler = ctypes.cast(load_handler().get_function_address("handle"), ctypes.c_void_p).value
    stub = STUB_PROGRAM.format(handler=handler, description=description.ctypes.data)
    program = load_program(stub, keep=False)
    call = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(program.get_function_address("stub"))
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(call), platform="cpu")
    jax.ffi.register_ffi_target_as_batch_partitionable(name)
    return compiled, description, program


@functools.cache
def load_handler() -> Any:
    """Compiles the handler that all kernels share."""
    x86 = platform.machine().lower() in ("x86_64", "amd64")
    rounding = {part: text if x86 else "" for part, text in ROUNDING.items()}
    pause = "" if sys.platform == "win32" else "  %yielded = call i32 @sched_yield()"
    text = HANDLER.format(
        pause=pause, message=BUFFER_MISMATCH, length=len(BUFFER_MISMATCH) + 1, **rounding
    )
    return load_program(expand_field_loads(text))


def expand_field_loads(text: str) -> str:
    """Expands each line `%x = field TYPE, ptr %s, i64 N`, which loads a value N bytes into %s."""
    return re.sub(
        r"  %(\w+) = field (\w+), ptr %(\w+), i64 (\d+)",
        r"  %\1_at = getelementptr i8, ptr %\3, i64 \4\n  %\1 = load \2, ptr %\1_at",
        text,
    )


BUFFER_MISMATCH = "a kernel was called with buffers of another type, rank or size"
STUB_PROGRAM = """
define ptr @stub(ptr %frame) {{
  %handler = inttoptr i64 {handler} to ptr
  %description = inttoptr i64 {description} to ptr
  %error = call ptr %handler(ptr %frame, ptr %description)
  ret ptr %error
}}
"""

# XLA's threads flush subnormal numbers to zero; calls of a kernel outside of XLA do not. So that
# both give the same results, a kernel turns that off while it works.
ROUNDING = {
    "declare_rounding": """
declare void @llvm.x86.sse.ldmxcsr(ptr)
declare void @llvm.x86.sse.stmxcsr(ptr)
""",
    "set_rounding": """
  %mode = alloca i32
  %exact = alloca i32
  store i32 8064, ptr %exact
  call void @llvm.x86.sse.stmxcsr(ptr %mode)
  call void @llvm.x86.sse.ldmxcsr(ptr %exact)
""",
    "reset_rounding": "  call void @llvm.x86.sse.ldmxcsr(ptr %mode)",
}

# The job of one call, in words of eight bytes: 0 the next piece; 1 cells done; 2 threads that still
# use the job; 3 cells; 4 cells of a piece; 5 the kernel; 6 its strides; 7 addresses, strides.
HANDLER = """
declare ptr @malloc(i64)
declare void @free(ptr)
declare i32 @sched_yield()
{declare_rounding}
@wrong = private constant [{length} x i8] c"{message}\\00"

define void @work(ptr %job) {{
entry:
{set_rounding}
  %done = getelementptr i64, ptr %job, i64 1
  %cells_at = getelementptr i64, ptr %job, i64 3
  %cells = load i64, ptr %cells_at
  %piece_at = getelementptr i64, ptr %job, i64 4
  %piece = load i64, ptr %piece_at
  %kernel_at = getelementptr i64, ptr %job, i64 5
  %kernel = load ptr, ptr %kernel_at
  %addresses = getelementptr i64, ptr %job, i64 7
  %strides_at = getelementptr i64, ptr %job, i64 6
  %strides = load ptr, ptr %strides_at
  br label %next
next:
  %i = atomicrmw add ptr %job, i64 1 seq_cst
  %start = mul i64 %i, %piece
  %some = icmp slt i64 %start, %cells
  br i1 %some, label %compute, label %end
compute:
  %beyond = add i64 %start, %piece
  %last = icmp slt i64 %beyond, %cells
  %stop = select i1 %last, i64 %beyond, i64 %cells
  call void %kernel(i64 %start, i64 %stop, ptr %addresses, ptr %strides)
  %count = sub i64 %stop, %start
  %before = atomicrmw add ptr %done, i64 %count seq_cst
  br label %next
end:
{reset_rounding}
  ret void
}}

define void @leave(ptr %job) {{
  %users = getelementptr i64, ptr %job, i64 2
  %left = atomicrmw sub ptr %users, i64 1 seq_cst
  %last = icmp eq i64 %left, 1
  br i1 %last, label %remove, label %end
remove:
  call void @free(ptr %job)
  ret void
end:
  ret void
}}

define void @task(ptr %job) {{
  call void @work(ptr %job)
  call void @leave(ptr %job)
  ret void
}}

define ptr @handle(ptr %frame, ptr %description) {{
entry:
  %count = alloca i64
  %threads_args = alloca [4 x i64]
  %schedule_args = alloca [5 x i64]
  %error_args = alloca [4 x i64]
  %extension = field ptr, ptr %frame, i64 8
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %run, label %extended
extended:
  %kind = field i32, ptr %extension, i64 8
  %asked = icmp eq i32 %kind, 1
  br i1 %asked, label %metadata, label %run
metadata:
  %about = field ptr, ptr %extension, i64 24
  %major_at = getelementptr i8, ptr %about, i64 24
  store i32 0, ptr %major_at
  %minor_at = getelementptr i8, ptr %about, i64 28
  store i32 3, ptr %minor_at
  ret ptr null
run:
  %api = field ptr, ptr %frame, i64 16
  %context = field ptr, ptr %frame, i64 24
  %given_args = field i64, ptr %frame, i64 56
  %given_rets = field i64, ptr %frame, i64 96
  %kernel = load ptr, ptr %description
  %args = field i64, ptr %description, i64 8
  %rets = field i64, ptr %description, i64 16
  %all = add i64 %args, %rets
  %least = field i64, ptr %description, i64 24
  %most = field i64, ptr %description, i64 32
  %as_many = icmp eq i64 %given_args, %args
  %as_many_too = icmp eq i64 %given_rets, %rets
  %counts = and i1 %as_many, %as_many_too
  br i1 %counts, label %prepare, label %refuse
prepare:
  %arg_list = field ptr, ptr %frame, i64 72
  %ret_list = field ptr, ptr %frame, i64 112
  ; the first result gives the number of cells, along any number of axes
  %first = load ptr, ptr %ret_list
  %first_rank = field i64, ptr %first, i64 32
  %first_place = mul i64 %args, 3
  %first_rank_place = add i64 %first_place, 6
  %expected_at = getelementptr i64, ptr %description, i64 %first_rank_place
  %expected = load i64, ptr %expected_at
  %one = icmp eq i64 %first_rank, %expected
  br i1 %one, label %allocate, label %higher
higher:
  %has_cells = icmp sgt i64 %first_rank, %expected
  %first_lead = sub i64 %first_rank, %expected
  %first_dims = field ptr, ptr %first, i64 40
  br i1 %has_cells, label %many, label %refuse
many:
  %first_axis = phi i64 [ 0, %higher ], [ %first_axis_next, %many ]
  %some_cells = phi i64 [ 1, %higher ], [ %all_cells, %many ]
  %length_at = getelementptr i64, ptr %first_dims, i64 %first_axis
  %length = load i64, ptr %length_at
  %all_cells = mul i64 %some_cells, %length
  %first_axis_next = add i64 %first_axis, 1
  %more_axes = icmp slt i64 %first_axis_next, %first_lead
  br i1 %more_axes, label %many, label %allocate
allocate:
  %cells = phi i64 [ 1, %prepare ], [ %all_cells, %many ]
  %slots0 = add i64 %all, %args
  %slots = add i64 %slots0, 7
  %bytes = mul i64 %slots, 8
  %job = call ptr @malloc(i64 %bytes)
  %addresses = getelementptr i64, ptr %job, i64 7
  %strides = getelementptr i64, ptr %addresses, i64 %all
  br label %each
each:
  %k = phi i64 [ 0, %allocate ], [ %k_next, %sound ]
  %more = icmp slt i64 %k, %all
  br i1 %more, label %buffer, label %launch
buffer:
  %is_arg = icmp slt i64 %k, %args
  %k_ret = sub i64 %k, %args
  %place = select i1 %is_arg, i64 %k, i64 %k_ret
  %list = select i1 %is_arg, ptr %arg_list, ptr %ret_list
  %b_at = getelementptr ptr, ptr %list, i64 %place
  %b = load ptr, ptr %b_at
  %type32 = field i32, ptr %b, i64 16
  %type = sext i32 %type32 to i64
  %data = field ptr, ptr %b, i64 24
  %rank = field i64, ptr %b, i64 32
  %dims = field ptr, ptr %b, i64 40
  %d0 = mul i64 %k, 3
  %d1 = add i64 %d0, 5
  %e_type_at = getelementptr i64, ptr %description, i64 %d1
  %e_type = load i64, ptr %e_type_at
  %e_rank = field i64, ptr %e_type_at, i64 8
  %e_size = field i64, ptr %e_type_at, i64 16
  %type_good = icmp eq i64 %type, %e_type
  %lead = sub i64 %rank, %e_rank
  %mapped = icmp sgt i64 %lead, 0
  %rank_good = icmp sge i64 %lead, 0
  %alike = and i1 %type_good, %rank_good
  br i1 %alike, label %leading, label %unlike
leading:
  br i1 %mapped, label %leads, label %common
leads:
  %own_axis = phi i64 [ 0, %leading ], [ %own_axis_next, %leads ]
  %own_part = phi i64 [ 1, %leading ], [ %own, %leads ]
  %own_dim_at = getelementptr i64, ptr %dims, i64 %own_axis
  %own_dim = load i64, ptr %own_dim_at
  %own = mul i64 %own_part, %own_dim
  %own_axis_next = add i64 %own_axis, 1
  %own_left = icmp slt i64 %own_axis_next, %lead
  br i1 %own_left, label %leads, label %cellwise
cellwise:
  %own_good = icmp eq i64 %own, %cells
  br label %sizes
common:
  ; all cells may read a shared buffer, but only one may write it
  %single = icmp eq i64 %cells, 1
  %common_good = or i1 %is_arg, %single
  br label %sizes
sizes:
  %lead_good = phi i1 [ %own_good, %cellwise ], [ %common_good, %common ]
  %stride = phi i64 [ %e_size, %cellwise ], [ 0, %common ]
  br label %multiply
multiply:
  %axis = phi i64 [ %lead, %sizes ], [ %axis_next, %factor ]
  %size = phi i64 [ 1, %sizes ], [ %size_next, %factor ]
  %axes_left = icmp slt i64 %axis, %rank
  br i1 %axes_left, label %factor, label %compare
factor:
  %dim_at = getelementptr i64, ptr %dims, i64 %axis
  %dim = load i64, ptr %dim_at
  %size_next = mul i64 %size, %dim
  %axis_next = add i64 %axis, 1
  br label %multiply
compare:
  %size_good = icmp eq i64 %size, %e_size
  %good = and i1 %size_good, %lead_good
  br i1 %good, label %note, label %unlike
note:
  %address_at = getelementptr ptr, ptr %addresses, i64 %k
  store ptr %data, ptr %address_at
  br i1 %is_arg, label %note_stride, label %sound
note_stride:
  %stride_at = getelementptr i64, ptr %strides, i64 %k
  store i64 %stride, ptr %stride_at
  br label %sound
sound:
  %k_next = add i64 %k, 1
  br label %each
unlike:
  call void @free(ptr %job)
  br label %refuse

launch:
  %few = icmp sle i64 %cells, %least
  br i1 %few, label %alone, label %pool
pool:
  %t0 = getelementptr i64, ptr %threads_args, i64 0
  store i64 32, ptr %t0
  %t1 = getelementptr i64, ptr %threads_args, i64 1
  store ptr null, ptr %t1
  %t2 = getelementptr i64, ptr %threads_args, i64 2
  store ptr %context, ptr %t2
  %t3 = getelementptr i64, ptr %threads_args, i64 3
  store ptr %count, ptr %t3
  store i64 1, ptr %count
  %ask = field ptr, ptr %api, i64 144
  %no_pool = call ptr %ask(ptr %threads_args)
  %pooled = icmp eq ptr %no_pool, null
  br i1 %pooled, label %share, label %forget
forget:
  call void @dismiss(ptr %api, ptr %no_pool)
  br label %alone
share:
  %threads0 = load i64, ptr %count
  %threads_low = icmp slt i64 %threads0, 1
  %threads = select i1 %threads_low, i64 1, i64 %threads0
  ; several pieces for each thread, so that all end at about the same time
  %parts = mul i64 %threads, 4
  %rounded = add i64 %cells, %parts
  %rounded1 = sub i64 %rounded, 1
  %even = sdiv i64 %rounded1, %parts
  %small = icmp slt i64 %even, %least
  %larger = select i1 %small, i64 %least, i64 %even
  %large = icmp sgt i64 %larger, %most
  %piece_shared = select i1 %large, i64 %most, i64 %larger
  %up = add i64 %cells, %piece_shared
  %up1 = sub i64 %up, 1
  %pieces = sdiv i64 %up1, %piece_shared
  %fewer = icmp slt i64 %pieces, %threads
  %workers = select i1 %fewer, i64 %pieces, i64 %threads
  %others_shared = sub i64 %workers, 1
  br label %go
alone:
  br label %go
go:
  %piece = phi i64 [ %piece_shared, %share ], [ %cells, %alone ]
  %others = phi i64 [ %others_shared, %share ], [ 0, %alone ]
  %done = getelementptr i64, ptr %job, i64 1
  %users = getelementptr i64, ptr %job, i64 2
  %cells_at = getelementptr i64, ptr %job, i64 3
  %piece_at = getelementptr i64, ptr %job, i64 4
  %kernel_at = getelementptr i64, ptr %job, i64 5
  %strides_at = getelementptr i64, ptr %job, i64 6
  store i64 0, ptr %job
  store i64 0, ptr %done
  %everyone = add i64 %others, 1
  store i64 %everyone, ptr %users
  store i64 %cells, ptr %cells_at
  store i64 %piece, ptr %piece_at
  store ptr %kernel, ptr %kernel_at
  store ptr %strides, ptr %strides_at
  %s0 = getelementptr i64, ptr %schedule_args, i64 0
  store i64 40, ptr %s0
  %s1 = getelementptr i64, ptr %schedule_args, i64 1
  store ptr null, ptr %s1
  %s2 = getelementptr i64, ptr %schedule_args, i64 2
  store ptr %context, ptr %s2
  %s3 = getelementptr i64, ptr %schedule_args, i64 3
  store ptr @task, ptr %s3
  %s4 = getelementptr i64, ptr %schedule_args, i64 4
  store ptr %job, ptr %s4
  %schedule_at = getelementptr i8, ptr %api, i64 136
  br label %hire
hire:
  %hired = phi i64 [ 0, %go ], [ %hired_next, %counted ]
  %wanted = icmp slt i64 %hired, %others
  br i1 %wanted, label %schedule, label %join
schedule:
  %hired_next = add i64 %hired, 1
  %enlist = load ptr, ptr %schedule_at
  %refusal = call ptr %enlist(ptr %schedule_args)
  %hired_one = icmp eq ptr %refusal, null
  br i1 %hired_one, label %counted, label %without
without:
  call void @dismiss(ptr %api, ptr %refusal)
  %fewer_users = atomicrmw sub ptr %users, i64 1 seq_cst
  br label %counted
counted:
  br label %hire
join:
  call void @work(ptr %job)
  br label %wait
wait:
  %finished = load atomic i64, ptr %done seq_cst, align 8
  %complete = icmp sge i64 %finished, %cells
  br i1 %complete, label %finish, label %pause
pause:
{pause}
  br label %wait
finish:
  call void @leave(ptr %job)
  ret ptr null

refuse:
  %r0 = getelementptr i64, ptr %error_args, i64 0
  store i64 28, ptr %r0
  %r1 = getelementptr i64, ptr %error_args, i64 1
  store ptr null, ptr %r1
  %r2 = getelementptr i64, ptr %error_args, i64 2
  store ptr @wrong, ptr %r2
  %r3 = getelementptr i64, ptr %error_args, i64 3
  store i64 3, ptr %r3
  %create = field ptr, ptr %api, i64 48
  %error = call ptr %create(ptr %error_args)
  ret ptr %error
}}

define void @dismiss(ptr %api, ptr %error) {{
  %args = alloca [3 x i64]
  store i64 24, ptr %args
  %a1 = getelementptr i64, ptr %args, i64 1
  store ptr null, ptr %a1
  %a2 = getelementptr i64, ptr %args, i64 2
  store ptr %error, ptr %a2
  %destroy = field ptr, ptr %api, i64 64
  call void %destroy(ptr %args)
  ret void
}}
"""
