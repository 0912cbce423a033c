"""Pictures drawn again in part are the pictures drawn whole."""

from dataclasses import replace

import torch

from edit3r.geometry.paths import between_and_around
from edit3r.reuse.crop import boxes_of, cropped
from edit3r.reuse.frames import changed_between, redraw
from edit3r.reuse.graft import graft
from edit3r.testing.scenes import cameras_around, gaussian_cloud
from edit3r.types import Views


def test_a_cropped_camera_shows_the_pixels_of_the_whole_picture(rasterizer):
    cloud, camera = gaussian_cloud(200, seed=1), cameras_around(1, (40, 56))
    cloud = replace(cloud, scales=cloud.scales * 0.2)
    whole = rasterizer.render(cloud, camera).images[0, 0]
    part = rasterizer.render(cloud, cropped(camera, (7, 11, 30, 50))).images[0, 0]
    assert torch.allclose(part, whole[:, 7:30, 11:50], atol=1 / 255)


def test_nothing_shows_outside_its_box(rasterizer):
    camera = cameras_around(1, (64, 96))
    for index in range(40):
        one = gaussian_cloud(40, seed=2).select(torch.tensor([index]))
        shown = rasterizer.render(one, camera).alphas[0, 0, 0] > 0
        (box,) = boxes_of(one, camera)
        if box is not None:
            top, left, bottom, right = box
            shown[top:bottom, left:right] = False
        assert not shown.any()


def test_redrawn_pictures_are_those_of_the_new_scene(rasterizer, planted):
    before = planted.reconstruct(planted.views)
    inverted = planted.reconstruct(Views(1 - planted.views.images, planted.views.intrinsics)).gaussians
    after = graft(before.gaussians, inverted, planted.masks[1, 0] > 0, before.cameras, rasterizer).gaussians
    path = between_and_around(before.cameras, 5)
    drawn = []

    def render(camera):
        drawn.append(camera.image_size[0] * camera.image_size[1])
        return rasterizer.render(after, camera)

    old, new = (rasterizer.render(scene, path).images[0] for scene in (before.gaussians, after))
    frames = torch.stack(list(redraw(list(old), changed_between(before.gaussians, after), path, render)))
    assert torch.allclose(frames, new, atol=2e-3)
    assert sum(drawn) < 0.5 * new[:, 0].numel() and float((old - new).abs().amax()) > 0.2


def test_scenes_of_other_structure_have_no_known_difference(planted):
    scene = planted.reconstruct(planted.views).gaussians
    assert changed_between(scene, scene).count == 0
    assert changed_between(scene, scene.select(torch.arange(10))) is None
