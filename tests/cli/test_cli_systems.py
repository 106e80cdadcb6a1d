"""Systems that are no walkers, on the command line."""

import functools
import json
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from henon import as_map

import walker_jax as wj
from walker_jax.stability.robustness_fields import summarise_robustness
from walker_jax.systems.family import SYSTEMS
from walker_jax.walkers.parameters import parameters

HENON = """
import jax.numpy as jnp
import walker_jax as wj

def henon(x, a, b):
    return jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])

stays = lambda x, a, b: 100 - jnp.sum(x**2)
region = {"x": (-2, 2, 5), "y": (-1, 1, 5)}
system = wj.Map(henon, ("x", "y"), parameters={"a": 1.02, "b": 0.3}, feasible=stays, region=region)

class Shrinking(wj.System):
    factor: float = 0.5
    section = ("x", "y", "z")

    def advance(self, x):
        return self.factor * x, wj.Outcome.STRIDE, 1.0

    def feasible(self, x):
        return jnp.sum(jnp.abs(x)) < 1
"""
SQUARE = ("--axis", "x=-2:2:40", "--axis", "y=-2:2:30")
DIRECT = (*SQUARE, "--method", "direct", "--strides", "500")


@pytest.fixture
def run(run, monkeypatch, tmp_path):
    """Run a command beside the file `my_maps.py`; returns exit code, standard output and error."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    tmp_path.joinpath("my_maps.py").write_text(HENON)

    def run_anew(*arguments):
        sys.modules.pop("my_maps", None)
        return run(*arguments)

    yield run_anew
    sys.modules.pop("my_maps", None)


def stays(x, a, b):
    return 100 - jnp.sum(x**2)


def own(a: float = 1.02) -> wj.Map:
    return as_map(a, feasible=stays)


def test_a_basin_is_that_of_the_library_and_kept_for_its_code(run, tmp_path):
    command = ("basin", "--system", "my_maps.py:system", *DIRECT, "--a", "0.95", "--json")
    code, out, err = run(*command)
    assert code == 0, err
    answer, kept = json.loads(out), xr.open_zarr("basin.zarr", consolidated=False)
    grid = wj.Grid.plain(x=(-2, 2, 40), y=(-2, 2, 30))
    data = wj.basin(own(0.95), grid, "direct", strides=500)
    np.testing.assert_array_equal(kept["fate"], data["fate"])
    np.testing.assert_array_equal(kept["attractor"], data["attractor"])
    assert answer["walker"] == {"name": "henon", "a": 0.95, "b": 0.3} and "slope" not in answer
    assert answer["area"] == float(data["area"].sum()) > 1
    assert [one["period"] for one in answer["attractors"]] == data["period"].values.tolist() == [4]
    assert tmp_path.joinpath("basin.png").is_file()

    assert "taken from basin.zarr" in run(*command[:-1])[1]
    source = tmp_path.joinpath("my_maps.py")
    source.write_text(HENON.replace("b * x[0]", "b * x[0] * 1"))
    code, out, err = run(*command)
    assert (code, out) == (2, "") and "basin.zarr holds another result (code" in err


def test_without_axes_the_window_is_that_of_gaits(run):
    code, _, err = run(
        "basin", "--system", "my_maps.py:system", "--method", "direct", "--levels", "0"
    )
    assert code == 0, err
    data = xr.open_zarr("basin.zarr", consolidated=False)
    ends = [float(data[name][i]) for name in "xy" for i in (0, -1)]
    assert ends == pytest.approx([-1.99, 1.99, -0.995, 0.995])
    assert data["fate"].shape == (200, 200)


def test_gaits_from_a_start_and_of_any_period(run):
    starts = ("--start", "x=0.5", "--start", "y=0.2")
    code, out, err = run("gait", "--system", "my_maps.py:system", "--a", "1.1", *starts, "--json")
    assert code == 0, err
    (found,) = json.loads(out)["gaits"]
    expected = wj.find_gait(own(1.1), [0.5, 0.2])
    np.testing.assert_array_equal(found["states"], expected.states)
    code, out, _ = run("gait", "--system", "my_maps.py:system", "--period", "2", "--a", "0.8")
    assert code == 0 and out.startswith("stable cycle of period 2 of henon, multipliers")


def test_slices_fix_any_coordinate(run):
    for fixed, along in (("z", "xy"), ("x", "yz")):
        axes = [part for name in along for part in ("--axis", f"{name}=-1:1:20")]
        command = ("basin", "--system", "my_maps.py:Shrinking", *axes, "--axis", f"{fixed}=0.25")
        code, out, err = run(*command, "--out", f"{fixed}.zarr")
        assert code == 0, err
        assert f"slice at {fixed} 0.25" in out and "rad" not in out
        data = xr.open_zarr(f"{fixed}.zarr", consolidated=False)
        first, second = (np.linspace(-0.95, 0.95, 20),) * 2
        near = np.abs(first)[:, None] + np.abs(second) < 0.75
        np.testing.assert_array_equal(data["fate"] == wj.Outcome.STRIDE, near)


def test_a_slice_elsewhere_is_another_request(run):
    axes = ("--axis", "y=-0.9:0.9:20", "--axis", "z=-0.9:0.9:20", "--samples", "300")
    command = ("continuation", "--system", "my_maps.py:Shrinking", "--over", "factor=0.4:0.5:2")
    code, out, err = run(*command, "--axis", "x=0.1", *axes, "--json")
    assert code == 0, err
    share = json.loads(out)["attractors"][0]["largest_fraction"]
    assert share == pytest.approx(2 * 0.9**2 / 1.8**2, abs=0.1)  # of the square, |y| + |z| < 0.9
    code, out, err = run(*command, "--axis", "x=0.8", *axes)
    assert (code, out) == (2, "") and "continuation.zarr holds another result" in err


def test_bifurcations_over_a_parameter_that_is_named(run, monkeypatch):
    diagram, kept = functools.partial(wj.bifurcation_diagram, scan=10), []

    def once(*arguments, **more):
        kept[:] = kept or [diagram(*arguments, **more)]
        return kept[0].copy()

    monkeypatch.setattr("walker_jax.bifurcation_diagram", once)
    command = ["bifurcation", "--system", "henon", "--over", "a", "--from", "0.3", "--to", "0.95"]
    code, out, err = run(*command, "--period-max", "2", "--json")
    assert code == 0, err
    doublings = [one["value"] for one in json.loads(out)["doublings"]]
    np.testing.assert_allclose(doublings, [0.3675, 0.9125], rtol=1e-12)  # by Henon's formulas
    code, out, err = run(*command, "--period-max", "2")
    assert code == 0 and "from a 0.3 to 0.95\n" in out and "up to the highest a\n" in out, err
    spring = ("--walker", "spring", "--slope", "0.01", "--over", "hip-stiffness", "--to", "2")
    code, out, err = run("bifurcation", *spring)
    assert (code, err) == (2, "walker-jax: --from is required: the range of hip-stiffness\n")


def test_walks_of_a_system(run):
    command = ["walk", "--system", "my_maps.py:system", "--start", "x=0.5", "--start", "y=0"]
    code, out, err = run(*command, "--strides", "3", "--json")
    assert code == 0, err
    made = json.loads(out)
    expected = wj.walk(own(1.02), jnp.array([0.5, 0.0]), 3)
    np.testing.assert_allclose(made["states"], expected.states, rtol=1e-15)
    assert made["outcomes"] == ["STRIDE"] * 3 and made["times"] == [1.0] * 3
    code, out, err = run(*command)
    assert code == 0 and out.split()[:4] == ["iterate", "x", "y", "outcome"], err
    code, out, err = run("walk", "--system", "bouncing-ball", "--strides", "2")
    assert code == 0 and "3.141593" in out, err
    for option in ("--ground", "0.1"), ("--animate", "film.gif"), ("--theta", "0.2"):
        code, out, err = run(*command, *option)
        assert (code, out) == (2, "") and option[0] in err


@pytest.mark.slow
def test_robustness_of_a_system(run):
    small = ("--levels", "0", "--strides", "300")
    command = ["robustness", "--system", "my_maps.py:system", "--a", "0.3", *small]
    code, out, err = run(*command, "--axis", "x=-2:2:30", "--axis", "y=-2:2:30", "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["walker"]["a"] == 0.3 and "slope" not in found and found["step_down"] is None
    assert found["gait"]["state"] == pytest.approx([1.0, 0.3]) and found["area"] == 16
    assert found["least_disturbance"]["failure"] == "OUTSIDE"
    table = ("--over", "a", "--from", "0.2", "--to", "0.3", "--count", "2", "--out", "t.zarr")
    code, out, err = run("robustness", "--system", "my_maps.py:system", *table, *small, *SQUARE)
    assert code == 0 and "\n  a 0.2: area " in out and "\n  a 0.3: area " in out, err


class Nowhere(wj.System):
    """All that is tried returns."""

    section = "x", "y"

    def advance(self, x):
        return 0.1 * x, wj.Outcome.STRIDE, 1.0

    def gait_region(self):
        return wj.Grid.plain(x=(-1, 1, 10), y=(-1, 1, 10))


def test_where_nothing_fails_robustness_has_the_rest():
    data = wj.robustness(Nowhere(), levels=0, check=0)
    assert np.isnan(data["least_disturbance"]) and data["failure"] == data["fall_failure"] == -1
    assert data["stability"] == 1 and data["total_area"] == pytest.approx(4, rel=1e-12)
    found = summarise_robustness(data, {})
    assert found["least_disturbance"]["failure"] is None and found["gait"]["period"] == 1


def test_a_sweep_needs_no_region_of_gaits(run, tmp_path):
    source = tmp_path.joinpath("my_maps.py")
    source.write_text(HENON.replace(", region=region", ""))
    over = ("--over", "a=0.9:1.0:2", "--check", "2000")
    code, out, err = run("sweep", "--system", "my_maps.py:system", *over, *SQUARE, "--json")
    assert code == 0, err
    assert [one["failed"] for one in json.loads(out)["points"]] == [0, 0]
    assert [one["gait_period"] for one in json.loads(out)["points"]] == [2, 4]


@pytest.mark.slow
def test_other_commands_take_systems_too(run):
    code, out, err = run(
        "explain", "--system", "my_maps.py:system", "--start", "x=0.5", "--start", "y=0"
    )
    assert code == 0 and out.startswith("henon from (0.5, 0): goes on\n"), err
    over = ("--over", "a=0.9:1.0:2")
    code, out, err = run(
        "sweep", "--system", "my_maps.py:system", *over, *SQUARE, "--check", "2000", "--json"
    )
    assert code == 0, err
    assert [one["gait_period"] for one in json.loads(out)["points"]] == [2, 4]
    code, out, err = run(
        "continuation", "--system", "my_maps.py:system", *over, *SQUARE, "--samples", "500"
    )
    assert code == 0 and "period doubling of 0 at 0.9125" in out, err
    flat = ("--axis", "x=-0.2:0.2:20", "--axis", "y=-0.2:0.2:20", "--strides", "50", "--json")
    code, out, err = run("boundary", "--system", "my_maps.py:system", "--a", "0.1", *flat)
    assert code == 0 and json.loads(out)["edges"] == [], err


def test_systems_are_listed_and_their_parameters_have_bounds(run):
    code, out, _ = run("--list-walkers")
    assert code == 0
    for name, kind in SYSTEMS.items():
        own = out[out.index(f"--system {name}:") :].splitlines()
        assert own[1] == f"  section ({', '.join(kind.section)})"
        for one in parameters(kind):
            assert any(line.startswith(f"  --{one.name.replace('_', '-')} ") for line in own)
    code, _, err = run("gait", "--system", "torso-wheel", "--torso-mass", "-1")
    said = "walker-jax: --torso-mass must be finite and not negative, not -1.0\n"
    assert (code, err) == (2, said)
