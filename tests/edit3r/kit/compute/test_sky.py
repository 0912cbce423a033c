import numpy as np
import pytest

from edit3r.kit.compute.sky import coloured_like_sky, find_skies

SIZE = (120, 160)


def colours(*rgb):
    return np.array(rgb, np.float32) / 255


@pytest.fixture
def outdoors():
    """A tower and rough ground under a blue sky that grows pale towards the horizon."""
    random = np.random.default_rng(0)
    down = np.linspace(0, 1, SIZE[0])[:, None, None]
    image = colours(70, 130, 220) * (1 - down) + colours(200, 220, 245) * down
    image = np.broadcast_to(image, (*SIZE, 3)).astype(np.float32).copy()
    things = np.zeros(SIZE, bool)
    things[70:] = True
    things[30:, 60:80] = True
    rough = colours(120, 100, 70) * random.uniform(0.4, 1.2, (*SIZE, 1))
    image[things] = rough[things]
    return image.clip(0, 1), ~things


def test_sky_is_all_that_is_smooth_and_blue_down_to_the_roofs(outdoors):
    image, sky = outdoors
    found = find_skies([image, image])
    for mask in found:
        assert (mask & sky).sum() / (mask | sky).sum() > 0.97


def test_a_photo_that_shows_little_of_it_is_helped_by_the_others(outdoors):
    image, _ = outdoors
    under_a_tree = image.copy()
    under_a_tree[:, 20:] = colours(40, 60, 20)
    assert find_skies([under_a_tree]) is None
    _, found = find_skies([image, under_a_tree])
    assert found[:60, :18].all() and not found[:, 22:].any()


@pytest.mark.parametrize("ceiling", [(205, 200, 190), (235, 225, 205), (120, 120, 125)])
def test_a_ceiling_is_no_sky(outdoors, ceiling):
    image, sky = outdoors
    indoors = image.copy()
    indoors[sky] = colours(*ceiling)
    assert find_skies([indoors, indoors]) is None


def test_blue_water_at_the_lower_edge_is_no_sky(outdoors):
    image, _ = outdoors
    assert find_skies([image[::-1], image[::-1]]) is None


def test_branches_before_it_have_no_colour_of_it(outdoors):
    image, _ = outdoors
    image[10:12] = colours(40, 30, 20)
    like = coloured_like_sky(image)
    assert not like[10:12].any()
    assert like[:10].all()
