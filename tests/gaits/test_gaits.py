import inspect
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import read_values
from simplest_gaits import REGION, assert_repeats, walker

import walker_jax as wj
from walker_jax.gaits import cycles, search
from walker_jax.gaits.cycles import iterate_newton
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.walkers import parameters

VALUES = read_values("values")


def assert_walks(slope, gait):
    """The gait repeats itself when it is walked."""
    times = assert_repeats(slope, gait.states)
    np.testing.assert_allclose(times, gait.step_times, rtol=0, atol=1e-9)


def walk_on(slope, x, count):
    """Where a walker is after so many strides."""
    for _ in range(count):
        x = wj.strides(walker(slope), x[None]).state[0]
    return x


def richardson(function, x, h):
    """Derivative by central differences, extrapolated to sixth order."""
    d = [(function(x + s) - function(x - s)) / (2 * s) for s in (h, h / 2, h / 4)]
    first = [(4 * b - a) / 3 for a, b in pairwise(d)]
    return (16 * first[1] - first[0]) / 15


SLOW = pytest.mark.slow
STIFF = [
    pytest.param(0.001, 100.0, marks=SLOW),
    pytest.param(0.012, 3.0, marks=SLOW),
    pytest.param(0.1, 100.0, marks=SLOW),
    (0.2, 20.0),
]
"""Slopes and stiffnesses of springs that swing the leg fast."""


@pytest.mark.parametrize(("slope", "stiffness"), STIFF)
def test_the_region_to_search_holds_the_gaits_that_attract(slope, stiffness):
    """By direct iteration over nearly all feasible starts."""
    wide = wj.Grid.sheared(theta=(0, np.pi / 4, 20), sum=(-1.2, 0.2, 40))
    one = wj.SpringWalker(slope, stiffness)
    data = wj.basin(one, wide, "direct")
    assert data.sizes["number"] >= 1 and (data["period"] == 1).all()
    assert one.gait_region().contains(data["states"].values[:, 0]).all()


def test_without_a_guess_the_gait_of_a_spring_is_the_stable_one():
    """The only one that attracts; an unstable one has a multiplier of -2.99."""
    one = wj.SpringWalker(0.012, 3.0)
    gait = wj.find_gait(one)
    assert gait.stable and np.abs(gait.multipliers) == pytest.approx(0.70334, abs=1e-5)
    data = wj.basin(one, wj.Grid.sheared(theta=(0.1, 0.3, 12), sum=(-0.15, 0, 12)), "direct")
    np.testing.assert_allclose(data["states"].values, gait.states[None], rtol=0, atol=1e-12)


def test_few_starts_are_searched_before_all(monkeypatch):
    """All of them only if no gait is stable that is found from few; the gait is the same."""
    one, sizes, find = wj.SpringWalker(0.012, 3.0), [], search.search_region
    region = wj.Grid.sheared(theta=(0.1, 0.3, 30), sum=(-0.15, 0, 80))
    gaits = wj.find_gaits(one, region=region)
    stable = min(gaits, key=lambda gait: abs(gait.multipliers[0]))
    assert stable.stable and len(gaits) > 1
    monkeypatch.setattr(wj.SpringWalker, "gait_region", lambda _: region)

    def search_region(walker, period, grid, *, kept, **options):
        sizes.append(grid.size)
        np.testing.assert_array_equal([grid.lower, grid.upper], [region.lower, region.upper])
        found = find(walker, period, grid, **options)
        return [gait for gait in found if grid.size == region.size or kept(gait)]

    for kept, expected in (
        (lambda gait: True, [15 * 40]),
        (lambda gait: not gait.stable, [15 * 40, 30 * 80]),
        (lambda gait: False, [15 * 40, 30 * 80]),
    ):
        sizes.clear()
        monkeypatch.setattr(search, "search_region", partial(search_region, kept=kept))
        np.testing.assert_allclose(wj.find_gait(one).states, stable.states, rtol=0, atol=1e-12)
        assert sizes == expected
    monkeypatch.setattr(search, "FEW_STARTS", region.size)
    wj.find_gait(one)
    assert sizes == [*expected, 30 * 80]


def test_without_a_stable_gait_the_further_region_is_searched(monkeypatch):
    one = wj.SpringWalker(0.012, 3.0)
    stable, unstable = wj.find_gait(one, [0.1777, -0.2482]), wj.find_gait(one, [0.1688, -0.2558])
    assert stable.stable and not unstable.stable

    def around(gait, size, cells):
        theta, thetadot = gait.states[0]
        axes = {"theta": theta, "thetadot": thetadot}
        return wj.Grid.plain(**{name: (at - size, at + size, cells) for name, at in axes.items()})

    near, further = around(unstable, 1e-6, 2), around(stable, 1e-2, 8)
    monkeypatch.setattr(wj.SpringWalker, "gait_region", lambda _: near)
    assert [gait.stable for gait in wj.find_gaits(one)] == [False]
    np.testing.assert_allclose(wj.find_gait(one).states, unstable.states, rtol=0, atol=1e-12)
    monkeypatch.setattr(wj.SpringWalker, "further_gait_region", lambda _: further)
    np.testing.assert_allclose(wj.find_gait(one).states, stable.states, rtol=0, atol=1e-12)


@pytest.mark.parametrize("value", VALUES["gaits"], ids=lambda v: f"{v['kind']}-{v['slope']}")
def test_gaits_of_the_reference(value):
    """The long one without a guess, the short one from Garcia's expansion."""
    slope = value["slope"]
    guess = None
    if value["kind"] == "short":
        theta = 0.943976 * slope ** (1 / 3) - 0.264561 * slope
        guess = [theta, -1.090331 * theta + 0.86661 * slope]
    gait = wj.find_gait(walker(slope), guess)
    assert gait.found and gait.residual < 1e-14
    np.testing.assert_allclose(gait.states, [value["state"]], rtol=0, atol=1e-11)
    np.testing.assert_allclose(gait.step_times, [value["step_time"]], rtol=0, atol=1e-9)
    multipliers = [complex(*pair) for pair in value["multipliers"]]
    np.testing.assert_allclose(gait.multipliers, multipliers, rtol=0, atol=1e-9)
    assert gait.stable == all(abs(m) < 1 for m in multipliers)
    assert_walks(slope, gait)
    if "jacobian" in value:
        local = cycles.linearise(walker(slope), np.array([[value["state"]]]), Integrator(1e-12))
        np.testing.assert_allclose(local.jacobian[0, 0], value["jacobian"], rtol=0, atol=1e-9)


def test_all_gaits_of_a_region_each_once():
    kinds = {v["kind"]: v["state"] for v in VALUES["gaits"] if v["slope"] == 0.009}
    for region in (None, REGION):
        gaits = wj.find_gaits(walker(), region=region)
        states = np.array([gait.states[0] for gait in gaits])
        for kind in ("short", "long"):
            assert (np.abs(states - kinds[kind]).max(axis=1) < 1e-11).sum() == 1
        assert (np.diff(states[:, 0]) > 1e-7).all()
        for gait in gaits:
            assert_walks(0.009, gait)
    around_long = wj.Grid.plain(theta=(0.198, 0.202, 9), thetadot=(-0.202, -0.198, 9))
    (only,) = wj.find_gaits(walker(), region=around_long)
    np.testing.assert_allclose(only.states[0], kinds["long"], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("period", "bifurcation", "before", "after"),
    [(2, 0.01508843794111946, 0, 1), pytest.param(3, 0.012280821626094882, 0, 2, marks=SLOW)],
)
def test_next_to_a_bifurcation_no_gait_is_invented(period, bifurcation, before, after):
    """Where cycles that are none miss themselves by no more than rounding."""
    for distance in (-1e-10, -1e-11, 0, 1e-11, 1e-10):
        gaits = wj.find_gaits(walker(bifurcation + distance), period, REGION)
        assert len(gaits) <= (after if distance > 0 else before)
    for distance, count in ((-1e-5, before), (1e-5, after)):
        assert len(wj.find_gaits(walker(bifurcation + distance), period, REGION)) == count


@pytest.mark.parametrize("slope", [1e-6, 0.05, 0.1, 0.2, 0.25, 0.2597])
def test_the_long_gait_is_found_on_every_slope_that_has_it(slope):
    gait = wj.find_gait(walker(slope))
    assert gait.found and gait.step_times[0] > 3.8
    guess = np.asarray(search.approximate_long_gait(slope))
    np.testing.assert_allclose(gait.states[0], guess, rtol=0, atol=2e-5)


@pytest.mark.slow
def test_slow_gaits_whose_swing_leg_swings_back_and_forth_again():
    """Close to the edge of falling backward, where only fine cells lead to them."""
    fine = wj.Grid.sheared(theta=(0, 0.5, 100), sum=(-0.05, 0.02, 1000))
    gaits = wj.find_gaits(walker(), region=fine)
    times = [float(gait.step_times[0]) for gait in gaits]
    np.testing.assert_allclose(times, [3.096, 3.882, 9.417, 10.182], atol=1e-3)
    for gait in gaits[2:]:
        assert not gait.stable and abs(gait.multipliers[0]) > 900
        assert_walks(0.009, gait)


@pytest.mark.parametrize(
    ("slope", "period", "count"), [(0.005, 2, 0), (0.016, 2, 1), (0.0122, 3, 0), (0.0124, 3, 2)]
)
def test_gaits_exist_where_they_do(slope, period, count):
    """Period two after the doubling at 0.01509, period three after the fold at 0.01228."""
    gaits = wj.find_gaits(walker(slope), period, REGION)
    assert len(gaits) == count
    for gait in gaits:
        assert gait.states.shape == (period, 2) and gait.states[:, 0].argmin() == 0
        assert np.abs(gait.states[1:] - gait.states[0]).max(axis=1).min() > 1e-3
        assert_walks(slope, gait)
        columns = [
            richardson(lambda s, x=gait.states[0], e=e: walk_on(slope, x + s * e, period), 0, 1e-5)
            for e in np.eye(2)
        ]
        expected = np.linalg.eigvals(np.stack(columns, axis=1)).astype(complex)
        found = sorted(gait.multipliers, key=lambda m: (m.real, m.imag))
        expected = sorted(expected, key=lambda m: (m.real, m.imag))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", ["long", "short"])
def test_small_slopes_recover_the_expansion(kind):
    """Down to a slope of 1e-5, fitted by polynomials in slope^{2/3}; Garcia and others (1998)."""
    slopes = np.geomspace(1e-5, 3e-4, 12)
    printed = VALUES["small_slope_expansion"][kind]
    gaits = []
    for slope in slopes:
        theta = printed["T0"] * slope ** (1 / 3)
        gaits.append(wj.find_gait(walker(slope), [theta, printed["a"] * theta]))
    assert all(gait.found for gait in gaits)
    theta, thetadot = np.array([gait.states[0] for gait in gaits]).T
    u = np.cbrt(slopes)
    powers = np.stack([u ** (2 * i) for i in range(5)], axis=1)
    fit = lambda basis, values: np.linalg.lstsq(basis, values, rcond=None)[0][:2]
    T0, T1 = fit(powers, theta / u)
    a, c1 = fit(np.column_stack([theta / u, powers[:, 1:]]), thetadot / u)
    t0, t1 = fit(powers, np.array([gait.step_times[0] for gait in gaits]))
    found = dict(T0=T0, T1=T1, a=a, c1=c1, t0=t0, t1=t1)
    if kind == "long":  # printed as -0.270837
        assert found.pop("T1") == pytest.approx(-0.186569, abs=6e-7)
    for name, value in found.items():
        assert value == pytest.approx(printed[name], abs=6e-7), name


def test_derivatives_of_a_gait():
    gait = wj.find_gait(walker())
    derivatives = gait_derivatives(walker(), gait, "slope")
    printed = VALUES["gait_slope_derivative"]["d_state_d_slope"]
    np.testing.assert_allclose(derivatives.states[0], printed, rtol=1e-5)
    at = lambda field: lambda slope: getattr(wj.find_gait(walker(slope)), field)
    for field in ("states", "step_times"):
        expected = richardson(at(field), 0.009, 1e-4)
        np.testing.assert_allclose(getattr(derivatives, field), expected, rtol=1e-9)
    expected = richardson(at("multipliers"), 0.009, 2e-5)
    np.testing.assert_allclose(derivatives.multipliers, expected, rtol=1e-8)
    for quantity in ("states", "step-times", "multipliers"):
        found, field = wj.measure(walker(), quantity, "slope", gait), quantity.replace("-", "_")
        np.testing.assert_array_equal(found.value, getattr(gait, field))
        np.testing.assert_array_equal(found.gradient[..., 0], getattr(derivatives, field))
    theta = wj.measure(walker(), lambda walker, gait: gait.states[0, 0], "slope", gait)
    assert theta.value == gait.states[0, 0]
    np.testing.assert_allclose(theta.gradient, derivatives.states[0, :1], rtol=1e-12)


def test_derivatives_of_a_gait_of_period_two():
    (gait,) = wj.find_gaits(walker(0.0165), 2, REGION)
    derivatives = gait_derivatives(walker(0.0165), gait, "slope")
    at = lambda field: lambda slope: getattr(wj.find_gait(walker(slope), gait.states, 2), field)
    for field in ("states", "step_times", "multipliers"):
        expected = richardson(at(field), 0.0165, 2e-5)
        np.testing.assert_allclose(getattr(derivatives, field), expected, rtol=1e-8)


def test_derivatives_grow_towards_a_fold():
    """Like the inverse square root of the distance; the fold of period three is at 0.01228082."""
    rates = []
    for distance in (4e-9, 1e-9):
        slope = 0.012280821626094882 + distance
        gaits = wj.find_gaits(walker(slope), 3, REGION)
        derivatives = gait_derivatives(walker(slope), gaits[0], "slope")
        rates.append(np.abs(derivatives.states).max())
    assert rates[1] / rates[0] == pytest.approx(2, abs=0.05)


@pytest.mark.slow
def test_a_transformed_gait_is_the_same_and_differentiable():
    gait, rates = jax.jvp(lambda s: wj.find_gait(wj.SimplestWalker(s)), (0.009,), (1.0,))
    eager = wj.find_gait(walker())
    derivatives = gait_derivatives(walker(), eager, "slope")
    assert gait.found and gait.stable
    for field in ("states", "multipliers", "step_times"):
        np.testing.assert_allclose(getattr(gait, field), getattr(eager, field), atol=1e-13)
        np.testing.assert_allclose(getattr(rates, field), getattr(derivatives, field), rtol=1e-9)
    guesses = jnp.array([[0.2, -0.2], [3.0, 3.0]])
    batch, changes = jax.jvp(
        lambda s: jax.vmap(lambda x: wj.find_gait(wj.SimplestWalker(s), x))(guesses),
        (0.009,),
        (1.0,),
    )
    assert batch.found.tolist() == [True, False]
    for field in ("states", "multipliers", "step_times"):
        np.testing.assert_allclose(getattr(batch, field)[0], getattr(eager, field), atol=1e-13)
        assert (
            np.isnan(getattr(batch, field)[1]).all() and np.isnan(getattr(changes, field)[1]).all()
        )
    (cycle,) = wj.find_gaits(walker(0.016), 2, REGION)
    two = jax.jit(lambda x: wj.find_gait(walker(0.016), x, 2))(cycle.states[0] + 1e-4)
    np.testing.assert_allclose(two.states, cycle.states, atol=1e-12)
    np.testing.assert_allclose(two.multipliers, cycle.multipliers, atol=1e-11)


def test_a_failed_search_says_so():
    for guess in ([3.0, 3.0], [0.2, -0.5], [0.2, 0.2]):
        gait = search_gait(walker(), guess)
        assert not gait.found and not gait.stable and np.isnan(gait.residual)
        assert gait.states.shape == (1, 2) and np.isnan(gait.states).all()
        assert np.isnan(gait.multipliers).all() and np.isnan(gait.step_times).all()
    gait = search_gait(walker(0.005), [0.1, -0.1], 3)
    assert not gait.found and gait.states.shape == (3, 2) and gait.step_times.shape == (3,)


WHY = r"\(explain says why\)"


@pytest.mark.parametrize(
    ("slope", "guess", "period", "reason"),
    [
        (
            0.009,
            [0.2, -0.5],
            1,
            rf"it makes no stride from the guess {WHY}; try another guess",
        ),
        (
            0.005,
            [0.1, -0.1],
            3,
            rf"it makes fewer than 3 strides from the guess {WHY}; try an",
        ),
        (0.27, None, 1, rf"it makes no stride from where the search begins {WHY}; try a"),
        (
            0.009,
            [0.348, -0.3378],
            1,
            r"Newton's iteration diverged: a stride misses .* by 0\.\d+; ",
        ),
        (0.005, None, 2, "none of the searches from .* starts that make a stride converged; try a"),
    ],
)
def test_find_gait_raises_with_the_reason_where_it_finds_none(slope, guess, period, reason):
    expected = rf"^no gait of period {period} found for SimplestWalker, slope {slope}: {reason}"
    with pytest.raises(wj.ComputationFailed, match=expected):
        wj.find_gait(walker(slope), guess, period)


@pytest.mark.parametrize("guess", [[np.nan, 0.0], [0.2, np.inf], [[0.2, -0.2], [np.nan, -0.2]]])
def test_a_guess_that_is_not_finite_is_refused(guess):
    with pytest.raises(ValueError, match=r"^guess must be finite, not \[.*(nan|inf).*\]$"):
        wj.find_gait(walker(), guess, np.ndim(guess))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cycles": np.zeros((0, 1, 2))}, r"cycles must have shape .* not \(0, 1, 2\)"),
        ({"steps": 0}, "steps must be at least 1, not 0"),
        ({"rate": np.nan}, "rate must be positive and finite, not nan"),
        ({"rate": -1.0}, r"rate must be positive and finite, not -1\.0"),
    ],
)
def test_descend_refuses(changes, message):
    arguments = {"cycles": np.array([[[0.2, -0.2]]]), "steps": 2, "rate": 0.001} | changes
    with pytest.raises(ValueError, match=message):
        wj.descend(walker(), **arguments)


def test_a_shorter_period_is_not_a_longer_one():
    long = wj.find_gait(walker())
    twice = search_gait(walker(), long.states[0], 2)
    assert twice.residual < 1e-14 and not twice.found and not twice.stable


def test_a_gait_that_a_walk_does_not_repeat_is_none():
    """One so unstable that it loses its way within its period; here, one that is none."""
    (gait,) = wj.find_gaits(walker(0.016), 2, REGION)
    away = gait.states + np.array([[0.0, 0.0], [0.0, 1e-6]])
    both = cycles.Gait(*(np.stack([field, field]) for field in gait))
    both = both._replace(states=np.stack([gait.states, away]))
    confirmed = search.confirm_gaits(walker(0.016), both, Integrator(1e-12))
    assert confirmed.found.tolist() == confirmed.stable.tolist() == [True, False]


def test_a_gait_with_one_of_its_states_in_the_region_is_found():
    (gait,) = wj.find_gaits(walker(0.016), 2, REGION)
    for theta, thetadot in gait.states:
        around = wj.Grid.plain(
            theta=(theta - 1e-3, theta + 1e-3, 5), thetadot=(thetadot - 1e-3, thetadot + 1e-3, 5)
        )
        (found,) = wj.find_gaits(walker(0.016), 2, around)
        np.testing.assert_allclose(found.states, gait.states, rtol=0, atol=1e-11)
    beside = wj.Grid.plain(theta=(0.1, 0.12, 5), thetadot=(-0.13, -0.11, 5))
    assert np.abs(gait.states - np.array([0.11, -0.12])).max(axis=1).min() > 0.02
    assert wj.find_gaits(walker(0.016), 2, beside) == []


def test_a_traced_search_invents_no_gait_next_to_a_bifurcation(monkeypatch):
    """Of a map with the gaits +-sqrt(distance), the first coordinate's, where distance > 0.

    A negative one of 1e-13 misses by no more than what passes for rounding.
    """

    def ends(walker, states, integrator):
        distance, (x, y) = walker.slope - 0.5, states.T
        return jnp.stack([x + distance - x**2, y / 2], axis=1), jnp.ones_like(x)

    monkeypatch.setattr("walker_jax.gaits.cycles.apply_strides", ends)
    start, plain = jnp.array([[1e-4, 0.1]]), inspect.unwrap(cycles.solve_cycle)
    solve = jax.jit(lambda slope: plain(walker(slope), start, Integrator(1e-12)))
    for distance, found in ((1e-4, True), (-1e-13, False), (-1e-4, False)):
        gait = solve(0.5 + distance)
        assert bool(gait.found) == bool(gait.stable) == found
        assert np.isfinite(gait.states).all() == np.isfinite(gait.multipliers).all() == found
        if found:
            np.testing.assert_allclose(gait.states, [[1e-2, 0]], rtol=0, atol=1e-12)
            np.testing.assert_allclose(gait.multipliers, [1 - 2e-2, 0.5], rtol=0, atol=1e-12)


def test_multipliers_of_a_traced_search_are_in_their_order(monkeypatch):
    """Of a cycle of three, whose Jacobians do not commute."""

    def bend(x):
        return jnp.stack([1 - 1.92 * x[0] ** 2 + x[1], 0.05 * x[0] + 0.3 * x[0] * x[1]])

    def ends(walker, states, integrator):
        return jax.vmap(bend)(states), jnp.ones(len(states))

    def thrice(x):
        return bend(bend(bend(x)))

    monkeypatch.setattr("walker_jax.gaits.cycles.apply_strides", ends)
    x = jax.lax.fori_loop(0, 999, lambda _, x: bend(x), jnp.array([1.0, 0.0]))
    plain = inspect.unwrap(cycles.solve_cycle)
    start = jnp.stack([x, bend(x), bend(bend(x))])
    gait = jax.jit(lambda start: plain(walker(), start, Integrator(1e-12)))(start)
    assert gait.found
    end, jacobian = jax.jit(lambda x: (thrice(x), jax.jacfwd(thrice)(x)))(gait.states[0])
    np.testing.assert_allclose(end, gait.states[0], rtol=0, atol=1e-13)
    expected = np.linalg.eigvals(jacobian).astype(complex)
    expected = expected[np.argsort(-np.abs(expected))]
    np.testing.assert_allclose(gait.multipliers, expected, rtol=1e-9)


def test_descent_reaches_gaits_from_where_newton_diverges():
    """From the cells of the whole section that make a stride at all."""
    grid = wj.Grid.plain(theta=(0, np.pi / 4, 16), thetadot=(-1, 0, 16))
    starts = grid.centres(np.arange(grid.size))
    _, cycles = search.cycle_guesses(walker(), starts, 1, Integrator(1e-12))
    newton = iterate_newton(walker(), cycles, Integrator(1e-12))
    assert 0.6 < newton.found.mean() < 0.85
    lost = cycles[~newton.found]
    nearer = wj.descend(walker(), lost)
    rescued = iterate_newton(walker(), nearer, Integrator(1e-12))
    assert rescued.found.mean() > 0.7
    before, after = (
        np.abs(wj.strides(walker(), x[:, 0]).state - x[:, 0]).max(axis=1) for x in (lost, nearer)
    )
    assert np.isfinite(after).all() and (after < before).mean() > 0.9


def test_descent_leaves_what_cannot_stride_alone():
    cycles = np.array([[[0.2, -0.2]], [[0.2, -0.5]]])
    moved = wj.descend(walker(), cycles, 5)
    np.testing.assert_array_equal(moved[1], cycles[1])
    assert np.abs(moved[0] - cycles[0]).max() > 0


def test_each_search_may_have_its_own_walker():
    slopes = np.array([0.004, 0.009, 0.015])
    states = [
        v["state"]
        for s in slopes
        for v in VALUES["gaits"]
        if (v["slope"], v["kind"]) == (s, "long")
    ]
    walkers = parameters.with_parameter(walker(), "slope", slopes)
    found = iterate_newton(walkers, np.array(states)[:, None] + 1e-3, Integrator(1e-12))
    np.testing.assert_allclose(found.states[:, 0], states, rtol=0, atol=1e-11)
    ends = wj.strides(walkers, np.array(states))
    np.testing.assert_allclose(ends.state, states, rtol=0, atol=1e-11)


def test_uncertainty_is_how_residual_and_rounding_move_it():
    """By the smallest of the factors by which a matrix stretches; here a diagonal one, turned."""
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    matrices = np.stack([turn @ np.diag([3.0, small]) for small in (0.5, 1e-7)])
    sure, unsure = cycles.estimate_error(np.array([1e-12, 0.0]), matrices)
    assert sure == pytest.approx(2e-12, rel=0.01)
    assert np.finfo(float).eps / 1e-7 <= unsure < 1e-7  # though nothing is seen to be missed


def test_one_singular_system_spoils_no_other():
    matrices = np.stack([np.eye(2), np.zeros((2, 2)), 2 * np.eye(2)])
    solutions = cycles.solve_linear_systems(matrices, np.ones((3, 2)))
    np.testing.assert_allclose(solutions, [[1, 1], [0, 0], [0.5, 0.5]])
    steep = np.stack([np.diag([1.0, 1e-17]), np.zeros((2, 2))])  # the first is not singular
    np.testing.assert_allclose(
        cycles.solve_linear_systems(steep, np.ones((2, 2))), [[1, 1e17], [0, 0]]
    )


def test_in_float32_a_gait_has_float32_digits():
    gait = wj.find_gait(wj.SimplestWalker(jnp.float32(0.009)), np.array([0.2, -0.2], np.float32))
    assert gait.found and gait.stable and gait.states.dtype == np.float32
    np.testing.assert_allclose(gait.states[0], [0.2003109, -0.1998325], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(period=0), "period .*0"),
        (dict(guess=[0.2]), r"guess .*\(2,\).*\(1,\)"),
        (dict(guess=[[0.2, -0.2]], period=2), r"guess .*\(2, 2\).*\(1, 2\)"),
        (dict(tolerance=1e-30), "tolerance .*1e-30"),
    ],
)
def test_wrong_requests_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        wj.find_gait(walker(), **arguments)


def test_wrong_regions_parameters_and_gaits_are_refused():
    with pytest.raises(ValueError, match=r"region .*theta, thetadot"):
        wj.find_gaits(walker(), region=wj.Grid.plain(theta=(0, 1, 3)))
    with pytest.raises(ValueError, match=r"period .*-1"):
        wj.find_gaits(walker(), -1)
    with pytest.raises(ValueError, match=r"descent .*-5"):
        wj.find_gaits(walker(), descent=-5)
    gait = wj.find_gait(walker())
    with pytest.raises(ValueError, match=r"parameter .*slope.*'mass'"):
        gait_derivatives(walker(), gait, "mass")
    with pytest.raises(ValueError, match=r"gait must be one"):
        gait_derivatives(walker(), search_gait(walker(), [3.0, 3.0]), "slope")
    with pytest.raises(ValueError, match=r"guess .*period 2.* JAX traces"):
        jax.eval_shape(lambda s: wj.find_gait(wj.SimplestWalker(s), period=2), 0.009)


def gait_with_a_fold(d):
    """x -> x + d - x^2 rests at sqrt(d), by d 1 / (2 sqrt(d)); where d is negative, at no point."""
    system = wj.Map(lambda x, d: x + d - x**2, ("x",), parameters={"d": d})
    found = wj.find_gait(system, jnp.array([0.3]))
    return found.states[0, 0], found.multipliers[0].real


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_a_missing_gait_has_derivatives_of_nan(mode):
    d = jnp.array([0.04, -0.04, 0.09])
    root = np.sqrt(np.abs(d))
    expected = [0.5 / root, -1 / root]
    known = np.array([True, False, True])
    slopes = mode(gait_with_a_fold)
    for found, value in zip(jax.vmap(slopes)(d), expected, strict=True):
        np.testing.assert_allclose(found, np.where(known, value, np.nan), rtol=1e-9)
    compiled = jax.jit(slopes)
    assert all(np.isnan(one) for one in compiled(-0.04))
    assert all(np.isfinite(one) for one in compiled(0.04))


@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=SLOW)])
def test_a_missing_gait_has_second_derivatives_of_nan(mode):
    d = jnp.array([0.04, -0.04, 0.09])
    root = np.sqrt(np.abs(d))
    known = np.array([True, False, True])
    np.testing.assert_array_equal(np.isfinite(jax.vmap(gait_with_a_fold)(d)[0]), known)
    second = jax.vmap(jax.jacfwd(mode(lambda d: gait_with_a_fold(d)[0])))(d)
    np.testing.assert_allclose(second, np.where(known, -0.25 / root**3, np.nan), rtol=1e-8)
