"""What the forward and the backward kernel share: a tile's blocks, and which of them a splat reaches.

A tile's state lies in a scratch buffer that stays in the L1 cache: per block `stride` floats, that is planes of sixteen
lanes. Plane 0 is the transmittance left, negative once the pixel has ended; 1 and 2 are the pixel centres' x and y
in the tile.
"""

import numpy as np

from edit3r_rasterizers.compiled import inlined
from edit3r_rasterizers.records import (
    BLOCK,
    FLATNESS,
    LEAN,
    LOOKAHEAD,
    NARROWNESS,
    REACH,
    RECORD,
    SLOPE,
    SLOPE_REST,
    TILE,
    X_REST,
    Y_REST,
    X,
    Y,
)
from edit3r_rasterizers.simd import broadcast, lane_columns, lane_rows, mask_bits, maximum, minimum, select
from edit3r_rasterizers.simd_memory import load, load_block, prefetch, store, store_block

F = np.float32
U = np.uint64
LANES = U(16)
BLOCKS = U((TILE // BLOCK) ** 2)
ACROSS = U(TILE // BLOCK)
"""Blocks in a row of a tile."""
TRANSMITTANCE, LATTICE_X, LATTICE_Y, FIRST_FREE = U(0), LANES, U(2) * LANES, U(3) * LANES
BATCH = U(16)
"""Entries looked at together: first which blocks each reaches, then what it does there."""
LOWEST_EXPONENT = F(-60)
"""Of alpha, base 2: keeps exp2 away from denormal numbers, which are slow."""


@inlined
def open_tile(scratch, stride, width, height):
    """Prepare the first three planes for a tile of width x height pixels; returns the blocks that have any."""
    live = U(0)
    for block in range(BLOCKS):
        columns = lane_columns() + F((block % ACROSS) * U(BLOCK))
        rows = lane_rows() + F((block // ACROSS) * U(BLOCK))
        inside = (broadcast(F(width)) > columns) & (broadcast(F(height)) > rows)
        place = block * stride
        store(scratch, place + TRANSMITTANCE, select(inside, broadcast(F(1)), F(-1)))
        store(scratch, place + LATTICE_X, columns + F(0.5))
        store(scratch, place + LATTICE_Y, rows + F(0.5))
        if mask_bits(inside):
            live |= U(1) << block
    return live


@inlined
def live_blocks(scratch, stride):
    """The blocks with a pixel that has not ended."""
    live = U(0)
    for block in range(BLOCKS):
        if mask_bits(load(scratch, block * stride + TRANSMITTANCE) > F(0)):
            live |= U(1) << block
    return live


@inlined
def line_up(records, start, tile_x, tile_y):
    """Constants of the splat whose record begins at flat index `start`, for positions (x, y) relative to a tile.

    Returns (narrowness, slant, shift_x, flatness, shift_y): the exponent's two terms are the squares of
    narrowness * x - slant * y + shift_x and flatness * y + shift_y. In float64, as the mean may be far away.
    """
    x = (np.float64(records[start + U(X)]) - tile_x) + np.float64(records[start + U(X_REST)])
    y = (np.float64(records[start + U(Y)]) - tile_y) + np.float64(records[start + U(Y_REST)])
    slope = np.float64(records[start + U(SLOPE)]) + np.float64(records[start + U(SLOPE_REST)])
    narrowness, flatness = records[start + U(NARROWNESS)], records[start + U(FLATNESS)]
    shift_x, shift_y = F(np.float64(narrowness) * (slope * y - x)), F(-np.float64(flatness) * y)
    return narrowness, narrowness * F(slope), shift_x, flatness, shift_y


@inlined
def find_touched(first, last, entries, records, tile_x, tile_y, touched):
    """Into `touched`: for each entry of [first, last) the blocks whose pixel centres its ellipse reaches, as bits.

    One lane per block: over a rectangle the smallest exponent lies on the edge nearest the mean, where x nearest or
    y nearest is given and the other follows from the ellipse's axes.
    """
    for entry in range(first, last):
        prefetch(records, U(entries[entry + U(LOOKAHEAD)]) * U(RECORD))
        start = U(entries[entry]) * U(RECORD)
        x = (records[start + U(X)] - F(tile_x)) + records[start + U(X_REST)]
        y = (records[start + U(Y)] - F(tile_y)) + records[start + U(Y_REST)]
        slope, lean = records[start + U(SLOPE)], records[start + U(LEAN)]
        narrowness, flatness = records[start + U(NARROWNESS)], records[start + U(FLATNESS)]
        left = lane_columns() * F(BLOCK) + (F(0.5) - x)
        top = lane_rows() * F(BLOCK) + (F(0.5) - y)
        right, bottom = left + F(BLOCK - 1), top + F(BLOCK - 1)
        near_x = minimum(maximum(left, F(0)), right)
        near_y = minimum(maximum(top, F(0)), bottom)
        down = minimum(maximum(near_x * lean, top), bottom)
        by_column = _squares(near_x - down * slope, down, narrowness, flatness)
        axis = near_y * slope
        by_row = _squares(minimum(maximum(axis, left), right) - axis, near_y, narrowness, flatness)
        limit = broadcast(records[start + U(REACH)] * F(1.001) + F(1e-2))
        touched[entry - first] = mask_bits(minimum(by_column, by_row) <= limit)


@inlined
def _squares(across, down, narrowness, flatness):
    across, down = across * narrowness, down * flatness
    return across * across + down * down


@inlined
def write_block(scratch, place, picture, target, width, columns, rows):
    """Copy columns x rows pixels of a plane to flat index `target` of a picture `width` wide."""
    if columns == U(BLOCK) and rows == U(BLOCK):
        store_block(picture, target, width, load(scratch, place))
        return
    for row in range(rows):
        for column in range(columns):
            picture[target + row * width + column] = scratch[place + row * U(BLOCK) + column]


@inlined
def read_block(scratch, place, picture, source, width, columns, rows):
    """Copy columns x rows pixels of a picture `width` wide from flat index `source` to a plane, zero elsewhere."""
    if columns == U(BLOCK) and rows == U(BLOCK):
        store(scratch, place, load_block(picture, source, width))
        return
    store(scratch, place, broadcast(F(0)))
    for row in range(rows):
        for column in range(columns):
            scratch[place + row * U(BLOCK) + column] = picture[source + row * width + column]
