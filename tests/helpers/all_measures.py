"""All measures of a gait that have names, with their derivatives."""

from collections.abc import Sequence

import walker_jax as wj
from walker_jax.design.measures import Measure, measures_known
from walker_jax.gaits.search import search_gait


def all_measures(
    walker: wj.System, parameters: Sequence[str] = (), gait: wj.Gait | None = None
) -> dict[str, Measure]:
    gait = search_gait(walker) if gait is None else gait
    return {name: wj.measure(walker, name, parameters, gait) for name in measures_known(walker)}
