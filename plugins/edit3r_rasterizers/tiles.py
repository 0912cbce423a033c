"""What the forward and the backward kernel share: the blocks of a tile, and the splats at their
pixels.

A tile's state lies in a scratch buffer that stays in the L1 cache: per block `stride` floats, that
is planes of sixteen lanes. Plane 0 is the transmittance left, negative once the pixel has ended; 1
and 2 are the pixel centres' x and y in the tile.
"""

import numpy as np

from edit3r_rasterizers import layout
from edit3r_rasterizers.kernels import inlined
from edit3r_rasterizers.simd import (
    broadcast,
    exp2,
    flag_negative,
    lane_columns,
    lane_rows,
    mask_bits,
    maximum,
    minimum,
    select,
)
from edit3r_rasterizers.simd_memory import (
    load,
    load_block,
    prefetch,
    store,
    store_block,
)

F = np.float32
U = np.uint64
LANES = U(16)
BLOCKS = U((layout.TILE // layout.BLOCK) ** 2)
BLOCKS_PER_ROW = U(layout.TILE // layout.BLOCK)
"""Blocks in a row of a tile."""
TRANSMITTANCE, PIXEL_X, PIXEL_Y, FIRST_FREE = U(0), LANES, U(2) * LANES, U(3) * LANES
BATCH = U(16)
"""Entries looked at together: first which blocks each reaches, then what it does there."""
LOWEST_EXPONENT = F(-60)
"""Of alpha, base 2: keeps exp2 away from denormal numbers, which are slow."""


@inlined
def open_tile(scratch, stride, width, height):
    """Prepare the first three planes for a tile of so many pixels; returns the blocks with any."""
    live = U(0)
    for block in range(BLOCKS):
        columns = lane_columns() + F((block % BLOCKS_PER_ROW) * U(layout.BLOCK))
        rows = lane_rows() + F((block // BLOCKS_PER_ROW) * U(layout.BLOCK))
        inside = (broadcast(F(width)) > columns) & (broadcast(F(height)) > rows)
        place = block * stride
        store(scratch, place + TRANSMITTANCE, select(inside, broadcast(F(1)), F(-1)))
        store(scratch, place + PIXEL_X, columns + F(0.5))
        store(scratch, place + PIXEL_Y, rows + F(0.5))
        if mask_bits(inside):
            live |= U(1) << block
    return live


@inlined
def live_blocks(scratch, stride):
    """Return the blocks with a pixel that has not ended, as bits."""
    live = U(0)
    for block in range(BLOCKS):
        if mask_bits(load(scratch, block * stride + TRANSMITTANCE) > F(0)):
            live |= U(1) << block
    return live


@inlined
def place_splat(records, start, tile_x, tile_y):
    """Read the splat whose record begins at flat index `start`, for positions (x, y) relative to a
    tile.

    Returns its ellipse, red, green, blue and depth. The ellipse is (inv_std_x, shear, shift_x,
    inv_std_y, shift_y, log_opacity): log2(alpha) is log_opacity minus the squares of inv_std_x * x
    - shear * y + shift_x and of inv_std_y * y + shift_y. Computed in float64, as the mean may be
    far away.
    """
    x = (np.float64(records[start + layout.X]) - tile_x) + np.float64(
        records[start + layout.X_REST]
    )
    y = (np.float64(records[start + layout.Y]) - tile_y) + np.float64(
        records[start + layout.Y_REST]
    )
    x_per_y = np.float64(records[start + layout.X_PER_Y]) + np.float64(
        records[start + layout.X_PER_Y_REST]
    )
    inv_std_x = records[start + layout.INV_STD_X]
    inv_std_y = records[start + layout.INV_STD_Y]
    shift_x = F(np.float64(inv_std_x) * (x_per_y * y - x))
    shift_y = F(-np.float64(inv_std_y) * y)
    ellipse = (
        inv_std_x,
        inv_std_x * F(x_per_y),
        shift_x,
        inv_std_y,
        shift_y,
        records[start + layout.LOG_OPACITY],
    )
    red = records[start + layout.RED]
    green = records[start + layout.GREEN]
    blue = records[start + layout.BLUE]
    return ellipse, red, green, blue, records[start + layout.DEPTH]


@inlined
def splat_exponent(scratch, place, ellipse):
    """Terms and log2(alpha) of a splat (`place_splat`) at the block's sixteen pixels."""
    inv_std_x, shear, shift_x, inv_std_y, shift_y, log_opacity = ellipse
    pixel_y = load(scratch, place + PIXEL_Y)
    across = load(scratch, place + PIXEL_X) * inv_std_x + (
        broadcast(shift_x) - pixel_y * shear
    )
    down = pixel_y * inv_std_y + shift_y
    return (
        across,
        down,
        maximum(
            (broadcast(log_opacity) - across * across) - down * down, LOWEST_EXPONENT
        ),
    )


@inlined
def pass_splat(scratch, place, ellipse, limits):
    """Let the light of the block at `place` pass a splat, which lowers its transmittance and ends
    pixels.

    `limits` are log2 of the least alpha, the largest alpha and the least transmittance. Returns
    the two terms of `splat_exponent`, alpha before and after the limit, the transmittance before,
    the splat's weight, and where it is shown.
    """
    threshold, limit, least = limits
    across, down, exponent = splat_exponent(scratch, place, ellipse)
    full_alpha = exp2(exponent)
    alpha = minimum(full_alpha, limit)
    before = load(scratch, place + TRANSMITTANCE)
    weight = alpha * before
    after = before - weight
    covered = exponent >= threshold
    shown = covered & (after > least)
    left = select(shown, after, flag_negative(covered, before))
    store(scratch, place + TRANSMITTANCE, left)
    weight = select(shown, weight, broadcast(F(0)))
    return across, down, full_alpha, alpha, before, weight, shown


@inlined
def find_touched_blocks(first, last, entries, records, tile_x, tile_y, touched):
    """Write for each entry of [first, last) the blocks whose pixel centres its ellipse reaches, as
    bits in `touched`.

    One lane per block, places relative to the mean. Over a rectangle the exponent is least on the
    column nearest to the mean or on the row nearest to it, and how far along these follows from the
    ellipse's axes.
    """
    for entry in range(first, last):
        prefetch(records, U(entries[entry + U(layout.LOOKAHEAD)]) * U(layout.RECORD))
        start = U(entries[entry]) * U(layout.RECORD)
        x = (records[start + layout.X] - F(tile_x)) + records[start + layout.X_REST]
        y = (records[start + layout.Y] - F(tile_y)) + records[start + layout.Y_REST]
        x_per_y = records[start + layout.X_PER_Y]
        y_per_x = records[start + layout.Y_PER_X]
        inv_std_x = records[start + layout.INV_STD_X]
        inv_std_y = records[start + layout.INV_STD_Y]
        left = lane_columns() * F(layout.BLOCK) + (F(0.5) - x)
        top = lane_rows() * F(layout.BLOCK) + (F(0.5) - y)
        right, bottom = left + F(layout.BLOCK - 1), top + F(layout.BLOCK - 1)
        column = minimum(maximum(left, F(0)), right)
        row = minimum(maximum(top, F(0)), bottom)
        down = minimum(maximum(column * y_per_x, top), bottom)
        by_column = _squares(column - down * x_per_y, down, inv_std_x, inv_std_y)
        axis = row * x_per_y
        across = minimum(maximum(axis, left), right)
        by_row = _squares(across - axis, row, inv_std_x, inv_std_y)
        limit = broadcast(records[start + layout.CUTOFF] * F(1.001) + F(1e-2))
        touched[entry] = mask_bits(minimum(by_column, by_row) <= limit)


@inlined
def _squares(across, down, inv_std_x, inv_std_y):
    across, down = across * inv_std_x, down * inv_std_y
    return across * across + down * down


@inlined
def write_block(scratch, place, image, target, shape):
    """Copy a plane to flat index `target` of an image; `shape` is the image's width, and the
    columns and rows that are copied.
    """
    width, columns, rows = shape
    if columns == U(layout.BLOCK) and rows == U(layout.BLOCK):
        store_block(image, target, width, load(scratch, place))
        return
    for row in range(rows):
        for column in range(columns):
            pixel = scratch[place + row * U(layout.BLOCK) + column]
            image[target + row * width + column] = pixel


@inlined
def read_block(scratch, place, image, source, shape):
    """Copy the other way; zero beyond the columns and rows that are copied."""
    width, columns, rows = shape
    if columns == U(layout.BLOCK) and rows == U(layout.BLOCK):
        store(scratch, place, load_block(image, source, width))
        return
    store(scratch, place, broadcast(F(0)))
    for row in range(rows):
        for column in range(columns):
            pixel = image[source + row * width + column]
            scratch[place + row * U(layout.BLOCK) + column] = pixel
