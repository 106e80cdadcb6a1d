"""Neimark-Sacker points along branches: of maps in the place of strides, known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from maps import done_with

import walker_jax as wj
from walker_jax import figures
from walker_jax.gaits import continuation
from walker_jax.gaits.branches import Branch
from walker_jax.gaits.crises import Loss
from walker_jax.gaits.diagrams import assemble_diagram
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.gait_summary import summarise_bifurcations
from walker_jax.integrators.integrator import Integrator
from walker_jax.storage.schema import check_dataset
from walker_jax.walking.iteration import orbits


def delayed_logistic(x, p):
    """x' = p x (1 - y), y' = x: its fixed point, x = y = 1 - 1/p, has exp(+-i pi / 3) at p = 2."""
    return jnp.stack([p * x[0] * (1 - x[1]), x[0]])


def with_a_third(x, p):
    """The same beside a coordinate that it drives, and that is at rest with a multiplier of 0.3."""
    return jnp.append(delayed_logistic(x[:2], p), 0.3 * x[2] + x[0] * x[1])


def in_two_scales(x, p):
    """The same in coordinates whose scale changes from stride to stride: cycles of period two."""
    side = x[2]
    next_side = -(3 * side - side**3) / 2
    return jnp.append(
        (1 + 0.2 * next_side) * delayed_logistic(x[:2] / (1 + 0.2 * side), p), next_side
    )


def saddle(x, p):
    """Multipliers p and 0.8 of the fixed point 0: their product passes 1, and both are real."""
    return jnp.stack([p * x[0] + x[0] ** 3, 0.8 * x[1]])


def path_of(stride, states, value, bounds=(1.6, 2.4)):
    start = continuation.Start(value, np.asarray(states, float))
    return done_with(stride, continuation.follow_branch(start, 1.0, bounds))


@pytest.mark.parametrize(
    ("stride", "states", "angle"),
    [
        (delayed_logistic, [[3 / 8] * 2], np.pi / 3),
        (with_a_third, [[3 / 8, 3 / 8, 9 / 64 / 0.7]], np.pi / 3),
        (in_two_scales, [[0.45, 0.45, 1.0], [0.3, 0.3, -1.0]], 2 * np.pi / 3),
    ],
)
def test_a_pair_that_leaves_the_unit_circle_is_located(stride, states, angle):
    path = path_of(stride, states, 1.6)
    assert path.end == "the end of the range" and len(path.events) == 1
    (found,) = path.events
    assert found.kind == "neimark-sacker"
    assert abs(found.value - 2) < 1e-12 and found.residual < 1e-12
    upper = found.multipliers[0]
    assert abs(upper - np.exp(1j * angle)) < 1e-11
    scales = [1.0] if len(states) == 1 else [1.2, 0.8]
    for state, scale in zip(found.states, scales, strict=True):
        np.testing.assert_allclose(state[:2], 0.5 * scale, rtol=0, atol=1e-12)
    before, after = (
        [one for one in path.points if (one.value > 2) == beyond] for beyond in (False, True)
    )
    assert before and after


def test_real_multipliers_whose_product_is_one_are_none():
    path = path_of(saddle, [[0.0, 0.0]], 1.1, (1.1, 1.6))
    assert path.end == "the end of the range" and path.events == []


def test_they_are_in_the_data_of_a_diagram_and_its_picture():
    """Of a branch with two points, beside what its folds and doublings are told by."""
    walker = wj.SimplestWalker(0.01)
    states, multipliers = np.array([[[0.2, -0.2]], [[0.3, -0.3]]]), np.array([[0.9 + 0.3j] * 2] * 2)
    multipliers[:, 1] = multipliers[:, 1].conj()
    points = [
        Bifurcation("neimark-sacker", value, states[0], np.exp([1j, -1j]), states[0] + 0j, 0.0)
        for value in (0.012, 0.014)
    ]
    sizes = states[..., 0]
    branch = Branch(
        "slope", np.array([0.01, 0.02]), states, multipliers, sizes, [], [], ("", ""), tuple(points)
    )
    shapes = {"fate": (1, 1), "strides": (1, 1), "period": (1, 1)}
    scanned = xr.Dataset(
        {name: (("sample", "start"), np.zeros(shape, int)) for name, shape in shapes.items()}
        | {
            "value": ("sample", np.array([0.01])),
            "orbit": (("sample", "start", "recent", "coordinate"), np.zeros((1, 1, 4, 2))),
        },
        attrs={"strides": 4},
    )
    loss = Loss(0.02, np.nan, 10)
    data = assemble_diagram(walker, "slope", [branch], [0], scanned, loss)
    check_dataset(data, "bifurcation diagram")
    np.testing.assert_array_equal(data["torus_value"], [0.012, 0.014])
    found = summarise_bifurcations(data)["neimark_sackers"]
    assert [one["slope"] for one in found] == [0.012, 0.014]
    np.testing.assert_allclose([one["angle"] for one in found], 1.0, rtol=1e-15)
    ax = figures.gait_branches(data)
    squares = [line for line in ax.lines if line.get_marker() == "s"]
    assert [float(np.asarray(line.get_xdata())[0]) for line in squares] == [0.012, 0.014]
    assert any("2 Neimark-Sacker points" in text.get_text() for text in ax.texts)


@pytest.mark.slow
def test_the_walker_in_space_loses_its_gait_to_a_closed_curve():
    """Disturbances decay on one side of the point and grow on the other, as the multipliers say."""
    branch = wj.continue_gait(wj.SpatialWalker(), "hip_width", (0.3, 0.37))
    (point,) = branch.neimark_sackers
    assert abs(point.value - 0.319655251888) < 1e-11 and point.residual < 1e-12
    np.testing.assert_allclose(np.abs(point.multipliers[:2]), 1, rtol=0, atol=1e-12)
    assert branch.folds == branch.doublings == []
    for width, grows in ((point.value - 1e-4, True), (point.value + 1e-4, False)):
        walker = wj.SpatialWalker(hip_width=width)
        gait = wj.find_gait(walker, point.states)
        assert gait.found and gait.stable != grows
        start = gait.states[0] + 1e-4 * np.eye(7)[0]
        ((states,), _) = orbits(walker, np.asarray(start)[None], 3000, Integrator(1e-12))
        distance = np.linalg.norm(states - gait.states[0], axis=1)
        early, late = distance[100:140].max(), distance[2900:2940].max()
        rate = (late / early) ** (1 / 2800)
        assert (rate > 1) == grows
        assert abs(rate - np.abs(gait.multipliers[0])) < 3e-6
