"""Margins are zero where outcomes change, and have the right signs and derivatives."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import DATA

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.execution.tiles import map_cells
from walker_jax.walkers.abstract_point_foot import AbstractPointFootWalker
from walker_jax.walking.failure_margins import Margins, margins

WAYS = "backward", "forward", "running", "stopping"
DECIDES = {
    Outcome.BACKWARD: "backward",
    Outcome.FORWARD: "forward",
    Outcome.RUNNING: "running",
    Outcome.STOPPED: "stopping",
}
WALKERS = {
    "simplest": wj.SimplestWalker(0.0165),
    "spring": wj.SpringWalker(0.0165, 1.0),
    "point-foot": wj.PointFootWalker(0.0165, 0.05),
    "round-foot": wj.RoundFootWalker(0.02, com_offset=-0.02),
    "upper-body": wj.UpperBodyWalker(0.02),
}


def starts(walker, count=3000, seed=0):
    """Of all kinds: walkers that stride, and that fail in each way."""
    rng = np.random.default_rng(seed)
    x = [rng.uniform(0.02, 0.75, count), rng.uniform(-1.2, -0.02, count)]
    if len(walker.section) == 3:
        x.append(rng.uniform(-0.5, 0.3, count))
    return np.stack(x, axis=1)


PARAMS = [pytest.param(name, marks=[pytest.mark.slow] * (name != "simplest")) for name in WALKERS]


@pytest.fixture(scope="module", params=PARAMS)
def margins_found(request):
    walker = WALKERS[request.param]
    xs = starts(walker)
    return walker, xs, margins(walker, xs)


def assert_signs(found: Margins):
    """Which margins are negative, positive and unknown after each outcome."""
    outcome = found.stride.outcome
    none = np.isin(outcome, [Outcome.OUTSIDE, Outcome.UNDECIDED])
    struck = np.isin(outcome, [Outcome.STRIDE, Outcome.STOPPED])
    struck |= (outcome == Outcome.RUNNING) & ~np.isnan(found.forward)
    for code, way in DECIDES.items():
        values = getattr(found, way)
        assert np.all(values[outcome == code] <= 0)
        others = values[outcome != code]
        assert np.all((others > 0) | np.isnan(others))
    for way in WAYS:
        assert np.isnan(getattr(found, way)[none]).all()
    for way in ("forward", "running"):
        assert not np.isnan(getattr(found, way)[struck]).any()
    assert not np.isnan(found.stopping[outcome == Outcome.STRIDE]).any()
    assert np.isnan(found.running[outcome == Outcome.FORWARD]).all()
    assert not np.isnan(found.backward[outcome == Outcome.FORWARD]).any()
    at_start = (outcome == Outcome.RUNNING) & np.isnan(found.forward)
    assert np.isnan(found.backward[at_start]).all()


@pytest.mark.parametrize("name", ["slope_0.004", "slope_0.0165_plain"])
def test_signs_are_the_outcomes_of_the_reference(name):
    with np.load(DATA / f"strides_{name}.npz") as data:
        axes = "sum" if "sum" in data else "thetadot"
        theta, other = np.meshgrid(data["theta"], data[axes], indexing="ij")
        thetadot = other - theta if axes == "sum" else other
        outcomes = data["outcome"].ravel()
    xs = np.stack([theta.ravel(), thetadot.ravel()], axis=1)
    slope = float(name.split("_")[1])
    found = margins(wj.SimplestWalker(slope), xs)
    np.testing.assert_array_equal(found.stride.outcome, outcomes)
    assert_signs(found)
    stride = wj.strides(wj.SimplestWalker(slope), xs)
    np.testing.assert_allclose(found.stride.state, stride.state, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.stride.time, stride.time, rtol=0, atol=1e-9)


def test_signs_are_the_outcomes_of_every_walker(margins_found):
    walker, xs, found = margins_found
    np.testing.assert_array_equal(found.stride.outcome, wj.strides(walker, xs).outcome)
    assert len(set(found.stride.outcome.tolist())) >= 4
    assert_signs(found)


def push(shared, cell):
    """Margins, and their derivatives along a direction of start and slope."""
    walker, tolerance = shared
    x, direction, along_slope = cell
    still = jax.tree.map(jnp.zeros_like, walker)
    tangent = jax.tree.unflatten(
        jax.tree.structure(walker), [along_slope, *jax.tree.leaves(still)[1:]]
    )
    look = lambda walker, x: [*margins(walker, x, tolerance=tolerance).by_name.values()]
    return jax.jvp(look, (walker, x), (tangent, direction))


def assert_derivatives(walker, xs, seed=0, scale=1e-4):
    """Along random directions, against extrapolated differences, wherever these settle."""
    rng = np.random.default_rng(seed)
    directions, along_slope = rng.normal(size=xs.shape), rng.normal(size=len(xs))
    cells = xs, directions, along_slope
    tolerance = np.float64(1e-14)
    values, found = map(np.stack, map_cells(push, ((walker, tolerance), cells)))

    def at(h):
        first, *others = jax.tree.leaves(walker)
        leaves = [np.asarray(first) + h * along_slope]
        leaves += [np.full(len(xs), float(leaf)) for leaf in others]
        walkers = jax.tree.unflatten(jax.tree.structure(walker), leaves)
        found = margins(walkers, xs + h * directions, tolerance=tolerance)
        return np.stack([*found.by_name.values()])

    steps = scale * 0.5 ** np.arange(4)
    table = [(at(h) - at(-h)) / (2 * h) for h in steps]
    for factor in (4, 16, 64):
        before, table = (
            table,
            [(factor * b - a) / (factor - 1) for a, b in pairwise(table)],
        )
    size = 1 + np.abs(table[0])
    settled = np.abs(before[0] - before[1]) < 1e-7 * size
    error = np.abs(found - table[0]) / size
    assert np.all(error[settled] < 1e-7)
    return settled & np.isfinite(values), np.isfinite(values)


def test_derivatives_are_those_of_differences(margins_found):
    walker, xs, _ = margins_found
    settled, known = assert_derivatives(walker, xs[:1500])
    # of each margin that a walker without phases has, nearly everywhere
    settled, known = settled.sum(axis=1), known.sum(axis=1)
    assert np.all(settled > 0.9 * known) and np.all(known > 20) and len(known) == 4


def pairs_at(walker, code):
    """Starts on both sides of where an outcome changes, within 1e-7 of each other.

    On the other side there is a heel strike, of most of them.
    """
    rare = code in (Outcome.RUNNING, Outcome.STOPPED)  # of long and fast strides
    xs = starts(walker, 12_000 if rare else 4000, seed=3)
    if rare:
        rng = np.random.default_rng(4)
        xs[:, :2] = rng.uniform([0.65, -0.85], [0.785, -0.65], (len(xs), 2))
    outcome = wj.strides(walker, xs).outcome
    struck = np.isin(outcome, [Outcome.STRIDE, Outcome.STOPPED])
    fails, others = xs[outcome == code], xs[struck & (outcome != code)]
    count = min(400, len(fails), len(others))
    good, bad = others[:count], fails[:count]
    for _ in range(24):
        middle = (good + bad) / 2
        still = (wj.strides(walker, middle).outcome == code)[:, None]
        good, bad = np.where(still, good, middle), np.where(still, middle, bad)
    return good, bad


@pytest.mark.parametrize("way", WAYS)
def test_margins_are_zero_at_the_boundaries(margins_found, way):
    walker, *_ = margins_found
    code = {name: code for code, name in DECIDES.items()}[way]
    good, bad = pairs_at(walker, code)
    before, after = margins(walker, good), margins(walker, bad)
    passed, failed = getattr(before, way), getattr(after, way)
    own = passed > 0  # else another failure came before this one
    assert np.all(failed <= 0)
    if way == "running" and isinstance(walker, wj.PointFootWalker):
        assert len(own) == 0  # it is in tension at the start of a stride alone
        return
    assert own.sum() >= (30 if way in ("backward", "forward") else 3)
    # starts close to falling backward are magnified thousands of times
    least, most = (1e-6, 1e-4) if way == "backward" else (1e-6, 1e-5)
    assert np.median(passed[own]) < least
    assert np.median(-failed[own]) < most


@pytest.mark.slow
def test_a_stride_that_is_traced_has_the_same_margins():
    walker, xs = WALKERS["simplest"], starts(WALKERS["simplest"], 200)
    many = margins(walker, xs)
    mapped = jax.jit(jax.vmap(lambda x: margins(walker, x)))(xs)
    for one, other in zip(jax.tree.leaves(many), jax.tree.leaves(mapped), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    single = margins(walker, xs[7])
    for one, other in zip(jax.tree.leaves(many), jax.tree.leaves(single), strict=True):
        np.testing.assert_array_equal(one[7], other)


def test_margins_in_float32_are_close():
    walker = wj.SimplestWalker(0.0165)
    xs = starts(walker, 500)
    exact, found = margins(walker, xs), margins(walker, xs.astype(np.float32))
    same = exact.stride.outcome == found.stride.outcome
    assert same.mean() > 0.99 and found.forward.dtype == np.float32
    for way in WAYS:
        error = np.abs(getattr(exact, way) - getattr(found, way))[same]
        assert np.nanmedian(error) < 1e-5


def test_margins_of_the_simplest_walker_in_closed_form():
    """At the top, at the start, and at heel strike."""
    walker, xs = WALKERS["simplest"], starts(WALKERS["simplest"])
    found = margins(walker, xs)
    outcome, (theta, thetadot) = found.stride.outcome, xs.T
    energy = thetadot**2 / 2 + np.cos(theta - 0.0165) - 1  # above that at the top
    fell, stops, strode = (
        outcome == one for one in (Outcome.FORWARD, Outcome.BACKWARD, Outcome.STRIDE)
    )
    climbs = theta > 0.0165
    left = np.where(climbs, energy, thetadot**2 / 2)
    np.testing.assert_allclose(found.backward[fell], left[fell], rtol=0, atol=1e-11)
    after = found.stride.state[:, 1] ** 2 / 2
    least = np.minimum(left, after)[strode]
    np.testing.assert_allclose(found.backward[strode], least, rtol=0, atol=1e-11)
    assert (
        (climbs & strode).any()
        and (after < left)[strode].any()
        and (stops & climbs).all(where=stops)
    )
    # it stops where cos(theta - slope) = 1 + energy, and thetaddot = sin(theta - slope)
    sine = 1 - (1 + energy[stops]) ** 2
    np.testing.assert_allclose(found.backward[stops], -sine / 2, rtol=0, atol=1e-11)
    angle, speed = found.stride.state[strode].T  # -theta, and cos(2 theta) thetadot
    lift = np.cos(angle) * np.sin(2 * angle) * -speed
    np.testing.assert_allclose(found.stopping[strode], lift, rtol=0, atol=1e-12)
    arrival = speed / np.cos(2 * angle)
    pull = np.cos(angle) * (np.cos(angle + 0.0165) - arrival**2)
    start = np.cos(theta) * (np.cos(theta - 0.0165) - thetadot**2)
    np.testing.assert_allclose(
        found.running[strode], np.minimum(pull, start[strode]), rtol=0, atol=1e-12
    )


def forward_by_brute_force(walker, x, outcome, time):
    """The forward margin, from many states along a stride; NaN where the foot never had a chance.

    Also whether it is that of the place of the strike, or of a scuff.
    """
    theta, phi, *_ = map(np.asarray, wj.trajectory(walker, x, np.linspace(0, time, 6000)))
    upright = np.flatnonzero(theta > -np.pi / 2)  # until the stance leg is down
    theta, phi = theta[upright], phi[upright]
    h = phi - 2 * theta
    h[0] *= abs(h[0]) > 1e-12  # both feet on the slope
    turns = np.flatnonzero((h[1:-1] < h[:-2]) & (h[1:-1] <= h[2:])) + 1
    rises = np.flatnonzero((h[:-1] < 0) & (h[1:] >= 0))
    scuffs = rises[theta[rises] >= 0]
    if outcome == Outcome.STRIDE:
        since = [i for i in turns if i > max(scuffs, default=0) and h[i] < 0]
        depth, ahead = max(-h[since], default=np.inf), -theta[-1]
        return min(depth, ahead), ahead < depth
    turned = [-h[i] for i in turns if phi[i] < 0 and h[i] >= 0]
    share = [h[i] / (h[i] - h[i + 1]) for i in scuffs]
    scuffed = [s * -theta[i + 1] + (1 - s) * -theta[i] for i, s in zip(scuffs, share, strict=True)]
    both = [*turned, *scuffed]
    return max(both, default=np.nan), bool(scuffed) and max(both) == max(scuffed)


def test_the_forward_margin_is_that_of_the_motion():
    """Of strides, how far the foot passes or how far ahead it comes down; of falls, what missed."""
    walker, rng = WALKERS["simplest"], np.random.default_rng(5)
    theta, thetadot = starts(walker, 6000, seed=5).T
    on_section = np.stack([theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot], axis=1)
    launched = rng.uniform([0.0, -0.8, -0.5, -0.8], [0.4, 0.8, 0.0, 0.8], (2000, 4))
    xs = np.concatenate([on_section, launched])
    found = margins(walker, xs)
    outcome = found.stride.outcome
    strode, fell = (np.flatnonzero(outcome == code) for code in (Outcome.STRIDE, Outcome.FORWARD))
    nearest = strode[np.argsort(found.stride.state[strode, 0])[:8]]  # where the foot comes down
    kinds = []
    for i in (*nearest, *strode[::120], *fell[::240]):
        time = found.stride.time[i] if outcome[i] == Outcome.STRIDE else 8.0
        expected, other = forward_by_brute_force(walker, xs[i], outcome[i], time)
        if not np.isnan(expected):
            assert found.forward[i] == pytest.approx(expected, abs=1e-5)
            kinds.append((int(outcome[i]), bool(other)))
    assert set(kinds) == {(0, False), (0, True), (1, False), (1, True)}


class HeavierWorld(AbstractPointFootWalker):
    """The simplest walker where gravity is another, and nothing is known of its feet or forces."""

    slope: jax.Array
    gravity: jax.Array
    least: jax.Array
    """If not NaN, its contact force is another one that is least, so much, at theta = slope."""

    gait_region = wj.SimplestWalker.gait_region
    impact = wj.SimplestWalker.impact

    def vector_field(self, state):
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        swing = jnp.sin(phi) * (thetadot**2 - self.gravity * jnp.cos(angle))
        thetaddot = self.gravity * jnp.sin(angle)
        return wj.State(thetadot, phidot, thetaddot, swing + thetaddot)

    def contact_force(self, state):
        tension = state.thetadot**2 - self.gravity * jnp.cos(state.theta - self.slope)
        pressed = (state.theta - self.slope) ** 2 + self.least
        force = jnp.where(jnp.isnan(self.least), -jnp.cos(state.theta) * tension, pressed)
        return jnp.sin(state.theta) * tension, force

    def past_contact(self, state):
        return state.theta > jnp.inf


def test_margins_of_a_stance_leg_of_which_nothing_is_known():
    """What is left where it is slowest, and what is missing where it stops, in closed form."""
    gravity, slope = 4.0, 0.0165
    xs = starts(WALKERS["simplest"], 2000)
    heavier = lambda least: HeavierWorld(*map(jnp.asarray, (slope, gravity, least)))
    found = margins(heavier(np.nan), xs * [1, 2])
    plain = margins(WALKERS["simplest"], xs)
    np.testing.assert_array_equal(found.stride.outcome, plain.stride.outcome)
    theta, thetadot = xs.T
    energy = gravity * (thetadot**2 / 2 + np.cos(theta - slope) - 1)  # above that at the top
    after = found.stride.state[:, 1] ** 2 / 2  # heel strike
    strode, stops = (found.stride.outcome == code for code in (Outcome.STRIDE, Outcome.BACKWARD))
    assert min(strode.sum(), stops.sum()) > 50
    climbs = strode & (theta > slope)
    least = np.minimum(energy, after)[climbs]
    assert (energy < after)[climbs].any() and (energy > after)[climbs].any()
    np.testing.assert_allclose(found.backward[climbs], least, rtol=1e-9, atol=1e-12)
    # it stops where cos(angle) = 1 + energy / gravity, thetaddot is gravity sin(angle), and a
    # walker topples at a rate of sqrt(gravity)
    sine = 1 - (1 + energy[stops] / gravity) ** 2
    np.testing.assert_allclose(found.backward[stops], -gravity * sine / 2, rtol=1e-7)
    assert np.isnan(found.stopping[stops]).all()
    for way, unit in (("forward", 1), ("running", gravity), ("stopping", np.sqrt(gravity))):
        ours, theirs = getattr(found, way)[strode], unit * getattr(plain, way)[strode]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    for least, outcome in ((0.1, Outcome.STRIDE), (-1e-4, Outcome.RUNNING)):
        pressed = margins(heavier(least), xs[climbs] * [1, 2])
        again = (pressed.stride.outcome == outcome) & (theta[climbs] > slope + 0.01)
        assert again.sum() > 50
        np.testing.assert_allclose(pressed.running[again], least, rtol=0, atol=1e-12)


def edges(walker, theta, low, tolerance=None):
    """Rates between which walkers, at these angles, stride and turn back: from some that stride."""
    high = np.full_like(theta, -1e-6)
    for _ in range(60):
        middle = (low + high) / 2
        ends = wj.strides(walker, np.stack([theta, middle], axis=1), tolerance=tolerance)
        strode = ends.outcome == Outcome.STRIDE
        low, high = np.where(strode, middle, low), np.where(strode, high, middle)
    return low, high


def test_a_stance_leg_that_stops_for_a_moment_has_turned_back():
    """Heavy feet swing it on again, within a step of the integration."""
    walker, x = wj.PointFootWalker(0.02, 0.3), np.array([0.21612040133779264, -0.2664148139061631])
    for tolerance in (None, 1e-9, 1e-6):
        assert wj.strides(walker, x[None], tolerance=tolerance).outcome == Outcome.BACKWARD
    theta = np.linspace(0.19, 0.24, 4)
    strides, falls = edges(walker, theta, -1.3 * theta)
    np.testing.assert_allclose(
        strides, edges(walker, theta, -1.3 * theta, 1e-9)[0], rtol=0, atol=1e-9
    )
    found = [
        margins(walker, np.stack([theta, rate], axis=1))
        for rate in (strides - 1e-9, falls + 1e-9)  # beyond rounding
    ]
    for one, outcome in zip(found, (Outcome.STRIDE, Outcome.BACKWARD), strict=True):
        assert (one.stride.outcome == outcome).all()
        np.testing.assert_allclose(one.backward, 0, atol=1e-7)


@pytest.mark.slow
def test_a_stance_leg_hardly_moves_where_it_nearly_stops():
    walker, theta = wj.PointFootWalker(0.02, 0.3), np.array([0.19, 0.24])
    rates, _ = edges(walker, theta, -1.3 * theta)
    for start in np.stack([theta, rates], axis=1):
        time = wj.strides(walker, start[None]).time[0]
        motion = wj.trajectory(walker, start, np.linspace(0, float(time), 2000))
        assert -1e-4 < np.max(motion.thetadot) < 1e-9


@pytest.mark.parametrize("slope", [-0.1, -0.05])
def test_uphill_margins_vanish_where_leg_stops_as_foot_strikes(slope):
    """Or as the foot comes too late."""
    walker = lambda slope: wj.PoweredWalker(slope, push_off=0.25, hip_stiffness=6.0)
    theta = np.array([0.2])
    strides, falls = edges(walker(slope), theta, -3 * theta)
    failed, went = (
        margins(walker(slope), np.array([theta[0], rate[0]])) for rate in (falls, strides)
    )
    assert failed.stride.outcome == Outcome.BACKWARD
    assert failed.backward == pytest.approx(0, abs=1e-12)
    assert min(went.backward, went.forward) == pytest.approx(0, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("slope", [-0.1, -0.05])
def test_uphill_that_boundary_moves_as_margins_say(slope):
    walker = lambda slope: wj.PoweredWalker(slope, push_off=0.25, hip_stiffness=6.0)
    theta, step = np.array([0.2]), 1e-4
    at = lambda slope, x: margins(walker(slope), x).backward
    x = np.array([theta[0], edges(walker(slope), theta, -3 * theta)[1][0]])
    by_slope, by_x = jax.grad(at, (0, 1))(slope, jnp.asarray(x))
    (before, _), (after, _) = (edges(walker(slope + h), theta, -3 * theta) for h in (-step, step))
    moves = (after[0] - before[0]) / (2 * step)
    assert -by_slope / by_x[1] == pytest.approx(moves, rel=1e-6)


@pytest.mark.slow
def test_margins_in_float32_end():
    x = np.array([0.2888847887516022, -0.28140076994895935], np.float32)
    found = margins(wj.PointFootWalker(0.01), x)
    assert found.stride.outcome == Outcome.STRIDE
    assert found.running == pytest.approx(0.862, abs=1e-3)


def test_wrong_starts_are_refused():
    with pytest.raises(ValueError, match="x must have shape"):
        margins(WALKERS["simplest"], np.ones(3))
