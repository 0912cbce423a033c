"""Composite the splats of each tile front to back, a 4x4 block of pixels at a time."""

import numpy as np

from edit3r_rasterizers.compiled import inlined, kernel
from edit3r_rasterizers.records import (
    BLOCK,
    BLUE,
    DEPTH,
    GREEN,
    LOG_OPACITY,
    RECORD,
    RED,
    TILE,
)
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA
from edit3r_rasterizers.simd import broadcast, flag_negative, lowest_bit, magnitude, maximum, minimum, select
from edit3r_rasterizers.simd_math import exp2
from edit3r_rasterizers.simd_memory import flat, load, store
from edit3r_rasterizers.tiles import (
    ACROSS,
    BATCH,
    BLOCKS,
    FIRST_FREE,
    LANES,
    LATTICE_X,
    LATTICE_Y,
    LOWEST_EXPONENT,
    TRANSMITTANCE,
    F,
    U,
    find_touched,
    line_up,
    live_blocks,
    open_tile,
    write_block,
)

_RED, _GREEN, _BLUE, _DEPTH = FIRST_FREE, FIRST_FREE + LANES, FIRST_FREE + U(2) * LANES, FIRST_FREE + U(3) * LANES
STRIDE = FIRST_FREE + U(4) * LANES
FORWARD_SCRATCH = int(BLOCKS * STRIDE)
"""Floats of scratch memory that `shade_tiles` needs."""


@kernel
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
    touched,
    images,
    alphas,
    depths,
    transmittances,
):
    """Render the tiles [first_tile, last_tile) of one picture into images [3, H, W] and three of [H, W]."""
    height, width = alphas.shape
    offsets, entries, records, scratch = flat(offsets), flat(entries), flat(records), flat(scratch)
    touched, background = flat(touched), flat(background)
    images, alphas, depths, transmittances = flat(images), flat(alphas), flat(depths), flat(transmittances)
    zero = broadcast(F(0))
    threshold, limit, least = F(np.log2(min_alpha)), F(max_alpha), F(min_transmittance)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(scratch, STRIDE, min(TILE, width - tile_x), min(TILE, height - tile_y))
        for block in range(BLOCKS):
            for plane in range(FIRST_FREE, STRIDE, LANES):
                store(scratch, block * STRIDE + plane, zero)
        first, end = U(offsets[U(tile)]), U(offsets[U(tile) + U(1)])
        while first < end and live != U(0):
            last = min(first + BATCH, end)
            find_touched(first, last, entries, records, tile_x, tile_y, touched)
            for entry in range(first, last):
                todo = live & touched[entry - first]
                start = U(entries[entry]) * U(RECORD)
                narrowness, slant, shift_x, flatness, shift_y = line_up(records, start, tile_x, tile_y)
                log_opacity = records[start + U(LOG_OPACITY)]
                red, green = records[start + U(RED)], records[start + U(GREEN)]
                blue, depth = records[start + U(BLUE)], records[start + U(DEPTH)]
                while todo != U(0):
                    place = lowest_bit(todo) * STRIDE
                    todo &= todo - U(1)
                    lattice_y = load(scratch, place + LATTICE_Y)
                    across = load(scratch, place + LATTICE_X) * narrowness + (broadcast(shift_x) - lattice_y * slant)
                    down = lattice_y * flatness + shift_y
                    exponent = maximum((broadcast(log_opacity) - across * across) - down * down, LOWEST_EXPONENT)
                    alpha = minimum(exp2(exponent), limit)
                    before = load(scratch, place + TRANSMITTANCE)
                    weight = alpha * before
                    after = before - weight
                    covered = exponent >= threshold
                    shown = covered & (after > least)
                    weight = select(shown, weight, zero)
                    store(scratch, place + TRANSMITTANCE, select(shown, after, flag_negative(covered, before)))
                    store(scratch, place + _RED, load(scratch, place + _RED) + weight * red)
                    store(scratch, place + _GREEN, load(scratch, place + _GREEN) + weight * green)
                    store(scratch, place + _BLUE, load(scratch, place + _BLUE) + weight * blue)
                    store(scratch, place + _DEPTH, load(scratch, place + _DEPTH) + weight * depth)
            live &= live_blocks(scratch, STRIDE)
            first = last
        _write_tile(
            scratch, U(tile_x), U(tile_y), U(width), U(height), background, images, alphas, depths, transmittances
        )


@inlined
def _write_tile(scratch, tile_x, tile_y, width, height, background, images, alphas, depths, transmittances):
    """Composite the background in place and copy a tile's pixels to the pictures."""
    plane = width * height
    for block in range(BLOCKS):
        x, y = tile_x + (block % ACROSS) * U(BLOCK), tile_y + (block // ACROSS) * U(BLOCK)
        if x >= width or y >= height:
            continue
        place, target = block * STRIDE, y * width + x
        columns, rows = min(U(BLOCK), width - x), min(U(BLOCK), height - y)
        left = magnitude(load(scratch, place + TRANSMITTANCE))
        alpha = broadcast(F(1)) - left
        store(scratch, place + TRANSMITTANCE, left)
        store(scratch, place + LATTICE_X, alpha)
        store(scratch, place + _DEPTH, load(scratch, place + _DEPTH) / maximum(alpha, F(MIN_TOTAL_ALPHA)))
        write_block(scratch, place + TRANSMITTANCE, transmittances, target, width, columns, rows)
        write_block(scratch, place + LATTICE_X, alphas, target, width, columns, rows)
        write_block(scratch, place + _DEPTH, depths, target, width, columns, rows)
        for channel in range(U(3)):
            colour = place + _RED + channel * LANES
            store(scratch, colour, load(scratch, colour) + left * background[channel])
            write_block(scratch, colour, images, target + channel * plane, width, columns, rows)
