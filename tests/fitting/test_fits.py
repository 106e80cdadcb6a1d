"""Fits find the parameters of made-up recordings, with errors that say how far off they are."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from made_up_recordings import GRAVITY, Ball, bounces, record_ball, record_walk
from scipy.optimize import least_squares
from scipy.stats import chi2

import walker_jax as wj
from walker_jax.fitting import fits
from walker_jax.fitting.bounds import Bounds, from_free, slopes, to_free
from walker_jax.fitting.residuals import all_residuals, standardise
from walker_jax.fitting.solving import Solved
from walker_jax.fitting.starts import FEWEST, SHARE, values_at_start
from walker_jax.fitting.steps import Steps
from walker_jax.fitting.uncertainty import covariance_and_directions, information

NOISE = 1e-3
BALL_NOISE = {"height": NOISE, "time": NOISE}
WALK_NOISE: dict[str, float] = dict.fromkeys(("theta", "phi", "time"), NOISE)
GUESS = Ball(9.5, 0.0, 0.85)
MANY: dict[str, Any] = dict(count=20, restitution=0.97)


@pytest.fixture(scope="module")
def ball():
    """A recording of a ball with noise, and fits of both its parameters by single shooting."""
    recordings = record_ball(noise=NOISE)

    def fit(recordings=recordings, guess=GUESS, **options):
        asked: Any = dict(noise=BALL_NOISE, shooting="single") | options
        return wj.fit(guess, recordings, ["gravity", "restitution"], **asked)

    return recordings, fit


@pytest.fixture(scope="module")
def many():
    """A recording of 20 bounces with noise, and fits of the gravity with free starts."""
    recordings = record_ball(noise=NOISE, seed=3, **MANY)
    fit = lambda recordings=recordings, guess=GUESS, **options: wj.fit(
        guess, recordings, "gravity", noise=BALL_NOISE, **options
    )
    return recordings, fit


@pytest.mark.parametrize("shooting", ["multiple", "single"])
def test_exact_recordings_give_back_the_parameters(shooting, ball, many):
    (_, fit), exact = (many, MANY) if shooting == "multiple" else (ball, {})
    found = fit(record_ball(**exact))
    expected = {"gravity": GRAVITY, "restitution": 0.9}
    for name, value in found.parameters.items():
        assert value == pytest.approx(expected[name], rel=1e-8)
    assert found.converged and found.data.attrs["sum_of_squares"] < 1e-8
    np.testing.assert_allclose(found.data.fitted, found.data.recorded, atol=1e-9)
    assert float(vars(found.system)["gravity"]) == found.parameters["gravity"]


def test_free_starts_tell_nothing_of_the_impact(ball):
    """The restitution moves no residual then, and the fit says so by name."""
    _, fit = ball
    found = fit(shooting="multiple")
    assert found.errors["restitution"] == np.inf and 0 < found.errors["gravity"] < 0.02
    assert [one.split(":")[0] for one in found.unknown] == ["1.00 restitution"]
    assert found.parameters["restitution"] == pytest.approx(0.85)


def check_with_scipy(found, parameter):
    """`least_squares` on all residuals, one for each number, which are not compressed."""
    posed = found.problem
    assert posed is not None
    first = posed.data.steps.is_first if posed.layout.single else slice(None)
    flat, unflatten = ravel_pytree(posed.begun._replace(starts=posed.begun.starts[first]))
    residuals = jax.jit(lambda at, data: all_residuals(posed.layout, unflatten(at), data))
    of = lambda at: np.asarray(residuals(jnp.asarray(at), posed.data))
    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-13)
    other = least_squares(of, np.asarray(flat), "3-point", x_scale="jac", **tight)
    assert found.data.attrs["sum_of_squares"] == pytest.approx(2 * other.cost, rel=1e-9)
    free = jnp.asarray(other.x[: len(found.parameters)])
    value = float(from_free(free, found.bounds)[0])
    error = found.errors[parameter]
    assert abs(found.parameters[parameter] - value) < 1e-3 * error
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    rate = float(slopes(free, found.bounds)[0])
    assert error == pytest.approx(rate * np.sqrt(covariance[0, 0]), rel=1e-4)


def test_scipy_finds_the_same_by_differences(ball, many):
    for _, fit in (ball, many):
        check_with_scipy(fit(), "gravity")


@pytest.mark.slow
@pytest.mark.parametrize("shooting", ["multiple", "single"])
def test_scipy_finds_the_same_of_a_walk(shooting):
    recordings = record_walk(wj.SimplestWalker(0.009), noise=NOISE)
    asked = wj.SimplestWalker(0.0095), recordings, "slope"
    check_with_scipy(wj.fit(*asked, noise=WALK_NOISE, shooting=shooting), "slope")


def check_guesses(near, far, name):
    for one in far:
        off = one.parameters[name] - near.parameters[name]
        assert one.converged and abs(off) < 1e-5 * near.errors[name]


def test_a_first_guess_that_is_far_off_leads_to_the_same(ball, many):
    for _, fit in (ball, many):
        check_guesses(fit(), [fit(guess=Ball(g, 0.0, 0.95)) for g in (6.0, 14.0)], "gravity")


@pytest.mark.slow
@pytest.mark.parametrize("shooting", ["multiple", "single"])
def test_a_walker_that_is_far_off_leads_to_the_same(shooting):
    recordings = record_walk(wj.SimplestWalker(0.009), noise=NOISE)
    options: Any = dict(noise=WALK_NOISE, shooting=shooting)
    near, *far = (
        wj.fit(wj.SimplestWalker(slope), recordings, "slope", **options)
        for slope in (0.009, 0.006, 0.0135)
    )
    check_guesses(near, far, "slope")


def test_errors_are_as_large_as_the_fits_are_off(ball):
    """Squares of 40 errors, over their standard deviations, add up as the chi-square law says."""
    _, fit = ball
    totals, costs = np.zeros(2), 0.0
    for seed in range(40):
        found = fit(record_ball(noise=NOISE, seed=seed))
        off = [found.parameters["gravity"] - GRAVITY, found.parameters["restitution"] - 0.9]
        totals += (off / np.array([*found.errors.values()])) ** 2
        costs += found.data.attrs["sum_of_squares"]
    low, high = chi2.ppf((5e-4, 1 - 5e-4), 40)
    assert (low < totals).all() and (totals < high).all()
    low, high = chi2.ppf((5e-4, 1 - 5e-4), 40 * found.data.attrs["degrees_of_freedom"])
    assert low < costs < high


def test_noise_that_is_not_given_is_found(ball):
    _, fit = ball
    found = fit(noise={"time": NOISE})
    count = int(np.isfinite(found.data.recorded).sum())
    assert float(found.data.noise[0]) == pytest.approx(NOISE, rel=4 / np.sqrt(2 * count))
    assert found.parameters["gravity"] == pytest.approx(fit().parameters["gravity"], rel=1e-3)


@pytest.fixture(scope="module")
def posed(many):
    """A fit of a ball before its search, at the true gravity, and its bounces in closed form."""
    _, fit = many
    problem = fit(guess=Ball(GRAVITY, 0.0, 0.97)).problem
    assert problem is not None
    begins, speeds = bounces(**MANY)
    begun = problem.begun._replace(begins=begins[:1], starts=speeds[:, None])
    return problem._replace(begun=begun), begins[:-1], speeds


def test_a_step_apart_begins_where_it_was_recorded(posed):
    """So a first one that is too long puts no later one off, as it does where steps are linked."""
    problem, begins, speeds = posed
    longer = problem.begun._replace(starts=problem.begun.starts * ([[1.1]] + [[1.0]] * 19))
    follow = lambda apart: fits.follow_jit(
        problem.layout, longer, problem.data._replace(apart=np.array(apart))
    )
    np.testing.assert_array_equal(follow(True).begins, problem.data.steps.begins)
    np.testing.assert_allclose(
        follow(True).ends - follow(True).begins, 2 * longer.starts[:, 0] / GRAVITY, rtol=1e-12
    )
    late = np.append(0, np.full(19, 0.2 * speeds[0] / GRAVITY))
    np.testing.assert_allclose(follow(False).begins, begins + late, rtol=1e-12)


def test_noise_is_that_of_steps_that_are_made(posed):
    """The last one, which begins below the ground, has no residuals; the others keep theirs."""
    problem, begins, speeds = posed
    steps, starts = problem.data.steps, np.append(speeds[:-1], -1.0)[:, None]
    nothing: Any = None
    found = Solved(problem.begun._replace(starts=starts), *[nothing] * 5)
    after = steps.times - begins[:, None]
    off = (speeds[:, None] * after - GRAVITY * after**2 / 2 - steps.values[..., 0])[:-1]
    free = 1 - (1 + 1 + len(speeds)) / steps.count
    expected = np.sqrt(np.mean(off[steps.known[:-1, :, 0]] ** 2) / free)
    noise = fits.noise_left(problem.layout, found, problem.data)
    np.testing.assert_allclose(noise, expected, rtol=1e-9)


def test_bootstrap_agrees_with_the_jacobian(many):
    """Resampled steps spread as far as the error says, within the chance of 20 steps."""
    _, fit = many
    found = fit(bootstrap=100, seed=1)
    assert found.draws.shape == (100, 1) and np.isfinite(found.draws).all()
    assert 0.6 < found.draws.std() / found.errors["gravity"] < 1.6
    low, high = found.intervals()["gravity"]
    assert low < GRAVITY < high


def test_a_prior_and_a_recording_are_weighed_by_their_errors(ball):
    """For a nearly linear problem the posterior mean is that of two normal distributions."""
    _, fit = ball
    alone = fit()
    mean, deviation = alone.parameters["gravity"] + 0.01, alone.errors["gravity"]
    both = fit(priors={"gravity": (mean, deviation)})
    middle = alone.parameters["gravity"] + 0.005
    assert both.parameters["gravity"] == pytest.approx(middle, abs=1e-4)
    assert both.errors["gravity"] == pytest.approx(deviation / np.sqrt(2), rel=1e-3)


def test_bounds_hold_and_tell(ball):
    _, fit = ball
    bounded = fit(bounds={"gravity": (9.0, 9.7), "restitution": (0.5, np.inf)})
    assert 9.0 < bounded.parameters["gravity"] < 9.7
    free, wide = fit(), fit(bounds={"gravity": (9.0, 11.0), "restitution": (-np.inf, 1)})
    for name, value in free.parameters.items():
        assert wide.parameters[name] == pytest.approx(value, abs=1e-4 * free.errors[name])
        assert wide.errors[name] == pytest.approx(free.errors[name], rel=1e-6)


@pytest.mark.parametrize(
    "robust", [["cauchy"], pytest.param(["cauchy", "soft_l1"], marks=pytest.mark.slow)]
)
def test_outliers_move_a_robust_fit_less(robust, ball):
    (recording,), fit = ball
    wild = recording.values["height"].copy()
    wild[::15] += 0.5
    recordings = [recording._replace(values={"height": wild})]
    fits = [fit(recordings, loss=loss, shooting="multiple") for loss in (*robust, "linear")]
    off = [abs(one.parameters["gravity"] - GRAVITY) for one in fits]
    assert off == sorted(off) and off[-2] < off[-1] / 5


def test_losses_are_those_of_scipy():
    r = jnp.linspace(-5, 5, 11)
    assert jnp.allclose(standardise("soft_l1", r) ** 2, 2 * (jnp.sqrt(1 + r**2) - 1))
    assert jnp.allclose(standardise("cauchy", r) ** 2, jnp.log1p(r**2))
    at_zero = jax.grad(lambda r: standardise("cauchy", r))(0.0)
    assert float(at_zero) == 1


def test_gaps_cost_precision_alone(ball):
    recordings, fit = ball
    gone = recordings[0].values["height"].copy()
    gone[::6] = np.nan
    fewer, whole = fit([recordings[0]._replace(values={"height": gone})]), fit()
    assert fewer.errors["gravity"] > whole.errors["gravity"]
    assert abs(fewer.parameters["gravity"] - GRAVITY) < 4 * fewer.errors["gravity"]


def test_two_systems_take_turns_and_a_recorded_input_pushes():
    """Bounces of two restitutions in turn; each system is told which bounce is its own.

    With a push of 0.5 g the balls fall as if gravity were half as much again.
    """
    factors = np.where(np.arange(6) % 2, 0.8, 0.95)
    (plain,) = record_ball(6, restitution=factors)
    samples = {"time": plain.time, "push": -GRAVITY / 2 + 0 * plain.time} | plain.values
    recordings = wj.read_recordings(samples, ["height"], inputs=["push"], strikes=plain.strikes)
    table: Any = dict(push=np.zeros(2), spacing=1.2)
    pair = Ball(4.0, 0.0, 0.95, **table), Ball(4.0, 0.0, 0.8, **table)
    fit = lambda systems: wj.fit(
        systems,
        recordings,
        "gravity",
        noise=BALL_NOISE,
        shooting="single",
        inputs={"push": ("push", 1.2)},
    )
    found = fit(pair)
    assert found.parameters["gravity"] == pytest.approx(GRAVITY / 2, rel=1e-7)
    assert isinstance(found.system, tuple)
    assert [float(vars(one)["restitution"]) for one in found.system] == [0.95, 0.8]
    assert found.data.attrs["sum_of_squares"] < 1e-8
    assert fit(pair[::-1]).data.attrs["sum_of_squares"] > 1e4


@pytest.mark.slow
def test_parameters_that_add_up_are_not_told_apart():
    names = ["gravity", "more_gravity"]
    found = wj.fit(Ball(9.0, 0.8), record_ball(noise=NOISE), names, noise=BALL_NOISE)
    (words,) = found.unknown
    direction = found.directions[0].weights
    # equal and opposite in their own units, so as 1 / value relative to the values
    g, more = (found.parameters[name] for name in names)
    ratio = direction["gravity"] / direction["more_gravity"]
    assert ratio == pytest.approx(-more / g, rel=1e-4)
    assert "gravity" in words and g + more == pytest.approx(GRAVITY, rel=2e-3)
    assert not np.isfinite([*found.errors.values()]).any()


def test_covariance_is_that_of_linear_regression():
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(40, 5))
    root = information(jacobian, 2)
    covariance, directions = covariance_and_directions(root, ["a", "b"], np.array([2.0, 0.1]))
    expected = np.linalg.inv(jacobian.T @ jacobian)[:2, :2]
    np.testing.assert_allclose(covariance, expected, rtol=1e-12)
    scaled = expected / np.outer([2.0, 0.1], [2.0, 0.1])
    deviations = np.sqrt(np.linalg.eigvalsh(scaled))[::-1]
    np.testing.assert_allclose([one.deviation for one in directions], deviations, rtol=1e-12)
    # a value that happens to be 1e-14 is as well known as before, but not relative to itself
    near_zero, (worst, _) = covariance_and_directions(root, ["a", "b"], np.array([2.0, 1e-14]))
    np.testing.assert_allclose(near_zero, expected, rtol=1e-12)
    assert worst.weights["b"] == pytest.approx(1) and 1e10 < worst.deviation < np.inf


def test_changes_of_variables_are_inverse_to_each_other():
    bounds = Bounds(
        jnp.array([-jnp.inf, 1.0, -jnp.inf, 2.0]), jnp.array([jnp.inf, jnp.inf, 3.0, 4.0])
    )
    values = jnp.array([-7.0, 1.5, 2.0, 3.9])
    free = to_free(values, bounds)
    np.testing.assert_allclose(from_free(free, bounds), values, rtol=1e-14)
    by_differences = (from_free(free + 1e-6, bounds) - from_free(free - 1e-6, bounds)) / 2e-6
    np.testing.assert_allclose(slopes(free, bounds), by_differences, rtol=1e-7)


def test_a_guess_with_a_wrong_sign_is_told(ball):
    """With the gravity of the guess a ball falls upward and never lands."""
    _, fit = ball
    with pytest.raises(ValueError, match="none walks from its recorded start, such as"):
        fit(guess=Ball(-9.0, 0.0, 0.85))


def test_first_values_and_rates_are_those_of_least_squares():
    """A quadratic over the first quarter of a step; over few samples a straight line."""
    rng, late = np.random.default_rng(2), 0.3
    times = late + np.sort(rng.uniform(0, 2, (3, 32)), axis=1)
    values, known = rng.normal(size=(3, 32, 2)), np.ones((3, 32, 2), bool)
    known[1, 2:, 0] = False  # two samples
    known[2, ::2] = False
    whole, begins = np.zeros(3, int), np.full(3, late)
    ends = begins + 2
    steps = Steps(
        times, np.where(known, values, 0), known, begins, ends, whole, whole, whole, whole
    )
    found = values_at_start(steps)
    for step, column in np.ndindex(3, 2):
        at = times[step, known[step, :, column]] - late
        near = max(np.sum(at <= SHARE * 2), min(FEWEST, len(at)))
        of = values[step, known[step, :, column], column][:near]
        expected = np.polynomial.polynomial.polyfit(at[:near], of, 2 if near >= FEWEST else 1)
        np.testing.assert_allclose(found[:, step, column], expected[:2], rtol=1e-9)
