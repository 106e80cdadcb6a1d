"""The package on every Python, with the oldest and newest dependencies, and where little is had.

    python .ci/matrix.py                # every combination that can be made here: half an hour
    python .ci/matrix.py --only 3.12    # those whose name has this in it
    python .ci/matrix.py --constraints  # prints both sets of versions, and ends

For each Python that is found, and for both sets, a fresh environment runs the main job and a quick
selection of the tests: three of their hundred files, which show whether the package installs and
does its main job there, not that all of it works. The whole suite is .ci/run's, on the newest
Python, with a part on the oldest. Then the main job runs on the first Python without what it
usually has. Its answer must be the same everywhere. The sets are computed from pyproject.toml, anew
each time: the oldest versions of what it names, and the newest of all. Needs the network for
packages alone.
"""

import argparse
import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
SETS = {"oldest": "lowest-direct", "newest": "highest"}
"""How uv calls the two sets of versions."""
TESTS = ("walking/test_stride.py", "storage/test_schema.py", "storage/test_store.py")
"""The quick selection: files of tests that need the extra [test] alone, and take a minute."""
JOB = ("-m", "walker_jax", "basin", "--json", "--overwrite")
EXPECTED = {"cells": [3043, 1], "state": [0.1533895648762377, -0.1560801466756835]}
"""What the main job finds: cells of the gait and of an artefact; and the gait, to rounding."""
ROUNDING = 1e-13
MEMORY = 2 * 2**30
"""Bytes in which the main job must get along."""
UNWRITABLE = "/proc/nowhere"
"""A folder that nobody can make, root included."""


class Missing(Exception):
    """What a combination needs is not here."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--only", default="", help="part of the names of combinations")
    parser.add_argument("--constraints", action="store_true", help="print both sets of versions")
    arguments = parser.parse_args()
    rows: list[tuple[str, str, str]] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        uv = install_uv(place)
        if arguments.constraints:
            for name in SETS:
                print(f"# {name}\n{constraints(uv, name, sys.executable, place).read_text()}")
            return
        for version in PYTHONS:
            for name in SETS:
                title = f"Python {version}, {name}"
                if arguments.only in title:
                    report(rows, title, lambda v=version, n=name: try_versions(uv, v, n, place))
        conditions = [name for name in CONDITIONS if arguments.only in name]
        if conditions:
            python = make_environment(uv, sys.executable, "newest", place, "conditions")
            for name in conditions:
                report(rows, name, lambda n=name: try_condition(python, n, place))
    print("\n| where | outcome | |\n|---|---|---|")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    sys.exit(any(outcome == "FAILED" for _, outcome, _ in rows))


def report(rows: list[tuple[str, str, str]], title: str, attempt: Callable[[], str]) -> None:
    """Make an attempt, and keep what came of it."""
    try:
        row = title, "passed", attempt()
    except Missing as error:
        row = title, "not here", str(error)
    except subprocess.CalledProcessError as error:
        said = f"{error.stdout or ''}\n{error.stderr or ''}".strip()
        print(said, file=sys.stderr)
        row = title, "FAILED", (said.splitlines() or [str(error)])[-1]
    except AssertionError as error:
        row = title, "FAILED", str(error)
    except (LookupError, TypeError, ValueError) as error:  # the answer is none, or lacks something
        row = title, "FAILED", f"{type(error).__name__}: {error}"
    print(*row, sep=": ", flush=True)
    rows.append(row)


def install_uv(place: Path) -> str:
    """uv in an environment of its own."""
    subprocess.run([sys.executable, "-m", "venv", place / "uv"], check=True)
    subprocess.run([place / "uv/bin/pip", "install", "--quiet", "uv"], check=True)
    return str(place / "uv/bin/uv")


def constraints(uv: str, name: str, python: str, place: Path) -> Path:
    """A file with the versions of a set, for a Python."""
    path = place / f"{name}.txt"
    # Some of the oldest have no wheel for a newer Python: then it is the oldest that has one.
    how = ["--resolution", SETS[name], "--extra", "test", "--python", python]
    how += ["--only-binary", ":all:"]
    plain = ["--no-header", "--no-annotate", "--quiet", "--output-file", path]
    run([uv, "pip", "compile", ROOT / "pyproject.toml", *how, *plain])
    return path


def make_environment(uv: str, python: str, name: str, place: Path, folder: str) -> Path:
    """The Python of a fresh environment with the package as it is installed."""
    versions = constraints(uv, name, python, place)
    run([uv, "venv", "--quiet", "--python", python, place / folder])
    new = place / folder / "bin" / "python"
    package = [f"{ROOT}[test]", "--constraints", versions]
    run([uv, "pip", "install", "--quiet", "--python", new, *package])
    return new


def find_python(version: str) -> str:
    """The path of a Python that runs: this one, or one on PATH or among pyenv's."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    others = pyenv.glob(f"versions/{version}.*/bin/python")
    for path in (sys.executable, shutil.which(f"python{version}"), *others):
        with contextlib.suppress(OSError, subprocess.CalledProcessError):
            said = run([path or "", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
            if said.stdout.strip() == version:
                return str(path)
    raise Missing("there is no such Python")


def try_versions(uv: str, version: str, name: str, place: Path) -> str:
    """The main job and the quick tests on a Python, with a set of versions."""
    folder = f"{version}-{name}"
    python = make_environment(uv, find_python(version), name, place, folder)
    began = time.monotonic()
    job = check_job(python, place, own_cache(place, folder))
    tests = [f"tests/{one}" for one in TESTS]
    said = run(
        [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests],
        cwd=copy_of_tests(place),
        env=own_cache(place, folder),
    ).stdout
    shutil.rmtree(place / folder)
    seconds = time.monotonic() - began
    return f"{job}; {said.strip().splitlines()[-1].strip('= ')}; {seconds:.0f} s in all"


def copy_of_tests(place: Path) -> Path:
    """A folder with the tests alone, so that the package is the one that is installed."""
    folder = place / "checkout"
    if not folder.exists():
        for name in ("tests", "docs", "benchmarks", "notebooks"):
            shutil.copytree(ROOT / name, folder / name)
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, folder)
    return folder


def own_cache(place: Path, name: str) -> dict[str, str]:
    """The environment's variables, with a cache folder that is empty at first."""
    plain = {key: value for key, value in os.environ.items() if "PYTHON" not in key}
    plain = {key: value for key, value in plain.items() if not key.startswith(("JAX_", "XLA_"))}
    return plain | {"WALKER_JAX_CACHE_DIR": str(place / f"cache-{name}")}


def check_job(python: Path, place: Path, variables: dict[str, str]) -> str:
    """Run the main job, and compare its answer; says how much time and memory it took."""
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory(dir=place) as folder,
        tempfile.TemporaryFile("w+", dir=place) as output,
        tempfile.TemporaryFile("w+", dir=place) as errors,
    ):
        command = [python, *JOB]
        done = subprocess.Popen(command, cwd=folder, env=variables, stdout=output, stderr=errors)
        _, status, usage = os.wait4(done.pid, 0)
        done.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        out, err = output.read(), errors.read()
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, JOB, out, err)
    answer = json.loads(out)
    found = answer["attractors"]
    assert [one["cells"] for one in found] == EXPECTED["cells"], f"other cells: {found}"
    for one, expected in zip(found[0]["states"][0], EXPECTED["state"], strict=True):
        assert math.isclose(one, expected, rel_tol=ROUNDING), f"another gait: {found[0]}"
    peak = usage.ru_maxrss * 1024
    assert peak < MEMORY, f"{peak / 2**20:.0f} MiB at the peak"
    said = f"; it says: {err.strip().splitlines()[-1]}" if err.strip() else ""
    return f"the same answer in {time.monotonic() - began:.1f} s and {peak / 2**20:.0f} MiB{said}"


def try_condition(python: Path, name: str, place: Path) -> str:
    """The main job under a condition."""
    with CONDITIONS[name](own_cache(place, name.replace(" ", "-")), place) as variables:
        return check_job(python, place, variables)


def with_variables(**changed: str | None) -> Callable:
    """A condition that changes variables; None removes one."""

    @contextlib.contextmanager
    def changing(variables: dict[str, str], place: Path) -> Iterator[dict[str, str]]:
        both = variables | changed
        yield {key: value for key, value in both.items() if value is not None}

    return changing


@contextlib.contextmanager
def on_one_core(variables: dict[str, str], place: Path) -> Iterator[dict[str, str]]:
    """The process, and those that it starts, may use one core."""
    if not hasattr(os, "sched_setaffinity"):
        raise Missing("this system binds no process to a core")
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield variables
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def in_little_memory(variables: dict[str, str], place: Path) -> Iterator[dict[str, str]]:
    """A control group with a limit of memory, of either version, where one may be made."""
    for root, limit in (("memory/", "memory.limit_in_bytes"), ("", "memory.max")):
        group = Path("/sys/fs/cgroup") / root / "walker_jax"
        before = Path("/sys/fs/cgroup") / root / "cgroup.procs"
        try:
            group.mkdir()
            (group / limit).write_text(str(MEMORY))
            (group / "cgroup.procs").write_text(str(os.getpid()))
        except OSError:
            with contextlib.suppress(OSError):
                group.rmdir()
            continue
        try:
            yield variables
        finally:
            before.write_text(str(os.getpid()))
            group.rmdir()
        return
    raise Missing("no control group can be made; the peaks above are below the limit")


@contextlib.contextmanager
def on_a_full_disk(variables: dict[str, str], place: Path) -> Iterator[dict[str, str]]:
    """A cache folder on a file system of 64 KiB."""
    folder = place / "full"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k,mode=700", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        raise Missing("no file system can be mounted")
    try:
        yield variables | {"WALKER_JAX_CACHE_DIR": str(folder)}
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextlib.contextmanager
def with_a_file_in_the_way(variables: dict[str, str], place: Path) -> Iterator[dict[str, str]]:
    """A file stands where the cache folder should be."""
    path = place / "file"
    path.write_text("mine")
    yield variables | {"WALKER_JAX_CACHE_DIR": str(path)}


CONDITIONS = {
    "without AVX-512": with_variables(
        WALKER_JAX_KERNELS="haswell", XLA_FLAGS="--xla_cpu_max_isa=AVX2"
    ),
    "without AVX": with_variables(
        WALKER_JAX_KERNELS="nehalem", XLA_FLAGS="--xla_cpu_max_isa=SSE4_2"
    ),
    "by XLA alone": with_variables(WALKER_JAX_KERNELS="off"),
    "on one core": on_one_core,
    "in 2 GiB": in_little_memory,
    "HOME unset": with_variables(HOME=None, WALKER_JAX_CACHE_DIR=None),
    "HOME read-only": with_variables(HOME=UNWRITABLE, WALKER_JAX_CACHE_DIR=None),
    "cache read-only": with_variables(WALKER_JAX_CACHE_DIR=UNWRITABLE),
    "cache full": on_a_full_disk,
    "cache a file": with_a_file_in_the_way,
}


def run(command: list, **options) -> subprocess.CompletedProcess:
    """Run a program; what it says is kept."""
    return subprocess.run(
        list(map(str, command)), check=True, capture_output=True, text=True, **options
    )


if __name__ == "__main__":
    main()
