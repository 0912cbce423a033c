"""The four methods begin with a given scene, as they were published."""

import pytest
import torch

import edit3r
from edit3r.contract.interfaces import StartsFromScene
from edit3r.kit.scenes.scene_views import look_around, pictures_of
from tests.plugins.scan import of_ball, scan

METHODS = ("refit", "instruct-nerf2nerf", "gaussctrl", "editsplat")


@pytest.fixture(scope="module")
def scene(rasterizer):
    places = look_around(scan(), rasterizer, count=3, size=(24, 24))
    return pictures_of(scan(), places, rasterizer)


@pytest.mark.parametrize("method", METHODS)
def test_a_given_scene_is_begun_with_and_no_photo_is_fitted(method, scene, build):
    built = build(method, edit_steps=2)
    assert isinstance(built, StartsFromScene)
    started = built.starting_from(scene.scene)
    assert built.given is None
    begun, cameras = started._fit_photos(None)  # it would fail on photos
    assert begun is scene.scene.gaussians
    assert cameras is scene.scene.cameras
    assert not started.uses_geometry
    made = started(scene.pictures)
    # What was given is moved a little, not made anew; editsplat trims what the edit attends to.
    assert 0.5 * scan().count < made.gaussians.count <= scan().count
    assert torch.equal(made.cameras.c2w, scene.scene.cameras.c2w)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_run_on_a_scene_with_a_method_comes_back_in_the_scenes_own_frame(
    method, tmp_path
):
    given = scan()
    looked = edit3r.run(given, editor="none", size=32, views=3)
    red, green, blue = looked.photos.images.unbind(2)
    masks = ((red > 1.8 * green) & (red > 1.8 * blue)).float()
    recon = {"name": method, "edit_steps": 4}
    result = edit3r.run(
        given, "paint the ball blue", masks=masks, recon=recon, size=32, views=3
    )
    edited = result.scene
    low, high = (given.means[0].quantile(q, 0) for q in (0.02, 0.98))
    inside = ((edited.means[0] > low - 0.2) & (edited.means[0] < high + 0.2)).all(1)
    assert inside.float().mean() > 0.9
    if edited.count == given.count:
        moved = edited.harmonics[0, of_ball(given, 0), 0]
        before = given.harmonics[0, of_ball(given, 0), 0]
        assert (moved - before)[:, 2].mean() > 0  # bluer
