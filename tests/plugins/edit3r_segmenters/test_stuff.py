"""Sky and ground by their looks, and how surely: a wall is no sky, a table may be no
ground.
"""

import numpy as np
import pytest
from edit3r_segmenters.stuff import GROUND_CONFIDENCE, sky_confidence, stuff

from edit3r.contract.interfaces import SURE

BLUE_SKY, GREY_SKY, BLOWN_OUT = (100, 150, 230), (200, 205, 215), (255, 255, 255)
GREY_WALL, CREAM_WALL = (190, 188, 182), (245, 235, 215)
EARTH, ROOM = (80, 70, 40), (140, 130, 120)


def photo(above, below, rows=30, wide=1.0):
    """Two colours, the first from the upper edge down to some row, along a share of its width."""
    pixels = np.full((60, 80, 3), below, np.float32) / 255
    mask = np.zeros((60, 80), dtype=bool)
    mask[:rows, : round(80 * wide)] = True
    pixels[mask] = np.float32(above) / 255
    return pixels, mask


@pytest.mark.parametrize(
    ("above", "below", "wide", "sure"),
    [
        (BLUE_SKY, EARTH, 1.0, True),
        (GREY_SKY, EARTH, 1.0, True),
        (BLOWN_OUT, EARTH, 1.0, True),
        (GREY_WALL, ROOM, 1.0, False),
        (CREAM_WALL, EARTH, 1.0, False),  # bright, but warm
        (BLUE_SKY, EARTH, 0.3, False),  # a window
    ],
)
def test_a_sky_is_sure_where_no_wall_looks_like_it(above, below, wide, sure):
    confidence = sky_confidence(*photo(above, below, wide=wide))
    assert (confidence >= SURE) == sure
    assert confidence <= 0.9  # never without doubt


def test_a_word_for_stuff_says_how_sure_it_is():
    pixels, sky = photo(BLUE_SKY, EARTH)
    found, confidence = stuff("sky", pixels)
    assert (found == sky).mean() > 0.95 and confidence == sky_confidence(pixels, found)
    found, confidence = stuff("ground", pixels)
    assert found[-1].all() and confidence == GROUND_CONFIDENCE < SURE


def test_haze_into_which_a_sky_passes_is_sky_and_a_pale_house_is_not():
    pixels = np.full((120, 80, 3), EARTH, np.float32)
    pixels[:80] = np.linspace(BLUE_SKY, (200, 205, 225), 80)[:, None]
    pixels[80:100, 20:50] = GREY_WALL
    found, _ = stuff("sky", pixels / 255)
    assert found[:76].mean() > 0.95 and found[84:].mean() < 0.05


def test_without_sky_nothing_is_found_for_sure():
    pixels, _ = photo((30, 25, 20), EARTH)
    found, confidence = stuff("sky", pixels)
    assert not found.any() and confidence == 0
