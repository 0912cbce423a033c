"""Which views are edited together, and what the editor is given."""

import pytest
import torch
from edit3r_refit.gaussctrl import aligns_views, chunks, reference_views, takes_depth, with_geometry
from edit3r_refit.renders import FittedGeometry

from edit3r.reporting import Report, collecting
from edit3r.types import EditRequest


def test_reference_views_are_spread_evenly():
    assert reference_views(9, 3) == [0, 4, 8] and reference_views(2, 4) == [0, 1]


@pytest.mark.parametrize("count, together", [(2, 12), (9, 4), (30, 12), (5, 2)])
def test_every_view_is_edited_and_the_references_lead_every_call(count, together):
    references = reference_views(count, min(4, together - 1))
    calls = chunks(count, references, together)
    assert {view for call in calls for view in call} == set(range(count))
    assert all(call[: len(references)] == references and len(call) <= together for call in calls)


def test_an_editor_that_cannot_align_is_used_and_the_run_says_what_is_missing(build, editor, posed):
    report = Report()
    with collecting(report):
        build("gaussctrl", references=1, together=2)(posed, posed, EditRequest("invert"))
    assert [views.count for views, _ in editor.calls] == [2, 2]
    (said,) = [text for text in report.warnings if text.startswith("gaussctrl")]
    assert "not aligned" in said and "not conditioned" in said
    assert not aligns_views(editor) and not takes_depth(editor) and with_geometry(editor, None) is None


def test_an_editor_with_a_matcher_is_given_the_fitted_depth_and_stays_as_it_was(truth):
    class Depthy:
        def __init__(self):
            self.matcher = object()
            self.parts = {"matcher": self.matcher}

    editor = Depthy()
    geometry = FittedGeometry(truth.cameras, truth.depths[0], torch.ones_like(truth.depths[0]))
    twin = with_geometry(editor, geometry)
    assert twin.matcher is geometry and editor.matcher is editor.parts["matcher"]
    found = twin.matcher.match(truth.views)
    assert torch.equal(found.depths, truth.depths) and torch.equal(found.c2w, truth.cameras.c2w)
