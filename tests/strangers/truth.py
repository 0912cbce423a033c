"""A stranger's matcher: it knows what is true of the test photos."""

from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Matcher
from edit3r_testing.scenes import true_geometry

EDIT3R_API = 1


class TruthMatcher(Matcher):
    asked = 0

    def match(self, views):
        TruthMatcher.asked += 1
        return true_geometry(views)


@hookimpl
def register_matchers():
    return Component("truth", "truth:TruthMatcher", "knows the answer", min_views=2)
