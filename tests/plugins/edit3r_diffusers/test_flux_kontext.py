"""FLUX.1 Kontext on a tiny random model."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import SettingsError

ASK = edit3r.EditRequest("paint it red", seed=3)


@pytest.fixture(scope="module")
def build(tiny):
    usual = {"model": str(tiny.flux_kontext()), "local_files_only": True}
    usual |= {"steps": 2, "resolution": 0}
    return lambda **given: edit3r.build("editor", "flux-kontext", **usual | given)


@pytest.fixture(scope="module")
def edited(build, two_views):
    return build().edit(two_views, ASK).images


def test_without_masks_it_is_the_plain_kontext_pipeline(tiny, edited, two_views):
    from diffusers import FluxKontextPipeline

    model = tiny.flux_kontext()
    pipeline = FluxKontextPipeline.from_pretrained(model, local_files_only=True)
    plain = pipeline(
        image=two_views.images[0, :1],
        prompt=ASK.prompt,
        **{"height": 32, "width": 32, "max_area": 1024, "_auto_resize": False},
        num_inference_steps=2,
        guidance_scale=2.5,
        generator=torch.Generator().manual_seed(3),
        output_type="pt",
    ).images
    assert torch.allclose(edited[0, 0], plain[0], atol=1e-4)


@pytest.mark.slow
def test_guidance_strength_and_negative_prompt_change_the_result(
    build, edited, two_views
):
    negative = {"negative_prompt": "blurry", "true_guidance": 3.0}
    for change in ({"guidance": 7.0}, {"strength": 0.5}, negative):
        other = build(**change).edit(two_views, ASK).images
        assert not torch.equal(other, edited), change


def test_a_mask_confines_the_edit_through_the_inpaint_form(build, two_views, left_half):
    masked = replace(ASK, masks=left_half)
    images = build().edit(two_views, masked).images
    other = build().edit(two_views, replace(masked, prompt="make it snow")).images
    assert torch.allclose(images[..., -8:], other[..., -8:], atol=0.02)
    assert not torch.equal(images[..., :8], other[..., :8])


def test_an_empty_mask_leaves_the_photos_alone(build, two_views):
    nothing = replace(ASK, masks=torch.zeros(1, 2, 32, 32))
    assert torch.equal(build().edit(two_views, nothing).images, two_views.images)


def test_a_negative_prompt_without_guidance_is_refused(build):
    with pytest.raises(SettingsError, match="true_guidance above 1"):
        build(negative_prompt="blurry")
