"""edit3r's contract of a reconstructor, on a tiny random network that answers as VGGT does."""

import pytest
import torch
from edit3r_vggt import reconstructor
from torch import nn

import edit3r
from edit3r.contract.types import Views
from edit3r_testing import ReconstructorContract, photograph


class Tiny(nn.Module):
    """What VGGT's forward returns, of a network of two layers."""

    def __init__(self, weights: str = "") -> None:
        super().__init__()
        torch.manual_seed(0)
        self.pose, self.maps = nn.Linear(3, 9), nn.Conv2d(3, 2, 3, padding=1)

    def forward(self, images):
        depth, conf = (
            self.maps(images.flatten(0, 1))
            .exp()
            .unflatten(0, images.shape[:2])
            .unbind(2)
        )
        usual = torch.tensor([0.0, 0, 0, 0, 0, 0, 1, 0.6, 0.8])
        poses = usual + 0.1 * self.pose(images.mean((3, 4)))
        return {
            "pose_enc": poses,
            "depth": depth[..., None] + 1,
            "depth_conf": conf + 1,
        }


@pytest.fixture(scope="module", autouse=True)
def tiny():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            reconstructor, "load", Tiny
        )  # with a GPU and VGGT: take out this line
        yield


def built():
    return reconstructor.VggtReconstructor(
        reconstructor.VggtReconstructor.Settings(size=56)
    )


class TestVggtKeepsTheContract(ReconstructorContract):
    def build(self):
        return built()


def test_pictures_poses_and_lens_reach_the_scene():
    views = photograph(2, (48, 64)).views
    result = edit3r.run(
        views, "make everything grey", recon=built(), frames=2, outputs=["scene"]
    )
    told = Tiny()(views.at((42, 56)).images)
    geometry = built().find_geometry(views)
    assert geometry.depths.shape == (1, 2, 48, 64)
    across, high = geometry.intrinsics[0, 1].diagonal()[:2]
    wide, tall = (0.5 / told["pose_enc"][0, 1, [8, 7]].mul(0.5).tan()).tolist()
    assert (float(across), float(high)) == pytest.approx((wide, tall), rel=1e-4)
    assert result.cameras.c2w[0, 1, :3, 3].norm() > 0
    assert torch.equal(result.cameras.c2w, geometry.c2w)


def test_the_world_of_view_0_is_the_frame():
    """A network that turns its whole world gives the same scene."""
    views = photograph(2, (48, 64)).views
    first, turned = built(), built()
    quarter = torch.tensor([0.0, 0, 0.5**0.5, 0.5**0.5])  # xyzw, about z

    class Turned(Tiny):
        def forward(self, images):
            told = super().forward(images)
            poses = told["pose_enc"].clone()
            x, y, z, w = torch.nn.functional.normalize(poses[..., 3:7], dim=-1).unbind(
                -1
            )
            s, c = quarter[2], quarter[3]
            poses[..., 3:7] = torch.stack(
                (x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s), -1
            )
            return {**told, "pose_enc": poses}

    turned.model = Turned().eval()
    a, b = (
        one.find_geometry(Views(views.images, views.intrinsics)).c2w
        for one in (first, turned)
    )
    assert torch.allclose(a, b, atol=1e-5)
