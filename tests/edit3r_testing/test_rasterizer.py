"""The rasterizer's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Rasterizer
from edit3r_testing import RasterizerContract, cameras_around, gaussian_cloud


class Spoiled(Rasterizer):
    """A good rasterizer whose input or answer is changed."""

    def __init__(self, good, answer=None, scene=None, cameras=None):
        same = lambda value: value  # noqa: E731
        self.good, self.settings = good, good.settings
        self.answer, self.scene, self.cameras = (
            answer or same,
            scene or same,
            cameras or same,
        )

    def render(self, gaussians, cameras):
        return self.answer(
            self.good.render(self.scene(gaussians), self.cameras(cameras))
        )


class HalfGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, gradient):
        return 0.5 * gradient


def no_empty_scene(gaussians):
    if gaussians.count == 0:
        raise IndexError("index 0 is out of bounds")
    return gaussians


def half_the_gradient_of(field):
    return {
        "scene": lambda g: replace(g, **{field: HalfGradient.apply(getattr(g, field))})
    }


def mirrored(gaussians):
    return replace(
        gaussians,
        means=torch.cat((gaussians.means[..., :2], gaussians.means[..., 2:].abs()), -1),
    )


def noisy(rendering):
    return replace(
        rendering, images=rendering.images + 1e-6 * torch.rand_like(rendering.images)
    )


RANGE, AGREES = "test_rendering_is_in_range", "test_agrees_with_the_reference"
GRADIENT = "test_gradients_agree_with_the_reference"
CASES = {
    "alphas beyond 1": (
        {"answer": lambda r: replace(r, alphas=r.alphas * 3)},
        RANGE,
        "return alphas in [0, 1]",
    ),
    "negative colours": (
        {"answer": lambda r: replace(r, images=r.images - 1)},
        RANGE,
        "clamp max(0, SH + 0.5)",
    ),
    "half a pixel off": (
        {
            "cameras": lambda c: replace(
                c,
                intrinsics=c.intrinsics
                + torch.tensor([[0, 0, 1 / 64], [0] * 3, [0] * 3]),
            )
        },
        AGREES,
        "pixel centres at +0.5",
    ),
    "quaternions xyzw": (
        {"scene": lambda g: replace(g, quats=g.quats.roll(1, -1))},
        AGREES,
        "wxyz quaternions",
    ),
    "depth not normalised": (
        {"answer": lambda r: replace(r, depths=r.depths * r.alphas)},
        AGREES,
        "sum(w z) / sum(w)",
    ),
    "sees behind itself": (
        {"scene": mirrored},
        "test_gaussians_behind_the_camera_are_not_seen",
        "cull z <= near_plane",
    ),
    "no empty scene": (
        {"scene": no_empty_scene},
        "test_empty_scene_shows_the_background",
        "raised IndexError",
    ),
    "alphas of nothing": (
        {"answer": lambda r: replace(r, alphas=r.alphas + 0.1)},
        "test_empty_scene_shows_the_background",
        "both must be 0",
    ),
    "noise": (
        {"answer": noisy},
        "test_same_input_gives_the_same_image",
        "sum in a fixed order",
    ),
    "half a gradient of opacity": (
        half_the_gradient_of("opacities"),
        GRADIENT,
        "the gradient of opacities is",
    ),
    "detached scales": (
        {"scene": lambda g: replace(g, scales=g.scales.detach())},
        GRADIENT,
        "no gradient reaches scales",
    ),
    "detached": (
        {
            "answer": lambda r: replace(
                r,
                images=r.images.detach(),
                alphas=r.alphas.detach(),
                depths=r.depths.detach(),
            )
        },
        GRADIENT,
        "render differentiably",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_rasterizer_broken_by(case, examples, complaint):
    changes, claim, advice = CASES[case]
    good = examples.build("rasterizer", "worked-rasterizer")
    assert advice in complaint(
        RasterizerContract, lambda: Spoiled(good, **changes), claim
    )


def test_the_reference_is_given_the_same_background(examples):
    """A rasterizer that is right passes with any background of its own."""

    class White(RasterizerContract):
        component, settings = "worked-rasterizer", {"background": (1.0, 1.0, 1.0)}

        @property
        def registry(self):
            return examples

    White().test_agrees_with_the_reference()
    assert (
        White().subject.render(gaussian_cloud(1), cameras_around()).images.max() > 0.9
    )


def test_every_claim_about_rasterizers_can_fail():
    own = {name for name in vars(RasterizerContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
