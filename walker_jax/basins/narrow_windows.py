"""Windows so narrow that float64 hardly tells their starts apart.

Starts in such a window differ in their last digits, which a stride's rounding errors blur. But a
stride is linear in a narrow window: the starts are c + d with one centre c, and after a stride they
are S(c) + J d. So only the centre is followed, with the product P of the Jacobians, until the
window P d is wide enough. From there each start is followed itself. Two starts then differ by P d,
which has no rounding errors but those of the Jacobians.

The picture is exact up to a shift. The centre of the window is a number that float64 holds, and the
orbit of the centre has rounding errors, as if it had begun about 1e-16 from the requested point. If
the window meets the boundary of a failure in the next stride before it is `LINEAR` wide, starts are
followed from there all the same, and rounding errors show. In windows 2e-13 wide on such a
boundary, 1.2 % of the cells had another fate than in arithmetic of 60 digits.
"""

import numpy as np
from jaxtyping import Bool, Float

from walker_jax.basins.edge_states import failing_margin
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.gaits.cycles import linearise
from walker_jax.grids import Grid, steps_around
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.iteration import strides as take_strides

LINEAR = 1e-9
"""Width, in the largest coordinate, from which on starts are followed themselves. Rounding errors,
1e-15, are then a millionth of the width, and a stride is linear up to 1e-9 of its second
derivative."""
NARROWEST = 32
"""Fewest rounding units of the centre across a window: with fewer, float64 cannot place the
window."""
BLUR = 1e-14
"""Size of a margin that rounding errors of a stride may turn over."""
CURVED = 1e-4
"""Largest difference between a stride and a linear one, as a share of the window."""
ROUNDING = 1e-13
"""Error of the end of a stride that a test of linearity allows for."""


def follow_window(
    walker: System, grid: Grid, integrator: Integrator, limit: int
) -> tuple[Grid, int]:
    """Follow a narrow window until it is wide; return the resulting grid and the strides made.

    A window that is not narrow is returned as it is, after no stride. At most `limit` - 1 strides
    are made. If walkers converge, so that the window never is wide enough, it is returned where it
    is widest.

    Raises `WrongUse` for a window too narrow to place its centre; `ComputationFailed` where the
    window is torn apart before it is wide enough.
    """
    half = np.asarray(grid.upper - grid.lower, float) / 2
    middle = np.asarray(grid.lower, float) + half
    shear = np.asarray(grid.shear, float)
    centre = np.asarray(grid.origin, float) + shear @ middle
    if widths(shear, half).max() >= LINEAR:
        check_cells(grid, centre, half)
        return grid, 0
    check_width(grid, centre, half)
    ends = zip(grid.names, half.tolist(), grid.shape, strict=True)
    axes = {name: (-width, width, count) for name, width, count in ends}
    samples = steps_around(len(half)) * half
    widest, width = (grid, 0), 0.0
    for made in range(limit):
        points = centre + samples @ shear.T
        ends = take_strides(
            walker, points, tolerance=integrator.tolerance, solver=integrator.solver
        )
        passed = np.asarray(ends.outcome) == Outcome.STRIDE
        wide = float(widths(shear, half).max())
        if wide < LINEAR * CURVED:
            refuse_torn(walker, points, passed, integrator, f"after {made} strides")
        here = Grid(axes, shear, centre, grid.fixed), made
        if wide >= LINEAR or not passed.any():
            return here
        if wide > width:
            widest, width = here, wide
        local = linearise(walker, centre[None, None], integrator)
        next_centre, next_shear = local.state[0, 0], local.jacobian[0, 0] @ shear
        moved = difference(ends.state, next_centre, turns_of(walker))
        bent = np.abs(moved - samples @ next_shear.T).max()
        if not passed.all() or not bent < ROUNDING + CURVED * widths(next_shear, half).max():
            return here
        centre, shear = next_centre, next_shear
    return widest


def refuse_torn(
    walker: System,
    points: Float[np.ndarray, "n s"],
    passed: Bool[np.ndarray, " n"],
    integrator: Integrator,
    when: str,
) -> None:
    """Raise `ComputationFailed` if the boundary of a failure in the next stride is too close."""
    name, margin = failing_margin(walker, points, integrator)
    if margin < BLUR or passed.any() != passed.all():
        raise ComputationFailed(
            f"the window is torn apart {when}, by the boundary of a failure in the next stride "
            f"({name}, margin {margin:.1g}), so close to which float64 tells no starts apart: "
            "take a wider window, or another centre"
        )


def widths(shear: Float[np.ndarray, "s d"], half: Float[np.ndarray, " d"]) -> np.ndarray:
    """Return the width of a window along each coordinate of the state."""
    return 2 * np.abs(shear) @ half


def check_cells(grid: Grid, centre: Float[np.ndarray, " s"], half: Float[np.ndarray, " d"]) -> None:
    """Raise `WrongUse` for a window wide along one axis, with cells too narrow along another."""
    shear = np.asarray(grid.shear, float)
    reach = np.abs(centre) + widths(shear, half) / 2
    cells = 2 * np.abs(shear) * half / np.array(grid.shape)
    for name, one in zip(grid.names, cells.T, strict=True):
        if (one < 2 * np.spacing(reach)).all():
            raise WrongUse(
                f"grid must have cells along {name} wider than states of float64 are apart, "
                f"{np.spacing(reach.max()):.1g}, not {one.max():.1g}, in a window so wide along "
                "another axis"
            )


def check_width(grid: Grid, centre: Float[np.ndarray, " s"], half: Float[np.ndarray, " d"]) -> None:
    """Raise `WrongUse` for a window in which its own centre, or its axes, have no digits."""
    least = NARROWEST * np.spacing(np.abs(centre[: len(grid.names)]).max())
    narrow = widths(np.asarray(grid.shear, float), half)[: len(grid.names)].min()
    if narrow < least:
        raise WrongUse(
            f"grid must be at least {least:.1g} wide, not {narrow:.1g}: float64 holds its centre "
            f"to {least / NARROWEST:.1g} only"
        )
    for name, low, high, count in zip(grid.names, grid.lower, grid.upper, grid.shape, strict=True):
        if (high - low) / count < 2 * np.spacing(max(abs(low), abs(high))):
            raise WrongUse(
                f"grid must have cells along {name} wider than numbers near {float(low)} are "
                "apart: give offsets from an origin, grid.zoom(centre, factor)"
            )
