"""How XLA compiles in the tests: quickly, as most programs run once."""

import jax

QUICK = "--xla_backend_optimization_level=0"
"""Flags that halve the time of XLA's compilation."""
if jax.__version_info__ < (0, 11):  # later versions do not know this one
    QUICK += " --xla_cpu_use_fusion_emitters=false"

AS_USERS = {"xla_backend_optimization_level": 3}
"""`compiler_options` of `jax.jit` for the code that XLA makes for users: with it, products and sums
are rounded once, which decides last digits."""
