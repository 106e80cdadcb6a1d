"""Units of walkers in SI: by dimensional analysis, and by a page of the documentation."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.storage.schema import KINDS, kind_of
from walker_jax.systems.parameter import Parameter
from walker_jax.walkers.parameter_table import DESCRIBED
from walker_jax.walkers.units import is_unit, powers_of, si_unit, units_of, with_units

PAGE = Path(__file__).parents[2] / "docs" / "si-units.md"
UNITS = wj.Units(length=0.8, mass=10.0, gravity=9.81)
NO_UNITS = {"", "strides", "1/stride", "cells", "s"}
"""Units of counts, and of times of a computer."""


@pytest.mark.parametrize(
    ("unit", "size", "named"),
    [
        ("√(l/g)", (0.8 / 9.81) ** 0.5, "s"),
        ("unit of time", (0.8 / 9.81) ** 0.5, "s"),
        ("√(gl)", (0.8 * 9.81) ** 0.5, "m/s"),
        ("rad/√(l/g)", (9.81 / 0.8) ** 0.5, "rad/s"),
        ("rad²/√(l/g)", (9.81 / 0.8) ** 0.5, "rad²/s"),
        ("rad³·g/l", 9.81 / 0.8, "rad³/s²"),
        ("leg length", 0.8, "m"),
        ("hip mass", 10.0, "kg"),
        ("mass length^2", 6.4, "kg·m²"),
        ("mass g length", 78.48, "kg·m²/s²"),
        ("mass length sqrt(g length)", 8.0 * (0.8 * 9.81) ** 0.5, "kg·m²/s"),
        ("m l/√(l/g)^3", 8.0 * (9.81 / 0.8) ** 1.5, "kg·m/s³"),
    ],
)
def test_sizes_of_units(unit, size, named):
    assert UNITS.size(unit) == pytest.approx(size, rel=1e-14) and si_unit(unit) == named


def test_every_unit_of_the_tables_is_read():
    units = {one.unit for kind in KINDS for one in KINDS[kind].variables.values()}
    parameters = {
        one.unit for row in DESCRIBED.values() for one in row if isinstance(one, Parameter)
    }
    single = {part for unit in units | parameters for part in unit.split(", ")}
    assert {unit for unit in single if not is_unit(unit)} == NO_UNITS


@pytest.mark.parametrize("unit", ["metres", "l +", "√", "^2", "l ^", "rad^x"])
def test_a_unit_of_other_bases_is_refused(unit):
    with pytest.raises(WrongUse, match="unit must be of rad, mass, length, gravity"):
        powers_of(unit)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, "1"])
def test_sizes_must_be_positive(wrong):
    with pytest.raises(WrongUse, match="mass must be finite and above 0"):
        wj.Units(1.0, wrong).size("rad")


def test_numbers_of_a_walker_from_si():
    """A pendulum of 0.4 kg and 0.3 m: its moment of inertia in units of 10 kg and 0.8 m."""
    found = UNITS.numbers(wj.RoundFootWalker, leg_mass=0.4, leg_inertia=0.4 * 0.3**2, slope=0.01)
    expected = {"leg_mass": 0.04, "leg_inertia": 0.04 * 0.375**2, "slope": 0.01}
    assert found == pytest.approx(expected, rel=1e-14)
    with pytest.raises(WrongUse, match="length must be one of slope, hip_mass"):
        UNITS.numbers(wj.RoundFootWalker, length=1.0)


GRID = wj.Grid.sheared(theta=(0.1, 0.2, 8), sum=(-0.01, 0.01, 8))
MAPPED = wj.Grid.plain(x=(-1, 1, 3), y=(-1, 1, 3))


def test_a_basin_in_si():
    data = wj.basin(wj.SimplestWalker(0.004), GRID, progress=False)
    found = UNITS.convert(data)
    time = (0.8 / 9.81) ** 0.5
    np.testing.assert_allclose(found.area, data.area / time, rtol=1e-14)
    np.testing.assert_allclose(found.states[..., 0], data.states[..., 0], rtol=0)
    np.testing.assert_allclose(found.states[..., 1], data.states[..., 1] / time, rtol=1e-14)
    assert found.area.attrs["units"] == "rad²/s" and found.states.attrs["units"] == "rad, rad/s"
    assert found.fate.identical(data.fate.assign_coords(found.fate.coords))
    assert found.attrs["units"] == "SI, from length 0.8 m, mass 10 kg, gravity 9.81 m/s²"
    assert kind_of(data) == "basin" and "units" not in data.area.attrs
    assert with_units(data).area.attrs["units"] == "rad²/√(l/g)"


def test_a_volume_is_one_of_rates_squared():
    """Over three dimensions, of which two are rates."""
    data = wj.basin(wj.SimplestWalker(0.004), GRID, progress=False)
    over = {name: data[name].expand_dims(phidot=[0.0]) for name in ("fate", "attractor", "strides")}
    data = data.assign(over).assign_attrs(section="theta, thetadot, phidot")
    assert units_of(data)["area"] == "rad³·g/l" and units_of(data)["phidot"] == "rad/√(l/g)"


def test_other_systems_have_no_units():
    data = xr.Dataset(attrs={"section": "x, y"})
    assert with_units(data).identical(data)
    of_maps = wj.basin(wj.systems.HenonMap(), MAPPED, "direct", strides=9, progress=False)
    assert with_units(of_maps).identical(of_maps)
    with pytest.raises(WrongUse, match=r"data must be of a walker, for units, not of \['x', 'y'\]"):
        UNITS.convert(of_maps)
    with pytest.raises(WrongUse, match="data must be of a kind"):
        kind_of(data)


@pytest.mark.slow
def test_the_page_prints_what_its_program_computes():
    """And Froude's similarity: a gait on the Moon takes longer by the root of gravities."""
    page = PAGE.read_text()
    (source,) = re.findall(r"```python\n(.*?)```", page, re.S)
    known: dict = {}
    exec(source, known)
    data = known["in_si"].isel(slope=0)
    said = f"takes {known['step_time']:.4f} s for a step of {float(data.step_length):.4f} m, which"
    words = " ".join(page.split())
    assert said in words and f"makes {float(data.speed):.4f} m/s" in words
    speed = float(data.step_length) / known["step_time"]
    assert float(data.speed) == pytest.approx(speed, rel=1e-9)
    for unit, digits in re.findall(r"\| ([^|]*) \| ([\d.]+) [^|]* \|", page):
        assert f"{UNITS.size(unit):.5g}".rstrip("0") == digits.rstrip("0"), unit
    moon = wj.Units(0.8, 10.0, 1.62).size("√(l/g)") / UNITS.size("√(l/g)")
    assert moon == pytest.approx((9.81 / 1.62) ** 0.5, rel=1e-14)
