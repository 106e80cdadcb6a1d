"""A card that is not there, and its driver: a processor runs the threads, one after the other.

XLA on a CPU calls what it would call on a GPU: the handler for GPUs, or its own call of PTX. The
handler calls this file's driver in the place of NVIDIA's, and XLA's call is one of this file's too.
A card's program is its source with its entry, compiled for the processor. So all that a card would
be given is seen here, and what it would compute; not what NVIDIA's driver makes of the PTX.
"""

import ctypes
import re
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import pytest
from jax.interpreters import mlir

from walker_jax.identity import Cache
from walker_jax.kernels import ffi, gpu, launcher, primitive, program, ptx
from walker_jax.kernels.handler import VERSION
from walker_jax.kernels.machine import hash_source, load_program

STREAM = 0xABC0


class Launch(NamedTuple):
    """What a card is given."""

    grid: tuple[int, ...]
    block: tuple[int, ...]
    shared_memory: int
    stream: int
    arguments: list[int]


WORDS = ctypes.POINTER(ctypes.c_uint64)
INT, UINT, ANY, TEXT = ctypes.c_int, ctypes.c_uint, ctypes.c_void_p, ctypes.c_char_p
INIT = ctypes.CFUNCTYPE(INT, UINT)
LOAD = ctypes.CFUNCTYPE(INT, ANY, TEXT, ANY, ANY, UINT, ANY, ANY, UINT)
GET_KERNEL = ctypes.CFUNCTYPE(INT, ANY, ANY, TEXT)
LAUNCH = ctypes.CFUNCTYPE(INT, ANY, *[UINT] * 7, ANY, ctypes.POINTER(WORDS), ANY)
GET_STREAM = ctypes.CFUNCTYPE(ANY, WORDS)
HANDLER = ctypes.CFUNCTYPE(ANY, ANY)
"""Signatures of cuda.h and of XLA's c_api.h."""


class Card:
    """A card, and a driver that can fail."""

    def __init__(self):
        self.launches: list[Launch] = []
        self.places: list[int] = []
        """Of the results of XLA's own call among its arguments."""
        self.sources: dict[str, str] = {}
        """By PTX: the source of which it is made."""
        self.loaded: list[tuple] = []
        """Programs, by the handles that the driver gives them."""
        self.status = {"init": 0, "load": 0, "launch": 0}
        self.driver = SimpleNamespace(
            cuInit=INIT(lambda _: self.status["init"]),
            cuLibraryLoadData=LOAD(self.load),
            cuLibraryGetKernel=GET_KERNEL(self.kernel_of),
            cuLaunchKernel=LAUNCH(self.launch),
        )
        self.get_stream = GET_STREAM(self.stream_of)
        self.ptx_call = HANDLER(self.call_ptx)

    def load(self, library, code, *options):
        assert not any(options)
        self.loaded.append(for_processor(self.sources[code.decode()]))
        ctypes.cast(library, WORDS)[0] = 100 + len(self.loaded)
        return self.status["load"]

    def kernel_of(self, kernel, library, name):
        assert name == b"entry"
        ctypes.cast(kernel, WORDS)[0] = library + 1000
        return 0

    def launch(self, kernel, *rest):
        *sizes, shared_memory, stream, arguments, extra = rest
        grid, block = tuple(sizes[:3]), tuple(sizes[3:])
        assert not extra
        program, count = self.loaded[kernel - 1101]
        values = [arguments[i][0] for i in range(count)]
        self.work(program, Launch(grid, block, shared_memory, stream, values))
        return self.status["launch"]

    def work(self, program: Any, launch: Launch) -> None:
        self.launches.append(launch)
        run(program, launch.arguments, launch.grid[0], launch.block[0])

    def stream_of(self, given):
        assert given[0] == 32 and given[2] != 0
        given[3] = STREAM
        return 0

    def call_ptx(self, frame):
        """XLA's own call of PTX, on a CPU."""
        frame = words_at(frame)
        if extension := frame[1]:
            assert INT.from_address(extension + 8).value == 1
            (INT * 2).from_address(words_at(extension)[3] + 24)[:] = VERSION
            return None
        buffers = [*pointers(frame[9], frame[7]), *pointers(frame[14], frame[12])]
        given = attributes(frame)
        program, count = for_processor(self.sources[given["kernel_data"]])
        assert count == len(buffers) and given["name"] == "entry" and given["kernel_type"] == "ptx"
        addresses = [words_at(buffer)[3] for buffer in buffers]
        grid, block = (tuple(given[f"{one}_{axis}"] for axis in "xyz") for one in ("grid", "block"))
        self.work(program, Launch(grid, block, given["shared_mem_bytes"], STREAM, addresses))
        return None


def words_at(address: int) -> Any:
    return ctypes.cast(address, WORDS)


def pointers(address: int, count: int) -> list[int]:
    return [words_at(address)[i] for i in range(count)]


def attributes(frame: Any) -> dict[str, Any]:
    """Texts and numbers of 32 bits that a call of XLA has."""
    text = lambda span: ctypes.string_at(*pointers(span, 2)).decode()
    number = lambda scalar: INT.from_address(words_at(scalar)[1]).value
    kinds = (INT * frame[17]).from_address(frame[18])
    found = zip(kinds, pointers(frame[19], frame[17]), pointers(frame[20], frame[17]), strict=True)
    return {text(name): (text if kind == 4 else number)(value) for kind, name, value in found}


# One thread after the other. What a card knows of a thread is a variable here.
ONE_THREAD = """
@thread = internal global i32 0
@block = internal global i32 0
@threads = internal global i32 0
define internal i32 @number_of_thread() {
  %n = load i32, ptr @thread
  ret i32 %n
}
define internal i32 @number_of_block() {
  %n = load i32, ptr @block
  ret i32 %n
}
define internal i32 @threads_of_block() {
  %n = load i32, ptr @threads
  ret i32 %n
}
define void @become(i32 %block, i32 %thread, i32 %threads) {
  store i32 %threads, ptr @threads
  store i32 %block, ptr @block
  store i32 %thread, ptr @thread
  ret void
}
"""


def for_processor(source: str) -> tuple[Any, int]:
    """A program and its entry for this processor, and the number of its arguments."""
    head = re.search(r"define ptx_kernel void @entry\((.*)\)", source)
    assert head is not None
    own = source.replace("define ptx_kernel", "define")
    own = re.sub(r"(?m)^(declare .*@llvm.nvvm.read.*|!.*|target .*)\n", "", own)
    own = own.replace("@llvm.nvvm.read.ptx.sreg.tid.x", "@number_of_thread")
    own = own.replace("@llvm.nvvm.read.ptx.sreg.ctaid.x", "@number_of_block")
    own = own.replace("@llvm.nvvm.read.ptx.sreg.ntid.x", "@threads_of_block")
    return load_program(own + ONE_THREAD), head[1].count("%")


one_at_a_time = threading.Lock()
"""For the threads of XLA, as the variables of a program are those of all."""


def run(program: Any, arguments: Sequence[int], blocks: int, threads: int) -> None:
    """All threads of a launch."""
    become = ctypes.CFUNCTYPE(None, INT, INT, INT)(program.get_function_address("become"))
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_uint64] * len(arguments))
    entry = kind(program.get_function_address("entry"))
    with one_at_a_time:
        for block in range(blocks):
            for thread in range(threads):
                become(block, thread, threads)
                entry(*arguments)


@contextmanager
def a_card() -> Iterator[Card]:
    """XLA on a CPU has a card to call."""
    card = Card()
    register, lowering = ffi.register, jax.ffi.ffi_lowering

    def ptx_of(source):
        text = f"PTX of {hash_source(source)}"
        card.sources[text] = source
        return text

    def ffi_lowering(name, backend_config=None, **more):
        """A CPU's calls have no lists: where the results are is seen here."""
        if name == gpu.PTX_CALL and backend_config:
            places = backend_config.pop("output_indices")
            card.places = [place.value for place in places]
        return lowering(name, backend_config=backend_config, **more)

    stream = ctypes.cast(card.get_stream, ANY).value
    asked = "%get_stream = field ptr, ptr %api, i64 80"
    assert asked in launcher.LAUNCH
    launch = launcher.LAUNCH.replace(asked, f"%get_stream = inttoptr i64 {stream} to ptr")
    caches = launcher.load_driver, launcher.load_launcher, gpu.failure_of
    jax.ffi.register_ffi_target(gpu.PTX_CALL, jax.ffi.pycapsule(card.ptx_call), platform="cpu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher, "LAUNCH", launch)
        patch.setattr(ptx, "ptx_of", ptx_of)
        patch.setattr(ptx, "load_or_compile", lambda name, compile: compile())
        patch.setattr(program, "programs", Cache())
        patch.setattr(ffi, "registrations", {})
        patch.setattr(ffi, "register", lambda name, _, *more: register(name, "cpu", *more))
        patch.setattr(jax.ffi, "ffi_lowering", ffi_lowering)
        patch.setattr(ctypes, "CDLL", lambda name: card.driver)
        for function in caches:
            function.cache_clear()
        mlir.register_lowering(primitive.kernel_p, gpu.lower_on_gpu, platform="cpu")
        try:
            yield card
        finally:
            mlir.register_lowering(primitive.kernel_p, primitive.lower_on_cpu, platform="cpu")
            for function in caches:
                function.cache_clear()
