"""The chance to fall in a stride of a walk that has lasted long, by a stochastic cell map.

On rough ground walking is metastable (Byl and Tedrake 2009, Int. J. Robot. Res. 28:1040-1064): a
walker forgets its start in a few strides, and falls after many. Ulam's method makes this a Markov
chain. The states just after heel strike are divided into cells, and P_ij is the chance that a
stride from cell i ends in cell j; rows fall short of 1 by the chance to fall. The largest
eigenvalue of P is the chance not to fall (the second one, if falls are an absorbing state). Its
left eigenvector is the quasi-stationary distribution of the states of walks that still last.

The places of starts within a cell matter: uniform starts spread states, so that walks seem shorter
by as much as a half. So all cells have equally many walkers, placed where walkers arrived and
weighted by the chance of arrival: a weighted ensemble (Huber and Kim 1996, Biophys. J. 70:97-110).
Strides count in P by that weight. Starts within a cell are then distributed as in long walks, and
the chance to survive is right for cells of any size.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import csr_array

from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_whole,
    is_number,
    short,
)
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.rough_ground import (
    RandomDisturbance,
    draw,
    read_ground,
    read_key,
    start_of_walks,
    walk_disturbed,
)
from walker_jax.storage.schema import with_dims
from walker_jax.systems.outcomes import Outcome, join_names
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import describe_source
from walker_jax.walking.disturbed import Disturbance, follow_disturbed
from walker_jax.walking.scan import Walked

PILOT_WALKS, PILOT_STRIDES = 20_000, 8
"""Walks that show where states are, and their strides: enough to forget a disturbance."""
FEWEST_SURVIVORS = 200
"""Fewest survivors of these walks that show where states are."""
FORGOTTEN, ROUNDS = 20, 80
"""Strides in which the ensemble forgets its start, and its strides in all."""
MOST_CELLS, FEWEST_IN_CELL = 1_000_000, 12
"""Most cells, which take some GB of memory, and fewest walkers in each."""
BITS = 20
"""Bits of the number of a cell along each direction: three fit in an integer of 64."""
FALLEN, UNKNOWN = -1, -2
"""In place of a cell's number: the walker fell, or the integration gave no answer."""
SCATTER_OF_ROUNDING = 1e-11
"""Largest standard deviation of states due to rounding and the tolerance of a stride."""
SETTLED = 1e-13
"""Relative change of an eigenvector at which power iteration ends."""
MAX_ITERATIONS = 10_000

States = Float[np.ndarray, "n full"]
Numbers = Int[np.ndarray, " n"]
"""Numbers of the cells of n states."""
Cells = Int[np.ndarray, " cells"]
"""Numbers of cells, each once, ascending."""
Chances = Float[np.ndarray, " cells"]

NO_CELL = "no cell leads to another: walks end at once; give a more even ground"


def survival_of_cells(
    walker: Walker,
    ground: float | RandomDisturbance,
    walkers: int,
    key: Any = None,
    *,
    gait: Gait | None = None,
    side: float = 0.8,
    repetitions: int = 4,
    tolerance: float | None = None,
) -> xr.Dataset:
    """Estimate the chance to survive a stride by a cell map, as `steps_to_fall` says."""
    if len(walker.section) != 2:
        raise WrongUse(f"walker must have two section coordinates, not {walker.section}")
    check_whole("n", walkers)
    check_whole("repetitions", repetitions, 2)
    if not (is_number(side) and 0 < side < np.inf):
        raise WrongUse(f"side must be a number above 0, not {short(side)}")
    draw_one, key = read_ground(ground), read_key(key)
    start = start_of_walks(walker, gait, tolerance)
    rough = Rough(walker, draw_one, walkers, float(side), tolerance)
    made = [repeat(rough, start, jax.random.fold_in(key, i)) for i in range(repetitions)]
    logs = np.array([(np.log(one.mean), np.log(one.survival / (1 - one.survival))) for one in made])
    log_mean, log_odds = logs.mean(axis=0)
    error = logs[:, 0].std(ddof=1) / np.sqrt(repetitions) * widening(repetitions)
    chart, cells = made[-1].chart, made[-1].cells
    middle = np.full((len(cells), len(chart.centre)), 0.5)
    coordinates = [*walker.section, "gap"][: len(chart.centre)]
    found = {
        "survival": 1 / (1 + np.exp(-log_odds)),
        "mean_strides": np.exp(log_mean),
        "mean_strides_error": np.exp(log_mean) * error,
        "undecided": sum(one.undecided for one in made),
        "chance": made[-1].distribution,
        "centre": chart.points_in(cells, middle, rough.side),
        "edges": rough.side * chart.axes,
    }
    named = ground if is_number(ground) else getattr(ground, "__qualname__", repr(ground))
    about = {
        **describe_source(walker),
        "ground": named,
        "side": rough.side,
        "walkers": walkers,
        "repetitions": repetitions,
        "key": join_names(map(str, np.asarray(jax.random.key_data(key)))),
    }
    direction = {"direction": np.array(coordinates, object)}
    return xr.Dataset(with_dims("metastable walking", found), direction, about)


class Rough(NamedTuple):
    """A walker on rough ground, and how finely its states are divided."""

    walker: Walker
    ground: RandomDisturbance
    walkers: int
    side: float
    tolerance: float | None


class Repetition(NamedTuple):
    """The chance to survive a stride and the mean number of strides, from independent walks."""

    survival: float
    mean: float
    undecided: int
    chart: "Chart"
    cells: Cells
    distribution: Chances


def repeat(rough: Rough, start: Float[np.ndarray, " full"], key: Array) -> Repetition:
    """Run one repetition. Walks from the start give the strides before they forget that start."""
    pilot, own = jax.random.split(key)
    along = rough.ground, jax.random.split(pilot, PILOT_WALKS), PILOT_STRIDES, rough.tolerance
    walks = walk_disturbed(rough.walker, np.broadcast_to(start, (PILOT_WALKS, len(start))), *along)
    chart, lasting = chart_of(walks)
    chain, cells, unanswered = transition_matrix(rough, chart, lasting, own)
    survival, distribution, means = solve_chain(chain)
    if survival >= 1:
        raise ComputationFailed(
            f"no walker fell from any of {len(cells):,} cells: ground is too even for a result; "
            "give a rougher one"
        )
    decided = walks.outcome != Outcome.UNDECIDED
    place, known = places_of(chart.cell_of(lasting, rough.side), cells)
    later = len(lasting) * means[place[known]].mean()
    mean = (walks.strides[decided].sum() + later) / np.count_nonzero(decided)
    unanswered += int(np.count_nonzero(~decided))
    return Repetition(survival, mean, unanswered, chart, cells, distribution)


def widening(repetitions: int) -> float:
    """Return the factor on the scatter of few repetitions for a 95 % interval of 1.96 of it."""
    from scipy.special import ndtri, stdtrit

    return float(stdtrit(repetitions - 1, 0.975) / ndtri(0.975))


class Chart(NamedTuple):
    """Coordinates of states just after heel strike in which their scatter is round."""

    centre: Float[np.ndarray, " d"]
    axes: Float[np.ndarray, "d d"]
    """Rows: directions, each as long as the standard deviation of states along it."""

    def cell_of(self, states: States, side: float) -> Numbers:
        """Return the number of the cell of each state."""
        y = section_and_gap(states, len(self.centre))
        place = np.floor((y - self.centre) @ np.linalg.inv(self.axes) / side)
        half = 2 ** (BITS - 1)
        place = np.clip(place, -half, half - 1).astype(np.int64) + half
        number = place[:, 0]
        for column in place.T[1:]:
            number = (number << BITS) | column
        return number

    def points_in(
        self, cells: Numbers, within: Float[np.ndarray, "n d"], side: float
    ) -> Float[np.ndarray, "n d"]:
        """Return points of cells, at places `within` each from 0 to 1."""
        d = len(self.centre)
        shifts = BITS * np.arange(d - 1, -1, -1)
        place = ((cells[:, None] >> shifts) & (2**BITS - 1)) - 2 ** (BITS - 1)
        return self.centre + (place + within) * side @ self.axes


def section_and_gap(states: States, size: int) -> Float[np.ndarray, "n d"]:
    """Return theta, thetadot and, as a third, phi - 2 theta, zero with both feet at one height."""
    theta, phi, thetadot, _ = states.T
    return np.stack([theta, thetadot, phi - 2 * theta], axis=1)[:, :size]


def chart_of(walks: Walked) -> tuple[Chart, States]:
    """Make the chart of the states of walks that last; return these states too."""
    lasting = walks.state[walks.outcome == Outcome.STRIDE]
    if len(lasting) < FEWEST_SURVIVORS:
        raise ComputationFailed(
            f"of {len(walks.state)} walks {len(lasting)} lasted {PILOT_STRIDES} strides: too few "
            "to be metastable; give a more even ground"
        )
    y = section_and_gap(lasting, 3)
    rough = np.ptp(y[:, 2]) > max(1e-12, 100 * np.finfo(lasting.dtype).eps)
    y = y if rough else y[:, :2]
    centre = y.mean(axis=0)
    variances, directions = np.linalg.eigh(np.cov(y.T))
    if not variances[0] > SCATTER_OF_ROUNDING**2:
        raise ComputationFailed(
            "ground is too even for a result: states hardly scatter; give a rougher one"
        )
    axes = (directions * np.sqrt(variances)).T
    return Chart(centre, axes), lasting


def transition_matrix(
    rough: Rough, chart: Chart, states: States, key: Array
) -> tuple[csr_array, Cells, int]:
    """Estimate P, from walks that last, in their states; its cells are in ascending order.

    A stride counts by the weight of its walk. Transitions to cells without starts are dropped: they
    are about as rare as those that never happened. So are strides without an answer, as they may
    not end in a fall; their number comes last.
    """
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).astype(np.uint32))
    integrator = integrator_of(states.dtype, rough.tolerance).in_dtype(states.dtype)
    arrays = in_dtype(rough.walker, states.dtype)
    chances, made_strides, undecided = np.full(len(states), 1 / len(states)), [], 0
    for number in range(ROUNDS):
        here = chart.cell_of(states, rough.side)
        cells, chance, chosen = choose_walkers(rng, here, chances, rough.walkers)
        if len(cells) > MOST_CELLS:
            raise ComputationFailed(
                f"walks reach more than {MOST_CELLS:,} cells: side must be above {rough.side:g}"
            )
        padded = 1 << (len(chosen) - 1).bit_length()  # to compile few programs
        own = jax.random.split(jax.random.fold_in(key, number), padded)
        drawn = np.asarray(draw(rough.ground, own, 0, 1))[: len(chosen), 0]
        disturbances: Any = Disturbance(*np.ascontiguousarray(drawn.T))
        given = arrays, states[chosen], disturbances, integrator
        made = map_cells(follow_disturbed, given, (False, True, True, False))
        going = made.outcome == Outcome.STRIDE
        if not going.any():
            raise ComputationFailed(NO_CELL)
        each = len(chosen) // len(cells)
        weights = np.repeat(chance / each, each)
        states = made.state[going]
        chances = weights[going] / weights[going].sum()
        if number >= FORGOTTEN:
            unknown = made.outcome == Outcome.UNDECIDED
            undecided += int(unknown.sum())
            ends = np.where(unknown, UNKNOWN, FALLEN)
            ends[going] = chart.cell_of(states, rough.side)
            made_strides.append((np.repeat(cells, each), ends, weights))
    starts, ends, weights = (np.concatenate(parts) for parts in zip(*made_strides, strict=True))
    cells = known_cells(starts, ends)
    (here, used), (there, known) = places_of(starts, cells), places_of(ends, cells)
    told = used & (known | (ends == FALLEN))
    total = np.bincount(here[told], weights[told], len(cells))
    known &= used
    shares = weights[known] / total[here[known]]
    return csr_array((shares, (here[known], there[known])), (len(cells),) * 2), cells, undecided


def known_cells(starts: Numbers, ends: Numbers) -> Cells:
    """Return the cells with a stride that is known to end in one of them, or in a fall.

    Any other cell would have the chance 0 to survive, as if all its strides were falls.
    """
    cells = np.unique(starts)
    while True:
        told = places_of(starts, cells)[1] & (places_of(ends, cells)[1] | (ends == FALLEN))
        left = np.unique(starts[told])
        if len(left) == 0:
            raise ComputationFailed(NO_CELL)
        if len(left) == len(cells):
            return cells
        cells = left


def choose_walkers(
    rng: np.random.Generator, numbers: Numbers, chances: Float[np.ndarray, " n"], walkers: int
) -> tuple[Cells, Chances, Int[np.ndarray, " m"]]:
    """Resample walkers; return the cells, the chance of each, and equally many walkers of each.

    Resampling is systematic: at equal distances along the walkers' chances, joined.
    """
    order = np.argsort(numbers, kind="stable")
    cells, first = np.unique(numbers[order], return_index=True)
    joined = np.cumsum(chances[order])
    chance = np.add.reduceat(chances[order], first)
    samples = max(FEWEST_IN_CELL, walkers // len(cells))
    begin = joined[first] - chances[order][first]
    shares = (np.arange(samples) + rng.uniform(size=(len(cells), 1))) / samples
    chosen = np.searchsorted(joined, (begin[:, None] + shares * chance[:, None]).ravel())
    last = np.append(first[1:], len(order)) - 1
    low, high = (np.repeat(end, samples) for end in (first, last))
    return cells, chance, order[np.clip(chosen, low, high)]


def places_of(numbers: Numbers, cells: Cells) -> tuple[Numbers, Bool[np.ndarray, " n"]]:
    """Return the places of cells in an ascending list, and whether they are in it."""
    place = np.minimum(np.searchsorted(cells, numbers), len(cells) - 1)
    return place, cells[place] == numbers


def solve_chain(chain: csr_array) -> tuple[float, Chances, Chances]:
    """Compute the largest eigenvalue, its left eigenvector, and the mean life from each cell.

    The mean number m of strides until a fall is P (1 + m). Along the eigenvector it is large,
    survival / (1 - survival); the remainder converges as fast as walks forget.
    """
    count = len(chain.indptr) - 1
    backward = chain.T.tocsr()
    survival, distribution = largest_eigenvector(backward, count)
    _, right_eigenvector = largest_eigenvector(chain, count)
    right_eigenvector = right_eigenvector / (distribution @ right_eigenvector)
    if 1 - survival < SETTLED:  # nothing falls: 1 to rounding
        return 1.0, distribution, np.full(count, np.inf)
    life = survival / (1 - survival)
    source = chain @ np.ones(len(right_eigenvector)) - survival * right_eigenvector
    rest = np.zeros_like(right_eigenvector)
    for _ in range(MAX_ITERATIONS):
        former, rest = rest, source + chain @ rest
        rest = rest - (distribution @ rest) * right_eigenvector
        if np.abs(rest - former).max() <= SETTLED * life:
            break
    return survival, distribution, life * right_eigenvector + rest


def largest_eigenvector(matrix: csr_array, count: int) -> tuple[float, Chances]:
    """Compute the largest eigenvalue and its eigenvector, of sum 1, by power iteration."""
    vector = np.full(count, 1 / count)
    value = 0.0
    for _ in range(MAX_ITERATIONS):
        following = matrix @ vector
        value = float(following.sum())
        if not value > 0:
            raise ComputationFailed(NO_CELL)
        following /= value
        settled = np.abs(following - vector).max() <= SETTLED * following.max()
        vector = following
        if settled:
            return value, vector
    raise ComputationFailed(
        f"the eigenvector is not found in {MAX_ITERATIONS} iterations: give another side"
    )
