"""The family of walkers, by their names on the command line."""

from walker_jax.walkers.kneed import KneedWalker
from walker_jax.walkers.model import State, Walker
from walker_jax.walkers.parameter_table import OPENING as OPENING
from walker_jax.walkers.point_foot import PointFootWalker
from walker_jax.walkers.powered import PoweredWalker
from walker_jax.walkers.powered_masses import (
    PoweredPointFootWalker,
    PoweredRoundFootWalker,
    PoweredUpperBodyWalker,
)
from walker_jax.walkers.round_foot import RoundFootWalker
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walkers.spring import SpringWalker
from walker_jax.walkers.upper_body import UpperBodyWalker

WALKERS: dict[str, type[Walker]] = {
    "simplest": SimplestWalker,
    "spring": SpringWalker,
    "point-foot": PointFootWalker,
    "round-foot": RoundFootWalker,
    "upper-body": UpperBodyWalker,
    "kneed": KneedWalker,
    "spatial": SpatialWalker,
    "powered": PoweredWalker,
    "powered-point-foot": PoweredPointFootWalker,
    "powered-round-foot": PoweredRoundFootWalker,
    "powered-upper-body": PoweredUpperBodyWalker,
}
"""The walkers of the package, by their names on the command line.

To add one, name it here and in `walker_jax/__init__.pyi`, and describe its parameters in
`parameter_table.py`: options, `--list-walkers` and the reference follow.
"""

WINDOWS = {
    "spatial": {
        "yaw": (0.0, 0.2),
        "theta": (0.06, 0.26),
        "phi": (0.19, 0.39),
        "yawdot": (-0.23, -0.03),
        "leandot": (-0.12, 0.08),
        "thetadot": (-0.57, -0.37),
        "phidot": (-0.49, -0.29),
    }
}
"""Windows of the explorer around gaits that take long to find."""

PLANAR_WALKERS = {name: kind for name, kind in WALKERS.items() if kind.state is State}
"""Walkers that move in the plane."""
