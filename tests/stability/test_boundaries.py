"""The dimensions of boundaries that are known: smooth ones, and fractals."""

import inspect

import numpy as np
import pytest

from walker_jax.checks import WrongUse
from walker_jax.fractals.dimensions import box_counting, uncertainty_exponent


def circle(p):
    """Inside a ball of radius 0.7, in any number of dimensions."""
    return (np.linalg.norm(p, axis=-1) < 0.7).astype(np.int8)


def line(p):
    return (p[..., 0] > 0).astype(np.int8)


def snowflake(p):
    """Inside the Koch snowflake on a triangle of side 1 about 0: below the curve of every side."""
    inside = np.ones(p.shape[:-1], bool)
    for angle in 2 * np.pi / 3 * np.arange(3):
        x, y = np.moveaxis(p @ rotation(angle), -1, 0)
        inside &= below_koch_curve(x + 0.5, y - 0.5 / np.sqrt(3))
    return inside.astype(np.int8)


def below_koch_curve(x, y, levels=12):
    """Below that from (0, 0) to (1, 0), whose quarters are images of the whole."""
    for _ in range(levels):
        x = np.minimum(x, 1 - x)
        from_corner = x - 1 / 3
        second = np.sqrt(3) * from_corner + y > 0  # beyond the bisector at the first corner
        x, y = (
            np.where(second, 1.5 * (from_corner + np.sqrt(3) * y), 3 * x),
            np.where(second, 1.5 * (y - np.sqrt(3) * from_corner), 3 * y),
        )
    return y < 0


def newton(p, steps=40):
    """Which root of z^3 = 1 Newton's method goes to."""
    z = p[..., 0] + 1j * p[..., 1]
    for _ in range(steps):
        z = (2 * z + 1 / z**2) / 3
    return np.select([z.real > 0.5, z.imag > 0], [0, 1], 2)


def cantor(p, levels=30):
    """The middle-thirds set's gaps, alternately 1 and 2 by their sizes; 0 outside [0, 1]."""
    x = np.array(p[..., 0])
    label = np.zeros(x.shape, int)
    open_ = (x >= 0) & (x <= 1)
    for level in range(levels):
        x = 3 * x
        middle = open_ & (x > 1) & (x < 2)
        label[middle] = 1 + level % 2
        open_ &= ~middle
        x = np.where(x >= 2, x - 2, x)
    return label


def newton_dimension(generations, start=0.3 + 0.7j):
    """The zero t of the pressure: that for which the sums of |(N^n)'|^-t over N^n(z) = start stay.

    N's critical points are its fixed roots and 0, which goes to the repelling fixed point at
    infinity, so N is subhyperbolic, and this is the dimension, Hausdorff's and Minkowski's. In the
    metric (1 + |z|^2)^(-3/4) |dz| derivatives neither vanish nor blow up on the boundary.
    """
    z, logs, sums = np.array([start]), np.zeros(1), []
    t = np.linspace(1.4, 1.5, 201)
    for _ in range(generations):
        companion = np.zeros((z.size, 3, 3), complex)  # of 2 x^3 - 3 z x^2 + 1
        companion[:, 0, 0], companion[:, 0, 2] = 1.5 * z, -0.5
        companion[:, 1, 0] = companion[:, 2, 1] = 1
        before = np.linalg.eigvals(companion)
        metric = 0.75 * np.log((1 + abs(before) ** 2) / (1 + abs(z[:, None]) ** 2))
        slope = np.log(abs(2 * (before**3 - 1) / (3 * before**3)))
        logs = (logs[:, None] + slope + metric).ravel()
        z = before.ravel()
        sums.append([np.exp(-power * logs).sum() for power in t])
    pressure = np.log(sums[-1]) - np.log(sums[-2])
    return np.interp(0, -pressure, t)


NEWTON = 1.4445  # by newton_dimension
KOCH = np.log(4) / np.log(3)
CANTOR = np.log(2) / np.log(3)


def test_the_reference_for_newton_s_method():
    found = [newton_dimension(9, start) for start in (0.3 + 0.7j, 2 + 0.3j)]
    np.testing.assert_allclose(found, NEWTON, atol=1e-3)


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def points(half, *shape, seed=0):
    """A square grid over about [-half, half] along the last axis, shifted and in 2-D rotated."""
    rng = np.random.default_rng(seed)
    step = 2 * half / max(shape)
    axes = [step * (np.arange(n) - n / 2) for n in shape]
    p = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    if len(shape) == 2:
        p = p @ rotation(rng.uniform(0, 2 * np.pi))
    return p + rng.uniform(-0.05, 0.05, len(shape))


BOXES = {
    "circle": (circle, points(1, 1024, 1000), 1.0, 0.01),
    "line": (line, points(1, 900, 1024), 1.0, 0.01),
    "snowflake": (snowflake, points(0.8, 700, 700), KOCH, 0.03),
    "newton": (newton, points(1, 800, 700), NEWTON, 0.06),
    "cantor": (cantor, 0.5 + points(0.6, 2**16 + 7), CANTOR, 0.06),
    "sphere": (circle, points(1.2, 160, 150, 155), 2.0, 0.05),
}


@pytest.mark.parametrize("name", BOXES)
def test_box_counting_finds_the_dimension(name):
    label_of, p, dimension, width = BOXES[name]
    found = box_counting(label_of(p), spacing=0.5)
    assert found.low <= dimension <= found.high
    assert 0 < found.high - found.low < width
    assert found.low < found.value < found.high
    np.testing.assert_array_equal(found.sizes, 2.0 * 2 ** np.arange(len(found.sizes)))
    slope = np.polyfit(np.log(found.sizes), np.log(found.counts), 1)[0]
    np.testing.assert_allclose(-slope, found.value, atol=width / 2)


def test_boxes_on_a_straight_boundary_are_counted_exactly():
    labels = np.zeros((1000, 777), int)
    labels[500:] = 3
    found = box_counting(labels)
    np.testing.assert_array_equal(found.sizes, [4, 8, 16])
    np.testing.assert_allclose(found.counts, (777 - 16) / found.sizes)  # half of 16 left off twice
    np.testing.assert_allclose(found[:3], 1)


def test_labels_at_random_fill_the_plane():
    found = box_counting(np.random.default_rng(0).integers(0, 3, (300, 300)))
    np.testing.assert_allclose(found[:3], 2, atol=1e-3)


def test_so_do_cells_that_alternate():
    found = box_counting(np.indices((200, 200)).sum(axis=0) % 2)
    np.testing.assert_allclose(found[:3], 2)


def test_more_confidence_takes_a_wider_interval():
    labels = newton(points(1, 256, 256))
    wide, narrow = (box_counting(labels, confidence=c) for c in (0.99, 0.5))
    assert wide.low < narrow.low < narrow.value == wide.value < narrow.high < wide.high


@pytest.mark.parametrize("corner", [0, 3])
def test_without_boundary_enough_there_is_no_dimension(corner):
    labels = np.ones((128, 128), int)
    labels[60 : 60 + corner, 60 : 60 + corner] = 2
    found = box_counting(labels)
    assert np.isnan(found[:3]).all()
    assert found.sizes.size == found.counts.size == 0


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        ((63, 200), {}, r"labels: shape \(63, 200\)"),
        ((), {}, r"labels: shape \(\)"),
        ((200, 200), {"spacing": 0.0}, r"spacing=0\.0"),
        ((200, 200), {"spacing": np.nan}, "spacing=nan"),
        ((200, 200), {"confidence": 1.0}, r"confidence must be .*, not 1\.0"),
    ],
)
def test_box_counting_refuses(shape, options, message):
    with pytest.raises(ValueError, match=message):
        box_counting(np.zeros(shape, int), **options)


@pytest.mark.parametrize(
    "labels", [np.full((64, 64), "in"), np.full((64, 64), None), "in", [["a"]]]
)
def test_box_counting_refuses_labels_that_are_no_numbers(labels):
    with pytest.raises(WrongUse, match=r"^labels must be numbers, not .*$"):
        inspect.unwrap(box_counting)(labels)  # without the tests' own checks of types


def box(low, high, d):
    return lambda rng, n: rng.uniform(low, high, (n, d))


DISTANCES = np.geomspace(1e-3, 0.1, 8)
POINTS = {
    "circle": (circle, box(-1, 1, 2), 1.0, DISTANCES),
    "line": (line, box(-1, 1, 2), 1.0, DISTANCES * 3),
    "snowflake": (snowflake, box(-0.6, 0.6, 2), KOCH, DISTANCES / 5),
    "newton": (newton, box(-1, 1, 2), NEWTON, DISTANCES / 10),
    "cantor": (cantor, box(0, 1, 1), CANTOR, DISTANCES / 1000),
    "sphere": (circle, box(-1, 1, 3), 2.0, DISTANCES),
}


@pytest.mark.parametrize("name", POINTS)
def test_uncertainty_exponent_finds_the_dimension(name):
    label_of, draw, dimension, distances = POINTS[name]
    found = uncertainty_exponent(label_of, draw, distances, pairs=40_000)
    assert found.low <= dimension <= found.high
    assert 0 < found.high - found.low < 0.1
    d = draw(np.random.default_rng(), 1).shape[1]
    assert found.value == d - found.exponent
    assert np.isin(found.distances, distances).all()


def test_the_fraction_is_that_near_a_line():
    """Within eps of it, and of these with |u_x| large enough: eps times the mean |u_x|, 2 / pi."""
    found = uncertainty_exponent(line, box(-1, 1, 2), np.array([0.4, 0.1, 0.2]), pairs=100_000)
    np.testing.assert_array_equal(found.distances, [0.1, 0.2, 0.4])
    np.testing.assert_allclose(found.fractions, found.distances * 2 / np.pi, rtol=0.05)


def test_distances_with_few_uncertain_points_are_left_out():
    distances = np.array([1e-9, 0.01, 0.02, 0.04])
    found = uncertainty_exponent(line, box(-1, 1, 2), distances)
    np.testing.assert_array_equal(found.distances, distances[1:])
    assert found.low <= 1 <= found.high


def test_without_uncertain_points_there_is_no_exponent():
    found = uncertainty_exponent(lambda p: np.zeros(len(p), int), box(0, 1, 2), DISTANCES)
    assert np.isnan(found[:4]).all()
    assert found.distances.size == found.fractions.size == 0


@pytest.mark.parametrize(("confidence", "least", "most"), [(0.5, 0.45, 0.75), (0.95, 0.92, 1)])
def test_the_interval_holds_the_dimension_as_often_as_it_says(confidence, least, most):
    """Somewhat more often: it is the wider of two."""
    distances = np.geomspace(0.02, 0.3, 6)
    found = [
        uncertainty_exponent(
            line, box(-1, 1, 2), distances, pairs=2000, seed=seed, confidence=confidence
        )
        for seed in range(200)
    ]
    assert least < np.mean([f.low <= 1 <= f.high for f in found]) < most


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distances": np.array([0.1, 0.2])}, "distances="),
        ({"distances": np.array([0.1, 0.2, 0.2])}, "distances="),
        ({"distances": np.array([0.0, 0.1, 0.2])}, "distances="),
        ({"distances": np.array([0.1, 0.2, np.inf])}, "distances="),
        ({"pairs": 9}, "pairs must be at least 10, not 9"),
        ({"confidence": 0.0}, r"confidence must be .*, not 0\.0"),
        ({"draw": lambda rng, n: np.zeros(n)}, r"draw must .*\(10000,\)"),
        ({"label_of": lambda p: np.zeros(p.shape, int)}, r"label_of must .*\(30000, 2\)"),
    ],
)
def test_uncertainty_exponent_refuses(changes, message):
    arguments = {"label_of": line, "draw": box(-1, 1, 2), "distances": DISTANCES}
    with pytest.raises(ValueError, match=message):
        uncertainty_exponent(**(arguments | changes))
