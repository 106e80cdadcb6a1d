"""Results that are computed piece by piece into a store, and resumed: one loop for all of them."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from walker_jax import storage
from walker_jax.execution.progress import track
from walker_jax.execution.workers import Compute, open_workers
from walker_jax.storage.pieces import Pieces

if TYPE_CHECKING:
    import xarray  # takes half a second to load


class Work(NamedTuple):
    """How the result of a request is computed piece by piece; other terms are `open_pieces`'s."""

    request: dict
    about: "xarray.Dataset"
    arrays: "Mapping[str, xarray.Variable]"
    block: tuple[int, ...]
    finish: Callable[[Pieces, Compute], "xarray.Dataset"]
    """Returns the data known only when all pieces are there. If it is interrupted, it is repeated
    with the same result."""
    item_of: Callable[[Pieces, int], Any] | None = None
    """Returns what tells a piece to a worker; None where `finish` finds the pieces one by one."""
    compute: Callable[[Any, Any], Mapping[str, Any]] | None = None
    """Computes the values of arrays over a piece from the notes and its item, on any worker."""
    notes: Callable[[], Any] = dict
    aside: Sequence[str] = ()


def complete_store(
    work: Work,
    out: Path,
    *,
    overwrite: bool,
    cluster: Any = None,
    progress: bool = False,
    label: str = "pieces",
) -> "xarray.Dataset":
    """Return the result stored at `out`: read if it is complete, else resumed or begun."""
    found = storage.find(out, work.request, overwrite=overwrite)
    if found is not None:
        return found
    terms = work.request, work.about, work.arrays, work.block, work.notes
    with (
        open_workers(cluster) as each,  # first, as there may be none
        storage.open_pieces(out, *terms, aside=work.aside, overwrite=overwrite) as place,
    ):
        if work.compute is not None and work.item_of is not None:
            piece_of = {work.item_of(place, piece): piece for piece in place.missing()}
            found = each(partial(work.compute, place.notes), [*piece_of])
            done = place.count - len(piece_of)
            for item, values in track(found, label, progress, place.count, done):
                place.write(piece_of[item], values, done=True)
        place.finish(work.finish(place, each))
    return storage.open_dataset(out)
