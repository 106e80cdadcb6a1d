"""The page in a notebook."""

import atexit
import html
import subprocess
import sys
import tempfile
from urllib.parse import urlencode

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_whole
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import chosen_options, parameters

HEIGHT = 760
"""Pixels in which walker, basin and sliders have room."""


class PageServer:
    """A server of the page in a process of its own, which ends with this one."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "walker_jax", "explore", "--no-browser"]
        with tempfile.TemporaryFile() as errors:
            self.process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, text=True
            )
            assert self.process.stdout is not None
            self.link = self.process.stdout.readline().strip()
            if not self.link:
                self.process.stdout.close()
                code = self.process.wait()
                errors.seek(0)
                said = " ".join(errors.read().decode(errors="replace").split())
                raise ComputationFailed(f"the server ended with code {code}: {said}")
        atexit.register(self.close)

    @property
    def serves(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        atexit.unregister(self.close)


started: list[PageServer] = []
"""The server of all pages of this process, once there is one."""


class Explorer:
    """A page, as a notebook shows it: in a frame."""

    def __init__(self, server: PageServer, state: dict[str, str | float], height: int):
        self.server, self.height = server, height
        self.link = f"{server.link.partition('#')[0]}#{urlencode(state)}"
        """The link that opens the page in any browser on this machine."""

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{html.escape(self.link)}" width="100%" height="{self.height}" '
            'style="border: 0" allow="clipboard-write" title="Explorer of basins"></iframe>'
        )

    def close(self) -> None:
        """End the server, and with it all pages of this process."""
        self.server.close()


def explore(walker: Walker, *, height: int = HEIGHT) -> Explorer:
    """The page of `walker-jax explore` in a notebook: a basin that follows sliders, and walks.

    One server, in a process of its own on this machine's loopback interface, serves all pages of
    this process; it ends with this process, or by `.close()`. The notebook's browser must be on the
    same machine; elsewhere, forward the port of `.link`.

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
    values = {one.name: float(getattr(walker, one.name)) for one in parameters(walker)}
    if not (started and started[0].serves):
        started[:] = [PageServer()]
    return Explorer(started[0], {"walker": names[0]} | values, height)
