"""Kernels for GPUs, without a GPU: a card that is not there gets what a card would get."""

import itertools
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_card import STREAM, a_card
from jax import lax
from test_primitive_calls import A_FUNCTION, ON_DEVICES, ON_MESHES

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.information import versions
from walker_jax.execution import tiles
from walker_jax.kernels import decorator, gpu, kernel, launcher, machine, ptx, why_not

BY_HANDLER, BY_XLA = gpu.ROUTES


@pytest.fixture(scope="module")
def the_card():
    with a_card() as card:
        yield card


@pytest.fixture
def card(the_card):
    the_card.launches.clear()
    yield the_card
    the_card.status = dict.fromkeys(the_card.status, 0)


@pytest.fixture(params=gpu.ROUTES, ids=["by the handler", "by XLA"])
def route(request):
    token = gpu.trying.set(request.param)
    yield request.param
    gpu.trying.reset(token)


def function(shared, x, n):
    """A loop that ends for each cell at another turn, and results of several types."""

    def step(state):
        i, y = state
        return i + 1, y * shared["scale"] + x[1]

    turns, y = lax.while_loop(lambda state: state[0] < n, step, (jnp.zeros_like(n), x[0]))
    return {"y": y, "both": jnp.stack([x * y, shared["offset"]]), "turns": turns, "big": y > 1}


SHARED = {"scale": jnp.asarray(0.9), "offset": jnp.asarray([2.0, 3.0])}


def cells(n):
    rng = np.random.default_rng(n)
    return jnp.asarray(rng.normal(size=(n, 2))), jnp.asarray(rng.integers(0, 9, n))


def check(found, expected):
    same = lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
    jax.tree.map(same, found, expected)


@pytest.mark.parametrize(("n", "block"), [(0, 64), (1, 64), (64, 64), (65, 64), (257, 256)])
def test_a_launch(card, route, n, block, monkeypatch):
    """Its size, its stream, and its arguments in their order."""
    if block == 256:
        monkeypatch.setattr(ptx, "CACHED", -1)  # the program counts as large
    many = lambda of: jax.jit(jax.vmap(of, (None, 0, 0)))(SHARED, *cells(n))
    check(many(kernel(function)), many(function))
    if n == 0:
        assert not card.launches
        return
    (launch,) = card.launches
    assert launch.grid == (-(-n // block), 1, 1)
    assert launch.block == (block, 1, 1)
    assert (launch.shared_memory, launch.stream, len(launch.arguments)) == (0, STREAM, 1 + 4 + 4)
    if route.fixed:
        assert card.places == [5, 6, 7, 8]
    else:
        assert launch.arguments[0] == n


@pytest.mark.slow
def test_cells_along_several_axes_and_derivatives(card, route):
    xs, counts = cells(6)
    xs = xs.reshape(2, 3, 2)
    for many in (
        lambda of: jax.vmap(jax.vmap(lambda x: of(SHARED, x, counts[0])["y"]))(xs),
        lambda of: jax.vmap(lambda n: of(SHARED, xs[0, 0], n)["both"])(counts),
        lambda of: of(SHARED, xs[0, 0], counts[1])["y"],
        lambda of: jax.vmap(jax.jacfwd(lambda x: of(SHARED, x, counts[2])["both"]))(xs[0]),
        lambda of: jax.jvp(lambda s: of(s, xs[0, 1], counts[3])["y"], (SHARED,), (SHARED,)),
        lambda of: lax.map(lambda x: of(SHARED, x, counts[4])["y"], xs[1]),
    ):
        card.launches.clear()
        check(
            jax.jit(lambda many=many: many(kernel(function)))(),
            jax.jit(many, static_argnums=0)(function),
        )
        assert card.launches
    kernel_of = kernel(lambda x: x[0] * x[1] ** 2)
    expected = np.stack([xs[0, :, 1] ** 2, 2 * xs[0, :, 0] * xs[0, :, 1]], axis=1)
    check(jax.jit(jax.vmap(jax.grad(kernel_of)))(xs[0]), expected)
    check(jax.jit(jax.vmap(jax.hessian(kernel_of)))(xs[0])[:, 1, 1], 2 * xs[0, :, 0])


def test_float32(card, route):
    xs = jnp.linspace(0, 1, 100, dtype=jnp.float32)
    found = jax.jit(jax.vmap(kernel(lambda x: jnp.sqrt(x) * x)))(xs)
    assert found.dtype == jnp.float32 and card.launches
    np.testing.assert_allclose(found, np.sqrt(xs) * xs, rtol=3e-7)


def test_one_operand_twice(card, route):
    x = jnp.arange(5.0)
    found = jax.jit(lambda x: jax.vmap(kernel(lambda a, b: a - 2 * b))(x, x))(x)
    np.testing.assert_array_equal(found, -x)


@pytest.mark.slow
def test_strides(card, route):
    starts = np.stack([np.linspace(0.1, 0.3, 70), np.linspace(-0.1, -0.3, 70)], axis=1)
    walker = wj.SimplestWalker(0.004)
    found = jax.jit(jax.vmap(lambda x: wj.stride(walker, x)))(starts)
    assert card.launches[-1].grid == (2, 1, 1)
    expected = wj.strides(walker, starts)
    np.testing.assert_array_equal(found.outcome, expected.outcome)
    np.testing.assert_allclose(found.state, expected.state, rtol=1e-12)


SHARDED = """
import sys
sys.path.insert(0, sys.argv[2])
from fake_card import a_card
from walker_jax.kernels import gpu
gpu.trying.set(gpu.ROUTES[0])
with a_card() as card:
    exec(sys.argv[1])
assert len(card.launches) > 30
"""


@pytest.mark.slow
def test_cells_on_several_devices():
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    flags["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    helpers = str(Path(__file__).parents[1] / "helpers")
    command = [sys.executable, "-c", SHARDED, A_FUNCTION + ON_DEVICES + ON_MESHES, helpers]
    done = subprocess.run(command, env=os.environ | flags, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("way", gpu.ROUTES, ids=["by the handler", "by XLA"])
def test_xlas_own_call_is_not_divided(card, way, monkeypatch):
    """Its number of cells is fixed, so that XLA would give it all of them on each device.

    XLA divides cells along the axes of a mesh that `jax.shard_map` leaves to it.
    """
    monkeypatch.setattr(gpu, "route_in_use", lambda: way)
    mesh = jax.make_mesh((1, 1), ("a", "b"), axis_types=(jax.sharding.AxisType.Auto,) * 2)
    each = {"mesh": mesh, "in_specs": jax.P("a"), "out_specs": jax.P("a")}
    many, xs = jax.vmap(kernel(lambda x: 3 * x)), jnp.arange(8.0)
    lowered = lambda axes: jax.jit(jax.shard_map(many, axis_names=axes, **each)).lower(xs).as_text()
    whole, divided = lowered({"a", "b"}), lowered({"a"})
    call = gpu.PTX_CALL if way is BY_XLA else "stablehlo.custom_call @walker_jax"
    assert call in whole and "num_batch_dims" not in whole
    assert (call in divided) == ("num_batch_dims" in divided) == (way is BY_HANDLER)


# Routes


numbers = itertools.count(1000)


def another_tiny():
    """XLA would know the same program, and the driver would have it."""
    most = np.float32(next(numbers))
    return lambda shared, x: shared * jnp.minimum(x, most) + 1


@pytest.fixture
def switched_on(card, monkeypatch):
    """A GPU is there, as far as routes look for one."""
    monkeypatch.delenv(machine.VARIABLE, raising=False)
    here = jax.local_devices()
    monkeypatch.setattr(jax, "local_devices", lambda *_, **__: here)
    monkeypatch.setattr(gpu, "tiny", another_tiny())
    caches = gpu.failure_of, launcher.load_driver, gpu.ffi.available
    for function in caches:
        function.cache_clear()
    yield card
    for function in caches:
        function.cache_clear()


def many_of(factor):
    """The launches of a kernel that is not known yet, whose results are checked."""
    xs = jnp.arange(5.0)
    np.testing.assert_array_equal(jax.jit(jax.vmap(kernel(lambda x: factor * x)))(xs), factor * xs)


def test_the_first_route_that_works_is_taken(switched_on):
    assert gpu.route_in_use() is BY_HANDLER
    assert [launch.grid for launch in switched_on.launches] == [(2, 1, 1)]  # the trial
    many_of(2.0)
    assert len(switched_on.launches) == 2
    assert gpu.in_words().startswith("in use, by XLA's foreign function interface")


def test_what_is_in_use_is_said(switched_on, monkeypatch):
    """In a report of a bug, and of a function."""
    gpu.route_in_use()
    a_gpu = SimpleNamespace(platform="gpu", device_kind="a card")
    monkeypatch.setattr(jax, "devices", lambda: [a_gpu])
    assert "kernels are in use, by XLA's foreign function interface" in " ".join(versions())
    monkeypatch.setattr(jax, "devices", jax.local_devices)
    monkeypatch.setenv(machine.VARIABLE, "cpu")
    assert f"  kernels are in use, compiled for {machine.processor()[0]}" in versions()
    monkeypatch.delenv(machine.VARIABLE)
    there = SimpleNamespace(devices=lambda: [SimpleNamespace(platform="gpu")])
    monkeypatch.setattr(decorator.jnp, "zeros", lambda _: there)
    assert why_not(lambda x: 23 * x, 1.0) is None
    assert str(why_not(lambda x: jnp.sort(x), jnp.ones(3))).startswith(
        "kernels do not support sort"
    )
    monkeypatch.setenv(machine.VARIABLE, "cpu")
    assert str(why_not(lambda x: 23 * x, 1.0)).startswith("arrays are on a gpu, where kernels are")


def no_driver(_):
    raise OSError("libcuda.so.1: cannot open shared object file")


def failing(what, status):
    return lambda patch, card: card.status.update({what: status})


@pytest.mark.parametrize(
    ("remove", "reason"),
    [
        (
            lambda patch, card: patch.setattr(launcher.ctypes, "CDLL", no_driver),
            "OSError: libcuda.so.1: cannot open shared object file",
        ),
        (failing("init", 100), "OSError: NVIDIA's driver fails, with CUDA's error 100"),
        (failing("load", 218), "OSError: NVIDIA's driver fails, with CUDA's error 218"),
        (
            failing("launch", 701),
            "JaxRuntimeError: INTERNAL: NVIDIA's driver could not launch a kernel: "
            "WALKER_JAX_KERNELS=cpu leaves what is on GPUs to XLA",
        ),
    ],
    ids=["the driver", "a card", "a driver that takes the PTX", "room for a launch"],
)
def test_where_a_part_is_missing(remove, reason, switched_on, monkeypatch):
    remove(monkeypatch, switched_on)
    assert gpu.route_in_use() is BY_XLA
    assert gpu.failure_of(BY_HANDLER) == reason
    assert f"by XLA's own call of PTX; not by {BY_HANDLER.name}: {reason}" in gpu.in_words()
    before = len(switched_on.launches)
    many_of(3.0 + len(reason))
    assert len(switched_on.launches) == before + 1


def test_where_xlas_interface_is_unknown(switched_on, monkeypatch):
    monkeypatch.setattr(gpu.ffi, "VERSION", (0, 10**6))
    with pytest.warns(RuntimeWarning, match="more slowly"):
        assert gpu.route_in_use() is BY_XLA
    assert "interface is of an unknown version" in str(gpu.failure_of(BY_HANDLER))


def test_a_wrong_result_is_no_route(switched_on, monkeypatch):
    monkeypatch.setattr(type(switched_on), "work", lambda *_: None)
    assert gpu.route_in_use() is None
    assert gpu.in_words() == "not in use" + "".join(
        f"; not by {route.name}: its results are wrong" for route in gpu.ROUTES
    )


def test_without_a_gpu_xla_computes(card, monkeypatch):
    monkeypatch.delenv(machine.VARIABLE, raising=False)
    gpu.failure_of.cache_clear()
    assert gpu.route_in_use() is None
    for route in gpu.ROUTES:
        assert (
            gpu.failure_of(route)
            == "RuntimeError: Unknown backend cuda. Available backends are ['cpu']"
        )
    many_of(5.0)
    assert not card.launches


def test_a_program_that_the_driver_refuses_is_xlas(switched_on):
    """Though it took the tiny one of the trial."""
    assert gpu.route_in_use() is BY_HANDLER
    switched_on.launches.clear()
    switched_on.status["load"] = 2
    with pytest.warns(RuntimeWarning, match="driver fails, with CUDA's error 2: XLA computes"):
        many_of(8.0)
    assert not switched_on.launches


def test_a_launch_that_fails_names_the_way_out(switched_on):
    assert gpu.route_in_use() is BY_HANDLER
    switched_on.status["launch"] = 701
    with pytest.raises(jax.errors.JaxRuntimeError, match="WALKER_JAX_KERNELS=cpu leaves"):
        many_of(9.0)


def test_a_setting_that_is_none_is_refused(switched_on, monkeypatch):
    """Before anything is tried, whose failure would be kept."""
    monkeypatch.setenv(machine.VARIABLE, "gpu")
    with pytest.raises(WrongUse, match="must be off, cpu, or a processor that LLVM knows"):
        gpu.route_in_use()
    monkeypatch.delenv(machine.VARIABLE)
    assert gpu.route_in_use() is BY_HANDLER


def test_without_a_compiler_for_cards(switched_on, monkeypatch):
    def no_target(_):
        raise RuntimeError("No available targets are compatible with triple")

    monkeypatch.setattr(ptx, "ptx_of", lambda source: no_target(source))
    assert gpu.route_in_use() is None
    many_of(6.0)
    assert not switched_on.launches


@pytest.mark.parametrize("setting", ["off", "cpu", "CPU"])
def test_kernels_on_gpus_are_switched_off(switched_on, monkeypatch, setting):
    card = switched_on
    monkeypatch.setenv(machine.VARIABLE, setting)
    assert gpu.route_in_use() is None
    assert gpu.in_words() == f"not in use: WALKER_JAX_KERNELS is {setting.lower()}"
    many_of(7.0)
    assert not card.launches


def test_what_kernels_do_not_support_is_xlas(switched_on, monkeypatch):
    middle = kernel(lambda x: jnp.sort(x)[1])
    assert jax.jit(middle)(jnp.asarray([3.0, 1.0, 2.0])) == 2
    assert [launch.grid for launch in switched_on.launches] == [(2, 1, 1)]


# Cells in pieces


@pytest.fixture
def as_on_a_gpu(switched_on, monkeypatch):
    """`map_cells` takes the CPU of the tests for a GPU."""
    monkeypatch.setattr(tiles, "route_here", gpu.route_in_use)
    monkeypatch.setattr(tiles, "GPU_CALL_CELLS", (64, 256))
    return switched_on


@pytest.mark.parametrize("n", [0, 1, 65, 256, 600])
def test_calls_of_a_kernel(as_on_a_gpu, n):
    xs = np.linspace(0, 1, n)
    gpu.route_in_use()
    as_on_a_gpu.launches.clear()
    found = tiles.map_cells(lambda shared, x: shared * x - 1, (np.float64(n), xs))
    np.testing.assert_allclose(found, n * xs - 1, rtol=1e-14, atol=1e-15)
    sizes = {0: [], 1: [64], 65: [128], 256: [256], 600: [256] * 3}[n]
    assert [launch.arguments[0] for launch in as_on_a_gpu.launches] == sizes


@pytest.mark.slow
def test_a_basin(as_on_a_gpu, monkeypatch):
    """Walks are followed in fewer rounds, to the same ends."""
    walker, grid = (
        wj.SimplestWalker(0.004),
        wj.Grid.sheared(theta=(0.1, 0.3, 12), sum=(-0.1, 0.0, 12)),
    )
    as_on_a_gpu.launches.clear()
    found = wj.basin(walker, grid, method="direct")
    assert as_on_a_gpu.launches
    monkeypatch.undo()
    np.testing.assert_array_equal(found.fate, wj.basin(walker, grid, method="direct").fate)
