"""Pictures drawn again in part are the pictures drawn whole, byte for byte."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners.footprint import measured_footprint

import edit3r
from edit3r.geometry.paths import between_and_around
from edit3r.io.images import encode_png, to_bytes
from edit3r.reuse.frames import changed_between, redraw


def drawn_whole(rasterizer, gaussians, path):
    return [to_bytes(picture) for picture in rasterizer.render(gaussians, path).images[0]]


@pytest.fixture
def edit(planted):
    """The scene, the scene with other colours and sizes in one corner, and a path around both."""
    before = planted.reconstruct(planted.views)
    corner = torch.zeros(planted.views.image_size, dtype=torch.bool)
    corner[4:14, 6:18] = True
    chosen = corner.flatten().repeat(2)[None, :, None]
    scene = before.gaussians
    after = replace(
        scene,
        harmonics=torch.where(chosen[..., None], -scene.harmonics, scene.harmonics),
        scales=torch.where(chosen, 1.5 * scene.scales, scene.scales),
    )
    return scene, after, between_and_around(before.cameras, 5)


def redrawn(rasterizer, before, after, path):
    """Pictures of `after`, and how many Gaussians were drawn for each."""
    drawn = []

    def render(gaussians, camera):
        drawn.append(gaussians.count)
        return rasterizer.render(gaussians, camera)

    files = [encode_png(picture) for picture in drawn_whole(rasterizer, before, path)]
    footprint = measured_footprint(rasterizer, after.means)
    return list(redraw(files, changed_between(before, after), after, path, footprint, render)), drawn


@pytest.mark.parametrize("settings", [{}, {"eps2d": 4.0}, {"min_alpha": 1e-3}, {"background": (0.2, 0.5, 0.9)}])
def test_redrawn_pictures_are_those_of_the_new_scene(edit, settings):
    rasterizer = edit3r.build("rasterizer", "numba", threads=1, **settings)
    before, after, path = edit
    pictures, drawn = redrawn(rasterizer, before, after, path)
    wanted = drawn_whole(rasterizer, after, path)
    assert all((picture == whole).all() for picture, whole in zip(pictures, wanted, strict=True))
    assert max(drawn) < 0.6 * after.count
    assert all((picture != old).any() for picture, old in zip(pictures, drawn_whole(rasterizer, before, path)))


def test_gaussians_that_moved_leave_no_trace_where_they_were(edit, rasterizer):
    before, _, path = edit
    means = before.means.clone()
    means[:, 500:560, 0] += 0.3
    after = replace(before, means=means)
    pictures, _ = redrawn(rasterizer, before, after, path)
    assert all((a == b).all() for a, b in zip(pictures, drawn_whole(rasterizer, after, path), strict=True))


def test_where_all_gaussians_went_behind_the_camera_the_background_is_drawn(edit, rasterizer):
    scene, _, path = edit
    before = scene.select(torch.arange(40))
    after = replace(before, means=before.means + torch.tensor([0, 0, -100.0]))
    pictures, drawn = redrawn(rasterizer, before, after, path)
    assert max(drawn) == 0 and not any(picture.any() for picture in pictures)
    assert any(picture.any() for picture in drawn_whole(rasterizer, before, path))


def test_pictures_of_an_unchanged_scene_are_not_drawn_and_of_a_new_one_drawn_whole(edit, rasterizer):
    before, _, path = edit
    pictures, drawn = redrawn(rasterizer, before, before, path)
    assert not drawn and all((a == b).all() for a, b in zip(pictures, drawn_whole(rasterizer, before, path)))
    after = replace(before, harmonics=-before.harmonics)
    pictures, drawn = redrawn(rasterizer, before, after, path)
    assert drawn == [after.count] * path.count
    assert all((a == b).all() for a, b in zip(pictures, drawn_whole(rasterizer, after, path)))


def test_scenes_of_other_structure_have_no_known_difference(planted):
    scene = planted.reconstruct(planted.views).gaussians
    assert changed_between(scene, scene).count == 0
    assert changed_between(scene, scene.select(torch.arange(10))) is None
