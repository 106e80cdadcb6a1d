"""Powers of vectors with a known exponent, x^a = exp(a log(x)), exact to about one unit in 2^52.

The product a log(x) reaches 700, and its absolute error is the relative error of the power. So the
logarithm and the product are sums of two numbers, the second of which is the rounding error of the
first (double-double arithmetic).
"""

import math
from typing import no_type_check

import numpy as np
from llvmlite import ir

LN2_HIGH = float(np.float32(math.log(2)))
"""High part of log(2), with 24 bits: its product with a binary exponent is exact."""
LN2_LOW = float(np.longdouble("0.693147180559945309417232121458176568") - np.longdouble(LN2_HIGH))
"""log(2) less its high part, rounded to float64."""
SQRT_HALF = int(np.float64(math.sqrt(0.5)).view(np.int64))
"""Bits of sqrt(1/2) as an integer: the lower bound of mantissas in `log_as_sum`."""
ODD_TERMS = 13
"""Terms of artanh(s) = s + s^3 / 3 + ...; s is at most 0.172 in `log_as_sum`."""
EXPONENTIAL_TERMS = 14
"""Terms of exp(r) for r up to log(2) / 2 = 0.347."""


@no_type_check  # as the emitter
class Arithmetic:
    """Instructions on vectors of float64, each rounded once and not reordered."""

    def __init__(self, emitter):
        self.emitter, self.builder = emitter, emitter.builder
        self.float, self.int = emitter.type(np.float64), emitter.type(np.int64)

    def number(self, value):
        return self.emitter.vector(value, np.float64) if isinstance(value, float) else value

    def integer(self, value: int):
        return self.emitter.vector(value, np.int64)

    def add(self, a, b):
        return self.builder.fadd(self.number(a), self.number(b))

    def sub(self, a, b):
        return self.builder.fsub(self.number(a), self.number(b))

    def mul(self, a, b):
        return self.builder.fmul(self.number(a), self.number(b))

    def div(self, a, b):
        return self.builder.fdiv(self.number(a), self.number(b))

    def fma(self, a, b, c):
        return self.emitter.intrinsic("fma", *map(self.number, (a, b, c)))

    def less(self, a, b):
        return self.builder.fcmp_ordered("<", self.number(a), self.number(b))

    def equal(self, a, b):
        return self.builder.fcmp_ordered("==", self.number(a), self.number(b))

    def select(self, which, one, other):
        return self.builder.select(which, self.number(one), self.number(other))

    def polynomial(self, coefficients: list[float], x):
        *others, result = coefficients
        for coefficient in reversed(others):
            result = self.fma(result, x, coefficient)
        return result

    def bits(self, x):
        return self.builder.bitcast(x, self.int)

    def from_bits(self, x):
        return self.builder.bitcast(x, self.float)

    def two_to(self, n):
        """2^n for integers n that are exponents of normal numbers."""
        return self.from_bits(
            self.builder.shl(self.builder.add(n, self.integer(1023)), self.integer(52))
        )


@no_type_check
def known_exponent(y) -> float | None:
    """Return the number in all lanes of a constant vector; None if it is an integer or varies."""
    if not isinstance(y, ir.Constant):
        return None
    value = y.constant[0].constant
    return None if not math.isfinite(value) or value == int(value) else value


@no_type_check
def power_of_known(emitter, x, exponent: float):
    """Return x^exponent, for a vector of float64."""
    calc = Arithmetic(emitter)
    high, low = log_as_sum(calc, calc.emitter.intrinsic("fabs", x))
    product = calc.mul(high, exponent)
    rest = calc.fma(low, exponent, calc.fma(high, exponent, calc.sub(-0.0, product)))
    result = exp_of_sum(calc, product, rest)
    ends = (0.0, math.inf) if exponent > 0 else (math.inf, 0.0)
    size = emitter.intrinsic("fabs", x)
    result = calc.select(calc.less(x, 0.0), math.nan, result)
    result = calc.select(calc.equal(size, 0.0), ends[0], result)
    result = calc.select(calc.equal(size, math.inf), ends[1], result)
    return calc.select(calc.builder.fcmp_unordered("uno", x, x), x, result)


@no_type_check
def log_as_sum(calc, x):
    """Return log(x) for x > 0, as a sum of two numbers."""
    builder = calc.builder
    subnormal = calc.less(x, float(np.finfo(np.float64).tiny))
    x = calc.select(subnormal, calc.mul(x, 2.0**54), x)
    # x = 2^e m, with m between sqrt(1/2) and sqrt(2)
    e = builder.ashr(builder.sub(calc.bits(x), calc.integer(SQRT_HALF)), calc.integer(52))
    m = calc.from_bits(builder.sub(calc.bits(x), builder.shl(e, calc.integer(52))))
    e = builder.sub(e, builder.select(subnormal, calc.integer(54), calc.integer(0)))
    e = builder.sitofp(e, calc.float)
    # s = (m - 1) / (m + 1), and log(m) = 2 artanh(s)
    above, below = calc.sub(m, 1.0), calc.add(m, 1.0)
    below_rest = calc.sub(m, calc.sub(below, 1.0))
    s = calc.div(above, below)
    minus_s = calc.sub(-0.0, s)
    s_rest = calc.div(calc.fma(minus_s, below_rest, calc.fma(minus_s, below, above)), below)
    square = calc.mul(s, s)
    series = calc.polynomial([2 / (2 * k + 1) for k in range(1, ODD_TERMS)], square)
    small = calc.fma(calc.mul(s, square), series, calc.mul(s_rest, 2.0))
    large, whole = calc.mul(s, 2.0), calc.mul(e, LN2_HIGH)
    # |whole| is zero or larger than |large|
    high = calc.add(whole, large)
    rounded = calc.sub(large, calc.sub(high, whole))
    return high, calc.add(rounded, calc.fma(e, LN2_LOW, small))


@no_type_check
def exp_of_sum(calc, x, rest):
    """Return exp(x + rest) for a small rest."""
    emitter, builder = calc.emitter, calc.builder
    x = emitter.intrinsic(
        "minnum", emitter.intrinsic("maxnum", x, calc.number(-800.0)), calc.number(800.0)
    )
    n = emitter.intrinsic("roundeven", calc.mul(x, 1 / math.log(2)))
    minus_n = calc.sub(-0.0, n)
    r = calc.add(calc.fma(minus_n, LN2_LOW, calc.fma(minus_n, LN2_HIGH, x)), rest)
    tail = calc.polynomial([1 / math.factorial(k) for k in range(2, EXPONENTIAL_TERMS)], r)
    value = calc.add(1.0, calc.fma(calc.mul(r, r), tail, r))
    n = builder.fptosi(n, calc.int)
    half = builder.ashr(n, calc.integer(1))
    return calc.mul(calc.mul(value, calc.two_to(half)), calc.two_to(builder.sub(n, half)))
