"""Fixtures of more than one file."""

import pytest

from walker_jax.kernels import object_cache, primitive


@pytest.fixture
def few_together(monkeypatch):
    """Few directions at once compile in no time; more become cells, if those are few."""
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (100, 100))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where kernels are kept: a folder that is not there yet."""
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path))
    return tmp_path / "kernels"
