"""Gaits as tables in notebooks."""

from typing import Any

import numpy as np

from walker_jax.checks import is_traced
from walker_jax.systems.html_tables import html_table, list_numbers


def gait_table(gait: Any) -> str | None:
    """Return a gait's states, step times and multipliers; None for several gaits."""
    if is_traced(gait) or np.ndim(gait.found):
        return None
    kind = ("Stable" if gait.stable else "Unstable") + " gait" if gait.found else "No gait found"
    columns = zip(gait.states, gait.step_times, strict=True)
    rows = [(k, list_numbers(state), list_numbers(time)) for k, (state, time) in enumerate(columns)]
    rows += [("multipliers", list_numbers(gait.multipliers), "")]
    rows += [] if gait.found else [("residual", list_numbers(gait.residual), "")]
    return html_table(f"{kind}, period {len(gait.states)}", ("stride", "state", "time"), rows)
