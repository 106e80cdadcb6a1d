"""The picture of a system's modes and guards."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.patches import FancyArrowPatch

import walker_jax as wj
from walker_jax import figures
from walker_jax.figures.mode_graphs import edges_of, places_of
from walker_jax.walking.explanation import Explanation, ModeRecord


class Relay(wj.HybridSystem):
    """It waits and rests, each for a time, and does not rest if it begins too far."""

    section = ("wait",)

    def lift(self, x):
        return jnp.stack([0 * x[0], x[0]])

    def project(self, y):
        return y[1:]

    def modes(self):
        field = lambda y: jnp.stack([jnp.ones_like(y[0]), 0 * y[1]])
        after = lambda time, to: wj.Guard(lambda y: y[0] - time, to)
        far = wj.Guard(lambda y: y[1] - 2, wj.SECTION)
        return {
            "waits": wj.Mode(field, (after(0.5, "rests"), far)),
            "rests": wj.Mode(field, (after(1.0, wj.SECTION),)),
        }


def arrows(ax):
    return [one for one in ax.patches if isinstance(one, FancyArrowPatch)]


@pytest.mark.parametrize(
    "system",
    [
        wj.systems.SpringMassBiped(),
        wj.systems.StickSlip(),
        wj.KneedWalker(0.05),
        wj.systems.DuffingOscillator(),
    ],
)
def test_every_mode_and_every_way_is_drawn(system):
    graph = system.modes()
    ax = figures.modes(system)
    ax.figure.draw_without_rendering()
    assert {*graph, wj.SECTION} <= {text.get_text() for text in ax.texts}
    assert len(arrows(ax)) == len(edges_of(graph))


def test_modes_stand_in_the_order_of_a_stride():
    places = places_of(wj.systems.SpringMassBiped().modes())
    assert places["past mid-stance"] == (0, 0) and places["before mid-stance"] == (2, 0)
    assert {places["double support"], places["flight"]} == {(1, 0), (1, 1)}
    assert places[wj.SECTION] == (3, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "start", "passed"),
    [
        (Relay(), [0.5], 2),
        (wj.systems.StickSlip(), [1.2], 3),
        (wj.systems.SpringMassBiped(energy=1.25), (0.9, 0.03), 3),
    ],
)
def test_the_way_of_a_stride_that_is_explained_is_thick(system, start, passed):
    check_thick_arrows(system, wj.explain(system, start), passed)


def test_the_way_of_a_stride_is_thick():
    """By a made-up explanation, in a tenth of the time of one."""
    way = {"waits": "rests", "rests": "section"}
    modes = [
        ModeRecord(name, 0.5, 1, to, None, [], {}, {}, {}, (np.nan, np.nan))
        for name, to in way.items()
    ]
    start, state = np.array([0.5]), np.array([1.0])
    about = wj.Outcome.STRIDE, "STRIDE", "Relay", start, modes, [], state, np.eye(1), ()
    made_up = Explanation(*about)
    check_thick_arrows(Relay(), made_up, 2)


def check_thick_arrows(system, explained, passed):
    ax = figures.modes(system, explained)
    thick = [one for one in arrows(ax) if one.get_linewidth() > 1]
    assert len(thick) == passed < len(arrows(ax))


def test_failures_are_named():
    ax = figures.modes(wj.systems.SpringMassBiped(energy=1.25))
    assert "backward\nforward\nrunning" in {text.get_text() for text in ax.texts}
