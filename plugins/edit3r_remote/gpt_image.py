"""GPT-Image through OpenAI's image editing service."""

import base64
from typing import Any, Literal

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

KEY_VARIABLE = "OPENAI_API_KEY"
SIZES = ((1024, 1024), (1024, 1536), (1536, 1024))
"""(height, width) the service draws [pixels]."""


class GptImageEditor(Editor):
    """Edits each view on its own by the same instruction.

    The service takes no seed, so equal requests may differ; the cache returns the answer already
    paid for, and another seed asks anew. Masks are sent as transparency, which the model takes as
    advice.
    """

    class Settings(RemoteSettings):
        model: str = Field("gpt-image-1", description="the service's name of the model")
        quality: Literal["auto", "low", "medium", "high"] = Field(
            "high", description="decides most of the price"
        )
        input_fidelity: Literal["low", "high"] = Field(
            "high", description="how closely the photo is looked at"
        )
        input_price: float = Field(
            10.0, ge=0, description="price of a million input tokens [USD]"
        )
        output_price: float = Field(
            40.0, ge=0, description="price of a million output tokens [USD]"
        )

    def edit(self, views: Views, request: EditRequest) -> Views:
        chosen = self.settings
        asked = {"service": "openai"} | chosen.model_dump(
            include={"model", "quality", "input_fidelity"}
        )
        note(
            "editor.seed",
            "the service takes no seed: equal requests may give other pictures unless cached",
        )
        return Dispatcher(OpenAiImages(chosen), chosen, asked).edit(
            views, request, SIZES, send_masks=True
        )


class OpenAiImages(ImageService):
    """`images.edit`; the client library retries 408, 429, 5xx and lost connections and honours
    Retry-After.
    """

    label = "gpt-image"

    def __init__(self, settings: GptImageEditor.Settings) -> None:
        from openai import OpenAI

        self.key = key_from_environment(self.label, KEY_VARIABLE)
        self.settings = settings
        self.client = OpenAI(
            api_key=self.key,
            base_url=settings.base_url or None,
            timeout=settings.timeout_s,
            max_retries=settings.attempts - 1,
        )

    def send(self, request: Request) -> Answer:
        import openai

        mask: dict[str, Any] = (
            {"mask": ("mask.png", request.mask, "image/png")} if request.mask else {}
        )
        try:
            response = self.client.images.edit(
                model=self.settings.model,
                image=("view.png", request.image, "image/png"),
                prompt=request.prompt,
                size=f"{request.size[1]}x{request.size[0]}",
                quality=self.settings.quality,
                input_fidelity=self.settings.input_fidelity,
                output_format="png",
                n=1,
                **mask,
            )
        except openai.APIStatusError as error:
            raise self._refused(error, request) from None
        except openai.APITimeoutError:
            raise RunError(
                f"gpt-image did not answer for {request.name} within {self.settings.timeout_s:g} "
                "s, "
                f"{self.settings.attempts} times; raise editor.timeout_s or try later."
            ) from None
        return self._answer(response, request)

    def _refused(self, error: Any, request: Request) -> Exception:
        """Make the sentence for an HTTP status that retrying did not cure."""
        words = self.quote(getattr(error, "message", error))
        if error.status_code == 401:
            return MissingDependencyError(
                f"gpt-image: the service does not accept the key in {KEY_VARIABLE}."
            )
        if getattr(error, "code", None) in (
            "moderation_blocked",
            "content_policy_violation",
        ):
            return PromptError(f"gpt-image refused to edit {request.name}: {words}")
        if error.status_code == 429:
            return RunError(
                f"gpt-image is over its rate limit or budget after {self.settings.attempts} "
                f"tries for {request.name} "
                f"({words}); wait, or lower editor.concurrent."
            )
        return RunError(
            f"gpt-image failed on {request.name} with status {error.status_code}: {words}"
        )

    def _answer(self, response: Any, request: Request) -> Answer:
        encoded = response.data[0].b64_json if getattr(response, "data", None) else None
        if not encoded:
            raise RunError(
                f"gpt-image answered without a picture for {request.name}: {self.quote(response)}"
            )
        usage = response.usage
        tokens = (
            getattr(usage, name, 0) for name in ("input_tokens", "output_tokens")
        )  # of any type
        return Answer(base64.b64decode(encoded), *tokens)
