"""`walker-jax explain`."""

from typing import Annotated

import numpy as np
import typer

from walker_jax.cli.answers import print_json
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Json,
    StartAt,
    check_finite,
    start_from,
    state_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.gaits.selection import require_gait
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_walker
from walker_jax.walking import explanation


@takes_walker(systems=True)
def explain(
    walker: System,
    theta: Annotated[
        float | None, typer.Option(help="Stance angle at the start, rad (default: the gait).")
    ] = None,
    thetadot: Annotated[
        float | None, typer.Option(help="Its rate at the start, rad per unit of time.")
    ] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}.")] = None,
    start: StartAt = None,
    as_json: Json = False,
) -> None:
    """Say why the stride from one start ends as it does, and whether a model fits together.

    Mode by mode: which guards rose through zero, when, and whether that counted; how near the
    others came; the least values of conditions. Lines with ! say what does not fit together.
    """
    given = {"theta": theta, "thetadot": thetadot, "phidot": phidot}
    given = {name: value for name, value in given.items() if value is not None}
    check_finite(**given)
    given = start_from(walker, start, given)
    gait = lambda: require_gait(walker, walker.section).states[0]
    found = explanation.explain(walker, np.asarray(state_from(walker, given) if given else gait()))
    if not as_json:
        print(found)
        return
    modes = [
        one._asdict() | {"rises": [rise._asdict() for rise in one.rises]} for one in found.modes
    ]
    known = found.name == "STRIDE"
    print_json(
        {
            "walker": describe_walker(walker),
            "start": found.start,
            "outcome": found.name,
            "modes": modes,
            "complaints": found.complaints,
            "state": found.state if known else None,
            "jacobian": found.jacobian if known else None,
        }
    )
