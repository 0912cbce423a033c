import sys
from pathlib import Path

import numpy as np
import pytest
from edit3r_segmenters.masks import snapped, tidied
from edit3r_segmenters.superpixels import superpixels

from edit3r.kit.compute.outlines import overlap, softened

# pytest in importlib mode finds no neighbours
sys.path.insert(0, str(Path(__file__).parent))

from segmenter_scenes import backdrop, ellipse, with_object

HEIGHT, WIDTH = 96, 128
MASK = ellipse(HEIGHT, WIDTH, (64, 48), (26, 20))
PICTURE = with_object(backdrop(HEIGHT, WIDTH), MASK)
CELLS = superpixels(PICTURE)


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
    assert not snapped(
        np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), bool), 0.1, 0.1
    ).any()


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
    inner, outer = (
        ellipse(HEIGHT, WIDTH, (64, 48), (20, 14)),
        ellipse(HEIGHT, WIDTH, (64, 48), (33, 27)),
    )
    assert soft.dtype == np.float32 and soft.shape == MASK.shape
    assert (soft[inner] == 1).all() and (soft[~outer] == 0).all()
    assert ((soft > 0) & (soft < 1)).any() and overlap(soft > 0.5, MASK) > 0.97


def test_a_soft_mask_has_the_size_of_the_picture_whatever_the_mask_s():
    assert softened(PICTURE, MASK[::4, ::4]).shape == (HEIGHT, WIDTH)
    assert not softened(PICTURE, np.zeros((10, 10), bool)).any()
