"""List the splats that each tile has to draw: sort them by depth, then distribute them over the
tiles.
"""

from dataclasses import dataclass

import numpy as np

from edit3r.contract.errors import RunError
from edit3r_rasterizers import layout
from edit3r_rasterizers.kernels import even_bounds, inlined, kernel, run_slices
from edit3r_rasterizers.simd_memory import flat, prefetch, shifted

MAX_ENTRIES = 2**31 - 1
U = np.uint64
_DIGIT, _BUCKETS, _LAST = U(8), U(256), U(255)  # bits per pass of the sort
_PASSES = U(4)
COUNTS = 4 * 256
"""Length of the sort's table of counts."""
_AHEAD = U(8)  # splats whose memory is asked for before it is their turn
_EXACT_ABOVE = U(4)  # a box of more tiles than this is tested tile by tile


@dataclass(frozen=True)
class TileGrid:
    """The tiles of an image."""

    height: int  # [pixels]
    width: int  # [pixels]

    @property
    def columns(self) -> int:
        return -(-self.width // layout.TILE)

    @property
    def rows(self) -> int:
        return -(-self.height // layout.TILE)

    @property
    def count(self) -> int:
        return self.rows * self.columns


@dataclass(frozen=True)
class TileLists:
    """Entries: one for each splat on each tile, grouped by tile, front to back."""

    offsets: np.ndarray  # [tiles + 1], where each tile's entries begin
    entries: np.ndarray  # [E + layout.LOOKAHEAD], splat of each entry
    # [E + layout.LOOKAHEAD], entries grouped by splat; empty where no gradients are wanted
    positions: np.ndarray
    # [G + 1], where each splat's positions begin; empty like these
    splat_offsets: np.ndarray


def list_tiles(
    threads: int,
    grid: TileGrid,
    records: np.ndarray,
    boxes: np.ndarray,
    keys: np.ndarray,
    by_splat: bool = True,
) -> TileLists:
    """Sort the splats by depth and distribute them over the tiles, in the same order for any number
    of threads.

    Each chunk of the depth order is counted first, so that it knows where its part of every tile's
    list begins.
    """
    order = _sort(keys, boxes)
    chunks = np.array(even_bounds(len(order), threads), np.int64)
    slices = list(range(len(chunks)))
    shared = grid.columns, (chunks, order, boxes, records)
    counts = np.empty((len(chunks) - 1, grid.count), np.int64)
    splat_offsets = np.zeros(len(records) + 1 if by_splat else 1, np.int64)
    run_slices(count_entries, slices, threads, *shared, counts, splat_offsets[1:])
    np.cumsum(splat_offsets, out=splat_offsets)
    offsets = np.zeros(grid.count + 1, np.int64)
    np.cumsum(counts.sum(0), out=offsets[1:])
    total = int(offsets[-1])
    _check_total(total)

    cursors = offsets[:-1] + np.cumsum(counts, 0) - counts
    entries = np.empty(total + layout.LOOKAHEAD, np.int32)
    positions = np.empty(len(entries) if by_splat else 0, np.int32)
    entries[-layout.LOOKAHEAD :] = positions[-layout.LOOKAHEAD :] = 0
    lists = splat_offsets, entries, positions
    run_slices(list_entries, slices, threads, *shared, cursors, lists)
    return TileLists(offsets, entries, positions, splat_offsets)


def _sort(keys: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the indices of the splats that have a box, front to back."""
    index, values, other_index, other_values = (
        np.empty(len(keys), kind) for kind in (np.int32, np.uint32, np.int32, np.uint32)
    )
    counts = np.empty(COUNTS, np.int64)
    length, swapped = sort_by_depth(
        keys.view(np.uint32), boxes, index, values, other_index, other_values, counts
    )
    return (other_index if swapped else index)[:length]


def _check_total(total: int) -> None:
    if total > MAX_ENTRIES:
        raise RunError(
            f"rasterizer 'numba': {total} pairs of Gaussian and tile, at most {MAX_ENTRIES} can be "
            "listed; the Gaussians cover the picture too many times over. Use fewer, smaller ones, "
            "or a smaller picture."
        )


@kernel
def sort_by_depth(keys, boxes, index, values, other_index, other_values, counts):
    """Sort the splats that have a box by ascending key, equal keys in index order (radix sort, a
    byte a pass).

    `keys`: the bits of positive float32, which order as the numbers do. Returns how many there are
    and whether the result is in `other_index` instead of `index`: a pass over a byte that all keys
    share is left out.
    """
    size = U(len(keys))
    keys, boxes, counts = flat((keys, boxes, counts))
    index, values = flat((index, values))
    other_index, other_values = flat((other_index, other_values))
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
    """Whether the splat's ellipse reaches pixel centres of a tile, by its smallest exponent."""
    left = np.float64(column * U(layout.TILE)) + 0.5 - np.float64(record[layout.X])
    top = np.float64(row * U(layout.TILE)) + 0.5 - np.float64(record[layout.Y])
    right, bottom = left + (layout.TILE - 1), top + (layout.TILE - 1)
    x, y = min(max(0.0, left), right), min(max(0.0, top), bottom)
    by_column = _exponent(record, x, min(max(record[layout.Y_PER_X] * x, top), bottom))
    by_row = _exponent(record, min(max(record[layout.X_PER_Y] * y, left), right), y)
    return min(by_column, by_row) <= record[layout.CUTOFF] * 1.001 + 0.01


@inlined
def _exponent(record, x, y):
    across = record[layout.INV_STD_X] * (x - record[layout.X_PER_Y] * y)
    down = record[layout.INV_STD_Y] * y
    return across * across + down * down


@kernel
def count_entries(first, last, columns, splats, counts, numbers):
    """Count for the chunks [first, last) the splats on each tile, and the tiles of each splat.

    `splats` are bounds, order, boxes and records: chunk c has the ranks [bounds[c], bounds[c + 1])
    in depth `order`. Fills rows of `counts` [chunks, tiles] and `numbers` [splats], which may be
    empty.
    """
    tiles, columns, by_splat = U(counts.shape[1]), U(columns), len(numbers) > 0
    bounds, order, boxes, records = flat(splats)
    counts, numbers = flat((counts, numbers))
    for chunk in range(U(first), U(last)):
        table = shifted(counts, chunk * tiles)
        for tile in range(tiles):
            table[tile] = 0
        end = U(bounds[chunk + U(1)])
        for rank in range(U(bounds[chunk]), end):
            prefetch(boxes, U(4) * U(order[min(rank + _AHEAD, end - U(1))]))
            i = U(order[rank])
            record = shifted(records, i * U(layout.RECORD))
            left, top, right, bottom, exact = _box(boxes, i)
            number = 0
            for row in range(top, bottom + U(1)):
                for column in range(left, right + U(1)):
                    if not exact or touches_tile(record, column, row):
                        table[row * columns + column] += 1
                        number += 1
            if by_splat:
                numbers[i] = number


@kernel
def list_entries(first, last, columns, splats, cursors, lists):
    """Put each splat of the chunks [first, last) at the end of its tiles' lists; `splats` as above.

    `cursors` [chunks, tiles]: where the chunk's part of each list begins; used up. `lists` are
    splat_offsets, entries and positions. `entries[e]`: splat of entry e, entries grouped by tile,
    front to back. `positions[splat_offsets[i] : splat_offsets[i + 1]]`: the entries of splat i; not
    where it is empty.
    """
    tiles, columns, by_splat = U(cursors.shape[1]), U(columns), len(lists[2]) > 0
    bounds, order, boxes, records = flat(splats)
    splat_offsets, entries, positions = flat(lists)
    cursors = flat(cursors)
    for chunk in range(U(first), U(last)):
        table = shifted(cursors, chunk * tiles)
        end = U(bounds[chunk + U(1)])
        for rank in range(U(bounds[chunk]), end):
            prefetch(boxes, U(4) * U(order[min(rank + _AHEAD, end - U(1))]))
            i = U(order[rank])
            record = shifted(records, i * U(layout.RECORD))
            left, top, right, bottom, exact = _box(boxes, i)
            done = U(splat_offsets[i]) if by_splat else U(0)
            for row in range(top, bottom + U(1)):
                for column in range(left, right + U(1)):
                    if not exact or touches_tile(record, column, row):
                        tile = row * columns + column
                        place = U(table[tile])
                        table[tile] += 1
                        entries[place] = i
                        if by_splat:
                            positions[done] = place
                            done += U(1)


@inlined
def _box(boxes, i):
    """Read the box of a splat, and whether it is so large that its tiles are tested one by one."""
    place = U(4) * i
    left, top = U(boxes[place]), U(boxes[place + U(1)])
    right, bottom = U(boxes[place + U(2)]), U(boxes[place + U(3)])
    count = (right - left + U(1)) * (bottom - top + U(1))
    return left, top, right, bottom, count > _EXACT_ABOVE
