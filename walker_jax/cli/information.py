"""The options `--version`, for reports of bugs, and `--list-walkers`: both print and exit."""

import math
import os
import platform
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from walker_jax.cli import library as lib
from walker_jax.cli.options import Option, option_of, underscored
from walker_jax.refusals import WrongUse

PACKAGES = "jax", "jaxlib", "diffrax", "equinox", "optimistix", "numpy", "scipy", "xarray", "zarr"
"""Packages on which results depend; llvmlite is named separately, with its LLVM."""


def printing(lines: Callable[[], Iterator[str]], flag: str, help: str) -> Option:
    """Make the option that prints these lines and exits."""

    def act(ctx: Any, param: Any, requested: bool) -> None:
        if requested and not ctx.resilient_parsing:
            for line in lines():
                print(line)
            ctx.exit()

    return Option(
        underscored(flag.removeprefix("--")),
        default=False,
        is_eager=True,
        expose_value=False,
        callback=act,
        help=help,
    )


def versions() -> Iterator[str]:
    """Yield the versions of the package, its dependencies and the machine."""
    import llvmlite
    import llvmlite.binding as llvm

    devices, machine = lib.find_devices(), lib.machine
    target, _ = machine.processor() if not machine.switched_off() else ("none", "")
    packages = [f"{name} {version(name)}" for name in PACKAGES]
    packages += [f"llvmlite {llvmlite.__version__} (LLVM {llvm.llvm_version_info[0]})"]
    yield f"walker-jax {version('walker-jax')}"
    yield f"  Python {platform.python_version()}, {platform.platform()}"
    yield f"  {', '.join(packages)}"
    features = llvm.get_host_cpu_features()
    known = ("sse2", "avx", "avx2", "fma", "avx512f", "neon")
    vectors = " ".join(name for name in known if features.get(name)) or "no vectors"
    yield f"  processor {processor_name()}, {lib.cores()} cores; {vectors}"
    yield f"  devices {', '.join(f'{one.platform} ({one.device_kind})' for one in devices)}"
    if machine.switched_off():
        yield f"  kernels are switched off, by {machine.VARIABLE}"
    elif devices[0].platform != "cpu":
        yield f"  kernels are {lib.gpu.in_words()}"
    else:
        named = f", by {machine.VARIABLE}" * (machine.setting() not in ("", "cpu"))
        yield f"  kernels are in use, compiled for {target}{named}"
    yield f"  compiled programs are kept in {lib.cache_folder() or 'no folder'}"


def processor_name() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def walkers() -> Iterator[str]:
    """Yield all walkers and systems with their parameters, also of other packages."""
    for name, kind in lib.WALKERS.items():
        yield from describe(name, kind)
    for name, point in lib.installed_walkers().items():
        package = point.dist.name if point.dist else point.module
        try:
            yield from describe(f"{name} (of {package})", lib.load_installed(point))
        except WrongUse as error:
            yield f"{name} (of {package}): {error}"
    for name, kind in lib.SYSTEMS.items():
        yield from describe(f"--system {name}", kind)


def describe(name: str, kind: type) -> Iterator[str]:
    """Yield what a walker is, its section and its parameters."""
    yield f"{name}: {(kind.__doc__ or kind.__name__).strip().splitlines()[0]}"
    yield f"  section ({', '.join(kind.section)})"
    for one in lib.parameters(kind):
        about = ", ".join(filter(None, (one.meaning, one.bounds())))
        default = "required" if math.isnan(one.default) else f"{one.default:g}"
        yield f"  {option_of(one.name):18} {one.unit:17} {default:<8} {about}"
    yield from (f"  {option_of(one.name):18} FILE" for one in lib.trees(kind))
    yield from (f"  {option_of(one.name):44} {one.meaning}" for one in lib.options(kind))


STARTUP = {"bash": ".bashrc", "zsh": ".zshrc", "fish": ".config/fish/config.fish"}
"""File that a shell runs when it starts, in the user's home."""


def completion() -> Iterator[str]:
    """Let the user's shell complete commands, options and walkers, and yield where it says so."""
    shell = Path(os.environ.get("SHELL", "")).name
    if shell not in STARTUP:
        known = ", ".join(STARTUP)
        raise WrongUse(
            f"--install-completion must be used in one of {known}, not in {shell or 'none'}"
        )
    line = 'eval "$(_WALKER_JAX_COMPLETE=SHELL_source walker-jax)"'
    if shell == "fish":
        line = "_WALKER_JAX_COMPLETE=SHELL_source walker-jax | source"
    place, line = Path.home() / STARTUP[shell], line.replace("SHELL", shell)
    place.parent.mkdir(parents=True, exist_ok=True)
    if not place.exists() or line.encode() not in place.read_bytes():
        with place.open("a") as file:
            file.write(f"\n{line}\n")
    yield f"{place} now has the line {line}: new shells complete walker-jax"


VERSION = printing(
    versions,
    "--version",
    "Print versions, processor and devices, as a report of a bug needs them.",
)
LIST_WALKERS = printing(
    walkers,
    "--list-walkers",
    "List all walkers and systems, with their parameters; --walker NAME --help has those of one.",
)
COMPLETION = printing(
    completion,
    "--install-completion",
    "Let bash, zsh or fish complete commands, options and walkers.",
)
