"""Sort splats by depth and list them per tile, in that order."""

import numpy as np

from edit3r_rasterizers.compiled import inlined, kernel
from edit3r_rasterizers.records import FLATNESS, LEAN, NARROWNESS, REACH, RECORD, SLOPE, TILE, X, Y
from edit3r_rasterizers.simd_memory import flat, prefetch, shifted

U = np.uint64
_DIGIT, _BUCKETS, _LAST = U(8), U(256), U(255)  # bits per pass of the sort
_PASSES = U(4)
COUNTS = 4 * 256
"""Length of the sort's table of counts."""
_AHEAD = U(8)  # splats whose memory is asked for before it is their turn
_EXACT_ABOVE = U(4)  # a box of more tiles than this is tested tile by tile


@kernel
def sort_by_depth(keys, boxes, index, values, other_index, other_values, counts):
    """Sort the splats that have a box by ascending key, equal keys in index order (radix sort, a byte a pass).

    `keys`: the bits of positive float32, which order as the numbers do. Returns how many there are and whether the
    result is in `other_index` instead of `index`: a pass over a byte that all keys share is left out.
    """
    size = U(len(keys))
    keys, boxes, counts = flat(keys), flat(boxes), flat(counts)
    index, values = flat(index), flat(values)
    other_index, other_values = flat(other_index), flat(other_values)
    for bucket in range(_PASSES * _BUCKETS):
        counts[bucket] = 0
    n = U(0)
    for i in range(size):
        if boxes[U(4) * i] <= boxes[U(4) * i + U(2)]:
            key = keys[i]
            index[n], values[n] = i, key
            n += U(1)
            for digit in range(_PASSES):
                counts[digit * _BUCKETS + ((U(key) >> (digit * _DIGIT)) & _LAST)] += 1
    swapped = False
    for digit in range(_PASSES):
        table = shifted(counts, digit * _BUCKETS)
        if n == U(0) or U(table[(U(values[U(0)]) >> (digit * _DIGIT)) & _LAST]) == n:
            continue
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
        swapped = not swapped
    return n, swapped


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
def count_entries(first, last, bounds, order, boxes, records, columns, counts, numbers):
    """For the chunks [first, last): how many of its splats are on each tile, and on how many tiles each splat is.

    Chunk c has the ranks [bounds[c], bounds[c + 1]) in depth `order`. Fills rows of `counts` [chunks, tiles] and
    `numbers` [splats].
    """
    tiles, columns = U(counts.shape[1]), U(columns)
    bounds, order, boxes, records = flat(bounds), flat(order), flat(boxes), flat(records)
    counts, numbers = flat(counts), flat(numbers)
    for chunk in range(U(first), U(last)):
        table = shifted(counts, chunk * tiles)
        for tile in range(tiles):
            table[tile] = 0
        end = U(bounds[chunk + U(1)])
        for rank in range(U(bounds[chunk]), end):
            prefetch(boxes, U(4) * U(order[min(rank + _AHEAD, end - U(1))]))
            i = U(order[rank])
            record = shifted(records, i * U(RECORD))
            left, top, right, bottom = _box(boxes, i)
            exact = (right - left + U(1)) * (bottom - top + U(1)) > _EXACT_ABOVE
            number = 0
            for row in range(top, bottom + U(1)):
                for column in range(left, right + U(1)):
                    if not exact or touches_tile(record, column, row):
                        table[row * columns + column] += 1
                        number += 1
            numbers[i] = number


@kernel
def list_entries(first, last, bounds, order, boxes, records, columns, cursors, places, entries, positions):
    """For the chunks [first, last): put each splat at the end of its tiles' lists.

    `cursors` [chunks, tiles]: where the chunk's part of each list begins; used up. `entries[e]`: splat of entry e,
    entries grouped by tile, front to back. `positions[places[i] : places[i + 1]]`: where splat i's entries are.
    """
    tiles, columns = U(cursors.shape[1]), U(columns)
    bounds, order, boxes, records = flat(bounds), flat(order), flat(boxes), flat(records)
    cursors, places, entries, positions = flat(cursors), flat(places), flat(entries), flat(positions)
    for chunk in range(U(first), U(last)):
        table = shifted(cursors, chunk * tiles)
        end = U(bounds[chunk + U(1)])
        for rank in range(U(bounds[chunk]), end):
            coming = U(order[min(rank + _AHEAD, end - U(1))])
            prefetch(boxes, U(4) * coming)
            prefetch(places, coming)
            i = U(order[rank])
            record = shifted(records, i * U(RECORD))
            left, top, right, bottom = _box(boxes, i)
            exact = (right - left + U(1)) * (bottom - top + U(1)) > _EXACT_ABOVE
            done = U(places[i])
            for row in range(top, bottom + U(1)):
                for column in range(left, right + U(1)):
                    if not exact or touches_tile(record, column, row):
                        tile = row * columns + column
                        place = U(table[tile])
                        table[tile] += 1
                        entries[place], positions[done] = i, place
                        done += U(1)


@inlined
def _box(boxes, i):
    return U(boxes[U(4) * i]), U(boxes[U(4) * i + U(1)]), U(boxes[U(4) * i + U(2)]), U(boxes[U(4) * i + U(3)])
