"""The decorator that compiles a function of one cell, and the reasons why it cannot."""

import functools
import inspect
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from walker_jax.checks import WrongUse, short
from walker_jax.kernels import gpu
from walker_jax.kernels.primitive import call_program
from walker_jax.kernels.program import Program, program_of
from walker_jax.kernels.reverse import says_no_transpose

UNEQUAL_AXES = "vmap out_axes"
"""Part of JAX's error for `jax.jacfwd` of a function whose result itself depends on the
direction, as steps within a kernel do that are as long as their derivatives allow."""


def kernel(
    function: Callable | None = None, *, static_argnames: str | Sequence[str] = ()
) -> Callable:
    """Compile a pure JAX function of one cell to vectorised machine code; a decorator.

    ```python
    @kernel
    def energy(q, p):
        return p**2 / 2 - jnp.cos(q)

    jax.vmap(energy)(jnp.linspace(0, 1, 1000), jnp.zeros(1000))
    ```

    Call a kernel as its function, and map it over cells by `jax.vmap`. On a CPU it works on as many
    cells at once as a register holds, and on all cores under `jax.jit`; on an NVIDIA GPU each
    thread computes a cell. On other devices, and where `why_not` gives a reason, XLA computes the
    same function.

    All transformations of JAX apply: `jit`, `vmap`, `jvp`, `vjp`, `grad`, `scan`, `shard_map` and
    others. Reverse mode by few numbers, or through a `lax.while_loop`, multiplies by the Jacobian,
    which is computed in forward mode. By many it transposes the function, if JAX can. A function
    that calls a `jax.custom_vjp` has no derivatives in forward mode.

    **Arguments:**

    - `function`: takes PyTrees of arrays and numbers, and returns one. It may depend on its
      arguments alone, and on no named axis. With complex arguments or results, the kernel is the
      function itself.
    - `static_argnames`: names of arguments that are hashable values and not arrays, such as a
      method or a number of terms. A program is compiled for each value.

    **Returns** the kernel, or a decorator if no function is given.

    **Raises** `WrongUse` for names that are not arguments. The kernel raises it for a non-static
    argument that holds anything but arrays and numbers, and for a function that depends on a traced
    value from its surroundings.
    """
    if function is None:
        return functools.partial(kernel, static_argnames=static_argnames)
    if not callable(function):
        raise WrongUse(f"function must be a function, not {short(function)}")
    static = names_of(function, static_argnames)

    @functools.wraps(function, updated=())
    def of_call(given: CallArguments):
        return function(*given.args, **given.kwargs, **{name: x for name, _, x in given.static})

    def find_program(args: tuple, kwargs: dict):
        """Find the program of the function, or of one that takes its arguments by name."""
        try:
            if static or kwargs:
                return program_for(of_call, (split_arguments(function, static, args, kwargs),))
            return program_for(function, args)
        except TypeError:
            check_dynamic_arguments(
                inspect.signature(function).bind(*args, **kwargs).arguments, static
            )
            raise

    @functools.wraps(function)
    def call(*args, **kwargs):
        found = find_program(args, kwargs)
        if found is None:
            return function(*args, **kwargs)
        program, leaves, results = found
        return jax.tree.unflatten(results, call_program(program, leaves))

    vars(call).update(of_one_cell=function, find_program=find_program)
    return call


def why_not(function: Callable, *args: Any, **kwargs: Any) -> str | None:
    """Say in one line why a function of one cell has no kernel for these arguments.

    ```python
    why_not(lambda x: jnp.sort(x), jnp.zeros(3))
    ```

    **Arguments:**

    - `function`: a function of one cell, or a kernel.
    - `args`, `kwargs`: its arguments for one cell; only their shapes and types matter.

    **Returns** the reason, with the line of the function if it is known; for a function that cannot
    be traced, the error in one line. Returns `None` if there is a kernel.
    """
    platform = next(iter(jnp.zeros(()).devices())).platform
    route = gpu.route_in_use() if platform != "cpu" else None
    if platform != "cpu" and route is None:
        return f"arrays are on a {platform}, where kernels are {gpu.in_words()}"
    if not hasattr(function, "find_program"):
        function = kernel(function)
    try:
        found = vars(function)["find_program"](args, kwargs)
        if found is None:
            return "kernels do not support complex numbers"
        program, leaves, _ = found
        made = gpu.ptx_for(program, [True] * len(leaves), route) if route else program.compiled
    except WrongUse:
        raise
    except Exception as error:  # whatever JAX or the function itself raises as it is traced
        return why_untraced(error)
    return None if made else program.why_not


def why_untraced(error: Exception) -> str:
    """Say in one line that a function cannot be traced, and what to do about a derivative."""
    first, *_ = str(error).strip().rstrip(".").splitlines() or [""]
    instead = ""
    if says_no_transpose(error) or UNEQUAL_AXES in first:
        instead = ": a derivative of kernel(f) has a kernel of its own, outside any other kernel"
    return f"a kernel cannot trace the function, {type(error).__name__}: {first}{instead}"


def program_for(function: Callable, args: tuple) -> tuple[Program, list[jax.Array], Any] | None:
    """Return the program for these arguments, their leaves, and the tree of the results.

    None if any argument is complex: real derivatives are not linear over complex numbers.
    """
    leaves, structure = jax.tree.flatten(args)
    leaves = list(map(jnp.asarray, leaves))
    if any(map(jnp.iscomplexobj, leaves)):
        return None
    program, results = program_of(function, structure, list(map(jax.typeof, leaves)))
    is_complex = (jnp.issubdtype(aval.dtype, jnp.complexfloating) for aval in program.results)
    return None if any(is_complex) else (program, leaves, results)


# --------------------------------------------------------------------------- arguments by name


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["args", "kwargs"], meta_fields=["static"]
)
@dataclass
class CallArguments:
    """Arguments of a call: arrays by position and by name, and static values by name."""

    args: tuple
    kwargs: Mapping[str, Any]
    static: tuple[tuple[str, type, Hashable], ...]
    """Names, types and values; the types are there because `1`, `1.0` and `True` are equal."""


def names_of(function: Callable, static_argnames: Any) -> list[str]:
    """Return the names of static arguments; refuse names that the function does not have."""
    several = isinstance(static_argnames, Collection) and not isinstance(static_argnames, str)
    names: list[Any] = [*static_argnames] if several else [static_argnames]
    known = inspect.signature(function).parameters if names else {}
    for name in names:
        if name not in [*known]:
            raise WrongUse(f"static_argnames must be arguments of the function, not {short(name)}")
    for one in known.values():
        if one.kind in (one.POSITIONAL_ONLY, one.VAR_POSITIONAL):
            raise WrongUse(
                f"static_argnames must not be given for a function whose {one.name} has no name "
                "for callers"
            )
    return names


def split_arguments(
    function: Callable, static: Sequence[str], args: tuple, kwargs: dict
) -> CallArguments:
    """Separate the static arguments of a call from the others."""
    given = inspect.signature(function).bind(*args, **kwargs)
    values = [(name, given.arguments.pop(name)) for name in static if name in given.arguments]
    for name, value in values:
        try:
            hash(value)
        except TypeError:
            raise WrongUse(f"{name} is static and must be hashable, not {short(value)}") from None
    return CallArguments(given.args, given.kwargs, tuple((name, type(x), x) for name, x in values))


def check_dynamic_arguments(given: Mapping[str, Any], static: Sequence[str]) -> None:
    """Refuse the first non-static argument that holds anything but arrays and numbers."""
    for name, value in given.items():
        for leaf in () if name in static else jax.tree.leaves(value):
            try:
                jnp.asarray(leaf)
            except TypeError:
                raise WrongUse(
                    f"{name} must hold arrays and numbers alone, not {short(leaf)}: "
                    "name it in static_argnames"
                ) from None
