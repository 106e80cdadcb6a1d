"""The picture of a most probable fall: its words, each of which can be left out."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import figures
from walker_jax.stability.probable_falls import ProbableFall

STATES = np.array([[0.15, 0.3, -0.15, -0.01], [0.16, 0.32, -0.14, -0.01], [0.2, 0.4, -0.2, 0.0]])
PUSHES = np.array([[-1e-3, 0, 0.1], [2e-3, 0, 0]])
ACTIONS = np.array([14.0, 12.5])
FALL = ProbableFall(12.5, PUSHES, STATES, wj.Outcome.FORWARD, 2, ACTIONS, 1.0, 1e-12)


def words_of(**style):
    """The title of the figure, the titles of its panels, their axes' names, and their legends."""
    figure = figures.probable_fall(FALL, wj.SimplestWalker(0.009), **style)
    panels = figure.axes
    return (
        figure.get_suptitle(),
        [ax.get_title(loc="left") for ax in panels],
        [ax.get_xlabel() for ax in panels]
        + [child.get_xlabel() for child in panels[-1].child_axes],
        [ax.get_legend() is not None for ax in panels],
    )


def test_the_words_of_a_fall_can_be_left_out():
    title, panels, names, legends = words_of()
    assert title.startswith("SimplestWalker") and "falls forward after 2 strides" in title
    assert all(panels) and all(names) and legends == [True, False, True, True]
    assert words_of(title=False) == ("", panels, names, legends)
    assert words_of(title="Mine") == ("Mine", panels, names, legends)
    assert words_of(subtitle=False)[0] == title.split("\n")[0]
    assert not any(words_of(legend=False)[3]) and not any(words_of(labels=False)[2])
    with pytest.raises(ValueError, match="style must be of title, subtitle, legend, labels, not t"):
        figures.probable_fall(FALL, **{"tilte": True})  # pyright: ignore[reportArgumentType] (misspelt)


def test_a_title_of_ones_own_stays_in_print():
    with figures.for_print():
        assert words_of()[0] == "" and words_of(title="Mine")[0] == "Mine"
