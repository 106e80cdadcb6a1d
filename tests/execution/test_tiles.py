import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from timers import AtOnce

import walker_jax as wj
from walker_jax.execution import tiles
from walker_jax.execution.tiles import CALL_SHAPES, KERNEL_CALL_CELLS, compact_order, map_cells
from walker_jax.identity import Cache
from walker_jax.kernels import program as of_program
from walker_jax.kernels.jaxprs import UnsupportedPrimitive

CALL = CALL_SHAPES["cpu"][0] * CALL_SHAPES["cpu"][1]


def sum_and_norm(shared, cell):
    return {"sum": shared["offset"] + jnp.sum(cell["x"]), "scaled": cell["i"] * cell["x"]}


def by_xla(shared, cell):
    """The same, with what no kernel can do in it."""
    result = sum_and_norm(shared, cell)
    return result | {"sum": result["sum"] + 0 * jnp.sort(cell["x"])[0]}


@pytest.mark.parametrize(
    "n",
    [0, 1, 2, 511, 512, 513, CALL_SHAPES["cpu"][0], CALL - 1, CALL, CALL + 1, 2 * CALL + 77, 2**18],
)
@pytest.mark.parametrize("function", [sum_and_norm, by_xla])
def test_any_number_of_cells(function, n):
    rng = np.random.default_rng(n)
    cells = {"x": rng.normal(size=(n, 3)), "i": rng.normal(size=n)}
    result = map_cells(function, ({"offset": 2.5}, cells))
    np.testing.assert_allclose(result["sum"], 2.5 + cells["x"].sum(axis=1), rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(result["scaled"], cells["i"][:, None] * cells["x"])


def test_parts_and_transposes_of_arrays_are_taken_as_they_are():
    x = np.random.default_rng(0).normal(size=(3, 60))
    cells = {"x": x.T[::2], "i": x[0, ::2]}
    result = map_cells(sum_and_norm, ({"offset": 0}, cells))
    np.testing.assert_array_equal(result["scaled"], cells["i"][:, None] * x.T[::2])


def scaled(shared, cell):
    return jnp.sin(jnp.asarray(1, float)) * shared * cell


def test_a_kernel_is_made_anew_for_another_mode_of_jax():
    cells = np.ones(3, np.float32)
    with jax.numpy_dtype_promotion("standard"):
        assert map_cells(scaled, (2.0, cells)).dtype == np.float64
        assert map_cells(scaled, (jnp.asarray(2.0), cells)).dtype == np.float64
        with jax.enable_x64(False):
            assert map_cells(scaled, (2.0, cells)).dtype == np.float32
    with pytest.raises(jax.dtypes.TypePromotionError):
        map_cells(scaled, (2.0, cells))


def times(shared, cell):
    return shared * cell


def test_what_is_shared_may_be_of_a_weak_type():
    cells = np.ones(3, np.float32)
    for weak in (2, 2.0, jnp.asarray(2.0)):
        assert map_cells(times, (weak, cells)).dtype == np.float32
    with jax.numpy_dtype_promotion("standard"):
        assert map_cells(times, (2j, cells)).dtype == np.complex64


@pytest.mark.parametrize("turn", [1, -1])
def test_a_kernel_is_made_anew_for_a_number_of_another_kind(turn):
    """A plain number takes the type of the cells; one of NumPy's has its own."""
    function = lambda shared, cell: shared * cell
    with jax.numpy_dtype_promotion("standard"):
        for shared, dtype in ((2.0, np.float32), (np.float64(2.0), np.float64))[::turn]:
            assert map_cells(function, (shared, np.ones(3, np.float32))).dtype == dtype


def no_kernel(closed, shared):
    raise UnsupportedPrimitive("any")


@pytest.fixture(scope="module")
def starts():
    rng = np.random.default_rng(0)
    theta = rng.uniform(0.01, 0.4, 20_000)
    return np.stack([theta, rng.uniform(-0.04, 0.01, 20_000) - theta], axis=1)


@pytest.mark.slow
def test_strides_by_kernels_and_by_xla_are_the_same_to_rounding(monkeypatch, starts):
    walker = wj.SimplestWalker(0.004)
    found = wj.strides(walker, starts)
    monkeypatch.setattr(of_program, "Compiled", no_kernel)
    monkeypatch.setattr(of_program, "programs", Cache())
    expected = wj.strides(walker, starts)
    np.testing.assert_array_equal(found.outcome, expected.outcome)
    np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=1e-9)
    assert np.nanmedian(np.abs(found.state - expected.state)) < 1e-14


def test_an_option_that_xla_lacks_is_left_out(monkeypatch):
    """With it XLA would compile nothing."""
    options = {"xla_cpu_prefer_vector_width": 256, "xla_no_such_option": 1}
    monkeypatch.setitem(tiles.COMPILER_OPTIONS, "cpu", options)
    monkeypatch.setattr(of_program, "Compiled", no_kernel)
    monkeypatch.setattr(of_program, "programs", Cache())
    cells = np.arange(5.0)
    found = map_cells(lambda shared, cell: shared + cell**2, (3.0, cells))
    np.testing.assert_array_equal(found, 3 + cells**2)
    assert tiles.options_for("cpu") == {"xla_cpu_prefer_vector_width": 256}


def test_cells_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"cells .*\[3, 4\]"):
        map_cells(sum_and_norm, ({"offset": 0.0}, {"x": np.ones((3, 2)), "i": np.ones(4)}))


@pytest.mark.parametrize("shape", [(7,), (5000,), (200, 250), (3, 10000), (33, 65), (20, 30, 40)])
def test_compact_order_is_a_permutation_into_compact_tiles(shape):
    order = compact_order(shape, CALL_SHAPES["cpu"][0])
    size = int(np.prod(shape))
    np.testing.assert_array_equal(np.sort(order), np.arange(size))
    places = np.stack(np.unravel_index(order, shape), axis=1)
    tiles = np.array_split(places, range(CALL_SHAPES["cpu"][0], size, CALL_SHAPES["cpu"][0]))
    extents = np.array([np.ptp(tile, axis=0) + 1 for tile in tiles])
    # the side of a cube, or the length of a tile that is as wide as a narrow grid
    side = max(CALL_SHAPES["cpu"][0] ** (1 / len(shape)), CALL_SHAPES["cpu"][0] / min(shape))
    # blocks that do not divide the grid make tiles drift over two or three of them
    assert np.median(extents, axis=0).max() <= 3 * side


def assert_same_bits(one: wj.Stride, other: wj.Stride) -> None:
    for values, others in zip(one, other, strict=True):
        np.testing.assert_array_equal(values, others)
    assert 0 < (one.outcome == wj.Outcome.STRIDE).sum() < len(one.outcome)


def test_same_bits_on_one_core_and_on_two(monkeypatch, starts):
    results = []
    for cores in ({0}, {0, 1}):
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid, cores=cores: cores, raising=False)
        results.append(wj.strides(wj.SimplestWalker(0.004), starts))
    assert_same_bits(*results)


DEVICES = """
import sys
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from walker_jax.execution import tiles
from walker_jax.kernels.program import Program
jax.config.update("jax_enable_x64", True)
Program.compiled = None  # so that it is XLA that computes, as on an accelerator
devices = jax.local_devices()
assert len(devices) == 8

def until_near(rate, x):
    turned = lambda a, b: (jnp.sin(0.9 * a) + rate * b, 0.9 * b - rate * a)
    step = lambda c: (*turned(*c[:2]), c[2] + 1)
    near = lambda c: (jnp.hypot(c[0], c[1]) > 0.01) & (c[2] < 400)
    first, second, steps = lax.while_loop(near, step, (x[0], x[1], 0))
    return {"state": jnp.stack([first, second]), "steps": steps}

starts = np.load(f"{sys.argv[1]}/starts.npy")
for n in map(int, sys.argv[2:]):
    jax.local_devices = lambda: devices[:n]
    tiles.compile_call.cache_clear()
    np.savez(f"{sys.argv[1]}/on{n}.npz", **tiles.map_cells(until_near, (0.3, starts)))
"""


@pytest.mark.parametrize("counts", [(1, 8), pytest.param((2, 4, 8), marks=pytest.mark.slow)])
def test_same_bits_on_one_device_and_on_eight(tmp_path, starts, counts):
    """Of eight devices, some have nothing to do in the last call."""
    np.save(tmp_path / "starts.npy", starts)
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=8"}
    command = [sys.executable, "-c", DEVICES, str(tmp_path), *map(str, counts)]
    subprocess.run(command, check=True, env={**os.environ, **flags})
    one, *others = (np.load(tmp_path / f"on{n}.npz") for n in counts)
    assert 5 < len(np.unique(one["steps"])) and np.isfinite(one["state"]).all()
    for other in others:
        for name in one:
            np.testing.assert_array_equal(other[name], one[name])


WALKERS_ON_DEVICES = DEVICES.replace(
    "tiles.map_cells(until_near, (0.3, starts))",
    "wj.strides(wj.SimplestWalker(0.004), starts)._asdict()",
).replace("import jax\n", "import jax\nimport walker_jax as wj\n", 1)


@pytest.mark.slow
def test_strides_have_the_same_bits_on_one_device_and_on_eight(tmp_path, starts):
    np.save(tmp_path / "starts.npy", starts)
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=8"}
    command = [sys.executable, "-c", WALKERS_ON_DEVICES, str(tmp_path), "1", "2", "8"]
    subprocess.run(command, check=True, env={**os.environ, **flags})
    one, *others = (wj.Stride(**np.load(tmp_path / f"on{n}.npz")) for n in (1, 2, 8))
    assert len(np.unique(one.outcome)) > 1
    for other in others:
        assert_same_bits(one, other)


def sorted_sines(shared, x):
    return jnp.sort(jnp.stack([x, jnp.sin(jnp.asarray(1e5, float) * x)]))


def test_threads_compute_in_the_modes_of_the_caller():
    """They belong to a thread; no kernel sorts, so that XLA computes, in several threads."""
    with jax.enable_x64(False):
        x = np.random.default_rng(0).random(CALL + 1).astype(np.float32)
        found = map_cells(sorted_sines, (None, x))
        expected = jax.vmap(lambda x: sorted_sines(None, x))(x)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_bar_is_shown_on_a_terminal_only(capfd, monkeypatch):
    monkeypatch.setattr("walker_jax.execution.progress.quiet", False)
    monkeypatch.setattr("walker_jax.execution.progress.Timer", AtOnce)
    some = KERNEL_CALL_CELLS[0] + 1
    cells = {"x": np.ones((some, 2)), "i": np.ones(some)}
    map_cells(sum_and_norm, ({"offset": 0.0}, cells), progress="the work")
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes this for a terminal
    map_cells(sum_and_norm, ({"offset": 0.0}, cells), progress="the work")
    out, err = capfd.readouterr()
    assert out == "" and "the work" in err
    map_cells(sum_and_norm, ({"offset": 0.0}, cells))
    few = jax.tree.map(lambda leaf: leaf[1:], cells)
    map_cells(sum_and_norm, ({"offset": 0.0}, few), progress="over before a bar is shown")
    assert capfd.readouterr() == ("", "")
