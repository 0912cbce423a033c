"""Only as many bands of harmonics as the pictures need."""

from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Rasterizer
from edit3r.types import Cameras, Gaussians


def needed_degree(
    gaussians: Gaussians, looks: Sequence[Cameras], rasterizer: Rasterizer, tolerance: float
) -> Gaussians:
    """The Gaussians with the lowest degree whose pictures differ nowhere by more than `tolerance` [sRGB].

    Bands that are zero go without a look. The others are judged by rendering: a band may matter to single Gaussians
    and to no pixel.
    """
    used = _highest_used(gaussians.harmonics)
    full = [rasterizer.render(gaussians, look).images for look in looks] if used else []
    for degree in range(used):
        fewer = _cut(gaussians, degree)
        if all(
            float((rasterizer.render(fewer, look).images - picture).abs().amax()) <= tolerance
            for look, picture in zip(looks, full)
        ):
            return fewer
    return _cut(gaussians, used)


def _cut(gaussians: Gaussians, degree: int) -> Gaussians:
    return replace(gaussians, harmonics=gaussians.harmonics[:, :, : (degree + 1) ** 2].contiguous())


def _highest_used(harmonics: Float[Tensor, "batch gaussian coefficient 3"]) -> int:
    """Degree of the last coefficient that is not zero everywhere."""
    used = harmonics.ne(0).any(dim=3).any(dim=1).any(dim=0).nonzero()
    return int(float(used.max()) ** 0.5) if used.numel() else 0
