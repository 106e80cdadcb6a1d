"""Results on disk: labelled data sets as Zarr, written whole or not at all, or piece by piece.

The attribute `request` of a data set holds, as JSON, what was asked for. The same request finds its
result again; any other request is refused the place, unless it is told to overwrite.

A run reserves its place by a lock in a hidden folder beside it (`runs`), writes there, and renames
the whole into place (`datasets`), or writes piece by piece and completes it at the end (`pieces`).
Chunks and metadata have checksums (`damage`), which readers check (`reading`); what fails is named,
and may be overwritten if it is still known as a data set of this package.
`schema` has the kinds of data sets, and `tables` copies them for other programs.
"""

from walker_jax.storage.datasets import find as find
from walker_jax.storage.datasets import load as load
from walker_jax.storage.datasets import open_dataset as open_dataset
from walker_jax.storage.datasets import rewritable as rewritable
from walker_jax.storage.datasets import save as save
from walker_jax.storage.pieces import Pieces as Pieces
from walker_jax.storage.pieces import open_pieces as open_pieces
from walker_jax.storage.pieces import resumable as resumable
from walker_jax.storage.places import ANOTHER_PLACE as ANOTHER_PLACE
from walker_jax.storage.places import RESUME_HINT as RESUME_HINT
from walker_jax.storage.places import StoreConflict as StoreConflict
from walker_jax.storage.places import absolute as absolute
from walker_jax.storage.places import atomic_file as atomic_file
from walker_jax.storage.places import check_writable as check_writable
from walker_jax.storage.places import write_text as write_text
from walker_jax.storage.requests import check_picture as check_picture
from walker_jax.storage.requests import request_in as request_in
from walker_jax.storage.requests import signature as signature
from walker_jax.storage.tables import export as export
