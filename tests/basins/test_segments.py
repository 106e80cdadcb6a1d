"""The search along segments for a change of label, against places known in closed form."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.segments import Segments, close_in, narrow


def test_many_segments_close_in_on_a_circle_at_once():
    """Rays from the middle leave the unit disc at length 1; 2^-20 of each is left."""
    angles = np.linspace(0, 6, 40)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = np.stack([0 * rays, 3 * rays], axis=1)
    outside = lambda x: np.hypot(*x.T) > 1
    by_ones = by_fives = Segments(ends, np.tile([False, True], (40, 1)))
    for _ in range(20):
        by_ones = narrow(outside, by_ones)
    for _ in range(4):
        by_fives = narrow(outside, by_fives, 5)
    np.testing.assert_array_equal(by_ones.ends, by_fives.ends)  # the same points, to the last bit
    lengths = np.linalg.norm(by_ones.ends, axis=2)
    assert (lengths[:, 0] <= 1).all() and (lengths[:, 1] > 1).all()
    np.testing.assert_allclose(np.diff(lengths), 3 / 2**20, rtol=1e-9)
    none = narrow(outside, by_ones.part(slice(0)))
    assert none.ends.shape == (0, 2, 2)


def test_a_third_label_is_told_and_a_direct_change_preferred():
    three = lambda x: np.digitize(x[:, 0], [0.3, 0.31])
    found = close_in(three, np.array([[0.0], [1.0]]), 1e-13, 5)
    assert found.labels.tolist() == [[0, 1]]
    assert found.ends[0, 0, 0] == pytest.approx(0.3, abs=1e-12)
    # 0 to 1 to 0 to 2: the last change is a direct one
    several = lambda x: np.array([0, 1, 0, 2])[np.digitize(x[:, 0], [0.3, 0.5, 0.8])]
    found = close_in(several, np.array([[0.0], [1.0]]), 1e-13, 5)
    assert found.labels.tolist() == [[0, 2]]
    assert found.ends[0, 0, 0] == pytest.approx(0.8, abs=1e-12)
    with pytest.raises(wj.ComputationFailed, match="both ends have one label"):
        close_in(three, np.array([[0.0], [0.2]]), 1e-13, 5)


@pytest.mark.parametrize("halvings", [1, 5])
def test_the_last_digit_is_found(halvings):
    """Neighbouring numbers of float64 around 1/3 and, in two coordinates, around pi and e."""
    low, high = close_in(lambda x: x[:, 0] > 1 / 3, np.array([[0.0], [1.0]]), 0.0, halvings).ends[0]
    assert low == 1 / 3 and high == np.nextafter(1 / 3, 1)
    beyond = lambda x: x @ [1.0, 1.0] > np.pi + np.e
    pair = close_in(beyond, np.array([[3.0, 2.0], [4.0, 3.0]]), 0.0, halvings).ends[0]
    assert beyond(pair).tolist() == [False, True]
    assert (np.abs(np.diff(pair, axis=0)) <= np.spacing(pair[0])).all()
