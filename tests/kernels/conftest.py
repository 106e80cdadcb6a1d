"""Fixtures of more than one file."""

import pytest

from walker_jax.kernels import primitive


@pytest.fixture
def few_together(monkeypatch):
    """Machine code of few directions at once compiles in no time; more are cells of their own."""
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (100, 100))
