"""A segmenter that breaks its contract is named, whatever it was asked."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import PluginError
from edit3r.contract.interfaces import (
    Editor,
    MaskLogits,
    Matcher,
    Proposal,
    Segmenter,
    Tracks,
)
from edit3r.kit import asking
from edit3r_testing.scenes import photograph, true_geometry

IMAGES = torch.rand(2, 3, 8, 12)
MASK = torch.eye(8, 12)
GOOD = Proposal(MASK)
CLICK = [((0.5, 0.5), True)]
SEVERAL = MaskLogits(torch.ones(3, 4, 6), torch.ones(3))
FOLLOWED = Tracks(torch.ones(2, 1, 8, 12), torch.ones(2, 1, dtype=torch.bool))


class Answers(Segmenter):
    """Answers one thing, whatever it is asked; an error is raised."""

    def __init__(self, answer):
        self.answer = answer

    def masks(self, image, clicks, box=None, before=None):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def words(self, image, text):
        return self.masks(image, ())

    def track(self, images, masks):
        return self.masks(images, ())


class Spoils(Answers):
    def masks(self, image, clicks, box=None, before=None):
        image.numpy()[:] = 0
        return self.answer


ASKED = {
    "masks": lambda one: asking.masks(one, IMAGES[0], CLICK),
    "words": lambda one: asking.words(one, IMAGES[0], "box"),
    "track": lambda one: asking.track(one, IMAGES, MASK[None]),
}
OF = "edit3r.contract.interfaces."


def named(**changes):
    return (replace(GOOD, **changes),)


@pytest.mark.parametrize(
    "asked, answer, said",
    [
        *((asked, ValueError("no"), "raised ValueError: no") for asked in ASKED),
        ("words", "box", f"must return a tuple of {OF}Proposal, got str"),
        ("words", (MASK,), f"must return {OF}Proposal, got Tensor"),
        ("words", named(soft_mask=MASK / 0), "soft_mask with 96 of 96 values not"),
        ("words", named(soft_mask=MASK.numpy()), "soft_mask as a tensor, got ndarray"),
        ("words", named(soft_mask=MASK[:6]), r"shape \[8, 12\], got \[6, 12\]"),
        ("words", named(soft_mask=MASK.double()), "float32, got torch.float64"),
        ("words", named(soft_mask=255 * MASK), r"in \[0, 1\], got 0 to 255"),
        ("words", named(confidence=float("nan")), r"confidence in \[0, 1\], got nan"),
        ("masks", None, f"must return {OF}MaskLogits, got NoneType"),
        ("masks", replace(SEVERAL, logits=None), "must return torch.Tensor, got"),
        ("masks", replace(SEVERAL, logits=torch.ones(4, 6)), r"logits \[n, h, w\]"),
        ("masks", replace(SEVERAL, logits=torch.ones(0, 4, 6)), r"\[0, 4, 6\]"),
        ("masks", replace(SEVERAL, quality=torch.ones(2)), r"\[3, 4, 6\], \[2\]"),
        ("masks", replace(SEVERAL, logits=SEVERAL.logits / 0), "return finite logits"),
        ("track", "box", f"must return {OF}Tracks, got str"),
        (
            "track",
            replace(FOLLOWED, logits=FOLLOWED.logits[:1]),
            r"logits of shape \[2, 1, 8, 12\]",
        ),
        ("track", replace(FOLLOWED, present=torch.ones(2, 1)), "present in torch.bool"),
    ],
)
def test_a_segmenter_that_breaks_its_contract_is_named(asked, answer, said):
    with pytest.raises(PluginError, match=f"^segmenter 'Answers' .*{said}"):
        ASKED[asked](Answers(answer))


def test_what_it_was_given_stays_as_it_was():
    images = IMAGES.clone()
    with pytest.raises(PluginError, match="must leave its arguments as they are"):
        asking.masks(Spoils(SEVERAL), images[0], CLICK)


def test_good_answers_pass():
    assert asking.masks(Answers(SEVERAL), IMAGES[0], CLICK) is SEVERAL
    assert asking.words(Answers([GOOD]), IMAGES[0], "box") == (GOOD,)
    assert asking.words(Answers(None), IMAGES[0], "box") is None
    assert asking.track(Answers(None), IMAGES, MASK[None]) is None
    assert asking.track(Answers(FOLLOWED), IMAGES, MASK[None]) is FOLLOWED


class Darkens(Editor):
    """Changes the images while it only has to say where it edits."""

    def edit(self, views, request):
        return views

    def widened(self, regions, images):
        images.mul_(0.5)
        return regions


def test_an_editor_that_changes_the_photos_where_it_is_asked_for_regions_is_named():
    with pytest.raises(PluginError, match="must leave its arguments as they are"):
        asking.widened(Darkens(), torch.ones(1, 1, 2, 8, 12), IMAGES[None].clone())


class Found(Matcher):
    """Answers one thing, whatever it is asked."""

    def __init__(self, geometry):
        super().__init__(None)
        self.geometry = geometry

    def match(self, views):
        return self.geometry


@pytest.mark.parametrize("axis", [0, 1])
def test_a_matcher_with_a_lens_that_looks_backwards_is_named(axis):
    photos = photograph(2, (16, 24)).views
    sound = true_geometry(photos)
    lenses = photos.intrinsics.clone()
    sound = replace(sound, intrinsics=lenses)
    assert asking.find_geometry(Found(sound), photos).intrinsics is not None
    lenses[0, 1, axis, axis] = -0.8
    with pytest.raises(PluginError, match=r"focal lengths above 0, got -0\.8"):
        asking.find_geometry(Found(sound), photos)
