"""Between photos of any size and the sizes a diffusion model works at."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import RunError
from edit3r.types import Views


def working_size(height: int, width: int, longer_side: int, multiple: int) -> tuple[int, int]:
    """(height, width) with the photo's shape, the given longer side (0: its own), both multiples of `multiple`."""
    scale = longer_side / max(height, width) if longer_side else 1.0
    fit = [max(multiple, round(side * scale / multiple) * multiple) for side in (height, width)]
    return fit[0], fit[1]


def resize(images: Float[Tensor, "n c h w"], size: tuple[int, int]) -> Float[Tensor, "n c H W"]:
    """Antialiased bicubic resize, clipped to [0, 1]; untouched when the size is already right."""
    if images.shape[-2:] == size:
        return images
    return F.interpolate(images, size, mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)


def mask_on_grid(mask: Float[Tensor, "n 1 h w"], size: tuple[int, int], cell: int) -> Float[Tensor, "n 1 H W"]:
    """A 0/1 mask of `size` made of square cells of `cell` pixels, the grid of the latents."""
    cells = resize_mask(mask, (size[0] // cell, size[1] // cell))
    return F.interpolate((cells > 0).to(mask), size, mode="nearest")


def resize_mask(mask: Float[Tensor, "n 1 h w"], size: tuple[int, int]) -> Float[Tensor, "n 1 H W"]:
    """A mask at another size in which every cell that touches a pixel that may change may change too."""
    return F.interpolate(F.adaptive_max_pool2d(mask, size), size, mode="nearest")


def checked(image: Tensor, like: Tensor, view: str) -> Tensor:
    """A pipeline's picture with the photos' size, dtype and device; raises RunError where half precision overflowed."""
    if not torch.isfinite(image).all():
        raise RunError(
            f"the edit of {view} came out with values that are not finite, which happens when half precision "
            f"overflows; use --set editor.dtype=float32."
        )
    image = image.to(like.device, torch.float32).clamp(0, 1)
    return resize(image, like.shape[-2:]).to(like.dtype)


def view_name(views: Views, view: int) -> str:
    """What to call a view in messages."""
    return views.names[view] if views.names else f"view {view}"
