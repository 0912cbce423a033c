"""2D editors behind an API key: GPT-Image and Gemini."""

from functools import partial

from edit3r import Component, hookimpl

EDIT3R_API = 1

_service = partial(
    Component,
    licence="Apache-2.0; the service has its own terms",
    needs_network=True,
    actions=("other",),
    supports_seed=False,
)


@hookimpl
def register_editors():
    return (
        _service(
            name="gpt-image",
            target="edit3r_remote.gpt_image:GptImageEditor",
            summary="OpenAI's image editing service; costs money, needs OPENAI_API_KEY in the "
            "environment; no seed",
            requires=("openai",),
            extra="openai",
        ),
        _service(
            name="gemini-image",
            target="edit3r_remote.gemini_image:GeminiImageEditor",
            summary="Google's Gemini image model; costs money, needs GEMINI_API_KEY in the "
            "environment; seed is a hint",
            requires=("google.genai",),
            extra="gemini",
        ),
    )
