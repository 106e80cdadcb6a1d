"""Examples in the docstrings of public functions fit what there is, and run."""

import ast
import inspect
import re
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import kernels

PUBLIC = {name: getattr(wj, name) for name in wj.__all__} | {
    name: getattr(kernels, name) for name in ("kernel", "why_not")
}


def example_of(thing) -> str:
    """The first indented lines of a docstring; empty if there are none."""
    found = re.search(r"\n\n((?: {4}[^\n]*\n|\n)+)", inspect.getdoc(thing) or "")
    return textwrap.dedent(found[1]) if found else ""


EXAMPLES = {
    name: source
    for name, thing in PUBLIC.items()
    if re.search(rf"\b{name}\b", source := example_of(thing))
}


def test_main_functions_have_an_example():
    assert {"find_gait", "continue_gait", "optimise", "viable", "kernel"} <= set(EXAMPLES)
    assert len(EXAMPLES) >= 20


@pytest.mark.parametrize("name", EXAMPLES)
def test_calls_of_examples_fit_their_functions(name):
    for call in ast.walk(ast.parse(EXAMPLES[name])):
        match call:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="wj"), attr=called)):
                given = {one.arg: one for one in call.keywords if one.arg}
                inspect.signature(getattr(wj, called)).bind(*call.args, **given)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run(name):
    names = {"wj": wj, "np": np, "jax": jax, "jnp": jnp, **vars(kernels)}
    with jax.numpy_dtype_promotion("standard"):  # as those who copy it have
        exec(compile(EXAMPLES[name], name, "exec"), names)
