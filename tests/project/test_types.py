"""Type checkers accept programs of users that run: pyright, as the editors of users call it."""

import json
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
from reference import ROOT

import walker_jax as wj

POINTS = """
import walker_jax as wj
from walker_jax import figures

walker = TorqueWalker(0.01, 3.0, damping=1.2)
TorqueWalker(jnp.array(0.01), jnp.array(3.0))
start, many = [0.2, -0.2], [(0.2, -0.2), (0.21, -0.2)]
for end in (wj.stride(walker, start), wj.stride(walker, (0.2, -0.2)), wj.strides(walker, many)):
    end.state[0]
wj.stride(walker, start, step=-0.01)
wj.walk(walker, start, 2, ground=[0.0, 0.01]).states
wj.motion(walker, start, 2, ground=[0.0, 0.01])
wj.trajectory(walker, start, [0.1, 0.2])
wj.phase_times(walker, start)
wj.margins(walker, start)
wj.margins(walker, many)
wj.explain(walker, start)
wj.lyapunov(walker, start)
wj.transients(walker, many)
wj.attractors(walker, "slope", [0.01, 0.011], starts=start)
wj.edge_state(walker, start, [0.2, -0.1])
wj.find_gait(walker, [start, start], period=2).states
wj.descend(walker, [[start]])
grid = wj.Grid.plain(theta=(0, 0.4, 20), thetadot=(-0.4, 0, 25))
wj.boundary_point(walker, grid, start)
wj.zoom(walker, grid, 10.0, centre=start)
figures.basin(wj.basin(walker, grid)).get_figure().savefig("basin.png")
figures.sweep(wj.sweep(walker, {"slope": [0.01, 0.011]})).figure.savefig("sweep.png")
"""
WRONG = """
wj.walk(walker, start, "three")
wj.stride("walker", start)
wj.stride(walker, {0.2, -0.2})
figures.basin(start)
"""


def errors_in(path, source):
    """Lines of the errors that pyright finds in a file with this source."""
    path.write_text(source)
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson"]
    done = subprocess.run([*command, str(path)], cwd=ROOT, capture_output=True, text=True)
    found = json.loads(done.stdout)["generalDiagnostics"]
    return {one["range"]["start"]["line"]: one["message"] for one in found}


def test_programs_of_users_have_no_errors_and_wrong_ones_have(tmp_path):
    readme = (ROOT / "README.md").read_text()
    (torque,) = re.findall(r"<!-- a walker of your own -->\n```python\n(.*?)```", readme, re.S)
    right = torque + "\nimport jax.numpy as jnp\n" + POINTS
    found = errors_in(tmp_path / "own.py", right + WRONG)
    first = right.count("\n")
    wrong = [first + i for i, line in enumerate(WRONG.splitlines()) if line]
    assert {line: text for line, text in found.items() if line < first} == {}
    assert sorted(found) == wrong


def test_lists_are_points_as_arrays_are():
    walker, start = wj.SimplestWalker(0.009), [0.2, -0.2]
    for function in (wj.stride, lambda walker, x: wj.walk(walker, x, 2), wj.margins):
        found = [jax.tree.leaves(function(walker, one)) for one in (start, jnp.array(start))]
        for one, other in zip(found[0], found[1], strict=True):
            np.testing.assert_array_equal(one, other)
    found = [wj.descend(walker, one, 2) for one in ([[start]], np.array([[start]]))]
    np.testing.assert_array_equal(found[0], found[1])
