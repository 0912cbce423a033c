"""The editor for any class of diffusers, on tiny random models of the presets."""

from dataclasses import replace

import pytest
import torch
from edit3r_diffusers.pipeline_editor import TAKES_SEVERAL

import edit3r
from edit3r.contract.errors import PromptError, RunError, SettingsError

pytestmark = pytest.mark.slow

ASK = edit3r.EditRequest("paint it red", seed=3)
PRESETS = ("flux-kontext", "qwen-image-edit", "flux2-klein", "longcat-image-edit")


@pytest.fixture(scope="module")
def build(tiny):
    def build(name: str, **settings):
        model = str(getattr(tiny, name.replace("-", "_"))())
        cheap = {"model": model, "steps": 2, "resolution": 64, "local_files_only": True}
        return edit3r.build("editor", name, **{**cheap, **settings})

    return build


@pytest.mark.parametrize("name", PRESETS)
def test_each_preset_edits_by_its_prompt(build, two_views, name):
    editor = build(name)
    edited, other = (
        editor.edit(two_views, replace(ASK, prompt=prompt)).images
        for prompt in ("red", "snow")
    )
    assert edited.shape == two_views.images.shape
    assert torch.isfinite(edited).all()
    assert not torch.equal(other, edited)


def test_equal_views_get_equal_edits(build, two_views):
    same = replace(two_views, images=two_views.images[:, :1].expand(-1, 2, -1, -1, -1))
    edited = build("flux2-klein").edit(same, ASK).images
    assert torch.equal(edited[0, 0], edited[0, 1])


def test_a_mask_goes_to_the_class_for_masks_made_of_the_same_parts(
    build, two_views, left_half
):
    editor = build("flux2-klein")
    masked = replace(ASK, masks=left_half)
    images = editor.edit(two_views, masked).images
    other = editor.edit(two_views, replace(masked, seed=4)).images
    assert type(editor._masked).__name__ == "Flux2KleinInpaintPipeline"
    assert editor._masked.transformer is editor._plain.transformer
    assert editor._masked.config.is_distilled
    outside = (images - other).abs()[..., -8:].mean()
    assert outside < 0.3 * (images - other).abs()[..., :8].mean()


def test_any_class_is_driven_by_its_name_and_the_arguments_of_its_call(tiny, two_views):
    given = {"model": str(tiny.instruct_pix2pix()), "steps": 2, "resolution": 0}
    given |= {"pipeline": "StableDiffusionInstructPix2PixPipeline"}
    plain, closer = (
        edit3r.build("editor", "diffusers", **given, **more).edit(two_views, ASK).images
        for more in ({}, {"arguments": {"image_guidance_scale": 3.0}})
    )
    assert plain.shape == two_views.images.shape and not torch.equal(closer, plain)


MODEL = {"model": "a/b"}


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({}, "needs a pipeline; give one with --set editor.pipeline=ClassName"),
        ({"pipeline": "LongCatImageEditPipeline"}, "needs a model"),
        ({"pipeline": "FluxPipeline"} | MODEL, "does not take an image and a prompt"),
        (
            {"pipeline": "LongCatImageEditPipeline", "strength": 0.5} | MODEL,
            r"editor\.strength: LongCatImageEditPipeline has no argument strength.*guidance_scale",
        ),
        (
            {"pipeline": "Flux2KleinPipeline", "arguments": {"zoom": 1}} | MODEL,
            r"editor\.arguments\.zoom: Flux2KleinPipeline has no argument zoom",
        ),
    ],
)
def test_what_a_class_lacks_is_told_before_anything_is_loaded(
    two_views, settings, told
):
    with pytest.raises(SettingsError, match=told):
        edit3r.build("editor", "diffusers", **settings).edit(two_views, ASK)


def test_what_a_class_refuses_is_a_sentence(build, two_views):
    said = r"editing left\.png: Flux2KleinPipeline refused: Image too small"
    with pytest.raises(RunError, match=said):
        build("flux2-klein", resolution=32).edit(two_views, ASK)


def test_no_prompt_is_an_error(build, two_views):
    with pytest.raises(PromptError, match="qwen-image-edit needs an instruction"):
        build("qwen-image-edit").edit(two_views, replace(ASK, prompt=" "))


@pytest.mark.parametrize("name", sorted(TAKES_SEVERAL))
def test_the_classes_that_take_several_pictures_exist(name):
    diffusers = pytest.importorskip("diffusers")
    assert "image" in getattr(diffusers, name).__call__.__annotations__
