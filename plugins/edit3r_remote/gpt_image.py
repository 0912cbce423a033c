"""GPT-Image through OpenAI's image editing service."""

import base64
from typing import Any, Literal

from pydantic import Field

from edit3r.contract.errors import Edit3rError, PromptError, RunError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import note
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.service import bounded_client
from edit3r_remote.dispatch import Dispatcher
from edit3r_remote.service import ImageService, RemoteSettings, Request, ServiceAnswer

SIZES = ((1024, 1024), (1024, 1536), (1536, 1024))
"""(height, width) the service draws [pixels]."""
REFUSALS = ("moderation_blocked", "content_policy_violation")


class GptImageEditor(Editor):
    """Edits each view on its own by the same instruction.

    The service takes no seed, so equal requests may differ; the cache returns the answer already
    paid for, and another seed asks anew. Masks are sent as transparency, which the model takes as
    advice.
    """

    class Settings(RemoteSettings):
        model: str = "gpt-image-1"
        """the service's name of the model"""
        quality: Literal["auto", "low", "medium", "high"] = "high"
        """decides most of the price"""
        input_fidelity: Literal["low", "high"] = "high"
        """how closely the photo is looked at"""
        input_price: float = Field(10.0, ge=0)
        """price of a million input tokens [USD]"""
        output_price: float = Field(40.0, ge=0)
        """price of a million output tokens [USD]"""

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        service = OpenAiImages(self.settings)
        note(
            "editor.seed",
            "the service takes no seed: equal requests may give other images unless cached",
        )
        asked = {"service": "openai", **service.chosen}
        return Dispatcher(service, asked).edit(views, request, SIZES, send_masks=True)


class OpenAiImages(ImageService):
    """`images.edit`; the client library tries 408, 429, 5xx and lost connections again."""

    label = "gpt-image"
    variables = ("OPENAI_API_KEY",)

    def __init__(self, settings: GptImageEditor.Settings) -> None:
        from openai import OpenAI

        super().__init__(settings)
        self.chosen = settings.model_dump(
            include={"model", "quality", "input_fidelity"}
        )
        self.client = OpenAI(
            api_key=self.key,
            base_url=settings.base_url or None,
            http_client=bounded_client(settings.timeout_s),
            timeout=settings.timeout_s,
            max_retries=settings.attempts - 1,
        )

    def send(self, request: Request) -> ServiceAnswer:
        import openai

        optional: dict[str, Any] = {}
        if request.mask:
            optional["mask"] = ("mask.png", request.mask, "image/png")
        try:
            response = self.client.images.edit(
                image=("view.png", request.image, "image/png"),
                prompt=request.prompt,
                size=f"{request.size[1]}x{request.size[0]}",
                output_format="png",
                n=1,
                **self.chosen,
                **optional,
            )
        except openai.APIStatusError as error:
            raise self._refused(error, request) from None
        encoded = response.data[0].b64_json if getattr(response, "data", None) else None
        if not encoded:
            raise RunError(
                f"gpt-image answered without an image for {request.name}: {self.quote(response)}"
            )
        usage = response.usage  # of any type
        return ServiceAnswer(
            image=base64.b64decode(encoded),
            input_tokens=getattr(usage, "input_tokens", 0),
            output_tokens=getattr(usage, "output_tokens", 0),
        )

    def _refused(self, error: Any, request: Request) -> Edit3rError:
        if error.code in REFUSALS:
            words = self.quote(error.message)
            return PromptError(f"gpt-image refused to edit {request.name}: {words}")
        return self.failure(error.status_code, error.message, request)
