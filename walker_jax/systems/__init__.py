"""Return maps: systems in general, maps, hybrid systems, outcomes, and models of other machines.

The models are `wj.systems.HenonMap` and the like; docs/systems.md lists them.
"""

from walker_jax.lazy_names import load_lazily

__getattr__, __dir__, __all__ = load_lazily(globals())  # pyright: ignore[reportUnsupportedDunderAll] (from the stub)
