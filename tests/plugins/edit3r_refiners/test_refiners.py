"""The three refiners as the registry builds them."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.interfaces import ComparesWithBefore, Rasterizer, RefineInputs
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r_testing.scenes import cameras_around, gaussian_cloud

from .scenes import textured


@pytest.fixture
def scene(rasterizer):
    """A cloud, two cameras, and the views of the first of them with other colours."""
    gaussians, cameras = gaussian_cloud(80), cameras_around(2)
    with torch.no_grad():
        images = rasterizer.render(gaussians, cameras).images
    return gaussians, cameras, Views(0.5 * images[:, :1], cameras.intrinsics[:, :1])


def test_simplify_leaves_no_more_than_the_smaller_of_both_numbers(rasterizer, scene):
    refiner = edit3r.build("refiner", "simplify", gaussians="30", max_gaussians=20)
    assert 0 < refiner(scene[0], RefineInputs(*scene[1:], rasterizer)).count <= 20


def test_simplify_to_all_changes_nothing(rasterizer, scene):
    refiner = edit3r.build("refiner", "simplify", gaussians="all")
    assert refiner(scene[0], RefineInputs(*scene[1:], rasterizer)) is scene[0]


def test_refine_brings_the_scene_closer_to_the_edited_views_alone(rasterizer, scene):
    gaussians, cameras, views = scene
    seen = []

    class Watch(Rasterizer):
        def render(self, gaussians, cameras):
            seen.append(cameras.count)
            return rasterizer.render(gaussians, cameras)

    refiner = edit3r.build("refiner", "refine", steps=10)
    better = refiner(gaussians, RefineInputs(cameras, views, Watch(None)))
    # photos that still show the colours from before would pull them back
    assert set(seen) == {1}
    with torch.no_grad():
        before, after = (
            rasterizer.render(g, cameras.select([0])).images - views.images
            for g in (gaussians, better)
        )
    assert after.square().mean() < 0.8 * before.square().mean()
    assert not better.means.requires_grad


def test_simplify_and_refine_tell_what_they_did(rasterizer):
    gaussians, cameras, images = textured()
    views, report = Views(images, cameras.intrinsics), Report()
    inputs = RefineInputs(cameras, views, rasterizer)
    with collecting(report):
        fewer = edit3r.build("refiner", "simplify", gaussians=900)(gaussians, inputs)
        edit3r.build("refiner", "refine", steps=2)(fewer, inputs)
    assert fewer.count == report.notes["simplify.left"] <= 900
    assert report.notes["simplify.before"] == gaussians.count
    assert 0 <= report.notes["refine"]["steps"] <= 2 * views.count


def masked(scene, rasterizer, share):
    gaussians, cameras, views = scene
    masks = torch.zeros(1, 2, *cameras.image_size)
    masks[..., : round(share * cameras.image_size[1])] = 0.5
    before = replace(gaussians, view_index=torch.zeros(80, dtype=torch.long))
    edited = replace(before, harmonics=-gaussians.harmonics)
    inputs = RefineInputs(cameras, views, rasterizer, masks, before)
    return edited, edit3r.build("refiner", "keep-outside-mask")(edited, inputs), inputs


def test_keep_outside_mask_keeps_what_shows_outside_and_takes_what_shows_inside_alone(
    rasterizer, scene
):
    edited, result, inputs = masked(scene, rasterizer, 0.7)
    with torch.no_grad():
        old, new = (
            rasterizer.render(g, scene[1]).images[0].movedim(1, -1)
            for g in (inputs.before, result)
        )
    outside = inputs.masks[0] == 0
    assert torch.equal(old[outside], new[outside]) and not torch.equal(old, new)
    from_before = (result.harmonics == inputs.before.harmonics).flatten(2).all(2)
    from_edited = (result.harmonics == edited.harmonics).flatten(2).all(2)
    assert (from_before ^ from_edited).all() and from_edited.any()


def test_keep_outside_mask_keeps_nothing_where_masks_cover_all_or_there_are_none(
    rasterizer, scene
):
    gaussians, cameras, views = scene
    refiner = edit3r.build("refiner", "keep-outside-mask")
    assert isinstance(refiner, ComparesWithBefore)
    for masks in (None, torch.ones(1, 2, *cameras.image_size)):
        before = replace(gaussians, harmonics=-gaussians.harmonics)
        inputs = RefineInputs(cameras, views, rasterizer, masks, before)
        assert refiner(gaussians, inputs) is gaussians
