"""Tables in notebooks say what the repr says, in words."""

import xml.etree.ElementTree as ElementTree

import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj

WALKER, X, FALL = wj.SimplestWalker(0.009), [0.2003, -0.1998], [0.3, -0.1]


def cells(value) -> tuple[str, list[list[str]]]:
    """Caption and rows, without the head, of a table; HTML this plain is XML too."""
    caption, _, *rows = ElementTree.fromstring(value._repr_html_())
    return caption.text or "", [[cell.text or "" for cell in row] for row in rows]


def test_parameters_are_listed_with_units_and_meanings():
    assert cells(WALKER) == ("SimplestWalker", [["slope", "0.009", "rad", "of the ground"]])
    name, rows = cells(wj.systems.HenonMap())
    assert name == "HenonMap" and rows[0] == ["a", "1.4", "", "of the square"]
    assert cells(wj.Map(lambda x, a: a * x, ("x",), parameters={"a": 0.5}))[1] == [
        ["a", "0.5", "", ""]
    ]


def test_words_are_escaped():
    class Named(wj.systems.HenonMap):
        def label(self):
            return "a < b & <script>"

    assert cells(Named())[0] == "a < b & <script>"
    assert "<script>" not in Named()._repr_html_()


def test_a_stride_is_told_in_words():
    made = wj.stride(WALKER, X)
    (outcome, state, time), caption = cells(made)[1], cells(made)[0]
    assert caption == "Stride" and outcome == ["outcome", "walks"]
    np.testing.assert_allclose([float(x) for x in state[1].split(", ")], made.state, rtol=1e-7)
    np.testing.assert_allclose(float(time[1]), made.time, rtol=1e-7)
    assert cells(wj.stride(WALKER, FALL)) == ("Stride", [["outcome", "falls backward"]])
    assert cells(wj.strides(WALKER, [X, FALL, X])) == (
        "3 strides",
        [["walks", "2"], ["falls backward", "1"]],
    )


def test_a_walk_is_told_up_to_its_failure():
    caption, rows = cells(wj.walk(WALKER, X, 2))
    assert caption == "Walk" and [row[3] for row in rows] == ["walks", "walks"]
    assert rows[0][:2] == ["0", "0.2003, -0.1998"]
    fallen = cells(wj.walk(WALKER, FALL, 5))[1]
    assert [row[2:] for row in fallen] == [["nan", "falls backward"]]


def test_a_gait_is_told_with_its_states_multipliers_and_times():
    gait = wj.find_gait(WALKER)
    caption, (state, multipliers) = cells(gait)
    assert caption == "Stable gait, period 1"
    numbers = lambda text: [complex(one) for one in text.split(", ")]
    np.testing.assert_allclose(numbers(state[1]), gait.states[0], rtol=1e-7)
    np.testing.assert_allclose(numbers(state[2]), gait.step_times, rtol=1e-7)
    np.testing.assert_allclose(numbers(multipliers[1]), gait.multipliers, rtol=1e-7)
    unstable = cells(gait._replace(stable=np.array(False)))
    assert unstable[0] == "Unstable gait, period 1"
    lost = gait._replace(found=np.array(False), residual=np.array(0.25))
    assert cells(lost)[0] == "No gait found, period 1" and cells(lost)[1][-1][:2] == [
        "residual",
        "0.25",
    ]


def test_several_walkers_and_traced_values_have_the_repr_alone():
    many = jax.vmap(wj.SimplestWalker)(jnp.array([0.004, 0.009]))
    assert cells(many)[1] == [["slope", "f64[2]", "rad", "of the ground"]]
    walks = jax.vmap(lambda walker: wj.walk(walker, jnp.array(X), 1))(many)
    gait = wj.find_gait(WALKER)
    assert walks._repr_html_() is None
    assert jax.tree.map(lambda x: np.asarray(x)[None], gait)._repr_html_() is None
    shown = []

    @jax.jit
    def traced(slope):
        walker = wj.SimplestWalker(slope)
        made = wj.stride(walker, jnp.array(X))
        shown.extend([cells(walker)[1][0][1], made._repr_html_()])
        shown.append(wj.walk(walker, jnp.array(X), 1)._repr_html_())
        shown.append(gait._replace(found=made.outcome == 0)._repr_html_())
        return made.time

    traced(jnp.asarray(np.float64(0.009)))
    assert shown == ["f64[]", None, None, None]
