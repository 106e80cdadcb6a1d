"""Results on disk: labelled data sets as Zarr, written whole or not at all, or piece by piece.

A data set carries, in its attribute `request`, what was asked for, as JSON. The same request finds
its result again; any other is refused the place unless it is told to overwrite.
"""

from walker_jax.storage.piecewise import Pieces as Pieces
from walker_jax.storage.piecewise import pieces as pieces
from walker_jax.storage.piecewise import resumable as resumable
from walker_jax.storage.places import ELSEWHERE as ELSEWHERE
from walker_jax.storage.places import RESUME as RESUME
from walker_jax.storage.places import Occupied as Occupied
from walker_jax.storage.places import draft_of as draft_of
from walker_jax.storage.places import writable as writable
from walker_jax.storage.places import write as write
from walker_jax.storage.requests import check_picture as check_picture
from walker_jax.storage.requests import signature as signature
from walker_jax.storage.whole import export as export
from walker_jax.storage.whole import find as find
from walker_jax.storage.whole import load as load
from walker_jax.storage.whole import opened as opened
from walker_jax.storage.whole import rewritable as rewritable
from walker_jax.storage.whole import save as save
