"""Moving vectors between registers and memory.

Kernels take contiguous arrays and turn them into bare pointers with `flat`: indexing one is a plain
load or store, and passing one on costs nothing, where an array would be reference-counted (an
atomic operation) at every turn. Nothing is checked, and memory that a kernel allocates itself would
be freed too early: scratch memory is an argument too.
"""

from llvmlite import ir

from edit3r.kit.compute.compiling import numba
from edit3r_rasterizers.kernels import inlined
from edit3r_rasterizers.simd import DOUBLES, FLOATS, INT32, INT64, constant

types = numba.types
intrinsic = numba.extending.intrinsic
cgutils = numba.core.cgutils

_KINDS = {types.float32: FLOATS, types.float64: DOUBLES}
_PARTS = 4  # a 4x4 block is four rows of four


def _pointer(builder, pointer, offset, target):
    return builder.bitcast(builder.gep(pointer, [offset]), target.as_pointer())


def _align(kind) -> int:
    return kind.scalar.bitwidth // 8


@intrinsic
def flat(typing, arrays):
    """Pointer to the first element of a contiguous array, or of each in a tuple of them; index it
    by flat element index.

    None stays None, so that a kernel may go without an array.
    """
    if arrays is types.none:
        return arrays(arrays), lambda context, builder, signature, values: values[0]

    def pointer(context, builder, kind, array):
        return context.make_array(kind)(context, builder, array).data

    if not isinstance(arrays, types.BaseTuple):
        return types.CPointer(arrays.dtype)(arrays), (
            lambda context, builder, signature, values: pointer(
                context, builder, arrays, values[0]
            )
        )
    pointers = types.BaseTuple.from_types(
        [types.CPointer(one.dtype) for one in arrays],
        getattr(arrays, "instance_class", None),
    )

    def emit(context, builder, signature, values):
        parts = cgutils.unpack_tuple(builder, values[0], len(arrays))
        found = [pointer(context, builder, *one) for one in zip(arrays, parts)]
        return context.make_tuple(builder, pointers, found)

    return pointers(arrays), emit


@intrinsic
def shifted(typing, pointer, offset):
    """Pointer to the element at flat index `offset`."""
    return pointer(
        pointer, types.uint64
    ), lambda context, builder, signature, values: builder.gep(*values[:1], values[1:])


@intrinsic
def load(typing, pointer, offset):
    """A vector of consecutive values: sixteen float32 or eight float64."""
    kind = _KINDS[pointer.dtype]

    def emit(context, builder, signature, values):
        return builder.load(_pointer(builder, *values, kind.ir), align=_align(kind))

    return kind(pointer, types.uint64), emit


@intrinsic
def store(typing, pointer, offset, value):
    """Write a vector to consecutive addresses."""
    kind = _KINDS[pointer.dtype]

    def emit(context, builder, signature, values):
        builder.store(
            values[2], _pointer(builder, *values[:2], kind.ir), align=_align(kind)
        )
        return context.get_dummy_value()

    return types.void(pointer, types.uint64, kind), emit


@inlined
def add(pointer, offset, value):
    """Add a vector to what lies at consecutive addresses."""
    store(pointer, offset, load(pointer, offset) + value)


@intrinsic
def load_block(typing, pointer, offset, stride):
    """A 4x4 block of a float32 image: rows of four from flat index `offset`, `stride` apart."""
    quarter = ir.VectorType(ir.FloatType(), _PARTS)

    def emit(context, builder, signature, values):
        data, offset, stride = values
        rows = []
        for row in range(_PARTS):
            place = builder.add(offset, builder.mul(stride, ir.Constant(INT64, row)))
            rows.append(builder.load(_pointer(builder, data, place, quarter), align=4))
        halves = [_join(builder, rows[0], rows[1]), _join(builder, rows[2], rows[3])]
        return _join(builder, *halves)

    return FLOATS(pointer, types.uint64, types.uint64), emit


@intrinsic
def store_block(typing, pointer, offset, stride, value):
    """Write a 4x4 block of a float32 image; see `load_block`."""

    def emit(context, builder, signature, values):
        data, offset, stride, lanes = values
        for row in range(_PARTS):
            place = builder.add(offset, builder.mul(stride, ir.Constant(INT64, row)))
            piece = _part(builder, lanes, row * _PARTS, _PARTS)
            builder.store(piece, _pointer(builder, data, place, piece.type), align=4)
        return context.get_dummy_value()

    return types.void(pointer, types.uint64, types.uint64, FLOATS), emit


@intrinsic
def store_sums(typing, pointer, offset, vectors):
    """Write the lane sums of a tuple of up to 16 float32 vectors to consecutive addresses."""
    count = len(vectors)

    def emit(context, builder, signature, values):
        level = list(cgutils.unpack_tuple(builder, values[2], count))
        group = FLOATS.width // 2
        while group:
            level += [constant(FLOATS, 0.0)] * (len(level) % 2)
            level = [
                _fold(builder, a, b, group) for a, b in zip(level[::2], level[1::2])
            ]
            group //= 2
        done = 0
        while done < count:  # in pieces whose lengths are powers of two
            length = 1 << ((count - done).bit_length() - 1)
            piece = _part(builder, level[0], done, length)
            place = builder.add(values[1], ir.Constant(INT64, done))
            builder.store(
                piece, _pointer(builder, values[0], place, piece.type), align=4
            )
            done += length
        return context.get_dummy_value()

    return types.void(pointer, types.uint64, vectors), emit


@intrinsic
def prefetch(typing, pointer, offset):
    """Ask for the cache line of an element ahead of its use; never faults."""

    def emit(context, builder, signature, values):
        line = _pointer(builder, *values, ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [line.type, INT32, INT32, INT32])
        hint = cgutils.get_or_insert_function(
            builder.module, kind, "llvm.prefetch.p0i8"
        )
        builder.call(
            hint,
            [line, ir.Constant(INT32, 0), ir.Constant(INT32, 3), ir.Constant(INT32, 1)],
        )
        return context.get_dummy_value()

    return types.void(pointer, types.uint64), emit


def _indices(values) -> ir.Constant:
    values = list(values)
    return ir.Constant(ir.VectorType(INT32, len(values)), values)


def _join(builder, first, second):
    return builder.shuffle_vector(first, second, _indices(range(2 * first.type.count)))


def _part(builder, lanes, start: int, length: int):
    return builder.shuffle_vector(lanes, lanes, _indices(range(start, start + length)))


def _fold(builder, first, second, group: int):
    """One step of a transposed sum: groups of 2 * `group` lanes halve, `first`'s first."""
    starts = [lane for lane in range(2 * FLOATS.width) if lane % (2 * group) < group]
    low = builder.shuffle_vector(first, second, _indices(starts))
    high = builder.shuffle_vector(
        first, second, _indices(lane + group for lane in starts)
    )
    return builder.fadd(low, high)
