"""Functions of one cell as machine code that works on several cells at once.

XLA makes of a function that is mapped over a tile of cells a loop over the tile for each part that
it sees as a whole. There, all wait for the slowest cell of the tile, a loop gives one result, and
what several have in common is computed again for each. Here the jaxpr of the same function is read
number by number (`scalars`) and written as one program for LLVM, in which a number is a vector of
as many cells as one of 512 bits holds. A loop goes on until it has ended for all of these; those
for which it has keep their values. So a slow cell holds up seven others, nothing is computed
twice, and what lies between start and end of a cell never leaves the core.

What comes out is what XLA computes, to rounding; but a product with a number known to be zero is
zero, whatever the other factor. Loops of a known number of turns (`lax.scan`), sorting, indices
that are computed, and types of 16 bits have no kernel. Programs are compiled for the processor at
hand.
"""

import contextlib
import ctypes
import functools
import math
import sys
import time
from collections.abc import Callable
from typing import Any, no_type_check

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive
from jaxtyping import PyTree
from llvmlite import ir

from walker_jax.checks import WrongUse
from walker_jax.scalars import Unrolling, is_number

BITS = 512
"""Of a vector; LLVM makes shorter ones of it where the processor has no such."""

LARGEST = 1000
"""Numbers that go into a program, of what cells share and of one cell."""

long_programs = jax.make_user_context(False)
"""Whether a function is traced for a kernel, and so may be longer than XLA has it."""


class NoKernel(NotImplementedError):
    """A function holds a primitive or a type, which the error names, that no kernel can do."""


FLOATS = {np.dtype(np.float32): ir.FloatType(), np.dtype(np.float64): ir.DoubleType()}


class Complex:
    """A complex entry, of two real ones."""

    def __init__(self, real, imag):
        self.real, self.imag = real, imag


@no_type_check  # as its base
class Writer(Unrolling):
    """A jaxpr written as LLVM instructions: an entry is a number, a vector of one, or `Complex`."""

    def __init__(self, builder: ir.IRBuilder, lanes: int):
        super().__init__()
        self.builder = builder
        self.lanes = lanes
        self.active: Any = None
        """Which lanes are at work, where not all are."""

    # Types and constants.

    def scalar_type(self, dtype):
        try:
            dtype = np.dtype(dtype)
        except TypeError:  # one of JAX's own
            raise NoKernel(str(dtype)) from None
        if dtype.kind == "b":
            return ir.IntType(1)
        if dtype in FLOATS:
            return FLOATS[dtype]
        if dtype.kind in "iu":
            return ir.IntType(8 * dtype.itemsize)
        raise NoKernel(str(dtype))

    def type(self, dtype):
        return ir.VectorType(self.scalar_type(dtype), self.lanes)

    def vector(self, entry, dtype) -> Any:
        """An entry as a vector."""
        if not is_number(entry):
            return entry
        kind = self.scalar_type(dtype)
        value = np.asarray(entry, dtype).item()
        value = int(value) if isinstance(kind, ir.IntType) else value
        return ir.Constant(self.type(dtype), [ir.Constant(kind, value)] * self.lanes)

    def intrinsic(self, name: str, *operands: Any, result: ir.Type | None = None):
        kind = operands[0].type if result is None else result
        letter = lambda t: f"v{t.count}{self.letter(t.element)}"
        types = [kind, operands[0].type] if result is not None else [kind]
        full = ".".join([f"llvm.{name}", *map(letter, types)])
        module = self.builder.module
        function = module.globals.get(full)
        if function is None:
            function = ir.Function(
                module, ir.FunctionType(kind, [operand.type for operand in operands]), full
            )
        return self.builder.call(function, operands, fastmath=FAST if is_float(kind) else ())

    def by_library(self, name: str, dtype, *operands: Any):
        """A function of the C library, one cell after the other."""
        kind, builder = self.scalar_type(dtype), self.builder
        full = name + ("f" if dtype == np.float32 else "")
        if not in_library(full):
            raise NoKernel(name)
        function = builder.module.globals.get(full)
        if function is None:
            function = ir.Function(
                builder.module, ir.FunctionType(kind, [kind] * len(operands)), full
            )
        result = ir.Constant(self.type(dtype), ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            values = [builder.extract_element(operand, place) for operand in operands]
            result = builder.insert_element(result, builder.call(function, values), place)
        return result

    @staticmethod
    def letter(kind) -> str:
        if isinstance(kind, ir.IntType):
            return f"i{kind.width}"
        return "f64" if isinstance(kind, ir.DoubleType) else "f32"

    # Values.

    def split(self, value) -> np.ndarray:
        if isinstance(value, jax.Array):
            value = np.asarray(value)
        if np.iscomplexobj(value):
            entries = np.empty(np.shape(value), object)
            for place in np.ndindex(entries.shape):
                number = complex(value[place])
                entries[place] = Complex(number.real, number.imag)
            return entries
        return super().split(value)

    def evaluate(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        if all(map(is_number, operands)):
            return super().evaluate(primitive, params, operands, dtypes)
        rule = RULES.get(primitive.name)
        if rule is None or any(isinstance(operand, Complex) for operand in operands):
            raise NoKernel(primitive.name)
        vectors = [self.vector(x, dtype) for x, dtype in zip(operands, dtypes, strict=True)]
        return rule(self, params, dtypes, *vectors)

    def term(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        name = primitive.name
        if name == "select_n" and is_number(operands[0]):
            return operands[1 + int(operands[0])]
        if name in ("select_n", "stop_gradient", "convert_element_type", "copy", "copy_p") and any(
            isinstance(operand, Complex) for operand in operands
        ):
            part = lambda which: [getattr(o, which, o) for o in operands]
            real = np.dtype(np.float32 if dtypes[-1] == np.complex64 else np.float64)
            dtypes = [real if np.dtype(d).kind == "c" else d for d in dtypes]
            parts = (self.term(primitive, params, part(p), dtypes) for p in ("real", "imag"))
            return Complex(*parts)
        if name == "stop_gradient":
            return operands[0]
        return super().term(primitive, params, operands, dtypes)

    def apply(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        name, params = equation.primitive.name, equation.params
        if name in ("complex", "real", "imag"):
            result = np.empty(equation.outvars[0].aval.shape, object)
            for place in np.ndindex(*result.shape):
                entries = [operand[place] for operand in operands]
                result[place] = (
                    Complex(*entries) if name == "complex" else getattr(entries[0], name)
                )
            return [result]
        if name in ("custom_jvp_call", "custom_vjp_call"):
            return self.interpret(params["call_jaxpr"], operands)
        if name in REDUCTIONS:
            return [self.reduce(REDUCTIONS[name], operands[0], params["axes"], equation)]
        if name == "while":
            return self.loop(params, operands)
        if name == "cond":
            return self.choice(params, operands)
        return super().apply(equation, operands)

    def keep(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        if all(is_number(entry) for operand in operands for entry in operand.ravel()):
            with contextlib.suppress(TypeError):  # a key to random numbers, which has no digits
                return super().keep(equation, operands)
        raise NoKernel(equation.primitive.name)

    def reduce(self, primitive: Primitive, operand: np.ndarray, axes, equation) -> np.ndarray:
        like = equation.outvars[0].aval
        if operand.size == 0:
            raise NoKernel(equation.primitive.name)
        moved = np.moveaxis(operand, axes, range(len(axes)))
        result = np.empty(like.shape, object)
        for place in np.ndindex(*like.shape):
            first, *others = moved[(..., *place)].ravel()
            for other in others:
                first = self.term(primitive, {}, [first, other], [like.dtype] * 2)
            result[place] = first
        return result

    # Loops.

    def loop(self, params: dict, operands: list[np.ndarray]) -> list[np.ndarray]:
        """A while loop. Lanes that have ended keep their values until the last one has."""
        condition, body = params["cond_jaxpr"], params["body_jaxpr"]
        count, more = params["cond_nconsts"], params["body_nconsts"]
        of_condition, of_body = operands[:count], operands[count : count + more]
        carry = operands[count + more :]

        if runs_once(condition.jaxpr, body.jaxpr, carry, count, more):
            return self.interpret(body, [*of_body, *carry])

        avals = [variable.aval for variable in body.jaxpr.outvars]
        flat, kinds = self.flattened(carry, avals)
        initial = [self.vector(x, dtype) for x, dtype in zip(flat, kinds, strict=True)]
        builder = self.builder
        before = builder.block
        head = builder.append_basic_block("head")
        turn = builder.append_basic_block("turn")
        done = builder.append_basic_block("done")
        builder.branch(head)
        builder.position_at_end(head)
        phis = [builder.phi(value.type) for value in initial]
        for phi, value in zip(phis, initial, strict=True):
            phi.add_incoming(value, before)

        known, lanes = len(self.known), self.active
        values = self.gathered(phis, avals)
        ((going,),) = map(np.ravel, self.interpret(condition, [*of_condition, *values]))
        going = self.vector(going, bool)
        if lanes is not None:
            going = builder.and_(going, lanes)
        bits = builder.bitcast(going, ir.IntType(self.lanes))
        builder.cbranch(
            builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(self.lanes), 0)), turn, done
        )

        builder.position_at_end(turn)
        self.active = going
        results, _ = self.flattened(self.interpret(body, [*of_body, *values]), avals)
        for phi, result, dtype in zip(phis, results, kinds, strict=True):
            new = builder.select(going, self.vector(result, dtype), phi)
            phi.add_incoming(new, builder.block)
        builder.branch(head)
        builder.position_at_end(done)
        self.active = lanes
        while len(self.known) > known:  # of what came before or after a loop, none is from inside
            self.known.popitem()
        return self.gathered(phis, avals)

    def choice(self, params: dict, operands: list[np.ndarray]) -> list[np.ndarray]:
        """One of several functions: all are computed, unless it is known which is wanted."""
        branches, (which, *inputs) = params["branches"], operands
        index = which[()]
        if is_number(index):
            branches = [branches[min(max(int(index), 0), len(branches) - 1)]]
        results, lanes = [], self.active
        avals = [variable.aval for variable in branches[0].jaxpr.outvars]
        for i, branch in enumerate(branches):
            if len(branches) > 1:
                mine = self.builder.icmp_signed("==", index, self.vector(i, np.int32))
                self.active = mine if lanes is None else self.builder.and_(mine, lanes)
            results.append(self.flattened(self.interpret(branch, inputs), avals))
        self.active = lanes
        chosen, kinds = results[-1]
        for i, (entries, _) in reversed(list(enumerate(results[:-1]))):
            before = self.builder.icmp_signed("<=", index, self.vector(i, np.int32))
            chosen = [
                self.builder.select(before, self.vector(one, dtype), self.vector(other, dtype))
                for one, other, dtype in zip(entries, chosen, kinds, strict=True)
            ]
        return self.gathered(chosen, avals)

    def flattened(self, arrays: list[np.ndarray], avals) -> tuple[list, list]:
        """All entries of arrays, complex ones as two, and their types."""
        flat, kinds = [], []
        for array, aval in zip(arrays, avals, strict=True):
            for entry in array.ravel():
                if isinstance(entry, Complex):
                    flat += [entry.real, entry.imag]
                    kinds += [np.finfo(aval.dtype).dtype] * 2
                else:
                    flat.append(entry)
                    kinds.append(aval.dtype)
        return flat, kinds

    def gathered(self, flat: list, avals) -> list[np.ndarray]:
        """The arrays of such a list."""
        remaining = iter(flat)
        arrays = []
        for aval in avals:
            result = np.empty(aval.shape, object)
            for place in np.ndindex(aval.shape):
                pair = np.dtype(aval.dtype).kind == "c"
                result[place] = (
                    Complex(next(remaining), next(remaining)) if pair else next(remaining)
                )
            arrays.append(result)
        return arrays

    def inline(self, function: Callable, *vectors: Any, dtype) -> Any:
        """A function of JAX scalars."""
        like = [jax.ShapeDtypeStruct((), dtype)] * len(vectors)
        closed = jax.make_jaxpr(function)(*like)
        inputs = []
        for vector in vectors:
            entry = np.empty((), object)
            entry[()] = vector
            inputs.append(entry)
        (result,) = self.interpret(closed, inputs)
        return self.vector(result[()], dtype)


def runs_once(condition: Jaxpr, body: Jaxpr, carry: list, count: int, more: int) -> bool:
    """Whether a loop is one of a single turn, whose condition hangs on a flag that the body sets.

    That is how `integrate.once` keeps XLA from computing its results several times.
    """
    if count or len(condition.eqns) != 1 or condition.eqns[0].primitive.name != "not":
        return False
    (flag,) = condition.eqns[0].invars
    if condition.outvars[0] is not condition.eqns[0].outvars[0] or flag not in condition.invars:
        return False
    place = condition.invars.index(flag)
    first, last = carry[place][()], body.outvars[place]
    return is_number(first) and not first and isinstance(last, Literal) and bool(last.val)


# Where the C library has its mathematics.
LIBRARY = {"linux": "libm.so.6", "darwin": "/usr/lib/libSystem.B.dylib", "win32": "ucrtbase"}


@functools.cache
def in_library(name: str) -> bool:
    """Whether the C library has a function that programs can call."""
    if llvm.address_of_symbol(name) is None and sys.platform in LIBRARY:
        with contextlib.suppress(RuntimeError):  # it is not there
            llvm.load_library_permanently(LIBRARY[sys.platform])
    return llvm.address_of_symbol(name) is not None


FAST = ("contract",)
"""Multiply and add at once, as XLA does; nothing else that IEEE arithmetic forbids."""


def is_float(kind) -> bool:
    return isinstance(getattr(kind, "element", kind), (ir.FloatType, ir.DoubleType))


def is_floating(dtype) -> bool:
    return np.dtype(dtype).kind == "f"


def arithmetic(of_float: str, of_int: str):
    def rule(writer, params, dtypes, *operands):
        if is_floating(dtypes[0]):
            return getattr(writer.builder, of_float)(*operands, flags=FAST)
        return getattr(writer.builder, of_int)(*operands)

    return rule


def unary(name: str):
    return lambda writer, params, dtypes, x: writer.intrinsic(name, x)


def extremum(of_float: str, of_int: str):
    def rule(writer, params, dtypes, a, b):
        if is_floating(dtypes[0]):
            return writer.intrinsic(of_float, a, b)
        return writer.intrinsic(of_int.replace("?", signed(dtypes[0])), a, b)

    return rule


def signed(dtype) -> str:
    return "s" if np.dtype(dtype).kind == "i" else "u"


def comparison(sign: str):
    def rule(writer, params, dtypes, a, b):
        builder = writer.builder
        if is_floating(dtypes[0]):
            ordered = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
            return ordered(sign, a, b)
        compare = builder.icmp_signed if signed(dtypes[0]) == "s" else builder.icmp_unsigned
        return compare(sign, a, b)

    return rule


def negation(writer, params, dtypes, x):
    return writer.builder.fneg(x, flags=FAST) if is_floating(dtypes[0]) else writer.builder.neg(x)


def absolute(writer, params, dtypes, x):
    if is_floating(dtypes[0]):
        return writer.intrinsic("fabs", x)
    return writer.builder.select(
        writer.builder.icmp_signed("<", x, writer.vector(0, dtypes[0])), writer.builder.neg(x), x
    )


def division(writer, params, dtypes, a, b):
    if is_floating(dtypes[0]):
        return writer.builder.fdiv(a, b, flags=FAST)
    return whole(writer, dtypes[0], "div", a, b)


def remainder(writer, params, dtypes, a, b):
    if is_floating(dtypes[0]):
        return writer.by_library("fmod", dtypes[0], a, b)
    return whole(writer, dtypes[0], "rem", a, b)


def whole(writer, dtype, name: str, a, b):
    """A quotient or remainder of integers, which are what XLA has where there is none.

    The processor must not come to divide by zero, or the least integer by -1, in any lane.
    """
    builder, equal = writer.builder, lambda x, value: writer.builder.icmp_signed("==", x, value)
    zero, one, ones = (
        writer.vector(value, dtype)
        for value in (0, 1, -1 if signed(dtype) == "s" else np.iinfo(dtype).max)
    )
    none = equal(b, zero)
    wrong = none
    if signed(dtype) == "s":
        least = writer.vector(np.iinfo(dtype).min, dtype)
        wrong = builder.or_(none, builder.and_(equal(a, least), equal(b, ones)))
    result = getattr(builder, f"{signed(dtype)}{name}")(a, builder.select(wrong, one, b))
    return builder.select(none, ones if name == "div" else a, result)


def power(writer, params, dtypes, x):
    """x^y for an integer y, by repeated squaring."""
    y = params["y"]
    multiply = lambda a, b: writer.builder.fmul(a, b, flags=FAST)
    if not is_floating(dtypes[0]):
        multiply = writer.builder.mul
    result, square, left = None, x, abs(y)
    while left:
        if left & 1:
            result = square if result is None else multiply(result, square)
        left >>= 1
        if left:
            square = multiply(square, square)
    one = writer.vector(1, dtypes[0])
    if result is None:
        return one
    return writer.builder.fdiv(one, result, flags=FAST) if y < 0 else result


def raised(writer, params, dtypes, x, y):
    """x^y, where y may be of another type."""
    if dtypes[1] != dtypes[0]:
        y = conversion(writer, {"new_dtype": dtypes[0]}, [dtypes[1]], y)
    return writer.by_library("pow", dtypes[0], x, y)


def selection(writer, params, dtypes, which, *cases):
    if np.dtype(dtypes[0]).kind != "b" or len(cases) != 2:
        raise NoKernel("select_n")
    return writer.builder.select(which, cases[1], cases[0])


def conversion(writer, params, dtypes, x):
    builder, old, new = writer.builder, np.dtype(dtypes[0]), np.dtype(params["new_dtype"])
    kind = writer.type(new)
    if old == new:
        return x
    if new.kind == "b":
        zero = writer.vector(0, old)
        if is_floating(old):
            return builder.fcmp_unordered("!=", x, zero)
        return builder.icmp_unsigned("!=", x, zero)
    if is_floating(old):
        if is_floating(new):
            return (builder.fpext if new.itemsize > old.itemsize else builder.fptrunc)(x, kind)
        return saturated(writer, old, new, x)
    if is_floating(new):
        return (builder.sitofp if old.kind == "i" else builder.uitofp)(x, kind)
    if new.itemsize > old.itemsize or old.kind == "b":
        return (builder.sext if old.kind == "i" else builder.zext)(x, kind)
    return builder.trunc(x, kind) if new.itemsize < old.itemsize else x


def saturated(writer, old, new, x):
    """The nearest integer of a type that is not beyond x; zero for NaN."""
    builder, info = writer.builder, np.iinfo(new)
    low, high = float(info.min), -float(info.min) if info.min else float(info.max) + 1
    low, high = writer.vector(low, old), writer.vector(high, old)
    inside = builder.and_(builder.fcmp_ordered(">=", x, low), builder.fcmp_ordered("<", x, high))
    convert = builder.fptosi if signed(new) == "s" else builder.fptoui
    value = convert(builder.select(inside, x, writer.vector(0, old)), writer.type(new))
    value = builder.select(builder.fcmp_ordered(">=", x, high), writer.vector(info.max, new), value)
    return builder.select(builder.fcmp_ordered("<", x, low), writer.vector(info.min, new), value)


def finite(writer, params, dtypes, x):
    size = writer.intrinsic("fabs", x)
    return writer.builder.fcmp_ordered("<", size, writer.vector(np.inf, dtypes[0]))


def sign(writer, params, dtypes, x):
    zero, one = writer.vector(0, dtypes[0]), writer.vector(1, dtypes[0])
    builder = writer.builder
    if is_floating(dtypes[0]):
        return builder.select(
            builder.fcmp_ordered("!=", x, zero), writer.intrinsic("copysign", one, x), x
        )
    unit = one
    if signed(dtypes[0]) == "s":
        unit = builder.select(builder.icmp_signed("<", x, zero), writer.vector(-1, dtypes[0]), one)
    return builder.select(builder.icmp_unsigned("==", x, zero), zero, unit)


def rounding(writer, params, dtypes, x):
    even = params["rounding_method"] == lax.RoundingMethod.TO_NEAREST_EVEN
    return writer.intrinsic("roundeven" if even else "round", x)


def logical(name: str):
    return lambda writer, params, dtypes, a, b: getattr(writer.builder, name)(a, b)


def clamp(writer, params, dtypes, low, x, high):
    return RULES["min"](writer, {}, dtypes, RULES["max"](writer, {}, dtypes, x, low), high)


def shift(name: str):
    """By as many bits as there are, or more, nothing but the sign is left."""

    def rule(writer, params, dtypes, x, by):
        builder, last = writer.builder, 8 * np.dtype(dtypes[0]).itemsize - 1
        inside = builder.icmp_unsigned("<=", by, writer.vector(last, dtypes[0]))
        arithmetic = name == "ashr"
        outside = writer.vector(last if arithmetic else 0, dtypes[0])
        shifted = getattr(builder, name)(x, builder.select(inside, by, outside))
        zero = writer.vector(0, dtypes[0])
        return shifted if arithmetic else builder.select(inside, shifted, zero)

    return rule


def bits(writer, params, dtypes, x):
    if np.dtype(params["new_dtype"]).itemsize != np.dtype(dtypes[0]).itemsize:
        raise NoKernel("bitcast_convert_type")
    return writer.builder.bitcast(x, writer.type(params["new_dtype"]))


def elementary(name: str, of_float32: Callable | None = None):
    """A function of the C library, cell by cell; or one of JAX's primitives, for float32."""

    def rule(writer, params, dtypes, *operands):
        if of_float32 is not None and dtypes[0] == np.float32:
            return writer.inline(of_float32, *operands, dtype=np.float32)
        return writer.by_library(name, dtypes[0], *operands)

    return rule


def log_float32(x):
    """log(x) of a normal number, right to about 1e-7 of the larger of it and 1."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    # x = 2^e m, with m between sqrt(1/2) and sqrt(2)
    e = lax.shift_right_arithmetic(bits - 0x3F3504F3, jnp.int32(23))
    m = lax.bitcast_convert_type(bits - lax.shift_left(e, jnp.int32(23)), jnp.float32)
    # log(m) = 2 artanh(s)
    s = (m - 1) / (m + 1)
    z = s * s
    series = 2 * s * (1 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z / 9))))
    value = e.astype(jnp.float32) * jnp.float32(np.log(2)) + series
    value = jnp.where(x == jnp.inf, x, value)
    value = jnp.where(x > 0, value, jnp.where(x == 0, -jnp.inf, jnp.nan)).astype(jnp.float32)
    return value


def exp_float32(x):
    """exp(x), right to about 1e-7 of it."""
    x = jnp.minimum(jnp.maximum(x, jnp.float32(-104)), jnp.float32(89))
    n = lax.round(x * jnp.float32(1 / np.log(2)), lax.RoundingMethod.TO_NEAREST_EVEN)
    r = x - n * jnp.float32(0.693359375) + n * jnp.float32(2.12194440e-4)
    value = jnp.float32(1 / 5040)
    for k in (720, 120, 24, 6, 2, 1, 1):
        value = value * r + jnp.float32(1 / k)
    half = lax.shift_right_arithmetic(n.astype(jnp.int32), jnp.int32(1))

    def two_to(k):
        return lax.bitcast_convert_type(lax.shift_left(k + 127, jnp.int32(23)), jnp.float32)

    return value * two_to(half) * two_to(n.astype(jnp.int32) - half)


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
    "rsqrt": lambda writer, params, dtypes, x: writer.builder.fdiv(
        writer.vector(1, dtypes[0]), writer.intrinsic("sqrt", x), flags=FAST
    ),
    "floor": unary("floor"),
    "ceil": unary("ceil"),
    "round": rounding,
    "sign": sign,
    "integer_pow": power,
    "square": lambda writer, params, dtypes, x: power(writer, {"y": 2}, dtypes, x),
    "is_finite": finite,
    "eq": comparison("=="),
    "ne": comparison("!="),
    "lt": comparison("<"),
    "le": comparison("<="),
    "gt": comparison(">"),
    "ge": comparison(">="),
    "and": logical("and_"),
    "or": logical("or_"),
    "xor": logical("xor"),
    "not": lambda writer, params, dtypes, x: writer.builder.not_(x),
    "shift_left": shift("shl"),
    "shift_right_arithmetic": shift("ashr"),
    "shift_right_logical": shift("lshr"),
    "select_n": selection,
    "clamp": clamp,
    "convert_element_type": conversion,
    "bitcast_convert_type": bits,
    "pow": raised,
    "log": elementary("log", log_float32),
    "exp": elementary("exp", exp_float32),
    **{
        name: elementary(name)
        for name in (
            "exp2 expm1 log1p cbrt sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh "
            "atanh erf".split()
        )
    },
}
"""Primitives of real scalars, as instructions."""


class Kernel:
    """A compiled function of (shared, cell), for arrays of cells."""

    def __init__(self, function: Callable, shared: PyTree, cell: PyTree):
        """Compile it for leaves of these shapes and types. `NoKernel` where that cannot be."""
        start = time.perf_counter()
        with long_programs(True):
            closed, shapes = jax.make_jaxpr(function, return_shape=True)(shared, cell)
        self.structure = jax.tree.structure(shapes)
        avals = [variable.aval for variable in closed.jaxpr.invars]
        split = len(jax.tree.leaves(shared))
        if sum(math.prod(aval.shape) for aval in avals) > LARGEST:
            raise NoKernel(f"more than {LARGEST} numbers")
        described = lambda leaves: [(leaf.shape, np.dtype(leaf.dtype)) for leaf in leaves]
        self.shared, self.cell = described(avals[:split]), described(avals[split:])
        self.results = described(jax.tree.leaves(shapes))
        self.run = compiled(written(closed, self.shared, self.cell, self.results))
        seconds = time.perf_counter() - start
        jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)

    def bind(
        self, shared: PyTree, cells: PyTree, n: int
    ) -> tuple[Callable[[int, int], None], PyTree[np.ndarray]]:
        """A function that computes results[start:stop] of n cells, and the results, still empty.

        It may run in several threads at once.
        """
        results = [np.empty((n, *shape), dtype) for shape, dtype in self.results]
        given = contiguous(shared, self.shared) + contiguous(cells, self.cell, n)
        arrays = [*given, *results]
        pointers = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        # The arrays must live as long as it does.
        compute = lambda start, stop, _=arrays: self.run(start, stop, pointers)
        return compute, jax.tree.unflatten(self.structure, results)


def contiguous(tree: PyTree, like: list, *lead: int) -> list[np.ndarray]:
    """The leaves of a tree as a kernel reads them: of these shapes and types, in C's order."""
    pairs = zip(jax.tree.leaves(tree), like, strict=True)
    arrays = [np.ascontiguousarray(leaf, dtype) for leaf, (_, dtype) in pairs]
    for array, (shape, _) in zip(arrays, like, strict=True):
        if array.size != math.prod((*lead, *shape)):
            raise WrongUse(f"shape {array.shape} of an array must be {(*lead, *shape)}")
    return arrays


def written(closed: ClosedJaxpr, shared: list, cell: list, results: list) -> str:
    """A program that computes results[start:stop]: void kernel(start, stop, addresses).

    The addresses are of the arrays that cells share, then of those of cells and of results.
    """
    floats = [dtype.itemsize for _, dtype in (*cell, *results) if is_floating(dtype)]
    lanes = BITS // 8 // max(floats, default=8)
    module = ir.Module("kernel")
    number, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [number, number, pointer.as_pointer()])
    function = ir.Function(module, kind, "kernel")
    start, stop, addresses = function.args
    before, head, turn, done = map(function.append_basic_block, ("before", "head", "turn", "done"))
    builder = ir.IRBuilder(before)
    writer = Writer(builder, lanes)
    long = lambda value: ir.Constant(number, value)
    lane = lambda value: ir.Constant(ir.IntType(32), value)

    def in_memory(dtype):
        return ir.IntType(8) if dtype.kind == "b" else writer.scalar_type(dtype)

    def array_at(i: int, dtype):
        address = builder.load(builder.gep(addresses, [long(i)]))
        return builder.bitcast(address, in_memory(dtype).as_pointer())

    arrays = [array_at(i, dtype) for i, (_, dtype) in enumerate((*shared, *cell, *results))]
    of_shared = arrays[: len(shared)]
    of_cells = arrays[len(shared) : len(shared) + len(cell)]

    def load(array, places: list, dtype):
        """A vector of what stands at each lane's place of an array."""
        vector = ir.Constant(ir.VectorType(in_memory(dtype), lanes), ir.Undefined)
        for i, place in enumerate(places):
            value = builder.load(builder.gep(array, [place]))
            vector = builder.insert_element(vector, value, lane(i))
        return builder.trunc(vector, writer.type(dtype)) if dtype.kind == "b" else vector

    def entries(array, shape, dtype, places_of: Callable[[int], list]):
        values = np.empty(shape, object)
        for i, place in enumerate(np.ndindex(*shape)):
            values[place] = load(array, places_of(i), dtype)
        return values

    constants = [
        entries(array, shape, dtype, lambda i: [long(i)] * lanes)
        for array, (shape, dtype) in zip(of_shared, shared, strict=True)
    ]
    last = builder.sub(stop, long(1))
    builder.branch(head)

    builder.position_at_end(head)
    first = builder.phi(number)
    first.add_incoming(start, before)
    builder.cbranch(builder.icmp_signed("<", first, stop), turn, done)

    builder.position_at_end(turn)
    # Lanes beyond the last cell work on that one too, and write the same results.
    cells = []
    for i in range(lanes):
        mine = builder.add(first, long(i))
        cells.append(builder.select(builder.icmp_signed("<", mine, last), mine, last))

    def places_in(shape) -> Callable[[int], list]:
        size = math.prod(shape)
        return lambda i: [builder.add(builder.mul(one, long(size)), long(i)) for one in cells]

    inputs = [
        entries(array, shape, dtype, places_in(shape))
        for array, (shape, dtype) in zip(of_cells, cell, strict=True)
    ]
    outputs = writer.interpret(closed, constants + inputs)
    ends = zip(arrays[len(arrays) - len(results) :], outputs, results, strict=True)
    for array, output, (shape, dtype) in ends:
        for i, place in enumerate(np.ndindex(*shape)):
            vector = writer.vector(output[place], dtype)
            if dtype.kind == "b":
                vector = builder.zext(vector, ir.VectorType(in_memory(dtype), lanes))
            for j, where in enumerate(places_in(shape)(i)):
                value = builder.extract_element(vector, lane(j))
                builder.store(value, builder.gep(array, [where]))
    first.add_incoming(builder.add(first, long(lanes)), builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    builder.ret_void()
    return str(module)


def compiled(source: str) -> Callable[[int, int, Any], None]:
    """The machine code of a program, for this processor."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        jit=True,
    )
    module = llvm.parse_assembly(source)
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)
    call = kind(engine.get_function_address("kernel"))
    engines.append(engine)
    return call


engines: list = []
"""What holds the machine code: it lasts as long as the process."""
