"""Data sets in NetCDF's oldest format, which SciPy alone writes: no list of words, 32 bits."""

import inspect
from operator import attrgetter

import numpy as np
import pytest
import xarray as xr
from small_calls import CALLS, MAP, PLANE

import walker_jax as wj
from walker_jax.basins.schema import request_of
from walker_jax.systems.outcomes import failures_of, join_names, names_in

RETURNING = [
    name
    for name in CALLS
    if "Dataset" in str(inspect.signature(attrgetter(name.split()[0])(wj)).return_annotation)
    and name != "steps_to_fall"  # of walks, which are no data set
]
"""Public functions that return a data set."""


SLOW = {"boundary", "steps_to_fall by cells", "prove_basin", "robustness"}
SLOW |= {"robustness over values", "bifurcation_diagram"}
"""Slow to compile, or as good as another one."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.slow] if one in SLOW else []) for one in RETURNING],
)
def test_every_data_set_goes_to_netcdf_by_scipy_alone(tmp_path, name):
    data = CALLS[name]()
    data.to_netcdf(tmp_path / "a.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "a.nc", engine="scipy") as there:
        xr.testing.assert_equal(there, data)
        assert there.attrs.keys() == data.attrs.keys()
        for key, value in data.attrs.items():
            np.testing.assert_array_equal(there.attrs[key], value)


def test_names_are_read_from_one_string_or_a_list():
    attributes = {"section": "x, y", "older": ["x", "y"], "one": "x", "array": np.array(["x", "y"])}
    data = xr.Dataset(attrs=attributes)
    assert names_in(data, "section") == names_in(data, "older") == ("x", "y")
    assert names_in(data, "array") == ("x", "y") and names_in(data, "one") == ("x",)
    assert names_in(data, "none") == failures_of(data) == ()
    for names in (("x",), ("x", "y"), ("the end of the range", "the curve closes")):
        assert names_in(xr.Dataset(attrs={"all": join_names(names)}), "all") == names


def test_a_request_is_that_of_before():
    """Of a store begun when the section was a list: the same command still finds its result."""
    data = CALLS["basin"]()
    older = data.assign_attrs(section=["x", "y"], failures=["sticks"])
    newer = data.assign_attrs(section="x, y", failures="sticks")
    assert request_of(older, PLANE) == request_of(newer, PLANE)
    assert names_in(data, "section") == MAP.section
