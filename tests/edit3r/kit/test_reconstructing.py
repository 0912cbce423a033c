"""In one call: geometry is read from the photos before editing, by whom the reconstructor needs."""

from dataclasses import replace

from edit3r.contract.interfaces import FindsGeometry
from edit3r.kit.reconstructing import WithMatcher
from edit3r_testing import photograph

PHOTOS = photograph(2, (16, 24)).views
EDITED = replace(PHOTOS, images=1 - PHOTOS.images)
GRID = (8, 12)


class Asked:
    """A matcher whose geometry names the photos that it was read from."""

    def match(self, views):
        return "matched", views


class Told:
    """A reconstructor that gives back what it is given."""

    uses_geometry = True

    def __call__(self, *given):
        return given


class Alone(Told):
    uses_geometry = False


class Finds(Told, FindsGeometry):
    def find_geometry(self, views):
        return "found", views


def test_geometry_comes_from_the_photos_before_editing_where_they_are_given():
    both = WithMatcher(Told(), Asked())
    assert both(EDITED, PHOTOS, GRID) == (EDITED, PHOTOS, ("matched", PHOTOS), GRID)
    assert both(EDITED) == (EDITED, EDITED, ("matched", EDITED), None)


def test_the_matcher_is_asked_only_where_nobody_else_knows():
    assert WithMatcher(Alone(), None)(EDITED, PHOTOS)[2] is None
    assert WithMatcher(Finds(), None)(EDITED, PHOTOS)[2] == ("found", PHOTOS)
