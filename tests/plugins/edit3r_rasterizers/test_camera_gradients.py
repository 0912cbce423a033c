"""Gradients by poses and intrinsics: the reference's against finite differences, numba's against
the reference's. They are in `gradients` of the other tests too.
"""

import math
from dataclasses import replace

import pytest
import torch
from raster_scenes import FIELDS, cameras, cloud, gradients, one

import edit3r
from edit3r.contract.types import Cameras, Gaussians

GREY = torch.tensor([0.2, 0.5, 0.8])
NUMBA = edit3r.build("rasterizer", "numba")
TORCH = edit3r.build("rasterizer", "torch")


@pytest.mark.slow
def test_reference_gradients_by_cameras_agree_with_finite_differences():
    scene = cloud(3, degree=1, dtype=torch.float64)
    views = cameras((3, 4), count=2, dtype=torch.float64)

    def render(c2w, intrinsics):
        seen = TORCH.render(scene, Cameras(c2w, intrinsics, (3, 4)))
        return seen.images, seen.alphas, seen.depths

    inputs = views.c2w.clone(), views.intrinsics.clone()
    assert torch.autograd.gradcheck(
        render, [value.requires_grad_() for value in inputs], atol=1e-5
    )


def balls(*places, **changes) -> Gaussians:
    turned = {"quats": [0.9, 0.2, 0.3, 0.1], "scales": [0.9, 0.5, 0.7]} | changes
    return Gaussians.cat([one(means=list(place), **turned) for place in places])


def far_away() -> tuple[Gaussians, Cameras]:
    scene, views = cloud(30, degree=2), cameras(count=2)
    shift = torch.tensor([100.0, -300.0, 200.0])
    c2w = views.c2w.clone()
    c2w[..., :3, 3] += shift
    return replace(scene, means=scene.means + shift), replace(views, c2w=c2w)


def off_centre() -> Cameras:
    views = cameras((21, 50), count=3)
    intrinsics = views.intrinsics.clone()
    intrinsics[..., :2, 2] = torch.tensor([0.3, 0.8])
    intrinsics[..., 1, 1] *= 0.6
    return replace(views, intrinsics=intrinsics)


BORDERS = [(x, y, 2.0) for x in (-2.4, 0.1, 2.4) for y in (-2.0, 0.1, 2.0)]
SCENES = {
    "several_cameras": (cloud(60, degree=3), cameras((33, 47), count=3)),
    "off_centre": (cloud(60), off_centre()),
    "clamped_tangents": (balls(*BORDERS), cameras((33, 47), count=2)),
    "near_plane": (
        balls((0.002, 0.001, 0.011), (0.0, 0.0, 0.005), scales=[0.003] * 3),
        cameras(),
    ),
    "tiny": (cloud(60, scales=(1e-6, 1e-5)), cameras((64, 90))),
    "huge": (balls((0.1, 0.2, 3.0), scales=[50.0, 30.0, 0.1]), cameras()),
    "needle": (
        balls((-4.0, -3.0, 2.0), (0.1, 0.0, 2.0), scales=[3.0, 3e-3, 3e-3]),
        cameras((70, 90)),
    ),
    "grazing": (
        balls((0.1, 0.4, 2.0), quats=[1.0, 0.0, 0.0, 0.0], scales=[0.9, 1e-4, 0.9]),
        cameras(),
    ),
    "opaque": (balls((0.1, 0.2, 3.0), (0.0, 0.1, 4.0), opacities=1.0), cameras()),
    "zero_quats": (
        balls((0.1, 0.2, 3.0), quats=[0.0] * 4, scales=[0.3, 0.1, 0.2]),
        cameras(),
    ),
    "wide": (cloud(60), cameras((20, 90), fov=math.radians(150))),
    "far_from_the_origin": far_away(),
}


@pytest.mark.parametrize("name", SCENES)
def test_numba_gradients_by_cameras_agree_with_the_reference(name):
    scene, views = SCENES[name]
    exact = scene.to(torch.float64), views.to(torch.float64)
    truth = gradients(TORCH, *exact, GREY)
    found = gradients(NUMBA, scene, views, GREY)
    also = gradients(NUMBA, *exact, GREY)
    for camera in ("c2w", "intrinsics"):
        assert found[camera].dtype == torch.float32
        assert also[camera].dtype == torch.float64
        for part in (slice(-1), slice(-1, None)):  # rotation or focal lengths; the rest
            expected = truth[camera][..., part]
            largest = expected.abs().max()
            assert largest > 0
            assert (found[camera][..., part] - expected).abs().max() <= 1e-3 * largest


@pytest.mark.parametrize(
    "scene", [cloud(0, degree=1), cloud(9, batch=2), one(opacities=0.0)]
)
def test_cameras_that_nothing_moves_have_gradients_of_zero(scene):
    behind = replace(scene, means=-scene.means)
    found = gradients(NUMBA, behind, cameras(batch=len(scene.means)), GREY)
    assert not found["c2w"].any() and not found["intrinsics"].any()


def test_what_else_asks_for_a_gradient_changes_none():
    scene, views = cloud(60, degree=2), cameras(count=3)
    leaves = {name: getattr(scene, name) for name in FIELDS}
    leaves |= {name: getattr(views, name) for name in ("c2w", "intrinsics")}

    def found(*asking):
        given = {
            name: value.clone().requires_grad_(name in asking)
            for name, value in leaves.items()
        }
        posed = Cameras(given.pop("c2w"), given.pop("intrinsics"), views.image_size)
        wanted = [{**given, **vars(posed)}[name] for name in asking]
        loss = NUMBA.render(Gaussians(**given), posed).images.square().sum()
        return dict(zip(asking, torch.autograd.grad(loss, wanted)))

    every = found(*leaves)
    for asking in [FIELDS, ["c2w"], ["intrinsics"], ["harmonics", "intrinsics"]]:
        for name, gradient in found(*asking).items():
            assert gradient.any() and torch.equal(gradient, every[name]), name
