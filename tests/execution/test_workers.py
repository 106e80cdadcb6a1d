"""Worker processes on this machine."""

import signal
from functools import partial

import pytest

from walker_jax.execution.workers import open_workers


def test_only_the_first_process_gets_interrupts():
    """Ctrl-C goes to all processes of a terminal; each worker's traceback would fill a screen."""
    if not hasattr(signal, "pthread_sigmask"):
        pytest.skip("Windows has no such masks")
    blocked = partial(signal.pthread_sigmask, signal.SIG_BLOCK)
    with open_workers(1) as each:
        ((_, there),) = each(blocked, [()])
        assert signal.SIGINT not in blocked(())
    assert signal.SIGINT in there and signal.SIGINT not in blocked(())
