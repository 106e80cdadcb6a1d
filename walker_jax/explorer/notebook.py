"""The page in a notebook."""

import atexit
import html
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from urllib.parse import urlencode

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_whole
from walker_jax.explorer.offers import FAMILY, OTHERS, flag_of, offer
from walker_jax.systems.system import System, numbers_of
from walker_jax.walkers.parameters import chosen_options

HEIGHT = 760
"""Pixels that the walker, the basin and the sliders need."""


class PageServer:
    """A server of the page in a process of its own, which ends with this process."""

    def __init__(self, options: Sequence[str], code: str) -> None:
        self.code = code
        command = [sys.executable, "-m", "walker_jax", "explore", "--no-browser", *options]
        importable = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with tempfile.TemporaryFile() as errors:
            self.process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=os.environ | importable,
            )
            assert self.process.stdout is not None
            self.link = self.process.stdout.readline().strip()
            if not self.link:
                self.process.stdout.close()
                status = self.process.wait()
                errors.seek(0)
                said = " ".join(errors.read().decode(errors="replace").split())
                raise ComputationFailed(f"the server ended with code {status}: {said}")
        atexit.register(self.close)

    @property
    def serves(self) -> bool:
        """Whether the server is still running."""
        return self.process.poll() is None

    def close(self) -> None:
        """End the server."""
        self.process.terminate()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        atexit.unregister(self.close)


started: dict[str, PageServer] = {}
"""The servers of this process's pages. Keys are "" for the package's walkers, "system" for its
other systems, and otherwise the reference of a user's class or map."""


class Explorer:
    """A page of the explorer, which a notebook shows in a frame."""

    def __init__(self, server: PageServer, state: dict[str, str | float], height: int):
        self.server, self.height = server, height
        self.link = f"{server.link.partition('#')[0]}#{urlencode(state)}"
        """Link that opens the page in any browser on this machine."""

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{html.escape(self.link)}" width="100%" height="{self.height}" '
            'style="border: 0" allow="clipboard-write" title="Explorer of basins"></iframe>'
        )

    def close(self) -> None:
        """End the server, and so all pages that it serves."""
        self.server.close()


def explore(walker: System, *, height: int = HEIGHT) -> Explorer:
    """Show the page of `walker-jax explore` in a notebook: a basin that follows sliders, and walks.

    ```python
    page = wj.explore(wj.SimplestWalker(slope=0.004))
    page  # in the last line of a cell, it shows the page
    page.close()
    ```

    A server runs in a process of its own, on this machine's loopback interface. One server serves
    all pages of the package's walkers, and another one those of its other systems. A class or a map
    of your own has its own server, until its code changes. Servers end with this process, or by
    `.close()`. The browser must be on the same machine; otherwise forward the port of `.link`.

    **Arguments:**

    - `walker`: a walker, or any other system with a `gait_region`, with numbers for parameters and
      a section of two coordinates or more. A class or a map of your own must be in a file.
    - `height`: height of the frame in pixels.

    **Returns** the page, which a notebook shows in a frame; `.link` opens it in a browser.

    Raises `ValueError` for a section of one coordinate, and for code that is in no file;
    `ComputationFailed` if the server does not start.
    """
    check_kind("walker", walker, System)
    check_whole("height", height, 100, 10_000)
    for option in chosen_options(walker):
        raise WrongUse(f"walker must be without {option}: the page knows parameters alone")
    offered = offer(walker)
    own = numbers_of(walker)
    values = {one.name: float(own[one.name]) for one in offered.parameters}
    key, options = "", []
    if offered in OTHERS.values():
        key, options = "system", ["--system", next(iter(OTHERS))]
    elif offered not in FAMILY.values():
        flag, key = flag_of(offered.kind)
        words = ((f"--{name.replace('_', '-')}", repr(value)) for name, value in values.items())
        options = [f"--{flag}", key, *(word for pair in words for word in pair)]
    server = started.get(key)
    if server is None or not server.serves or server.code != offered.code:
        if server is not None:
            server.close()
        server = started[key] = PageServer(options, offered.code)
    return Explorer(server, {"walker": offered.name} | values, height)
