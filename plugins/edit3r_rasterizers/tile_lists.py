"""Which splats each tile has to draw, and in which order."""

from dataclasses import dataclass

import numpy as np

from edit3r.errors import RunError
from edit3r_rasterizers.binning import COUNTS, count_entries, list_entries, sort_by_depth
from edit3r_rasterizers.records import LOOKAHEAD, TileGrid
from edit3r_rasterizers.threads import even_bounds, run_slices

MAX_ENTRIES = 2**31 - 1


@dataclass(frozen=True)
class TileLists:
    """Entries: one for each splat on each tile, grouped by tile, front to back."""

    offsets: np.ndarray  # [tiles + 1], where each tile's entries begin
    entries: np.ndarray  # [E + LOOKAHEAD], splat of each entry
    positions: np.ndarray  # [E + LOOKAHEAD], entries grouped by splat
    places: np.ndarray  # [G + 1], where each splat's positions begin


def list_tiles(threads: int, grid: TileGrid, records: np.ndarray, boxes: np.ndarray, keys: np.ndarray) -> TileLists:
    """Sort the splats by depth and distribute them over the tiles, in the same order for any number of threads.

    Each chunk of the depth order is counted first, so that it knows where its part of every tile's list begins.
    """
    order = _sort(keys, boxes)
    chunks = np.array(even_bounds(len(order), threads), np.int64)
    slices = list(range(len(chunks)))
    shared = chunks, order, boxes, records, grid.columns
    counts = np.empty((len(chunks) - 1, grid.count), np.int64)
    places = np.zeros(len(records) + 1, np.int64)
    run_slices(count_entries, slices, threads, *shared, counts, places[1:])
    np.cumsum(places, out=places)
    _check_total(int(places[-1]))

    offsets = np.zeros(grid.count + 1, np.int64)
    np.cumsum(counts.sum(0), out=offsets[1:])
    cursors = offsets[:-1] + np.cumsum(counts, 0) - counts
    entries, positions = (np.empty(places[-1] + LOOKAHEAD, np.int32) for _ in range(2))
    entries[-LOOKAHEAD:] = positions[-LOOKAHEAD:] = 0
    run_slices(list_entries, slices, threads, *shared, cursors, places, entries, positions)
    return TileLists(offsets, entries, positions, places)


def _sort(keys: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Indices of the splats that have a box, front to back."""
    index, values, other_index, other_values = (
        np.empty(len(keys), kind) for kind in (np.int32, np.uint32, np.int32, np.uint32)
    )
    counts = np.empty(COUNTS, np.int64)
    length, swapped = sort_by_depth(keys.view(np.uint32), boxes, index, values, other_index, other_values, counts)
    return (other_index if swapped else index)[:length]


def _check_total(total: int) -> None:
    if total > MAX_ENTRIES:
        raise RunError(
            f"rasterizer 'numba': {total} pairs of Gaussian and tile, at most {MAX_ENTRIES} can be listed; "
            f"the Gaussians cover the picture too many times over. Use fewer, smaller ones, or a smaller picture."
        )
