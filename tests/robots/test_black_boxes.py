"""Black boxes: maps by NumPy, whose basins are known."""

import numpy as np
import pytest
from unchecked import unchecked

import walker_jax as wj

pytestmark = pytest.mark.filterwarnings("ignore:.*black box", "ignore:.*has no kernel")
CENTRE, RADIUS, EDGE = np.array([0.5, 0.3]), 0.05, 2.0
"""A pocket of falls, and the edge beyond which all falls."""
TURN = np.array([[0.5, 0.2], [-0.2, 0.5]])
calls: list[int] = []


def spiral(starts):
    """A linear map to the origin, but for the pocket and the edge."""
    calls.append(len(starts))
    made = np.hypot(*(starts - CENTRE).T) > RADIUS
    return starts @ TURN.T, made & (np.hypot(*starts.T) < EDGE)


@pytest.fixture(scope="module")
def box():
    return wj.BlackBox(spiral, ("x", "y"))


def test_many_starts_are_one_call(box):
    starts = np.array([[0.1, 0.2], [0.5, 0.3], [3.0, 0.0]])
    calls.clear()
    strides = wj.strides(box, starts)
    assert len(calls) == 1
    walks, falls = wj.Outcome.STRIDE, wj.Outcome.FORWARD
    assert strides.outcome.tolist() == [walks, falls, falls]
    assert np.array_equal(strides.state[0], starts[0] @ TURN.T)


def test_gaits_have_multipliers_by_differences(box):
    gait = wj.find_gait(box, [0.1, 0.1])
    assert gait.stable and np.abs(gait.states).max() < 1e-9
    known = np.linalg.eigvals(TURN)
    assert np.abs(np.sort_complex(gait.multipliers) - np.sort_complex(known)).max() < 1e-9


def test_an_audit_meets_the_pocket_if_samples_do(box):
    """Its share of the disc is RADIUS^2; its nearest point is known."""
    found = wj.audit(box, [0.0, 0.0], 1.0, samples=4000, seed=1)
    expected = 1 - RADIUS**2
    assert found.low < expected < found.high and found.returned < 1
    nearest = np.hypot(*CENTRE) - RADIUS
    assert nearest < found.least < nearest + 0.02
    assert np.hypot(*found.disturbance) == pytest.approx(found.least)
    assert np.hypot(*(found.disturbance - CENTRE)) == pytest.approx(RADIUS, abs=1e-6)
    assert found.pockets == round(4000 * (1 - found.returned)) > 0
    few = wj.audit(box, [0.0, 0.0], 1.0, samples=20)
    assert few.returned == 1 and few.least == np.inf and np.isnan(few.disturbance).all()
    assert few.low < expected, "that none fell says little"


def test_an_audit_finds_the_edge_in_its_units(box):
    found = wj.audit(box, [0.0, 0.0], 4.0, scale=[1.0, 0.5], samples=2000, seed=2)
    assert found.disturbance[1] != 0 and found.pockets < 2000 * (1 - found.returned) / 4
    assert found.least > np.hypot(0.5, 0.6) - 2 * RADIUS


def test_wrong_uses_of_black_boxes_are_told(box):
    wrong = wj.BlackBox(lambda starts: (starts[:1], [True]), ("x", "y"))
    for message, use in {
        "strides must be a function": lambda: wj.BlackBox(3, ("x",)),  # pyright: ignore[reportArgumentType]
        "step must be positive and finite, not 0": lambda: wj.BlackBox(spiral, ("x", "y"), step=0),
        "disturbances must be positive and finite": lambda: wj.audit(box, [0, 0], -1.0),
        "state must be 2 finite numbers": lambda: wj.audit(box, [0, 0, 0], 1.0),
        "scale must be positive": lambda: wj.audit(box, [0, 0], 1.0, scale=[1, 0]),
        "state must be of a gait": lambda: wj.audit(box, CENTRE, 1.0),
        "strides must return states of shape": lambda: wj.audit(wrong, [0, 0], 1.0, samples=3),
    }.items():
        with unchecked(), pytest.raises(ValueError, match=message):
            use()
