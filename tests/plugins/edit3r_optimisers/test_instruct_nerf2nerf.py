"""The images of a fit are edited anew when they should be, from what they should be."""

from dataclasses import replace

import pytest
import torch
from edit3r_optimisers.instruct_nerf2nerf import (
    DatasetUpdate,
    InstructNerf2NerfReconstructor,
)

from edit3r.contract.interfaces import StartsFromImages
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest
from edit3r_testing.scenes import gaussian_cloud

SCHEDULE = InstructNerf2NerfReconstructor.Settings(
    edit_every=3, least_strength=0.5, most_strength=0.5
)
ASK = EditRequest("invert", seed=5)


@pytest.fixture
def targets(posed, truth, editor, rasterizer):
    def targets(schedule=SCHEDULE, request=ASK, editor=editor):
        asked = request, schedule, editor, rasterizer
        return DatasetUpdate(posed, truth.cameras, *asked)

    return targets


def before(targets, steps):
    for step in steps:
        targets.before_step(step, gaussian_cloud)


def test_one_view_is_edited_every_so_many_steps_and_every_view_once_a_round(
    targets, editor, posed
):
    updated = targets()
    before(updated, range(9))
    assert len(editor.calls) == updated.updates == 3
    asked = torch.cat([views.images[0] for views, _ in editor.calls])
    assert all((asked == photo).flatten(1).all(1).any() for photo in posed.images[0])


def test_views_that_were_not_edited_yet_stay_as_they_are(targets, posed):
    updated = targets()
    before(updated, [0, 1, 2])
    changed = (updated.images != posed.images[0]).flatten(1).any(1)
    assert changed.sum() == 1


def test_the_photo_before_editing_is_what_is_edited_however_often(
    targets, editor, posed
):
    before(targets(), range(0, 27, 3))
    assert len(editor.calls) == 9
    for views, _ in editor.calls:
        assert (posed.images[0] == views.images[0]).flatten(1).all(1).any()


def test_an_editor_that_cannot_start_from_a_picture_is_mixed_with_the_render_and_the_run_says_so(
    targets, posed, rasterizer, truth
):
    report = Report()
    with collecting(report):
        updated = targets()
        before(updated, [0])
    view = int((updated.images != posed.images[0]).flatten(1).any(1).nonzero())
    seen = rasterizer.render(gaussian_cloud(), truth.cameras.select([view]))
    mixed = (seen.images[0, 0].clamp(0, 1) + 1 - posed.images[0, view]) / 2
    assert torch.allclose(updated.images[view], mixed, atol=1e-6)
    assert any("cannot start from a given picture" in text for text in report.warnings)


def test_an_editor_that_can_start_from_a_picture_is_given_render_and_strength(
    targets, posed
):
    class Starting(StartsFromImages):
        def edit(self, views, request):
            raise AssertionError

        def edit_from(self, views, start, request, strength):
            self.asked = views, start, request, strength
            return replace(views, images=start.clamp(0, 1))

    editor = Starting()
    before(targets(editor=editor), [0])
    views, start, request, strength = editor.asked
    assert any(torch.equal(views.images[0, 0], photo) for photo in posed.images[0])
    assert start.shape == views.images.shape
    assert (strength, request.prompt) == (0.5, "invert")


def test_fresh_noise_is_another_seed_each_time(targets, editor):
    before(targets(), range(0, 9, 3))
    assert [request.seed for _, request in editor.calls] == [5, 6, 7]


def test_masks_go_with_their_view_and_confine_it(targets, posed, editor):
    masks = torch.zeros(1, 3, 32, 40)
    masks[:, :, :, :20] = 1
    updated = targets(request=replace(ASK, masks=masks))
    before(updated, range(9))
    assert torch.equal(updated.images[..., 20:], posed.images[0, ..., 20:])
    assert not torch.equal(updated.images[..., :20], posed.images[0, ..., :20])
    assert editor.calls[0][1].masks.shape == (1, 1, 32, 40)
