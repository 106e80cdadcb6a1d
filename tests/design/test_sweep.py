"""Basins over parameters, and the cluster that may compute them."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
import xarray as xr
from jax.errors import JaxRuntimeError

import walker_jax as wj
from walker_jax import figures, storage
from walker_jax.design import sweeps
from walker_jax.execution import tiles, workers
from walker_jax.execution.workers import open_workers
from walker_jax.kernels.program import MODES
from walker_jax.stability.robustness_fields import without_gait
from walker_jax.storage import datasets

WALKER = wj.SpringWalker(0.004, 0.0)
GRID = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.2, 0.05, 25))
SIMPLEST = wj.SimplestWalker(0.004)
"""It finds its gait from the slope alone, others search a region."""
QUICK: Any = {"levels": 0, "check": 100}
OVER = {"hip_stiffness": [0.0, 2.0], "slope": [0.004, 0.3]}


@pytest.fixture(scope="module")
def swept():
    """Gaits are searched for from few places."""
    few = wj.Grid.sheared(theta=(0.1, 0.3, 8), sum=(-0.1, 0.02, 8))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wj.SpringWalker, "gait_region", lambda _: few)
        return wj.sweep(WALKER, OVER, GRID, **QUICK)


def test_every_combination_is_as_computed_alone(swept):
    assert swept["total_area"].dims == ("hip_stiffness", "slope")
    assert swept["fate"].dims == ("hip_stiffness", "slope", "theta", "sum")
    for stiffness, slope in ((0.0, 0.004), (2.0, 0.004)):
        walker, here = (
            wj.SpringWalker(slope, stiffness),
            {"hip_stiffness": stiffness, "slope": slope},
        )
        alone, there = wj.basin(walker, GRID, "direct"), swept.sel(here)
        for name in ("fate", "attractor", "strides"):
            np.testing.assert_array_equal(there[name], alone[name])
        assert float(there["area"]) == alone.area.values.sum()
        fine = wj.refine(walker, GRID, **QUICK)
        assert float(there["total_area"]) == float(fine["total_area"])
        assert float(there["total_area_error"]) == float(fine["total_area_error"])
        assert fine["cells"].size == 1 and float(there["gait_period"]) == 1 and not there["note"]
        gait = wj.find_gait(walker, fine["states"][0].values)
        np.testing.assert_array_equal(there["gait_state"], gait.states[0])
        assert float(there["multiplier"]) == np.abs(gait.multipliers[0])
        assert float(there["speed"]) == wj.measure(walker, "speed", (), gait).value


STIFF = wj.SpringWalker(0.004, 11.24)
"""It has two stable gaits; the more stable one attracts few starts."""
AROUND_STIFF = wj.Grid.sheared(theta=(0.02, 0.2, 12), sum=(-0.2, 0, 16))


def test_the_gait_is_that_of_the_basin_not_of_the_search(monkeypatch):
    """Its multiplier by differences of strides, its speed by their length and time."""
    other = wj.find_gait(STIFF, [0.1446, -0.1614])
    monkeypatch.setattr("walker_jax.design.sweeps.search_gait", lambda *_, **__: other)
    found = wj.sweep(STIFF, {"hip_stiffness": [11.24]}, AROUND_STIFF, **QUICK)
    found = found.isel(hip_stiffness=0)
    state = found["gait_state"].values
    number = found["attractor"].values
    assert int(found["attractors"]) == 2 and np.median(number[number >= 0]) == 0
    start = AROUND_STIFF.centres(np.flatnonzero(number.ravel() == 0))[0]
    np.testing.assert_allclose(wj.walk(STIFF, start, 500).states[-1], state, rtol=0, atol=1e-10)
    step = 1e-5 * np.concatenate([np.eye(2), -np.eye(2)])
    ends = wj.strides(STIFF, state + step).state
    largest = np.abs(np.linalg.eigvals((ends[:2] - ends[2:]).T / 2e-5)).max()
    assert float(found["multiplier"]) == pytest.approx(largest, rel=1e-6)
    assert largest > np.abs(other.multipliers[0]) + 0.1
    step_time = float(wj.stride(STIFF, state).time)
    assert float(found["speed"]) == pytest.approx(2 * np.sin(state[0]) / step_time, rel=1e-12)
    assert str(found["note"].values) == (
        "find_gait without a guess finds a stable gait, multiplier 0.775764, at (0.144555, "
        "-0.161404), not that of the basin"
    )


def test_a_gait_of_two_strides_is_that_of_its_basin_too():
    slopes = {"slope": [0.0165, 0.03]}
    found = wj.sweep(wj.SimplestWalker(0.01), slopes, GRID, **QUICK)
    assert found["gait_period"].values.tolist() == [2, 0]
    two, none = (found.isel(slope=i) for i in range(2))
    gait = wj.find_gait(wj.SimplestWalker(0.0165), two["gait_state"].values, 2)
    assert gait.stable and float(two["multiplier"]) == pytest.approx(np.abs(gait.multipliers[0]))
    assert "an unstable gait, multiplier 1." in str(two["note"].values)
    assert np.isnan(none["multiplier"]) and np.isnan(none["speed"]) and not none["note"]


@pytest.mark.slow
def test_a_robust_sweep_has_the_robustness_of_each_combination():
    walker, small = (
        wj.SimplestWalker(0.004),
        wj.Grid.sheared(theta=(0.1, 0.2, 8), sum=(-0.02, 0.01, 6)),
    )
    options: Any = {"levels": 0, "check": 100, "strides": 60, "seed": 3}
    found = wj.sweep(walker, {"slope": [0.004]}, small, robust=True, **options).isel(slope=0)
    alone = wj.robustness(walker, small, **options)
    for name in ("total_area", *without_gait(walker)):
        np.testing.assert_array_equal(found[name], alone[name])
    assert 0 < float(found["least_disturbance"]) < 0.1 and float(found["failed"]) == 0


def test_where_nothing_walks_there_is_no_area_and_no_gait(swept):
    steep = swept.sel(slope=0.3, hip_stiffness=0.0)
    assert steep["total_area"] == 0 and np.isnan(steep["multiplier"]) and steep["failed"] == 0


def test_attributes_say_what_does_not_vary(swept, monkeypatch):
    gait = wj.find_gait(SIMPLEST)
    monkeypatch.setattr("walker_jax.design.sweeps.search_gait", lambda *_, **__: gait)
    assert swept.attrs["walker"] == "SpringWalker" and "walker_slope" not in swept.attrs
    slopes = wj.sweep(WALKER, {"slope": [0.004]}, GRID, **QUICK)
    assert slopes.attrs["walker_hip_stiffness"] == 0
    assert float(slopes["total_area"][0]) == float(swept["total_area"][0, 0])


def test_a_combination_that_fails_costs_no_other(monkeypatch):
    measured = sweeps.measure_basin

    def failing(walker, plan):
        if float(walker.slope) == 0.006:
            raise FloatingPointError("broken")
        return measured(walker, plan)

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", failing)
    found = wj.sweep(SIMPLEST, {"slope": [0.004, 0.006]}, GRID, **QUICK)
    assert found["failed"].values.tolist() == [0, 1]
    assert found["reason"].values.tolist() == ["", "FloatingPointError: broken"]
    assert (found["fate"][1] == -1).all() and np.isnan(found["total_area"][1])
    assert found["total_area"][0] > 0


def test_what_the_machine_lacks_is_tried_again(tmp_path, monkeypatch):
    path, over, lacking = tmp_path / "a.zarr", {"slope": [0.004, 0.006]}, [MemoryError]
    measured = sweeps.measure_basin

    def failing(walker, plan):
        if float(walker.slope) == 0.006 and lacking:
            raise lacking.pop()
        return measured(walker, plan)

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", failing)
    with pytest.raises(MemoryError):
        wj.sweep(SIMPLEST, over, GRID, **QUICK, out=path)
    found = wj.sweep(SIMPLEST, over, GRID, **QUICK, out=path)
    assert not found["failed"].any() and (found["total_area"] > 0).all()


@pytest.mark.parametrize(
    "lacking",
    [
        MemoryError(),
        OSError("disk"),
        ImportError("library"),
        JaxRuntimeError("RESOURCE_EXHAUSTED: memory"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_the_machine_lacks_is_raised_not_told(monkeypatch, lacking):
    broken = [lacking, JaxRuntimeError("INTERNAL"), ValueError("gait"), RuntimeError("no step")]

    def failing(*_):
        raise broken.pop(0)

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", failing)
    plan = sweeps.Measurement(WALKER, GRID, ("slope",), 0, 0, False, 10, 0, 1e-12)
    with pytest.raises(type(lacking)):
        sweeps.compute_combination(plan, (0.004,))
    for said in ("JaxRuntimeError: INTERNAL", "ValueError: gait", "RuntimeError: no step"):
        assert sweeps.compute_combination(plan, (0.004,)) == {"failed": 1, "reason": said}
    refused = sweeps.compute_combination(plan, (-1.0,))
    said = "slope must be above 0 and below 1.5708, not -1.0"
    assert not broken and refused == {"failed": 1, "reason": said}


def test_a_sweep_of_which_all_failed_has_a_picture(monkeypatch):
    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", lambda *_: 1 / 0)
    found = wj.sweep(SIMPLEST, {"slope": [0.004, 0.006]}, GRID, **QUICK)
    assert found["failed"].values.tolist() == [1, 1]
    assert "2 failed" in figures.sweep(found).texts[0].get_text()


def test_an_interrupted_sweep_goes_on(tmp_path, swept, monkeypatch):
    computed, path = [], tmp_path / "a.zarr"

    def counted(walker, plan):
        computed.append((float(walker.hip_stiffness), float(walker.slope)))
        if len(computed) == 3:
            raise KeyboardInterrupt
        there = swept.sel(hip_stiffness=walker.hip_stiffness, slope=walker.slope)
        return {name: there[name].values for name in sweeps.empty_row(plan)}

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", counted)
    with pytest.raises(KeyboardInterrupt):
        wj.sweep(WALKER, OVER, GRID, **QUICK, out=path)
    looked = xr.open_zarr(path, consolidated=False)
    assert looked["total_area"].notnull().sum() == 2
    with pytest.raises(storage.StoreConflict, match=r"\(levels: 0, not 1\)"):
        wj.sweep(WALKER, OVER, GRID, levels=1, check=100, out=path)
    found = wj.sweep(WALKER, OVER, GRID, **QUICK, out=path)
    assert len(computed) == 5 and len(set(computed)) == 4
    assert found.drop_attrs(deep=False).identical(swept.drop_attrs(deep=False))
    assert wj.sweep(WALKER, OVER, GRID, **QUICK, out=path).identical(found)
    assert len(computed) == 5


@pytest.mark.parametrize(
    ("over", "named"),
    [
        ({}, "over must name"),
        ({"mass": [1]}, "mass"),
        ({"slope": []}, "over slope"),
        ({"slope": [0.1, 0.1]}, "over slope"),
        ({"slope": [0.1, -0.1]}, "slope"),
        ({"slope": [0.1, np.nan]}, "slope"),
        ({"slope": [[0.1]]}, "over slope"),
        (
            {"slope": np.linspace(0.001, 0.02, 2000), "hip_stiffness": np.arange(1000)},
            "over must have at most 1048576 combinations, not 2000000",
        ),
    ],
)
def test_wrong_values(over, named):
    with pytest.raises(ValueError, match=named):
        wj.sweep(SIMPLEST, over, GRID)


def test_what_is_overwritten_is_kept_until_the_next_is_begun(tmp_path):
    path, over = tmp_path / "a.zarr", {"slope": [0.004]}
    first = wj.sweep(SIMPLEST, over, GRID, **QUICK, out=path)
    slice_ = wj.Grid.plain(theta=(0, 0.4, 4))
    with pytest.raises(ValueError, match="grid must have"):
        wj.sweep(SIMPLEST, over, slice_, **QUICK, out=path, overwrite=True)
    assert datasets.open_dataset(path).identical(first)
    second = wj.sweep(SIMPLEST, {"slope": [0.006]}, GRID, **QUICK, out=path, overwrite=True)
    assert second["slope"].values.tolist() == [0.006]


def test_a_cluster_needs_a_place():
    with pytest.raises(ValueError, match="out is required"):
        wj.basin(WALKER, GRID, cluster=2)


def test_here_things_are_computed_one_by_one():
    with open_workers() as each:
        assert list(each(lambda x: 2 * x, [3, 1])) == [(3, 6), (1, 2)]


@pytest.mark.parametrize(
    ("cluster_", "message"),
    [
        ("tcp://127.0.0.1:9", r"cluster tcp://127\.0\.0\.1:9 cannot be reached"),
        (0, "cluster must be at least 1, not 0"),
        (10**6, "cluster must be at most 1024, not 1000000"),
        (2.5, r"cluster must be a whole number, not 2\.5"),
    ],
)
def test_a_cluster_that_there_cannot_be_costs_nothing(tmp_path, monkeypatch, cluster_, message):
    monkeypatch.setattr("walker_jax.execution.workers.CONNECT_SECONDS", 0.1)
    with pytest.raises(ValueError, match=message):
        wj.basin(WALKER, GRID, out=tmp_path / "a.zarr", cluster=cluster_)
    assert not [*tmp_path.iterdir()]
    first = wj.basin(WALKER, GRID, strides=5, method="direct", out=tmp_path / "a.zarr")
    options = {"out": tmp_path / "a.zarr", "cluster": cluster_, "overwrite": True}
    with pytest.raises(ValueError, match=message):
        wj.basin(WALKER, GRID, **options)
    with pytest.raises(ValueError, match=message):
        wj.sweep(WALKER, OVER, GRID, **options)
    assert datasets.open_dataset(tmp_path / "a.zarr").identical(first)


@pytest.fixture(scope="module")
def client():
    """Of a cluster in this process, of one worker to begin with."""
    from distributed import Client, LocalCluster

    options = {"processes": False, "threads_per_worker": 1, "dashboard_address": None}
    local: Any = LocalCluster(n_workers=1, **options)
    with local, Client(local) as client:
        yield client


CHANGED = threading.Condition()
COUNT = Counter()


def together(thing):
    """Runs until as many as are wanted have run at once; gives how many these were at most."""
    with CHANGED:
        COUNT["running"] += 1
        COUNT["most"] = max(COUNT["most"], COUNT["running"])
        CHANGED.notify_all()
        if not CHANGED.wait_for(lambda: COUNT["most"] >= COUNT["wanted"], timeout=60):
            COUNT["wanted"] = 0  # it has failed, and the others need not wait
        COUNT["running"] -= 1
        return COUNT["most"]


def test_workers_that_come_later_are_used(client):
    COUNT.clear()
    with open_workers(client) as each:
        done = {}
        for thing, most in each(together, [*range(40)]):
            if not done:
                client.cluster.scale(4)
                client.wait_for_workers(4)
                COUNT["wanted"] = 4
            done[thing] = most
    assert sorted(done) == [*range(40)] and max(done.values()) == 4


TRIED = Counter()


def dying(thing: tuple[str, int]):
    """A piece over which workers have died as often as it says, before it is computed."""
    from distributed import KilledWorker

    name, deaths = thing
    TRIED[thing] += 1
    if TRIED[thing] <= deaths:
        who: Any = SimpleNamespace(address="tcp://127.0.0.1:9")
        raise KilledWorker(name, who, 3)
    return name.upper()


def test_a_piece_over_which_workers_died_is_tried_some_times(client):
    from distributed import KilledWorker

    TRIED.clear()
    pieces = [("a", 0), ("b", workers.MAX_DEATHS), ("c", 1)]
    with open_workers(client) as each:
        assert dict(each(dying, pieces)) == {piece: piece[0].upper() for piece in pieces}
        with pytest.raises(KilledWorker):
            list(each(dying, [("d", workers.MAX_DEATHS + 1)]))


@pytest.fixture
def modes():
    """Those of this process, and its cores, are as before when a test ends."""
    before = {mode: getattr(jax.config, mode) for mode in MODES}
    yield before
    for mode, value in before.items():
        jax.config.update(mode, value)
    tiles.limit_cores(None)


@pytest.mark.parametrize("by", ["client", "address"])
def test_workers_compute_in_the_modes_of_the_process_that_asks(client, modes, monkeypatch, by):
    asked = []
    keep = lambda self, setup: asked.append(setup)
    monkeypatch.setattr(type(client), "register_worker_callbacks", keep)
    with open_workers(client if by == "client" else client.cluster.scheduler_address):
        (setup,) = asked
    others = {"jax_enable_x64": False, "jax_numpy_dtype_promotion": "standard"}
    assert set(others) == set(modes) and not set(others.items()) & set(modes.items())
    for mode, value in others.items():
        jax.config.update(mode, value)
    stopped = []
    profilers = ("profile", "profile-cycle", "heartbeat")
    callbacks = {name: SimpleNamespace(stop=partial(stopped.append, name)) for name in profilers}
    setup(SimpleNamespace(periodic_callbacks=callbacks))
    assert {mode: getattr(jax.config, mode) for mode in modes} == modes
    assert stopped == ["profile", "profile-cycle"]
    workers.configure_worker(modes, 1, SimpleNamespace(periodic_callbacks={}))
    assert tiles.cores() == 1


DYING = """
import sys
from pathlib import Path
import jax
import walker_jax as wj
jax.config.update("jax_enable_x64", True)
def main():
    grid = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.2, 0.05, 25))
    over = {"hip_stiffness": [0.0, 2.0], "slope": [0.004, 0.3]}
    options = {"out": Path(sys.argv[1]), "cluster": 2}
    wj.sweep(wj.SpringWalker(0.004, 0.0), over, grid, levels=0, check=100, **options)
if __name__ == "__main__":
    main()
"""


@pytest.mark.slow
def test_workers_that_are_killed_cost_their_pieces_alone(tmp_path, swept):
    program, path, kills = tmp_path / "program.py", tmp_path / "a.zarr", 0
    program.write_text(DYING)
    rng = np.random.default_rng(0)
    with subprocess.Popen([sys.executable, program, path], stderr=subprocess.DEVNULL) as run:
        while not path.exists() and run.poll() is None:  # till the workers are there
            time.sleep(0.1)
        while run.poll() is None:
            time.sleep(rng.uniform(0.5, 2))
            workers = [pid for pid in descendants(run.pid) if b"spawn_main" in command_of(pid)]
            if workers and kills < 2:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                kills += 1
    assert (run.returncode, kills) == (0, 2)
    found = datasets.open_dataset(path)
    assert found.drop_attrs(deep=False).identical(swept.drop_attrs(deep=False))


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def descendants(pid: int) -> list[int]:
    """Processes that one has started, and those that these have."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        children = [child for one in threads for child in (one / "children").read_text().split()]
    except OSError:
        return []
    return [one for child in map(int, children) for one in (child, *descendants(child))]
