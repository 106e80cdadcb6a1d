"""Rules that translate scalar primitives into LLVM instructions on vectors of cells."""

import contextlib
import functools
import sys
from collections.abc import Callable

import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
from jax import lax
from llvmlite import ir

from walker_jax.kernels.elementary import exp_float32, log_float32, next_after
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.powers import known_exponent, power_of_known

# The file of the C library that has the mathematical functions.
LIBRARY = {"linux": "libm.so.6", "darwin": "/usr/lib/libSystem.B.dylib", "win32": "ucrtbase"}


@functools.cache
def in_library(name: str) -> bool:
    """Return whether the C library has a function of this name."""
    if llvm.address_of_symbol(name) is None and sys.platform in LIBRARY:
        with contextlib.suppress(RuntimeError):  # there is no such file
            llvm.load_library_permanently(LIBRARY[sys.platform])
    return llvm.address_of_symbol(name) is not None


def is_float(kind) -> bool:
    return isinstance(getattr(kind, "element", kind), (ir.FloatType, ir.DoubleType))


def is_floating(dtype) -> bool:
    return np.dtype(dtype).kind == "f"


def arithmetic(of_float: str, of_int: str):
    def rule(emitter, params, dtypes, *operands):
        if is_floating(dtypes[0]):
            return emitter.builder.arithmetic(of_float, *operands)
        return getattr(emitter.builder, of_int)(*operands)

    return rule


def unary(name: str):
    return lambda emitter, params, dtypes, x: emitter.intrinsic(name, x)


def extremum(of_float: str, of_int: str):
    def rule(emitter, params, dtypes, a, b):
        if is_floating(dtypes[0]):
            return emitter.intrinsic(of_float, a, b)
        return emitter.intrinsic(of_int.replace("?", signedness(dtypes[0])), a, b)

    return rule


def signedness(dtype) -> str:
    return "s" if np.dtype(dtype).kind == "i" else "u"


def comparison(sign: str):
    def rule(emitter, params, dtypes, a, b):
        builder = emitter.builder
        if is_floating(dtypes[0]):
            ordered = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
            return ordered(sign, a, b)
        compare = builder.icmp_signed if signedness(dtypes[0]) == "s" else builder.icmp_unsigned
        return compare(sign, a, b)

    return rule


def total_order(sign: str):
    """Compare in the total order of IEEE 754: -0 is below 0, and NaN beyond infinity."""

    def rule(emitter, params, dtypes, *operands):
        if not is_floating(dtypes[0]):
            return comparison(sign)(emitter, params, dtypes, *operands)
        builder, integer = emitter.builder, np.dtype(f"int{8 * np.dtype(dtypes[0]).itemsize}")
        last, most = 8 * integer.itemsize - 1, np.iinfo(integer).max

        def key(x):
            bits = builder.bitcast(x, emitter.type(integer))
            negative = builder.ashr(bits, emitter.vector(last, integer))
            return builder.xor(bits, builder.and_(negative, emitter.vector(most, integer)))

        return builder.icmp_signed(sign, *map(key, operands))

    return rule


def negation(emitter, params, dtypes, x):
    builder = emitter.builder
    return builder.arithmetic("fneg", x) if is_floating(dtypes[0]) else builder.neg(x)


def absolute(emitter, params, dtypes, x):
    if is_floating(dtypes[0]):
        return emitter.intrinsic("fabs", x)
    return emitter.builder.select(
        emitter.builder.icmp_signed("<", x, emitter.vector(0, dtypes[0])), emitter.builder.neg(x), x
    )


def division(emitter, params, dtypes, a, b):
    if is_floating(dtypes[0]):
        return emitter.builder.arithmetic("fdiv", a, b)
    return integer_division(emitter, dtypes[0], "div", a, b)


def remainder(emitter, params, dtypes, a, b):
    if is_floating(dtypes[0]):
        return emitter.by_library("fmod", dtypes[0], a, b)
    return integer_division(emitter, dtypes[0], "rem", a, b)


def integer_division(emitter, dtype, name: str, a, b):
    """Return a quotient or remainder of integers, with XLA's values where it is undefined.

    Division by zero, and of the smallest integer by -1, would trap, so no lane may execute it.
    """
    builder, equal = emitter.builder, lambda x, value: emitter.builder.icmp_signed("==", x, value)
    zero, one, ones = (
        emitter.vector(value, dtype)
        for value in (0, 1, -1 if signedness(dtype) == "s" else np.iinfo(dtype).max)
    )
    none = equal(b, zero)
    wrong = none
    if signedness(dtype) == "s":
        least = emitter.vector(np.iinfo(dtype).min, dtype)
        wrong = builder.or_(none, builder.and_(equal(a, least), equal(b, ones)))
    result = getattr(builder, f"{signedness(dtype)}{name}")(a, builder.select(wrong, one, b))
    return builder.select(none, ones if name == "div" else a, result)


def integer_power(emitter, params, dtypes, x):
    """Return x^y for an integer y, by repeated squaring."""
    y = params["y"]
    multiply = lambda a, b: emitter.builder.arithmetic("fmul", a, b)
    if not is_floating(dtypes[0]):
        multiply = emitter.builder.mul
    result, square, left = None, x, abs(y)
    while left:
        if left & 1:
            result = square if result is None else multiply(result, square)
        left >>= 1
        if left:
            square = multiply(square, square)
    one = emitter.vector(1, dtypes[0])
    if result is None:
        return one
    return emitter.builder.arithmetic("fdiv", one, result) if y < 0 else result


def power(emitter, params, dtypes, x, y):
    """Return x^y; y may be of another type."""
    if dtypes[1] != dtypes[0]:
        y = conversion(emitter, {"new_dtype": dtypes[0]}, [dtypes[1]], y)
    elif (exponent := known_exponent(y)) is not None:
        if dtypes[0] == np.float64:
            return power_of_known(emitter, x, exponent)
        x = emitter.builder.fpext(x, emitter.type(np.float64))
        return emitter.builder.fptrunc(
            power_of_known(emitter, x, exponent), emitter.type(np.float32)
        )
    return emitter.by_library("pow", dtypes[0], x, y)


def selection(emitter, params, dtypes, which, *cases):
    """Select case number `which`; if `which` is a flag, the second case where it is true."""
    builder = emitter.builder
    if np.dtype(dtypes[0]).kind == "b":
        return builder.select(which, cases[1], cases[0])
    *others, chosen = cases
    for i, case in reversed(list(enumerate(others))):
        here = builder.icmp_signed("<=", which, emitter.vector(i, dtypes[0]))
        chosen = builder.select(here, case, chosen)
    return chosen


def conversion(emitter, params, dtypes, x):
    builder, old, new = emitter.builder, np.dtype(dtypes[0]), np.dtype(params["new_dtype"])
    kind = emitter.type(new)
    if old == new:
        return x
    if new.kind == "b":
        zero = emitter.vector(0, old)
        if is_floating(old):
            return builder.fcmp_unordered("!=", x, zero)
        return builder.icmp_unsigned("!=", x, zero)
    if is_floating(old):
        if is_floating(new):
            return (builder.fpext if new.itemsize > old.itemsize else builder.fptrunc)(x, kind)
        return saturate(emitter, old, new, x)
    if is_floating(new):
        return (builder.sitofp if old.kind == "i" else builder.uitofp)(x, kind)
    if new.itemsize > old.itemsize or old.kind == "b":
        return (builder.sext if old.kind == "i" else builder.zext)(x, kind)
    return builder.trunc(x, kind) if new.itemsize < old.itemsize else x


def saturate(emitter, old, new, x):
    """Truncate x to an integer, clipped to the bounds of its type; zero for NaN."""
    builder, info = emitter.builder, np.iinfo(new)
    low, high = float(info.min), -float(info.min) if info.min else float(info.max) + 1
    low, high = emitter.vector(low, old), emitter.vector(high, old)
    inside = builder.and_(builder.fcmp_ordered(">=", x, low), builder.fcmp_ordered("<", x, high))
    convert = builder.fptosi if signedness(new) == "s" else builder.fptoui
    value = convert(builder.select(inside, x, emitter.vector(0, old)), emitter.type(new))
    value = builder.select(
        builder.fcmp_ordered(">=", x, high), emitter.vector(info.max, new), value
    )
    return builder.select(builder.fcmp_ordered("<", x, low), emitter.vector(info.min, new), value)


def is_finite(emitter, params, dtypes, x):
    size = emitter.intrinsic("fabs", x)
    return emitter.builder.fcmp_ordered("<", size, emitter.vector(np.inf, dtypes[0]))


def sign(emitter, params, dtypes, x):
    zero, one = emitter.vector(0, dtypes[0]), emitter.vector(1, dtypes[0])
    builder = emitter.builder
    if is_floating(dtypes[0]):
        return builder.select(
            builder.fcmp_ordered("!=", x, zero), emitter.intrinsic("copysign", one, x), x
        )
    unit = one
    if signedness(dtypes[0]) == "s":
        unit = builder.select(builder.icmp_signed("<", x, zero), emitter.vector(-1, dtypes[0]), one)
    return builder.select(builder.icmp_unsigned("==", x, zero), zero, unit)


def rounding(emitter, params, dtypes, x):
    even = params["rounding_method"] == lax.RoundingMethod.TO_NEAREST_EVEN
    return emitter.intrinsic("roundeven" if even else "round", x)


def logical(name: str):
    return lambda emitter, params, dtypes, a, b: getattr(emitter.builder, name)(a, b)


def clamp(emitter, params, dtypes, low, x, high):
    return RULES["min"](emitter, {}, dtypes, RULES["max"](emitter, {}, dtypes, x, low), high)


def shift(name: str):
    """Shift bits; a shift by all bits or more leaves zeros, or the sign if arithmetic."""

    def rule(emitter, params, dtypes, x, by):
        builder, last = emitter.builder, 8 * np.dtype(dtypes[0]).itemsize - 1
        inside = builder.icmp_unsigned("<=", by, emitter.vector(last, dtypes[0]))
        arithmetic = name == "ashr"
        outside = emitter.vector(last if arithmetic else 0, dtypes[0])
        shifted = getattr(builder, name)(x, builder.select(inside, by, outside))
        zero = emitter.vector(0, dtypes[0])
        return shifted if arithmetic else builder.select(inside, shifted, zero)

    return rule


def bits(emitter, params, dtypes, x):
    if np.dtype(params["new_dtype"]).itemsize != np.dtype(dtypes[0]).itemsize:
        raise UnsupportedPrimitive("bitcast_convert_type")
    return emitter.builder.bitcast(x, emitter.type(params["new_dtype"]))


def elementary(name: str, of_float32: Callable | None = None):
    """Call a function of the C library lane by lane; for float32, a JAX function if given."""

    def rule(emitter, params, dtypes, *operands):
        if of_float32 is not None and dtypes[0] == np.float32:
            return emitter.inline(of_float32, *operands, dtype=np.float32)
        return emitter.by_library(name, dtypes[0], *operands)

    return rule


def inline_jax(function: Callable):
    return lambda emitter, params, dtypes, *x: emitter.inline(function, *x, dtype=dtypes[0])


REDUCTIONS = {
    "reduce_max": lax.max_p,
    "reduce_min": lax.min_p,
    "reduce_prod": lax.mul_p,
    "reduce_and": lax.and_p,
    "reduce_or": lax.or_p,
}
RULES: dict[str, Callable] = {
    "add": arithmetic("fadd", "add"),
    "add_any": arithmetic("fadd", "add"),
    "sub": arithmetic("fsub", "sub"),
    "mul": arithmetic("fmul", "mul"),
    "div": division,
    "rem": remainder,
    "neg": negation,
    "abs": absolute,
    "max": extremum("maximum", "?max"),
    "min": extremum("minimum", "?min"),
    "sqrt": unary("sqrt"),
    "rsqrt": inline_jax(lambda x: 1 / jnp.sqrt(x)),
    "floor": unary("floor"),
    "ceil": unary("ceil"),
    "round": rounding,
    "sign": sign,
    "integer_pow": integer_power,
    "square": lambda emitter, params, dtypes, x: integer_power(emitter, {"y": 2}, dtypes, x),
    "one_minus_square": inline_jax(lambda x: (1 + x) * (1 - x)),
    "polynomial": inline_jax(lambda x, *c: functools.reduce(lambda y, one: y * x + one, c[::-1])),
    "is_finite": is_finite,
    "eq": comparison("=="),
    "ne": comparison("!="),
    "lt": comparison("<"),
    "le": comparison("<="),
    "gt": comparison(">"),
    "ge": comparison(">="),
    "lt_to": total_order("<"),
    "le_to": total_order("<="),
    "and": logical("and_"),
    "or": logical("or_"),
    "xor": logical("xor"),
    "not": lambda emitter, params, dtypes, x: emitter.builder.not_(x),
    "shift_left": shift("shl"),
    "shift_right_arithmetic": shift("ashr"),
    "shift_right_logical": shift("lshr"),
    "select_n": selection,
    "clamp": clamp,
    "convert_element_type": conversion,
    "bitcast_convert_type": bits,
    "nextafter": inline_jax(next_after),
    "logistic": inline_jax(lambda x: 1 / (1 + jnp.exp(-x))),
    "pow": power,
    "log": elementary("log", log_float32),
    "exp": elementary("exp", exp_float32),
    **{
        name: elementary(name)
        for name in (
            "exp2 expm1 log1p log2 cbrt sin cos tan asin acos atan atan2 sinh cosh tanh asinh "
            "acosh atanh erf erfc".split()
        )
    },
}
"""By primitive: (emitter, parameters, types of operands, *vectors) -> vector."""
