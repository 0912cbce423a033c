"""Composite the splats of each tile front to back, a 4x4 block of pixels at a time, and
differentiate that.

The backward pass goes front to back too. Per pixel `rest` starts as (final image . gradient) and
loses each splat's share as it is passed, so that d loss / d alpha = T * (colour . gradient) - rest
/ (1 - alpha) needs no list of what was drawn. Per entry ten sums over the pixels are written to its
own place and added up per splat afterwards: no two threads write to one number.
"""

import numpy as np

from edit3r_rasterizers.kernels import inlined, kernel
from edit3r_rasterizers.layout import BLOCK, LOOKAHEAD, RECORD, SUMS, TILE
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA
from edit3r_rasterizers.simd import (
    broadcast,
    exp2,
    flag_negative,
    lowest_bit,
    magnitude,
    maximum,
    minimum,
    select,
)
from edit3r_rasterizers.simd_memory import flat, load, prefetch, store, store_sums
from edit3r_rasterizers.tiles import (
    BATCH,
    BLOCKS,
    BLOCKS_PER_ROW,
    FIRST_FREE,
    LANES,
    PIXEL_X,
    TRANSMITTANCE,
    F,
    U,
    find_touched_blocks,
    live_blocks,
    open_tile,
    place_splat,
    read_block,
    splat_exponent,
    write_block,
)

# Planes after the first three. Forward: sums of red, green, blue and depth. Backward: gradients by
# red, green, blue and by weighted depth, then what later splats and the background still
# contribute.
_RED = FIRST_FREE
_GREEN = FIRST_FREE + LANES
_BLUE = FIRST_FREE + U(2) * LANES
_DEPTH = FIRST_FREE + U(3) * LANES
_REST = FIRST_FREE + U(4) * LANES
FORWARD_STRIDE, BACKWARD_STRIDE = FIRST_FREE + U(4) * LANES, FIRST_FREE + U(5) * LANES
FORWARD_SCRATCH = int(BLOCKS * FORWARD_STRIDE)
BACKWARD_SCRATCH = int(BLOCKS * BACKWARD_STRIDE)
"""Floats of scratch memory that `shade_tiles` and `differentiate_tiles` need."""


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
    touched,
    background,
    scratch,
    images,
    alphas,
    depths,
    transmittances,
):
    """Render the tiles [first_tile, last_tile) of one image into images [3, H, W] and three of [H,
    W].

    `touched[e]` becomes the blocks that entry e reaches, as bits; the backward pass reads it.
    """
    height, width = alphas.shape
    offsets = flat(offsets)
    entries = flat(entries)
    records = flat(records)
    scratch = flat(scratch)
    touched, background = flat(touched), flat(background)
    images = flat(images)
    alphas = flat(alphas)
    depths = flat(depths)
    transmittances = flat(transmittances)
    zero = broadcast(F(0))
    threshold, limit, least = F(np.log2(min_alpha)), F(max_alpha), F(min_transmittance)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(
            scratch,
            FORWARD_STRIDE,
            min(TILE, width - tile_x),
            min(TILE, height - tile_y),
        )
        for block in range(BLOCKS):
            for plane in range(FIRST_FREE, FORWARD_STRIDE, LANES):
                store(scratch, block * FORWARD_STRIDE + plane, zero)
        first, end = U(offsets[U(tile)]), U(offsets[U(tile) + U(1)])
        while first < end and live != U(0):
            last = min(first + BATCH, end)
            find_touched_blocks(first, last, entries, records, tile_x, tile_y, touched)
            for entry in range(first, last):
                todo = live & U(touched[entry])
                start = U(entries[entry]) * U(RECORD)
                ellipse, red, green, blue, depth = place_splat(
                    records, start, tile_x, tile_y
                )
                while todo != U(0):
                    place = lowest_bit(todo) * FORWARD_STRIDE
                    todo &= todo - U(1)
                    _, _, exponent = splat_exponent(scratch, place, ellipse)
                    alpha = minimum(exp2(exponent), limit)
                    before = load(scratch, place + TRANSMITTANCE)
                    weight = alpha * before
                    after = before - weight
                    covered = exponent >= threshold
                    shown = covered & (after > least)
                    weight = select(shown, weight, zero)
                    store(
                        scratch,
                        place + TRANSMITTANCE,
                        select(shown, after, flag_negative(covered, before)),
                    )
                    store(
                        scratch,
                        place + _RED,
                        load(scratch, place + _RED) + weight * red,
                    )
                    store(
                        scratch,
                        place + _GREEN,
                        load(scratch, place + _GREEN) + weight * green,
                    )
                    store(
                        scratch,
                        place + _BLUE,
                        load(scratch, place + _BLUE) + weight * blue,
                    )
                    store(
                        scratch,
                        place + _DEPTH,
                        load(scratch, place + _DEPTH) + weight * depth,
                    )
            live &= live_blocks(scratch, FORWARD_STRIDE)
            first = last
        _write_tile(
            scratch,
            U(tile_x),
            U(tile_y),
            U(width),
            U(height),
            background,
            images,
            alphas,
            depths,
            transmittances,
        )


@inlined
def _write_tile(
    scratch,
    tile_x,
    tile_y,
    width,
    height,
    background,
    images,
    alphas,
    depths,
    transmittances,
):
    """Composite the background in place and copy a tile's pixels to the images."""
    plane = width * height
    for block in range(BLOCKS):
        x = tile_x + (block % BLOCKS_PER_ROW) * U(BLOCK)
        y = tile_y + (block // BLOCKS_PER_ROW) * U(BLOCK)
        if x >= width or y >= height:
            continue
        place, target = block * FORWARD_STRIDE, y * width + x
        columns, rows = min(U(BLOCK), width - x), min(U(BLOCK), height - y)
        left = magnitude(load(scratch, place + TRANSMITTANCE))
        alpha = broadcast(F(1)) - left
        store(scratch, place + TRANSMITTANCE, left)
        store(scratch, place + PIXEL_X, alpha)
        store(
            scratch,
            place + _DEPTH,
            load(scratch, place + _DEPTH) / maximum(alpha, F(MIN_TOTAL_ALPHA)),
        )
        write_block(
            scratch, place + TRANSMITTANCE, transmittances, target, width, columns, rows
        )
        write_block(scratch, place + PIXEL_X, alphas, target, width, columns, rows)
        write_block(scratch, place + _DEPTH, depths, target, width, columns, rows)
        for channel in range(U(3)):
            colour = place + _RED + channel * LANES
            store(scratch, colour, load(scratch, colour) + left * background[channel])
            write_block(
                scratch, colour, images, target + channel * plane, width, columns, rows
            )


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
    touched,
    shapes,
    scratch,
    images,
    depths,
    transmittances,
    image_gradients,
    alpha_gradients,
    depth_gradients,
    sums,
):
    """Fill `sums[e]` (see `layout`) for every entry of the tiles [first_tile, last_tile); without
    `shapes`, colours.
    """
    height, width = depths.shape
    offsets = flat(offsets)
    entries = flat(entries)
    records = flat(records)
    scratch = flat(scratch)
    touched, sums = flat(touched), flat(sums)
    images, depths, transmittances = flat(images), flat(depths), flat(transmittances)
    image_gradients, alpha_gradients = flat(image_gradients), flat(alpha_gradients)
    depth_gradients = flat(depth_gradients)
    zero = broadcast(F(0))
    threshold, limit, least = F(np.log2(min_alpha)), F(max_alpha), F(min_transmittance)
    plane = U(width) * U(height)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(
            scratch,
            BACKWARD_STRIDE,
            min(TILE, width - tile_x),
            min(TILE, height - tile_y),
        )
        for block in range(BLOCKS):
            x = U(tile_x) + (block % BLOCKS_PER_ROW) * U(BLOCK)
            y = U(tile_y) + (block // BLOCKS_PER_ROW) * U(BLOCK)
            if x < U(width) and y < U(height):
                place, corner = block * BACKWARD_STRIDE, y * U(width) + x
                shape = U(width), U(width) - x, U(height) - y
                _read_planes(
                    scratch, place, images, depths, transmittances, corner, plane, shape
                )
                seen = _load_planes(scratch, place)
                _read_planes(
                    scratch,
                    place,
                    image_gradients,
                    depth_gradients,
                    alpha_gradients,
                    corner,
                    plane,
                    shape,
                )
                _start_rest(scratch, place, seen)
        first, end = U(offsets[U(tile)]), U(offsets[U(tile) + U(1)])
        while first < end and live != U(0):
            last = min(first + BATCH, end)
            for entry in range(first, last):
                prefetch(records, U(entries[entry + U(LOOKAHEAD)]) * U(RECORD))
                todo = live & U(touched[entry])
                start = U(entries[entry]) * U(RECORD)
                ellipse, red, green, blue, depth = place_splat(
                    records, start, tile_x, tile_y
                )
                sum_v = zero
                sum_vs = zero
                sum_vt = zero
                sum_vss = zero
                sum_vst = zero
                sum_vtt = zero
                sum_red, sum_green, sum_blue, sum_depth = zero, zero, zero, zero
                while todo != U(0):
                    place = lowest_bit(todo) * BACKWARD_STRIDE
                    todo &= todo - U(1)
                    across, down, exponent = splat_exponent(scratch, place, ellipse)
                    full_alpha = exp2(exponent)
                    alpha = minimum(full_alpha, limit)
                    before = load(scratch, place + TRANSMITTANCE)
                    weight = alpha * before
                    after = before - weight
                    covered = exponent >= threshold
                    shown = covered & (after > least)
                    weight = select(shown, weight, zero)
                    store(
                        scratch,
                        place + TRANSMITTANCE,
                        select(shown, after, flag_negative(covered, before)),
                    )
                    by_red = load(scratch, place + _RED)
                    by_green = load(scratch, place + _GREEN)
                    by_blue = load(scratch, place + _BLUE)
                    by_depth = load(scratch, place + _DEPTH)
                    sum_red += weight * by_red
                    sum_green += weight * by_green
                    sum_blue += weight * by_blue
                    sum_depth += weight * by_depth
                    if shapes:
                        value = (
                            by_red * red
                            + by_green * green
                            + by_blue * blue
                            + by_depth * depth
                        )
                        rest = load(scratch, place + _REST) - weight * value
                        store(scratch, place + _REST, rest)
                        by_alpha = before * value - rest / (broadcast(F(1)) - alpha)
                        v = select(
                            shown & (full_alpha <= limit), alpha * by_alpha, zero
                        )
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
                    (
                        sum_v,
                        sum_vs,
                        sum_vt,
                        sum_vss,
                        sum_vst,
                        sum_vtt,
                        sum_red,
                        sum_green,
                        sum_blue,
                        sum_depth,
                    ),
                )
            live &= live_blocks(scratch, BACKWARD_STRIDE)
            first = last
        for place in range(first * U(SUMS), end * U(SUMS)):
            sums[place] = F(0)


@inlined
def _read_planes(scratch, place, images, depths, alphas, corner, plane, shape):
    """Copy a block of three colours, depth and a last image to the planes that `_start_rest` works
    on.
    """
    width, columns, rows = shape[0], min(U(BLOCK), shape[1]), min(U(BLOCK), shape[2])
    read_block(scratch, place + _RED, images, corner, width, columns, rows)
    read_block(scratch, place + _GREEN, images, corner + plane, width, columns, rows)
    read_block(
        scratch, place + _BLUE, images, corner + U(2) * plane, width, columns, rows
    )
    read_block(scratch, place + _DEPTH, depths, corner, width, columns, rows)
    read_block(scratch, place + _REST, alphas, corner, width, columns, rows)


@inlined
def _load_planes(scratch, place):
    red = load(scratch, place + _RED)
    green = load(scratch, place + _GREEN)
    blue = load(scratch, place + _BLUE)
    return red, green, blue, load(scratch, place + _DEPTH), load(scratch, place + _REST)


@inlined
def _start_rest(scratch, place, seen):
    """Compute the gradient by weighted depth, and `rest`, from a block's images (`seen`) and their
    gradients.
    """
    red, green, blue, depth, left = seen
    by_red, by_green, by_blue, by_depth, by_alpha = _load_planes(scratch, place)
    by_depth = by_depth / maximum(broadcast(F(1)) - left, F(MIN_TOTAL_ALPHA))
    rest = (
        red * by_red
        + green * by_green
        + blue * by_blue
        + depth * by_depth
        - left * by_alpha
    )
    store(scratch, place + _DEPTH, by_depth)
    store(scratch, place + _REST, rest)
