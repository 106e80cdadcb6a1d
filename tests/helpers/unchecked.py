"""The package without the checks of signatures that the tests add, as users have it."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from jaxtyping import config


@contextmanager
def unchecked() -> Iterator[None]:
    """Signatures are not checked, and warnings are no errors."""
    assert not config.jaxtyping_disable
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        config.update("jaxtyping_disable", True)
        try:
            yield
        finally:
            config.update("jaxtyping_disable", False)
