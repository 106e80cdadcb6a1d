"""Passive dynamic walkers: their gaits, and the basins of attraction of these.

    import walker_jax as wj

    walker = wj.SimplestWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    wj.basin(walker, grid)

Importing sets no JAX flag. Turn on float64 for numbers to quote:
`jax.config.update("jax_enable_x64", True)`.
"""

from importlib.metadata import version

from walker_jax.lazy_names import load_lazily

__version__ = version("walker-jax")
__getattr__, __dir__, __all__ = load_lazily(globals())  # pyright: ignore[reportUnsupportedDunderAll] (from the stub)
