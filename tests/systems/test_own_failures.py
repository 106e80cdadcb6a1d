"""Failures that a system names itself are outcomes like any other, wherever outcomes are told."""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from matplotlib.text import Text

import walker_jax as wj
from walker_jax import figures
from walker_jax.basins.basin_summary import summarise_basin, tally
from walker_jax.explorer.family import describe_family
from walker_jax.explorer.offers import Offer
from walker_jax.systems.outcomes import OUTCOMES, OWN, failures_of

GRID = wj.Grid.plain(speed=(0, 3, 60), place=(-1, 1, 4))


class Juggler(wj.HybridSystem):
    """A ball thrown up under a ceiling, which must come down fast enough to be thrown again.

    It comes down as fast as it was thrown, and is thrown at 0.8 of that and 0.2 more.
    """

    ceiling: float = 2.0
    slowest: float = 0.5

    section = "speed", "place"
    failures = "hits_the_ceiling", "sticks"

    def lift(self, x):
        return {"y": 0 * x[0], "speed": x[0], "place": x[1]}

    def project(self, state):
        return jnp.stack([state["speed"], state["place"]])

    def feasible(self, x):
        return x[0] > 0

    def modes(self):
        field = lambda y: {"y": y["speed"], "speed": -1 + 0 * y["y"], "place": 0 * y["y"]}
        again = lambda y: y | {"speed": 0.2 - 0.8 * y["speed"], "place": y["place"] / 2}
        fast = wj.Condition(lambda y: -y["speed"] - self.slowest, "sticks")
        falls = (lambda y: -y["speed"],)
        guards = (
            wj.Guard(lambda y: y["y"] - self.ceiling, "hits_the_ceiling"),
            wj.Guard(lambda y: -y["y"], wj.SECTION, falls, reset=again, must_hold=(fast,)),
        )
        energy = lambda y: y["y"] + y["speed"] ** 2 / 2
        return {"flight": wj.Mode(field, guards, energy=energy)}


BASIN = wj.basin(Juggler(), GRID, "direct", strides=300)


def test_strides_end_in_them():
    made = wj.strides(Juggler(), np.array([[1.0, 0.4], [0.4, 0.0], [2.1, 0.0], [-1.0, 0.0]]))
    high, stuck = map(Juggler().failure, Juggler.failures)
    assert (high, stuck) == (OWN, OWN + 1)
    assert made.outcome.tolist() == [0, stuck, high, wj.Outcome.OUTSIDE]
    np.testing.assert_allclose(made.state[0], [1.0, 0.2], rtol=1e-12)
    assert np.isnan(made.state[1:]).all()


def test_margins_are_how_far_they_are():
    found = wj.margins(Juggler(), np.array([[1.0, 0.0], [0.6, 0.0], [0.4, 0.0], [1.9, 0.0]]))
    np.testing.assert_allclose(found.own, [0.5, 0.1, -0.1, 2 - 1.9**2 / 2], atol=1e-12)
    assert np.isnan(found.stopping).all()
    by = jax.grad(lambda system: wj.margins(system, jnp.array([0.6, 0.0])).own)(Juggler())
    assert by.slowest == pytest.approx(-1, abs=1e-12) and by.ceiling == 0
    # The ball is at the ceiling with no speed at 2: it would have risen by nothing.
    assert 0 >= wj.margins(Juggler(), jnp.array([2.0 + 1e-9, 0.0])).own > -1e-8


class Relay(wj.HybridSystem):
    """Two modes of waiting; the first must end early, and at a known place."""

    latest: float = 1.0
    farthest: float = 2.0

    section = "wait", "place"
    failures = "late", "lost"

    def lift(self, x):
        return {"time": 0 * x[0], "wait": x[0], "place": x[1]}

    def project(self, y):
        return jnp.stack([y["wait"], y["place"]])

    def modes(self):
        field = lambda y: {"time": 1 + 0 * y["time"], "wait": 0 * y["wait"], "place": 0 * y["wait"]}
        judged = (
            wj.Condition(lambda y: self.latest - y["time"], "late"),
            wj.Condition(lambda y: self.farthest - y["place"], "lost"),
            wj.Condition(lambda y: self.farthest - 0.5 - y["place"], "lost"),
            wj.Condition(lambda y: jnp.sqrt(4 + y["place"]), "lost"),
        )
        again = lambda y: y | {"time": 0 * y["time"]}
        ends = wj.Guard(lambda y: y["time"] - y["wait"], "rest", reset=again, must_hold=judged)
        rests = wj.Guard(lambda y: y["time"] - 1, wj.SECTION)
        return {"wait": wj.Mode(field, (ends,)), "rest": wj.Mode(field, (rests,))}


def test_a_mode_that_is_not_the_last_is_judged_at_its_end():
    starts = np.array([[0.5, 0.0], [1.5, 0.0], [0.5, 1.7], [0.5, 2.5], [1.5, 2.5], [-0.5, 1.7]])
    found = wj.margins(Relay(), starts)
    late, lost = map(Relay().failure, Relay.failures)
    assert found.stride.outcome.tolist() == [0, late, lost, lost, late, lost]
    np.testing.assert_array_equal(wj.strides(Relay(), starts).outcome, found.stride.outcome)
    np.testing.assert_allclose(found.own, [0.5, -0.5, -0.2, -1.0, -0.5, -0.2], atol=1e-12)
    # what is not a number decides nothing
    assert wj.stride(Relay(), jnp.array([0.5, -5.0])).outcome == wj.Outcome.UNDECIDED


@pytest.mark.slow
def test_an_explanation_tells_conditions_of_one_failure_apart():
    said = str(wj.explain(Relay(), jnp.array([0.5, 1.7])))
    assert "from (0.5, 1.7): lost\n" in said and "mode rest" not in said
    assert "condition lost at the end: 0.3 at least\n" in said
    assert "condition lost at the end (2): -0.2 at least, violated" in said
    at_once = wj.explain(Relay(), jnp.array([-0.5, 1.7]))
    assert at_once.name == "lost" and len(at_once.modes) == 1
    assert at_once.modes[0].led_to == "rest at once"


class Stumbling(wj.SimplestWalker):
    """It stops where it comes down too slowly, too."""

    slowest: float = 0.0

    def modes(self):
        modes = super().modes()
        *falls, strike = modes["swing"].guards
        fast = wj.Condition(lambda y: -y.thetadot - self.slowest, "STOPPED")
        strike = strike._replace(must_hold=(*strike.must_hold, fast))
        return modes | {"swing": modes["swing"]._replace(guards=(*falls, strike))}


def test_a_walker_has_the_least_of_its_margins():
    x = jnp.array([0.2, -0.2])
    plain = wj.margins(wj.SimplestWalker(0.009), x)
    values = [wj.margins(Stumbling(0.009, slowest), x) for slowest in (0.0, 0.19, 0.3)]
    speed = float(values[1].stopping) + 0.19
    assert values[0].stopping == min(plain.stopping, speed) and 0.19 < speed < 0.3
    assert values[2].stride.outcome == wj.Outcome.STOPPED
    assert values[2].stopping == pytest.approx(speed - 0.3, abs=1e-12)
    change = jax.grad(lambda walker: wj.margins(walker, x).stopping)(Stumbling(0.009, 0.3))
    assert change.slowest == pytest.approx(-1, abs=1e-12)


def test_ends_and_axes_have_their_names_elsewhere_too():
    with pytest.raises(ValueError, match="not both hits_the_ceiling: try a start on the other"):
        wj.edge_state(Juggler(), np.array([2.2, 0.0]), np.array([2.5, 0.0]))
    named = wj.Map(lambda x: x / 2, ("failure", "frame"))
    grid = wj.Grid.plain(failure=(0, 1, 3), frame=(0, 1, 3))
    for make in (wj.robustness, lambda system, grid: wj.zoom(system, grid, 10)):
        with pytest.raises(ValueError, match="grid must not have an axis called f"):
            make(named, grid)
    assert np.isnan(wj.boundary_dimension(named, grid, pairs=50).value)


def test_the_basin_names_them(tmp_path):
    speed = BASIN["speed"].values
    fate = BASIN["fate"].values[:, 0]
    expected = np.where(speed > 2, 12, np.where(speed < 0.5, 13, 0))
    np.testing.assert_array_equal(fate, expected)
    flags = dict(
        zip(
            BASIN["fate"].attrs["flag_meanings"].split(),
            BASIN["fate"].attrs["flag_values"],
            strict=True,
        )
    )
    assert flags["hits_the_ceiling"] == 12 and flags["sticks"] == 13 and "OWN_1" not in flags
    fates = summarise_basin(BASIN, tally(BASIN))["fates"]
    assert fates["hits_the_ceiling"] == 80 and fates["sticks"] == 40 and "OWN_3" not in fates
    words = {one.get_text() for one in figures.basin(BASIN).figure.findobj(Text)}
    assert {"hits the ceiling", "sticks"} <= words
    # NetCDF has no list of one name
    BASIN.assign_attrs(failures="sticks").to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "b.nc", engine="h5netcdf") as kept:
        assert failures_of(kept) == ("sticks",)
    mapped = wj.basin(Juggler(), GRID, "cell-map")
    assert set(np.unique(mapped["fate"].values)) <= {0, 12, 13}


@pytest.mark.slow
def test_the_area_changes_with_what_moves_their_boundaries():
    found = wj.measure(Juggler(), "area", ["ceiling", "slowest"], grid=GRID)
    assert found.value == pytest.approx(3.0, rel=1e-9)
    np.testing.assert_allclose(found.gradient, [1.0, -2.0], rtol=1e-4)


def test_an_explanation_names_them():
    stuck = str(wj.explain(Juggler(), jnp.array([0.4, 0.0])))
    assert stuck.startswith("Juggler from (0.4, 0): sticks\n")
    assert "condition sticks at the end: -0.1 at least, violated" in stuck
    assert "energy 0.08 at the start" in stuck
    high = wj.explain(Juggler(), jnp.array([2.1, 0.0]))
    assert high.name == "hits_the_ceiling" and high.modes[0].led_to == high.name
    assert high.outcome == Juggler().failure("hits_the_ceiling")


def test_the_command_line_names_them(run, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    source = Path(__file__).read_text().partition("BASIN =")[0].replace("import pytest\n", "")
    (tmp_path / "juggling.py").write_text(source)
    words = "basin --axis speed=0:3:30 --axis place=-1:1:2 --method direct --json".split()
    code, out, _ = run(*words, "--system", f"{tmp_path / 'juggling.py'}:Juggler", "--out", "b.zarr")
    assert code == 0
    fates = json.loads(out)["fates"]
    assert fates["hits_the_ceiling"] == 20 and fates["sticks"] == 10


class Leaning(wj.SimplestWalker):
    failures = ("leans_too_far",)

    def falls(self, state):
        return {"leans_too_far": state.theta - 0.5} | super().falls(state)


def test_walkers_have_them_too():
    made = wj.strides(Leaning(0.009), np.array([[0.2, -0.2], [0.55, -0.5]]))
    assert made.outcome.tolist() == [0, Leaning(0.009).failure("leans_too_far")]
    offered = {"leaning": Offer("leaning", Leaning, (0.009,), "")}
    fates = describe_family(offered)["walkers"]["leaning"]["fates"]
    assert fates[12]["words"] == "leans too far" and fates[12]["lost"] and 13 not in fates


class Unnamed(Juggler):
    failures = ()


class Elsewhere(Juggler):
    def modes(self):
        (mode,) = super().modes().values()
        high, down = mode.guards
        return {"flight": mode._replace(guards=(high._replace(leads_to=99), down))}


class Unknown(Juggler):
    def modes(self):
        (mode,) = super().modes().values()
        high, down = mode.guards
        return {"flight": mode._replace(guards=(high._replace(leads_to="OWN_3"), down))}


class Misspelt(Juggler):
    def modes(self):
        (mode,) = super().modes().values()
        high, down = mode.guards
        (fast,) = down.must_hold
        down = down._replace(must_hold=(fast._replace(leads_to="stick"),))
        return {"flight": mode._replace(guards=(high, down))}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: Juggler().failure("drops"),
            "failure of Juggler must be one of hits_the_ceiling, sticks, FORWARD, .*, not 'drops'",
        ),
        (Unnamed, "guards of mode 'flight' of Unnamed must .*, not to 'hits_the_ceiling'"),
        (Elsewhere, "guards of mode 'flight' of Elsewhere must lead to a mode, .*, not to 99"),
        (Misspelt, "must_hold of mode 'flight' of Misspelt must .* a failure, not to 'stick'"),
        (Unknown, "guards of mode 'flight' of Unknown must lead to .* a failure, not to 'OWN_3'"),
        (
            type("Twice", (Juggler,), {"failures": ("sticks", "sticks")}),
            "failures of Twice must be 20 different words at most",
        ),
        (
            type("Taken", (Juggler,), {"failures": ("FORWARD",)}),
            "failures of Taken must be a tuple of words that name no Outcome, not",
        ),
    ],
)
def test_what_is_none_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        wj.stride(make(), jnp.array([1.0, 0.0]))


def test_as_many_as_there_are_numbers_have_their_names():
    names = (*Juggler.failures, *(f"drops_{i}" for i in range(OUTCOMES - OWN - 2)))
    make = lambda names: type("Many", (Juggler,), {"failures": names})()
    many = make((*names[2:], *names[:2]))
    assert len(names) == 20 and many.failure("sticks") == OUTCOMES - 1 == 31
    made = wj.strides(many, np.array([[0.4, 0.0], [2.1, 0.0]]))
    assert made.outcome.tolist() == [31, 30]
    with pytest.raises(ValueError, match="failures of Many must be 20 different words at most"):
        make((*names, "one_more"))


class Astray(wj.System):
    section = ("x",)

    def advance(self, x):
        return x, jnp.asarray(99), 1.0


def test_an_outcome_that_is_none_is_undecided():
    assert wj.stride(Astray(), jnp.array([1.0])).outcome == wj.Outcome.UNDECIDED


class There(NamedTuple):
    place: Any
    time: Any


class ThereAndBack(wj.HybridSystem):
    """It goes at speed 1 to a turning point and back for a time of 1, and fails if it is beyond.

    A `jump` at the turning point leads further, or back.
    """

    turning: Any = 0.1
    jump: Any = 0.0

    section = ("place",)
    failures = ("beyond",)

    def lift(self, x):
        return There(x[0], 0 * x[0])

    def project(self, state):
        return state.place[None]

    def modes(self):
        there = lambda y: There(jnp.cos(y.time), 1 + 0 * y.time)
        back = lambda y: There(-1 - y.place**2, 1 + 0 * y.time)
        turns = lambda y: There(y.place + self.jump, 0 * y.time)
        arrives = wj.Guard(lambda y: y.place - self.turning, "back", reset=turns)
        beyond = wj.Guard(lambda y: y.place**3 - self.turning**3, "beyond", at_once=True)
        ends = wj.Guard(lambda y: y.time - 1, wj.SECTION)
        return {"there": wj.Mode(there, (arrives,)), "back": wj.Mode(back, (beyond, ends))}


def test_a_guard_on_the_switch_to_its_mode_does_not_end_it():
    """Its value is zero there but for rounding, of either sign, and falls."""
    xs = np.linspace(-0.6, 0.1, 100)[:, None]  # the last begins at the switch
    found = wj.strides(ThereAndBack(), xs)
    assert (found.outcome == wj.Outcome.STRIDE).all()
    expected = np.tan(np.arctan(0.1) - 1)
    np.testing.assert_allclose(found.state[:, 0], expected, rtol=0, atol=1e-12)
    fails = ThereAndBack().failure("beyond")
    for jump, outcome in ((1e-9, fails), (-1e-9, wj.Outcome.STRIDE)):
        assert (wj.strides(ThereAndBack(jump=jump), xs[::9]).outcome == outcome).all()
    single = wj.strides(ThereAndBack(), xs[::9].astype(np.float32))
    assert (single.outcome == wj.Outcome.STRIDE).all()


@pytest.mark.slow
def test_nor_does_it_by_xla_or_in_an_explanation():
    xs = np.linspace(-0.6, 0.1, 20)[:, None]
    by_xla = jax.jit(jax.vmap(partial(wj.stride, ThereAndBack())))(xs)
    assert (by_xla.outcome == wj.Outcome.STRIDE).all()
    assert wj.explain(ThereAndBack(), xs[3]).name == "STRIDE"
    assert wj.explain(ThereAndBack(jump=1e-9), xs[3]).name == "beyond"


class TwoDoors(wj.HybridSystem):
    """A point that moves with speed 1 to either of two doors, one on each side, and not too long.

    It falls in time 2, and each door lets it pass only near the middle, z = 0.
    """

    section = "place", "speed", "z"
    failures = "lost", "bored"
    first: str = eqx.field(static=True, default="left")

    def lift(self, x):
        return {"place": x[0], "speed": x[1], "z": x[2], "time": 0 * x[0]}

    def project(self, y):
        return jnp.stack([y["place"], y["speed"], y["z"]])

    def modes(self):
        def field(y):
            zero = 0 * y["place"]
            return {"place": y["speed"], "speed": zero, "z": zero, "time": 1 + zero}

        near = (lambda y: 0.5 - y["z"],)
        doors = {
            "left": wj.Guard(lambda y: -1 - y["place"], wj.SECTION, near),
            "right": wj.Guard(lambda y: y["place"] - 1, wj.SECTION, near),
        }
        late = wj.Guard(lambda y: y["time"] - 2, "lost")
        bored = wj.Condition(lambda y: 1.5 - y["time"], "bored")
        other = "right" if self.first == "left" else "left"
        guards = doors[self.first], late, doors[other]
        return {"room": wj.Mode(field, guards, (bored,))}


def test_every_guard_to_the_section_is_measured_in_any_order():
    """In closed form: how far the door that it takes is open, and how near it came to either."""
    starts = np.array(
        [[0, 1, 0.2], [0, -1, 0.2], [0, 0.4, 0], [0, -0.4, 0], [0, 1, 0.6], [0, -1, 0.6]]
    )
    starts = np.concatenate([starts, [[0, 0.6, 0.1], [0, -0.6, 0.1]]])
    found, other = (wj.margins(TwoDoors(first), starts) for first in ("left", "right"))
    lost, bored = map(TwoDoors().failure, TwoDoors.failures)
    assert found.stride.outcome.tolist() == [0, 0, *[lost] * 4, bored, bored]
    np.testing.assert_allclose(found.forward[:2], 0.3, atol=1e-12)
    # 0.2 short of a door that is open; or 0.1 beside the gap of a door that it reached
    np.testing.assert_allclose(found.by_name["lost"][2:6], [-0.2, -0.2, -0.1, -0.1], atol=1e-12)
    np.testing.assert_allclose(found.by_name["lost"][:2], 1, atol=1e-12)
    np.testing.assert_allclose(found.by_name["bored"][[0, 1]], 0.5, atol=1e-12)
    # the margins of the failures that happened, and of all others: each has its own
    np.testing.assert_allclose(found.failed[2:6], found.by_name["lost"][2:6])
    np.testing.assert_allclose(found.failed[6:], found.by_name["bored"][6:])
    np.testing.assert_allclose(found.by_name["bored"][6:], 1.5 - 1 / 0.6, atol=1e-12)
    assert np.isnan(found.failed[:2]).all() and np.isnan(found.sideways).all()
    np.testing.assert_array_equal(found.own, np.fmin(found.by_name["lost"], found.by_name["bored"]))
    for one, same in zip(jax.tree.leaves(found), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(one, same, atol=1e-12)
    single = jax.grad(lambda x: wj.margins(TwoDoors(), x).by_name["lost"])
    np.testing.assert_allclose(single(jnp.array([0.0, -0.4, 0.0])), [-1, -2, 0], atol=1e-12)


class Twice(wj.HybridSystem):
    """Two guards at the start lead to one failure."""

    section = ("place",)
    failures = ("out",)

    def lift(self, x):
        return {"place": x[0]}

    def project(self, y):
        return jnp.stack([y["place"]])

    def modes(self):
        guards = (
            wj.Guard(lambda y: y["place"] - 1, "out", at_once=True),
            wj.Guard(lambda y: -1 - y["place"], "out", at_once=True),
            wj.Guard(lambda y: y["place"] - 0.5, wj.SECTION),
        )
        return {"on": wj.Mode(lambda y: {"place": 1 + 0 * y["place"]}, guards)}


def test_of_two_guards_to_one_failure_the_due_one_is_measured():
    found = wj.margins(Twice(), np.array([[1.2], [-1.3], [0.0]]))
    np.testing.assert_allclose(found.failed[:2], [-0.2, -0.3], atol=1e-12)
    assert found.stride.outcome[2] == wj.Outcome.STRIDE and found.by_name["out"][2] > 0
