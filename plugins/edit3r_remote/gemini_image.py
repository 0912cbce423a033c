"""Gemini's image model through the Gemini API."""

import sys
from collections.abc import Callable
from typing import Any

from pydantic import Field

from edit3r.contract.interfaces import Editor
from edit3r.contract.types import EditRequest, Views
from edit3r.errors import MissingDependencyError, PromptError, RunError
from edit3r.reporting import note
from edit3r_remote.dispatch import Dispatcher
from edit3r_remote.service import (
    Answer,
    ImageService,
    RemoteSettings,
    Request,
    key_from_environment,
)

KEY_VARIABLES = ("GEMINI_API_KEY", "GOOGLE_API_KEY")
RETRIED = (408, 429, 500, 502, 503, 504)
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
        model: str = Field(
            "gemini-2.5-flash-image", description="the service's name of the model"
        )
        retry_delay_s: float = Field(
            1.0,
            gt=0,
            le=60,
            description="wait before the second try, doubled for each more",
        )
        input_price: float = Field(
            0.30, ge=0, description="price of a million input tokens [USD]"
        )
        output_price: float = Field(
            30.0, ge=0, description="price of a million output tokens [USD]"
        )

    def edit(self, views: Views, request: EditRequest) -> Views:
        chosen = self.settings
        note(
            "editor.seed",
            "sent to the service, which does not promise equal pictures for equal seeds",
        )
        asked = {"service": "gemini", "model": chosen.model}
        return Dispatcher(GeminiImages(chosen), chosen, asked).edit(
            views, request, tuple(SHAPES), send_masks=False
        )


class GeminiImages(ImageService):
    """`generate_content` with a picture as the only modality; the client library retries once told
    to.
    """

    label = "gemini-image"

    def __init__(self, settings: GeminiImageEditor.Settings) -> None:
        from google import genai
        from google.genai import types

        self.key = key_from_environment(self.label, *KEY_VARIABLES)
        self.settings, self.types = settings, types
        retries = types.HttpRetryOptions(
            attempts=settings.attempts,
            initial_delay=settings.retry_delay_s,
            jitter=settings.retry_delay_s,
            http_status_codes=list(RETRIED),
        )
        options = types.HttpOptions(
            base_url=settings.base_url or None,
            timeout=int(settings.timeout_s * 1000),
            retry_options=retries,
        )
        self.client = genai.Client(
            api_key=self.key, vertexai=False, http_options=options
        )

    def send(self, request: Request) -> Answer:
        from google.genai import errors

        types = self.types
        image = types.Part.from_bytes(data=request.image, mime_type="image/png")
        config = types.GenerateContentConfig(
            response_modalities=["IMAGE"],
            seed=request.seed,
            image_config=types.ImageConfig(aspect_ratio=SHAPES[request.size]),
        )
        try:
            ask = self.client.models.generate_content
            contents = [request.prompt, image]
            response = self._patiently(
                ask, model=self.settings.model, contents=contents, config=config
            )
        except errors.APIError as error:
            raise self._refused(error, request) from None
        return self._answer(response, request)

    def _patiently(self, ask: Callable[..., Any], **asked: Any) -> Any:
        """Ask again when the connection breaks during the answer, which the client library does
        not.
        """
        import tenacity

        retrying = tenacity.Retrying(
            stop=tenacity.stop_after_attempt(self.settings.attempts),
            wait=tenacity.wait_exponential(
                multiplier=self.settings.retry_delay_s, max=60
            ),
            retry=tenacity.retry_if_exception_type(_broken_connections()),
            reraise=True,
        )
        return retrying(ask, **asked)

    def _refused(self, error: Any, request: Request) -> Exception:
        """Make the sentence for an HTTP status that retrying did not cure."""
        words = self.quote(error.message or error.status)
        if error.code in (401, 403) or "api key not valid" in words.lower():
            names = " or ".join(KEY_VARIABLES)
            return MissingDependencyError(
                f"gemini-image: the service does not accept the key in {names} ({words})."
            )
        if error.code == 429:
            return RunError(
                f"gemini-image is over its rate limit after {self.settings.attempts} tries for "
                f"{request.name} "
                f"({words}); wait, or lower editor.concurrent."
            )
        return RunError(
            f"gemini-image failed on {request.name} with status {error.code}: {words}"
        )

    def _answer(self, response: Any, request: Request) -> Answer:
        """Take the image among the answer's parts; raises PromptError with the model's words when
        there is none.
        """
        candidate = response.candidates[0] if response.candidates else None
        parts = (
            candidate.content.parts if candidate and candidate.content else None
        ) or []
        image = next(
            (
                part.inline_data.data
                for part in parts
                if part.inline_data and part.inline_data.data
            ),
            None,
        )
        if image is None:
            raise PromptError(
                f"gemini-image sent no picture for {request.name}: {self._reason(response, parts)}"
            )
        usage = response.usage_metadata
        tokens = (
            (usage.prompt_token_count, usage.candidates_token_count)
            if usage
            else (0, 0)
        )
        return Answer(image, *tokens)

    def _reason(self, response: Any, parts: list[Any]) -> str:
        text = " ".join(part.text for part in parts if part.text)
        feedback = response.prompt_feedback
        blocked = (
            feedback.block_reason_message or feedback.block_reason if feedback else None
        )
        finish = response.candidates[0].finish_reason if response.candidates else None
        named = getattr(blocked or finish, "value", blocked or finish)
        reasons = ([f"[{named}]"] if named else []) + ([f'"{text}"'] if text else [])
        return self.quote(" ".join(reasons)) or "no reason"


def _broken_connections() -> tuple[type[Exception], ...]:
    """List the exceptions for a connection lost midway, of whichever HTTP library the client
    uses.
    """
    libraries = [
        sys.modules[name] for name in ("httpx", "httpx2") if name in sys.modules
    ]
    return tuple(
        error
        for http in libraries
        for error in (http.RemoteProtocolError, http.ReadError, http.WriteError)
    )
