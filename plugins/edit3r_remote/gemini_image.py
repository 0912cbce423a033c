"""Gemini's image model through the Gemini API."""

from typing import Any

from pydantic import Field

from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import note
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.service import bounded_client
from edit3r_remote.dispatch import Dispatcher
from edit3r_remote.service import ImageService, RemoteSettings, Request, ServiceAnswer

SHAPES = {
    (1024, 1024): "1:1",
    (832, 1248): "3:2",
    (1248, 832): "2:3",
    (864, 1184): "4:3",
    (1184, 864): "3:4",
    (768, 1344): "16:9",
    (1344, 768): "9:16",
    (672, 1536): "21:9",
}
"""(height, width) the model draws [pixels] for each shape that can be asked for."""


class GeminiImageEditor(Editor):
    """Edits each view on its own by the same instruction and seed, which the service takes as a
    hint.

    The service takes no mask: outside it the framework's composite keeps the photo.
    """

    class Settings(RemoteSettings):
        model: str = "gemini-2.5-flash-image"
        """the service's name of the model"""
        retry_delay_s: float = Field(1.0, gt=0, le=60)
        """wait before the second try, doubled for each more"""
        input_price: float = Field(0.30, ge=0)
        """price of a million input tokens [USD]"""
        output_price: float = Field(30.0, ge=0)
        """price of a million output tokens [USD]"""

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        service = GeminiImages(self.settings)
        note(
            "editor.seed",
            "sent to the service, which does not promise equal images for equal seeds",
        )
        asked = {"service": "gemini", "model": self.settings.model}
        return Dispatcher(service, asked).edit(
            views, request, tuple(SHAPES), send_masks=False
        )


class GeminiImages(ImageService):
    """`generate_content` with an image as the only modality; the client library tries again."""

    label = "gemini-image"
    variables = ("GEMINI_API_KEY", "GOOGLE_API_KEY")

    def __init__(self, settings: GeminiImageEditor.Settings) -> None:
        from google import genai
        from google.genai import types

        super().__init__(settings)
        options = types.HttpOptions(
            base_url=settings.base_url or None,
            timeout=int(settings.timeout_s * 1000),
            httpx_client=bounded_client(settings.timeout_s),
            retry_options=types.HttpRetryOptions(
                attempts=settings.attempts,
                initial_delay=settings.retry_delay_s,
                jitter=settings.retry_delay_s,
            ),
        )
        self.client = genai.Client(
            api_key=self.key, vertexai=False, http_options=options
        )

    def send(self, request: Request) -> ServiceAnswer:
        from google.genai import errors, types

        config = types.GenerateContentConfig(
            response_modalities=["IMAGE"],
            seed=request.seed,
            image_config=types.ImageConfig(aspect_ratio=SHAPES[request.size]),
        )
        photo = types.Part.from_bytes(data=request.image, mime_type="image/png")
        prompt = types.Part.from_text(text=request.prompt)
        content = types.UserContent(parts=[prompt, photo])
        try:
            response = self.client.models.generate_content(
                model=self.settings.model, contents=content, config=config
            )
        except errors.APIError as error:
            words = error.message or error.status
            raise self.failure(error.code, words, request) from None
        usage = response.usage_metadata
        for part in response.parts or ():
            if part.inline_data and part.inline_data.data:
                return ServiceAnswer(
                    image=part.inline_data.data,
                    input_tokens=usage.prompt_token_count or 0 if usage else 0,
                    output_tokens=usage.candidates_token_count or 0 if usage else 0,
                )
        raise PromptError(
            f"gemini-image sent no image for {request.name}: {self._reason(response)}"
        )

    def _reason(self, response: Any) -> str:
        """What the model says instead of an image, and why it ended."""
        reasons = []
        if response.prompt_feedback:
            feedback = response.prompt_feedback
            reasons.append(feedback.block_reason_message or feedback.block_reason)
        if response.candidates:
            reasons.append(response.candidates[0].finish_reason)
        reasons += [part.text for part in response.parts or ()]
        words = [str(getattr(reason, "value", reason)) for reason in reasons if reason]
        return self.quote("; ".join(words)) or "no reason"
