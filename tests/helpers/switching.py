"""The switching functions of a function along a series, the bases of fractional powers last."""

from walker_jax.integrators.taylor import series_of_switches


def switching_series(function, series):
    kinks, of_powers = series_of_switches(function, series)
    return [*kinks, *of_powers]
