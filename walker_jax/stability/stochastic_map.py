"""The chance to fall in a stride of a walk that has lasted long, by a stochastic cell map.

On rough ground walking is metastable (Byl and Tedrake 2009, Int. J. Robot. Res. 28:1040-1064): a
walker forgets where it began in a few strides, and falls after many. Ulam's method makes that a
Markov chain: the states just after heel strike are divided into cells, and P_ij is the chance that
a stride from a random point of cell i ends in cell j; rows fall short of 1 by the chance to fall.
The largest eigenvalue of P is the chance not to fall, and its left eigenvector the quasi-stationary
distribution, that of the states of all walks that still last. (As a state of its own that is never
left, a fall has the eigenvalue 1, and this one is the second.)
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import csr_array

from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_kind,
    check_whole,
    refuses_tracers,
)
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.solvers import default_tolerance
from walker_jax.stability.rough_ground import (
    RandomDisturbance,
    draw,
    read_ground,
    read_key,
    start_of_walks,
    walk_disturbed,
)
from walker_jax.walkers.model import State, Walker, check_planar
from walker_jax.walking.disturbed import Disturbance, follow_disturbed
from walker_jax.walking.outcomes import Outcome

PILOT_WALKS, PILOT_STRIDES = 20_000, 8
"""Walks that show where states are, and the strides after which they are looked at: a few
multiples of the time in which a stable gait forgets a disturbance."""
MARGIN = 1.25
"""How far the cells reach, as a multiple of the distance of the farthest of these states, by which
walks that last are still inside. What leaves the cells counts as in the nearest one."""
FEWEST_SURVIVORS = 200
"""Of the pilot, below which there is too little to tell where states are."""
CELLS = {2: 256, 3: 80}
"""Cells along each direction: some 1 % of the scatter of states, and 8 %."""
SCATTER_OF_ROUNDING = 1e-11
"""Standard deviation of states that rounding and the tolerance of a stride make, at most."""
SETTLED = 1e-13
"""Change of an eigenvector, relative, at which power iteration ends."""
MAX_ITERATIONS = 10_000


class Metastability(NamedTuple):
    """How long walks last, by a stochastic cell map."""

    survival: float
    """The chance not to fall in a stride, of walks that have lasted long: the eigenvalue, its odds
    extrapolated as `mean` is."""
    mean: float
    """The mean number of strides until a fall, from the gait on, as `StepsToFall` has it."""
    error: float
    """Standard error of `mean`: of the samples, and of the size of cells."""
    axes: Float[np.ndarray, "d d"]
    """Rows: the directions of the grid of cells, in the coordinates (theta, thetadot, and, if the
    ground is rough, phi - 2 theta), each as long as the standard deviation of states along it."""
    centre: Float[np.ndarray, " d"]
    """The mean of these states."""
    edges: Float[np.ndarray, " cells+1"]
    """Edges of the cells along each direction."""
    density: Float[np.ndarray, "..."]
    """The quasi-stationary distribution, the chance of each cell: that of the last repetition."""


@refuses_tracers()
def metastability(
    walker: Walker,
    ground: float | RandomDisturbance,
    key: Any = None,
    *,
    gait: Gait | None = None,
    cells: int | None = None,
    samples: int = 12,
    repetitions: int = 4,
    tolerance: float | None = None,
) -> Metastability:
    """How long a walker walks on rough ground, by a stochastic cell map (Ulam's method).

    It costs the same however rare falls are, and is independent of `steps_to_fall`, which follows
    walks. Cells spread states; the result is extrapolated from two sizes of cells.

    **Arguments:**

    - `walker`: one whose section has two coordinates.
    - `ground`, `key`, `gait`, `tolerance`: as in `steps_to_fall`.
    - `cells`: number of cells along each direction, even; 256 by default, and 80 on rough ground,
      where there are three directions.
    - `samples`: strides from each cell.
    - `repetitions`: of the whole with other random numbers, whose scatter gives the error.

    Raises `ValueError` for arguments out of range, and `ComputationFailed` where walks end too
    early to be called metastable.
    """
    check_planar(walker)
    check_kind("walker", walker, Walker)
    if len(walker.section) != 2:
        raise WrongUse(f"walker must have two section coordinates, not {walker.section}")
    check_whole("samples", samples)
    check_whole("repetitions", repetitions, 2)
    draw_one, key = read_ground(ground), read_key(key)
    start = start_of_walks(walker, gait, tolerance)
    chart = draw_chart(walker, draw_one, key, start, tolerance)
    if cells is None:
        cells = CELLS[len(chart.centre)]
    check_whole("cells", cells, 4)
    means: list[list[float]] = []
    lasting: list[list[float]] = []
    distribution = np.ones(0)
    for number in range(repetitions):
        own = jax.random.fold_in(key, number)
        means.append([])
        lasting.append([])
        for size in (cells // 2, cells):
            shape = (size,) * len(chart.centre)
            chain = transition_matrix(walker, draw_one, own, chart, shape, samples, tolerance)
            cell = chart.cell_of(start[None], shape)
            survival, distribution, mean = solve_chain(chain, size ** len(shape), int(cell[0]))
            means[-1].append(mean)
            lasting[-1].append(survival / (1 - survival) if survival < 1 else np.inf)
    if not np.isfinite(means).all():
        raise ComputationFailed(
            f"no walker fell in {samples} strides from each cell: ground is too even for a result"
        )
    fine, extrapolated = extrapolate(means)
    log_mean = float(extrapolated.mean())
    odds = float(np.exp(extrapolate(lasting)[1].mean()))
    scatter = float(extrapolated.std(ddof=1)) / np.sqrt(repetitions)
    mean = float(np.exp(log_mean))
    error = mean * float(np.hypot(scatter, (log_mean - fine.mean()) / 2))
    shape = (cells,) * len(chart.centre)
    edges = np.linspace(-chart.reach, chart.reach, cells + 1)
    return Metastability(
        odds / (1 + odds), mean, error, chart.axes, chart.centre, edges, distribution.reshape(shape)
    )


def extrapolate(
    lives: list[list[float]],
) -> tuple[Float[np.ndarray, " repetitions"], Float[np.ndarray, " repetitions"]]:
    """Logarithms of lives with the small cells, and with infinitely small ones.

    What cells spread is of second order in their size.
    """
    coarse, fine = np.log(np.array(lives)).T
    return fine, fine + (fine - coarse) / 3


class Chart(NamedTuple):
    """Coordinates of states just after heel strike in which their scatter is round."""

    centre: Float[np.ndarray, " d"]
    axes: Float[np.ndarray, "d d"]
    reach: float
    """Largest coordinate of the cells."""

    def cell_of(
        self, states: Float[np.ndarray, "n 4"], shape: tuple[int, ...]
    ) -> Int[np.ndarray, " n"]:
        """Number of the cell of each state, the nearest cell for those outside."""
        y = section_and_gap(states, len(self.centre))
        z = (y - self.centre) @ np.linalg.inv(self.axes)
        place = np.floor((z / self.reach + 1) / 2 * np.array(shape)).astype(int)
        place = np.clip(place, 0, np.array(shape) - 1)
        return np.array(np.ravel_multi_index(tuple(place.T), shape))

    def points_in(
        self, numbers: Int[np.ndarray, " n"], within: Float[np.ndarray, "n d"], shape
    ) -> Float[np.ndarray, "n d"]:
        """Points of cells, `within` from 0 to 1 in each."""
        place = np.stack(np.unravel_index(numbers, shape), axis=1) + within
        return self.centre + (2 * place / np.array(shape) - 1) * self.reach @ self.axes


def section_and_gap(states: Float[np.ndarray, "n 4"], size: int) -> Float[np.ndarray, "n d"]:
    """theta, thetadot and, as a third, phi - 2 theta, zero where both feet are as high."""
    theta, phi, thetadot, _ = states.T
    return np.stack([theta, thetadot, phi - 2 * theta], axis=1)[:, :size]


def draw_chart(
    walker: Walker, ground: RandomDisturbance, key: Array, start: Any, tolerance: float | None
) -> Chart:
    """The chart of the states of walks that have lasted a few strides."""
    keys = jax.random.split(key, PILOT_WALKS)
    starts = np.broadcast_to(start, (PILOT_WALKS, len(start)))
    ends = walk_disturbed(walker, starts, ground, keys, PILOT_STRIDES, tolerance)
    lasting = ends.state[ends.outcome == Outcome.STRIDE]
    if len(lasting) < FEWEST_SURVIVORS:
        raise ComputationFailed(
            f"of {PILOT_WALKS} walks {len(lasting)} lasted {PILOT_STRIDES} strides: too few to be "
            "metastable"
        )
    y = section_and_gap(lasting, 3)
    rough = np.ptp(y[:, 2]) > 1e-12
    y = y if rough else y[:, :2]
    centre = y.mean(axis=0)
    variances, directions = np.linalg.eigh(np.cov(y.T))
    if not variances[0] > SCATTER_OF_ROUNDING**2:
        raise ComputationFailed("ground is too even for a result: states hardly scatter")
    axes = (directions * np.sqrt(variances)).T
    reach = MARGIN * float(np.abs((y - centre) @ np.linalg.inv(axes)).max())
    return Chart(centre, axes, reach)


def transition_matrix(
    walker: Walker,
    ground: RandomDisturbance,
    key: Array,
    chart: Chart,
    shape: tuple[int, ...],
    samples: int,
    tolerance: float | None,
) -> csr_array:
    """P, from one stride from each of `samples` random points of every cell."""
    count = int(np.prod(shape))
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).astype(np.uint32))
    numbers = np.repeat(np.arange(count), samples)
    points = chart.points_in(numbers, rng.uniform(size=(len(numbers), len(shape))), shape)
    states = lift_all(walker, points)
    checked_tolerance = np.asarray(default_tolerance(states.dtype, tolerance), states.dtype)
    drawn = draw(ground, jax.random.split(key, count), 0, samples).reshape(-1, 3)
    disturbances = Disturbance(*map(np.asarray, drawn.T))  # pyright: ignore[reportArgumentType] of NumPy, for many strides
    walker = jax.tree.map(lambda leaf: np.asarray(leaf, states.dtype), walker)
    made = map_cells(
        follow_disturbed,
        (walker, states, disturbances, checked_tolerance),
        (False, True, True, False),
    )
    going = made.outcome == Outcome.STRIDE
    ends = chart.cell_of(made.state[going], shape)
    weights = np.full(len(ends), 1 / samples)
    return csr_array((weights, (numbers[going], ends)), shape=(count, count))


def lift_all(walker: Walker, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n 4"]:
    """Full states of section coordinates, and of the difference phi - 2 theta."""

    def lift(walker, y):
        gap = y[2] if len(y) > 2 else jnp.zeros_like(y[0])
        zero = jnp.zeros_like(y[0])
        return jnp.stack(walker.push(State(y[0], 2 * y[0] + gap, zero, zero), y[1]))

    walker = jax.tree.map(lambda leaf: np.asarray(leaf, points.dtype), walker)
    return map_cells(lift, (walker, points))


def solve_chain(
    chain: csr_array, count: int, start: int
) -> tuple[float, Float[np.ndarray, " cells"], float]:
    """The largest eigenvalue, its left eigenvector, and the mean life from a cell.

    The mean number m of strides until a fall is P (1 + m). Along the eigenvector it is large,
    survival / (1 - survival); what is left of it converges as fast as walks forget.
    """
    backward = chain.T.tocsr()
    survival, distribution = largest_eigenvector(backward, count)
    _, promise = largest_eigenvector(chain, count)
    promise = promise / (distribution @ promise)
    if survival >= 1:
        return 1.0, distribution, np.inf
    life = survival / (1 - survival)
    source = chain @ np.ones(len(promise)) - survival * promise
    rest = np.zeros_like(promise)
    for _ in range(MAX_ITERATIONS):
        former, rest = rest, source + chain @ rest
        rest = rest - (distribution @ rest) * promise
        if np.abs(rest - former).max() <= SETTLED * life:
            break
    return survival, distribution, float(life * promise[start] + rest[start])


def largest_eigenvector(matrix: csr_array, count: int) -> tuple[float, Float[np.ndarray, " cells"]]:
    """The largest eigenvalue and its eigenvector, of sum 1, by power iteration."""
    vector = np.full(count, 1 / count)
    value = 0.0
    for _ in range(MAX_ITERATIONS):
        following = matrix @ vector
        value = float(following.sum())
        if not value > 0:
            raise ComputationFailed("no cell leads to another: walks end at once")
        following /= value
        settled = np.abs(following - vector).max() <= SETTLED * following.max()
        vector = following
        if settled:
            return value, vector
    raise ComputationFailed(f"the eigenvector is not found in {MAX_ITERATIONS} iterations")
