"""The contracts of backbones and heads find every way of breaking them."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Backbone, GaussianHead
from edit3r.contract.types import Features
from edit3r_testing import BackboneContract, HeadContract, TinyBackbone


class SpoiledBackbone(Backbone):
    def __init__(self, spoil):
        super().__init__()
        self.good, self.spoil = TinyBackbone(), spoil
        self.patch_size, self.feature_widths = (
            self.good.patch_size,
            self.good.feature_widths,
        )

    def forward(self, images, intrinsics, geometry=None):
        return self.spoil(images, self.good(images, intrinsics))


class SpoiledHead(GaussianHead):
    def __init__(self, good, spoil):
        super().__init__()
        self.good, self.spoil = good, spoil

    def forward(self, *given):
        return self.spoil(self.good(*given))


def levels(features, change):
    return Features(tuple(change(level) for level in features.levels), features.grid)


def two_views_only(images, features):
    if images.shape[1] != 2:
        raise ValueError("expected 2 views")
    return features


SHAPE, BATCH, GRADIENT = (
    "test_features_have_the_declared_shape",
    "test_batch_items_are_independent",
    "test_gradients_are_finite",
)
BACKBONES = {
    "a tuple": (lambda i, f: f.levels, SHAPE, "types.Features, got tuple"),
    "two views only": (two_views_only, SHAPE, "raised ValueError: expected 2 views"),
    "a level too few": (
        lambda i, f: Features(f.levels[1:], f.grid),
        SHAPE,
        "as feature_widths say",
    ),
    "other widths": (
        lambda i, f: levels(f, lambda x: x[..., :5]),
        SHAPE,
        "as feature_widths say",
    ),
    "half precision": (
        lambda i, f: levels(f, torch.Tensor.half),
        SHAPE,
        "return torch.float32",
    ),
    "a grid turned over": (
        lambda i, f: Features(f.levels, f.grid[::-1]),
        SHAPE,
        "return grid (2, 3) for patches of 16, got (3, 2)",
    ),
    "batch statistics": (
        lambda i, f: levels(f, lambda x: x - x.mean()),
        BATCH,
        "never over the batch",
    ),
    "a root at 0": (
        lambda i, f: levels(f, lambda x: (x * 0).abs().sqrt()),
        GRADIENT,
        "is not finite",
    ),
    "detached": (
        lambda i, f: levels(f, torch.Tensor.detach),
        GRADIENT,
        "do not detach",
    ),
}

VALID, MAJOR = (
    "test_gaussians_are_valid_for_any_number_of_views",
    "test_view_index_is_view_major",
)
HEADS = {
    "raw opacities": (
        lambda g: replace(g, opacities=g.opacities * 9),
        VALID,
        "return opacities in [0, 1]",
    ),
    "raw scales": (
        lambda g: replace(g, scales=-g.scales),
        VALID,
        "return scales above 0",
    ),
    "a Gaussian too few": (
        lambda g: g.select(torch.arange(g.count - 1)),
        VALID,
        "1 (per_pixel) of each pixel",
    ),
    "no view numbers": (
        lambda g: replace(g, view_index=None),
        MAJOR,
        "repeat_interleave",
    ),
    "pixel by pixel": (
        lambda g: replace(g, view_index=g.view_index.view(3, -1).T.flatten()),
        MAJOR,
        "view by view",
    ),
    "a root at 0": (
        lambda g: replace(g, scales=(g.means * 0).abs().sqrt() + 1),
        GRADIENT,
        "is not finite",
    ),
}


@pytest.mark.parametrize("case", BACKBONES)
def test_a_backbone_broken_by(case, complaint):
    spoil, claim, advice = BACKBONES[case]
    assert advice in complaint(BackboneContract, lambda: SpoiledBackbone(spoil), claim)


@pytest.mark.parametrize("case", HEADS)
def test_a_head_broken_by(case, examples, complaint):
    spoil, claim, advice = HEADS[case]
    good = examples.build("head", "worked-head", parts={"backbone": TinyBackbone()})
    assert advice in complaint(HeadContract, lambda: SpoiledHead(good, spoil), claim)


def test_the_tiny_backbone_passes_its_contract():
    contract = type(
        "Bound", (BackboneContract,), {"build": lambda self: TinyBackbone()}
    )()
    for claim in (SHAPE, BATCH, GRADIENT):
        getattr(contract, claim)()


def test_a_head_is_tried_on_the_backbone_the_author_chooses(examples):
    class Wide(HeadContract):
        component, plugin_files = "worked-head", ()

        def make_backbone(self):
            return TinyBackbone(patch_size=4, feature_widths=(33,))

        @property
        def registry(self):
            return examples

    assert Wide().build().out.in_features == 33
    Wide().test_gaussians_are_valid_for_any_number_of_views()


def test_the_tiny_backbone_draws_nothing_from_the_global_generator():
    torch.manual_seed(0)
    expected = torch.rand(1)
    torch.manual_seed(0)
    TinyBackbone()
    assert torch.rand(1) == expected


def test_every_claim_about_networks_can_fail():
    for contract, cases in ((BackboneContract, BACKBONES), (HeadContract, HEADS)):
        own = {name for name in vars(contract) if name.startswith("test_")}
        assert own == {claim for _, claim, _ in cases.values()}
