"""Gradients of a tile's pixels by its splats, front to back like the forward pass.

Per pixel `rest` starts as (final picture . gradient) and loses each splat's share as it is passed, so that
d loss / d alpha = T * (colour . gradient) - rest / (1 - alpha) needs no list of what was drawn. Per entry ten sums
over the pixels are written to its own place and added up per splat afterwards: no two threads write to one number.
"""

import numpy as np
from numba import njit

from edit3r_rasterizers.raster_forward import (
    BLOCKS,
    LANES,
    LOWEST_EXPONENT,
    F,
    U,
    live_blocks,
    open_tile,
    touched_blocks,
)
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
    SUMS,
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
    maximum,
    minimum,
    negative_magnitude,
    select,
    store,
    store_sums,
)

STRIDE = U(6) * LANES  # planes: transmittance, gradients by red, green, blue and weighted depth, rest
BACKWARD_SCRATCH = int(BLOCKS * STRIDE)
_RECHECK = U(16)


@njit(cache=True, error_model="numpy", nogil=True)
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
    images,
    alphas,
    depths,
    transmittances,
    image_gradients,
    alpha_gradients,
    depth_gradients,
    sums,
):
    """Fill `sums[e]` (see `records`) for every entry of the tiles [first_tile, last_tile)."""
    height, width = alphas.shape
    zero = broadcast(F(0))
    threshold = F(np.log2(min_alpha))
    limit, least = broadcast(F(max_alpha)), F(min_transmittance)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        live = open_tile(scratch, STRIDE, min(TILE, width - tile_x), min(TILE, height - tile_y))
        _read_tile(
            scratch, tile_x, tile_y, images, alphas, depths, transmittances,
            image_gradients, alpha_gradients, depth_gradients,
        )  # fmt: skip
        for entry in range(U(offsets[tile]), U(offsets[tile + 1])):
            if (entry & (_RECHECK - U(1))) == U(0):
                live = live & live_blocks(scratch, STRIDE)
                if live == U(0):
                    sums[entry : U(offsets[tile + 1])] = F(0)
                    break
            record = records[U(entries[entry])]
            x, y = (record[X] - F(tile_x)) + record[X_REST], (record[Y] - F(tile_y)) + record[Y_REST]
            slope, narrowness, flatness = record[SLOPE], record[NARROWNESS], record[FLATNESS]
            todo = live & touched_blocks(x, y, slope, record[LEAN], narrowness, flatness, record[REACH])
            log_opacity = broadcast(record[LOG_OPACITY])
            red, green, blue, depth = record[RED], record[GREEN], record[BLUE], record[DEPTH]
            lanes_across = (lane_columns() - lane_rows() * slope) * narrowness
            lanes_down = lane_rows() * flatness
            sum_v, sum_vs, sum_vt, sum_vss, sum_vst, sum_vtt = zero, zero, zero, zero, zero, zero
            sum_red, sum_green, sum_blue, sum_depth = zero, zero, zero, zero
            while todo != U(0):
                block = lowest_bit(todo)
                todo &= todo - U(1)
                dx, dy = F((block & U(3)) * U(BLOCK)) + (F(0.5) - x), F((block >> U(2)) * U(BLOCK)) + (F(0.5) - y)
                across, down = lanes_across + narrowness * (dx - slope * dy), lanes_down + flatness * dy
                exponent = maximum(log_opacity - across * across - down * down, LOWEST_EXPONENT)
                full_alpha = exp2(exponent)
                alpha = minimum(full_alpha, limit)
                place = block * STRIDE
                before = load(scratch, place)
                weight = alpha * before
                after = before - weight
                covered = exponent >= threshold
                shown = covered & (after > least)
                weight = select(shown, weight, zero)
                store(scratch, place, select(shown, after, select(covered, negative_magnitude(before), before)))
                by_red, by_green = load(scratch, place + LANES), load(scratch, place + U(2) * LANES)
                by_blue, by_depth = load(scratch, place + U(3) * LANES), load(scratch, place + U(4) * LANES)
                sum_red += weight * by_red
                sum_green += weight * by_green
                sum_blue += weight * by_blue
                sum_depth += weight * by_depth
                value = by_red * red + by_green * green + by_blue * blue + by_depth * depth
                rest = load(scratch, place + U(5) * LANES) - weight * value
                store(scratch, place + U(5) * LANES, rest)
                by_alpha = before * value - rest / (F(1) - alpha)
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


@njit(error_model="numpy")
def _read_tile(
    scratch,
    tile_x,
    tile_y,
    images,
    alphas,
    depths,
    transmittances,
    image_gradients,
    alpha_gradients,
    depth_gradients,
):
    """Set the gradient planes and `rest` of a tile from the pictures and their gradients."""
    height, width = alphas.shape
    for place in range(U(BACKWARD_SCRATCH)):
        if place % STRIDE >= LANES:
            scratch[place] = F(0)
    for y in range(U(tile_y), U(min(tile_y + TILE, height))):
        for x in range(U(tile_x), U(min(tile_x + TILE, width))):
            row, column = y - U(tile_y), x - U(tile_x)
            block = (row // U(BLOCK)) * U(TILE // BLOCK) + column // U(BLOCK)
            place = block * STRIDE + (row % U(BLOCK)) * U(BLOCK) + column % U(BLOCK)
            rest = F(0)
            for channel in range(U(3)):
                gradient = image_gradients[channel, y, x]
                scratch[place + (channel + U(1)) * LANES] = gradient
                rest += gradient * images[channel, y, x]
            alpha, by_depth = alphas[y, x], depth_gradients[y, x]
            scratch[place + U(4) * LANES] = by_depth / max(alpha, F(MIN_TOTAL_ALPHA))
            rest -= transmittances[y, x] * alpha_gradients[y, x]
            if alpha > F(MIN_TOTAL_ALPHA):
                rest += by_depth * depths[y, x] / alpha
            scratch[place + U(5) * LANES] = rest
