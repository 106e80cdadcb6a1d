"""Runs that write a store, killed at each file operation in turn; then the same run goes on.

    python tests/helpers/store_killed.py {pieces,overwrite,save} folder [every]

At each, or at every so many. Ends with 0 if each left a place in which nothing is lost. It forks,
so it is a program of its own, and does nothing itself that starts threads.
"""

import os
import shutil
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from zarr.storage import LocalStore

from walker_jax import storage
from walker_jax.storage import datasets
from walker_jax.storage.requests import canonical_json

OLD, NEW = {"slope": 0.004}, {"slope": 0.005}
ROWS = np.arange(12.0).reshape(6, 2)
AXES = xr.Dataset(coords={"x": np.arange(6.0), "y": [0.0, 1.0]})
FOUND = xr.Dataset({"area": ("number", np.array([0.1, 0.2]))}, coords={"number": [0, 1]})
OTHER = AXES.merge(FOUND * 2).assign(value=(("x", "y"), ROWS + 1))
WHOLE = AXES.merge(FOUND).assign(value=(("x", "y"), ROWS))
KILLED = 9
OPERATIONS = ("unlink", "rmdir", "mkdir", "replace")


def run(path: Path, overwrite: bool = False) -> xr.Dataset:
    """Two pieces, and what is found at the end."""
    found = storage.find(path, NEW, overwrite=overwrite)
    if found is not None:
        return found
    arrays = {
        "value": xr.Variable(("x", "y"), np.broadcast_to(-1.0, (6, 2))),
        "half": xr.Variable(("x",), np.broadcast_to(np.int8(0), 6)),
    }
    options = {"aside": ["half"], "overwrite": overwrite}
    with storage.open_pieces(path, NEW, AXES, arrays, (4,), dict, **options) as place:
        for i in place.missing():
            (rows,) = place.at(i)
            half = np.ones(rows.stop - rows.start, np.int8)
            place.write(i, {"value": ROWS[rows], "half": half}, done=True)
        place.finish(AXES.merge(FOUND))
    return datasets.open_dataset(path)


def go_on(path: Path) -> xr.Dataset:
    """The same run again; where the old data set is still there, told to overwrite it again."""
    try:
        return run(path)
    except storage.StoreConflict:
        there = storage.load(path)
        assert there is not None and there.identical(OTHER.assign_attrs(there.attrs))
        return run(path, overwrite=True)


def saved_again(path: Path) -> xr.Dataset:
    """One of the two data sets is there, whole; then the other is saved."""
    assert storage.find(path, {}, overwrite=True) is None
    there = storage.load(path)
    assert there is not None
    wanted = {canonical_json(OLD): OTHER, canonical_json(NEW): WHOLE}[there.attrs["request"]]
    assert there.drop_attrs(deep=False).identical(wanted)
    return storage.save(WHOLE, path, NEW, overwrite=True)


def dying_at(operation: int) -> None:
    """Let this process end, without tidying up, before it does so many things to files."""
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if done == operation:
            os._exit(KILLED)

    def counted(does):
        def does_or_dies(*arguments, **options):
            tick()
            return does(*arguments, **options)

        return does_or_dies

    places = [(LocalStore, "set"), (Path, "rename"), *((os, name) for name in OPERATIONS)]
    for place, name in places:
        setattr(place, name, counted(getattr(place, name)))


def in_a_process(function: Callable[[], object]) -> int:
    """Its exit code: 0, or 1 for an exception."""
    process = os.fork()
    if process == 0:
        try:
            function()
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", flush=True)
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def main(kind: str, folder: Path, every: int = 1) -> int:
    warnings.simplefilter("error")
    first = {
        "pieces": lambda path: None,
        "overwrite": lambda path: storage.save(OTHER, path, OLD, overwrite=True),
        "save": lambda path: storage.save(OTHER, path, OLD, overwrite=True),
    }[kind]
    killed = {
        "pieces": run,
        "overwrite": partial(run, overwrite=True),
        "save": lambda path: storage.save(WHOLE, path, NEW, overwrite=True),
    }[kind]
    again = saved_again if kind == "save" else go_on
    bad, operation, code = 0, 0, KILLED

    def dies(path: Path) -> None:
        dying_at(operation)
        killed(path)

    def check(path: Path) -> None:
        # Before anything is tidied, readers find the old data set or the new one.
        assert kind == "pieces" or storage.load(path) is not None
        found = again(path)
        assert found.drop_attrs(deep=False).identical(WHOLE.drop_attrs(deep=False)), found
        left = [place.name for place in path.parent.iterdir()]
        assert left == [path.name], left
        assert not [*path.rglob("*.partial")]
        assert {place.name for place in path.iterdir()} == {*WHOLE.variables, "zarr.json"}

    while code == KILLED:
        operation += every
        place = folder / str(operation)
        place.mkdir()
        in_a_process(lambda path=place / "a.zarr": first(path))
        code = in_a_process(lambda path=place / "a.zarr": dies(path))
        if in_a_process(lambda path=place / "a.zarr": check(path)):
            print(f"killed at operation {operation}: not in order", flush=True)
            bad += 1
        shutil.rmtree(place, ignore_errors=True)
    print(f"{kind}: killed {operation // every - 1} times, {bad} not in order, ended with {code}")
    return int(bad + code > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:])))
