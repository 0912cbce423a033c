"""A fit finds the scene, repeats itself, and goes on after it was stopped."""

import pytest
import torch
from edit3r_optimisers.checkpoints import Checkpoints, fingerprint
from edit3r_optimisers.fitting import FitPlan, FixedPictures, fit, scene_extent
from edit3r_optimisers.settings import FitSettings

from edit3r.errors import InputError
from edit3r.types import Views

QUICK = FitSettings(densify_from=4, densify_every=4, densify_until=0.8, grow_gradient=1e-4, reset_every=10)
FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


@pytest.fixture
def start(build, posed):
    """First Gaussians and cameras."""
    first = build("refit").reconstructor(posed)
    return first.gaussians, first.cameras


def fitted(start, posed, rasterizer, steps, settings=QUICK, keeper=None, pictures=None):
    pictures = pictures or FixedPictures(posed.images[0])
    return fit(*start, pictures, rasterizer, FitPlan(settings, steps, 3, "test"), keeper)


def psnr(image, target) -> float:
    return float(-10 * torch.log10((image.clamp(0, 1) - target).square().mean()))


def test_loss_falls_and_the_views_look_like_the_photos(start, posed, rasterizer):
    settings = FitSettings(colour_rate=0.05, densify_from=20, densify_every=20)
    result = fitted(start, posed, rasterizer, 90, settings)
    first, last = (sum(part) / 9 for part in (result.losses[:9], result.losses[-9:]))
    assert last < first / 4
    rendering = rasterizer.render(result.gaussians, start[1])
    assert psnr(rendering.images, posed.images) > 26  # the grey ones it began with: 16 dB
    assert psnr(rasterizer.render(*start).images, posed.images) < 17


def test_gaussians_are_valid_and_know_the_view_they_came_from(start, posed, rasterizer):
    scene = fitted(start, posed, rasterizer, 12).gaussians
    assert not any(getattr(scene, name).requires_grad for name in FIELDS)
    assert scene.count != start[0].count and scene.view_index.max() <= 2
    assert torch.allclose(scene.quats.norm(dim=-1), torch.ones(1, scene.count), atol=1e-5)


class Stop(Exception):
    pass


class Stopping(FixedPictures):
    """Raises when it is asked before step 9."""

    def before(self, step, scene):
        if step == 9:
            raise Stop


def test_a_fit_that_was_stopped_ends_with_the_bytes_of_one_that_was_not(start, posed, rasterizer, tmp_path):
    straight = fitted(start, posed, rasterizer, 18)
    keeper = Checkpoints(tmp_path / "new", every=4).keeper("fit", posed.images)
    with pytest.raises(Stop):
        fitted(start, posed, rasterizer, 18, keeper=keeper, pictures=Stopping(posed.images[0]))
    assert keeper.load()["step"] == 8
    resumed = fitted(start, posed, rasterizer, 18, keeper=keeper)
    assert resumed.losses == straight.losses
    assert all(torch.equal(getattr(resumed.gaussians, n), getattr(straight.gaussians, n)) for n in FIELDS)
    # A finished one is taken as it is.
    again = fitted(start, posed, rasterizer, 18, keeper=keeper, pictures=Stopping(posed.images[0]))
    assert torch.equal(again.gaussians.means, straight.gaussians.means)


def test_a_file_that_is_no_checkpoint_is_an_error_that_says_what_to_do(tmp_path):
    keeper = Checkpoints(tmp_path, every=1).keeper("fit", 1)
    keeper.path.write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="delete it to begin anew"):
        keeper.load()


def test_checkpoints_of_other_inputs_are_other_files_and_vanish_when_the_work_is_done(tmp_path):
    checkpoints = Checkpoints(tmp_path, every=1)
    one, other = (checkpoints.keeper("fit", torch.tensor([value]), "same") for value in (1.0, 2.0))
    assert one.path != other.path and fingerprint(torch.zeros(2)) != fingerprint(torch.zeros(1, 2))
    for keeper in (one, other):
        keeper.save({"step": 1})
    checkpoints.discard()
    assert not list(tmp_path.iterdir())
    assert Checkpoints(None, every=1).keeper("fit", 1) is None


def test_extent_is_how_far_the_cameras_are_from_the_scene_however_near_each_other(truth, start):
    near = scene_extent(*start)
    apart = Views(truth.views.images, truth.views.intrinsics, c2w=truth.cameras.c2w)
    assert 2 < near < 4.5 and apart.count == 3  # balls and wall are 1.8 to 4 away, the cameras 0.2 from each other
