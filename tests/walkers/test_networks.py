"""Walkers with networks: every computation, against a walker with a field for each weight."""

import pickle
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from networks import NAMES, Limited, NetworkWalker, by_scalars, network, pushed

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.design.sweeps import empty_row
from walker_jax.explorer.offers import offer
from walker_jax.figures.text import walker_title
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.kernels import primitive, transposes
from walker_jax.kernels.program import Program
from walker_jax.storage.places import StoreConflict
from walker_jax.systems.trees import select
from walker_jax.walkers.parameters import value_of, with_parameter

WALKER = NetworkWalker(0.009)
SCALARS = by_scalars(WALKER)
GRID = wj.Grid.sheared(theta=(0.12, 0.3, 8), sum=(-0.03, 0.01, 8))
STARTS = np.random.default_rng(0).uniform([0.1, -0.3], [0.3, -0.15], (200, 2))
WEIGHT = "policy.layers[0].weight[1, 0]"
"""One of the weights, that of `w10`."""


@cache
def gait() -> wj.Gait:
    return wj.find_gait(WALKER)


def test_strides_equal_those_by_scalars_to_the_bit():
    of_network, of_scalars = wj.strides(WALKER, STARTS), wj.strides(SCALARS, STARTS)
    assert len({*of_network.outcome}) > 2
    for one, other in zip(of_network, of_scalars, strict=True):
        np.testing.assert_array_equal(one, other)
    free = wj.strides(wj.SimplestWalker(0.009), STARTS)
    assert np.nanmax(abs(free.state - of_network.state)) > 1e-3


def test_a_population_of_machines_moves_as_its_members_do(monkeypatch):
    gains = jnp.array([2.0, 3.0, 1.5])
    check_population(jax.vmap(pushed)(gains), list(map(pushed, gains)), monkeypatch)


@pytest.mark.slow
def test_a_population_walks_as_its_members_do(monkeypatch):
    keys = jax.random.split(jax.random.key(5), 4)
    make = lambda key: NetworkWalker(
        0.009, policy=eqx.nn.MLP(2, 1, 4, 1, activation=jnp.tanh, key=key)
    )
    check_population(eqx.filter_vmap(make)(keys), list(map(make, keys)), monkeypatch)


def check_population(population, members, monkeypatch):
    """Strides and their derivatives are those of the members, side by side and one by one."""
    xs = jnp.asarray(STARTS[: len(members)])
    one_by_one = [wj.strides(one, x[None]) for one, x in zip(members, xs, strict=True)]
    mapped = jax.vmap(wj.stride, in_axes=(0, 0))(population, xs)
    for ends in (mapped, wj.strides(population, xs)):
        for i, name in enumerate(ends._fields):
            expected = np.concatenate([one[i] for one in one_by_one])
            np.testing.assert_array_equal(getattr(ends, name), expected)
    every = lambda systems: jax.vmap(jax.vmap(wj.stride, (None, 0)), (0, None))(systems, xs)
    several = every(population)
    np.testing.assert_array_equal(several.state[2], wj.strides(select(population, 2), xs).state)
    real, exact = eqx.partition(population, eqx.is_inexact_array_like)

    def total(real):
        found = every(eqx.combine(real, exact))
        return found.state.sum() + found.time.sum()

    expected = jax.grad(total)(real)
    monkeypatch.setattr(primitive, "MOST_COPIED", 0)  # one member after the other
    np.testing.assert_array_equal(every(population).state, several.state)
    for one, other in zip(*map(jax.tree.leaves, (jax.grad(total)(real), expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


@pytest.mark.slow
def test_gaits_change_with_a_weight_as_their_derivatives_say():
    here, step, middle = gait(), 1e-3, float(value_of(WALKER, WEIGHT))
    by = gait_derivatives(WALKER, here, WEIGHT)
    changed = (with_parameter(WALKER, WEIGHT, middle + side * step) for side in (-2, -1, 1, 2))
    gaits = [wj.find_gait(walker, here.states[0]) for walker in changed]
    rate = np.array([1.0, -8.0, 8.0, -1.0]) / (12 * step)
    for name in ("states", "multipliers"):
        values = np.stack([getattr(one, name) for one in gaits])
        expected = np.einsum("i,i...->...", rate, values)
        np.testing.assert_allclose(getattr(by, name), expected, rtol=1e-6, atol=1e-8)


@pytest.mark.slow
def test_gaits_equal_those_by_scalars():
    here, there = gait(), wj.find_gait(SCALARS)
    assert here.found
    np.testing.assert_array_equal(here.states, there.states)
    np.testing.assert_array_equal(here.multipliers, there.multipliers)
    by, of_scalar = (
        gait_derivatives(WALKER, here, WEIGHT),
        gait_derivatives(SCALARS, there, "w10"),
    )
    np.testing.assert_allclose(by.states, of_scalar.states, rtol=1e-10)
    np.testing.assert_allclose(by.multipliers, of_scalar.multipliers, rtol=1e-9)


@pytest.mark.slow
def test_all_leaves_have_derivatives():
    """Those of a walker by scalars, forward and in reverse, and by differences."""
    x = jnp.asarray(gait().states[0]) + 0.002
    time = lambda walker: wj.stride(walker, x).time
    back, forward = jax.grad(time)(WALKER), jax.jacfwd(time)(WALKER)
    own = jax.grad(time)(SCALARS)
    every = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(back.policy)])
    np.testing.assert_allclose(every, [getattr(own, name) for name in NAMES], rtol=1e-11)
    for one, other in zip(*map(jax.tree.leaves, (back, forward)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-16)
    for name in ("slope", WEIGHT, "policy.layers[1].weight[0, 2]", "policy.layers[0].bias[3]"):
        step, middle = 1e-4, float(value_of(WALKER, name))
        values = middle + step * np.array([-2.0, -1.0, 1.0, 2.0])
        times = wj.strides(with_parameter(WALKER, name, values), np.tile(x, (4, 1))).time
        by = float(times @ np.array([1.0, -8.0, 8.0, -1.0])) / (12 * step)
        np.testing.assert_allclose(value_of(back, name), by, rtol=1e-7, atol=1e-9)


def test_gradients_of_many_walks_are_summed_in_groups(monkeypatch):
    """Group by group, the last of other sizes, as all at once; so are those by the starts."""
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)
    xs = jnp.asarray(STARTS[:15].reshape(3, 5, 2))
    real, exact = eqx.partition(pushed(), eqx.is_inexact_array_like)
    of_both = lambda real, x: (
        (wj.stride(eqx.combine(real, exact), x).state @ jnp.array([0.7, -0.2])) ** 2
    )
    total = lambda real, xs: jnp.sum(jax.vmap(jax.vmap(of_both, (None, 0)), (None, 0))(real, xs))
    at_once = jax.grad(total, (0, 1))(real, xs)
    one_by_one = [jax.grad(of_both, (0, 1))(real, x) for x in xs.reshape(-1, 2)]
    by_machine = jax.tree.map(lambda *each: sum(each), *[one for one, _ in one_by_one])
    expected = by_machine, jnp.stack([x for _, x in one_by_one]).reshape(xs.shape)
    calls = []

    def in_fours(cells, numbers):
        calls.append((cells, numbers))
        return 4, 3

    monkeypatch.setattr(transposes, "groups_of", in_fours)
    grouped = jax.grad(total, (0, 1))(real, xs)
    assert calls == [(15, 6)]  # all numbers of the machine
    for found in (at_once, grouped):
        for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
    monkeypatch.undo()
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert transposes.groups_of(1000, 4545) == (4, 250)
    assert transposes.groups_of(1000, 100) == (1, 1000)
    assert transposes.groups_of(129, 2**30) == (1, 129)  # for two cores
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert transposes.groups_of(1000, 4545) == (1, 1000)


@pytest.fixture
def adjoints(monkeypatch) -> list:
    """The adjoints that reverse mode asks for, None where forward mode answers in its place."""
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)
    find, found = Program.adjoint, []

    def record(*about):
        found.append(find(*about))
        return found[-1]

    monkeypatch.setattr(Program, "adjoint", record)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("width", [4, 16])
def test_margins_have_derivatives_by_all_weights(adjoints, width):
    """In reverse as forward, where walkers stride, fall either way, or run."""
    walker = NetworkWalker(0.009, policy=network(0, width))

    def number(walker, x):
        found = wj.margins(walker, x)
        known = jnp.stack([found.failed, found.backward, found.forward, found.running])
        return jnp.where(jnp.isnan(known), 0, known) @ jnp.array([1.0, 0.6, -0.3, 0.2])

    xs = jnp.array(
        [[0.2, -0.2], [0.2, -0.15], [0.35, -0.3], [0.15, -0.28], [0.2, -0.25], [0.5, -1]]
    )
    outcomes = {wj.Outcome(int(one)).name for one in wj.strides(walker, xs).outcome}
    assert outcomes == {"STRIDE", "BACKWARD", "FORWARD", "RUNNING"}
    back, forward = (
        jax.vmap(along(number, (0, 1)), (None, 0))(walker, xs) for along in (jax.grad, jax.jacfwd)
    )
    rows = lambda tree: np.concatenate(
        [one.reshape(len(xs), -1) for one in jax.tree.leaves(tree)], 1
    )
    scale = np.abs(rows(forward)).max(axis=1, keepdims=True)
    np.testing.assert_allclose(rows(back) / scale, rows(forward) / scale, rtol=0, atol=1e-10)
    assert adjoints and None not in adjoints


def test_a_machine_of_tables_solves_its_equation():
    """Its place after a time of 1 is that of the polynomials of the force; so are derivatives."""
    machine, x = pushed(), jnp.array([0.2, -0.5])
    c0, c1, c2 = 0.7, 0.3, -0.2

    def place(gain, pull):
        return x[0] + x[1] + gain * (c0 / 2 + c1 / 6 + c2 / 12) + pull / 2

    end = wj.stride(machine, x)
    np.testing.assert_allclose(end.state, [place(2, 0.5), x[1] + 2 * (c0 + c1 / 2 + c2 / 3) + 0.5])
    real, exact = eqx.partition(machine, eqx.is_inexact_array_like)
    by = jax.jacfwd(lambda one: wj.stride(eqx.combine(one, exact), x).state[0])(real)
    np.testing.assert_allclose(by.force["gain"], c0 / 2 + c1 / 6 + c2 / 12, rtol=1e-14)
    np.testing.assert_allclose(by.force["powers"], [2 / 6, 2 / 12, 2 / 2], rtol=1e-14)
    np.testing.assert_allclose(by.pulls, [0.5, 0.5], rtol=1e-14)
    back = jax.grad(lambda one: wj.stride(eqx.combine(one, exact), x).state[0])(real)
    for one, other in zip(*map(jax.tree.leaves, (back, by)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)
    many = jax.vmap(pushed)(jnp.array([2.0, 3.0]))
    ends = wj.strides(many, np.tile(x, (2, 1))).state[:, 0]
    np.testing.assert_allclose(ends, [place(2, 0.5), place(3, 0.5)], rtol=1e-15)


def test_margins_of_a_machine_of_tables_have_its_derivatives(adjoints):
    """In reverse as forward, where it goes on and where it fails either way."""
    real, exact = eqx.partition(pushed(kind=Limited), eqx.is_inexact_array_like)

    def number(real, x):
        found = wj.margins(eqx.combine(real, exact), x)
        known = jnp.stack([found.failed, found.backward, found.forward, found.running])
        return jnp.where(jnp.isnan(known), 0, known) @ jnp.array([1.0, 0.6, -0.3, 0.2])

    xs = jnp.array([[0.5, -0.4], [1.0, 0.8], [0.2, -1.2]])
    outcomes = [wj.Outcome(int(one)).name for one in wj.strides(pushed(kind=Limited), xs).outcome]
    assert outcomes == ["STRIDE", "FORWARD", "BACKWARD"]
    back, forward = (
        jax.vmap(along(number, (0, 1)), (None, 0))(real, xs) for along in (jax.grad, jax.jacfwd)
    )
    rows = [
        np.concatenate([np.reshape(one, (3, -1)) for one in jax.tree.leaves(tree)], 1)
        for tree in (back, forward)
    ]
    np.testing.assert_allclose(*rows, rtol=1e-11, atol=1e-13)
    assert (np.abs(rows[0]).max(axis=1) > 0.01).all()
    assert adjoints and None not in adjoints


def test_a_machine_of_tables_walks_and_is_explained():
    """Its speed grows by 2 (c0 + c1/2 + c2/3) + 0.5 in each stride, and its place follows it."""
    x, gain, rise = np.array([0.2, -0.5]), 2 * (0.7 + 0.15 - 0.2 / 3) + 0.5, 2 * (0.35 + 0.05)
    rise += 2 * -0.2 / 12 + 0.25
    made = wj.walk(pushed(), x, 3)
    expected: list = [x]
    for _ in range(3):
        place, speed = expected[-1]
        expected.append([place + speed + rise, speed + gain])
    np.testing.assert_allclose(made.states, expected, rtol=1e-13)
    half = wj.trajectory(pushed(), x, [0.0, 0.5]).speed
    np.testing.assert_allclose(half, [-0.5, -0.5 + 0.95 + 2 * (0.0375 - 0.2 / 24)])
    said = str(wj.explain(pushed(), x))
    assert "leads to section" in said and "Pushed" in said


def test_feedback_keeps_a_network():
    """Its stride is that of the network's walker on the slope that it sets."""
    rest, x = np.array([0.2, -0.2]), np.array([[0.21, -0.2]])
    walker = wj.Feedback(WALKER, rest, {"slope": (0.1, 0.0)}, {"slope": (0.005, 0.02)})
    of_feedback = wj.strides(walker, x)
    of_slope = wj.strides(with_parameter(WALKER, "slope", jnp.array(0.01)), x)
    assert of_feedback.outcome.tolist() == [wj.Outcome.STRIDE]
    np.testing.assert_allclose(of_feedback.state, of_slope.state, rtol=1e-13)
    assert eqx.tree_equal(vars(walker)["policy"], WALKER.policy)


@pytest.mark.slow
def test_walks_trajectories_and_explanations():
    x = gait().states[0]
    made, same = wj.walk(WALKER, x, 5), wj.walk(SCALARS, x, 5)
    np.testing.assert_array_equal(made.states, same.states)
    np.testing.assert_allclose(made.states[-1], x, atol=1e-12)
    times = np.linspace(0, 1, 5) * float(made.times[0])
    on_the_way = wj.trajectory(WALKER, x, times)
    np.testing.assert_array_equal(on_the_way.phi, wj.trajectory(SCALARS, x, times).phi)
    said = str(wj.explain(WALKER, x))
    assert "leads to section" in said and "NetworkWalker" in said


@pytest.mark.slow
def test_basins_and_falls_equal_those_by_scalars():
    one, other = (wj.basin(walker, GRID, progress=False) for walker in (WALKER, SCALARS))
    assert len(np.unique(one["fate"])) > 1
    for name in ("fate", "attractor", "strides"):
        np.testing.assert_array_equal(one[name], other[name])
    falls = [
        wj.steps_to_fall(walker, 2e-3, n=40, limit=60, gait=gait()).strides
        for walker in (WALKER, SCALARS)
    ]
    np.testing.assert_array_equal(falls[0], falls[1])


@pytest.mark.slow
def test_robustness_is_that_of_the_boundary():
    """All starts nearer to the gait than the least disturbance walk on; some beyond it do not.

    The area is that of random starts, to five standard errors.
    """
    found = wj.robustness(WALKER, GRID, levels=0, check=500, progress=False)
    size, area = float(found["least_disturbance"]), float(found["total_area"])
    angles = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def walk_on(x):
        for _ in range(60):
            x = wj.strides(WALKER, x).state
        return np.isfinite(x[:, 0])

    near = lambda part: walk_on(gait().states[0] + part * size * around)
    assert near(0.98).all() and 0 < np.sum(~near(1.02)) < 360
    drawn = walk_on(GRID.points_at(np.random.default_rng(2).uniform(size=(4000, 2))))
    box, share = GRID.size * GRID.cell_area, drawn.mean()
    error = np.hypot(box * np.sqrt(share * (1 - share) / len(drawn)), found["total_area_error"])
    assert 0.05 < share < 0.95 and abs(area - box * share) < 5 * error


@pytest.mark.slow
def test_robustness_equals_that_by_scalars():
    settings = {"levels": 0, "check": 500, "progress": False}
    one, other = (wj.robustness(walker, GRID, **settings) for walker in (WALKER, SCALARS))
    for name in ("total_area", "least_disturbance", "step_down", "stability"):
        np.testing.assert_array_equal(one[name], other[name])
    assert float(one["least_disturbance"]) > 0


def test_stores_resume_for_the_same_network_alone(tmp_path: Path, monkeypatch):
    """The numbers are made up, by the weight."""
    made_up = lambda walker, plan: {
        name: np.full(np.shape(x), float(value_of(walker, WEIGHT)))
        for name, x in empty_row(plan).items()
    }
    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", made_up)
    place = tmp_path / "sweep.zarr"
    over = {WEIGHT: [0.1, 0.3]}
    settings = {"grid": GRID, "levels": 0, "check": 500, "out": place, "progress": False}
    made = wj.sweep(WALKER, over, **settings)
    np.testing.assert_array_equal(made["total_area"], over[WEIGHT])
    xr.testing.assert_identical(wj.sweep(WALKER, over, **settings), made)
    with pytest.raises(StoreConflict, match=r"policy\.layers"):
        wj.sweep(NetworkWalker(0.009, policy=network(1)), over, **settings)
    assert made.attrs["walker_policy.layers[1].bias"] == [
        float(value_of(WALKER, "policy.layers[1].bias[0]"))
    ]
    made.to_netcdf(tmp_path / "sweep.nc", engine="scipy")
    assert walker_title(made).split()[:4] == ["NetworkWalker,", "slope", "0.009", "rad,"]


def test_an_interrupted_sweep_over_a_weight_goes_on(tmp_path, monkeypatch):
    """Each row is computed once; a pickled copy of the walker resumes, another network does not."""
    computed, path = [], tmp_path / "sweep.zarr"

    def counted(walker, plan):
        computed.append(float(value_of(walker, WEIGHT)))
        if len(computed) == 2:
            raise KeyboardInterrupt
        return {name: np.full(np.shape(x), computed[-1]) for name, x in empty_row(plan).items()}

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", counted)
    over = {WEIGHT: [0.1, 0.3, 0.5]}
    settings = {"grid": GRID, "levels": 0, "check": 500, "out": path, "progress": False}
    with pytest.raises(KeyboardInterrupt):
        wj.sweep(WALKER, over, **settings)
    with pytest.raises(StoreConflict, match=r"policy\.layers"):
        wj.sweep(NetworkWalker(0.009, policy=network(1)), over, **settings)
    again = pickle.loads(pickle.dumps(WALKER))
    found = wj.sweep(again, over, **settings)
    np.testing.assert_array_equal(found["total_area"], over[WEIGHT])
    assert computed == [0.1, 0.3, 0.3, 0.5]


def test_the_page_takes_the_defaults_of_a_class():
    assert [one.name for one in offer(WALKER).parameters] == ["slope"]
    with pytest.raises(WrongUse, match="or the default of the class of NetworkWalker"):
        offer(NetworkWalker(0.009, policy=network(1)))
    table = wj.Map(lambda x, a: a * x, ("x", "y"), parameters={"a": np.ones(2)})
    with pytest.raises(WrongUse, match="a must be a number, or"):
        offer(table)


@pytest.mark.slow
def test_feedback_and_gradients_keep_networks():
    gains = {"slope": (0.01, 0.0)}
    walker = wj.Feedback(WALKER, gait(), gains, {"slope": (0.005, 0.02)})
    np.testing.assert_allclose(wj.stride(walker, gait().states[0]).state, gait().states[0])
    found = wj.measure(WALKER, "least-disturbance", (WEIGHT,), gait(), directions=24)
    same = wj.measure(SCALARS, "least-disturbance", ("w10",), gait(), directions=24)
    np.testing.assert_allclose(found.gradient, same.gradient, rtol=1e-6)


@pytest.mark.parametrize("policy", [network(7)])
def test_command_line_reads_networks(run, tmp_path, policy, monkeypatch):
    source = Path(__file__).parents[1] / "helpers" / "networks.py"
    (tmp_path / "own_networks.py").write_text(source.read_text())
    eqx.tree_serialise_leaves(tmp_path / "policy.eqx", policy)
    walk = ["walk", "--walker", "own_networks.py:NetworkWalker", "--slope", 0.009]
    walk += ["--theta", 0.2, "--thetadot", -0.2, "--strides", 1, "--json"]
    code, _, errors = run(*walk, "--policy", "other.eqx")
    assert code == 2 and "--policy other.eqx must be a file of such numbers" in errors
    code, told, errors = run(*walk, "--policy", "policy.eqx")
    assert code in (0, 1), errors
    end = wj.stride(NetworkWalker(0.009, policy=policy), [0.2, -0.2])
    assert f"{float(end.time):.6g}"[:6] in told
