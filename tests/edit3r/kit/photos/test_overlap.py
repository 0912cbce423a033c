"""How much photos show of the same, and which few show most."""

import numpy as np

from edit3r.kit.photos.overlap import MIN_SHARED, covering, features_of, shared


def test_photos_are_chosen_that_cover_what_all_show():
    """Four photos in a row, one of them taken five times: by counting, copies of that one would be
    used.
    """
    place = np.array([0, 0.02, 0.01, 0.03, 0.04, 1, 2, 3])
    common = np.maximum(0, 1 - abs(place[:, None] - place) / 1.5)
    chosen = covering(common, 4)
    assert len(chosen) == 4 and {5, 6, 7} < set(chosen)


def test_photos_of_other_things_share_nothing_though_each_feature_has_a_nearest():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, (240, 240, 3), dtype=np.uint8)
    blocks = rng.integers(0, 255, (20, 20, 3), dtype=np.uint8)
    wall = blocks.repeat(12, 0).repeat(12, 1)
    here, elsewhere = features_of(wall), features_of(noise)
    assert shared([here, here])[0, 1] > 0.9
    assert shared([here, elsewhere])[0, 1] < MIN_SHARED


def test_a_photo_that_shares_nothing_is_not_chosen_before_those_that_do():
    place = np.array([0, 1, 2, 90])
    assert covering(np.maximum(0, 1 - abs(place[:, None] - place) / 1.5), 3) == [
        0,
        1,
        2,
    ]


def test_of_two_photos_the_one_that_shows_less_counts_in_whichever_order():
    rng = np.random.default_rng(1)
    blocks = rng.integers(0, 255, (8, 8, 3), dtype=np.uint8)
    wall = blocks.repeat(40, 0).repeat(40, 1)
    part = np.full_like(wall, 128)
    part[:160, :160] = wall[:160, :160]
    few, many = features_of(part), features_of(wall)
    assert len(few.points) < 0.6 * len(many.points)
    orders = [shared(pair)[0, 1] for pair in ((few, many), (many, few))]
    assert orders[0] == orders[1] > 0.6
