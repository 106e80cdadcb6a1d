"""Names of the library that commands use, each loaded on its first use: help needs no JAX.

The stub `library.pyi` lists them.
"""

from walker_jax.lazy_names import load_lazily

__getattr__, __dir__, __all__ = load_lazily(globals())
