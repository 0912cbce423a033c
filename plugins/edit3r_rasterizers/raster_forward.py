"""Composite the splats of each tile front to back, sixteen pixels (a 4x4 block) at a time.

A tile's state lies in a scratch buffer that stays in the L1 cache: per block the planes T (transmittance left,
negative once the pixel has ended), red, green, blue and depth, sixteen float32 each.
"""

import numpy as np
from numba import njit

from edit3r_rasterizers.records import (
    BLOCK,
    BLUE,
    DEPTH,
    FLATNESS,
    GREEN,
    LEAN,
    LOG_OPACITY,
    NARROWNESS,
    REACH,
    RED,
    SLOPE,
    TILE,
    X_REST,
    Y_REST,
    X,
    Y,
)
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA
from edit3r_rasterizers.simd import (
    broadcast,
    exp2,
    lane_columns,
    lane_rows,
    load,
    lowest_bit,
    mask_bits,
    maximum,
    minimum,
    negative_magnitude,
    select,
    store,
)

F = np.float32
U = np.uint64
LANES = U(16)
BLOCKS = U((TILE // BLOCK) ** 2)
PLANES = U(5)
STRIDE = PLANES * LANES
"""Floats per block in the forward scratch buffer."""
SCRATCH = int(BLOCKS * STRIDE)
LOWEST_EXPONENT = F(-60)  # log2; keeps exp2 away from denormal numbers, which are slow
_RECHECK = U(16)  # entries between looks at which blocks are finished


@njit(error_model="numpy")
def touched_blocks(x, y, slope, lean, narrowness, flatness, reach):
    """Bit b is set where the ellipse at (x, y), relative to the tile, reaches the pixel centres of block b.

    One lane per block: the smallest exponent over the block's rectangle is on the edge nearest the mean.
    """
    left = lane_columns() * F(BLOCK) + (F(0.5) - x)
    top = lane_rows() * F(BLOCK) + (F(0.5) - y)
    right, bottom = left + F(BLOCK - 1), top + F(BLOCK - 1)
    near_x = minimum(maximum(left, F(0)), right)
    near_y = minimum(maximum(top, F(0)), bottom)
    across = (near_x - minimum(maximum(near_x * lean, top), bottom) * slope) * narrowness
    down = minimum(maximum(near_x * lean, top), bottom) * flatness
    by_column = across * across + down * down
    across = (minimum(maximum(near_y * slope, left), right) - near_y * slope) * narrowness
    down = near_y * flatness
    by_row = across * across + down * down
    return mask_bits(minimum(by_column, by_row) <= broadcast(reach * F(1.0001) + F(1e-3)))


@njit(error_model="numpy")
def open_tile(scratch, stride, width, height):
    """Set the transmittance plane to 1, to -1 outside of the picture; returns the blocks with pixels to fill."""
    live = U(0)
    for block in range(BLOCKS):
        columns = lane_columns() + F((block & U(3)) * U(BLOCK))
        rows = lane_rows() + F((block >> U(2)) * U(BLOCK))
        inside = (broadcast(F(width)) > columns) & (broadcast(F(height)) > rows)
        store(scratch, block * stride, select(inside, broadcast(F(1)), broadcast(F(-1))))
        if mask_bits(inside):
            live |= U(1) << block
    return live


@njit(error_model="numpy")
def live_blocks(scratch, stride):
    """The blocks with a pixel that has not ended."""
    live = U(0)
    for block in range(BLOCKS):
        if mask_bits(load(scratch, block * stride) > F(0)):
            live |= U(1) << block
    return live


@njit(cache=True, error_model="numpy", nogil=True)
def shade_tiles(
    first_tile,
    last_tile,
    columns,
    offsets,
    entries,
    records,
    max_alpha,
    min_alpha,
    min_transmittance,
    background,
    scratch,
    images,
    alphas,
    depths,
    transmittances,
):
    """Render the tiles [first_tile, last_tile) of one picture into images [3, H, W] and alphas, depths, ... [H, W]."""
    height, width = alphas.shape
    zero = broadcast(F(0))
    threshold = F(np.log2(min_alpha))
    limit, least = broadcast(F(max_alpha)), F(min_transmittance)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(scratch, STRIDE, min(TILE, width - tile_x), min(TILE, height - tile_y))
        for block in range(BLOCKS):
            for plane in range(U(1), PLANES):
                store(scratch, block * STRIDE + plane * LANES, zero)
        for entry in range(U(offsets[tile]), U(offsets[tile + 1])):
            if (entry & (_RECHECK - U(1))) == U(0):
                live = live & live_blocks(scratch, STRIDE)
                if live == U(0):
                    break
            record = records[U(entries[entry])]
            x, y = (record[X] - F(tile_x)) + record[X_REST], (record[Y] - F(tile_y)) + record[Y_REST]
            slope, narrowness, flatness = record[SLOPE], record[NARROWNESS], record[FLATNESS]
            todo = live & touched_blocks(x, y, slope, record[LEAN], narrowness, flatness, record[REACH])
            log_opacity = broadcast(record[LOG_OPACITY])
            red, green, blue, depth = record[RED], record[GREEN], record[BLUE], record[DEPTH]
            lanes_across = (lane_columns() - lane_rows() * slope) * narrowness
            lanes_down = lane_rows() * flatness
            while todo != U(0):
                block = lowest_bit(todo)
                todo &= todo - U(1)
                dx, dy = F((block & U(3)) * U(BLOCK)) + (F(0.5) - x), F((block >> U(2)) * U(BLOCK)) + (F(0.5) - y)
                across, down = lanes_across + narrowness * (dx - slope * dy), lanes_down + flatness * dy
                exponent = maximum(log_opacity - across * across - down * down, LOWEST_EXPONENT)
                alpha = minimum(exp2(exponent), limit)
                place = block * STRIDE
                before = load(scratch, place)
                weight = alpha * before
                after = before - weight
                covered = exponent >= threshold
                shown = covered & (after > least)
                weight = select(shown, weight, zero)
                store(scratch, place, select(shown, after, select(covered, negative_magnitude(before), before)))
                place += LANES
                store(scratch, place, load(scratch, place) + weight * red)
                place += LANES
                store(scratch, place, load(scratch, place) + weight * green)
                place += LANES
                store(scratch, place, load(scratch, place) + weight * blue)
                place += LANES
                store(scratch, place, load(scratch, place) + weight * depth)
        _write_tile(scratch, tile_x, tile_y, background, images, alphas, depths, transmittances)


@njit(error_model="numpy")
def _write_tile(scratch, tile_x, tile_y, background, images, alphas, depths, transmittances):
    """Composite the background and copy a tile's pixels to the pictures."""
    height, width = alphas.shape
    for y in range(U(tile_y), U(min(tile_y + TILE, height))):
        for x in range(U(tile_x), U(min(tile_x + TILE, width))):
            row, column = y - U(tile_y), x - U(tile_x)
            block = (row // U(BLOCK)) * U(TILE // BLOCK) + column // U(BLOCK)
            place = block * STRIDE + (row % U(BLOCK)) * U(BLOCK) + column % U(BLOCK)
            left = abs(scratch[place])
            alpha = F(1) - left
            transmittances[y, x], alphas[y, x] = left, alpha
            for channel in range(U(3)):
                images[channel, y, x] = scratch[place + (channel + U(1)) * LANES] + left * background[channel]
            depths[y, x] = scratch[place + U(4) * LANES] / max(alpha, F(MIN_TOTAL_ALPHA))
