"""What is particular to Gemini."""

from importlib.util import find_spec

import pytest

import edit3r

if not (find_spec("google") and find_spec("google.genai")):
    pytest.skip("needs google.genai", allow_module_level=True)
ASK = edit3r.EditRequest("paint it red", seed=7)


@pytest.fixture(params=["gemini-image"])
def editor_name(request):
    return request.param


def test_shape_seed_and_modality_are_asked_for(build, fake, two_views):
    build().edit(two_views, ASK)
    sent = fake.requests[0]
    assert sent["path"].endswith("/models/gemini-2.5-flash-image:generateContent")
    config = sent["json"]["generationConfig"]
    assert config["seed"] == 7 and config["responseModalities"] == ["IMAGE"]
    assert config["imageConfig"]["aspectRatio"] == "4:3" and sent["size"] == (864, 1184)


def test_the_seed_is_declared_as_not_binding():
    offer = next(
        offer
        for offer in edit3r.components("editor")
        if offer.component.name == "gemini-image"
    )
    assert not offer.component.supports_seed
