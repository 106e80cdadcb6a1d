"""Interpreters of jaxprs: each evaluates equation after equation by the rule of its primitive.

Each interpreter has its own kind of values: entries of an array, instructions, or series.
"""

import abc
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, no_type_check

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, jaxprs_in_params
from jax.extend.source_info_util import user_context

from walker_jax.origins import FOLDER

INSTALLED = [Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")]
"""Folders of installed code, as opposed to a user's own."""


class UnsupportedPrimitive(NotImplementedError):
    """A function uses a primitive or a type that kernels do not support; the error names it."""

    line: str | None = None
    """The line of user code where it occurs, if known."""

    def __str__(self):
        return ", in ".join(filter(None, (*self.args, self.line)))


@no_type_check  # called for every equation of a program: checks would take minutes
class Interpreter(abc.ABC):
    """Computes the results of a jaxpr from the values of its arguments."""

    rules: ClassVar[Mapping[str, Callable[[Any, JaxprEqn, list], list]]]
    """By primitive: (interpreter, equation, operands) -> results."""

    @abc.abstractmethod
    def constant(self, value) -> Any:
        """Return the value of a constant of the jaxpr."""

    @abc.abstractmethod
    def default_rule(self, equation: JaxprEqn, operands: list) -> list:
        """Return the results of a primitive that has no rule."""

    def interpret(self, closed: ClosedJaxpr, inputs: list) -> list:
        jaxpr = closed.jaxpr
        values: dict = dict(zip(jaxpr.constvars, map(self.constant, closed.consts), strict=True))
        values |= zip(jaxpr.invars, inputs, strict=True)

        def read(variable):
            known = isinstance(variable, Literal)
            return self.constant(variable.val) if known else values[variable]

        try:
            for equation in jaxpr.eqns:
                operands = [
                    self.constant(one.val) if isinstance(one, Literal) else values[one]
                    for one in equation.invars
                ]
                results = self.apply(equation, operands)
                for variable, result in zip(equation.outvars, results, strict=True):
                    values[variable] = result
        except UnsupportedPrimitive as error:
            error.line = error.line or line_of(equation)
            raise
        return [read(variable) for variable in jaxpr.outvars]

    def apply(self, equation: JaxprEqn, operands: list) -> list:
        """Return the results of an equation."""
        rule = self.rules.get(equation.primitive.name, type(self).default_rule)
        return rule(self, equation, operands)


def line_of(equation: JaxprEqn) -> str | None:
    """Return the line of user code that an equation comes from, if known."""
    return line_in(equation.source_info.traceback)


@lru_cache(maxsize=4096)
def line_in(traceback: Any) -> str | None:
    """Return the innermost line of a traceback that is a user's own, if there is one."""
    for frame in traceback.frames if traceback else ():
        if is_code(frame.file_name):
            file = Path(frame.file_name)
            known = not file.is_relative_to(FOLDER)  # a user's own, rather than this package's
            return f"line {frame.line_num} of {file.name}" if known else None
    return None


@cache
def is_code(file: str) -> bool:
    """Return whether a file is code of a user, or of this package."""
    return Path(file).exists() and not any(map(Path(file).is_relative_to, INSTALLED))


def equations_in(jaxpr: Jaxpr) -> Iterator[JaxprEqn]:
    """Yield the equations of a function and of all functions that it calls, of each only once."""
    seen, left = {}, [jaxpr]
    while left:
        one = left.pop()
        if id(one) in seen:
            continue
        seen[id(one)] = one  # kept, so that no other function gets its number
        for equation in one.eqns:
            yield equation
            left += jaxprs_in_params(equation.params)
            if equation.primitive.name == "call_hi_primitive":
                left.append(called_function(equation).jaxpr)


def shape_dtype(aval) -> jax.ShapeDtypeStruct:
    """Return the shape and type of an abstract value, without its sharding."""
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type)


def called_function(equation: JaxprEqn) -> ClosedJaxpr:
    """Return the function that a call calls."""
    params = equation.params
    if equation.primitive.name == "call_hi_primitive":
        inner = partial(equation.primitive.to_lojax, **params)
        return jax.make_jaxpr(inner)(*(shape_dtype(variable.aval) for variable in equation.invars))
    inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
    return inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())


def binding(equation: JaxprEqn) -> Callable:
    """Return the primitive of an equation, with its parameters, as a function of operands.

    Each equation that it makes is of the same line of code.
    """
    primitive = equation.primitive
    bound = partial(primitive.bind, **primitive.get_bind_params(equation.params))

    def bind(*operands, **changed):
        with user_context(equation.source_info.traceback):
            return bound(*operands, **changed)

    return bind


def scan_counts(params: dict) -> tuple[int, int]:
    """Return the numbers of a scan's constants and of the values that it carries."""
    if "ft_in" in params:  # from jax 0.11 on
        constants, carried, _ = map(len, params["ft_in"].unpack())
        return constants, carried
    return params["num_consts"], params["num_carry"]


def enter(interpreter: Interpreter, equation: JaxprEqn, operands: list) -> list:
    """Return the results of a call by interpreting its function."""
    return interpreter.interpret(called_function(equation), operands)


SHARED_CALL = "shared_call"
"""Name of the primitive of a call of another kernel (`shared_code`)."""
CALLS = dict.fromkeys(
    ("jit", "pjit", "closed_call", "eval_jaxpr", "checkpoint", "remat2", SHARED_CALL), enter
)
"""Rules for primitives that only call a function."""
CALLS_WITH_DERIVATIVES = dict.fromkeys(
    ("custom_jvp_call", "custom_vjp_call", "call_hi_primitive"), enter
)
"""Rules for calls with custom derivatives, which are lost by interpretation.

From jax 0.11 on, functions such as `searchsorted` and `custom_root` are calls of the last kind.
"""


def changes_entries(name: str, params: dict) -> bool:
    """Return whether a scatter replaces entries by a function of them, as `x.at[i].apply` does."""
    update = params["update_jaxpr"]
    return name == "scatter" and update is not None and update.outvars[0] is not update.invars[1]
