"""Pictures: the fates of the cells of tiles, in bytes for the page.

A cell has two bytes. The first is its label: the `Outcome` of a failure; `UNMATCHED` where it walks
on without coming near a known attractor; or `FIRST_ATTRACTOR` and the number of its attractor. The
second is its number of strides, up to `MOST_STRIDES`.

The attractors of a walker are those to which walkers converge from a sample of its home window, in
the order in which `wj.basin` numbers them, and then those of walkers that remain. One thread alone
calls `label_tiles`, which remembers them.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.methods import cell_mapping
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
"""Labels beyond those of all outcomes."""
MOST_STRIDES = 255
STRIDES = 200
"""Strides for which a walker is followed, as by `wj.basin`."""
INTEGRATOR = integrator_of(float)
SAMPLE = (30, 40)
"""Starts in the home window from which attractors are found first: these take some 20 ms."""
LATER_SAMPLE = 64
"""Remaining walkers of a batch from which more attractors are found."""
MAX_ATTRACTORS = 32
"""Attractors that are told apart; one that has no period takes all that remain."""
REMEMBERED = 256
"""Subjects whose attractors are remembered."""


class Known(NamedTuple):
    """All that is known of a subject."""

    mapper: Mapper
    at: tuple[float, ...]
    """The other coordinates of the plane that is shown."""


known: OrderedDict[Subject, Known] = OrderedDict()


def find_attractors(subject: Subject) -> Known:
    """The attractors of a subject, from the sample of its home window, and its plane."""
    at = plane_of(subject)
    home = home_of(subject.offer, subject.section)
    grid = home.grid(subject, Rectangle(0, (0, 0), HOME_CELLS), at)
    shares = (np.indices(SAMPLE).reshape(2, -1).T + 0.5) / SAMPLE
    mapper = Mapper(subject.walker, [], INTEGRATOR, STRIDES, further=0)  # a page does not wait
    mapper = mapper.with_attractors_from(grid.points_at(shares))
    return Known(mapper.with_sorted_attractors(), at)


def plane_of(subject: Subject) -> tuple[float, ...]:
    """The coordinates that are fixed in the plane; those of the gait where none are given."""
    if None in subject.at:
        gait = dict(zip(subject.offer.section, gait_state(subject).tolist(), strict=True))
        given = zip(subject.plane.others, subject.at, strict=True)
        return tuple(gait[name] if value is None else value for name, value in given)
    return tuple(value for value in subject.at if value is not None)


def gait_state(subject: Subject) -> Float[np.ndarray, " section"]:
    """The first state of the gait; where there is none, of that of the default parameters.

    It depends on the subject alone: so pictures, copies and data of all who ask are of one plane.
    """
    guess, walker = np.array(home_of(subject.offer, subject.section).gait), subject.walker
    found = search_gait(walker, guess)
    if not found.found and has_gait_region(walker):
        found = search_gait(walker)
    return np.asarray(found.states[0]) if found.found else guess


def label_tiles(subject: Subject, tiles: Sequence[Tile]) -> list[bytes]:
    """The labels of the cells of tiles, then their strides, by direct iteration.

    The last axis is the fastest. The attractors are remembered.
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
    """The same, from what is known of the subject; and what is known then."""
    home, (mapper, at) = home_of(subject.offer, subject.section), before
    grids = [home.grid(subject, cells_of(tile), at) for tile in tiles]
    indices = np.arange(TILE * TILE)
    labels = mapper.follow(np.concatenate([grid.centres(indices) for grid in grids]))
    few = LATER_SAMPLE if len(mapper.attractors) < MAX_ATTRACTORS else 0
    labels, mapper = mapper.complete_labels(labels, few)
    label, strides = in_bytes(labels.fate, labels.attractor, labels.strides)
    pairs = zip(np.split(label, len(tiles)), np.split(strides, len(tiles)), strict=True)
    return [one.tobytes() + its_strides.tobytes() for one, its_strides in pairs], Known(mapper, at)


def map_rectangle(subject: Subject, cells: Rectangle) -> tuple[bytes, list[Attractor]]:
    """The same bytes of a rectangle of cells, by cell mapping, and its attractors."""
    home, at = home_of(subject.offer, subject.section), plane_of(subject)
    found = cell_mapping(subject.walker, home.grid(subject, cells, at), INTEGRATOR)
    label, strides = in_bytes(found.fate, found.attractor, found.strides)
    return label.tobytes() + strides.tobytes(), found.attractors


def in_bytes(
    fate: Int[np.ndarray, " n"], attractor: Int[np.ndarray, " n"], strides: Int[np.ndarray, " n"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the label and strides of cells, a byte each."""
    last = MAX_ATTRACTORS - 1
    walks = np.where(attractor < 0, UNMATCHED, FIRST_ATTRACTOR + np.minimum(attractor, last))
    label = np.where(fate == Outcome.STRIDE, walks, fate)
    return label.astype(np.uint8), np.minimum(strides, MOST_STRIDES).astype(np.uint8)


def describe_attractors(attractors: Sequence[Attractor]) -> list[dict]:
    """The attractors for the page; a motion without a period has one state."""
    return [
        {"period": one.period, "states": one.states.tolist(), "artefact": one.artefact}
        for one in attractors[:MAX_ATTRACTORS]
    ]
