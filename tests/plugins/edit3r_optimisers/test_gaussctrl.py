"""Which views are edited together, and what the editor is given."""

import pytest
import torch
from edit3r_optimisers.gaussctrl import chunks, reference_views

from edit3r.contract.interfaces import ConditionedOnDepth, Editor
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest


def test_reference_views_are_spread_evenly():
    assert reference_views(9, 3) == [0, 4, 8] and reference_views(2, 4) == [0, 1]
    assert reference_views(5, 0) == []


@pytest.mark.parametrize("count, together", [(2, 12), (9, 4), (30, 12), (5, 2)])
def test_every_view_is_edited_and_the_references_lead_every_call(count, together):
    references = reference_views(count, min(4, together - 1))
    calls = chunks(count, references, together)
    assert {view for call in calls for view in call} == set(range(count))
    assert all(call[: len(references)] == references for call in calls)
    assert max(map(len, calls)) <= together


def test_an_editor_that_cannot_align_is_used_and_the_run_says_what_is_missing(
    build, editor, posed
):
    report = Report()
    method = build("gaussctrl", together=2)
    with collecting(report):
        method.edit_and_reconstruct(posed, posed, EditRequest("invert"))
    assert [views.count for views, _ in editor.calls] == [2, 1]
    (said,) = [text for text in report.warnings if text.startswith("gaussctrl")]
    assert "not aligned" in said and "not conditioned" in said


class Depthy(Editor, ConditionedOnDepth):
    """Looks across views and asks its matcher for depth, as controlnet-depth does."""

    references = 1

    def __init__(self):
        self.matcher, self.asked = object(), []
        self.parts = {"matcher": self.matcher}

    def edit(self, views, request):
        self.asked.append((views, self.matcher.match(views)))
        return views


def test_an_editor_with_a_matcher_is_given_the_fitted_depth_and_stays_as_it_was(
    build, posed, truth
):
    editor, report = Depthy(), Report()
    method = build("gaussctrl", {"editor": editor}, together=2)
    with collecting(report):
        method.edit_and_reconstruct(posed, posed, EditRequest("x"))
    assert editor.matcher is editor.parts["matcher"] and not report.warnings
    # view 0 leads both calls
    assert [views.count for views, _ in editor.asked] == [2, 2]
    for (_, found), chosen in zip(editor.asked, ([0, 1], [0, 2])):
        assert torch.allclose(found.c2w, truth.cameras.c2w[:, chosen], atol=1e-5)
        off = (found.depths / truth.depths[:, chosen] - 1).abs()
        assert off[found.confidence > 0.5].median() < 0.05
