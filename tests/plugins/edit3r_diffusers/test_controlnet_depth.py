"""The GaussCtrl-like editor on a tiny random model whose ControlNet does something."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Geometry, Matcher

pytestmark = pytest.mark.slow

ASK = edit3r.EditRequest("a red bike", seed=3)


class SlopeMatcher(Matcher):
    """Stands in for a matcher: depth grows from `near` to `far` across the picture."""

    def __init__(self, near: float = 1.0, far: float = 4.0) -> None:
        self.near, self.far = near, far

    def match(self, views):
        batch, count = views.images.shape[:2]
        height, width = views.image_size
        slope = torch.linspace(self.near, self.far, width)
        depths = slope.expand(batch, count, height, width)
        pose, placed = torch.eye(4).expand(batch, count, 4, 4), torch.ones(batch, count)
        return Geometry(pose, depths, torch.ones_like(depths), placed > 0)


@pytest.fixture(scope="module")
def build(tiny):
    models = {"model": tiny.stable_diffusion(), "controlnet": tiny.controlnet()}
    usual = {name: str(folder) for name, folder in models.items()}
    usual |= {"steps": 2, "resolution": 0, "local_files_only": True}

    def build(matcher=None, **settings):
        parts = {"matcher": matcher or SlopeMatcher()}
        return edit3r.build("editor", "controlnet-depth", parts, **usual | settings)

    return build


@pytest.fixture(scope="module")
def edited(build, two_views):
    return build().edit(two_views, ASK).images


def test_prompt_and_every_setting_change_the_result(build, edited, two_views):
    snow = build().edit(two_views, replace(ASK, prompt="snow")).images
    assert not torch.equal(snow, edited)
    changes = {"guidance": 3.0, "negative_prompt": "blurry", "source_prompt": "a bike"}
    changes |= {"strength": 0.5, "invert": False, "eta": 0.5, "cross_view": 0.0}
    changes |= {"references": 1, "control_scale": 0.0}
    for name, value in changes.items():
        other = build(**{name: value}).edit(two_views, ASK).images
        assert not torch.equal(other, edited), name


def test_depth_changes_the_result_only_through_the_controlnet(build, edited, two_views):
    other = SlopeMatcher(near=4.0, far=1.0)
    turned = build(other).edit(two_views, ASK).images
    assert not torch.allclose(turned, edited, atol=1e-3)
    without = [
        build(matcher, control_scale=0.0).edit(two_views, ASK).images
        for matcher in (other, SlopeMatcher())
    ]
    assert torch.equal(*without)


def test_attention_across_views_lets_a_view_depend_on_the_other(build, two_views):
    changed = replace(two_views, images=two_views.images.clone())
    changed.images[:, 1] = changed.images[:, 1].flip(-1)
    # view 1 is no reference, so view 0 must not see it, but view 1 must see view 0
    one_reference = {"references": 1, "cross_view": 0.5, "invert": False}
    before, after = (
        build(**one_reference).edit(views, ASK).images for views in (two_views, changed)
    )
    assert torch.allclose(before[:, 0], after[:, 0], atol=1e-5)
    alone = [
        build(cross_view=weight, references=1).edit(two_views, ASK).images[:, 1]
        for weight in (0.0, 0.5)
    ]
    assert not torch.allclose(*alone, atol=1e-4)


def test_a_mask_confines_the_edit_along_the_inverted_latents(
    build, two_views, left_half
):
    masked = replace(ASK, masks=left_half)
    images = build().edit(two_views, masked).images
    other = build().edit(two_views, replace(masked, prompt="snow")).images
    difference = (images - other).abs()
    # The latents agree outside; what is left there leaks through the tiny autoencoder's
    # normalisation.
    assert difference[..., -8:].mean() < 0.3 * difference[..., :8].mean()


def test_two_scenes_are_edited_apart(build, two_views):
    images = torch.cat((two_views.images, two_views.images.flip(-1)))
    both = edit3r.Views(images, two_views.intrinsics.expand(2, -1, -1, -1))
    images = build().edit(both, ASK).images
    assert torch.allclose(images[:1], build().edit(two_views, ASK).images, atol=1e-5)


def test_one_view_is_refused_with_the_way_out(build, two_views):
    with pytest.raises(InputError, match="leave out --edit-views first"):
        build().edit(two_views.select([0]), ASK)
