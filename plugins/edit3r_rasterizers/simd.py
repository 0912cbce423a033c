"""Sixteen float32 lanes as a value inside numba kernels, so that the inner loops are vector code by construction.

`Lanes` and `Mask` exist only inside compiled functions: `+ - * /`, comparisons, `&` and the functions below map to
LLVM vector instructions, which LLVM splits into what the processor has (one AVX-512 register, two of AVX2, four of SSE
or NEON). A scalar operand must be float32 and is broadcast. Products and sums may fuse, nothing else is reordered, so
results do not depend on threads.

numba's on-disk cache watches a kernel's own file only: after a change here, delete the `__pycache__` folder.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel.models import PrimitiveModel
from numba.extending import intrinsic, lower_builtin, register_model, type_callable

WIDTH = 16
"""Number of lanes."""

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_FLOATS, _INTS = ir.VectorType(_FLOAT, WIDTH), ir.VectorType(_INT, WIDTH)
_BOOLS = ir.VectorType(ir.IntType(1), WIDTH)
_CONTRACT = ("contract",)


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float32x16")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="boolx16")


LANES, MASK = _LanesType(), _MaskType()


@register_model(_LanesType)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager, numba_type) -> None:
        super().__init__(manager, numba_type, _FLOATS)


@register_model(_MaskType)
class _MaskModel(PrimitiveModel):
    def __init__(self, manager, numba_type) -> None:
        super().__init__(manager, numba_type, _BOOLS)


def _splat(builder, scalar, lanes=_FLOATS):
    single = builder.insert_element(ir.Constant(lanes, ir.Undefined), scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(single, ir.Constant(lanes, ir.Undefined), ir.Constant(_INTS, [0] * WIDTH))


def _widened(builder, signature, values):
    """The operands with float32 scalars broadcast."""
    return [value if kind is LANES else _splat(builder, value) for kind, value in zip(signature.args, values)]


def _constant(values, kind=_FLOATS):
    return ir.Constant(kind, [float(np.float32(v)) if kind is _FLOATS else int(v) for v in values])


_OPERAND_PAIRS = ((LANES, LANES), (LANES, types.float32), (types.float32, LANES))


def _define_operator(function, result, emit) -> None:
    """Teach numba one binary operator on lanes."""

    @type_callable(function)
    def typing(context):
        def typer(a, b):
            return result if (a, b) in _OPERAND_PAIRS else None

        return typer

    def lower(context, builder, signature, values):
        return emit(builder, *_widened(builder, signature, values))

    for pair in _OPERAND_PAIRS:
        lower_builtin(function, *pair)(lower)


for _function, _instruction in (
    (operator.add, ir.IRBuilder.fadd),
    (operator.iadd, ir.IRBuilder.fadd),
    (operator.sub, ir.IRBuilder.fsub),
    (operator.isub, ir.IRBuilder.fsub),
    (operator.mul, ir.IRBuilder.fmul),
    (operator.truediv, ir.IRBuilder.fdiv),
):
    _define_operator(_function, LANES, lambda b, x, y, emit=_instruction: emit(b, x, y, flags=_CONTRACT))
_define_operator(operator.gt, MASK, lambda b, x, y: b.fcmp_ordered(">", x, y))
_define_operator(operator.ge, MASK, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_define_operator(operator.le, MASK, lambda b, x, y: b.fcmp_ordered("<=", x, y))


@type_callable(operator.and_)
def _type_and(context):
    def typer(a, b):
        return MASK if (a, b) == (MASK, MASK) else None

    return typer


@lower_builtin(operator.and_, MASK, MASK)
def _lower_and(context, builder, signature, values):
    return builder.and_(*values)


@intrinsic
def broadcast(typing, scalar):
    """All lanes equal to a float32."""
    return LANES(types.float32), lambda c, builder, s, args: _splat(builder, args[0])


@intrinsic
def minimum(typing, a, b):
    """Lane-wise minimum."""

    def emit(context, builder, signature, args):
        a, b = _widened(builder, signature, args)
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return LANES(a, b), emit


@intrinsic
def maximum(typing, a, b):
    """Lane-wise maximum."""

    def emit(context, builder, signature, args):
        a, b = _widened(builder, signature, args)
        return builder.select(builder.fcmp_ordered(">", a, b), a, b)

    return LANES(a, b), emit


@intrinsic
def select(typing, mask, a, b):
    """`a` where the mask holds, else `b`."""

    def emit(context, builder, signature, args):
        a, b = _widened(builder, types.void(*signature.args[1:]), args[1:])
        return builder.select(args[0], a, b)

    return LANES(MASK, a, b), emit


@intrinsic
def negative_magnitude(typing, a):
    """-|a|."""

    def emit(context, builder, signature, args):
        bits = builder.or_(builder.bitcast(args[0], _INTS), _constant([-(2**31)] * WIDTH, _INTS))
        return builder.bitcast(bits, _FLOATS)

    return LANES(LANES), emit


@intrinsic
def mask_bits(typing, mask):
    """The mask as an integer, lane 0 in bit 0."""

    def emit(context, builder, signature, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(WIDTH)), ir.IntType(64))

    return types.uint64(MASK), emit


@intrinsic
def lowest_bit(typing, bits):
    """Index of the lowest set bit of a non-zero uint64."""

    def emit(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.uint64(types.uint64), emit


@intrinsic
def lane_columns(typing):
    """0 1 2 3 0 1 2 3 ...: column of each lane in a 4x4 block."""
    return LANES(), lambda c, builder, s, args: _constant([lane % 4 for lane in range(WIDTH)])


@intrinsic
def lane_rows(typing):
    """0 0 0 0 1 1 1 1 ...: row of each lane in a 4x4 block."""
    return LANES(), lambda c, builder, s, args: _constant([lane // 4 for lane in range(WIDTH)])


def _lane_pointer(context, builder, array_type, array, offset):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), _FLOATS.as_pointer())


@intrinsic
def load(typing, array, offset):
    """Sixteen consecutive values of a contiguous float32 array from flat index `offset`, unchecked."""

    def emit(context, builder, signature, args):
        return builder.load(_lane_pointer(context, builder, signature.args[0], *args), align=4)

    return LANES(array, types.uint64), emit


@intrinsic
def store(typing, array, offset, value):
    """Write sixteen consecutive values of a contiguous float32 array from flat index `offset`, unchecked."""

    def emit(context, builder, signature, args):
        builder.store(args[2], _lane_pointer(context, builder, signature.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, LANES), emit


def _exp2_coefficients(degree: int = 5) -> np.ndarray:
    """Polynomial for 2^f on [-1/2, 1/2], relative error 1e-7, lowest power first."""
    nodes = 0.5 * np.cos(np.pi * (np.arange(256) + 0.5) / 256)
    return np.polynomial.polynomial.polyfit(nodes, 2.0**nodes, degree, w=2.0**-nodes)


_EXP2 = _exp2_coefficients()
_ROUNDER = 1.5 * 2**23  # adding it leaves the nearest integer in the low bits of the mantissa


@intrinsic
def exp2(typing, a):
    """2^a for a in [-120, 120], relative error 2e-7."""

    def emit(context, builder, signature, args):
        rounder = _constant([_ROUNDER] * WIDTH)
        shifted = builder.fadd(args[0], rounder)
        fraction = builder.fsub(args[0], builder.fsub(shifted, rounder))
        result = _constant([_EXP2[-1]] * WIDTH)
        for coefficient in _EXP2[-2::-1]:
            product = builder.fmul(result, fraction, flags=_CONTRACT)
            result = builder.fadd(product, _constant([coefficient] * WIDTH), flags=_CONTRACT)
        exponent = builder.shl(builder.bitcast(shifted, _INTS), _constant([23] * WIDTH, _INTS))
        return builder.bitcast(builder.add(builder.bitcast(result, _INTS), exponent), _FLOATS)

    return LANES(LANES), emit


def _fold(builder, first, second, group):
    """One step of a transposed sum: groups of 2 * `group` lanes become groups of `group`, those of `first` first."""
    starts = [lane for lane in range(2 * WIDTH) if lane % (2 * group) < group]
    low = builder.shuffle_vector(first, second, _constant(starts, _INTS))
    high = builder.shuffle_vector(first, second, _constant([lane + group for lane in starts], _INTS))
    return builder.fadd(low, high)


def _store_first(context, builder, array_type, array, offset, lanes, count) -> None:
    """Write the first `count` lanes, in pieces whose lengths are powers of two."""
    data = context.make_array(array_type)(context, builder, array).data
    done = 0
    while done < count:
        length = 1 << ((count - done).bit_length() - 1)
        index = ir.Constant(ir.VectorType(_INT, length), list(range(done, done + length)))
        piece = builder.shuffle_vector(lanes, lanes, index)
        pointer = builder.gep(data, [builder.add(offset, ir.Constant(offset.type, done))])
        builder.store(piece, builder.bitcast(pointer, piece.type.as_pointer()), align=4)
        done += length


@intrinsic
def store_sums(typing, array, offset, vectors):
    """Write the lane sums of a tuple of up to 16 vectors to consecutive places of a contiguous float32 array."""
    count = len(vectors)

    def emit(context, builder, signature, args):
        level = list(cgutils.unpack_tuple(builder, args[2], count))
        group = WIDTH // 2
        while group:
            level += [_constant([0] * WIDTH)] * (len(level) % 2)
            level = [_fold(builder, a, b, group) for a, b in zip(level[::2], level[1::2])]
            group //= 2
        _store_first(context, builder, signature.args[0], *args[:2], level[0], count)
        return context.get_dummy_value()

    return types.void(array, types.uint64, vectors), emit
