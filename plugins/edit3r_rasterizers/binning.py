"""Sort splats by depth and list them per tile, in that order."""

import numpy as np
from numba import njit

from edit3r_rasterizers.records import FLATNESS, LEAN, NARROWNESS, REACH, SLOPE, TILE, X, Y

_DIGIT = 11  # bits per pass: three passes over 32-bit keys
_BUCKETS = 1 << _DIGIT
_EXACT_ABOVE = 4  # a box of more tiles than this is tested tile by tile


@njit(cache=True, error_model="numpy", nogil=True)
def sort_by_depth(keys, boxes):
    """Indices of the splats with a non-empty box, by ascending key, equal keys in index order (radix sort).

    `keys`: the bits of positive float32, which order as the numbers do.
    """
    index = np.empty(len(keys), np.int32)
    values = np.empty(len(keys), np.uint32)
    counts = np.zeros((3, _BUCKETS), np.int64)
    n = np.uint64(0)
    for i in range(np.uint64(len(keys))):
        if boxes[i, 0] <= boxes[i, 2]:
            key = keys[i]
            index[n], values[n] = i, key
            n += np.uint64(1)
            counts[0, key & np.uint32(_BUCKETS - 1)] += 1
            counts[1, (key >> np.uint32(_DIGIT)) & np.uint32(_BUCKETS - 1)] += 1
            counts[2, key >> np.uint32(2 * _DIGIT)] += 1
    index, values = index[:n], values[:n]
    other_index, other_values = np.empty_like(index), np.empty_like(values)
    for digit in range(3):
        total = 0
        for bucket in range(_BUCKETS):
            counts[digit, bucket], total = total, total + counts[digit, bucket]
        shift = np.uint32(digit * _DIGIT)
        for i in range(n):
            bucket = (values[i] >> shift) & np.uint32(_BUCKETS - 1)
            place = np.uint64(counts[digit, bucket])
            counts[digit, bucket] += 1
            other_index[place], other_values[place] = index[i], values[i]
        index, other_index = other_index, index
        values, other_values = other_values, values
    return index


@njit(error_model="numpy")
def touches_tile(record, column, row):
    """Whether the splat's ellipse reaches the pixel centres of a tile: the smallest exponent over the rectangle."""
    left, top = column * TILE + 0.5 - np.float64(record[X]), row * TILE + 0.5 - np.float64(record[Y])
    right, bottom = left + (TILE - 1), top + (TILE - 1)
    x, y = min(max(0.0, left), right), min(max(0.0, top), bottom)
    by_column = _exponent(record, x, min(max(record[LEAN] * x, top), bottom))
    by_row = _exponent(record, min(max(record[SLOPE] * y, left), right), y)
    return min(by_column, by_row) <= record[REACH] * 1.001 + 0.001


@njit(error_model="numpy")
def _exponent(record, x, y):
    across, down = record[NARROWNESS] * (x - record[SLOPE] * y), record[FLATNESS] * y
    return across * across + down * down


@njit(cache=True, error_model="numpy", nogil=True)
def count_entries(order, boxes, records, columns, offsets):
    """Number of splats on each tile, as offsets of the tiles' lists: tile t has [offsets[t], offsets[t + 1])."""
    offsets[:] = 0
    for rank in range(np.uint64(len(order))):
        i = np.uint64(order[rank])
        left, top, right, bottom = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        exact = (int(right) - left + 1) * (int(bottom) - top + 1) > _EXACT_ABOVE
        for row in range(top, int(bottom) + 1):
            for column in range(left, int(right) + 1):
                if not exact or touches_tile(records[i], column, row):
                    offsets[np.uint64(row * columns + column + 1)] += 1
    for tile in range(1, len(offsets)):
        offsets[tile] += offsets[tile - 1]


@njit(cache=True, error_model="numpy", nogil=True)
def list_entries(order, boxes, records, columns, offsets, entries, positions, first):
    """Fill each tile's list front to back.

    `entries[e]`: splat of entry e, entries grouped by tile. `positions[first[i]:first[i + 1]]`... of splat i: where
    its entries are.
    """
    cursor = offsets.copy()
    done = np.uint64(0)
    for rank in range(np.uint64(len(order))):
        i = np.uint64(order[rank])
        first[i, 0] = done
        left, top, right, bottom = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        exact = (int(right) - left + 1) * (int(bottom) - top + 1) > _EXACT_ABOVE
        for row in range(top, int(bottom) + 1):
            for column in range(left, int(right) + 1):
                if not exact or touches_tile(records[i], column, row):
                    tile = np.uint64(row * columns + column)
                    place = np.uint64(cursor[tile])
                    cursor[tile] += 1
                    entries[place] = i
                    positions[done] = place
                    done += np.uint64(1)
        first[i, 1] = done
