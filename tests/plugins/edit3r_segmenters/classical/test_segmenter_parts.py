import sys
from pathlib import Path

import numpy as np
import pytest
from edit3r_segmenters.classical.segmenter_background import background_weights
from edit3r_segmenters.classical.segmenter_masks import overlap, snapped, softened, tidied
from edit3r_segmenters.classical.segmenter_merging import merge_tree
from edit3r_segmenters.classical.segmenter_objectness import measure
from edit3r_segmenters.classical.segmenter_superpixels import superpixels

sys.path.insert(0, str(Path(__file__).parent))  # pytest in importlib mode finds no neighbours

from segmenter_scenes import backdrop, ellipse, with_object

HEIGHT, WIDTH = 96, 128
MASK = ellipse(HEIGHT, WIDTH, (64, 48), (26, 20))
PICTURE = with_object(backdrop(HEIGHT, WIDTH), MASK)
CELLS = superpixels(PICTURE)


def test_superpixels_add_up_to_the_picture():
    assert CELLS.areas.sum() == HEIGHT * WIDTH == CELLS.histograms.sum()
    assert sorted(np.unique(CELLS.labels)) == list(range(len(CELLS.areas)))
    assert (CELLS.pairs[:, 0] < CELLS.pairs[:, 1]).all() and len(np.unique(CELLS.pairs, axis=0)) == len(CELLS.pairs)
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
    on, beside = (measure(mask, CELLS, background, (0, 1)) for mask in (MASK, np.roll(MASK, 15, 1)))
    assert on.outline > 1.5 * beside.outline and on.separation > 1.5 * beside.separation
    assert on.quality > beside.quality and on.salience > beside.salience and on.as_part > beside.as_part


def test_masks_outside_the_allowed_areas_are_not_measured():
    background = np.zeros((HEIGHT, WIDTH))
    assert measure(MASK, CELLS, background, (0.5, 1)) is None
    assert measure(MASK, CELLS, background, (0, 0.01)) is None
    assert measure(np.zeros_like(MASK), CELLS, background, (0, 1)) is None


@pytest.mark.parametrize("axes", [(30, 24), (22, 16)])
def test_snapping_moves_an_outline_to_the_edge(axes):
    rough = ellipse(HEIGHT, WIDTH, (64, 48), axes)
    pixels = np.round(PICTURE * 255).astype(np.uint8)
    assert overlap(rough, MASK) < 0.8
    assert overlap(snapped(pixels, rough, 0.15, 0.15), MASK) > 0.97


def test_snapping_leaves_unsure_pixels_to_their_colours():
    bulge = ellipse(HEIGHT, WIDTH, (100, 48), (14, 10)) & ~MASK
    pixels = np.round(PICTURE * 255).astype(np.uint8)
    assert overlap(snapped(pixels, MASK | bulge, 0.04, 0.04, unsure=bulge), MASK) > 0.97


def test_snapping_nothing_gives_nothing():
    assert not snapped(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), bool), 0.1, 0.1).any()


def test_tidying_drops_crumbs_and_fills_small_holes_only():
    seed = np.zeros((40, 60), bool)
    seed[5:35, 5:35] = True
    mask = seed.copy()
    mask[10:12, 10:12] = False  # a small hole
    mask[15:25, 15:25] = False  # a real one
    mask[2, 50] = True  # a crumb
    mask[10:30, 45:55] = True  # large, but nothing of the seed
    expected = seed.copy()
    expected[15:25, 15:25] = False
    assert np.array_equal(tidied(mask, seed), expected)


def test_a_soft_mask_is_full_inside_empty_far_outside_and_soft_between():
    soft = softened(PICTURE, MASK)
    inner, outer = ellipse(HEIGHT, WIDTH, (64, 48), (20, 14)), ellipse(HEIGHT, WIDTH, (64, 48), (33, 27))
    assert soft.dtype == np.float32 and soft.shape == MASK.shape
    assert (soft[inner] == 1).all() and (soft[~outer] == 0).all()
    assert ((soft > 0) & (soft < 1)).any() and overlap(soft > 0.5, MASK) > 0.97


def test_a_soft_mask_has_the_size_of_the_picture_whatever_the_mask_s():
    assert softened(PICTURE, MASK[::4, ::4]).shape == (HEIGHT, WIDTH)
    assert not softened(PICTURE, np.zeros((10, 10), bool)).any()
