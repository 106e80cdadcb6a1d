"""Tests compute in float64, and mixing dtypes without saying so is an error.

What XLA and LLVM compile is kept in pytest's cache, from which the processes of the tests take it,
those that they start, and the next run: `pytest --cache-clear` begins from nothing. XLA hardly
optimises, as most of what it compiles is called once, to compare with; kernels do not depend on it.
`XLA_FLAGS= pytest` tests what XLA makes for users. Properties are tried on the same inputs in every
run; `pytest --hypothesis-profile=explore` draws others.
"""

import atexit
import gc
import os
import signal
import sys
from collections.abc import Iterator

import equinox.internal as eqxi
import jax
import pytest
from compiler_flags import QUICK
from hypothesis import settings
from matplotlib.figure import Figure
from waiting import Waiting
from xdist.scheduler import LoadFileScheduling

os.environ.setdefault("XLA_FLAGS", QUICK)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

eqxi.prevbefore = jax.jit(eqxi.prevbefore)
"""Traced once: diffrax goes back from its last time by a hundred numbers, one after the other, each
time that it is traced, which would be a sixth of the compilation of a small system."""

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile("repeatable")

gc.set_threshold(100_000, 50, 1000)  # tracing makes many objects that stay: looking finds little
atexit.register(gc.freeze)  # nor at the end

WORTH_KEEPING = 0.1
"""Seconds of compilation from which on a program is kept."""
HALF_WRITTEN = "ignore:Error reading persistent compilation cache entry"
"""As another process is just writing it, or was killed while it did: it is compiled instead."""


@pytest.fixture(scope="module")
def few_dots() -> Iterator[None]:
    """Pictures are saved with a quarter of the dots along each side, and laid out once: none is
    looked at."""
    save = Figure.savefig

    def fewer(figure, path, *, dpi, **more):
        save(figure, path, dpi=dpi / 4, **more)
        figure.set_layout_engine("none")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", fewer)
        yield


@pytest.fixture
def run(monkeypatch, capsys, tmp_path, few_dots):
    """Run a command in an empty folder; returns exit code, standard output and error."""
    from walker_jax.cli import main  # not before its signatures are made to be checked

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("walker_jax.cli.startup.keep_compiled", lambda: None)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["walker-jax", *map(str, arguments)])
        interrupt = signal.getsignal(signal.SIGINT)
        with pytest.raises(SystemExit) as stop:
            main.main()
        signal.signal(signal.SIGINT, interrupt)
        return (stop.value.code, *capsys.readouterr())

    return run


class FromBothEnds(LoadFileScheduling):
    """One process takes files from the front, the others from the back.

    So neighbours, which compute alike, mostly share a process with what it has traced.
    """

    def _assign_work_unit(self, node) -> None:
        if node is not self.nodes[0]:
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log) -> LoadFileScheduling | None:
    return FromBothEnds(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_sessionstart(session: pytest.Session) -> None:
    plugins = session.config.pluginmanager
    reporter = plugins.get_plugin("terminalreporter")
    if reporter is not None and not hasattr(session.config, "workerinput"):
        waiting = Waiting(reporter)
        plugins.register(waiting)
        waiting.start()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("filterwarnings", HALF_WRITTEN)
    if getattr(config, "cache", None) is None:  # with -p no:cacheprovider
        return
    folder = str(config.cache.mkdir("compiled"))
    for place in (folder, f"{folder}/kernels"):  # or some umasks would let the group write there
        if os.path.exists(place):
            os.chmod(place, 0o700)
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)
    os.environ |= {  # for processes that tests start
        "JAX_COMPILATION_CACHE_DIR": folder,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": str(WORTH_KEEPING),
        "PYTHONWARNINGS": HALF_WRITTEN,
        "WALKER_JAX_CACHE_DIR": folder,
    }
