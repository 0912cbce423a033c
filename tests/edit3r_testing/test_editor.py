"""The editor's contract holds for the starter and finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Editor
from edit3r.contract.types import Views
from edit3r_testing import EditorContract, claims


class Spoiled(Editor):
    """A good editor whose answer is passed through `spoil(views, request, answer)`."""

    def __init__(self, good, spoil):
        self.good, self.spoil = good, spoil

    def edit(self, views, request):
        return self.spoil(views, request, self.good.edit(views, request))


def brightened_in_place(views, request, answer):
    views.images.mul_(0.5)
    return answer


def unseeded(views, request, answer):
    return replace(answer, images=(answer.images + torch.rand(1) * 0.1).clamp(0, 1))


def at_most_two_views(views, request, answer):
    if views.count > 2:
        raise IndexError("list index out of range")
    return answer


def refuses_masks(views, request, answer):
    assert request.masks is None
    return answer


def even_sizes_only(views, request, answer):
    height, width = (side // 2 * 2 for side in views.image_size)
    return replace(answer, images=answer.images[..., :height, :width])


CASES = {
    "wrong size": (
        even_sizes_only,
        "test_keeps_size_dtype_and_range",
        "of shape [1, 2, 3, 49, 61], got",
    ),
    "other intrinsics": (
        lambda v, r, a: replace(a, intrinsics=a.intrinsics * 2),
        "test_keeps_cameras_and_names",
        "dataclasses.replace(views, images=...)",
    ),
    "no names": (
        lambda v, r, a: Views(a.images, a.intrinsics),
        "test_keeps_cameras_and_names",
        "names changed",
    ),
    "two views at most": (
        at_most_two_views,
        "test_any_number_of_views_and_scenes",
        "raised IndexError",
    ),
    "one view lost": (
        lambda v, r, a: a.select(range(1)),
        "test_any_number_of_views_and_scenes",
        "of shape [1, 3, 3, 48, 64], got",
    ),
    "unseeded": (
        unseeded,
        "test_same_seed_gives_the_same_result",
        "torch.Generator().manual_seed(request.seed)",
    ),
    "writes into the photos": (
        brightened_in_place,
        "test_leaves_its_inputs_alone",
        "clone it first",
    ),
    "refuses masks": (
        refuses_masks,
        "test_pixels_outside_the_masks_stay_after_the_composite",
        "raised AssertionError",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_an_editor_broken_by(case, examples, complaint):
    spoil, claim, advice = CASES[case]
    good = examples.build("editor", "worked-editor")
    assert advice in complaint(EditorContract, lambda: Spoiled(good, spoil), claim)


def test_every_claim_about_editors_can_fail():
    own = {name for name in vars(EditorContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
    assert own <= set(claims(EditorContract))
