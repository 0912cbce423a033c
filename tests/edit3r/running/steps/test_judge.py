"""How much is looked at before a verdict."""

import pytest

from edit3r.running.steps.judge import _small, places_asked


@pytest.mark.parametrize(
    ("photos", "places"), [(2, 8), (8, 8), (16, 4), (40, 2), (500, 2)]
)
def test_of_many_photos_a_reference_is_looked_at_from_fewer_places(photos, places):
    """All of its Gaussians are drawn from each place, one a pixel of each photo."""
    assert places_asked(photos) == places


def test_half_way_views_have_256_pixels_on_the_longer_side_at_most():
    assert _small((1024, 512)) == (256, 128) and _small((100, 50)) == (100, 50)
    assert _small((2000, 1)) == (256, 1)
