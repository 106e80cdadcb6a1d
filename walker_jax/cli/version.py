"""The option `--version`, which prints all that a bug report needs."""

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

PACKAGES = "jax", "jaxlib", "diffrax", "equinox", "optimistix", "numpy", "scipy", "xarray", "zarr"
"""Packages on which results depend; llvmlite is named separately, with its LLVM."""


def print_version(requested: bool) -> bool:
    """Print the versions of the package, its dependencies and the machine, and exit."""
    if not requested:
        return False
    import llvmlite
    import llvmlite.binding as llvm

    from walker_jax.cli.startup import find_devices  # loads JAX, which takes a second
    from walker_jax.execution.tiles import cores
    from walker_jax.kernels import machine
    from walker_jax.kernels.gpu import in_words
    from walker_jax.kernels.object_cache import cache_folder

    devices = find_devices()
    target, _ = machine.processor() if not machine.switched_off() else ("none", "")
    versions = [f"{name} {version(name)}" for name in PACKAGES]
    versions += [f"llvmlite {llvmlite.__version__} (LLVM {llvm.llvm_version_info[0]})"]
    print(f"walker-jax {version('walker-jax')}")
    print(f"  Python {platform.python_version()}, {platform.platform()}")
    print(f"  {', '.join(versions)}")
    print(f"  processor {processor_name()}, {cores()} cores; {vector_extensions()}")
    print(f"  devices {', '.join(f'{one.platform} ({one.device_kind})' for one in devices)}")
    if machine.switched_off():
        print(f"  kernels are switched off, by {machine.VARIABLE}")
    elif devices[0].platform != "cpu":
        print(f"  kernels are {in_words()}")
    else:
        named = f", by {machine.VARIABLE}" * (machine.setting() not in ("", "cpu"))
        print(f"  kernels are in use, compiled for {target}{named}")
    print(f"  compiled programs are kept in {cache_folder() or 'no folder'}")
    raise typer.Exit


def processor_name() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def vector_extensions() -> str:
    """Return the processor's vector extensions, which set how many numbers it handles at once."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    known = [
        name for name in ("sse2", "avx", "avx2", "fma", "avx512f", "neon") if features.get(name)
    ]
    return " ".join(known) or "no vectors"


Version = Annotated[
    bool,
    typer.Option(
        "--version",
        is_eager=True,
        callback=print_version,
        help="Print versions, processor and devices, as a report of a bug needs them.",
    ),
]
