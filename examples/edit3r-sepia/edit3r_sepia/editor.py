"""Editor `sepia`: every photo in the brown tones of an old print."""

from dataclasses import replace

import kornia
import torch
from pydantic import Field

import edit3r
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import EditRequest, Views


class SepiaEditor(Editor):
    """The same matrix on every pixel, so all views agree. Masks are the pipeline's business."""

    class Settings(edit3r.Settings):
        strength: float = Field(
            1.0, ge=0, le=1, description="share of the sepia tone; 0 returns the photo"
        )

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        # [batch * view, 3, height, width], sRGB in [0, 1]
        images = views.images.flatten(0, 1)
        toned = kornia.color.sepia(images, rescale=False).clamp(0, 1)
        edited = torch.lerp(images, toned, self.settings.strength).clamp(0, 1)
        # cameras and names stay
        return replace(views, images=edited.reshape_as(views.images))
