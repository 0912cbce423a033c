"""What is particular to OpenAI's service."""

import io
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from PIL import Image

import edit3r

if find_spec("openai") is None:
    pytest.skip("needs openai", allow_module_level=True)
ASK = edit3r.EditRequest("paint it red")


@pytest.fixture(params=["gpt-image"])
def editor_name(request):
    return request.param


def test_the_declared_component_says_it_has_no_seed():
    offer = next(
        offer
        for offer in edit3r.components("editor")
        if offer.component.name == "gpt-image"
    )
    assert not offer.component.supports_seed and offer.component.needs_network


def test_a_photo_is_sent_in_a_size_the_service_offers_with_settings(
    build, fake, two_views
):
    build(quality="low").edit(two_views, ASK)
    sent = fake.requests[0]
    assert sent["size"] == (1024, 1536)
    assert Image.open(io.BytesIO(sent["image"])).size == (1536, 1024)
    assert (sent["quality"], sent["input_fidelity"], sent["model"]) == (
        b"low",
        b"high",
        b"gpt-image-1",
    )
    assert "seed" not in sent and "mask" not in sent


@pytest.mark.slow
def test_the_mask_is_transparent_where_the_picture_may_change(build, fake, two_views):
    masks = torch.zeros(1, 2, 24, 32)
    masks[..., :16] = 1
    build().edit(two_views, replace(ASK, masks=masks))
    mask = Image.open(io.BytesIO(fake.requests[0]["mask"]))
    alpha = np.array(mask)[..., 3]
    assert mask.mode == "RGBA" and mask.size == (1536, 1024)
    assert (alpha[:, :700] == 0).all() and (alpha[:, 800:] == 255).all()
