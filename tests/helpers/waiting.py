"""A line that names the tests a run waits for, when nothing has been printed for a while.

With `-n 0` pytest hides it, as anything that is printed during a test.
"""

import threading
import time
from typing import Any

PATIENCE = 20.0
"""Seconds without a result after which the line is printed; then again after as many."""


class Waiting:
    """A plugin of pytest's first process, which hears of the tests in all others."""

    def __init__(self, reporter: Any):
        self.reporter = reporter
        self.running: dict[str, None] = {}
        self.heard = time.monotonic()
        self.over = threading.Event()

    def start(self) -> None:
        threading.Thread(target=self.watch, daemon=True).start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.running[nodeid] = None

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.running.pop(nodeid, None)
        self.heard = time.monotonic()

    def pytest_sessionfinish(self) -> None:
        self.over.set()

    def watch(self) -> None:
        while not self.over.wait(PATIENCE / 4):
            self.tell()

    def tell(self) -> None:
        """Print the line, if it is time."""
        if self.running and time.monotonic() - self.heard >= PATIENCE:
            self.heard = time.monotonic()
            self.reporter.write_line(f"\nwaiting for {', '.join(self.running)}")
