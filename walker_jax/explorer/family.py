"""The walkers for the page: parameters, units and ranges; and words and colours of fates."""

import math

from walker_jax.explorer.lattice import FARTHEST, HOME_CELLS, LEVELS, MAX_TILES, TILE
from walker_jax.explorer.pictures import FIRST_ATTRACTOR, UNMATCHED
from walker_jax.explorer.subjects import SECTIONS, Offer, Offers, slider_range
from walker_jax.figures.style import (
    ARTEFACTS,
    BASINS,
    FAILURES,
    OTHERS,
    failure_words,
)
from walker_jax.figures.style import (
    UNMATCHED as UNMATCHED_COLOUR,
)
from walker_jax.systems.outcomes import OWN, Outcome
from walker_jax.walkers.parameters import Parameter

NOT_LOST = (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID)
"""Outcomes of which none is a walker's failure on its way."""


def describe_family(offers: Offers) -> dict:
    """All that the page shows and does not compute, from where it is defined."""
    return {
        "walkers": {name: describe_offer(one) for name, one in offers.items()},
        "fates": {
            int(outcome): {
                "name": outcome.name,
                "words": words,
                "colour": FAILURES[outcome][0],
                "lost": outcome not in NOT_LOST,
            }
            for outcome, words in words_of_failures(offers).items()
        },
        "basins": list(BASINS),
        "others": OTHERS,
        "unmatched": UNMATCHED_COLOUR,
        "artefacts": ARTEFACTS,
        "labels": {"unmatched": UNMATCHED, "first": FIRST_ATTRACTOR, "stride": int(Outcome.STRIDE)},
        "lattice": {
            "tile": TILE,
            "home": HOME_CELLS,
            "levels": LEVELS,
            "farthest": FARTHEST,
            "most": MAX_TILES,
        },
        "sections": SECTIONS,
    }


def words_of_failures(offers: Offers) -> dict[Outcome, str]:
    """The failures that walkers on the page may have, with words for each."""
    named: dict[Outcome, set[str]] = {}
    for one in offers.values():
        for outcome in OWN[: len(one.kind.failures)]:
            named.setdefault(outcome, set()).add(failure_words(outcome, one.kind.failures))
    own = {outcome: " or ".join(sorted(words)) for outcome, words in named.items()}
    return {one: words for one, (_, _, words) in FAILURES.items() if one not in OWN} | own


def describe_offer(offered: Offer) -> dict:
    """A walker: what it is, its section and its parameters."""
    kind = offered.kind
    about, _, _ = (kind.__doc__ or "").strip().partition("\n")
    return {
        "about": "" if about.startswith(f"{kind.__name__}(") else about,  # its fields, by dataclass
        "section": kind.section,
        "parameters": list(map(describe_parameter, offered.parameters)),
    }


def describe_parameter(one: Parameter) -> dict:
    """A parameter with the ends of its slider and the step between its values."""
    low, high = slider_range(one)
    step = 10.0 ** math.floor(math.log10((high - low) / 150))
    return {
        "name": one.name,
        "meaning": one.meaning,
        "unit": one.unit,
        "default": one.default,
        "low": low if one.closed or low > one.low else low + step,
        "high": high,
        "step": step,
        "bounds": one.bounds(),
    }
