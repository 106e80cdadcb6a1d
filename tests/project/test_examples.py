"""The examples in docstrings of public functions: a few lines each, which run."""

import ast
import inspect
import re
from operator import attrgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import figures, kernels

PUBLIC = {name: getattr(wj, name) for name in wj.__all__} | {
    name: getattr(module, name)
    for module, names in ((kernels, kernels.__all__), (wj.fractals, wj.fractals.__all__))
    for name in names
}
FOUND = {
    name: re.findall(r"```python\n(.*?)```", inspect.getdoc(thing) or "", re.S)
    for name, thing in PUBLIC.items()
}
EXAMPLES = {name: sources[0] for name, sources in FOUND.items() if sources}


def test_public_functions_have_examples():
    functions = {name for name in PUBLIC if name[0].islower()}
    assert functions - EXAMPLES.keys() == set()


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short_and_its_calls_fit(name):
    source = EXAMPLES[name]
    assert len(source.splitlines()) <= 6
    assert re.search(rf"\b{name}\b", source)
    for call in ast.walk(ast.parse(source)):
        match call:
            case ast.Call(func=ast.Attribute() as called) if ast.unparse(called).startswith("wj."):
                function = attrgetter(ast.unparse(called).removeprefix("wj."))(wj)
                given = {one.arg: one for one in call.keywords if one.arg}
                whole = all(one.arg for one in call.keywords)  # no dictionary of arguments
                signature = inspect.signature(function)
                (signature.bind if whole else signature.bind_partial)(*call.args, **given)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {"wj": wj, "np": np, "jax": jax, "jnp": jnp, "figures": figures, **vars(kernels)}
    with jax.numpy_dtype_promotion("standard"):  # as those who copy it have
        exec(compile(EXAMPLES[name], name, "exec"), names)
