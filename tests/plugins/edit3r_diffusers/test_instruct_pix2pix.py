"""InstructPix2Pix on a tiny random model."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import PromptError
from edit3r.contract.reporting import Report, collecting

pytestmark = pytest.mark.slow

ASK = edit3r.EditRequest("paint it red", seed=3)


@pytest.fixture(scope="module")
def build(tiny):
    usual = {"model": str(tiny.instruct_pix2pix()), "local_files_only": True}
    usual |= {"steps": 2, "resolution": 0}
    return lambda **given: edit3r.build("editor", "instruct-pix2pix", **usual | given)


@pytest.fixture(scope="module")
def edited(build, two_views):
    return build().edit(two_views, ASK).images


def test_two_equal_views_get_the_same_edit(build, two_views):
    twice = two_views.select([0, 0])
    images = build().edit(twice, ASK).images
    assert torch.equal(images[:, 0], images[:, 1])


@pytest.mark.slow
def test_prompt_guidance_and_negative_prompt_change_the_result(
    build, edited, two_views
):
    snow = build().edit(two_views, replace(ASK, prompt="make it snow")).images
    assert not torch.equal(snow, edited)
    changes = {"guidance": 3.0, "image_guidance": 3.0, "negative_prompt": "blurry"}
    for name, value in (changes | {"steps": 3}).items():
        other = build(**{name: value}).edit(two_views, ASK).images
        assert not torch.equal(other, edited), name


def test_a_mask_confines_the_edit_already_before_the_composite(
    build, two_views, left_half
):
    masked = replace(ASK, masks=left_half)
    images = build().edit(two_views, masked).images
    other = build().edit(two_views, replace(masked, prompt="make it snow")).images
    # Far outside the mask only the autoencoder's own loss is left, whatever the instruction.
    assert torch.allclose(images[..., -8:], other[..., -8:], atol=0.02)
    assert not torch.allclose(images[..., :8], other[..., :8], atol=0.02)


def test_steps_are_reported_as_progress_and_weights_noted(build, two_views):
    events = []
    report = Report(on_event=lambda *event: events.append(event))
    with collecting(report):
        build().edit(two_views, ASK)
    assert ("progress", "editing left.png", 1, 2) in events
    assert ("progress", "editing right.png", 2, 2) in events
    assert report.notes["editor.weights"]["model"].endswith("instruct-pix2pix")


def test_an_empty_instruction_is_refused(build, two_views):
    with pytest.raises(PromptError, match="--prompt"):
        build().edit(two_views, edit3r.EditRequest("  "))
