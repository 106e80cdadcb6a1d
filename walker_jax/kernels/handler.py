"""The handler that XLA calls for every kernel, as a program of LLVM.

XLA calls `handle` with a frame of the buffers of operands and results. `prepare` checks the type,
rank and size of each against the kernel's description; any number of axes of cells may come first.
It notes their addresses in a job. Then all threads of XLA's pool `work` on the job, piece by piece.
The calling thread takes pieces too, so the call completes even if the pool is busy; a task of the
pool that starts late finds no piece left and returns.

Three short forms are expanded before LLVM reads the program: `field` and `put` load and store a
value at a byte offset in a structure, and `item` loads an entry of an array.

The handler for GPUs (`launcher`) shares the parts `CALLED` and `HELPERS`.

Offsets are those of the structures in `xla/ffi/api/c_api.h`, version 0.3, on 64-bit machines. Minor
versions only add to these structures.
"""

import functools
import itertools
import platform
import re
import sys
from typing import Any

from walker_jax.kernels.machine import load_program

VERSION = 0, 3
"""Major version of the interface and smallest minor version for which the offsets hold."""
BUFFER_MISMATCH = "a kernel was called with buffers of another type, rank or size"


@functools.cache
def load_handler() -> Any:
    """Compile the handler, once for all kernels on a CPU."""
    x86 = platform.machine().lower() in ("x86_64", "amd64")
    rounding = {part: text if x86 else "" for part, text in ROUNDING.items()}
    pause = "" if sys.platform == "win32" else "  %yielded = call i32 @sched_yield()"
    parts = {"compute": COMPUTE, "pause": pause, **rounding}
    return load_program(fill_in(DECLARATIONS + CALLED + POOL + HELPERS, **parts))


def fill_in(text: str, **parts: str) -> str:
    """Fill in the parts of a program, and expand its short forms."""
    message = {"message": BUFFER_MISMATCH, "length": len(BUFFER_MISMATCH) + 1}
    return expand_short_forms(text.format(version=VERSION, **message, **parts))


def expand_short_forms(text: str) -> str:
    """Expand lines with `field`, `put` and `item` to LLVM's instructions."""
    names = map("%place{}".format, itertools.count())

    def expand(found: re.Match) -> str:
        place, (result, form, value, pointer, index) = next(names), found.groups()
        unit = value if form == "item" else "i8"
        access = f"store {value}" if form == "put" else f"{result}load {value}"
        return f"  {place} = getelementptr {unit}, {pointer}, {index}\n  {access}, ptr {place}"

    form = r"  (%\w+ = )?(field|put|item) ([^,\n]+), (ptr %\w+), (i64 [%\w]+)"
    return re.sub(form, expand, text)


# XLA's threads flush subnormal numbers to zero; calls of a kernel outside XLA do not. So a kernel
# turns that off while it works, and both give the same results.
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

# The job of one call, byte by byte: 0 the next piece; 8 cells done; 16 threads that still use the
# job; 24 cells; 32 cells of a piece; 40 the kernel; 48 its strides; 56 addresses, then strides.
# The description of a kernel, word by word: 0 its code; 1 operands; 2 results; 3 fewest cells of a
# piece and 4 most; then for each operand and result its type, its rank and its size.
DECLARATIONS = """
declare ptr @malloc(i64)
declare void @free(ptr)
declare i32 @sched_yield()
declare i64 @llvm.smin.i64(i64, i64)
declare i64 @llvm.smax.i64(i64, i64)
{declare_rounding}"""
CALLED = """
@wrong = private constant [{length} x i8] c"{message}\\00"

define ptr @handle(ptr %frame, ptr %description) {{
entry:
  %extension = field ptr, ptr %frame, i64 8
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %run, label %extended
extended:
  %kind = field i32, ptr %extension, i64 8
  %asked = icmp eq i32 %kind, 1
  br i1 %asked, label %metadata, label %run
metadata:
  %about = field ptr, ptr %extension, i64 24
  put i32 {version[0]}, ptr %about, i64 24
  put i32 {version[1]}, ptr %about, i64 28
  ret ptr null
run:
  %api = field ptr, ptr %frame, i64 16
  %job = call ptr @prepare(ptr %frame, ptr %description)
  %wrong = icmp eq ptr %job, null
  br i1 %wrong, label %refuse, label %compute
compute:
{compute}
refuse:
  %error = call ptr @refuse(ptr %api, ptr @wrong, i64 3)
  ret ptr %error
}}

define ptr @prepare(ptr %frame, ptr %description) {{
entry:
  %given_args = field i64, ptr %frame, i64 56
  %given_rets = field i64, ptr %frame, i64 96
  %args = field i64, ptr %description, i64 8
  %rets = field i64, ptr %description, i64 16
  %as_many_args = icmp eq i64 %given_args, %args
  %as_many_rets = icmp eq i64 %given_rets, %rets
  %as_many = and i1 %as_many_args, %as_many_rets
  br i1 %as_many, label %allocate, label %refuse
allocate:
  %all = add i64 %args, %rets
  %words = mul i64 %all, 16
  %bytes = add i64 %words, 56
  %job = call ptr @malloc(i64 %bytes)
  %addresses = getelementptr i8, ptr %job, i64 56
  %strides = getelementptr i64, ptr %addresses, i64 %all
  ; the first result gives the number of cells, along any number of axes
  %arg_list = field ptr, ptr %frame, i64 72
  %ret_list = field ptr, ptr %frame, i64 112
  %first = load ptr, ptr %ret_list
  %first_rank = field i64, ptr %first, i64 32
  %first_dims = field ptr, ptr %first, i64 40
  %first_row = mul i64 %args, 3
  %first_place = add i64 %first_row, 6
  %first_own = item i64, ptr %description, i64 %first_place
  %first_lead = sub i64 %first_rank, %first_own
  %cells = call i64 @product(ptr %first_dims, i64 0, i64 %first_lead)
  br label %each
each:
  %k = phi i64 [ 0, %allocate ], [ %k_next, %note ]
  %more = icmp slt i64 %k, %all
  br i1 %more, label %buffer, label %ready
buffer:
  %is_arg = icmp slt i64 %k, %args
  %k_ret = sub i64 %k, %args
  %place = select i1 %is_arg, i64 %k, i64 %k_ret
  %list = select i1 %is_arg, ptr %arg_list, ptr %ret_list
  %given = item ptr, ptr %list, i64 %place
  %type32 = field i32, ptr %given, i64 16
  %type = sext i32 %type32 to i64
  %data = field ptr, ptr %given, i64 24
  %rank = field i64, ptr %given, i64 32
  %dims = field ptr, ptr %given, i64 40
  %row = mul i64 %k, 3
  %expected = getelementptr i64, ptr %description, i64 %row
  %own_type = field i64, ptr %expected, i64 40
  %own_rank = field i64, ptr %expected, i64 48
  %own_size = field i64, ptr %expected, i64 56
  %lead = sub i64 %rank, %own_rank
  %type_good = icmp eq i64 %type, %own_type
  %rank_good = icmp sge i64 %lead, 0
  %alike = and i1 %type_good, %rank_good
  br i1 %alike, label %measure, label %unlike
measure:
  %size = call i64 @product(ptr %dims, i64 %lead, i64 %rank)
  %size_good = icmp eq i64 %size, %own_size
  %own_cells = call i64 @product(ptr %dims, i64 0, i64 %lead)
  %as_many_cells = icmp eq i64 %own_cells, %cells
  ; all cells may read a shared buffer, but only one may write it
  %shared = icmp eq i64 %lead, 0
  %shared_arg = and i1 %shared, %is_arg
  %cells_good = or i1 %as_many_cells, %shared_arg
  %good = and i1 %size_good, %cells_good
  br i1 %good, label %note, label %unlike
note:
  %address_at = getelementptr ptr, ptr %addresses, i64 %k
  store ptr %data, ptr %address_at
  %stride = select i1 %shared, i64 0, i64 %own_size
  %stride_at = getelementptr i64, ptr %strides, i64 %k
  store i64 %stride, ptr %stride_at
  %k_next = add i64 %k, 1
  br label %each
ready:
  %kernel = load ptr, ptr %description
  put i64 0, ptr %job, i64 0
  put i64 0, ptr %job, i64 8
  put i64 %cells, ptr %job, i64 24
  put ptr %kernel, ptr %job, i64 40
  put ptr %strides, ptr %job, i64 48
  ret ptr %job
unlike:
  call void @free(ptr %job)
  br label %refuse
refuse:
  ret ptr null
}}
"""
COMPUTE = """  call void @compute(ptr %frame, ptr %description, ptr %job)
  ret ptr null"""
POOL = """
define void @compute(ptr %frame, ptr %description, ptr %job) {{
entry:
  %api = field ptr, ptr %frame, i64 16
  %context = field ptr, ptr %frame, i64 24
  %least = field i64, ptr %description, i64 24
  %most = field i64, ptr %description, i64 32
  %cells = field i64, ptr %job, i64 24
  %count = alloca i64
  %threads_args = alloca [4 x i64]
  %schedule_args = alloca [5 x i64]
  %few = icmp sle i64 %cells, %least
  br i1 %few, label %go, label %pool
pool:
  put i64 32, ptr %threads_args, i64 0
  put ptr null, ptr %threads_args, i64 8
  put ptr %context, ptr %threads_args, i64 16
  put ptr %count, ptr %threads_args, i64 24
  store i64 1, ptr %count
  %ask = field ptr, ptr %api, i64 144
  %no_pool = call ptr %ask(ptr %threads_args)
  %pooled = icmp eq ptr %no_pool, null
  br i1 %pooled, label %share, label %alone
alone:
  call void @dismiss(ptr %api, ptr %no_pool)
  br label %go
share:
  ; several pieces for each thread, so that all end at about the same time
  %counted_threads = load i64, ptr %count
  %threads = call i64 @llvm.smax.i64(i64 %counted_threads, i64 1)
  %parts = mul i64 %threads, 4
  %even = call i64 @divide_up(i64 %cells, i64 %parts)
  %larger = call i64 @llvm.smax.i64(i64 %even, i64 %least)
  %piece_shared = call i64 @llvm.smin.i64(i64 %larger, i64 %most)
  %pieces = call i64 @divide_up(i64 %cells, i64 %piece_shared)
  %workers = call i64 @llvm.smin.i64(i64 %pieces, i64 %threads)
  br label %go
go:
  %piece = phi i64 [ %cells, %entry ], [ %cells, %alone ], [ %piece_shared, %share ]
  %users = phi i64 [ 1, %entry ], [ 1, %alone ], [ %workers, %share ]
  put i64 %users, ptr %job, i64 16
  put i64 %piece, ptr %job, i64 32
  put i64 40, ptr %schedule_args, i64 0
  put ptr null, ptr %schedule_args, i64 8
  put ptr %context, ptr %schedule_args, i64 16
  put ptr @task, ptr %schedule_args, i64 24
  put ptr %job, ptr %schedule_args, i64 32
  br label %hire
hire:
  %hired = phi i64 [ 1, %go ], [ %hired_next, %schedule ], [ %hired_next, %without ]
  %wanted = icmp slt i64 %hired, %users
  br i1 %wanted, label %schedule, label %join
schedule:
  %hired_next = add i64 %hired, 1
  %enlist = field ptr, ptr %api, i64 136
  %refusal = call ptr %enlist(ptr %schedule_args)
  %enlisted = icmp eq ptr %refusal, null
  br i1 %enlisted, label %hire, label %without
without:
  call void @dismiss(ptr %api, ptr %refusal)
  call void @leave(ptr %job)
  br label %hire
join:
  call void @work(ptr %job)
  %done = getelementptr i8, ptr %job, i64 8
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
  ret void
}}

define void @task(ptr %job) {{
  call void @work(ptr %job)
  call void @leave(ptr %job)
  ret void
}}

define void @work(ptr %job) {{
entry:
{set_rounding}
  %cells = field i64, ptr %job, i64 24
  %piece = field i64, ptr %job, i64 32
  %kernel = field ptr, ptr %job, i64 40
  %strides = field ptr, ptr %job, i64 48
  %addresses = getelementptr i8, ptr %job, i64 56
  %done = getelementptr i8, ptr %job, i64 8
  br label %next
next:
  %i = atomicrmw add ptr %job, i64 1 seq_cst
  %start = mul i64 %i, %piece
  %some = icmp slt i64 %start, %cells
  br i1 %some, label %compute, label %end
compute:
  %beyond = add i64 %start, %piece
  %stop = call i64 @llvm.smin.i64(i64 %beyond, i64 %cells)
  call void %kernel(i64 %start, i64 %stop, ptr %addresses, ptr %strides)
  %count = sub i64 %stop, %start
  %before = atomicrmw add ptr %done, i64 %count seq_cst
  br label %next
end:
{reset_rounding}
  ret void
}}

define void @leave(ptr %job) {{
  %users = getelementptr i8, ptr %job, i64 16
  %left = atomicrmw sub ptr %users, i64 1 seq_cst
  %last = icmp eq i64 %left, 1
  br i1 %last, label %remove, label %end
remove:
  call void @free(ptr %job)
  ret void
end:
  ret void
}}
"""
HELPERS = """
define i64 @product(ptr %numbers, i64 %from, i64 %to) {{
entry:
  br label %next
next:
  %i = phi i64 [ %from, %entry ], [ %i_next, %multiply ]
  %product = phi i64 [ 1, %entry ], [ %product_next, %multiply ]
  %more = icmp slt i64 %i, %to
  br i1 %more, label %multiply, label %end
multiply:
  %number = item i64, ptr %numbers, i64 %i
  %product_next = mul i64 %product, %number
  %i_next = add i64 %i, 1
  br label %next
end:
  ret i64 %product
}}

define i64 @divide_up(i64 %number, i64 %by) {{
  %sum = add i64 %number, %by
  %less = sub i64 %sum, 1
  %quotient = sdiv i64 %less, %by
  ret i64 %quotient
}}

define ptr @refuse(ptr %api, ptr %message, i64 %code) {{
  %args = alloca [4 x i64]
  put i64 28, ptr %args, i64 0
  put ptr null, ptr %args, i64 8
  put ptr %message, ptr %args, i64 16
  put i64 %code, ptr %args, i64 24
  %create = field ptr, ptr %api, i64 48
  %error = call ptr %create(ptr %args)
  ret ptr %error
}}

define void @dismiss(ptr %api, ptr %error) {{
  %args = alloca [3 x i64]
  put i64 24, ptr %args, i64 0
  put ptr null, ptr %args, i64 8
  put ptr %error, ptr %args, i64 16
  %destroy = field ptr, ptr %api, i64 64
  call void %destroy(ptr %args)
  ret void
}}
"""
