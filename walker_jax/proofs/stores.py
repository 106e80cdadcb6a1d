"""Proofs of basins that are stored batch by batch, and resumed after an interruption."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from walker_jax import storage
from walker_jax.checks import ComputationFailed
from walker_jax.execution.pieces import Work, complete_store
from walker_jax.execution.workers import Compute
from walker_jax.proofs.boxes import Trap
from walker_jax.proofs.following import Fates
from walker_jax.proofs.subdivision import BATCH, KeepFates

MOST_BATCHES = 2**12
"""Limit of the number of batches of a level."""
STORED_NAMES = {"fates": "batch_fates", "strides": "batch_strides"}
"""Names of the stored arrays of batches, which last until the proof is complete."""


def prove_in_batches(
    out: Path,
    request: dict,
    levels: int,
    find: Callable[[], Trap],
    prove: Callable[[Trap, KeepFates], xr.Dataset],
    *,
    overwrite: bool,
) -> xr.Dataset:
    """Return the data set of a proof stored on disk: read if complete, else resumed or begun.

    **Arguments:**

    - `find`: finds the trap. It is called once; a resumed proof reads its trap.
    - `prove`: takes the trap and a function that stores the fates of each batch, and returns the
      proof.
    """
    shape = levels + 1, MOST_BATCHES * BATCH
    dims = "from_level", "cell_of_level"
    empty = {"fates": np.int8(0), "strides": np.int32(0)}
    arrays = {
        STORED_NAMES[name]: xr.Variable(dims, np.broadcast_to(one, shape))
        for name, one in empty.items()
    }

    def finish(place: storage.Pieces, _: Compute) -> xr.Dataset:
        centre, factor, size = place.notes
        missing = set(place.missing())
        keep = lambda level, number, find: kept_batch(place, missing, level, number, find)
        return prove(Trap(np.array(centre), np.array(factor), size), keep)

    notes = lambda: [np.asarray(one).tolist() for one in find()]
    work = Work(request, xr.Dataset(), arrays, (1, BATCH), finish, notes=notes, aside=[*arrays])
    return complete_store(work, out, overwrite=overwrite)


def kept_batch(
    place: storage.Pieces, missing: set[int], level: int, number: int, find: Callable[[], Fates]
) -> Fates:
    """Return the fates of a batch: read if they are stored, else found and written.

    The fates of a level decide which cells the next one has. So once a batch had to be found,
    everything stored of later levels counts as missing.
    """
    if number >= MOST_BATCHES:
        raise ComputationFailed(
            f"a level has more than {MOST_BATCHES * BATCH} cells: levels must be smaller"
        )
    piece = level * MOST_BATCHES + number
    if piece in missing:
        found = find()
        room = BATCH - len(found.fates)
        values = {
            STORED_NAMES[name]: np.pad(one, (0, room)) for name, one in found._asdict().items()
        }
        place.write(piece, values, done=True)
        missing.update(range((level + 1) * MOST_BATCHES, place.count))
        return found
    return Fates(*(place.read(STORED_NAMES[name], piece)[0] for name in Fates._fields))
