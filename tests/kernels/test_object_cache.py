"""Machine code on disk is what was compiled, and whatever befalls it is compiled anew."""

import os
import subprocess
import sys
import warnings
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.kernels import machine, object_cache, private_files
from walker_jax.kernels.compiled import Compiled

FUNCTION = """
import jax, jax.numpy as jnp, numpy as np
from walker_jax.kernels.compiled import Compiled

def function(shared, x):  # of the C library: tan, pow, atan2
    return jnp.tan(x) + jnp.power(x, shared) * jnp.arctan2(x, shared)

def compute():
    kernel = Compiled(jax.make_jaxpr(function)(*np.ones(2, np.float32)))
    x = np.linspace(0.1, 3, 50, dtype=np.float32)
    run, results = kernel.bind([np.float32(0.3), x], [False, True], len(x))
    run(0, len(x))
    return x, results[0]
"""


@pytest.fixture
def compilations(monkeypatch):
    """Counts what is compiled."""
    made, compile = [], machine.object_code
    counted = lambda *args: made.append(args) or compile(*args)
    monkeypatch.setattr(machine, "object_code", counted)
    return made


def square(x=3.0):
    kernel = Compiled(jax.make_jaxpr(lambda x: x * x)(1.0))
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
    Compiled(jax.make_jaxpr(lambda x: x + x)(1.0)).code.optimise()
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


def test_code_is_of_its_processor_and_versions(folder, compilations, monkeypatch):
    class NoFeatures:
        def flatten(self):
            return ""

    changes = [
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


def test_a_folder_is_looked_at_after_a_part_of_its_size(folder, monkeypatch):
    """At the first write of a process, and then only after a sixteenth of the most bytes."""
    monkeypatch.setattr(object_cache, "MAX_BYTES", 16 * 1000)
    monkeypatch.setattr(object_cache, "unseen", type(object_cache.unseen)())
    looks, remove = [], object_cache.remove_oldest
    monkeypatch.setattr(object_cache, "remove_oldest", lambda at: looks.append(at) or remove(at))
    for number in range(40):
        object_cache.store(f"{number}", b"x" * 100)
        assert len(looks) == 1 + number // 11
    assert set(looks) == {folder}
    monkeypatch.setattr(object_cache, "MAX_BYTES", 1000)
    object_cache.store("last", b"x" * 100)
    sizes = [path.stat().st_size for path in folder.iterdir()]
    assert sum(sizes) <= 1000 < sum(sizes) + sizes[0]


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


# --------------------------------------------------------------------- what others can have written


STRANGER = 12345


def plant(path, code):
    """A program with a right checksum in the place of another one."""
    path.write_bytes(object_cache.checksum(path, code) + code)


def code_of_double(folder):
    """Machine code of x + x, which would be taken for that of x * x."""
    Compiled(jax.make_jaxpr(lambda x: x + x)(1.0)).code.optimise()
    (path,) = folder.iterdir()
    code = path.read_bytes()[object_cache.CHECKSUM_BYTES :]
    path.unlink()
    return code


@pytest.fixture
def planted(folder):
    """A program that is not the one that it is taken for, with a right checksum."""
    code = code_of_double(folder)
    square()
    (path,) = folder.iterdir()
    plant(path, code)
    assert square() == 6  # one's own folder is not protected from oneself
    private_files.warn_once.cache_clear()
    return path


def give_away(path, monkeypatch):
    """Let a file be of another user; without the right to, let it be taken for one."""
    if os.geteuid() == 0:
        os.chown(path, STRANGER, STRANGER)
        return
    inode = path.stat().st_ino
    monkeypatch.setattr(private_files, "is_own", lambda status: status.st_ino != inode)


CHANGES = [("of a stranger", None), *((oct(mode), mode) for mode in (0o777, 0o1777, 0o770, 0o702))]


@pytest.mark.parametrize("place", ["the whole", "kernels"])
@pytest.mark.parametrize(("name", "mode"), CHANGES, ids=lambda value: str(value))
def test_no_program_comes_from_a_folder_of_others(
    planted, compilations, monkeypatch, place, name, mode
):
    folder = planted.parent.parent if place == "the whole" else planted.parent
    give_away(folder, monkeypatch) if mode is None else folder.chmod(mode)
    before = planted.read_bytes()
    with pytest.warns(RuntimeWarning, match=f"compiled programs in {folder} are not used") as said:
        assert [square(), square(), square(5.0)] == [9, 9, 25]
    assert len(said) == 1 and len(compilations) >= 3
    assert planted.read_bytes() == before and list(planted.parent.iterdir()) == [planted]


@pytest.mark.parametrize(("name", "mode"), [*CHANGES[:2], ("0o620", 0o620)], ids=str)
def test_a_program_that_others_can_write_is_replaced(
    planted, compilations, monkeypatch, name, mode
):
    give_away(planted, monkeypatch) if mode is None else planted.chmod(mode)
    count = len(compilations)
    with pytest.warns(RuntimeWarning, match=f"some programs in {planted.parent} are not used"):
        assert square() == 9
    assert square() == 9 and len(compilations) == count + 1
    assert planted.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("umask", [0, 0o002, 0o277])
def test_folders_and_programs_are_ones_own_whatever_the_umask(tmp_path, monkeypatch, umask):
    folder = tmp_path / "above" / "cache"
    monkeypatch.setenv(object_cache.VARIABLE, str(folder))
    before = os.umask(umask)
    try:
        assert [square(), square()] == [9, 9]
    finally:
        os.umask(before)
    (path,) = folder.glob("kernels/*")
    modes = [place.stat().st_mode & 0o777 for place in (folder.parent, folder, path.parent, path)]
    assert modes == [0o700, 0o700, 0o700, 0o600]


def test_where_there_are_no_users_nothing_is_refused(planted, monkeypatch):
    planted.parent.chmod(0o777)
    monkeypatch.delattr(os, "geteuid")
    assert square() == 6


@pytest.mark.slow
def test_a_thousand_corrupted_and_foreign_programs(folder, monkeypatch):
    """In folders of every mode and owner; the modes and owners of the files are others, too."""
    random, count = np.random.default_rng(0), Counter()
    foreign = code_of_double(folder)
    assert square() == 9
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    head = object_cache.CHECKSUM_BYTES
    owners = (os.geteuid(), STRANGER) if os.geteuid() == 0 else (os.geteuid(),)

    def contents(how):
        at, bit = int(random.integers(len(whole))), int(random.integers(8))
        if how == "flip":
            return whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :]
        if how == "cut":
            return whole[:at]
        if how == "garbage":
            return random.bytes(int(random.integers(1, 5000)))
        if how == "of another name":
            return object_cache.checksum(path.with_name("other"), foreign) + foreign
        code = foreign if how == "foreign" else random.bytes(len(whole) - head)
        return object_cache.checksum(path, code) + code

    places = (folder.parent, folder, path)
    for _ in range(1000):
        how = random.choice(
            ["flip", "cut", "garbage", "of another name", "foreign", "garbage, right checksum"]
        )
        path.write_bytes(contents(how))
        private = True
        for place in random.permutation(len(places))[: random.integers(len(places) + 1)]:
            mode = places[place].stat().st_mode | int(random.integers(0o100))
            places[place].chmod(mode)
            owner = int(random.choice(owners))
            os.chown(places[place], owner, -1)
            private &= owner == owners[0] and not mode & 0o022
        if private and how in ("foreign", "garbage, right checksum"):
            os.chown(path, owners[-1], -1)  # of one's own these are not told from others
            path.chmod(0o602)
        private_files.warn_once.cache_clear()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert square() == 9, (how, [oct(place.stat().st_mode) for place in places])
        assert len(said) <= 1 and (private or said)
        count[how, "folder or file of others" if said else "private"] += 1
        for place in places:
            os.chown(place, owners[0], -1)
            place.chmod(0o600 if place is path else 0o700)
    print(*(f"{', '.join(what)}: {number}" for what, number in sorted(count.items())), sep="\n")
    assert sum(count.values()) == 1000
