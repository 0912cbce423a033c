"""In one call: geometry is read from the photos before editing, by whom the reconstructor needs."""

from dataclasses import replace

from edit3r.contract.interfaces import FindsGeometry, Matcher
from edit3r.kit.reconstructing import WithMatcher
from edit3r_testing import photograph
from edit3r_testing.broken import BrokenReconstructor
from edit3r_testing.scenes import true_geometry

PHOTOS = photograph(2, (16, 24)).views
EDITED = replace(PHOTOS, images=1 - PHOTOS.images)
GRID = (8, 12)


class Asked(Matcher):
    """Keeps the photos that geometry was read from, and what it told of them."""

    def match(self, views):
        self.asked, self.told = views, true_geometry(views)
        return self.told


class Told(BrokenReconstructor):
    """Keeps what it is given."""

    def __call__(self, *given):
        self.given = given
        return super().__call__(*given[:2], true_geometry(given[0]))


class Finds(Told, FindsGeometry):
    def find_geometry(self, views):
        return Asked.match(self, views)


def test_geometry_comes_from_the_photos_before_editing_where_they_are_given():
    both = WithMatcher(Told(), Asked())
    for source, grid in ((PHOTOS, GRID), (None, None)):
        both(EDITED, source, grid)
        views, read, geometry, made = both.reconstructor.given
        assert views is EDITED and read is both.matcher.asked is (source or EDITED)
        assert geometry is both.matcher.told and made == grid


def test_the_matcher_is_asked_only_where_nobody_else_knows():
    alone, finds = Told(), Finds()
    alone.uses_geometry = False
    WithMatcher(alone, None)(EDITED, PHOTOS)
    assert alone.given[2] is None
    WithMatcher(finds, None)(EDITED, PHOTOS)
    assert finds.asked is PHOTOS and finds.given[2] is finds.told
