"""Measures of labels and of points: dimensions, basin entropy, and the Wada test.

Labels are of any kind, on a grid or at random points; nothing here knows of walkers.
"""

from walker_jax.lazy_names import load_lazily

__getattr__, __dir__, __all__ = load_lazily(globals())  # pyright: ignore[reportUnsupportedDunderAll] (from the stub)
