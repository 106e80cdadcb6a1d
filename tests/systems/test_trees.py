"""Parameters of any shape: their names, ranks, words, files and refusals."""

import json
import pickle
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float
from networks import NetworkWalker, Pushed, network, pushed

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.walker_options import read_tree
from walker_jax.fingerprints import code_fingerprint
from walker_jax.proofs.provable import check_provable
from walker_jax.systems.system import arrays_of, code_of, numbers_of
from walker_jax.systems.trees import LARGEST, is_many, select
from walker_jax.walkers.parameters import (
    Parameter,
    attributes_of,
    check_parameter,
    describe_in_words,
    describe_walker,
    parameters,
    trees,
    value_of,
    with_parameter,
)

LEAVES = {
    "policy.layers[0].weight": (4, 2),
    "policy.layers[0].bias": (4,),
    "policy.layers[1].weight": (1, 4),
    "policy.layers[1].bias": (1,),
}


class Curve(wj.System):
    """A map whose steps are a cubic with these coefficients."""

    coefficients: Float[Any, " 4"]
    shift: float | Any = 0.0
    section = ("x",)

    def advance(self, x):
        return jnp.polyval(self.coefficients, x) + self.shift, wj.Outcome.STRIDE, 1.0


class Net(eqx.Module):
    """A network of a user's own, with an option."""

    weight: Any
    steep: float = eqx.field(static=True, default=1.0)

    def __call__(self, x):
        return jnp.tanh(self.steep * self.weight @ x)


def test_leaves_have_the_names_of_their_paths():
    walker = NetworkWalker(0.004)
    assert {name: leaf.shape for name, leaf in arrays_of(walker).items()} == LEAVES
    assert [*numbers_of(walker)] == ["slope"]
    machine = pushed()
    assert [*arrays_of(machine)] == ['force["powers"]', "order", "pulls"]
    assert numbers_of(machine) == {'force["gain"]': 2.0}
    made = wj.Map(
        lambda x, net, a: a * net(x), ("x", "y"), parameters={"net": Net(np.eye(2)), "a": 2}
    )
    assert [*arrays_of(made)] == ["net.weight"] and [*numbers_of(made)] == ["a"]
    np.testing.assert_allclose(wj.stride(made, [0.3, -1.0]).state, 2 * np.tanh([0.3, -1.0]))


def test_repr_and_tables_show_trees_by_their_size():
    walker = NetworkWalker(0.004)
    assert repr(walker) == "NetworkWalker(slope=0.004, policy=MLP of 17 numbers)"
    table = walker._repr_html_()
    assert "<td>policy.layers[0].weight</td><td>f64[4,2]</td>" in table
    assert "<td>policy.activation</td><td>tanh</td>" in table
    assert "pulls=f64[2]" in repr(pushed()) and "of springs" in pushed()._repr_html_()
    assert describe_in_words(walker).startswith(
        "NetworkWalker, slope 0.004, policy.layers[0].weight of 8 numbers"
    )


def test_requests_and_data_sets_hold_arrays_or_their_hashes():
    walker = NetworkWalker(0.004)
    first = np.asarray(walker.policy.layers[0].weight)
    about, attributes = describe_walker(walker), attributes_of(walker)
    assert json.loads(json.dumps(about))["policy.layers[0].weight"] == first.tolist()
    assert attributes["walker_policy.layers[0].weight"] == first.ravel().tolist()
    assert attributes["walker_policy.layers[0].weight_shape"] == [4, 2]
    assert about["policy.activation"] == attributes["walker_policy.activation"] == "tanh"
    assert attributes["code"]
    coefficients = np.linspace(0, 1, LARGEST + 1)
    large = describe_walker(Curve(coefficients))["coefficients"]
    changed = describe_walker(Curve(np.nextafter(coefficients, 2)))["coefficients"]
    assert large.startswith("sha256 ") and large != changed and large.endswith("(4097,)")
    assert attributes_of(Curve(coefficients))["walker_coefficients"] == large


def test_structures_count_as_code():
    def fingerprint(system):
        return code_fingerprint(type(system), code_of(system))

    def with_net(**options):
        return wj.Map(np.tanh, ("x",), parameters={"net": Net(np.ones((1, 1)), **options)})

    walker = NetworkWalker(0.004)
    other = eqx.nn.MLP(2, 1, 4, 1, activation=jax.nn.softplus, key=jax.random.key(0))
    assert fingerprint(walker) == fingerprint(NetworkWalker(0.005, policy=network(3)))
    assert fingerprint(walker) != fingerprint(NetworkWalker(0.004, policy=other))
    assert fingerprint(with_net()) == fingerprint(with_net(steep=1.0))
    assert fingerprint(with_net()) != fingerprint(with_net(steep=2.0))
    assert code_fingerprint(wj.systems.HenonMap, code_of(wj.systems.HenonMap())) == ""


@pytest.mark.parametrize("system", [NetworkWalker(0.004), pushed(), Curve(np.arange(4.0))])
def test_pickles(system):
    again = pickle.loads(pickle.dumps(system))
    assert jax.tree.structure(again) == jax.tree.structure(system)
    assert eqx.tree_equal(again, system) and again.array_ranks == system.array_ranks


def test_ranks_come_from_the_class_or_from_vmap():
    keys = jax.random.split(jax.random.key(0), 3)
    policies = eqx.filter_vmap(lambda key: eqx.nn.MLP(2, 1, 4, 1, jnp.tanh, key=key))(keys)
    by_default = NetworkWalker(0.004, policy=policies)
    by_vmap = eqx.filter_vmap(lambda one: NetworkWalker(0.004, policy=one))(policies)
    assert is_many(by_default) and is_many(by_vmap)
    assert not is_many(select(by_default, 1)) and not is_many(NetworkWalker(0.004))
    # A deeper network, whose leaves no default knows: one walker, or many by vmap.
    deep = lambda key: NetworkWalker(0.004, policy=eqx.nn.MLP(2, 1, 3, 2, jnp.tanh, key=key))
    assert not is_many(deep(keys[0])) and is_many(eqx.filter_vmap(deep)(keys))
    # jaxtyping tells a rank, `float` that of a number.
    assert not is_many(Curve(np.zeros(4))) and is_many(Curve(np.zeros((3, 4))))
    assert is_many(Curve(np.zeros(4), np.zeros(2)))
    # A Parameter tells a shape; nothing is known of a dictionary or a table without default.
    assert not is_many(pushed()) and is_many(jax.vmap(pushed)(jnp.ones(3)))


def test_a_parameter_with_a_span_is_one_number():
    """Without an annotation of its shape too; any other undescribed field has its array's rank."""

    class Spanned(wj.System):
        growth: jax.Array
        shifts: jax.Array
        section, spans = ("x",), {"growth": (1.0, 2.0)}

        def advance(self, x):
            return self.growth * x + jnp.sum(self.shifts), wj.Outcome.STRIDE, 1.0

    values = jnp.array([1.5, 2.5])
    assert dict(Spanned(values, values).array_ranks) == {"shifts": 1}
    ends = wj.strides(Spanned(values, values), np.ones((2, 1)))
    np.testing.assert_array_equal(ends.state[:, 0], [5.5, 6.5])


def test_many_systems_are_those_one_by_one():
    coefficients = np.array([[0.1, 0.2, -0.3, 0.5], [1.0, 0.0, 0.5, 0.0], [0.0, 0.0, 2.0, 1.0]])
    many, xs = Curve(coefficients, 0.25), np.array([[0.3], [0.5], [-0.5]])
    expected = [np.polyval(row, x) + 0.25 for row, x in zip(coefficients, xs[:, 0], strict=True)]
    np.testing.assert_allclose(wj.strides(many, xs).state[:, 0], expected, rtol=1e-15)
    axes = jax.tree.map(lambda leaf: 0 if np.ndim(leaf) else None, many)
    mapped = jax.vmap(wj.stride, in_axes=(axes, 0))(many, xs)
    np.testing.assert_array_equal(mapped.state[:, 0], wj.strides(many, xs).state[:, 0])


def test_one_number_of_an_array_has_a_name():
    walker = NetworkWalker(0.004)
    name = "policy.layers[0].weight[1, 0]"
    there = with_parameter(walker, name, 0.25)
    assert value_of(there, name) == there.policy.layers[0].weight[1, 0] == 0.25
    rest = np.asarray(walker.policy.layers[0].weight).copy()
    rest[1, 0] = 0.25
    np.testing.assert_array_equal(there.policy.layers[0].weight, rest)
    many = with_parameter(walker, name, np.array([0.25, 0.5]))
    assert is_many(many) and eqx.tree_equal(select(many, 0).policy, there.policy)


def test_parameters_of_a_class_are_numbers_and_trees():
    assert [one.name for one in parameters(NetworkWalker)] == ["slope"]
    assert [one.name for one in trees(NetworkWalker)] == ["policy"]
    assert [one.name for one in trees(Pushed)] == ["force", "pulls"]
    (shift,) = parameters(Curve)
    assert shift.name == "shift" and [one.name for one in trees(Curve)] == ["coefficients"]


def test_functions_put_in_later_are_static_too():
    x = jnp.array([0.2, -0.2])
    walker = NetworkWalker(0.009, policy=network(1))
    replaced = eqx.tree_at(lambda one: one.policy, NetworkWalker(0.009), network(1))
    assert any(map(callable, jax.tree.leaves(replaced)))
    np.testing.assert_array_equal(wj.stride(replaced, x).state, wj.stride(walker, x).state)


BOUNDED = Parameter("pulls", "", "", low=0.0, shape=(2,))


def test_refusals():
    wide, other = Curve(np.zeros((2, 4))), " must be real numbers or a function, not "
    wrong = {
        "coefficients must be an array of rank 1, not of shape (2, 4)": lambda: wj.stride(
            wide, [0.1]
        ),
        "coefficients must be an array of rank 1 or 3, not of shape (2, 4)": lambda: wj.strides(
            wide, np.zeros((3, 1))
        ),
        f"force[\"kind\"] of Pushed{other}'hard': a static field may hold words": lambda: Pushed(
            {"kind": "hard"}, np.arange(3)
        ),
        f'force["on"] of Pushed{other}True: a static field may hold words': lambda: Pushed(
            {"on": True}, np.arange(3)
        ),
        f"order of Pushed{other}1j: a static field may hold words": lambda: Pushed({}, 1j),
        "pulls must be real numbers of shape (2,), not [1.0]": lambda: BOUNDED.convert([1.0]),
        "pulls must be finite and above 0, not -2.0": lambda: BOUNDED.convert([1.0, -2.0]),
        "parameter must be one of the walker's, slope, policy.layers[0].weight[0, 0], ..., not "
        "'policy.layers[0].weight[4, 0]'": lambda: check_parameter(
            NetworkWalker(0.009), "policy.layers[0].weight[4, 0]"
        ),
        "--force needs a default of force in its class, to tell the shapes in a file": lambda: (
            read_tree(trees(Pushed)[0], None)
        ),
        "walker must have single numbers for parameters, not the array policy.layers[0].weight": (
            lambda: check_provable(NetworkWalker(0.009))
        ),
        "gains must name single numbers of the walker, not the array of policy.layers[0].bias[0]": (
            lambda: wj.Feedback(
                NetworkWalker(0.009), [0.2, -0.2], {"policy.layers[0].bias[0]": (1.0, 0.0)}
            )
        ),
    }
    for message, use in wrong.items():
        with pytest.raises(WrongUse) as error:
            use()
        assert str(error.value) == message


def test_areas_and_optima_follow_numbers_of_arrays(monkeypatch):
    """The basin of a contraction is where it is feasible, an ellipse's area of pi a b."""

    def inside(x, axes):
        return 1 - jnp.sum((x / axes) ** 2)

    axes = jnp.array([0.8, 0.5])
    system = wj.Map(lambda x, axes: x / 2, ("x", "y"), parameters={"axes": axes}, feasible=inside)
    grid = wj.Grid.plain(x=(-1, 1, 40), y=(-1, 1, 40))
    found = wj.measure(system, "area", ("axes[0]", "axes[1]"), grid=grid, levels=3)
    np.testing.assert_allclose(found.gradient, np.pi * np.array([0.5, 0.8]), rtol=2e-3)
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    best = wj.optimise(
        system, {"axes[1]": (0.2, 0.7)}, grid=grid, starts=1, levels=0, progress=False
    )
    np.testing.assert_allclose(best["optimum"].item(), 0.7, rtol=1e-6)
