"""Programs of threads as tests make and assemble them."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
from jax import lax

from walker_jax.kernels import ptx
from walker_jax.kernels.program import tracing_for_kernel


def find_ptxas():
    wheels = importlib.util.find_spec("nvidia")
    places = map(Path, (wheels and wheels.submodule_search_locations) or ())
    return next((str(one) for place in places for one in place.glob("*/bin/ptxas")), None)


PTXAS = find_ptxas() or shutil.which("ptxas")
DTYPES = ["float64", "float32"]
KNOWN = "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp exp2 expm1 log log1p cbrt"
TWICE = {"atan2": jnp.atan2, "pow": jnp.power, "fmod": lax.rem}


def closed_of(function, *args):
    with tracing_for_kernel(True):
        return jax.make_jaxpr(function)(*args)


def ptx_of(closed, in_memory=False):
    given = closed.in_avals, closed.out_avals, None, lambda: closed
    return ptx.find_ptx(*given, (True,) * len(closed.in_avals), in_memory).text


def elementary(x):
    """All functions of the C library that kernels call."""
    one = [getattr(jnp, name)(x) for name in KNOWN.split()]
    return [*one, lax.erf(x), *(of(x, x + x) for of in TWICE.values())]


def check_assembly(text, folder):
    assert PTXAS is not None
    (folder / "kernel.ptx").write_text(text)
    command = [PTXAS, "-arch=sm_90", "kernel.ptx", "-o", "kernel.cubin"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr
