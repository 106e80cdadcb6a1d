"""Tests compute in float64, and mixing dtypes without saying so is an error."""

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
