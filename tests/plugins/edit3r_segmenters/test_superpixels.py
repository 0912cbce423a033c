import sys
from pathlib import Path

import numpy as np
from edit3r_segmenters.salience import measure
from edit3r_segmenters.superpixels import background_weights, merge_tree, superpixels

from edit3r.kit.compute.outlines import overlap

# pytest in importlib mode finds no neighbours
sys.path.insert(0, str(Path(__file__).parent))

from segmenter_scenes import backdrop, ellipse, with_object

HEIGHT, WIDTH = 96, 128
MASK = ellipse(HEIGHT, WIDTH, (64, 48), (26, 20))
PICTURE = with_object(backdrop(HEIGHT, WIDTH), MASK)
CELLS = superpixels(PICTURE)


def test_superpixels_add_up_to_the_picture():
    assert CELLS.areas.sum() == HEIGHT * WIDTH == CELLS.histograms.sum()
    assert sorted(np.unique(CELLS.labels)) == list(range(len(CELLS.areas)))
    assert (CELLS.pairs[:, 0] < CELLS.pairs[:, 1]).all() and len(
        np.unique(CELLS.pairs, axis=0)
    ) == len(CELLS.pairs)
    assert CELLS.strengths.min() >= 0 and CELLS.strengths.max() <= 1


def test_the_tree_holds_every_superpixel_and_every_merge_up_to_the_whole_picture():
    tree, count = merge_tree(CELLS), len(CELLS.areas)
    assert tree.shape == (2 * count - 1, count)
    assert np.array_equal(tree[:count], np.eye(count, dtype=bool)) and tree[-1].all()


def test_regions_of_the_tree_nest():
    tree = merge_tree(CELLS).astype(int)
    shared, sizes = tree @ tree.T, tree.sum(1)
    assert ((shared == 0) | (shared == np.minimum.outer(sizes, sizes))).all()


def test_the_object_is_one_region_of_the_tree():
    assert max(overlap(row[CELLS.labels], MASK) for row in merge_tree(CELLS)) > 0.9


def test_background_weight_is_high_outside_and_low_on_an_object():
    weights = background_weights(CELLS)[CELLS.labels]
    assert weights[MASK].mean() < 0.2 < 0.8 < weights[~MASK].mean()


def test_an_object_cut_by_the_border_is_still_an_object():
    mask = ellipse(HEIGHT, WIDTH, (64, 90), (26, 20))
    cells = superpixels(with_object(backdrop(HEIGHT, WIDTH), mask))
    weights = background_weights(cells)[cells.labels]
    assert weights[mask].mean() < weights[~mask].mean() - 0.2


def test_a_mask_on_the_object_measures_better_than_one_beside_it():
    background = background_weights(CELLS)[CELLS.labels]
    on, beside = (
        measure(mask, CELLS, background, (0, 1))
        for mask in (MASK, np.roll(MASK, 15, 1))
    )
    assert on.outline > 1.5 * beside.outline and on.separation > 1.5 * beside.separation
    assert (
        on.quality > beside.quality
        and on.salience > beside.salience
        and on.as_part > beside.as_part
    )


def test_masks_outside_the_allowed_areas_are_not_measured():
    background = np.zeros((HEIGHT, WIDTH))
    assert measure(MASK, CELLS, background, (0.5, 1)) is None
    assert measure(MASK, CELLS, background, (0, 0.01)) is None
    assert measure(np.zeros_like(MASK), CELLS, background, (0, 1)) is None
