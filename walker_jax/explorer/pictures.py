"""Pictures: the fates of the cells of tiles, in bytes for the page.

A cell has two bytes. The first byte is its label: the `Outcome` of a failure; `UNMATCHED` if it
walks on without coming near a known attractor; or `FIRST_ATTRACTOR` plus the number of its
attractor. The second byte is its number of strides, up to `MOST_STRIDES`.

The first attractors of a walker are found from a sample of its home window, and numbered in the
order of `wj.basin`. Attractors of walkers that remain in later pictures follow. Only one thread
calls `label_tiles`, which remembers the attractors.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import Attractor, in_order
from walker_jax.basins.attractor_search import label_and_find, with_attractors_from
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.methods import CellMapping, label_in_memory
from walker_jax.explorer.lattice import (
    HOME_CELLS,
    TILE,
    Rectangle,
    Tile,
    cells_of,
    home_of,
)
from walker_jax.explorer.subjects import Subject
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import has_gait_region

UNMATCHED, FIRST_ATTRACTOR = 32, 64
"""Labels above all values of `Outcome`."""
MOST_STRIDES = 255
STRIDES = 200
"""Most strides for which a walker is followed, as by `wj.basin`."""
INTEGRATOR = integrator_of(float)
SAMPLE = (30, 40)
"""Starts along each axis of the home window that give the first attractors, in about 20 ms."""
LATER_SAMPLE = 64
"""Most remaining walkers of a batch that give further attractors."""
MAX_ATTRACTORS = 32
"""Most attractors with labels of their own; the last label stands for all further ones."""
REMEMBERED = 256
"""Most subjects whose attractors are remembered."""


class Known(NamedTuple):
    """The known attractors of a subject, and the plane that is shown."""

    mapper: Mapper
    at: tuple[float, ...]
    """Fixed coordinates of the plane."""


known: OrderedDict[Subject, Known] = OrderedDict()


def find_attractors(subject: Subject) -> Known:
    """Find the attractors of a subject from the sample of its home window, and its plane."""
    at = plane_of(subject)
    home = home_of(subject.offer, subject.section)
    grid = home.grid(subject, Rectangle(0, (0, 0), HOME_CELLS), at)
    shares = (np.indices(SAMPLE).reshape(2, -1).T + 0.5) / SAMPLE
    mapper = Mapper(subject.walker, [], INTEGRATOR, STRIDES, further=0)  # a page does not wait
    mapper = with_attractors_from(mapper, grid.points_at(shares))
    return Known(mapper._replace(attractors=in_order(mapper.attractors)[0]), at)


def plane_of(subject: Subject) -> tuple[float, ...]:
    """Return the fixed coordinates of the plane; those not given are the gait's."""
    if None in subject.at:
        gait = dict(zip(subject.offer.section, gait_state(subject).tolist(), strict=True))
        given = zip(subject.plane.others, subject.at, strict=True)
        return tuple(gait[name] if value is None else value for name, value in given)
    return tuple(value for value in subject.at if value is not None)


def gait_state(subject: Subject) -> Float[np.ndarray, " section"]:
    """Find the first state of the gait; if there is none, take the gait at default parameters.

    The state depends on the subject only, so all pictures, copies and data show the same plane.
    """
    guess, walker = np.array(home_of(subject.offer, subject.section).gait), subject.walker
    found = search_gait(walker, guess)
    if not found.found and has_gait_region(walker):
        found = search_gait(walker)
    return np.asarray(found.states[0]) if found.found else guess


def label_tiles(subject: Subject, tiles: Sequence[Tile]) -> list[bytes]:
    """Compute the bytes of tiles by direct iteration, and remember the attractors.

    Each tile has the labels of its cells, then their strides. The last axis is the fastest.
    """
    before = known[subject] if subject in known else find_attractors(subject)
    found, known[subject] = label_cells(subject, before, tiles)
    known.move_to_end(subject)
    while len(known) > REMEMBERED:
        known.popitem(last=False)
    return found


def label_cells(
    subject: Subject, before: Known, tiles: Sequence[Tile]
) -> tuple[list[bytes], Known]:
    """Compute the bytes of tiles with known attractors; return the attractors known then too."""
    home, (mapper, at) = home_of(subject.offer, subject.section), before
    grids = [home.grid(subject, cells_of(tile), at) for tile in tiles]
    indices = np.arange(TILE * TILE)
    starts = np.concatenate([grid.centres(indices) for grid in grids])
    few = LATER_SAMPLE if len(mapper.attractors) < MAX_ATTRACTORS else 0
    labels, mapper, _ = label_and_find(mapper, starts, most=few)
    label, strides = in_bytes(labels.fate, labels.attractor, labels.strides)
    pairs = zip(np.split(label, len(tiles)), np.split(strides, len(tiles)), strict=True)
    return [one.tobytes() + its_strides.tobytes() for one, its_strides in pairs], Known(mapper, at)


def map_rectangle(subject: Subject, cells: Rectangle) -> tuple[bytes, list[dict]]:
    """Compute the bytes of a rectangle of cells by cell mapping; describe its attractors too."""
    home, at = home_of(subject.offer, subject.section), plane_of(subject)
    grid = home.grid(subject, cells, at)
    found = label_in_memory(CellMapping(subject.walker, grid, {}, INTEGRATOR))
    label, strides = in_bytes(found.fate, found.attractor, found.strides)
    artefacts = found.cell_cycles.artefact.tolist() if found.cell_cycles else None
    return label.tobytes() + strides.tobytes(), describe_attractors(found.attractors, artefacts)


def in_bytes(
    fate: Int[np.ndarray, " n"], attractor: Int[np.ndarray, " n"], strides: Int[np.ndarray, " n"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels and the strides of cells, one byte each."""
    last = MAX_ATTRACTORS - 1
    walks = np.where(attractor < 0, UNMATCHED, FIRST_ATTRACTOR + np.minimum(attractor, last))
    label = np.where(fate == Outcome.STRIDE, walks, fate)
    return label.astype(np.uint8), np.minimum(strides, MOST_STRIDES).astype(np.uint8)


def describe_attractors(
    attractors: Sequence[Attractor], artefacts: Sequence[bool] | None = None
) -> list[dict]:
    """Describe the attractors for the page; a motion without a period has one state."""
    made_up = artefacts or [False] * len(attractors)
    return [
        {"period": one.period, "states": one.states.tolist(), "artefact": artefact}
        for one, artefact in zip(attractors[:MAX_ATTRACTORS], made_up, strict=False)
    ]
