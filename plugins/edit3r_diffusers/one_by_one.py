"""Edit views one after the other, each from the same noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.types import EditRequest, Views
from edit3r_diffusers import loading, pictures


@dataclass(frozen=True)
class ViewJob:
    """One view at the model's working size, on its device and in its precision."""

    image: Float[Tensor, "1 3 height width"]  # in [0, 1]
    mask: Float[Tensor, "1 1 H W"] | None  # at the photo's size; 1: may change
    prompt: str
    seed: int
    text: str  # for progress and messages
    start: Float[Tensor, "1 3 height width"] | None = None  # picture to begin from; None: from noise

    def generator(self) -> torch.Generator:
        """A fresh generator, on the CPU so that every device draws the same noise.

        One generator shared by the views would give each view other noise, and the edits would not match.
        """
        return torch.Generator("cpu").manual_seed(self.seed)


def edit_one_by_one(
    views: Views,
    request: EditRequest,
    pipeline: Any,
    longer_side: int,
    multiple: int,
    denoise: Callable[[ViewJob], Float[Tensor, "1 3 height width"]],
    starts: Float[Tensor, "batch view 3 height width"] | None = None,
) -> Views:
    """Every view through `denoise`, with its picture of `starts`; one whose mask is empty stays as it is."""

    def edit_view(scene: int, view: int) -> Tensor:
        photo = views.images[scene, view]
        mask = request.masks[scene, view][None, None] if request.masks is not None else None
        if mask is not None and not mask.any():
            return photo
        name = pictures.view_name(views, view)
        size = pictures.working_size(*photo.shape[-2:], longer_side, multiple)
        with torch.no_grad(), loading.out_of_memory_told(f"editing {name} at {size[1]}x{size[0]}"):
            chosen = photo if starts is None else torch.stack((photo, starts[scene, view].clamp(0, 1).to(photo)))
            sized = pictures.resize(chosen.reshape(-1, *photo.shape).float(), size)
            image, *start = sized.to(pipeline._execution_device, pipeline.dtype).split(1)
            edited = denoise(ViewJob(image, mask, request.prompt, request.seed, f"editing {name}", *start))
        return pictures.checked(edited, photo, name)[0]

    scenes, count = views.images.shape[:2]
    edited = [torch.stack([edit_view(scene, view) for view in range(count)]) for scene in range(scenes)]
    return replace(views, images=torch.stack(edited))
