"""Colours are told apart by those too who see red and green alike."""

from itertools import chain, combinations

import pytest
from colour_vision import VISIONS, ciede2000, lab

from walker_jax import Outcome
from walker_jax.figures import chart_plots, style
from walker_jax.systems.outcomes import OUTCOMES, OWN

APART = 12
OF_SOME_WALKERS = {Outcome.BENT_KNEE, Outcome.BUCKLED, Outcome.SCUFFED, Outcome.SIDEWAYS}


@pytest.mark.parametrize(
    "one, other, difference",  # of the table in Sharma, Wu and Dalal (2005)
    [
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, -1, 2), (50, 0, 0), 2.3669),
        ((50, 2.4900, -0.0010), (50, -2.4900, 0.0011), 7.2195),
        ((50, 2.5, 0), (58, 24, 15), 19.4535),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ],
)
def test_differences_of_colours_are_as_published(one, other, difference):
    assert ciede2000(one, other) == pytest.approx(difference, abs=6e-5)


@pytest.mark.parametrize("vision", VISIONS)
def test_classes_that_can_touch_are_told_apart(vision):
    """A system's own failures, four of them, stand in for four that are of some walkers only."""
    fates = {outcome: colour for outcome, (colour, _) in style.SIGNS.items()}
    own = [fates.pop(Outcome(one)) for one in range(OWN, OUTCOMES)]
    assert own == [*style.OWN_COLOURS * 5] and len({*own}) == 4
    basins = [*style.BASINS, style.OTHERS, style.UNMATCHED, style.ARTEFACTS]
    of_package = [*basins, *fates.values()]
    of_all = [fates[one] for one in fates if one not in OF_SOME_WALKERS]
    of_others = [*basins, *of_all, *style.OWN_COLOURS]
    pairs = chain(combinations(of_package, 2), combinations(of_others, 2))
    near = [pair for pair in pairs if ciede2000(*(lab(one, vision) for one in pair)) < APART]
    assert near == []


@pytest.mark.parametrize("vision", VISIONS)
def test_cells_of_charts_are_told_apart(vision):
    tints = [chart_plots.tinted(n) for n in range(1, len(style.PERIODS) + 1)]
    cells = [*tints, chart_plots.NO_PERIOD, chart_plots.FALLS, chart_plots.NOT_KNOWN]
    pairs = combinations([lab(one, vision) for one in cells], 2)
    assert min(ciede2000(*pair) for pair in pairs) > APART


@pytest.mark.parametrize("vision", VISIONS)
def test_periods_are_told_apart(vision):
    colours = [colour for colour, _ in (*style.PERIODS, style.LONGER)]
    pairs = combinations(colours, 2)
    near = [pair for pair in pairs if ciede2000(*(lab(one, vision) for one in pair)) < APART]
    assert near == []
