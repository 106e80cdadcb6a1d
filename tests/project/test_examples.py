"""The examples in docstrings of public functions: a few lines each, which run."""

import ast
import inspect
import re

import pytest

import walker_jax as wj
from walker_jax import figures

WITHOUT = {"crisis_exponent", "crisis_law", "transients"}
"""Functions of these modules whose docstrings have formulas instead."""
MODULES = ("basins.", "stability.", "walking.", "entropies", "fractals", "wada")


def examples():
    """The example of each public function that has one, by its name."""
    found = {}
    for name in wj.__all__:
        text = inspect.getdoc(getattr(wj, name)) or ""
        for source in re.findall(r"```python\n(.*?)```", text, re.S):
            found[name] = source
    return found


EXAMPLES = examples()


def test_functions_of_these_modules_have_examples():
    here = {
        name
        for name in wj.__all__
        if name[0].islower()
        and getattr(wj, name).__module__.removeprefix("walker_jax.").startswith(MODULES)
    }
    assert len(here) > 30
    assert here - WITHOUT - EXAMPLES.keys() == set()


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_short_and_uses_public_names(name):
    source = EXAMPLES[name]
    ast.parse(source)
    assert f"wj.{name}" in source
    assert {*re.findall(r"\bwj\.(\w+)", source)} <= {*wj.__all__}
    assert len(source.splitlines()) <= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    exec(compile(EXAMPLES[name], name, "exec"), {"wj": wj, "figures": figures})
