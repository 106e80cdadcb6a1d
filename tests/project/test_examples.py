"""The examples in docstrings of public functions: a few lines each, which run."""

import ast
import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import figures, kernels

PUBLIC = {name: getattr(wj, name) for name in wj.__all__} | {
    name: getattr(kernels, name) for name in ("kernel", "why_not")
}
FOUND = {
    name: re.findall(r"```python\n(.*?)```", inspect.getdoc(thing) or "", re.S)
    for name, thing in PUBLIC.items()
}
EXAMPLES = {name: sources[0] for name, sources in FOUND.items() if sources}
WITHOUT = {"margins_of_many"}
"""Functions beside others of the same use, which have the example."""


def test_public_functions_have_examples():
    functions = {name for name in PUBLIC if name[0].islower()}
    assert functions - EXAMPLES.keys() == WITHOUT


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short_and_its_calls_fit(name):
    source = EXAMPLES[name]
    assert len(source.splitlines()) <= 6
    assert re.search(rf"\b{name}\b", source)
    for call in ast.walk(ast.parse(source)):
        match call:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="wj"), attr=called)):
                given = {one.arg: one for one in call.keywords if one.arg}
                inspect.signature(getattr(wj, called)).bind(*call.args, **given)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {"wj": wj, "np": np, "jax": jax, "jnp": jnp, "figures": figures, **vars(kernels)}
    with jax.numpy_dtype_promotion("standard"):  # as those who copy it have
        exec(compile(EXAMPLES[name], name, "exec"), names)
