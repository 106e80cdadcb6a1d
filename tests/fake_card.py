"""A driver and a card that are not there: a program of threads is run by a processor, thread by
thread, with the arguments of its launch.

XLA's handler for GPUs is compiled and called as on a GPU, with buffers of a CPU. The driver that it
calls is this file's. What a card would be given is kept in `launches`.
"""

import ctypes
import re
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from jax.interpreters import mlir

from walker_jax.kernels import ffi, gpu, launcher, primitive, program, ptx
from walker_jax.kernels.machine import load_program

STREAM = 0xABC0


class Launch(NamedTuple):
    """The arguments of a launch."""

    grid: tuple[int, ...]
    block: tuple[int, ...]
    shared_memory: int
    stream: int
    cells: int
    addresses: list[int]


WORDS = ctypes.POINTER(ctypes.c_uint64)
INT, UINT, ANY, TEXT = ctypes.c_int, ctypes.c_uint, ctypes.c_void_p, ctypes.c_char_p
INIT = ctypes.CFUNCTYPE(INT, UINT)
LOAD = ctypes.CFUNCTYPE(INT, ANY, TEXT, ANY, ANY, UINT, ANY, ANY, UINT)
GET_KERNEL = ctypes.CFUNCTYPE(INT, ANY, ANY, TEXT)
LAUNCH = ctypes.CFUNCTYPE(INT, ANY, *[UINT] * 7, ANY, ctypes.POINTER(WORDS), ANY)
GET_WORDS = ctypes.CFUNCTYPE(INT, INT, ANY)
GET_STREAM = ctypes.CFUNCTYPE(ANY, WORDS)
"""Signatures of cuda.h, and of XLA's function for a stream."""

# One thread after the other. The registers in which a card has its numbers are variables here.
THREADS = """
@thread = internal global i32 0
@block = internal global i32 0
define internal i32 @number_of_thread() {{
  %n = load i32, ptr @thread
  ret i32 %n
}}
define internal i32 @number_of_block() {{
  %n = load i32, ptr @block
  ret i32 %n
}}
define void @run(i32 %block, i32 %thread, {arguments}) {{
  store i32 %block, ptr @block
  store i32 %thread, ptr @thread
  call void @entry({given})
  ret void
}}
"""


class Card:
    """A card whose driver can fail."""

    def __init__(self):
        self.launches: list[Launch] = []
        self.sources: dict[str, str] = {}
        """By PTX: the source of which it is made."""
        self.loaded: list[Any] = []
        """Programs, by the handles that the driver gives them."""
        self.status = {"init": 0, "load": 0, "launch": 0}
        self.driver = SimpleNamespace(
            cuInit=INIT(lambda _: self.status["init"]),
            cuLibraryLoadData=LOAD(self.load),
            cuLibraryGetKernel=GET_KERNEL(self.kernel_of),
            cuLaunchKernel=LAUNCH(self.launch),
            cuGetErrorString=GET_WORDS(self.words),
        )
        self.get_stream = GET_STREAM(self.stream_of)

    def load(self, library, code, *_):
        source = self.sources[code.decode()]
        self.loaded.append(for_processor(source))
        ctypes.cast(library, WORDS)[0] = 100 + len(self.loaded)
        return self.status["load"]

    def kernel_of(self, kernel, library, name):
        assert name == b"entry"
        ctypes.cast(kernel, WORDS)[0] = library + 1000
        return 0

    def launch(self, kernel, *rest):
        *sizes, shared_memory, stream, arguments, extra = rest
        assert not extra
        program, count = self.loaded[kernel - 1101]
        values = [arguments[i][0] for i in range(count)]
        self.launches.append(
            Launch(tuple(sizes[:3]), tuple(sizes[3:]), shared_memory, stream, values[0], values[1:])
        )
        run(program, values, sizes[0], sizes[3])
        return self.status["launch"]

    def stream_of(self, given):
        assert given[0] == 32 and given[2] != 0
        given[3] = STREAM
        return 0

    def words(self, status, words):
        ctypes.cast(words, ctypes.POINTER(TEXT))[0] = b"no card"
        return int(status != 100)


def for_processor(source: str) -> tuple[Any, int]:
    """A program and its entry for this processor, and the number of its arguments."""
    head = re.search(r"define ptx_kernel void @entry\((.*)\)", source)
    assert head is not None
    arguments = head[1]
    given = re.sub(r"noalias (readonly )?", "", arguments)
    own = source.replace("define ptx_kernel", "define").replace(" alwaysinline", "")
    own = re.sub(r"declare i32 @llvm.nvvm.*\n|!.*\n", "", own)
    own = own.replace("@llvm.nvvm.read.ptx.sreg.tid.x", "@number_of_thread")
    own = own.replace("@llvm.nvvm.read.ptx.sreg.ctaid.x", "@number_of_block")
    return load_program(own + THREADS.format(arguments=given, given=given)), len(given.split(","))


def run(program: Any, values: list[int], blocks: int, threads: int) -> None:
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int] * 2, *[ctypes.c_uint64] * len(values))
    call = kind(program.get_function_address("run"))
    for block in range(blocks):
        for thread in range(threads):
            call(block, thread, *values)


@contextmanager
def a_card(monkeypatch: pytest.MonkeyPatch) -> Iterator[Card]:
    """XLA on a CPU calls the handler for GPUs, and this driver launches."""
    card = Card()
    make, register = ptx.ptx_of, ffi.register

    def ptx_of(source):
        text = make(source)
        card.sources[text] = source
        return text

    stream = ctypes.cast(card.get_stream, ctypes.c_void_p).value
    monkeypatch.setattr(
        launcher,
        "LAUNCH",
        launcher.LAUNCH.replace(
            "%get_stream = field ptr, ptr %api, i64 80", f"%get_stream = inttoptr i64 {stream} to ptr"
        ),
    )
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", "")
    monkeypatch.setattr(ptx, "ptx_of", ptx_of)
    monkeypatch.setattr(program, "programs", OrderedDict())
    monkeypatch.setattr(ffi, "registrations", {})
    monkeypatch.setattr(ffi, "register", lambda name, _, *more: register(name, "cpu", *more))
    monkeypatch.setattr(ctypes, "CDLL", lambda name: card.driver)
    for function in launcher.load_driver, launcher.load_launcher:
        function.cache_clear()
    mlir.register_lowering(primitive.kernel_p, gpu.lower_on_gpu, platform="cpu")
    try:
        yield card
    finally:
        mlir.register_lowering(primitive.kernel_p, primitive.lower_on_cpu, platform="cpu")
        for function in launcher.load_driver, launcher.load_launcher:
            function.cache_clear()
