"""The page in a notebook."""

import atexit
import html
import subprocess
import sys

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_whole
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import chosen_options, parameters

HEIGHT = 760
"""Pixels in which walker, basin and sliders have room."""


class Explorer:
    """A server of the page in a process of its own; a notebook shows the page in a frame."""

    def __init__(self, command: list[str], height: int):
        self.height = height
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.link = self.process.stdout.readline().strip()
        """The link that opens the page in any browser on this machine."""
        if not self.link:
            raise ComputationFailed(f"the server ended with code {self.process.wait()}")
        atexit.register(self.close)

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{html.escape(self.link)}" width="100%" height="{self.height}" '
            'style="border: 0" allow="clipboard-write" title="Explorer of basins"></iframe>'
        )

    def close(self) -> None:
        """End the server."""
        self.process.terminate()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        atexit.unregister(self.close)


def explore(walker: Walker, *, height: int = HEIGHT) -> Explorer:
    """The page of `walker-jax explore` in a notebook: a basin that follows sliders, and walks.

    A server starts in a process of its own, on this machine's loopback interface; it ends with this
    process, or by `.close()`. The notebook's browser must be on the same machine; elsewhere,
    forward the port of `.link`.

    **Arguments:**

    - `walker`: one of the package's own, with numbers for parameters.
    - `height`: of the frame, in pixels.

    **Returns** what a notebook shows as the page. Raises `ValueError` for a walker of another
    class, `ComputationFailed` where the server does not start.
    """
    check_kind("walker", walker, Walker)
    check_whole("height", height, 100, 10_000)
    names = [name for name, kind in PLANAR_WALKERS.items() if type(walker) is kind]
    if not names:
        known = ", ".join(kind.__name__ for kind in PLANAR_WALKERS.values())
        raise WrongUse(f"walker must be one of {known}, not a {type(walker).__name__}")
    for option in chosen_options(walker):
        raise WrongUse(f"walker must have no {option}, unlike {walker}")
    command = [sys.executable, "-m", "walker_jax", "explore", "--no-browser", "--walker", names[0]]
    for one in parameters(walker):
        command += [f"--{one.name.replace('_', '-')}", repr(float(getattr(walker, one.name)))]
    return Explorer(command, height)
