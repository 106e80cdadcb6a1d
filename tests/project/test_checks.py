import ast
from pathlib import Path

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import WrongUse, check_kind, check_number, check_whole, numbers


def test_whole_numbers_in_range_are_taken():
    for value in (1, np.int8(3), 2**31 - 1):
        check_whole("strides", value)
    check_whole("seed", 0, 0)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0, "at least 1, not 0"),
        (-3, "at least 1, not -3"),
        (2**31, "at most 2147483647, not 2147483648"),
        (1.0, r"a whole number, not 1\.0"),
        (np.nan, "a whole number, not nan"),
        ("3", "a whole number, not '3'"),
        (None, "a whole number, not None"),
    ],
)
def test_other_counts_are_refused(value, said):
    with pytest.raises(WrongUse, match=f"^strides must be {said}$"):
        check_whole("strides", value)


@pytest.mark.parametrize("value", [None, "1", b"1", 1j, [], [1.0], np.zeros((2, 2)), 10**400])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(WrongUse, match=r"^rate must be a real number, not .*$"):
        check_number("rate", value)


def test_the_package_raises_no_other_value_error_than_wrong_use():
    """So that one that comes from within a computation is not taken for wrong use."""
    for path in Path(wj.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name = ast.unparse(node.exc.func)
                assert name not in ("ValueError", "TypeError"), (path.name, node.lineno)
            if isinstance(node, ast.ClassDef) and node.name != "WrongUse":
                assert "ValueError" not in map(ast.unparse, node.bases), (path.name, node.name)


def test_numbers_and_kinds():
    for value in (1, 0.5, np.float32(2), np.nan, np.zeros(())):
        check_number("rate", value)
    assert numbers("values", [1, 2]).tolist() == [1.0, 2.0]
    with pytest.raises(WrongUse, match=r"^values must be real numbers, not \[\[1\], \[2, 3\]\]$"):
        numbers("values", [[1], [2, 3]])
    for truth in (True, np.True_, np.zeros(3)[0] == 0):
        check_kind("fall", truth, bool)
    with pytest.raises(WrongUse, match=r"^fall must be a bool, not 1$"):
        check_kind("fall", 1, bool)
    with pytest.raises(WrongUse, match=r"^grid must be a Grid, not None$"):
        check_kind("grid", None, wj.Grid)
    with pytest.raises(WrongUse, match=r"^grid must be a Grid, not array\(\[\[0\., 0\..{,60}$"):
        check_kind("grid", np.zeros((30, 30)), wj.Grid)  # on one line, and a short one
