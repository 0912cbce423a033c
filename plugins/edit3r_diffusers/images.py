"""Between photos of any size and the sizes a diffusion model works at, and the edit of one view
after the other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import RunError
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.maps import resampled, size_of
from edit3r_diffusers import loading


@dataclass(frozen=True)
class ViewJob:
    """One view at the model's working size, on its device and in its precision."""

    image: Float[Tensor, "1 3 height width"]  # in [0, 1]
    mask: Float[Tensor, "1 1 H W"] | None  # at the photo's size; 1: may change
    prompt: str
    seed: int
    text: str  # for progress and messages
    # image to begin from; None: from noise
    start: Float[Tensor, "1 3 height width"] | None = None

    def generator(self) -> torch.Generator:
        """Make a fresh generator, on the CPU so that every device draws the same noise.

        One generator shared by the views would give each view other noise, and the edits would not
        match.
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
    """Edit every view by `denoise`, from its image of `starts` if given; an empty mask keeps it."""

    def edit_view(scene: int, view: int) -> Float[Tensor, "3 height width"]:
        photo = views.images[scene, view]
        masks = request.masks
        mask = None if masks is None else masks[scene, view][None, None]
        if mask is not None and not mask.any():
            return photo
        name = views.called[view]
        size = working_size(*size_of(photo), longer_side, multiple)
        with (
            torch.no_grad(),
            loading.out_of_memory_told(f"editing {name} at {size[1]}x{size[0]}"),
        ):
            chosen = [photo]
            if starts is not None:
                chosen.append(starts[scene, view].clamp(0, 1).to(photo))
            sized = resampled(torch.stack(chosen).float(), size)
            image, *start = sized.to(pipeline._execution_device, pipeline.dtype).split(
                1
            )
            text = f"editing {name}"
            job = ViewJob(image, mask, request.prompt, request.seed, text, *start)
            edited = denoise(job)
        return checked(edited, photo, name)[0]

    scenes, count = views.images.shape[:2]
    edited = [
        torch.stack([edit_view(scene, view) for view in range(count)])
        for scene in range(scenes)
    ]
    return replace(views, images=torch.stack(edited))


def working_size(
    height: int, width: int, longer_side: int, multiple: int
) -> tuple[int, int]:
    """(height, width) of the photo's shape and longer side (0: its own), in multiples."""
    scale = longer_side / max(height, width) if longer_side else 1.0
    height, width = (
        max(multiple, round(side * scale / multiple) * multiple)
        for side in (height, width)
    )
    return height, width


def mask_on_grid(
    mask: Float[Tensor, "n 1 h w"], size: tuple[int, int], cell: int
) -> Float[Tensor, "n 1 H W"]:
    """Make a 0/1 mask of `size` out of square cells of `cell` pixels, the grid of the latents."""
    cells = resize_mask(mask, (size[0] // cell, size[1] // cell))
    return F.interpolate((cells > 0).to(mask), size, mode="nearest")


def resize_mask(
    mask: Float[Tensor, "n 1 h w"], size: tuple[int, int]
) -> Float[Tensor, "n 1 H W"]:
    """Resize a mask so that every cell that touches a pixel that may change may change too."""
    return F.interpolate(F.adaptive_max_pool2d(mask, size), size, mode="nearest")


def checked(
    image: Float[Tensor, "n 3 h w"], like: Float[Tensor, "*n 3 height width"], view: str
) -> Float[Tensor, "n 3 height width"]:
    """A pipeline's images in the photos' size, dtype and device. Raises RunError on overflow."""
    if not torch.isfinite(image).all():
        raise RunError(
            f"the edit of {view} came out with values that are not finite, which happens when "
            "half precision overflows; use --set editor.dtype=float32."
        )
    image = image.to(like.device, torch.float32).clamp(0, 1)
    return resampled(image, size_of(like)).to(like.dtype)
