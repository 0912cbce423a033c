"""Composite the splats of each tile front to back, a 4x4 block of pixels at a time, and
differentiate that.

The backward pass goes front to back too. Per pixel `rest` starts as (final image . gradient) and
loses each splat's share as it is passed, so that d loss / d alpha = T * (colour . gradient) - rest
/ (1 - alpha) needs no list of what was drawn. Per entry ten sums over the pixels are written to its
own place and added up per splat afterwards: no two threads write to one number.
"""

from edit3r_rasterizers.kernels import inlined, kernel
from edit3r_rasterizers.layout import BLOCK, LOOKAHEAD, RECORD, SUMS, TILE
from edit3r_rasterizers.settings import MIN_TOTAL_ALPHA
from edit3r_rasterizers.simd import broadcast, lowest_bit, magnitude, maximum, select
from edit3r_rasterizers.simd_memory import add, flat, load, prefetch, store, store_sums
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
    pass_splat,
    place_splat,
    read_block,
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
    first_tile, last_tile, columns, lists, limits, background, scratch, images, left
):
    """Render the tiles [first_tile, last_tile) of one image into `images` (see
    `layout.CameraImages`) and the transmittance `left` [H, W].

    `lists` are offsets, entries, records and touched: `touched[e]` becomes the blocks that entry e
    reaches, as bits; the backward pass reads it. `limits` are those of `pass_splat`.
    """
    height, width = left.shape
    offsets, entries, records, touched = flat(lists)
    scratch, background, left = flat((scratch, background, left))
    images = flat(images)
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        inside = min(TILE, width - tile_x), min(TILE, height - tile_y)
        live = open_tile(scratch, FORWARD_STRIDE, inside[0], inside[1])
        for block in range(BLOCKS):
            for plane in range(FIRST_FREE, FORWARD_STRIDE, LANES):
                store(scratch, block * FORWARD_STRIDE + plane, broadcast(F(0)))
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
                    _, _, _, _, _, weight, _ = pass_splat(
                        scratch, place, ellipse, limits
                    )
                    add(scratch, place + _RED, weight * red)
                    add(scratch, place + _GREEN, weight * green)
                    add(scratch, place + _BLUE, weight * blue)
                    add(scratch, place + _DEPTH, weight * depth)
            live &= live_blocks(scratch, FORWARD_STRIDE)
            first = last
        corner, size = (U(tile_x), U(tile_y)), (U(width), U(height))
        _write_tile(scratch, corner, size, background, images, left)


@inlined
def _write_tile(scratch, corner, size, background, images, left):
    """Composite the background in place and copy a tile's pixels to the images."""
    width, height = size
    for block in range(BLOCKS):
        x = corner[0] + (block % BLOCKS_PER_ROW) * U(BLOCK)
        y = corner[1] + (block // BLOCKS_PER_ROW) * U(BLOCK)
        if x >= width or y >= height:
            continue
        place, target = block * FORWARD_STRIDE, y * width + x
        shape = width, min(U(BLOCK), width - x), min(U(BLOCK), height - y)
        through = magnitude(load(scratch, place + TRANSMITTANCE))
        alpha = broadcast(F(1)) - through
        depth = load(scratch, place + _DEPTH) / maximum(alpha, F(MIN_TOTAL_ALPHA))
        store(scratch, place + TRANSMITTANCE, through)
        store(scratch, place + PIXEL_X, alpha)
        store(scratch, place + _DEPTH, depth)
        write_block(scratch, place + TRANSMITTANCE, left, target, shape)
        write_block(scratch, place + PIXEL_X, images.alpha, target, shape)
        write_block(scratch, place + _DEPTH, images.depth, target, shape)
        for channel in range(U(3)):
            colour, plane = place + _RED + channel * LANES, channel * width * height
            add(scratch, colour, through * background[channel])
            write_block(scratch, colour, images.image, target + plane, shape)


@kernel
def differentiate_tiles(
    first_tile,
    last_tile,
    columns,
    lists,
    limits,
    shapes,
    scratch,
    images,
    left,
    gradients,
    sums,
):
    """Fill `sums[e]` (see `layout`) for every entry of the tiles [first_tile, last_tile); without
    `shapes`, colours. `gradients` are those by `images`.
    """
    height, width = left.shape
    offsets, entries, records, touched = flat(lists)
    scratch, sums, left = flat((scratch, sums, left))
    images, gradients = flat(images), flat(gradients)
    zero, one = broadcast(F(0)), broadcast(F(1))
    for tile in range(first_tile, last_tile):
        tile_x, tile_y = (tile % columns) * TILE, (tile // columns) * TILE
        inside = min(TILE, width - tile_x), min(TILE, height - tile_y)
        live = open_tile(scratch, BACKWARD_STRIDE, inside[0], inside[1])
        for block in range(BLOCKS):
            x = U(tile_x) + (block % BLOCKS_PER_ROW) * U(BLOCK)
            y = U(tile_y) + (block // BLOCKS_PER_ROW) * U(BLOCK)
            if x < U(width) and y < U(height):
                place, size = block * BACKWARD_STRIDE, (U(width), U(height))
                _read_planes(scratch, place, images, left, x, y, size)
                seen = _load_planes(scratch, place)
                _read_planes(scratch, place, gradients, gradients.alpha, x, y, size)
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
                sum_v, sum_vs, sum_vt = zero, zero, zero
                sum_vss, sum_vst, sum_vtt = zero, zero, zero
                sum_red, sum_green, sum_blue, sum_depth = zero, zero, zero, zero
                while todo != U(0):
                    place = lowest_bit(todo) * BACKWARD_STRIDE
                    todo &= todo - U(1)
                    across, down, full_alpha, alpha, before, weight, shown = pass_splat(
                        scratch, place, ellipse, limits
                    )
                    by_red, by_green, by_blue, by_depth, rest = _load_planes(
                        scratch, place
                    )
                    sum_red += weight * by_red
                    sum_green += weight * by_green
                    sum_blue += weight * by_blue
                    sum_depth += weight * by_depth
                    if shapes:
                        colour = by_red * red + by_green * green + by_blue * blue
                        value = colour + by_depth * depth
                        rest = rest - weight * value
                        store(scratch, place + _REST, rest)
                        by_alpha = before * value - rest / (one - alpha)
                        free = shown & (full_alpha <= limits[1])
                        v = select(free, alpha * by_alpha, zero)
                        vs, vt = v * across, v * down
                        sum_v += v
                        sum_vs += vs
                        sum_vt += vt
                        sum_vss += vs * across
                        sum_vst += vs * down
                        sum_vtt += vt * down
                of_shape = sum_v, sum_vs, sum_vt, sum_vss, sum_vst, sum_vtt
                of_colour = sum_red, sum_green, sum_blue, sum_depth
                store_sums(sums, entry * U(SUMS), of_shape + of_colour)
            live &= live_blocks(scratch, BACKWARD_STRIDE)
            first = last
        for place in range(first * U(SUMS), end * U(SUMS)):
            sums[place] = F(0)


@inlined
def _read_planes(scratch, place, images, last, x, y, size):
    """Copy a block of colours, depth and a last image to the planes that `_start_rest` reads."""
    width, height = size
    shape = width, min(U(BLOCK), width - x), min(U(BLOCK), height - y)
    corner = y * width + x
    for channel in range(U(3)):
        source = corner + channel * width * height
        read_block(scratch, place + _RED + channel * LANES, images.image, source, shape)
    read_block(scratch, place + _DEPTH, images.depth, corner, shape)
    read_block(scratch, place + _REST, last, corner, shape)


@inlined
def _load_planes(scratch, place):
    red = load(scratch, place + _RED)
    green = load(scratch, place + _GREEN)
    blue = load(scratch, place + _BLUE)
    return red, green, blue, load(scratch, place + _DEPTH), load(scratch, place + _REST)


@inlined
def _start_rest(scratch, place, seen):
    """The gradient by weighted depth, and `rest`, of a block's images (`seen`) and gradients."""
    red, green, blue, depth, left = seen
    by_red, by_green, by_blue, by_depth, by_alpha = _load_planes(scratch, place)
    by_depth = by_depth / maximum(broadcast(F(1)) - left, F(MIN_TOTAL_ALPHA))
    colour = red * by_red + green * by_green + blue * by_blue
    store(scratch, place + _DEPTH, by_depth)
    store(scratch, place + _REST, colour + depth * by_depth - left * by_alpha)
