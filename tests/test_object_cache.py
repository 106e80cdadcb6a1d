"""Machine code on disk is what was compiled, and whatever befalls it is compiled anew."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.kernels import Kernel, machine, object_cache

FUNCTION = """
import jax, jax.numpy as jnp, numpy as np
from walker_jax.kernels import Kernel

def function(shared, x):  # of the C library: tan, pow, atan2
    return jnp.tan(x) + jnp.power(x, shared) * jnp.arctan2(x, shared)

def compute():
    kernel = Kernel(jax.make_jaxpr(function)(*np.ones(2, np.float32)))
    x = np.linspace(0.1, 3, 50, dtype=np.float32)
    run, results = kernel.bind([np.float32(0.3), x], [False, True], len(x))
    run(0, len(x))
    return x, results[0]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path))
    return tmp_path / "kernels"


@pytest.fixture
def compilations(monkeypatch):
    """Counts what is compiled."""
    made, compile = [], machine.object_code
    counted = lambda *args: made.append(args) or compile(*args)
    monkeypatch.setattr(machine, "object_code", counted)
    return made


def square(x=3.0):
    kernel = Kernel(jax.make_jaxpr(lambda x: x * x)(1.0))
    run, results = kernel.bind([np.array([x])], [True], 1)
    run(0, 1)
    return results[0].item()


def test_processes_share_code_and_its_calls_of_the_c_library(folder, compilations):
    """Both begin at once, with nothing on disk; functions lie elsewhere in each process."""
    command = [sys.executable, "-c", f"{FUNCTION}\nprint(compute()[1].tobytes().hex())"]
    pipes = {"stdout": subprocess.PIPE, "text": True}
    runs = [subprocess.Popen(command, **pipes) for _ in range(2)]
    printed = [run.communicate()[0].strip() for run in runs]
    assert [run.returncode for run in runs] == [0, 0]

    scope = {}
    exec(FUNCTION, scope)
    x, results = scope["compute"]()
    assert compilations == [] and len(list(folder.iterdir())) == 1
    assert printed == [results.tobytes().hex()] * 2
    expected = jnp.tan(x) + x ** jnp.float32(0.3) * jnp.arctan2(x, jnp.float32(0.3))
    np.testing.assert_allclose(results, expected, rtol=1e-5)

    (entry,) = folder.iterdir()
    entry.unlink()
    _, compiled = scope["compute"]()
    assert len(compilations) == 1 and compiled.tobytes() == results.tobytes()


DAMAGE = {
    "truncated": lambda content: content[:-9],
    "empty": lambda content: b"",
    "shorter than its hash": lambda content: content[:5],
    "one bit": lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
    "no hash": lambda content: content[object_cache.CHECKSUM_BYTES :],
}


@pytest.mark.parametrize("how", DAMAGE)
def test_a_broken_file_is_compiled_anew(folder, compilations, how):
    assert square() == 9
    (entry,) = folder.iterdir()
    content = entry.read_bytes()
    entry.write_bytes(DAMAGE[how](content))
    assert square() == 9 and len(compilations) == 2
    assert (
        entry.read_bytes()[: object_cache.CHECKSUM_BYTES] == content[: object_cache.CHECKSUM_BYTES]
    )
    assert square() == 9 and len(compilations) == 2


def test_the_code_of_another_program_is_not_loaded(folder, compilations):
    square()
    (entry,) = folder.iterdir()
    Kernel(jax.make_jaxpr(lambda x: x + x)(1.0))
    (other,) = set(folder.iterdir()) - {entry}
    other.replace(entry)
    assert square() == 9 and len(compilations) == 3


def test_a_file_that_cannot_be_read_or_replaced_does_no_harm(folder, compilations):
    square()
    (entry,) = folder.iterdir()
    entry.unlink()
    (entry / "inside").mkdir(parents=True)
    assert square() == 9 and len(compilations) == 2
    assert list(folder.iterdir()) == [entry]  # nothing half-written beside it


def test_a_folder_that_cannot_be_made_does_no_harm(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path / "file"))
    assert square() == 9
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_nothing_is_kept_where_the_variable_is_empty(tmp_path, monkeypatch, compilations):
    monkeypatch.setenv(object_cache.VARIABLE, "")
    monkeypatch.setattr(object_cache.platformdirs, "user_cache_dir", lambda name: str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert [square(), square()] == [9, 9] and len(compilations) == 2
    assert list(tmp_path.iterdir()) == []
    monkeypatch.delenv(object_cache.VARIABLE)  # then it is the user's own
    square()
    assert len(list(tmp_path.glob("kernels/*"))) == 1


def test_code_is_of_its_processor_versions_and_optimisation(folder, compilations, monkeypatch):
    class NoFeatures:
        def flatten(self):
            return ""

    changes = [
        (machine, "OPTIMISATION_LEVEL", 1),
        (machine.llvmlite, "__version__", "0"),
        (machine.llvm, "llvm_version_info", (0, 0, 0)),
        (machine.llvm, "get_host_cpu_name", lambda: "generic"),
        (machine.llvm, "get_host_cpu_features", NoFeatures),
    ]
    square()
    for count, change in enumerate(changes):
        with monkeypatch.context() as patch:
            patch.setattr(*change)
            assert square() == 9
        assert len(compilations) == len(list(folder.iterdir())) == count + 2
    square()
    assert len(compilations) == len(changes) + 1


def test_what_was_used_last_stays(folder, monkeypatch):
    monkeypatch.setattr(object_cache, "MAX_BYTES", 3 * (100 + object_cache.CHECKSUM_BYTES))
    keep = lambda name: object_cache.load_or_compile(name, lambda: name.encode() * 100)
    folder.mkdir()
    others = folder / "of another program"
    others.write_bytes(b"x" * 1000)
    for age, name in enumerate("abc"):
        keep(name)
        os.utime(folder / f"{name}.kernel", (age, age))
    left = folder / "left by a killed process.kernel"
    left.write_bytes(b"x" * 100)
    os.utime(left, (0.5, 0.5))
    assert keep("a") == b"a" * 100  # used again, now the newest but one
    keep("d")
    kept = {path.name for path in folder.iterdir()}
    assert kept == {others.name, "a.kernel", "c.kernel", "d.kernel"}


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_write_that_does_not_end_leaves_nothing(folder, monkeypatch, error):
    def replace(*paths):
        raise error

    monkeypatch.setattr(object_cache.os, "replace", replace)
    if error is OSError:
        assert object_cache.load_or_compile("name", lambda: b"code") == b"code"
    else:
        with pytest.raises(KeyboardInterrupt):
            object_cache.load_or_compile("name", lambda: b"code")
    assert list(folder.iterdir()) == []
