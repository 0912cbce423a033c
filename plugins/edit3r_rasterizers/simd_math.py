"""Exponential and logarithm to base 2 of vectors."""

import math

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from edit3r_rasterizers.simd import DOUBLES, FLOATS, bit_constant, constant


def _exp2_coefficients(degree: int = 5) -> list[float]:
    """Polynomial for 2^f on [-1/2, 1/2], relative error 1e-7, lowest power first."""
    nodes = 0.5 * np.cos(np.pi * (np.arange(256) + 0.5) / 256)
    fitted = np.polynomial.polynomial.polyfit(nodes, 2.0**nodes, degree, w=2.0**-nodes)
    return [float(np.float32(value)) for value in fitted]


_EXP2 = _exp2_coefficients()
_ROUNDER = 1.5 * 2**23  # adding it leaves the nearest integer in the low bits of the mantissa
_SERIES = [2 / math.log(2) / power for power in range(1, 12, 2)]  # log2((1 + s) / (1 - s)) in odd powers of s


def _horner(builder, kind, coefficients, x):
    result = constant(kind, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        product = builder.fmul(result, x, flags=("contract",))
        result = builder.fadd(product, constant(kind, coefficient), flags=("contract",))
    return result


@intrinsic
def exp2(typing, a):
    """2^a of float32 lanes in [-120, 120], relative error 2e-7."""

    def emit(context, builder, signature, values):
        rounder = constant(FLOATS, _ROUNDER)
        shifted = builder.fadd(values[0], rounder)
        fraction = builder.fsub(values[0], builder.fsub(shifted, rounder))
        power = builder.bitcast(_horner(builder, FLOATS, _EXP2, fraction), FLOATS.bits)
        exponent = builder.shl(builder.bitcast(shifted, FLOATS.bits), bit_constant(FLOATS, 23))
        return builder.bitcast(builder.add(power, exponent), FLOATS.ir)

    return FLOATS(FLOATS), emit


@intrinsic
def log2(typing, a):
    """log2(a) of positive normal float64 lanes, absolute error 1e-10."""

    def emit(context, builder, signature, values):
        bits = builder.bitcast(values[0], DOUBLES.bits)
        # Exponent of a / sqrt(1/2), so that the mantissa that is left lies in [sqrt(1/2), sqrt(2)).
        half_root = int(np.float64(math.sqrt(0.5)).view(np.int64))
        exponent = builder.ashr(builder.sub(bits, bit_constant(DOUBLES, half_root)), bit_constant(DOUBLES, 52))
        mantissa = builder.sub(bits, builder.shl(exponent, bit_constant(DOUBLES, 52)))
        m = builder.bitcast(mantissa, DOUBLES.ir)
        one = constant(DOUBLES, 1.0)
        s = builder.fdiv(builder.fsub(m, one), builder.fadd(m, one))
        series = _horner(builder, DOUBLES, _SERIES, builder.fmul(s, s))
        return builder.fadd(builder.sitofp(exponent, ir.VectorType(ir.DoubleType(), 8)), builder.fmul(s, series))

    return DOUBLES(DOUBLES), emit
