"""Proved basins: discs and cells, against plain strides."""

import re
import sys
from fractions import Fraction
from typing import Any

import jax
import numpy as np
import pytest
from interruptions import stop_writes

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Window
from walker_jax.proofs.basin_proofs import summarise_proof
from walker_jax.proofs.boxes import CHUNK, ORDER, TOLERANCE, Boxes, Trap, carry
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.following import Fates
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.stores import MOST_BATCHES, kept_batch
from walker_jax.proofs.traps import is_trap
from walker_jax.storage.schema import check_dataset

WALKER = wj.SimplestWalker(0.004)
RADIUS = 0.0022562
BRAKE = 0.0


class Braked(wj.SimplestWalker):
    """Of which the equations read a number that may change."""

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - BRAKE * state.phi)


@pytest.fixture(scope="module", autouse=True)
def short_series():
    """Series of a lower order, with fewer steps to the digit: programs are half as long.

    Chunks of another size, so that no program of other tests is taken for one of these.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in ("boxes", "landings"):
            patch.setattr(f"walker_jax.proofs.{module}.ORDER", 8)
            patch.setattr(f"walker_jax.proofs.{module}.TOLERANCE", 1e-7)
        patch.setattr("walker_jax.proofs.boxes.CHUNK", 1024)
        yield


@pytest.fixture(scope="module")
def disc():
    return wj.prove_basin(WALKER, 0.99 * RADIUS)


def test_the_whole_least_disturbance_is_proved(disc):
    assert disc.attrs["all_walk"] and np.all(disc["proved"] == WALKS)
    assert disc.attrs["radius"] == 0.99 * RADIUS
    low, high = disc.attrs["area_lower"], disc.attrs["area_upper"]
    area = np.pi * (0.99 * RADIUS) ** 2
    assert low < area < high < low * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "radius"), [(0.004, RADIUS), (0.009, 0.0022556)])
def test_the_disc_at_two_slopes_is_proved(slope, radius):
    """By the series that users have."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("boxes", "landings"):
            patch.setattr(f"walker_jax.proofs.{module}.ORDER", ORDER)
            patch.setattr(f"walker_jax.proofs.{module}.TOLERANCE", TOLERANCE)
        patch.setattr("walker_jax.proofs.boxes.CHUNK", CHUNK)
        assert wj.prove_basin(wj.SimplestWalker(slope), 0.99 * radius).attrs["all_walk"]


@pytest.mark.parametrize("factor", [1.0001, 1.01, 10])
def test_a_disc_with_a_start_that_falls_is_refused(factor):
    """The start that is named lies on the circle, and falls by plain strides, one by one."""
    with pytest.raises(WrongUse, match="must be at most the least disturbance: the start") as said:
        wj.prove_basin(WALKER, factor * RADIUS)
    told = re.search(r"\((.*)\) on the circle .* in stride (\d+)$", str(said.value))
    point, stride = told.groups() if told else ("", "")
    start = np.array([float(one) for one in point.split(", ")])
    apart = np.hypot(*(start - wj.find_gait(WALKER).states[0]))
    assert apart == pytest.approx(factor * RADIUS, abs=2e-9)
    outcomes = np.asarray(wj.walk(WALKER, start, int(stride)).outcomes)
    assert np.all(outcomes[:-1] == wj.Outcome.STRIDE) and outcomes[-1] != wj.Outcome.STRIDE


def test_a_disc_with_too_few_levels_is_bounded():
    found = wj.prove_basin(WALKER, 0.99 * RADIUS, levels=2)
    assert not found.attrs["all_walk"] and np.any(found["proved"] == OPEN)
    low, high = found.attrs["area_lower"], found.attrs["area_upper"]
    area = np.pi * (0.99 * RADIUS) ** 2
    assert 0.5 * area < low < area < high * (1 + 1e-9) and high < area * (1 + 1e-9)


def trap_of(data) -> Trap:
    return Trap(data["trap_centre"].values, data["trap_factor"].values, float(data["trap_size"]))


def test_the_trap_holds_its_walks(disc):
    rng, trap = np.random.default_rng(1), trap_of(disc)
    angle, part = rng.uniform(0, 2 * np.pi, 500), np.sqrt(rng.uniform(size=500))
    y = trap.size * part[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    x = trap.centre + y @ np.linalg.inv(trap.factor)
    for _ in range(20):
        stride = wj.strides(WALKER, x)
        assert np.all(np.asarray(stride.outcome) == wj.Outcome.STRIDE)
        x = np.asarray(stride.state)
        assert np.all(np.linalg.norm((x - trap.centre) @ trap.factor, axis=1) <= trap.size)


def test_an_ellipse_that_walks_leave_is_no_trap(disc):
    trap = trap_of(disc)
    wide = Trap(trap.centre, np.eye(2), trap.size)
    assert not is_trap(check_provable(WALKER), wide, 1)


@pytest.fixture(scope="module")
def cells():
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 8), sum=(-0.03, 0.01, 14))
    return grid, wj.prove_basin(WALKER, grid, levels=3)


def test_cells_have_the_fates_of_their_walks(cells):
    _, data = cells
    rng = np.random.default_rng(2)
    width = (data["upper"] - data["lower"]).values / data["count"].values
    width = width / 2.0 ** data["level"].values[:, None]
    for proved in (WALKS, FALLS):
        some = np.flatnonzero(data["proved"] == proved)
        some = rng.choice(some, 250)
        place = data["place"].values[some] + rng.uniform(size=(250, 2))
        x = (data["lower"].values + place * width[some]) @ data["shear"].values.T
        for _ in range(60):
            x = wj.strides(WALKER, x).state
        assert np.all(np.isfinite(x[:, 0]) == (proved == WALKS))


def test_the_area_lies_between_its_bounds(cells):
    """Against walks from random starts of the window."""
    grid, data = cells
    x = grid.points_at(np.random.default_rng(4).uniform(size=(20_000, 2)))
    for _ in range(60):
        x = wj.strides(WALKER, x).state
    area = np.mean(np.isfinite(x[:, 0])) * grid.size * grid.cell_area
    assert 0 < data.attrs["area_lower"] < area < data.attrs["area_upper"]


def test_the_data_set_is_of_its_kind_and_summed_up(cells):
    _, data = cells
    check_dataset(data, "proof")
    answer = summarise_proof(data)
    assert sum(answer["cells"].values()) == data.sizes["cell"]
    assert not answer["all_walk"] and answer["trap"]["size"] > 1e-3


def test_a_box_is_carried_around_its_starts():
    rng, n = np.random.default_rng(3), 3000
    centres = np.array([0.15339, -0.15608]) + rng.normal(size=(n, 2)) * 4e-4
    sides = rng.normal(size=(n, 2, 2)) * 3e-5
    boxes = Boxes(np.concatenate([centres[..., None], sides], -1), np.zeros(centres.shape))
    found = carry(check_provable(WALKER), boxes, Trap.nowhere())
    assert np.all(found.verdicts == 1)
    u = rng.choice([-1, 1, 0.3], (n, 2))
    x = np.asarray(wj.strides(WALKER, centres + np.einsum("nij,nj->ni", sides, u)).state)
    new = found.boxes.terms
    inside = np.linalg.solve(new[:, :, 1:], (x - new[:, :, 0])[..., None])[..., 0]
    assert np.all(np.abs(inside) <= 1 + 1e-9)


def test_nothing_is_trapped_about_an_unstable_gait():
    short = wj.find_gait(WALKER, [0.1487783869696, -0.1588066734576])
    with pytest.raises(ComputationFailed, match="no trap"):
        wj.prove_basin(WALKER, 0.001, gait=short)


def test_wrong_use_of_basins_is_refused():
    with pytest.raises(WrongUse, match="walker must be a SimplestWalker"):
        wj.prove_basin(wj.PointFootWalker(0.004), 0.001)
    with pytest.raises(WrongUse, match="region must be a Grid, or a radius"):
        wj.prove_basin(WALKER, -0.1)
    axes = {"theta": (0, 0.3, 4), "thetadot": (-0.2, -0.1, 4)}
    moved = wj.Grid(axes, np.eye(2), np.array([0.0, 0.01]))
    for grid in (wj.Grid.plain(theta=(0, 0.3, 4), thetadot=-0.1), moved):
        with pytest.raises(WrongUse, match="both coordinates of the section"):
            wj.prove_basin(WALKER, grid)


def test_an_interrupted_proof_goes_on_with_the_same_bits(tmp_path, monkeypatch, cells):
    for module in ("subdivision", "stores", "basin_proofs"):
        monkeypatch.setattr(f"walker_jax.proofs.{module}.BATCH", 1024)
    path, stops, request = tmp_path / "a.zarr", {0, 3}, {"command": "prove", "levels": 3}
    prove = lambda: wj.prove_basin(WALKER, cells[0], levels=3, out=path, request=request)
    stop_writes(monkeypatch, stops, arrays=1)
    while stops:
        with pytest.raises(KeyboardInterrupt):
            prove()
        assert storage.find(path, request) is None  # the command may go on
    found, plain = prove(), cells[1]
    assert storage.find(path, request) is not None
    assert found.load().drop_attrs().identical(plain.drop_attrs())
    assert {name: found.attrs[name] for name in plain.attrs} == plain.attrs
    assert {one.name for one in path.iterdir() if one.is_dir()} == {*map(str, found.variables)}


def test_more_cells_than_are_kept_are_refused(tmp_path, monkeypatch, cells):
    for module in ("subdivision", "stores", "basin_proofs"):
        monkeypatch.setattr(f"walker_jax.proofs.{module}.BATCH", 1024)
    monkeypatch.setattr("walker_jax.proofs.stores.MOST_BATCHES", 1)
    with pytest.raises(ComputationFailed, match="a level has more than 1024 cells"):
        wj.prove_basin(WALKER, cells[0], levels=3, out=tmp_path / "a.zarr")


def test_functions_with_derivatives_of_their_own_are_refused():
    class Stopped(wj.SimplestWalker):
        def vector_field(self, state):
            rates = super().vector_field(state)
            return rates._replace(phidot=jax.lax.stop_gradient(rates.phidot))

    class Named(wj.SimplestWalker):
        def vector_field(self, state):
            sincos = jax.custom_jvp(lambda x: (x, x))
            sincos.defjvp(lambda x, dx: (sincos(*x), (0.0 * dx[0], 0.0 * dx[0])))
            return super().vector_field(state._replace(phi=sincos(state.phi)[0]))

    class StoppedImpact(wj.SimplestWalker):
        def impact(self, state):
            foot, after = super().impact(state)
            return foot, after._replace(thetadot=jax.lax.stop_gradient(after.thetadot))

    class StoppedForce(wj.SimplestWalker):
        def contact_force(self, state):
            return jax.lax.stop_gradient(super().contact_force(state))

    kinds = dict.fromkeys((Stopped, StoppedImpact, StoppedForce), "stop_gradient")
    for kind, what in (kinds | {Named: "custom_jvp_call"}).items():
        with pytest.raises(WrongUse, match=f"without derivatives of their own, so without {what}"):
            check_provable(kind(0.004))


def test_walkers_with_a_start_of_their_own_are_refused():
    class Lifted(wj.SimplestWalker):
        def lift(self, x):
            return super().lift(x)._replace(phi=2 * x[0] - 0.004)

    class Fallen(wj.SimplestWalker):
        def falls(self, state):
            return super().falls(state) | {"SIDEWAYS": state.phi - 0.1}

    for kind in (Lifted, Fallen):
        with pytest.raises(WrongUse, match="that changes only equations"):
            check_provable(kind(0.004))


def test_equations_are_those_of_now(monkeypatch):
    at: Any = 0.1, 0.2, 0.0, 0.0
    walker, state = check_provable(Braked(0.004)), wj.State(*at)
    rates = lambda walker, state: walker.vector_field(state)
    first = evaluate(rates, walker, state).phidot.midpoint
    monkeypatch.setattr(sys.modules[__name__], "BRAKE", 1e-7)
    changed = evaluate(rates, walker, state).phidot.midpoint
    assert float(first - changed) == pytest.approx(2e-8, rel=1e-6)


@pytest.mark.slow
def test_a_proof_is_about_equations_as_they_are_now(monkeypatch):
    walker, plain = Braked(0.004), wj.prove_gait(WALKER).states
    np.testing.assert_allclose(wj.prove_gait(walker).states, plain, rtol=0, atol=1e-13)
    monkeypatch.setattr(sys.modules[__name__], "BRAKE", 1e-7)
    proved, found = wj.prove_gait(walker), wj.find_gait(walker)
    assert np.all(np.abs(proved.states - found.states) < proved.radii + 1e-12)
    assert np.abs(proved.states - plain).max() > 1e-10


def test_batches_after_a_missing_one_are_found_anew():
    """The cells of a level follow from the fates of the level before."""
    made = []

    class Place:
        count = 3 * MOST_BATCHES

        def write(self, piece, values, done):
            made.append(piece)

        def read(self, name, piece):
            return (np.zeros(1),)

    fates = Fates(np.zeros(5, np.int8), np.zeros(5, np.int32))
    missing: set[int] = {MOST_BATCHES}  # the first batch of level 1; those of level 2 are there
    place: Any = Place()
    for level in range(3):
        kept_batch(place, missing, level, 0, lambda: fates)
    assert made == [MOST_BATCHES, 2 * MOST_BATCHES]


def test_areas_are_right_for_axes_nearly_parallel():
    shear = np.array([[0.1, 0.3], [0.1 + 2.0**-30, 0.3]])
    window = Window(np.zeros(2), np.ones(2), (1, 1), shear)
    (a, b), (c, d) = ([Fraction(float(one)) for one in row] for row in shear)
    assert window.area(0) == float(abs(a * d - b * c))
