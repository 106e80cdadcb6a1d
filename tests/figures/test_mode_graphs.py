"""The picture of a system's modes and guards."""

import pytest
from matplotlib.patches import FancyArrowPatch

import walker_jax as wj
from walker_jax import figures
from walker_jax.figures.mode_graphs import edges_of, places_of


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


@pytest.mark.parametrize(
    ("system", "start"),
    [
        (wj.systems.StickSlip(), [1.2]),  # slips, sticks, slips again, to the section
        pytest.param(wj.systems.SpringMassBiped(energy=1.25), (0.9, 0.03), marks=pytest.mark.slow),
    ],
)
def test_the_way_of_a_stride_is_thick(system, start):
    ax = figures.modes(system, wj.explain(system, start))
    thick = [one for one in arrows(ax) if one.get_linewidth() > 1]
    assert len(thick) == 3 < len(arrows(ax))


def test_failures_are_named():
    ax = figures.modes(wj.systems.SpringMassBiped(energy=1.25))
    assert "backward\nforward\nrunning" in {text.get_text() for text in ax.texts}
