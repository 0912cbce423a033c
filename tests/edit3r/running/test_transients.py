"""What one photo alone shows where two others see through its place is found and left out."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.running.transients import _grown, find_transients, without_transients
from edit3r_testing import photograph

SCENE = photograph(3, (64, 96))
THING = (0, 1, slice(20, 48), slice(40, 56))


def as_seen(views, unmeasured=True):
    """A magenta thing in photo 1 alone, which no other photo measured."""
    images = SCENE.views.images.clone()
    images[0, 1, :, THING[2], THING[3]] = torch.tensor([1.0, 0, 1])[:, None, None]
    confidence = torch.ones_like(SCENE.depths)
    if unmeasured:
        confidence[THING] = 0
    geometry = Geometry(
        SCENE.cameras.c2w,
        SCENE.depths,
        confidence,
        torch.ones(1, 3, dtype=torch.bool),
    )
    geometry = replace(
        geometry,
        c2w=geometry.c2w[:, views],
        depths=geometry.depths[:, views],
        confidence=geometry.confidence[:, views],
        registered=geometry.registered[:, views],
    )
    return geometry, replace(SCENE.views, images=images).select(views)


def test_what_one_of_three_photos_shows_alone_is_found_there_and_nowhere_else():
    found = find_transients(*as_seen([0, 1, 2]))
    assert found is not None and found[THING].float().mean() > 0.9
    assert not found[0, [0, 2]].any()
    found[0, 1, 14:54, 34:62] = False
    assert not found.any()


def test_two_photos_cannot_tell_which_of_them_is_right():
    assert find_transients(*as_seen([0, 1])) is None


def test_a_scene_that_holds_still_and_what_others_measured_too_are_no_passing_things():
    geometry, _ = as_seen([0, 1, 2])
    assert find_transients(geometry, SCENE.views) is None
    assert find_transients(*as_seen([0, 1, 2], unmeasured=False)) is None


@pytest.mark.parametrize(("count", "told"), [(3, True), (4, False)])
def test_guesses_that_agree_tell_of_a_place_only_among_three_photos(count, told):
    scene = photograph(count, (64, 96))
    images = scene.views.images.clone()
    images[0, 1, :, THING[2], THING[3]] = torch.tensor([1.0, 0, 1])[:, None, None]
    everywhere = torch.ones(1, count, dtype=torch.bool)
    guessed = torch.zeros_like(scene.depths)
    guessed[..., 80:] = 1  # but for a stripe
    geometry = Geometry(scene.cameras.c2w, scene.depths, guessed, everywhere)
    found = find_transients(geometry, replace(scene.views, images=images))
    assert (found is not None) == told


@pytest.mark.parametrize(("telling", "found"), [([0, 2], False), ([0, 2, 3], True)])
def test_of_many_photos_three_must_show_what_lies_behind(telling, found):
    scene = photograph(5, (64, 96))
    images = scene.views.images.clone()
    images[0, 1, :, THING[2], THING[3]] = torch.tensor([1.0, 0, 1])[:, None, None]
    confidence = torch.zeros_like(scene.depths)
    confidence[:, [1, *telling]] = 1
    confidence[THING] = 0
    everywhere = torch.ones(1, 5, dtype=torch.bool)
    geometry = Geometry(scene.cameras.c2w, scene.depths, confidence, everywhere)
    seen = find_transients(geometry, replace(scene.views, images=images))
    assert (seen is not None) == found


@pytest.mark.parametrize(("wide", "grown"), [(10, True), (40, False)])
def test_a_thing_is_its_whole_unmeasured_piece_unless_that_is_a_background(wide, grown):
    unmeasured = torch.zeros(60, 80, dtype=torch.bool)
    unmeasured[10:50, 10 : 10 + wide] = True
    found = torch.zeros_like(unmeasured)
    found[20:40, 12:18] = True

    thing = _grown(found, unmeasured, torch.ones_like(found))

    assert bool(thing.any()) == grown
    assert not grown or (thing == unmeasured).all()


def test_gaussians_go_that_the_photo_saw_within_its_mask_and_no_other_photos():
    views = SCENE.views
    cameras = Cameras(SCENE.cameras.c2w, views.intrinsics, views.image_size)
    scales = pixel_scales(SCENE.depths, views.intrinsics, 0.35)
    gaussians = pixels_to_gaussians(
        views.images, SCENE.depths, cameras, scales, torch.ones_like(SCENE.depths)
    )
    masks = torch.zeros(SCENE.depths.shape, dtype=torch.bool)
    masks[THING] = True
    left = without_transients(gaussians, masks, cameras.c2w, views.intrinsics)
    counts = [int((left.view_index == view).sum()) for view in range(3)]
    assert counts == [64 * 96, 64 * 96 - 28 * 16, 64 * 96]


def test_what_passed_in_one_scene_of_a_batch_stays_in_the_other():
    views = SCENE.views
    cameras = Cameras(SCENE.cameras.c2w, views.intrinsics, views.image_size)
    scales = pixel_scales(SCENE.depths, views.intrinsics, 0.35)
    one = pixels_to_gaussians(
        views.images, SCENE.depths, cameras, scales, torch.ones_like(SCENE.depths)
    )
    fields = ("means", "scales", "quats", "opacities", "harmonics")
    twice = {name: torch.cat([getattr(one, name)] * 2) for name in fields}
    masks = torch.zeros(2, *SCENE.depths.shape[1:], dtype=torch.bool)
    masks[THING] = True
    left = without_transients(
        replace(one, **twice),
        masks,
        cameras.c2w.expand(2, -1, -1, -1),
        views.intrinsics.expand(2, -1, -1, -1),
    )
    counts = (left.opacities > 0).sum(1).tolist()
    assert counts == [3 * 64 * 96 - 28 * 16, 3 * 64 * 96]


def test_what_was_transparent_before_stays():
    """Gaussians of a batch belong together: an opacity of 0 may fill a smaller scene."""
    views = SCENE.views
    cameras = Cameras(SCENE.cameras.c2w, views.intrinsics, views.image_size)
    scales = pixel_scales(SCENE.depths, views.intrinsics, 0.35)
    nothing = torch.zeros_like(SCENE.depths)
    gaussians = pixels_to_gaussians(
        views.images, SCENE.depths, cameras, scales, nothing
    )
    masks = torch.ones(SCENE.depths.shape, dtype=torch.bool)
    left = without_transients(gaussians, masks, cameras.c2w, views.intrinsics)
    assert left.count == gaussians.count
