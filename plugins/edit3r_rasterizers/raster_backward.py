"""Gradients of a tile's pixels by its splats, front to back like the forward pass.

Per pixel `rest` starts as (final picture . gradient) and loses each splat's share as it is passed, so that
d loss / d alpha = T * (colour . gradient) - rest / (1 - alpha) needs no list of what was drawn. Per entry ten sums
over the pixels are written to its own place and added up per splat afterwards: no two threads write to one number.
"""

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
    SUMS,
    TILE,
)
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA
from edit3r_rasterizers.simd import broadcast, flag_negative, lowest_bit, maximum, minimum, select
from edit3r_rasterizers.simd_math import exp2
from edit3r_rasterizers.simd_memory import flat, load, store, store_sums
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
    read_block,
)

# Planes: gradients by red, green, blue and by weighted depth; what later splats and the background still contribute.
_RED, _GREEN, _BLUE, _DEPTH = FIRST_FREE, FIRST_FREE + LANES, FIRST_FREE + U(2) * LANES, FIRST_FREE + U(3) * LANES
_REST = FIRST_FREE + U(4) * LANES
STRIDE = FIRST_FREE + U(5) * LANES
BACKWARD_SCRATCH = int(BLOCKS * STRIDE)
"""Floats of scratch memory that `differentiate_tiles` needs."""


@kernel
def differentiate_tiles(
    first_tile,
    last_tile,
    columns,
    offsets,
    entries,
    records,
    max_alpha,
    min_alpha,
    min_transmittance,
    scratch,
    touched,
    images,
    depths,
    transmittances,
    image_gradients,
    alpha_gradients,
    depth_gradients,
    sums,
):
    """Fill `sums[e]` (see `records`) for every entry of the tiles [first_tile, last_tile)."""
    height, width = depths.shape
    offsets, entries, records, scratch = flat(offsets), flat(entries), flat(records), flat(scratch)
    touched, sums = flat(touched), flat(sums)
    images, depths, transmittances = flat(images), flat(depths), flat(transmittances)
    image_gradients, alpha_gradients, depth_gradients = (
        flat(image_gradients),
        flat(alpha_gradients),
        flat(depth_gradients),
    )
    zero = broadcast(F(0))
    threshold, limit, least = F(np.log2(min_alpha)), F(max_alpha), F(min_transmittance)
    plane = U(width) * U(height)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(scratch, STRIDE, min(TILE, width - tile_x), min(TILE, height - tile_y))
        for block in range(BLOCKS):
            x, y = U(tile_x) + (block % ACROSS) * U(BLOCK), U(tile_y) + (block // ACROSS) * U(BLOCK)
            if x < U(width) and y < U(height):
                place, corner, shape = block * STRIDE, y * U(width) + x, (U(width), U(width) - x, U(height) - y)
                _read_planes(scratch, place, images, depths, transmittances, corner, plane, shape)
                seen = _load_planes(scratch, place)
                _read_planes(scratch, place, image_gradients, depth_gradients, alpha_gradients, corner, plane, shape)
                _start_rest(scratch, place, seen)
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
                sum_v, sum_vs, sum_vt, sum_vss, sum_vst, sum_vtt = zero, zero, zero, zero, zero, zero
                sum_red, sum_green, sum_blue, sum_depth = zero, zero, zero, zero
                while todo != U(0):
                    place = lowest_bit(todo) * STRIDE
                    todo &= todo - U(1)
                    lattice_y = load(scratch, place + LATTICE_Y)
                    across = load(scratch, place + LATTICE_X) * narrowness + (broadcast(shift_x) - lattice_y * slant)
                    down = lattice_y * flatness + shift_y
                    exponent = maximum((broadcast(log_opacity) - across * across) - down * down, LOWEST_EXPONENT)
                    full_alpha = exp2(exponent)
                    alpha = minimum(full_alpha, limit)
                    before = load(scratch, place + TRANSMITTANCE)
                    weight = alpha * before
                    after = before - weight
                    covered = exponent >= threshold
                    shown = covered & (after > least)
                    weight = select(shown, weight, zero)
                    store(scratch, place + TRANSMITTANCE, select(shown, after, flag_negative(covered, before)))
                    by_red, by_green = load(scratch, place + _RED), load(scratch, place + _GREEN)
                    by_blue, by_depth = load(scratch, place + _BLUE), load(scratch, place + _DEPTH)
                    sum_red += weight * by_red
                    sum_green += weight * by_green
                    sum_blue += weight * by_blue
                    sum_depth += weight * by_depth
                    value = by_red * red + by_green * green + by_blue * blue + by_depth * depth
                    rest = load(scratch, place + _REST) - weight * value
                    store(scratch, place + _REST, rest)
                    by_alpha = before * value - rest / (broadcast(F(1)) - alpha)
                    v = select(shown & (full_alpha <= limit), alpha * by_alpha, zero)
                    vs, vt = v * across, v * down
                    sum_v += v
                    sum_vs += vs
                    sum_vt += vt
                    sum_vss += vs * across
                    sum_vst += vs * down
                    sum_vtt += vt * down
                store_sums(
                    sums,
                    entry * U(SUMS),
                    (sum_v, sum_vs, sum_vt, sum_vss, sum_vst, sum_vtt, sum_red, sum_green, sum_blue, sum_depth),
                )
            live &= live_blocks(scratch, STRIDE)
            first = last
        for place in range(first * U(SUMS), end * U(SUMS)):
            sums[place] = F(0)


@inlined
def _read_planes(scratch, place, images, depths, alphas, corner, plane, shape):
    """Copy a block of three colours, depth and a last picture to the planes that `_start_rest` works on."""
    width, columns, rows = shape[0], min(U(BLOCK), shape[1]), min(U(BLOCK), shape[2])
    read_block(scratch, place + _RED, images, corner, width, columns, rows)
    read_block(scratch, place + _GREEN, images, corner + plane, width, columns, rows)
    read_block(scratch, place + _BLUE, images, corner + U(2) * plane, width, columns, rows)
    read_block(scratch, place + _DEPTH, depths, corner, width, columns, rows)
    read_block(scratch, place + _REST, alphas, corner, width, columns, rows)


@inlined
def _load_planes(scratch, place):
    red, green, blue = load(scratch, place + _RED), load(scratch, place + _GREEN), load(scratch, place + _BLUE)
    return red, green, blue, load(scratch, place + _DEPTH), load(scratch, place + _REST)


@inlined
def _start_rest(scratch, place, seen):
    """From a block's pictures (`seen`) and their gradients: the gradient by weighted depth, and `rest`."""
    red, green, blue, depth, left = seen
    by_red, by_green, by_blue, by_depth, by_alpha = _load_planes(scratch, place)
    by_depth = by_depth / maximum(broadcast(F(1)) - left, F(MIN_TOTAL_ALPHA))
    rest = red * by_red + green * by_green + blue * by_blue + depth * by_depth - left * by_alpha
    store(scratch, place + _DEPTH, by_depth)
    store(scratch, place + _REST, rest)
