"""The editor paints the regions it is given; which regions these are is not its business."""

import pytest
import torch
from edit3r_recolor.editor import RecolorEditor

from edit3r.contract.errors import PromptError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.running.editors import read

HEIGHT, WIDTH = 12, 16


def photos(batch: int = 1) -> Views:
    random = torch.Generator().manual_seed(0)
    images = torch.rand(batch, 2, 3, HEIGHT, WIDTH, generator=random)
    return Views(0.2 + 0.6 * images, torch.eye(3).expand(batch, 2, 3, 3), ("a", "b"))


def edit(prompt, regions=None, seed=0, views=None, **settings):
    editor = RecolorEditor(RecolorEditor.Settings(**settings))
    request = EditRequest(prompt, seed, instructions=read(prompt), regions=regions)
    return editor.edit(views or photos(), request).images


def halves() -> torch.Tensor:
    """Regions of two instructions: the left half, and the right half."""
    regions = torch.zeros(2, 1, 2, HEIGHT, WIDTH)
    regions[0, ..., : WIDTH // 2] = 1
    regions[1, ..., WIDTH // 2 :] = 1
    return regions


def test_pixels_outside_the_region_are_bit_equal():
    regions = torch.zeros(1, 1, 2, HEIGHT, WIDTH)
    regions[..., :5, :] = 1
    images = edit("paint all of the bike red", regions)
    assert torch.equal(images[..., 5:, :], photos().images[..., 5:, :])
    assert ((images - photos().images).abs().amax(2) > 1e-4)[..., :5, :].all()


def test_a_soft_region_blends_between_photo_and_colour():
    full = edit("paint it red", torch.ones(1, 1, 2, HEIGHT, WIDTH))
    half = edit("paint it red", torch.full((1, 1, 2, HEIGHT, WIDTH), 0.5))
    assert torch.allclose(half, 0.5 * full + 0.5 * photos().images, atol=1e-6)


def test_each_instruction_changes_its_own_region():
    images = edit("paint the door red and the wall green", halves())
    left = images[..., : WIDTH // 2].mean((0, 1, 3, 4))
    right = images[..., WIDTH // 2 :].mean((0, 1, 3, 4))
    assert left.argmax() == 0 and right.argmax() == 1


def test_without_regions_the_whole_image_changes():
    assert ((edit("make it darker") - photos().images).abs().amax(2) > 1e-4).all()


def test_random_colours_come_from_the_seed_and_are_noted():
    with collecting(Report()) as report:
        first = edit("recolor it", seed=3)
    assert torch.equal(first, edit("recolor it", seed=3))
    assert not torch.equal(first, edit("recolor it", seed=4))
    assert set(report.notes["editor.parameters"]) >= {"hue", "gamma", "permutation"}


def test_strength_mixes_with_the_photo():
    assert torch.equal(edit("make it darker", strength=0.0), photos().images)
    half = edit("make it darker", strength=0.5)
    full = edit("make it darker")
    assert torch.allclose(half, 0.5 * full + 0.5 * photos().images, atol=1e-6)


def test_scenes_of_a_batch_are_edited_one_by_one():
    both = edit("paint the bike red", views=photos(2))
    single = Views(photos(2).images[1:], photos(2).intrinsics[1:])
    assert torch.equal(both[1:], edit("paint the bike red", views=single))


@pytest.mark.parametrize(
    ("prompt", "whole"),
    [
        ("paint the bike blue", False),
        ("paint all of the bike blue", True),
        ("make the left half blue", True),  # a place
        ("turn the statue into bronze", True),  # a material
    ],
)
@pytest.mark.parametrize("level", [0.08, 0.4])
def test_neutral_parts_are_painted_where_all_of_it_is_meant(prompt, whole, level):
    images = torch.full((1, 2, 3, HEIGHT, WIDTH), level)
    images[..., :5, :] = torch.tensor([0.8, 0.1, 0.1])[:, None, None]
    views = Views(images, torch.eye(3).expand(1, 2, 3, 3))
    changed = (edit(prompt, views=views) - images).abs().amax(2)
    assert (changed[..., :5, :] > 0.05).all()
    assert (changed[..., 5:, :] > (0.02 if level < 0.1 else 0.05)).all() == whole
    assert whole or not changed[..., 5:, :].any()


def test_a_sky_is_painted_with_its_haze_and_clouds():
    views = photos()
    views.images[:] = 0.8
    views.images[..., : HEIGHT // 2, :] = torch.tensor([0.35, 0.55, 0.85])[
        :, None, None
    ]
    regions = torch.ones(1, 1, 2, HEIGHT, WIDTH)
    sky = edit("make the sky pink", regions, views=views)
    door = edit("make the door pink", regions, views=views)
    changed = [((one - views.images).abs().amax(2) > 0.02) for one in (sky, door)]
    assert changed[0].all() and not changed[1][..., HEIGHT // 2 :, :].any()


@pytest.mark.parametrize("prompt", ["", "remove the bike", "turn it into a castle"])
def test_what_changes_no_colour_is_refused(prompt):
    with pytest.raises(PromptError):
        edit(prompt)


def test_a_colour_that_nobody_read_off_its_thing_is_asked_for_by_name():
    with pytest.raises(PromptError, match=r"'the colour of wall'.*#8a7f70"):
        edit("paint the door the colour of the wall")
