"""What versions leave to later ones, and where the version stands."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from reference import DATA, ROOT

import walker_jax as wj
from walker_jax import storage
from walker_jax.storage.requests import check_request
from walker_jax.storage.schema import SCHEMA_VERSION


@pytest.fixture
def earlier(tmp_path):
    """A basin that version 0.1.0 has computed, in a folder of its own."""
    there = DATA / "basin-0.1.0.zarr"
    return Path(shutil.copytree(there, tmp_path / "basin.zarr"))


def test_a_whole_result_of_an_earlier_version_is_read(earlier):
    data = storage.load(earlier)
    assert data is not None
    request = storage.request_in(data.attrs)
    assert request["version"] == "0.1.0"
    found = storage.find(earlier, request | {"version": "0.2.0"})
    assert found is not None and found.equals(data)
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 30), sum=(-0.03, 0.01, 20))
    now = wj.basin(wj.SimplestWalker(0.004), grid)
    np.testing.assert_array_equal(data["fate"], now["fate"])
    np.testing.assert_allclose(data["states"], now["states"], rtol=1e-12)
    with pytest.raises(storage.StoreConflict, match="method"):
        storage.find(earlier, request | {"version": "0.2.0", "method": "direct"})


def test_unfinished_results_of_earlier_versions_are_not_resumed(earlier):
    data = storage.load(earlier)
    assert data is not None
    attributes = data.attrs | {"unfinished": "basin"}
    request = storage.request_in(attributes)
    check_request(earlier, attributes, request)
    with pytest.raises(storage.StoreConflict, match=r'version: "0\.1\.0", not "0\.2\.0"'):
        check_request(earlier, attributes, request | {"version": "0.2.0"})


def test_a_name_that_there_is_not():
    public: Any = wj
    with pytest.raises(AttributeError, match="module 'walker_jax' has no attribute 'no_such_name'"):
        assert public.no_such_name


def test_a_store_says_its_version(earlier):
    group = zarr.open_group(earlier, mode="r")
    assert group.attrs["schema_version"] == SCHEMA_VERSION


def test_the_changelog_tells_each_version_from_the_first_on():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    versions = re.findall(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert project["version"] in versions and versions[-1] == "0.1.0"


def test_the_version_and_the_pythons_are_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()
    matrix = (ROOT / ".ci" / "matrix.py").read_text()
    tried = re.findall(r'"(3\.\d+)"', matrix.partition("\nSETS")[0])
    known = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    assert known == tried and project["requires-python"] == f">={tried[0]}"
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    assert sorted(re.findall(r"^ +(3\.\d+)$", workflow, re.M)) == tried
    assert rf'{{python-version: "{tried[-1]}\n{tried[0]}"}}' in workflow  # for .ci/run
    actions = re.findall(r"uses: (?!actions/)\S+@(\S+)", workflow)  # of others than the host
    assert actions and all(re.fullmatch(r"[0-9a-f]{40}", one) for one in actions)


def test_the_oldest_python_has_tests_of_each_room():
    """`.ci/run` names folders and files of tests, which exist."""
    show = r"""eval "$(sed -n '/^on_oldest=(/,/^)/p' .ci/run)"; printf '%s\n' "${on_oldest[@]}" """
    said = subprocess.run(
        ["bash", "-c", show], cwd=ROOT, capture_output=True, text=True, check=True
    )
    named = [ROOT / one for one in said.stdout.split()]
    assert all(one.is_dir() or one.name.startswith("test_") for one in named)
    assert all(one.exists() for one in named)
    rooms = {one if one.is_dir() else one.parent for one in named}
    assert rooms == {one.parent for one in (ROOT / "tests").glob("*/test_*.py")}


@pytest.mark.parametrize(
    ("answer", "said"),
    [("", "JSONDecodeError: "), ("{}", "KeyError: "), ('{"attractors": []}', "other cells: []")],
)
def test_the_matrix_marks_an_answer_that_lacks_something(answer, said, tmp_path):
    script = ROOT / ".ci" / "matrix.py"
    names: dict[str, Any] = {"__name__": "matrix", "__file__": str(script)}
    exec(compile(script.read_text(), str(script), "exec"), names)
    names["JOB"] = ("-c", f"print({answer!r})")
    rows: list[tuple[str, str, str]] = []
    environment = names["own_cache"](tmp_path, "empty")
    names["report"](
        rows, "here", lambda: names["check_job"](Path(sys.executable), tmp_path, environment)
    )
    ((title, outcome, reason),) = rows
    assert (title, outcome) == ("here", "FAILED") and reason.startswith(said)
