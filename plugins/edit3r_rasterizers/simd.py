"""Vectors as values inside numba kernels, so that the hot loops are vector code by construction.

`FLOATS` is sixteen float32 lanes, `DOUBLES` eight float64 lanes; both are 512 bits, which LLVM
splits into what the processor has (one AVX-512 register, two of AVX2, four of SSE or NEON). They
exist only inside compiled functions, where `+ - * /`, comparisons, `&` and the functions below map
to LLVM vector instructions; a scalar operand must be of the lanes' type and is broadcast. Products
and sums may fuse, nothing else is reordered: results depend on no thread.
"""

import math
import operator

import numpy as np
from llvmlite import ir

from edit3r.kit.compute.compiling import numba

cgutils = numba.core.cgutils
types = numba.types
extending = numba.extending
intrinsic = extending.intrinsic

INT32, INT64 = ir.IntType(32), ir.IntType(64)
_CONTRACT = ("contract",)


class VectorType(types.Type):
    """The numba type of a vector; `scalar` is a float type, or boolean for a mask."""

    def __init__(
        self,
        scalar: types.Type,
        width: int,
        element: ir.Type,
        integer: ir.Type | None = None,
    ) -> None:
        self.scalar, self.width = scalar, width
        self.ir = ir.VectorType(element, width)
        # the lanes taken as integers
        self.bits = ir.VectorType(integer, width) if integer else None
        super().__init__(name=f"{scalar}x{width}")


@extending.register_model(VectorType)
class _VectorModel(numba.core.datamodel.models.PrimitiveModel):
    def __init__(self, manager, numba_type) -> None:
        super().__init__(manager, numba_type, numba_type.ir)


FLOATS = VectorType(types.float32, 16, ir.FloatType(), INT32)
DOUBLES = VectorType(types.float64, 8, ir.DoubleType(), INT64)
MASKS = {
    kind: VectorType(types.boolean, kind.width, ir.IntType(1))
    for kind in (FLOATS, DOUBLES)
}
_OPERAND_PAIRS = {
    pair: kind
    for kind in (FLOATS, DOUBLES)
    for pair in ((kind, kind), (kind, kind.scalar), (kind.scalar, kind))
}
"""Types of the two operands, and the vector type they make."""


def constant(kind: VectorType, values) -> ir.Constant:
    """A vector constant; a single number fills all lanes."""
    return ir.Constant(
        kind.ir, list(values) if hasattr(values, "__len__") else [values] * kind.width
    )


def bit_constant(kind: VectorType, value: int) -> ir.Constant:
    """Integer lanes of one value, in the layout of `kind`."""
    return ir.Constant(kind.bits, [value] * kind.width)


def splat(builder, kind: VectorType, scalar):
    """All lanes equal to `scalar`."""
    undefined = ir.Constant(kind.ir, ir.Undefined)
    single = builder.insert_element(undefined, scalar, ir.Constant(INT32, 0))
    return builder.shuffle_vector(
        single,
        undefined,
        ir.Constant(ir.VectorType(INT32, kind.width), [0] * kind.width),
    )


def _widened(builder, kind: VectorType, arguments, values):
    """The operands with scalars broadcast."""
    return [
        value if given is kind else splat(builder, kind, value)
        for given, value in zip(arguments, values)
    ]


def _define_operator(function, emit, compares: bool = False) -> None:
    """Teach numba a binary operator on vectors."""

    @extending.type_callable(function)
    def typing(context):
        def typer(a, b):
            kind = _OPERAND_PAIRS.get((a, b))
            return MASKS[kind] if compares and kind else kind

        return typer

    def lower(context, builder, signature, values):
        kind = _OPERAND_PAIRS[signature.args]
        return emit(builder, *_widened(builder, kind, signature.args, values))

    for pair in _OPERAND_PAIRS:
        extending.lower_builtin(function, *pair)(lower)


for _functions, _instruction in (
    ((operator.add, operator.iadd), ir.IRBuilder.fadd),
    ((operator.sub, operator.isub), ir.IRBuilder.fsub),
    ((operator.mul, operator.imul), ir.IRBuilder.fmul),
    ((operator.truediv, operator.itruediv), ir.IRBuilder.fdiv),
):
    for _function in _functions:
        _define_operator(
            _function, lambda b, x, y, emit=_instruction: emit(b, x, y, flags=_CONTRACT)
        )
for _function, _sign in (
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.lt, "<"),
    (operator.le, "<="),
):
    _define_operator(
        _function, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y), compares=True
    )


@extending.type_callable(operator.and_)
def _type_and(context):
    return lambda a, b: a if a is b and a in MASKS.values() else None


for _mask in MASKS.values():
    extending.lower_builtin(operator.and_, _mask, _mask)(
        lambda context, builder, signature, values: builder.and_(*values)
    )


def _pick(sign: str, typing, a, b):
    """Signature and code of a lane-wise minimum or maximum."""
    kind = _OPERAND_PAIRS[a, b]

    def emit(context, builder, signature, values):
        x, y = _widened(builder, kind, signature.args, values)
        return builder.select(builder.fcmp_ordered(sign, x, y), x, y)

    return kind(a, b), emit


@intrinsic
def minimum(typing, a, b):
    """Lane-wise minimum."""
    return _pick("<", typing, a, b)


@intrinsic
def maximum(typing, a, b):
    """Lane-wise maximum."""
    return _pick(">", typing, a, b)


@intrinsic
def select(typing, mask, a, b):
    """`a` where the mask holds, else `b`."""
    kind = _OPERAND_PAIRS[a, b]

    def emit(context, builder, signature, values):
        return builder.select(
            values[0], *_widened(builder, kind, signature.args[1:], values[1:])
        )

    return kind(mask, a, b), emit


@intrinsic
def broadcast(typing, scalar):
    """All lanes equal to a float32 (sixteen of them) or a float64 (eight)."""
    kind = {types.float32: FLOATS, types.float64: DOUBLES}[scalar]
    return kind(scalar), lambda context, builder, signature, values: splat(
        builder, kind, values[0]
    )


@intrinsic
def flag_negative(typing, mask, a):
    """`a`, with the sign bit set where the mask holds.

    Bit arithmetic, because a `select` between a new value and the one in memory becomes a masked
    store, for which a load that follows soon has to wait.
    """

    def emit(context, builder, signature, values):
        sign = builder.shl(builder.zext(values[0], a.bits), bit_constant(a, 31))
        return builder.bitcast(
            builder.or_(builder.bitcast(values[1], a.bits), sign), a.ir
        )

    return a(mask, a), emit


@intrinsic
def magnitude(typing, a):
    """|a| of float32 lanes."""

    def emit(context, builder, signature, values):
        bits = builder.and_(
            builder.bitcast(values[0], a.bits), bit_constant(a, 2**31 - 1)
        )
        return builder.bitcast(bits, a.ir)

    return a(a), emit


@intrinsic
def mask_bits(typing, mask):
    """The mask as an integer, lane 0 in bit 0."""

    def emit(context, builder, signature, values):
        return builder.zext(builder.bitcast(values[0], ir.IntType(mask.width)), INT64)

    return types.uint64(mask), emit


@intrinsic
def lowest_bit(typing, bits):
    """Index of the lowest set bit of a non-zero uint64."""

    def emit(context, builder, signature, values):
        return builder.cttz(values[0], ir.Constant(ir.IntType(1), 1))

    return types.uint64(types.uint64), emit


@intrinsic
def lane_columns(typing):
    """0 1 2 3 0 1 2 3 ...: column of each float32 lane in a 4x4 block."""
    return FLOATS(), lambda context, builder, s, v: constant(
        FLOATS, [float(lane % 4) for lane in range(16)]
    )


@intrinsic
def lane_rows(typing):
    """0 0 0 0 1 1 1 1 ...: row of each float32 lane in a 4x4 block."""
    return FLOATS(), lambda context, builder, s, v: constant(
        FLOATS, [float(lane // 4) for lane in range(16)]
    )


@intrinsic
def square_root(typing, a):
    """Lane-wise square root."""
    suffix = {FLOATS: "v16f32", DOUBLES: "v8f64"}[a]

    def emit(context, builder, signature, values):
        kind = ir.FunctionType(a.ir, [a.ir])
        function = cgutils.get_or_insert_function(
            builder.module, kind, f"llvm.sqrt.{suffix}"
        )
        return builder.call(function, values)

    return a(a), emit


def _exp2_coefficients() -> list[float]:
    """Polynomial for 2^f on [-1/2, 1/2], relative error 1e-7, lowest power first."""
    nodes = 0.5 * np.cos(np.pi * (np.arange(256) + 0.5) / 256)
    fitted = np.polynomial.polynomial.polyfit(nodes, 2.0**nodes, 5, w=2.0**-nodes)
    return [float(np.float32(value)) for value in fitted]


_EXP2 = _exp2_coefficients()
# adding it leaves the nearest integer in the low bits of the mantissa; formula
_ROUNDER = 1.5 * 2**23
# log2((1 + s) / (1 - s)) in odd powers of s
_SERIES = [2 / math.log(2) / power for power in range(1, 12, 2)]


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
        exponent = builder.shl(
            builder.bitcast(shifted, FLOATS.bits), bit_constant(FLOATS, 23)
        )
        return builder.bitcast(builder.add(power, exponent), FLOATS.ir)

    return FLOATS(FLOATS), emit


@intrinsic
def log2(typing, a):
    """log2(a) of positive normal float64 lanes, absolute error 1e-10."""

    def emit(context, builder, signature, values):
        bits = builder.bitcast(values[0], DOUBLES.bits)
        # Exponent of a / sqrt(1/2), so that the mantissa that is left lies in [sqrt(1/2), sqrt(2)).
        half_root = int(np.float64(math.sqrt(0.5)).view(np.int64))
        exponent = builder.ashr(
            builder.sub(bits, bit_constant(DOUBLES, half_root)),
            bit_constant(DOUBLES, 52),
        )
        mantissa = builder.sub(bits, builder.shl(exponent, bit_constant(DOUBLES, 52)))
        m = builder.bitcast(mantissa, DOUBLES.ir)
        one = constant(DOUBLES, 1.0)
        s = builder.fdiv(builder.fsub(m, one), builder.fadd(m, one))
        series = _horner(builder, DOUBLES, _SERIES, builder.fmul(s, s))
        return builder.fadd(
            builder.sitofp(exponent, ir.VectorType(ir.DoubleType(), 8)),
            builder.fmul(s, series),
        )

    return DOUBLES(DOUBLES), emit
