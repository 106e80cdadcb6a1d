"""The public names; `__init__.py` loads each from here on its first use."""

from walker_jax.fractals.dimensions import box_counting as box_counting
from walker_jax.fractals.dimensions import information_dimension as information_dimension
from walker_jax.fractals.dimensions import uncertainty_exponent as uncertainty_exponent
from walker_jax.fractals.entropies import basin_entropy as basin_entropy
from walker_jax.fractals.wada import merge_regions as merge_regions

__all__: list[str]
