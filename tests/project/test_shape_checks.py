"""Shapes and types of the rooms in which strides are made and gaits are found.

Run-time checks of these rooms take a quarter of all processor time of the tests, as each of their
functions is called thousands of times. So one process has them on, traces every stride once, and
searches in a map.
"""

import inspect
import subprocess
import sys

import pytest

import walker_jax as wj

ROOMS = "gaits", "hybrid", "multibody", "systems", "walkers", "walking"
PROGRAM = """
import sys
import jax
import jax.numpy as jnp
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
with install_import_hook([f"walker_jax.{room}" for room in sys.argv[2:]], "beartype.beartype"):
    import walker_jax as wj
    import walker_jax.multibody as multibody
    import walker_jax.walking.failure_margins
    import walker_jax.walking.movement
    import walker_jax.walking.starts as starts

LEGS, TRUNK = [0.3, -0.4], [0.3, -0.4, -0.1]
STARTS = [
    (wj.SimplestWalker(0.01), LEGS),
    (wj.systems.HenonMap(), LEGS),
    (wj.systems.StickSlip(), [1.0]),
]
if sys.argv[1] == "all":
    STARTS += [
        (wj.systems.DuffingOscillator(), LEGS),
        (wj.systems.BouncingBall(), [0.3, 0.2]),
        (wj.systems.SpringMassRunner(), [1.0]),
        (wj.systems.SpringMassBiped(), [0.9, 0.1]),
        (wj.systems.RaibertHopper(), [1.4, 0.6]),
        (wj.systems.BoundingQuadruped(), [1.04, 0.7, 0.0]),
        (wj.systems.TorsoWheel(), TRUNK),
        (wj.PoweredWalker(0.01, hip_stiffness=4.0, hip_angle=-0.4, push_off=0.05), LEGS),
        (wj.UpperBodyWalker(0.01), TRUNK),
        (wj.KneedWalker(0.05, check_lock=True, check_scuffing=True), TRUNK),
        (wj.SpatialWalker(0.07), [0.1, 0.16, 0.33, -0.32, -0.05, -0.51, -0.6]),
    ]
for walker, x in STARTS:
    functions = [wj.stride]
    if isinstance(walker, (wj.SimplestWalker, wj.systems.DuffingOscillator, wj.systems.HenonMap)):
        functions += [wj.margins]
    if isinstance(walker, wj.SimplestWalker):
        functions += [lambda walker, x: walker.contact_force(walker.lift(x))]
        functions += [lambda walker, x: wj.trajectory(walker, x, jnp.linspace(0.0, 1.0, 3))]
        functions += [lambda walker, x: wj.walk(walker, x, 2, ground=jnp.array([0.01, -0.01]))]
    for function in functions:
        jax.make_jaxpr(function)(walker, jnp.array(x))
henon = wj.systems.HenonMap(0.1)
gait = wj.find_gait(henon, [[0.7, 0.2]])
wj.continue_gait(henon, "a", (0.1, 0.4))
wj.bifurcation_diagram(henon, "a", (0.1, 0.4), period_max=2, strides=100, scan=20, exponents=50)
wj.chart(henon, {"a": (0.1, 0.5), "b": (0.2, 0.4)}, gait, period_max=2, cells=(3, 3), strides=40)
wj.lyapunov(henon, [0.7, 0.2], 50, walks=2)
system = wj.PointFootWalker(0.01).system()
q, rates = jnp.array([0.0, 0.0, 0.2, 0.3]), jnp.array([0.0, 0.0, -0.3, 0.1])
for function in multibody.solve_motion, multibody.kinetic_energy:
    jax.make_jaxpr(lambda q, rates: function(system, q, rates))(q, rates)
try:
    starts.on_section(wj.SimplestWalker(0.01), jnp.zeros((2, 2)))
except Exception as error:
    print(type(error).__name__)
"""


@pytest.mark.parametrize("kinds", ["some", pytest.param("all", marks=pytest.mark.slow)])
def test_strides_of_all_kinds_keep_to_their_shapes(kinds):
    command = [sys.executable, "-c", PROGRAM, kinds, *ROOMS]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["TypeCheckError"], "a wrong shape is not seen"


def test_signatures_name_types_as_the_code_does():
    """`help` shows `ArrayLike`, not the eight types that it stands for."""
    shown = [getattr(wj, name) for name in wj.__all__ if name[0].islower()]
    shown += [wj.Grid, wj.SimplestWalker, wj.KneedWalker, wj.systems.FiveLinkBiped]
    for one in shown:
        assert "Union[" not in str(inspect.signature(one)), one
        assert "jaxlib" not in str(inspect.signature(one)), one
