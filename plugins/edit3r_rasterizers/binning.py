"""Sort splats by depth and list them per tile, in that order."""

import numpy as np

from edit3r_rasterizers.compiled import inlined, kernel
from edit3r_rasterizers.records import FLATNESS, LEAN, NARROWNESS, REACH, RECORD, SLOPE, TILE, X, Y
from edit3r_rasterizers.simd_memory import flat, shifted

U = np.uint64
_DIGIT, _BUCKETS, _LAST = U(8), U(256), U(255)  # bits per pass of the sort
_PASSES = 4
COUNTS = _PASSES * 256
"""Length of the sort's table of counts."""
_EXACT_ABOVE = U(4)  # a box of more tiles than this is tested tile by tile


@kernel
def sort_by_depth(keys, boxes, index, values, other_index, other_values, counts):
    """Sort the splats that have a box by ascending key, equal keys in index order (radix sort, four passes of a byte).

    `keys`: the bits of positive float32, which order as the numbers do. The result is in `index`; returns its length.
    """
    size = U(len(keys))
    keys, boxes, counts = flat(keys), flat(boxes), flat(counts)
    index, values = flat(index), flat(values)
    other_index, other_values = flat(other_index), flat(other_values)
    for bucket in range(U(_PASSES) * _BUCKETS):
        counts[bucket] = 0
    n = U(0)
    for i in range(size):
        if boxes[U(4) * i] <= boxes[U(4) * i + U(2)]:
            key = keys[i]
            index[n], values[n] = i, key
            n += U(1)
            for digit in range(U(_PASSES)):
                counts[digit * _BUCKETS + ((U(key) >> (digit * _DIGIT)) & _LAST)] += 1
    for digit in range(U(_PASSES)):
        table = shifted(counts, digit * _BUCKETS)
        total = 0
        for bucket in range(_BUCKETS):
            table[bucket], total = total, total + table[bucket]
        for i in range(n):
            key = values[i]
            bucket = (U(key) >> (digit * _DIGIT)) & _LAST
            place = U(table[bucket])
            table[bucket] += 1
            other_index[place], other_values[place] = index[i], key
        index, other_index = other_index, index
        values, other_values = other_values, values
    return n


@inlined
def touches_tile(record, column, row):
    """Whether the splat's ellipse reaches the pixel centres of a tile: the smallest exponent over the rectangle."""
    left = np.float64(column * U(TILE)) + 0.5 - np.float64(record[X])
    top = np.float64(row * U(TILE)) + 0.5 - np.float64(record[Y])
    right, bottom = left + (TILE - 1), top + (TILE - 1)
    x, y = min(max(0.0, left), right), min(max(0.0, top), bottom)
    by_column = _exponent(record, x, min(max(record[LEAN] * x, top), bottom))
    by_row = _exponent(record, min(max(record[SLOPE] * y, left), right), y)
    return min(by_column, by_row) <= record[REACH] * 1.001 + 0.01


@inlined
def _exponent(record, x, y):
    across, down = record[NARROWNESS] * (x - record[SLOPE] * y), record[FLATNESS] * y
    return across * across + down * down


@kernel
def count_entries(order, boxes, records, columns, offsets):
    """Number of splats on each tile, as offsets of the tiles' lists: tile t has [offsets[t], offsets[t + 1])."""
    ranks, tiles, columns = U(len(order)), U(len(offsets)), U(columns)
    order, boxes, records, offsets = flat(order), flat(boxes), flat(records), flat(offsets)
    for tile in range(tiles):
        offsets[tile] = 0
    for rank in range(ranks):
        i = U(order[rank])
        record = shifted(records, i * U(RECORD))
        left, top, right, bottom = _box(boxes, i)
        exact = (right - left + U(1)) * (bottom - top + U(1)) > _EXACT_ABOVE
        for row in range(top, bottom + U(1)):
            for column in range(left, right + U(1)):
                if not exact or touches_tile(record, column, row):
                    offsets[row * columns + column + U(1)] += 1
    for tile in range(U(1), tiles):
        offsets[tile] += offsets[tile - U(1)]


@kernel
def list_entries(order, boxes, records, columns, cursors, entries, positions, places):
    """Fill each tile's list front to back; `cursors` (where each list begins) is used up.

    `entries[e]`: splat of entry e, entries grouped by tile. `positions[places[i, 0] : places[i, 1]]`: where splat i's
    entries are.
    """
    ranks, columns = U(len(order)), U(columns)
    order, boxes, records, cursors = flat(order), flat(boxes), flat(records), flat(cursors)
    entries, positions, places = flat(entries), flat(positions), flat(places)
    done = U(0)
    for rank in range(ranks):
        i = U(order[rank])
        record = shifted(records, i * U(RECORD))
        left, top, right, bottom = _box(boxes, i)
        exact = (right - left + U(1)) * (bottom - top + U(1)) > _EXACT_ABOVE
        places[U(2) * i] = done
        for row in range(top, bottom + U(1)):
            for column in range(left, right + U(1)):
                if not exact or touches_tile(record, column, row):
                    tile = row * columns + column
                    place = U(cursors[tile])
                    cursors[tile] += 1
                    entries[place], positions[done] = i, place
                    done += U(1)
        places[U(2) * i + U(1)] = done


@inlined
def _box(boxes, i):
    return U(boxes[U(4) * i]), U(boxes[U(4) * i + U(1)]), U(boxes[U(4) * i + U(2)]), U(boxes[U(4) * i + U(3)])
